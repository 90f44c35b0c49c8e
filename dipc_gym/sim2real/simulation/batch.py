"""Simulate windows of recordings with many variants of a model at once: by the engine, or by MuJoCo's batch.

Everything above this file sees a function from models and initial states to predicted readings. The engine, behind
`compiled`, simulates what it covers under RK4; the rest is left to MuJoCo, here.
"""

from __future__ import annotations

import contextlib
import copy
import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from mujoco import batch as mjbatch
from numpy.typing import NDArray

from dipc_gym import mjcf
from dipc_gym.engine import Uncovered
from dipc_gym.physics import Physics, stack
from dipc_gym.recording.held import held_mean
from dipc_gym.sim2real.simulation.commands import first_moments, per_step
from dipc_gym.sim2real.simulation.compiled import compiled, predicted
from dipc_gym.sim2real.simulation.dry_friction import DryFriction
from dipc_gym.sim2real.simulation.memory import Joints, Places, begin, forget
from dipc_gym.sim2real.simulation.windings import steady_currents
from dipc_gym.sim2real.simulation.windows import Windows

Array = NDArray[np.float64]

# Sizes of buffers that recorded commands do not need: delays are taken out of the model.
_LAYOUT = frozenset({"actuator_history", "actuator_historyadr", "sensor_history", "sensor_historyadr"})

# Default of MuJoCo's solref time constant; shorter ones were chosen with the time step in mind and scale with it.
_SOFT = 0.02


@dataclass(frozen=True)
class Stepping:
    """How finely, and by which rule, a model is simulated.

    Attributes:
        timestep: s; with an integrator the longest, shortened so that a whole number of steps fits one sample.
        integrator: MuJoCo's, or None for the model as its owner runs it: with its own, at this very step, read between
            two steps where a sample lies there. With one of its choice, dry friction is not left to MuJoCo's constraint
            either, but to `dry_friction.DryFriction`, which locates reversals inside the step.
    """

    timestep: float
    integrator: mujoco.mjtIntegrator | None = None

    def on(self, model: mujoco.MjModel, step: float) -> mujoco.MjModel:
        """The model itself, changed: this integrator at a step of `step` seconds, and no restart where it diverges."""
        given = model.opt.timestep
        model.opt.timestep = step
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
        if self.integrator is not None:
            model.opt.integrator = self.integrator
        stiff = is_stiff(model)
        model.dof_solref[stiff, 0] = np.maximum(model.dof_solref[stiff, 0] * step / given, 2 * step)
        return model


def is_stiff(model: mujoco.MjModel) -> NDArray[np.bool_]:
    """Whether the friction of each degree of freedom has a time constant chosen with the time step in mind, (nv,)."""
    return np.asarray((model.dof_solref[:, 0] > 0) & (model.dof_solref[:, 0] < _SOFT))


def grid_step(windows: Windows, stepping: Stepping) -> float:
    """The simulation step, s: the longest within the stepping of which a whole number fits the sample period.

    A model that is simulated as it is keeps its own.
    """
    if stepping.integrator is None:
        return stepping.timestep
    step = windows.period / math.ceil(windows.period / stepping.timestep - 1e-6)
    return stepping.timestep if abs(step / stepping.timestep - 1) < 1e-6 else step  # stamps are rounded


