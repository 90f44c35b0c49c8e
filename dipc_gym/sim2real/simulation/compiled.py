"""Windows through the engine: what `simulate` asks of it, and exact derivatives besides."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from numpy.typing import NDArray

from dipc_gym import mjcf
from dipc_gym.engine import Uncovered, program
from dipc_gym.engine.check import check
from dipc_gym.engine.constraints import stiff_limits
from dipc_gym.engine.layout import Head, Sensor
from dipc_gym.engine.rigid import GEOMETRY, GRAVITY, LINK
from dipc_gym.engine.run import Commands, Directions, Jobs, differentiate, run
from dipc_gym.physics import Moment, Physics
from dipc_gym.recording import Recording
from dipc_gym.sim2real.simulation.commands import changed_by
from dipc_gym.sim2real.simulation.memory import Joints, Places, begin, forget, remembering
from dipc_gym.sim2real.simulation.motion import initial_states

if TYPE_CHECKING:
    from dipc_gym.sim2real.simulation.windows import Windows

Array = NDArray[np.float64]

BESIDE = 2.0**-20  # of a reading, to where a sensor's map is asked for its slope
MOMENTS = 200  # of each recording, at which it is asked where a window would begin
NEAR = 0.02  # of a joint's range: a motion that keeps this far from its ends tells nothing of its limits

_checked: set[bytes] = set()


@dataclass(frozen=True)
class Compiled:
    """Windows and variants as the engine takes them.

    Attributes:
        variants: models of one structure.
        windows: what to predict.
        base: names of the joints that initial states describe.
        step: longest step, s.
        program: of the structure.
        parameters: of the variants, (variants, k).
    """

    variants: tuple[Physics, ...]
    windows: Windows
    base: tuple[str, ...]
    step: float
    program: program.Program
    parameters: Array

    @property
    def model(self) -> mujoco.MjModel:
        """The first variant's model."""
        return self.variants[0].model

    @property
    def _lags(self) -> list[tuple[int, int, list[int], Array]]:
        """Sensor and state of each lag, the states whose sum it reads, and their weights, which no variant changes."""
        codes = self.program.codes
        first = int(codes[Head.SENSOR_AT])
        sensors = codes[first : first + int(codes[Head.SENSORS]) * int(Sensor.SIZE)].reshape(-1, int(Sensor.SIZE))
        lags = []
        for k in np.flatnonzero(sensors[:, Sensor.LAG] >= 0):
            one = sensors[k]
            at, terms, weights = int(one[Sensor.TERM_AT]), int(one[Sensor.TERMS]), int(one[Sensor.NUMBERS])
            states = codes[at : at + terms].tolist()
            lags.append((int(k), int(one[Sensor.LAG]), states, self.parameters[0, weights : weights + terms]))
        return lags

    @property
    def _yielding(self) -> list[tuple[int, int]]:
        """State that holds at which length each spring that yields is unbent, and its tendon."""
        first = 2 * self.model.nv + self.model.na
        return [(first + k, tendon) for k, tendon in enumerate(mjcf.yielding(self.model))]

    def commands(self, warm: float) -> Commands:
        """Recorded commands as the model sees them, where windows and `warm` seconds before them ask for them; one set
        if no variant changes them.
        """
        time, whole = _end_to_end(self.windows.recordings)
        if not self.variants[0].stage("command"):
            return Commands(time, whole[None])
        first, count = self._samples(-warm, warm + self.sampled()[1])
        asked = np.zeros(len(time) + 1, dtype=int)
        np.add.at(asked, first, 1)
        np.add.at(asked, first + count, -1)
        asked = np.cumsum(asked[:-1]) > 0
        made: dict[bytes, Array] = {}
        for variant in self.variants:
            key = changed_by(variant)
            if key not in made:
                made[key] = np.zeros_like(whole)
                made[key][asked] = variant.command(whole[asked], time[asked])
        return Commands(time, np.stack([made[changed_by(variant)] for variant in self.variants]))

    def jobs(self, at: float, length: Array, times: Array, initial: Array, commands: Commands) -> Jobs:
        """Simulations of every window from `at` seconds after its start on.

        Args:
            at: s.
            length: to simulate, s, (windows,).
            times: at which sensors are read after that, (windows, sensors, samples).
            initial: states, (variants, windows, nx).
            commands: of all recordings.
        """
        clock = self.windows.start + at
        first, count = self._samples(at, length)
        sets = np.arange(len(initial)) if len(commands.values) > 1 else np.zeros(len(initial), dtype=np.int64)
        parameters = self.parameters[: len(initial)]
        return Jobs(parameters, initial, clock, first, count, commands, sets, times, length, self._limits_matter)

    def _samples(self, at: float, length: Array) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """First of the commands that act in each window from `at` seconds after its start on, and how many, (windows,).

        All recordings are counted through.
        """
        windows = self.windows
        clock, most = windows.start + at, float(self._delays.max(initial=0.0))
        first, count = np.zeros((2, len(windows)), dtype=np.int64)
        begin = 0
        for i, recording in enumerate(windows.recordings):
            mine = windows.source == i
            early = np.searchsorted(recording.time, clock[mine] - most - 1e-6, side="right") - 1
            early = np.maximum(early, 0)
            late = np.searchsorted(recording.time, clock[mine] + length[mine] + 1e-6, side="right") + 1
            first[mine] = begin + early
            count[mine] = np.minimum(late, len(recording.time)) - early
            begin += len(recording.time)
        return first, count

    @property
    def _limits_matter(self) -> bool:
        """Whether a joint comes near its limits in the recordings; else only what is far off meets them."""
        model, windows = self.model, self.windows
        limited = np.flatnonzero(stiff_limits(model))
        moved = [model.joint(name).id for name in self.base]
        if not windows.motions or not set(limited.tolist()) <= set(moved):
            return bool(len(limited))
        for joint in limited:
            low, high = model.jnt_range[joint]
            beside = model.jnt_margin[joint] + NEAR * (high - low)
            for motion in windows.motions:
                position = motion.position[:, moved.index(joint)]
                if position.min() < low + beside or position.max() > high - beside:
                    return True
        return False

    @property
    def _delays(self) -> Array:
        """Delay of each control, s, (variants, nu)."""
        codes = self.program.codes
        return self.parameters[:, codes[Head.DELAYS] : codes[Head.DELAYS] + codes[Head.CONTROLS]]

    def _places(self, states: Array) -> Places:
        """Where states (..., nx) hold what windows begin with."""
        nv, na = self.model.nv, self.model.na
        unbent = [states[..., state, None] for state, _ in self._yielding]
        first = 2 * nv + na + len(unbent)
        remembered = [states[..., first + k] for k in range(len(self.variants[0].remembering))]
        return Places(states[..., :nv], states[..., nv : 2 * nv], states[..., 2 * nv : 2 * nv + na], unbent, remembered)

    def begun(self, at: float, initial: Array) -> Array:
        """States (variants, windows, nx) that begin at positions and velocities of base joints (variants, n, 2 nb)."""
        states = np.zeros((len(self.variants), len(self.windows), self.program.nx))
        time = self.windows.start + at - self.windows.late
        begin(self._places(states), initial, self.variants, self.windows, self.base, self._delays, time)
        for _, lag, read, weights in self._lags:
            states[..., lag] = states[..., read] @ weights
        return states

    def put_back(self, states: Array, initial: Array, at: float = 0.0) -> Array:
        """States (..., windows, nx) with base joints at positions and velocities (..., windows, 2 nb), `at` seconds
        after each window's start.

        What follows them keeps its place relative to them, or is where they are if the recording begins only then;
        springs that yield stay as bent as they are, and what a sensor remembers moves along. All of it is linear, so
        tangents are put back in the same way.
        """
        n, out = self.model.nv, states.copy()
        places = self._places(out)
        places.put(Joints.of(self.model, self.base), initial, self.windows.after_the_first(at)[:, None])
        places.stay_bent(self.model, out[..., :n] - states[..., :n])
        for _, lag, read, weights in self._lags:
            out[..., lag] += (out[..., read] - states[..., read]) @ weights
        return out

    def forget(self, states: Array, initial: Array) -> None:
        """Let windows with which a recording begins remember nothing, in states (variants, windows, nx) that were run
        in.
        """
        forget(self._places(states), initial, self.variants, self.windows, self.base, self._delays)

    def forget_changes(self, tangents: Array) -> None:
        """The same for tangents (..., windows, nx): what is not bent goes with the joints, and all else is nothing."""
        first = ~self.windows.after_the_first(0.0)
        if not first.any() or not self._places(tangents).memories:
            return
        anew = tangents[..., first, :]
        places = self._places(anew)
        for memory in places.memories:
            memory[:] = 0.0
        places.stay_bent(self.model, anew[..., : self.model.nv])
        tangents[..., first, :] = anew

    def as_read(self, states: Array) -> Array:
        """States (..., windows, nx) where windows begin, with lagging sensors near what they read there."""
        out = states.copy()
        if not self.variants[0].stage("sensor") and not self.parameters[:, self.program.codes[Head.LATE]].any():
            for sensor, lag, _, _ in self._lags:
                out[..., lag] = self.windows.as_read(sensor, states[..., lag])
        return out

    def sampled(self) -> tuple[Array, Array]:
        """Sample times of every sensor (windows, sensors, samples), and how long windows are simulated for them."""
        windows, count = self.windows, len(self.program.sensors)
        times = np.repeat(windows.times[:, None], count, axis=1)
        late = self.parameters[:, self.program.codes[Head.LATE]].max()
        return times, windows.times.max(axis=1) + late

    def sensed(self, readings: Array, variant: Physics) -> Array:
        """What the rig's sensors say where the model's say `readings` (..., sensors, samples)."""
        address = mjcf.sensor_addresses(self.model).tolist()
        out = readings
        for extra in variant.stage("sensor"):
            if out is readings:
                out = readings.copy()
            k, zero = address.index(extra.index), np.zeros(())
            out[..., k, :] = extra(Moment(zero, zero, zero, zero, out[..., k, :]))
        return out


