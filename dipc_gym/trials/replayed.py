"""Recordings of a trial in MuJoCo, window by window: what the rivals are fitted on and judged by.

Windows are those of the scorer: 0.25 s, from estimated states, errors in units of the sensors' noise, freed of what
better initial states would remove.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
from mujoco import batch
from numpy.typing import NDArray

Array = NDArray[np.float64]
Force = Callable[[Array, Array, Array], Array]
"""Generalised force to add, (n, nv), from positions (n, nv), velocities (n, nv) and commands (n, 1)."""

WINDOW = 125  # samples of a window that is judged
STEPS = 4
"""Runge-Kutta steps a sample."""
SMOOTH = 31
"""Samples over which a cubic is laid to differentiate a reading."""
HELD_BACK = 0.2
"""Last share of each training recording, by which those rivals that learn a force choose."""


@dataclass(frozen=True)
class Motion:
    """A recording with what its readings say about the rig's state.

    Attributes:
        step: sample time, s.
        command: (samples, 1).
        measured: joint readings, (samples, nv).
        q: positions, smoothed.
        v: velocities.
        a: accelerations.
    """

    step: float
    command: Array
    measured: Array
    q: Array
    v: Array
    a: Array

    @classmethod
    def read(cls, path: Path) -> Motion:
        """Read a trial's CSV: time, command, joints."""
        from scipy.signal import savgol_filter

        table = np.loadtxt(path, delimiter=",", skiprows=1)
        step, y = float(np.median(np.diff(table[:, 0]))), table[:, 2:]
        q, v, a = (savgol_filter(y, SMOOTH, 3, deriv=k, delta=step, axis=0) for k in range(3))
        return cls(step, table[:, 1:2], y, q, v, a)

    @property
    def windows(self) -> int:
        """How many whole windows there are."""
        return len(self.measured) // WINDOW

    def cut(self, values: Array) -> Array:
        """(samples, k) to (windows, window samples, k)."""
        return values[: self.windows * WINDOW].reshape(self.windows, WINDOW, -1)