def simulate(
    variants: Sequence[Physics],
    windows: Windows,
    initial: Array,
    stepping: Stepping,
    *,
    base: Sequence[str],
    warm: float = 0.0,
    approach: Array | None = None,
    threads: int = 0,
    as_read: bool = True,
) -> Array:
    """Predict the sensors of every window with every variant.

    Args:
        variants: models of one structure with different parameters.
        windows: what to predict.
        initial: positions and velocities of the base joints at each window's start, (variants or 1, n, 2 nb).
        stepping: integrator and step.
        base: names of the nb joints that `initial` describes; others begin where the joint that they follow does.
        warm: s simulated before each window, so that bristles, currents and gaps reach their state.
        approach: as `initial`, where each of so many equal stretches of that begins, (k, n, 2 nb); needed if `warm` is
            positive. There joints are put back, for a rig that has to be balanced would fall meanwhile.
        threads: for MuJoCo's batch; 0 means all cores.
        as_read: whether lagging sensors begin near what they read, see `Windows.as_read`, and not as far behind as the
            motion before has left them.

    Returns:
        Readings (variants, n, m, ns); huge or not a number from where a simulation diverged.
    """
    initial = np.broadcast_to(initial, (len(variants), len(windows), initial.shape[-1]))
    if stepping.integrator == mujoco.mjtIntegrator.mjINT_RK4:
        distinct, which = _distinct(variants)
        with contextlib.suppress(Uncovered):
            of = compiled(distinct, windows, base, grid_step(windows, stepping))
            return predicted(of, initial, which, warm, approach, threads, as_read=as_read)
    runs = _Runs(variants, windows, stepping, base, threads)
    if warm > 0:
        assert approach is not None
        track = _approached(runs, initial, stepping, warm, approach, threads)
    else:
        track = None
        runs.begin(0, initial)
    return _read(runs, track, as_read=as_read)


def _distinct(variants: Sequence[Physics]) -> tuple[list[Physics], NDArray[np.intp]]:
    """The variants that are not one and the same, and which of them each one is."""
    distinct = list({id(variant): variant for variant in variants}.values())
    return distinct, np.array([next(i for i, one in enumerate(distinct) if one is variant) for variant in variants])


def _approached(
    runs: _Runs, initial: Array, stepping: Stepping, warm: float, approach: Array, threads: int
) -> Array | None:
    """Bring simulations to where their windows begin, through what is before them; how a window is approached does not
    depend on its own start, which fits vary most.

    Args:
        runs: windows with every variant.
        initial: positions and velocities at the windows' starts, (variants, n, 2 nb).
        stepping: see `simulate`, as are the others.
        warm: s.
        approach: (k, n, 2 nb).
        threads: 0 for all cores.

    Returns:
        Readings on the way (sims, steps, nsensordata) where a sensor lags behind them, else None.
    """
    windows, (distinct, which) = runs.windows, _distinct(runs.variants)
    n, alone = len(windows), len(distinct) == len(runs.variants)
    ahead = runs if alone else _Runs(distinct, windows, stepping, runs.names, threads)
    before = math.ceil(warm / runs.step - 1e-9)
    seams = np.linspace(-before, 0, len(approach) + 1).round().astype(int).tolist()
    far, tracks = np.repeat(approach[:, None], len(distinct), axis=1), list[Array]()
    ahead.begin(-before, far[0])
    for k, (since, until) in enumerate(itertools.pairwise(seams)):
        if k:
            ahead.put_back(far[k], since)
        track = ahead.run(since, until - since, record=bool(ahead.physics.stage("lag")))
        tracks += [] if track is None else [track]
    whole = np.concatenate([*tracks, ahead.readings()[:, None]], axis=1) if tracks else None
    if not alone:
        rows = (which[:, None] * n + np.arange(n)).ravel()
        runs.sims.state[:] = ahead.sims.state[rows]
        whole = None if whole is None else whole[rows]
    runs.put_back(initial)
    return whole


def _read(runs: _Runs, track: Array | None, *, as_read: bool) -> Array:
    """What sensors read of windows that are about to begin, (variants, n, m, ns).

    Args:
        runs: at the beginning of all windows.
        track: readings on the way there, where a sensor lags; see `_approached`.
        as_read: see `simulate`.
    """
    windows, count, n = runs.windows, len(runs.variants), len(runs.windows)
    addresses = mjcf.sensor_addresses(runs.sims.model)

    def begins(address: int, remembered: Array) -> Array:
        return windows.as_read(addresses.tolist().index(address), remembered.reshape(count, n)).ravel()

    ahead = runs.late.max(axis=1, keepdims=True) - runs.late
    nstep = max(math.floor((windows.times.max() + ahead.max(initial=0.0)) / runs.step + 1e-6) + 2, 4)  # of a cubic
    readings = runs.run(0, nstep, record=True)
    assert readings is not None
    near = as_read and track is not None and not (runs.late.any() or runs.physics.stage("sensor"))
    readings = _sense(runs.physics, readings, track, runs.step, begins if near else None)
    readings = readings[..., addresses].reshape(count, n, nstep, -1)
    out = _at_samples(readings, windows.times, runs.step)
    for k, sensor in np.argwhere(ahead > 0):
        one = readings[k, None, :, :, sensor, None]
        out[k, :, :, sensor] = _at_samples(one, windows.times + ahead[k, sensor], runs.step)[0, ..., 0]
    return out