@functools.lru_cache(maxsize=4)  # those of a diagnosis, and of what it holds out
def _end_to_end(recordings: tuple[Recording, ...]) -> tuple[Array, Array]:
    """Stamps (n,) and commands (n, nu) of all recordings; every simulation asks for them."""
    return np.concatenate([r.time for r in recordings]), np.concatenate([r.commands for r in recordings])


def compiled(variants: Sequence[Physics], windows: Windows, base: Sequence[str], step: float) -> Compiled:
    """Windows and variants for the engine.

    Raises:
        Uncovered: the engine does not simulate something in the model, or it is not what MuJoCo makes of it.
    """
    what, parameters = _read_and_checked(variants)
    return Compiled(tuple(variants), windows, tuple(base), step, what, parameters)


def _read_and_checked(variants: Sequence[Physics]) -> tuple[program.Program, Array]:
    """A program that MuJoCo agrees with, and its parameters; each program is compared once."""
    what, parameters = program.read(variants)
    key = repr(what.tree).encode() + what.codes.tobytes()
    if key not in _checked and check(what, parameters[0], variants[0]):
        _checked.add(key)
    return what, parameters


def left_to_mujoco(source: Physics) -> list[str]:
    """A sentence if a model is simulated by MuJoCo because the engine does not cover it."""
    try:
        _read_and_checked([source])
    except Uncovered as reason:
        return [f"MuJoCo simulates this model, which takes longer, for the engine does not cover it: {reason}."]
    return []


