"""The physics that MJCF cannot say, kept under `<custom>` of the same file and applied around MuJoCo's step.

MuJoCo has no dead zone in an amplifier, no sensor with a wrong gain, no friction that varies along a rail. Such
effects stand in the model file as

    <custom>
      <numeric name="dipc_gym:motor.deadzone:motor" data="0.4"/>
    </custom>

that is `dipc_gym:EFFECT:PLACE`, with the effect's numbers as data. Stock MuJoCo ignores the entry and simulates the
model without it; `load` applies it. Four kinds of effect exist, each a small function on arrays whose last axis is
the control, the sensor or the degree of freedom, so that one environment and a batch of a thousand run the same code:

    command    changes the command before the model sees it
    force      adds a generalised force that depends on time
    friction   sets the dry friction of a joint at each step
    sensor     changes a sensor's reading

and `timing.sensor_lag`, a sensor that follows its reading with a time constant, which alone has a memory.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import mujoco
import numpy as np
from numpy.typing import NDArray

from dipc_gym import mjcf
from dipc_gym.safety.naming import suggestion

__all__ = ["Extra", "Moment", "Physics", "from_model", "load", "register"]

Stage = Literal["command", "force", "friction", "sensor", "lag"]
Array = NDArray[np.float64]

LARGEST = 1e9  # of an entry's numbers; of what comes of them, its square
CLOSEST = 1e-12  # of a table's knots, as a share of what they are, or of 1
SHORTEST_LAG, LONGEST_LAG = 1e-9, 1e6  # time constants, s
TRIED = (-100.0, -1.0, -1e-3, 0.0, 1e-3, 1.0, 100.0)  # positions, forces, commands and times
OUTERMOST = (-1e10, 1e10)  # MuJoCo bounds a state to this; what comes of it need but be a number


@dataclass(frozen=True)
class Moment:
    """What an effect may look at when it acts.

    Attributes:
        time: simulation time, s, (...).
        position: position of the joint it acts on, m or rad, (...); zeros for commands and sensors.
        drive: force of the actuators on the joint, N or N m, (...).
        weight: force that gravity and the motion of other joints ask of it, MuJoCo's bias, N or N m, (...).
        value: the command or the reading to change, (...); zeros for forces and friction.
        speed: velocity of the joint it acts on, m/s or rad/s, (...); zeros for commands and sensors.
        inputs: what else a law depends on, in the order in which the file names them, (...) each.
    """

    time: Array
    position: Array
    drive: Array
    weight: Array
    value: Array
    speed: Any = 0.0
    inputs: tuple[Any, ...] = ()


Rule = Callable[[Array, Moment], Array]


def deadzone(data: Array, now: Moment) -> Array:
    """Command u becomes sign(u) max(|u| - width, 0); data: width."""
    return np.sign(now.value) * np.maximum(np.abs(now.value) - data[..., 0], 0.0)


def sensor_bias(data: Array, now: Moment) -> Array:
    """Reading plus a constant; data: bias."""
    return now.value + data[..., 0]


def sensor_gain(data: Array, now: Moment) -> Array:
    """Reading times a factor; data: gain."""
    return now.value * data[..., 0]


def sensor_eccentric(data: Array, now: Moment) -> Array:
    """Reading y + sine sin(a) + cosine cos(a), a = 2 pi y / wavelength; data: these three numbers."""
    angle = 2 * np.pi * now.value / data[..., 2]
    return np.asarray(now.value + data[..., 0] * np.sin(angle) + data[..., 1] * np.cos(angle))


def lag(data: Array, now: Moment) -> Array:
    """The reading that a lag settles at, the input itself (`Physics.sense` keeps time); data: time constant > 0."""
    return now.value + 0.0 * data[..., 0]


def friction_along(data: Array, now: Moment) -> Array:
    """Dry friction interpolated over position; data: first and last position, then levels at equal distances."""
    first, last = data[..., 0], data[..., 1]
    return np.maximum(_tabulated(data[..., 2:], (now.position - first) / (last - first)), 0.0)


def friction_over_time(data: Array, now: Moment) -> Array:
    """Dry friction interpolated over time; data: first and last time, then levels at equal distances."""
    first, last = data[..., 0], data[..., 1]
    return np.maximum(_tabulated(data[..., 2:], (now.time - first) / (last - first)), 0.0)


def _tabulated(table: Array, share: Array) -> Array:
    """A table (..., k) of equal distances at a share of its length; beyond its ends it goes on as it ends."""
    if not isinstance(table, np.ndarray):  # of the engine, which writes code for it
        return table.at(share)
    last = table.shape[-1] - 1
    along = np.clip(share * last, 0.0, last)
    # Not a number of a simulation that diverged; `along` hands it on.
    below = np.maximum(np.minimum(np.nan_to_num(along).astype(np.intp), last - 1), 0)
    at = np.take_along_axis(table, below[..., None], -1)[..., 0]
    above = np.take_along_axis(table, below[..., None] + 1, -1)[..., 0]
    return np.asarray(at + (along - below) * (above - at))


def table(data: Array, x: Array) -> Array:
    """A table, piecewise linear and constant outside; data (..., 2 k): its knots, increasing, then its values there."""
    knots, values = np.split(data, 2, axis=-1)
    share = np.clip((np.asarray(x)[..., None] - knots[..., :-1]) / np.diff(knots, axis=-1), 0.0, 1.0)
    return np.asarray(values[..., 0] + np.sum(share * np.diff(values, axis=-1), axis=-1))


def mapped(data: Array, now: Moment) -> Array:
    """A command or reading mapped by a table; data: at least two of them, increasing, then as many that they become.

    Outside the table it becomes as much more or less than the table's end as it is beyond it.
    """
    knots, _ = np.split(data, 2, axis=-1)
    inside = np.clip(now.value, knots[..., 0], knots[..., -1])
    return table(data, inside) + (now.value - inside)


def friction_wave(data: Array, now: Moment) -> Array:
    """Dry friction level + sine sin(a) + cosine cos(a), a = 2 pi q / wavelength; data: these four numbers."""
    angle = 2 * np.pi * now.position / data[..., 3]
    return np.maximum(data[..., 0] + data[..., 1] * np.sin(angle) + data[..., 2] * np.cos(angle), 0.0)


def friction_under_load(data: Array, now: Moment) -> Array:
    """Dry friction level + by_drive |drive| + by_weight |weight|; data: level, by_drive, by_weight."""
    return data[..., 0] + data[..., 1] * np.abs(now.drive) + data[..., 2] * np.abs(now.weight)


def periodic_force(data: Array, now: Moment) -> Array:
    """Amplitude sin(2 pi frequency t + phase); data: amplitude, frequency, phase."""
    return data[..., 0] * np.sin(2 * np.pi * data[..., 1] * now.time + data[..., 2])


def pulse_force(data: Array, now: Moment) -> Array:
    """A constant force from start on for a duration; data: force, start, duration."""
    over = now.time - data[..., 1] >= data[..., 2]
    return np.where(now.time >= data[..., 1], np.where(over, 0.0, data[..., 0]), 0.0)


def force_of(data: Array, now: Moment) -> Array:
    """A force interpolated over one or two inputs; data: speed, counts of both knots, knots of each, levels.

    Each knot of the first input has a row of levels over the second; without a second that has one knot, 0. Beyond its
    ends a table goes on as it ends. A force along the motion fades where the joint is faster than that speed, the
    largest in the data: it cannot drive it on for ever.
    """
    first, second = now.inputs
    force = _surface(data[..., 3:], data[..., 1], data[..., 2], first, second)
    fades = np.clip(np.abs(now.speed) / data[..., 0] - 1.0, 0.0, 1.0)
    return np.where(force * now.speed > 0, force * (1.0 - fades), force)


def _surface(data: Array, rows: Array, columns: Array, x: Array, y: Array) -> Array:
    """A table with rows of columns, straight lines between: its knots along both, then its levels.

    The counts are the same in all simulations of a batch.
    """
    if not isinstance(data, np.ndarray):  # of the engine, which writes code for it
        return data.across(rows, columns, x, y)
    m, n = int(np.ravel(rows)[0]), int(np.ravel(columns)[0])
    low, high, up = _between(data[..., :m], x)
    left, right, along = _between(data[..., m : m + n], y)
    levels = data[..., m + n :]
    corners = [_entry(levels, r * n + c) for r in (low, high) for c in (left, right)]
    one, other = (corners[k] + along * (corners[k + 1] - corners[k]) for k in (0, 2))
    return np.asarray(one + up * (other - one))


def _between(knots: Array, x: Array) -> tuple[NDArray[np.intp], NDArray[np.intp], Array]:
    """Entries below and above a number among knots (..., k), and how far between them it is, 0 to 1."""
    last = knots.shape[-1] - 1
    below = np.sum(np.asarray(x)[..., None] >= knots[..., 1:-1], axis=-1) if last else np.zeros(np.shape(x), np.intp)
    above = np.minimum(below + 1, last)
    one, other = _entry(knots, below), _entry(knots, above)
    return below, above, np.clip((x - one) / np.where(last, other - one, 1.0), 0.0, 1.0)


def _entry(table: Array, k: NDArray[np.intp]) -> Array:
    """Entry k (...) of each table (..., n)."""
    whole = np.broadcast_to(table, (*np.shape(k), table.shape[-1]))
    return np.asarray(np.take_along_axis(whole, np.asarray(k)[..., None], -1)[..., 0])


MOST_KNOTS = 256  # of a table in a file
MOST_LEVELS = 4096  # of a surface
MOST_NUMBERS = 3 * MOST_LEVELS  # of any entry
HEAD = 16  # numbers of an entry that say more than one level of a table

_TABLES = frozenset({"motor.map", "sensor.map"})
_EVEN = frozenset({"friction.position", "friction.time"})  # tables of equal distances between two ends
RESIDUAL = "residual.force"  # what a model lacks that has no name: a force of whatever the data say

_rules: dict[str, tuple[Stage, Rule]] = {
    "motor.deadzone": ("command", deadzone),
    "sensor.gain": ("sensor", sensor_gain),
    "sensor.bias": ("sensor", sensor_bias),
    "sensor.eccentric": ("sensor", sensor_eccentric),
    "timing.sensor_lag": ("lag", lag),
    "friction.position": ("friction", friction_along),
    "motor.map": ("command", mapped),
    "sensor.map": ("sensor", mapped),
    "friction.time": ("friction", friction_over_time),
    "friction.wave": ("friction", friction_wave),
    "friction.load": ("friction", friction_under_load),
    "disturbance.periodic": ("force", periodic_force),
    "disturbance.pulse": ("force", pulse_force),
    RESIDUAL: ("force", force_of),
}


def register(effect: str, stage: Stage, rule: Rule) -> None:
    """Make the loader understand a further effect.

    Args:
        effect: its id, as in `dipc_gym:EFFECT:PLACE`.
        stage: where it acts.
        rule: `rule(data, moment)`; for `command` and `sensor` the new value, for `friction` the level of dry friction,
            for `force` the force to add.

    Raises:
        ValueError: the id is taken.
    """
    if effect in _rules:
        raise ValueError(f"an effect {effect!r} is registered already")
    _rules[effect] = (stage, rule)


def rules() -> list[tuple[str, Stage, Rule]]:
    """Every effect that the loader understands: id, stage, rule."""
    return [(effect, stage, rule) for effect, (stage, rule) in _rules.items()]


@dataclass(frozen=True)
class Extra:
    """One entry of `<custom>`: a rule, the place it acts at, and its numbers.

    Attributes:
        effect: id of the effect.
        at: name of the actuator, sensor or joint.
        stage: where it acts.
        index: the control, sensor address or degree of freedom.
        data: the numbers, (k,), or (n, k) for n simulations.
        inputs: of a law that depends on more than its place: `position`, `velocity` or `command`, and the index of the
            coordinate, the degree of freedom or the control.
    """

    effect: str
    at: str
    stage: Stage
    index: int
    data: Array
    inputs: tuple[tuple[str, int], ...] = ()

    def __call__(self, now: Moment) -> Array:
        """Apply the rule."""
        return _rules[self.effect][1](self.data, now)


@dataclass(frozen=True)
class Physics:
    """A compiled model with what MJCF cannot say.

    Attributes:
        model: the MuJoCo model.
        extras: effects that stock MuJoCo leaves out, in the order of the file.

    Example:
        >>> physics = from_model(mjcf.compile(
        ...     '<mujoco><worldbody><body><joint name="a"/><geom size="1"/></body></worldbody></mujoco>'))
        >>> data = mujoco.MjData(physics.model)
        >>> physics.step(data, np.zeros(0), 5)
        >>> round(data.time, 3)
        0.01
    """

    model: mujoco.MjModel
    extras: tuple[Extra, ...] = ()

    def stage(self, stage: Stage) -> tuple[Extra, ...]:
        """The extras that act at one stage."""
        return tuple(extra for extra in self.extras if extra.stage == stage)

    @property
    def acts(self) -> bool:
        """Whether friction or forces have to be written at each step."""
        return any(extra.stage in ("friction", "force") for extra in self.extras)

    @property
    def pressed(self) -> bool:
        """Whether dry friction may depend on the forces at its joint, and not on where it is alone."""
        alone = (friction_along, friction_over_time, friction_wave)
        return any(extra.stage == "friction" and _rules[extra.effect][1] not in alone for extra in self.extras)

    def command(self, ctrl: Array, time: Array | float = 0.0) -> Array:
        """The command that the model sees for a command (..., nu) sent to the rig."""
        changed = ctrl
        for extra in self.stage("command"):
            if changed is ctrl:
                changed = np.array(ctrl, dtype=float)
            changed[..., extra.index] = extra(_moment(time, value=changed[..., extra.index]))
        return changed

    def sense(self, sensordata: Array, memory: Array | None = None, dt: float = 0.0) -> Array:
        """What the rig's sensors say where the model's say `sensordata` (..., nsensordata).

        Args:
            sensordata: the model's readings.
            memory: what `sensor_memory` returned, updated in place; None where no sensor lags.
            dt: time since the last call with this memory, s.
        """
        read = sensordata
        for extra in self.extras:
            if extra.stage not in ("sensor", "lag"):
                continue
            if read is sensordata:
                read = np.array(sensordata, dtype=float)
            i = extra.index
            if extra.stage == "sensor":
                read[..., i] = extra(_moment(0.0, value=read[..., i]))
            elif memory is not None and dt > 0:
                given = read[..., i].copy()
                read[..., i] = _follow(memory[0][..., i], memory[1][..., i], given, dt, extra.data[..., 0])
                memory[0][..., i], memory[1][..., i] = given, read[..., i]
        return read

    def sensor_memory(self, sensordata: Array) -> Array | None:
        """Memory (2, ..., nsensordata) of lagging sensors at rest at these readings; None if no sensor lags."""
        return np.stack([sensordata, sensordata]) if self.stage("lag") else None

    def act(self, state: Any, frictionloss: Array, applied: Array, step: float = 0.0) -> None:
        """Write friction and forces of this moment, or of a step that begins now.

        They are held over the step, so they are those of its middle: held from its beginning, a force that depends on
        time would come half a step late.

        Args:
            state: an `MjData`, a `mujoco.batch.Batch` with bound fields (n, ...), or what has such fields.
            frictionloss: where dry friction goes, (..., nv).
            applied: where generalised forces go, (..., nv).
            step: s.
        """
        pushed: set[int] = set()
        for extra in self.extras:
            if extra.stage == "friction":
                j = extra.index
                drive, weight = state.qfrc_actuator[..., j], state.qfrc_bias[..., j]
                q = state.qpos[..., self.model.jnt_qposadr[self.model.dof_jntid[j]]]
                q = q + step / 2 * state.qvel[..., j]
                frictionloss[..., j] = extra(_moment(state.time + step / 2, q, drive, weight))
            elif extra.stage == "force":
                # What was applied in the step before still stands there, so the first one replaces it.
                others = applied[..., extra.index] if extra.index in pushed else 0.0
                now = _moment(state.time + step / 2)
                if extra.inputs:
                    now = replace(now, speed=state.qvel[..., extra.index], inputs=self._seen(extra, state, step))
                applied[..., extra.index] = others + extra(now)
                pushed.add(extra.index)

    def _seen(self, extra: Extra, state: mujoco.MjData, step: float) -> tuple[Array, ...]:
        """What a law depends on, two numbers; positions are those of the middle of a step that begins now."""
        seen = []
        for kind, k in extra.inputs:
            if kind == "command":
                seen.append(state.ctrl[..., k])
            elif kind == "velocity":
                seen.append(state.qvel[..., k])
            else:
                joint = int(np.flatnonzero(self.model.jnt_qposadr == k)[0])
                seen.append(state.qpos[..., k] + step / 2 * state.qvel[..., self.model.jnt_dofadr[joint]])
        return (*seen, np.zeros_like(seen[0])) if len(seen) == 1 else tuple(seen)

    def step(self, data: mujoco.MjData, ctrl: Array, nstep: int = 1) -> None:
        """Advance one simulation by `nstep` steps under a held command (nu,)."""
        data.ctrl[:] = self.command(ctrl, data.time)
        if not self.acts:
            mujoco.mj_step(self.model, data, nstep)
            return
        for _ in range(nstep):
            self.act(data, self.model.dof_frictionloss, data.qfrc_applied, self.model.opt.timestep)
            mujoco.mj_step(self.model, data)


def _follow(before: Array, followed: Array, after: Array, dt: float, tau: Array) -> Array:
    """A first-order lag over one interval in which its input goes straight from `before` to `after`."""
    decay = np.exp(-dt / tau)
    slope = (after - before) / dt
    return decay * followed + (after - tau * slope) - decay * (before - tau * slope)


def _moment(
    time: Array | float,
    position: Array | float = 0.0,
    drive: Array | float = 0.0,
    weight: Array | float = 0.0,
    value: Array | float = 0.0,
) -> Moment:
    numbers = [np.asarray(x) for x in (time, position, drive, weight, value)]
    return Moment(numbers[0], numbers[1], numbers[2], numbers[3], numbers[4])


def load(source: mjcf.Source | str | Path) -> Physics:
    """Read a model together with the physics that MJCF cannot say.

    Args:
        source: a path, MJCF text, or a scanned source.

    Raises:
        mjcf.MjcfError: the model is refused or does not compile, or an entry of `<custom>` is not understood.
    """
    source = mjcf.as_source(source)
    return from_model(mjcf.compile(source), source.name)


def from_model(model: mujoco.MjModel, name: str = "the model") -> Physics:
    """The physics of a compiled model, its `<custom>` entries included.

    Args:
        model: compiled.
        name: what messages call it, as its file.

    Raises:
        mjcf.MjcfError: an entry names an unknown effect or place, or has the wrong count of numbers.
    """
    try:
        return Physics(model, tuple(_extras(model)))
    except mjcf.MjcfError as error:
        raise mjcf.MjcfError(f"{name}: {error}") from None


def _extras(model: mujoco.MjModel) -> list[Extra]:
    extras = []
    for i in range(model.nnumeric):
        name = model.numeric(i).name
        if not name.startswith(mjcf.PREFIX + ":"):
            continue
        parts = name.split(":", 2)
        if len(parts) != 3 or parts[1] not in _rules:
            near = suggestion(parts[1] if len(parts) > 1 else "", _rules)
            raise mjcf.MjcfError(f"<custom> entry {name!r}: known effects are {', '.join(sorted(_rules))}{near}")
        stage = _rules[parts[1]][0]
        index, inputs = _index(model, name, stage, parts[2]), _inputs(model, parts[1], parts[2])
        extras.append(Extra(parts[1], parts[2], stage, index, model.numeric(i).data.copy(), inputs))
    for extra in extras:
        if not _usable(extra):
            entry, rule = f"{mjcf.PREFIX}:{extra.effect}:{extra.at}", (_rules[extra.effect][1].__doc__ or "").strip()
            raise mjcf.MjcfError(
                f"<custom> entry '{entry}' has the numbers {_shown(extra.data)}, too few, too many or out of range"
                f"{_fault(extra)}; {rule.partition(chr(10))[0]}"
            )
    return extras


def _shown(numbers: Array) -> str:
    """Numbers of an entry, the first of many."""
    more = f", and {len(numbers) - HEAD:,} more" if len(numbers) > HEAD else ""
    return f"{numbers[:HEAD].tolist()}{more}"


def _fault(extra: Extra) -> str:
    """What is wrong with the numbers of an entry, where one thing can be told; begins with a colon."""
    numbers = extra.data
    if len(numbers) > MOST_NUMBERS:
        return f": {len(numbers):,} numbers, more than {MOST_NUMBERS:,}"
    wild = np.flatnonzero(~(np.abs(numbers) <= LARGEST))
    if len(wild):
        return f": number {wild[0] + 1} is {numbers[wild[0]]:g}"
    if extra.effect in _TABLES and len(numbers) % 2 == 0 and not _increase(numbers[: len(numbers) // 2]):
        return ": its knots do not increase"
    if extra.effect in _EVEN and len(numbers) > 1 and not _increase(numbers[:2]):
        return f": it goes from {numbers[0]:g} to {numbers[1]:g}"
    if extra.effect != RESIDUAL or len(numbers) < 3 or not np.all(numbers[1:3] == np.round(numbers[1:3])):
        return ""
    m, n = int(numbers[1]), int(numbers[2])
    if numbers[0] <= 0:
        return f": its speed is {numbers[0]:g}, and must be positive"
    if m * n > MOST_LEVELS:
        return f": a table of {m} x {n} is {m * n:,} levels, more than {MOST_LEVELS:,}"
    if len(numbers) != 3 + m + n + m * n:
        return f": a table of {m} x {n} has {3 + m + n + m * n} numbers, not {len(numbers)}"
    if not (_increase(numbers[3 : 3 + m]) and _increase(numbers[3 + m : 3 + m + n])):
        return ": its knots do not increase"
    return ": what it depends on is not said" if not extra.inputs else ""


def _increase(knots: Array) -> bool:
    """Whether knots increase by steps that numbers of their size can tell, and that can be divided by."""
    return bool(np.all(np.diff(knots) > CLOSEST * np.maximum(1.0, np.abs(knots[1:]))))


def _usable(extra: Extra) -> bool:
    """Whether an entry's numbers give numbers, wherever a joint is and whenever it is."""
    numbers = extra.data
    if not (0 < len(numbers) <= MOST_NUMBERS and np.all(np.abs(numbers) <= LARGEST)):
        return False
    if extra.stage == "lag" and not SHORTEST_LAG <= numbers[0] <= LONGEST_LAG:
        return False
    if extra.effect in _TABLES:
        knots = numbers[: len(numbers) // 2]
        if len(numbers) % 2 or not 2 <= len(knots) <= MOST_KNOTS or not _increase(knots):
            return False
    if extra.effect in _EVEN and not _increase(numbers[:2]):
        return False
    if extra.effect == RESIDUAL and not _is_surface(extra):
        return False
    # At its own numbers as positions a table of no length shows itself, and a wave of none a little further on. Levels
    # of a table are bounded by now, and so is what lies between two of them.
    usual = np.unique([*numbers[:HEAD], numbers.min(), numbers.max(), *TRIED])
    try:
        with np.errstate(all="ignore"):
            near, far = _alike(extra, usual), _alike(extra, np.array(OUTERMOST))
        return bool(np.all(np.abs(near) <= LARGEST**2) and np.all(np.isfinite(far)))
    except (IndexError, ValueError):
        return False


def _alike(extra: Extra, x: Array) -> Array:
    """What comes of an entry where position, force, command, time and all else are the same number of x (n,)."""
    everywhere = replace(extra, data=np.broadcast_to(extra.data, (len(x), len(extra.data))))
    return everywhere(replace(_moment(np.abs(x), x, x, x, x), speed=x, inputs=(x, x)))


def _is_surface(extra: Extra) -> bool:
    """Whether the numbers of a residual law are those of one, and what it depends on is said."""
    head, remainder = extra.data[:3], extra.data[3:]
    if len(head) < 3 or not 1 <= len(extra.inputs) <= 2 or head[0] <= 0:
        return False
    if not (np.all(head[1:] == np.round(head[1:])) and head[1] >= 2 and len(extra.inputs) <= head[2] <= MOST_LEVELS):
        return False
    m, n = int(head[1]), int(head[2])
    sorted_ = _increase(remainder[:m]) and _increase(remainder[m : m + n])
    return bool(m * n <= MOST_LEVELS and len(remainder) == m + n + m * n and sorted_)


def _inputs(model: mujoco.MjModel, effect: str, at: str) -> tuple[tuple[str, int], ...]:
    """What a law depends on beyond its place, as `<text>` of `<custom>` names it."""
    if effect != RESIDUAL:
        return ()
    texts = mjcf.texts(model)
    joints = {model.joint(j).name: j for j in range(model.njnt)}
    commands = {control: k for k, control in enumerate(mjcf.controls(model))}
    found = []
    for name in (f"{mjcf.INPUTS}{k}:{effect}:{at}" for k in (1, 2)):
        if name not in texts:
            break
        kind, _, of = texts[name].partition(" ")
        known = {"position": joints, "velocity": joints, "command": commands}.get(kind)
        if known is None or of not in known:
            what = f"{', '.join(known)}{suggestion(of, known)}" if known else "position, velocity and command"
            raise mjcf.MjcfError(f"<custom> entry {name!r}: no {texts[name]!r} in the model; there are {what}")
        address = {"position": model.jnt_qposadr, "velocity": model.jnt_dofadr}.get(kind)
        found.append((kind, known[of] if address is None else int(address[known[of]])))
    return tuple(found)


def _index(model: mujoco.MjModel, name: str, stage: Stage, at: str) -> int:
    known: Mapping[str, int]
    if stage == "command":
        known = {control: i for i, control in enumerate(mjcf.controls(model))}
    elif stage in ("sensor", "lag"):
        addresses = mjcf.sensor_addresses(model)
        known = {sensor: int(a) for sensor, a in zip(mjcf.scalar_sensors(model), addresses, strict=True)}
    else:
        known = {model.joint(j).name: int(model.jnt_dofadr[j]) for j in range(model.njnt)}
    if at not in known:
        there_are = f"there are {', '.join(known)}{suggestion(at, known)}"
        raise mjcf.MjcfError(f"<custom> entry {name!r}: no {at!r} in the model; {there_are}")
    return known[at]


def stack(variants: Sequence[Physics], which: NDArray[np.intp]) -> Physics:
    """One physics for a batch whose simulation i follows variant `which[i]`.

    Args:
        variants: the same model and effects with different numbers.
        which: (n,) index into `variants`.

    Returns:
        Physics whose extras hold (n, k) numbers; its model is the first variant's.
    """
    first = variants[0]
    extras = tuple(
        replace(extra, data=np.stack([variant.extras[i].data for variant in variants])[which])
        for i, extra in enumerate(first.extras)
    )
    return Physics(first.model, extras)