class _Runs:
    """Every window with every variant, side by side in one batch."""

    def __init__(
        self, variants: Sequence[Physics], windows: Windows, stepping: Stepping, base: Sequence[str], threads: int
    ) -> None:
        self.variants, self.windows = variants, windows
        self.step = grid_step(windows, stepping)
        models = [stepping.on(copy.copy(variant.model), self.step) for variant in variants]
        # Recorded commands and readings are simply read earlier; how late they are, the file's own steps say.
        stepped = stepping.integrator is None
        self.delays = np.stack([mjcf.control_delays(variant.model, stepped=stepped) for variant in variants])
        # Seen from the sensor that reads latest, commands act later by as much, and all others read ahead of it: so a
        # window begins with the state that this sensor shows, and nothing before it has to be simulated.
        self.late = np.stack([mjcf.sensor_delays(variant.model, stepped=stepped) for variant in variants])
        for model in models:
            model.actuator_delay[:], model.sensor_delay[:] = 0.0, 0.0
        self.delays += self.late.max(axis=1, keepdims=True)
        if stepping.integrator is not None:
            self.delays += np.stack([steady_currents(model, self.step) for model in models])
        level = np.stack([model.dof_frictionloss.copy() for model in models])
        self._exact = stepping.integrator is not None
        located = self._exact and bool((level > 0).any())
        if located:
            for model in models:
                model.dof_frictionloss[:] = 0
        which = np.repeat(np.arange(len(variants)), len(windows))
        self.physics = stack(variants, which)
        for model in models:
            _leave_out_idle(model, dry=bool(self.physics.stage("friction")) and not located)
        # More simulations than this at a time fall out of the cache and win nothing.
        self.sims = mjbatch.Batch(models[0], len(which), threads)
        _spread(self.sims, models, which)
        self.dry = DryFriction(self.sims, level[which]) if located else None
        self.names = tuple(base)
        self._joints = Joints.of(models[0], base)

    def begin(self, at: int, initial: Array) -> None:
        """Begin `at` steps after each window's start, from positions and velocities (variants, n, 2 nb)."""
        windows, sims = self.windows, self.sims
        sims.time[:] = (windows.start + at * self.step - self.late.max(axis=1, keepdims=True)).ravel()
        time = windows.start + at * self.step - windows.late  # on the clock of the motions, whatever delay is tried
        begin(self._places(), initial, self.variants, windows, self.names, self.delays, time)

    def put_back(self, initial: Array, at: int = 0) -> None:
        """Put the joints at positions and velocities (variants, n, 2 nb), `at` steps after each window's start.

        Whatever follows them keeps its place relative to them, or is where they are if the recording begins only then;
        springs that yield stay as bent as they are.
        """
        places = self._places()
        before = places.position.copy()
        places.put(self._joints, initial, self.windows.after_the_first(at * self.step)[:, None])
        places.stay_bent(self.sims.model, places.position - before)
        if at == 0:
            forget(places, initial, self.variants, self.windows, self.names, self.delays)

    def _places(self) -> Places:
        """Where the batch holds what windows begin with."""
        sims, model = self.sims, self.sims.model
        count = (len(self.variants), len(self.windows))
        plastic = sims.plastic.reshape(*count, sims.plastic.shape[1])
        first = [int(model.tendon_plasticadr[tendon]) for tendon in mjcf.yielding(model)]
        return Places(
            sims.qpos.reshape(*count, model.nq),
            sims.qvel.reshape(*count, model.nv),
            sims.act.reshape(*count, model.na),
            [plastic[..., k : k + 2] for k in first],
            [sims.userdata[:, law.slot].reshape(count) for law in self.physics.remembering],
        )

    def readings(self) -> Array:
        """What the model's sensors say now, (sims, nsensordata)."""
        sensed = self.sims.bind("sensordata")
        self.sims.forward()
        return np.array(sensed)

    def run(self, first: int, nstep: int, *, record: bool) -> Array | None:
        """Advance under the recorded commands, from the `first` step after each window's start on.

        Returns:
            Readings (sims, nstep, nsensordata) at the beginning of each step, or None if nothing is recorded.
        """
        sims, physics, dry = self.sims, self.physics, self.dry
        ctrl = per_step(held_mean, self.windows, self.delays, self.step, first, nstep).reshape(sims.nsim, nstep, -1)
        time = sims.time.reshape(1, -1) + self.step * np.arange(nstep)[:, None]
        ctrl = physics.command(ctrl.swapaxes(0, 1), time).swapaxes(0, 1)
        late = self._late_changes(first, nstep) if self._exact else None
        if dry is None and late is None and not physics.acts:
            out = sims.rollout(nstep, ctrl, record=("sensordata",) if record else ())
            return out.get("sensordata")
        readings = np.empty((nstep, sims.nsim, sims.model.nsensordata)) if record else None
        sensed, commanded, applied = sims.bind("sensordata"), sims.bind("ctrl"), sims.bind("qfrc_applied")
        forces = np.zeros((sims.nsim, sims.model.nv))
        level = sims.expand("dof_frictionloss") if dry is None else dry.level
        if physics.stage("friction"):
            sims.bind("qacc")
        if physics.remembering:
            sims.bind("qacc")
        pressed = physics.pressed
        if pressed:
            sims.bind("qfrc_actuator"), sims.bind("actuator_force"), sims.bind("qfrc_bias")
        if dry is not None:
            dry.begin()
        for k in range(nstep):
            commanded[:] = ctrl[:, k]
            if pressed:
                _forward_to_the_middle(sims, self.step)
            physics.act(sims, level, forces, self.step, None if dry is None else np.abs(dry.sign))
            now = None if readings is None else readings[k]
            if dry is not None:
                dry.step(forces, now, sensed)
            else:
                applied[:] = forces
                sims.step()
                if now is not None:
                    now[:] = sensed
            if late is not None:
                sticks = sims.qvel == 0
                for state, behind in zip((sims.qpos, sims.qvel), late, strict=True):
                    state[:] -= np.where(sticks, 0.0, behind[k])
        return None if readings is None else readings.swapaxes(0, 1)

    def _late_changes(self, first: int, nstep: int) -> tuple[Array, Array] | None:
        """What commands that change within steps do to the state, beyond what their means do.

        A change late in a step, rather than spread over it, moves less by then: the state x, with dx/dt = A x + B u,
        falls behind that under the mean command by A B times the first moment of u about the step's middle, to first
        order in the step. In a loop that feeds back noise that is as much as the noise itself, and passes for a soft
        coupling.

        Returns:
            What positions and velocities fall behind by in each step, (nstep, sims, nv) each; None where no command
            changes within a step. A and B are those of the present state.
        """
        sims = self.sims
        moments = per_step(first_moments, self.windows, self.delays, self.step, first, nstep)
        if not moments.any():
            return None
        accelerated = sims.bind("qacc")  # before the call that fills it
        sims.ctrl[:] = 0
        sims.forward()
        still, speed = accelerated.copy(), sims.qvel.copy()
        gained = np.zeros((2, sims.nsim, moments.shape[-1], sims.model.nv))
        for control in range(moments.shape[-1]):
            sims.ctrl[:, control] = 1
            sims.forward()
            gained[0, :, control] = accelerated - still
            sims.ctrl[:, control] = 0
            sims.qvel[:] = speed + self.step * gained[0, :, control]
            sims.forward()
            gained[1, :, control] = (accelerated - still) / self.step
            sims.qvel[:] = speed
        places, speeds = np.einsum("ikc,sicv->skiv", moments.reshape(sims.nsim, nstep, -1), gained)
        return places, speeds