def predicted(
    of: Compiled,
    initial: Array,
    which: NDArray[np.intp],
    warm: float,
    approach: Array | None,
    threads: int,
    *,
    as_read: bool,
) -> Array:
    """Readings (rows, windows, samples, sensors) of several rows.

    Args:
        of: distinct variants and windows.
        initial: positions and velocities of the base joints, (rows, windows, 2 nb).
        which: variant of each row, (rows,).
        warm: s simulated before each window.
        approach: as `initial`, at the first of so many equal stretches of these, and of all others, (k, windows, 2 nb).
        threads: 0 for all cores.
        as_read: see `batch.simulate`.
    """
    commands = of.commands(warm)
    rows = replace(of, variants=tuple(of.variants[k] for k in which), parameters=of.parameters[which])
    if warm > 0:
        assert approach is not None
        nothing = np.zeros((len(of.windows), len(of.program.sensors), 0))
        stretch, far = warm / len(approach), np.repeat(approach[:, None], len(of.variants), axis=1)
        states = of.begun(-warm, far[0])
        for k, there in enumerate(far):
            at = k * stretch - warm
            if k:
                states = of.put_back(states, there, at)
            jobs = of.jobs(at, np.full(len(of.windows), stretch), nothing, states, commands)
            _, states = run(of.program, jobs, of.step, threads=threads)
        states = of.put_back(states[which], initial)
        rows.forget(states, initial)
        states = of.as_read(states) if as_read else states
    else:
        states = rows.begun(0.0, initial)
    times, length = of.sampled()
    jobs = rows.jobs(0.0, length, times, states, commands)
    if len(commands.values) > 1:
        jobs = replace(jobs, which=which.astype(np.int64))
    readings, _ = run(of.program, jobs, of.step, threads=threads)
    said = np.stack([of.sensed(one, of.variants[k]) for one, k in zip(readings, which, strict=True)])
    return np.ascontiguousarray(np.swapaxes(said, 2, 3))