def predict(model: mujoco.MjModel, motion: Motion, force: Force | None, q: Array, v: Array) -> Array:
    """Joint positions in every window, (windows, window samples, nv).

    Args:
        model: whose sensors are its joints' positions, in their order.
        motion: for its commands.
        force: added at every step.
        q: initial positions of the windows, (windows, nv).
        v: initial velocities.
    """
    step = motion.step / STEPS
    model.opt.timestep, model.opt.integrator = step, mujoco.mjtIntegrator.mjINT_RK4
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET  # what diverges stays diverged
    count = len(q)
    sims = batch.Batch(model, count, 1)
    sims.qpos[:], sims.qvel[:] = q, v
    commands = motion.cut(motion.command)
    commands = np.tile(commands, (count // len(commands), 1, 1))
    seen = np.empty((count, WINDOW, model.nv))
    acceleration = np.zeros((count, model.nv))
    for k in range(WINDOW):
        seen[:, k] = sims.qpos
        sims.ctrl[:] = commands[:, k]
        for _ in range(STEPS):
            before = sims.qvel.copy()
            if force is not None:
                # It is held over the step: what it is in the middle of it costs a perfect force next to nothing.
                q, v = sims.qpos + step / 2 * before, before + step / 2 * acceleration
                sims.qfrc_applied[:] = force(q, v, commands[:, k])
            sims.step()
            acceleration = (sims.qvel - before) / step
    return seen


def from_estimates(
    model: mujoco.MjModel, motion: Motion, noise: Array, force: Force | None = None
) -> tuple[Array, Array]:  # fmt: skip
    """Predictions from the estimated initial states, and what better ones could change in them.

    Args:
        model: see `predict`.
        motion: the recording.
        noise: standard deviation of each reading's noise, (nv,).
        force: added to the model, if any.

    Returns:
        Predictions in units of noise, (windows, window samples x nv), and an orthonormal basis of the changes,
        (windows, window samples x nv, 2 nv).
    """
    q, v = motion.cut(motion.q)[:, 0], motion.cut(motion.v)[:, 0]
    moves = [(np.zeros(model.nv), np.zeros(model.nv))]
    for k in range(model.nv):
        for j in range(2):
            move = (np.zeros(model.nv), np.zeros(model.nv))
            move[j][k] = 20 * noise[k] / (1.0 if j == 0 else WINDOW * motion.step)
            moves.append(move)
    begin_q, begin_v = (np.concatenate([x + move[j] for move in moves]) for j, x in ((0, q), (1, v)))
    with np.errstate(over="ignore", invalid="ignore"):
        plain, *others = (predict(model, motion, force, begin_q, begin_v) / noise).reshape(len(moves), len(q), -1)
        changes = np.stack([other - plain for other in others], axis=-1)
    return plain, np.linalg.qr(np.nan_to_num(changes, nan=0.0, posinf=0.0, neginf=0.0))[0]


def without_initial(residual: Array, basis: Array) -> Array:
    """Residuals (..., windows, values) without what better initial states would remove."""
    return np.asarray(residual - np.einsum("wij,...wj->...wi", basis, np.einsum("wij,...wi->...wj", basis, residual)))


def error(model: mujoco.MjModel, motion: Motion, noise: Array, force: Force | None = None) -> float:
    """Prediction error on a recording in units of noise; 1 is a model that lacks nothing, infinity one that diverges.

    Args:
        model: see `predict`.
        motion: the recording.
        noise: standard deviation of each reading's noise, (nv,).
        force: added to the model, if any.
    """
    plain, basis = from_estimates(model, motion, noise, force)
    if not (np.all(np.isfinite(plain)) and np.all(np.isfinite(basis))):
        return math.inf
    measured = (motion.cut(motion.measured) / noise).reshape(plain.shape)
    return float(np.sqrt(np.mean(without_initial(plain - measured, basis) ** 2)))


def unexplained(model: mujoco.MjModel, motion: Motion) -> Array:
    """Force that the model lacks at each sample, (samples, nv).

    Differentiating a noisy reading smears accelerations; the model's own are smeared by the very same filter.
    """
    from scipy.signal import savgol_filter

    data = mujoco.MjData(model)
    modelled = np.empty_like(motion.a)
    for k in range(len(modelled)):
        data.qpos[:], data.qvel[:], data.ctrl[:] = motion.q[k], motion.v[k], motion.command[k]
        mujoco.mj_forward(model, data)
        modelled[k] = data.qacc
    speed = np.concatenate([np.zeros((1, model.nv)), np.cumsum(modelled, axis=0)[:-1]]) * motion.step
    way = np.cumsum(speed + 0.5 * motion.step * modelled, axis=0)
    way = np.concatenate([np.zeros((1, model.nv)), way[:-1]]) * motion.step
    missed = motion.a - savgol_filter(way, SMOOTH, 3, deriv=2, delta=motion.step, axis=0)
    out = np.empty_like(missed)
    for k in range(len(out)):
        data.qpos[:] = motion.q[k]
        mujoco.mj_forward(model, data)
        mujoco.mj_mulM(model, data, out[k], missed[k])
    return out


def lacking(model: mujoco.MjModel, motions: Sequence[Motion]) -> tuple[list[Array], list[Array]]:
    """Positions, velocities and command of each recording, (samples, 2 nv + 1), and the force that the model lacks
    there, (samples, nv); without the ends, where a cubic cannot be centred and derivatives are poor.
    """
    ends = slice(SMOOTH, -SMOOTH)
    inputs = [np.concatenate([m.q, m.v, m.command], axis=1)[ends] for m in motions]
    return inputs, [unexplained(model, m)[ends] for m in motions]


def early_and_late(arrays: Sequence[Array]) -> tuple[Array, Array]:
    """The first part of each recording, to fit, and the last, to choose by."""
    cuts = [int((1 - HELD_BACK) * len(a)) for a in arrays]
    early = np.concatenate([a[:c] for a, c in zip(arrays, cuts, strict=True)])
    return early, np.concatenate([a[c:] for a, c in zip(arrays, cuts, strict=True)])


def kept(model: mujoco.MjModel, motions: Sequence[Motion], noise: Array, force: Force) -> bool:
    """Whether recordings are simulated better with a force than without."""
    with_it, without = (np.mean([error(model, m, noise, f) ** 2 for m in motions]) for f in (force, None))
    return bool(with_it < without)