def _forward_to_the_middle(sims: mjbatch.Batch, step: float) -> None:
    """Leave in a batch the forces of the middle of the step that begins now, and its state as it is.

    The friction that they press on is held over the step. The drive of the step before would make it late, which passes
    for a delay; the drive of its beginning is off by what the motor's speed changes until its middle.
    """
    sims.forward()
    place, speed = sims.qpos.copy(), sims.qvel.copy()
    sims.qpos[:] += step / 2 * speed
    sims.qvel[:] += step / 2 * sims.qacc
    sims.forward()
    sims.qpos[:], sims.qvel[:] = place, speed


def _leave_out_idle(model: mujoco.MjModel, *, dry: bool) -> None:
    """Switch off what takes time in every step and has nothing to do.

    Contacts, of which supported models have none, and constraints where there is no limit, equality or friction.

    Args:
        model: to change.
        dry: whether friction may be written into it later.
    """
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    limited = model.neq or model.jnt_limited.any() or model.tendon_limited.any()
    if not (limited or dry or model.dof_frictionloss.any() or model.tendon_frictionloss.any()):
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT


def _spread(sims: mjbatch.Batch, models: Sequence[mujoco.MjModel], which: NDArray[np.intp]) -> None:
    """Give every simulation the fields in which its variant differs from the first."""
    if len(models) == 1:
        return
    for name in sorted(mjbatch.MODEL_FIELDS - _LAYOUT):
        field = name.removeprefix("opt.")
        values = [np.asarray(getattr(model.opt if field != name else model, field)) for model in models]
        # Hundreds of small arrays: comparing them as numbers takes ten times as long.
        first = values[0].tobytes()
        if all(value.tobytes() == first for value in values[1:]):
            continue
        sims.expand(name)[...] = np.stack(values)[which].reshape(sims.expand(name).shape)