def changes(of: Compiled, steps: Array) -> Array:
    """How a program's parameters change with those of a hypothesis, (p, k).

    Args:
        of: a variant, and for each parameter one in which it is a little larger.
        steps: by how much, (p,).
    """
    return np.asarray((of.parameters[1:] - of.parameters[0]) / steps[:, None])


def begins_alike(of: Compiled) -> NDArray[np.bool_]:
    """Which variants begin at the states of the first wherever in the recordings a window begins, (variants,).

    Asked all along them, for what these windows show nothing of, others may remember.
    """
    windows = of.windows
    if not remembering(of.variants[0]):
        return np.ones(len(of.variants), dtype=bool)
    if not windows.motions:  # whoever simulates is told that these are missing
        return np.zeros(len(of.variants), dtype=bool)
    time = np.concatenate([np.linspace(m.time[0], m.time[-1], MOMENTS) for m in windows.motions])
    source = np.repeat(np.arange(len(windows.motions)), MOMENTS)
    initial = initial_states(windows.motions, source, time)
    everywhere = replace(of, windows=replace(windows, source=source, start=time))
    begun = everywhere.begun(0.0, np.broadcast_to(initial, (len(of.variants), *initial.shape)))
    return np.asarray(np.all(begun == begun[0], axis=(1, 2)))


