"""Conventions: which way is positive, where zero is, what an angle is measured from, and which column is which.

Whoever wires a rig decides them, and whoever writes its model decides them anew. Where the two differ, no physics
makes up for that, and what is fitted is nonsense. So it is where a command is counted in thousandths.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import mujoco
import numpy as np
from numpy.typing import NDArray

from dipc_gym import mjcf
from dipc_gym.mjcf.edit import Document
from dipc_gym.physics import Physics
from dipc_gym.recording import Recording, RecordingError
from dipc_gym.recording.columns import COMMAND, SENSOR, called
from dipc_gym.recording.units import KINDS, of_command, of_sensor
from dipc_gym.sim2real.effects.shared.base import joint_of, sensed_joint
from dipc_gym.sim2real.estimation import states
from dipc_gym.sim2real.estimation.fit import Fit, evaluate
from dipc_gym.sim2real.estimation.segments import Prepared, prepare
from dipc_gym.sim2real.estimation.shooting import common_error
from dipc_gym.sim2real.selection import partitioning
from dipc_gym.sim2real.selection.settings import SEARCH, WINDOWS
from dipc_gym.sim2real.side_by_side import side_by_side
from dipc_gym.sim2real.verdict.settings import CONVENTIONS

IN_DEGREES = {"rad": "deg", "rad/s": "deg/s"}  # what `--unit` calls commands of servos that may be so

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Convention:
    """One way in which recordings may count otherwise than the model.

    Attributes:
        words: what they do, after "the recordings".
        mend: what their owner can do about it.
        commands: factors of the commands, (nu,).
        sensors: what makes the model's readings of theirs, (ns, ns).
        shift: added to that, (ns,).
        columns: of theirs, commands and then sensors, which one is each of the model's, (nu + ns,).
        driving: which commands drive otherwise than by their sign: in thousandths, or by another column, (nu,).
        early: rows by which commands act before their stamps: whoever writes an action down with what it led to.
    """

    words: str
    mend: str
    commands: Array
    sensors: Array
    shift: Array
    columns: NDArray[np.intp]
    driving: NDArray[np.bool_]
    early: int = 0

    def undriven(self) -> Convention:
        """The same without the commands that drive otherwise."""
        return replace(self, commands=np.where(self.driving, 0.0, self.commands))

    def applied(self, recording: Recording) -> Recording:
        """A recording as the model counts."""
        whole = np.concatenate([recording.commands, recording.sensors], axis=1)[:, self.columns]
        commands, sensors = np.split(whole, [len(self.commands)], axis=1)
        commands = np.concatenate([commands[self.early :], np.repeat(commands[-1:], self.early, axis=0)])
        return replace(recording, commands=commands * self.commands, sensors=sensors @ self.sensors.T + self.shift)


def possible(
    source: mjcf.Source, physics: Physics, actuators: Sequence[str], sensors: Sequence[str]
) -> Iterator[Convention]:
    """Every convention by itself: commands that are stamped late, signs of commands and joints, commands in
    thousandths or degrees, half turns, angles from the joint before or from afar, and columns that are interchanged.

    Args:
        source: text of the model.
        physics: the same, loaded.
        actuators: names of the commands.
        sensors: names of the sensors.
    """
    document, (nu, ns) = Document(source), (len(actuators), len(sensors))
    same = Convention("", "", np.ones(nu), np.eye(ns), np.zeros(ns), np.arange(nu + ns), np.zeros(nu, dtype=bool))
    for rows in CONVENTIONS.early if nu else ():
        words = "hold in each row what the command of that row led to, and not what it followed"
        if rows > 1:
            words = f"give commands {rows} rows later than they act"
        moved = f"{_listed('column', actuators)} up by {rows} row{'s' * (rows > 1)}"
        mend = f"move {moved}, so that a command stands where it begins"
        yield replace(same, words=words, mend=mend, early=rows)
    for name, unit in zip(actuators, np.eye(nu), strict=True):
        key = called(COMMAND, name, sensors)
        words, mend = f"count command {name!r} the other way round", _turn(key)
        yield replace(same, words=words, mend=mend, commands=1 - 2 * unit)
        unit_of = of_command(physics.model, name)
        if unit_of in IN_DEGREES:
            said = IN_DEGREES[unit_of]
            words, mend = f"count command {name!r} in degrees ({said})", f"say --unit {key}={said}"
            factors = np.where(unit == 1, math.pi / 180, 1.0)
            yield replace(same, words=words, mend=mend, commands=factors, driving=unit == 1)
        small = _thousandth(unit_of)
        words, mend = f"count command {name!r} in thousandths ({small})", f"say --unit {key}={small}"
        factors = np.where(unit == 1, CONVENTIONS.thousandth, 1.0)
        yield replace(same, words=words, mend=mend, commands=factors, driving=unit == 1)
    read, gains = _read(physics)
    for joint, (places, rates) in read.items():
        names = [sensors[s] for s in (*places, *rates)]
        keys = [called(SENSOR, name, actuators) for name in names]
        turned = np.eye(len(sensors))
        turned[[*places, *rates]] *= -1
        words, mend = f"count {_listed('sensor', names)} the other way round", _turn(*keys)
        yield replace(same, words=words, mend=mend, sensors=turned)
        if mjcf.is_hinge(physics.model, joint):
            words = f"count {_listed('sensor', names[: len(places)])} from half a turn away"
            half = f'ref="{document.angle(document.joint(joint), math.pi):.8g}"'
            mend = f"add half a turn to the column, or give joint {joint!r} of the model {half}"
            shift = np.zeros(len(sensors))
            shift[places] = gains[places] * math.pi
            yield replace(same, words=words, mend=mend, shift=shift)
    for one, other in itertools.permutations(read, 2):
        pairs = [(of, before) for of, before in zip(read[other], read[one], strict=True) if of]
        along = _carries(physics.model, one, other)
        if not (along and all(before for _, before in pairs)):
            continue
        for sign, which in ((-along, "an absolute angle"), (along, f"an angle from {one!r}")):
            mend = "subtract" if sign < 0 else "add"
            mixed = np.eye(len(sensors))
            for of, before in pairs:
                mixed[of, before[0]] = sign * gains[of] / gains[before[0]]
            words = f"measure at joint {other!r} {which}, and the model does not"
            yield replace(same, words=words, mend=f"{mend} what is read at {one!r} ({mend} the columns)", sensors=mixed)
    yield from _interchanged(physics.model, same, actuators, sensors)


def _interchanged(
    model: mujoco.MjModel, same: Convention, actuators: Sequence[str], sensors: Sequence[str]
) -> Iterator[Convention]:
    """Two columns in each other's place: of one unit, or a command and a sensor of what it drives."""
    labels = [*(f"command {name!r}" for name in actuators), *(f"sensor {name!r}" for name in sensors)]
    keys = [
        called(prefix, name, others)
        for prefix, names, others in ((COMMAND, actuators, sensors), (SENSOR, sensors, actuators))
        for name in names
    ]
    units = [*(of_command(model, name) for name in actuators), *(of_sensor(model, name) for name in sensors)]
    joints = [*(joint_of(model, name) for name in actuators), *(sensed_joint(model, name) for name in sensors)]
    for i, j in itertools.combinations(range(len(labels)), 2):
        drives = i < len(actuators) <= j
        if joints[i] != joints[j] if drives else units[i] != units[j]:
            continue
        order = same.columns.copy()
        order[[i, j]] = j, i
        words = f"have {labels[i]} and {labels[j]} interchanged"
        named = f"--map {keys[i]}={keys[j]} --map {keys[j]}={keys[i]} where they have these names"
        mend = f"interchange the two columns ({named})"
        driving = order[: len(actuators)] != np.arange(len(actuators))
        yield replace(same, words=words, mend=mend, columns=order, driving=driving)