def _sense(
    physics: Physics,
    readings: Array,
    track: Array | None,
    step: float,
    begins: Callable[[int, Array], Array] | None,
) -> Array:
    """Apply what the sensors do to the model's readings (sims, nstep, nsensordata).

    Args:
        physics: what they do.
        readings: of the model, from each window's start on.
        track: readings before that, where sensors remember them; the last are of the start, as it was approached.
        step: between readings, s.
        begins: what a sensor at an address remembers where windows begin, (sims,), from what it would; None for that.
    """
    if not physics.stage("lag"):
        return physics.sense(readings.swapaxes(0, 1)).swapaxes(0, 1)
    if track is None:
        whole = readings
    else:
        # The joints were put back to where the window starts; what a sensor remembers moves along.
        whole = np.concatenate([track[:, :-1] + readings[:, :1] - track[:, -1:], readings], axis=1)
    out = np.empty_like(whole)
    memory = physics.sensor_memory(whole[:, 0])
    for k in range(whole.shape[1]):
        out[:, k] = physics.sense(whole[:, k], memory, step if k else 0.0)
        if begins is not None and memory is not None and k == whole.shape[1] - readings.shape[1]:
            for lag in physics.stage("lag"):
                memory[1][:, lag.index] = out[:, k, lag.index] = begins(lag.index, out[:, k, lag.index])
    return out[:, -readings.shape[1] :]


def _at_samples(readings: Array, times: Array, step: float) -> Array:
    """Readings on the grid (variants, n, nstep, ns), interpolated at sample times (n, m) by a local cubic."""
    along = times / step
    nearest = np.rint(along).astype(np.intp)
    rows = np.arange(len(times))[:, None]
    if np.abs(along - nearest).max() < 1e-6:
        return readings[:, rows, nearest]
    first = np.clip(np.floor(along).astype(np.intp) - 1, 0, readings.shape[2] - 4)
    x = along - first
    weights = [
        -(x - 1) * (x - 2) * (x - 3) / 6,
        x * (x - 2) * (x - 3) / 2,
        -x * (x - 1) * (x - 3) / 2,
        x * (x - 1) * (x - 2) / 6,
    ]
    return np.asarray(sum(w[..., None] * readings[:, rows, first + j] for j, w in enumerate(weights)))