def derivatives(
    of: Compiled,
    change: Array,
    steps: Array,
    apart: NDArray[np.intp],
    initial: Array,
    warm: float,
    approach: Array | None,
    threads: int,
) -> tuple[Array, Array, Array]:
    """Readings of the first variant and how they change with parameters and initial states.

    Args:
        of: the variant itself, and those in which a parameter is a little larger that changes more than the program's
            parameters: commands, readings, or where simulations begin.
        change: of the program's parameters with each parameter, (p, k).
        steps: by how much parameters are larger in the other variants, (p,).
        apart: variant of each parameter, 0 where it has none, (p,).
        initial: positions and velocities of the base joints, (windows, 2 nb).
        warm: s simulated before each window.
        approach: see `predicted`.
        threads: 0 for all cores.

    Returns:
        Readings (windows, samples, sensors), their change per unit of each parameter (p, ...), and per unit of each
        initial state (2 nb, ...).

    Raises:
        Uncovered: a parameter changes the geometry, whose derivatives the engine leaves out.
    """
    count, nb2 = len(change), initial.shape[1]
    links = change[:, GRAVITY : of.program.tree.count].reshape(count, len(of.program.tree.parents), LINK)
    if links[..., :GEOMETRY].any():
        raise Uncovered("derivatives by the geometry of joints")
    commands = of.commands(warm)
    beside = np.flatnonzero(apart)
    along = np.zeros((count + nb2, of.parameters.shape[1]))
    along[:count] = change
    along_commands = Directions(along, np.zeros(0))
    if len(commands.values) > 1:
        moved = (commands.values[apart[beside]] - commands.values[0]) / steps[beside, None, None]
        along_commands = replace(along_commands, commanding=beside, commands=moved)
    one = replace(of, variants=of.variants[:1], parameters=of.parameters[:1])
    commands = Commands(commands.stamps, commands.values[:1])
    unit = np.zeros((count + nb2, *initial.shape))
    unit[count:] = np.eye(nb2)[:, None, :]

    def begin_changes(begun: Array) -> Array:
        """Change of the states that simulations begin at in every direction, from those of all variants."""
        out = np.zeros((count + nb2, *begun.shape[1:]))
        out[beside] = (begun[apart[beside]] - begun[0]) / steps[beside, None, None]
        return out

    if warm > 0:
        assert approach is not None
        nothing = np.zeros((len(of.windows), len(of.program.sensors), 0))
        stretch = warm / len(approach)
        begun = of.begun(-warm, np.broadcast_to(approach[0], (len(of.variants), *initial.shape)))
        states, tangents = begun[0], begin_changes(begun)[:count]
        for k, there in enumerate(approach):
            at, still = k * stretch - warm, np.zeros((count, *there.shape))
            if k:
                states, tangents = of.put_back(states, there, at), of.put_back(tangents, still, at)
            jobs = one.jobs(at, np.full(len(of.windows), stretch), nothing, states[None], commands)
            before = replace(along_commands, parameters=change, initial=tangents)
            _, _, states, tangents = differentiate(of.program, jobs, before, of.step, threads=threads)
        tangents = np.concatenate([tangents, np.zeros((nb2, *tangents.shape[1:]))])
        moved, tangents = of.put_back(states, initial), of.put_back(tangents, unit)
        one.forget(moved[None], initial[None])
        one.forget_changes(tangents)
        states = of.as_read(moved)
        tangents = np.where(states == moved, tangents, 0.0)
    else:
        begun = of.begun(0.0, np.broadcast_to(initial, (len(of.variants), *initial.shape)))
        states, tangents = begun[0], begin_changes(begun)
        tangents[count:] = of.put_back(tangents[count:], unit[count:])
    times, length = of.sampled()
    jobs = one.jobs(0.0, length, times, states[None], commands)
    readings, changes, _, _ = differentiate(
        of.program, jobs, replace(along_commands, initial=tangents), of.step, threads=threads
    )
    said = of.sensed(readings, of.variants[0])
    if of.variants[0].stage("sensor"):
        # A map of one reading: its slope, and what the parameters change in it.
        higher, lower = (of.sensed(readings + move, of.variants[0]) for move in (BESIDE, -BESIDE))
        slope = ((higher - lower) / (2 * BESIDE))[None]
        changes = slope * changes
        for k in beside.tolist():
            changes[k] += (of.sensed(readings, of.variants[apart[k]]) - said) / steps[k]
    said, changes = np.swapaxes(said, 1, 2), np.swapaxes(changes, 2, 3)
    return np.ascontiguousarray(said), changes[:count], changes[count:]