def differing(
    source: mjcf.Source,
    physics: Physics,
    recordings: Sequence[Recording],
    prepared: Prepared,
    fits: Sequence[Fit],
    *,
    gross: bool = True,
) -> tuple[list[Convention], float]:
    """Conventions with which the model as given predicts far better than it does without, whatever its parameters.

    The first seconds in which a recording moves tell: a wrong convention is wrong throughout.

    Args:
        source: text of the model.
        physics: the same, loaded.
        recordings: of one rig.
        prepared: windows of them, whose length and steps are taken.
        fits: as given, and with its parameters refitted.
        gross: whether the mismatch is a large one; else only what is off by a row is asked for.

    Returns:
        Those that predict best, alike, and the error then, in units of noise; none where none decides.
    """
    first, some = recordings[0], _in_motion(recordings, prepared)
    if not some:
        return [], math.inf

    def counted(convention: Convention | None) -> Prepared:
        given = some if convention is None else [convention.applied(recording) for recording in some]
        stepping, threads = prepared.problem.stepping, prepared.problem.threads
        again = prepare(source, physics, given, stepping, length=prepared.length, threads=threads)
        return partitioning.known_past(again)

    as_counted = counted(None).problem
    if not len(as_counted.windows):
        return [], math.inf
    without = min(common_error(evaluate(as_counted, one.structure, one.z)) for one in fits)
    decides = CONVENTIONS.decides * without

    def error(convention: Convention) -> tuple[float, float]:
        """Error with a convention, in units of noise, and how many of these would be as large beside what moves as it
        is counted: in the column of a command a sensor seems to be noisy, and everything is small beside that.
        """
        try:
            again = counted(convention)
        except RecordingError:  # a command that never changes is no reading
            return math.inf, math.inf
        few = again.problem.pick(np.arange(0, len(again.problem.windows), CONVENTIONS.every))
        beside = as_counted.motion / max(again.problem.motion, 1e-12)
        for problem, most in ((few, CONVENTIONS.hopeless * decides), (again.problem, math.inf)):
            off = common_error(evaluate(problem, again.structure, again.structure.first))
            if off * beside > most:
                break
        return off, off * beside

    named = possible(source, physics, first.actuator_names, first.sensor_names)
    all_of = [convention for convention in named if gross or convention.early]
    with side_by_side([partial(error, convention) for convention in all_of], prepared.problem.threads) as result:
        tried = [(*result(k), convention) for k, convention in enumerate(all_of)]
    tried = [each for each in tried if each[1] < decides]
    # A row is little: whatever leads or lags may seem to be one, where it is not nearly all that is wrong.
    tried = [each for each in tried if not each[2].early or each[0] < SEARCH.in_reach]
    # A drive that does nothing predicts a rig that sticks, and for a quarter of a second whatever is smooth.
    tried = [
        (off, share, convention)
        for off, share, convention in tried
        if not convention.driving.any() or off < CONVENTIONS.decides * error(convention.undriven())[0]
    ]
    least = min((share for _, share, _ in tried), default=math.inf)
    found = [(off, convention) for off, share, convention in tried if share < CONVENTIONS.alike * least]
    return [convention for _, convention in found], min((off for off, _ in found), default=math.inf)


def _in_motion(recordings: Sequence[Recording], prepared: Prepared) -> list[Recording]:
    """The first seconds in which recordings move, of two of them; at rest every convention predicts all."""
    windows, moves = prepared.problem.windows, partitioning.moves(prepared)
    known = max(WINDOWS.late, prepared.structure.activated)  # of the past, before a window
    begin = [(k, windows.start[moves & (windows.source == k)].min(initial=math.inf)) for k in range(len(recordings))]
    moving = [(recordings[k], start) for k, start in begin if math.isfinite(start)][:2]
    found = []
    for recording, start in moving:
        borders = start - known, start + CONVENTIONS.seconds / len(moving)
        found.append(recording.slice(*np.searchsorted(recording.time, borders).tolist()))
    return found


def _read(physics: Physics) -> tuple[dict[str, tuple[list[int], list[int]]], Array]:
    """Of every joint whose position some sensor tells by itself, the sensors of its position and of its rate; and how
    many times as far each of these goes, (ns,).
    """
    P, V, _ = states.sensor_map(physics)
    alone = (np.abs(P) + np.abs(V) > 0).sum(axis=1) == 1
    found = {
        joint: (np.flatnonzero(alone & (P[:, j] != 0)).tolist(), np.flatnonzero(alone & (V[:, j] != 0)).tolist())
        for j, joint in enumerate(mjcf.base_joints(physics.model))
    }
    return {joint: sensors for joint, sensors in found.items() if sensors[0]}, (P + V).sum(axis=1)


def _thousandth(unit: str) -> str:
    """How `--unit` calls a thousandth of a unit."""
    return next(
        (name for name, number in KINDS[unit].items() if number == CONVENTIONS.thousandth),
        f"{CONVENTIONS.thousandth:g}",
    )


def _turn(*names: str) -> str:
    """How to turn the sign of columns round."""
    units = " ".join(f"--unit {name}=-1" for name in names)
    return f"turn its sign round ({units}, or a minus before the unit given, as in -mm)"


def _listed(what: str, names: Sequence[str]) -> str:
    return f"{what}{'s' * (len(names) > 1)} {' and '.join(map(repr, names))}"


def _carries(model: mujoco.MjModel, one: str, other: str) -> int:
    """Whether one hinge carries another about an axis parallel to its own: 1, -1 where that points the other way, else
    0.
    """
    if not (mjcf.is_hinge(model, one) and mjcf.is_hinge(model, other)):
        return 0
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    first, second = (model.joint(name).id for name in (one, other))
    body, carrier = (int(model.jnt_bodyid[joint]) for joint in (second, first))
    while body not in (0, carrier):
        body = int(model.body_parentid[body])
    along = float(data.xaxis[first] @ data.xaxis[second])
    return int(np.sign(along)) if body == carrier and abs(along) > CONVENTIONS.parallel else 0
