"""Dry friction whose reversals are located inside the step.

A fixed step that meets a reversal of dry friction is wrong by the step times the jump of the acceleration, however
good the integrator: MuJoCo's friction constraint leaves 80 micrometres at 2 ms on a cart whose encoder resolves 20.
Here friction is taken out of the model. While a joint slides, its friction is a constant force, for which RK4 keeps
its order. Where the velocity would change sign, the simulation is taken back, stepped to the reversal, asked whether
the joint sticks, and stepped to the end of the interval. All simulations of a batch do so at once, each with its own
time step, so the cost grows with the number of reversals only.

Sticking joints are held by the force that keeps them still (Karnopp 1985), up to the level of friction.
"""

from __future__ import annotations

import mujoco
import numpy as np
from mujoco import batch as mjbatch
from numpy.typing import NDArray

Array = NDArray[np.float64]

_SINGULAR = 1e15  # condition from which a matrix has no inverse
_EVENTS = 4  # reversals looked for within one step; what is left over is a small error


class DryFriction:
    """Steps a batch under dry friction.

    Args:
        sims: batch of a model whose own `frictionloss` is zero.
        level: friction of each simulation and degree of freedom, N or N m, (nsim, nv); may be changed between steps.
    """

    def __init__(self, sims: mjbatch.Batch, level: Array) -> None:
        self.sims, self.level = sims, level
        model = sims.model
        self.step_size = float(model.opt.timestep)
        self.timestep = sims.expand("opt.timestep").reshape(sims.nsim, -1)
        self.address = np.array([int(model.jnt_qposadr[model.dof_jntid[d]]) for d in range(model.nv)])
        self.qpos, self.qvel, self.applied = sims.bind("qpos"), sims.bind("qvel"), sims.bind("qfrc_applied")
        self.inertia = sims.bind("M")
        self.acceleration = sims.bind("qacc_smooth")
        self.dense = _dense_map(model)
        self.sign: Array = np.zeros((sims.nsim, model.nv))
        self._force = np.zeros_like(level)
        self._inverse = np.zeros((sims.nsim, model.nv, model.nv))  # of the inertia, where joints rest

    def begin(self) -> None:
        """Take the present velocities for the directions of sliding; joints at rest are asked whether they stick."""
        self.sign = np.where(self.level > 0, np.sign(self.qvel), 0.0)

    def step(self, forces: Array, readings: Array | None, sensed: Array) -> None:
        """Advance every simulation by one step.

        Args:
            forces: generalised forces beside friction, (nsim, nv).
            readings: where the sensors at the beginning of the step go, (nsim, nsensordata), or None.
            sensed: the batch's bound sensor data.
        """
        sims = self.sims
        # Where there was no friction a while, a joint may be on its way without a direction; what is held has no speed.
        self.sign = np.where((self.sign == 0) & (self.level > 0), np.sign(self.qvel), self.sign)
        resting = (self.sign == 0) & (self.level > 0)
        if resting.any():
            self._hold(np.flatnonzero(resting.any(axis=1)), forces)
        stuck = (self.sign == 0) & (self.level > 0)
        sliding = np.where(stuck, self._force, -self.sign * self.level)
        before = sims.state.copy()
        speed, place = self.qvel.copy(), self.qpos.copy()
        self.applied[:] = forces + sliding
        sims.step()
        if readings is not None:
            readings[:] = sensed
        self._keep(stuck, place)
        crossed = self.sign * self.qvel < 0
        if crossed.any():
            self._events(np.flatnonzero(crossed.any(axis=1)), before, speed, forces)

    def _events(self, ids: NDArray[np.intp], before: Array, speed: Array, forces: Array) -> None:
        """Redo the step of some simulations, stopping at each reversal."""
        sims = self.sims
        left = np.full(sims.nsim, self.step_size)
        for _ in range(_EVENTS):
            after = self.qvel[ids]
            start = speed[ids]
            crossed = self.sign[ids] * after < 0
            with np.errstate(divide="ignore", invalid="ignore"):
                share = np.where(crossed, start / (start - after), np.inf)
            first = np.argmin(share, axis=1)
            each = np.arange(len(ids))
            until = np.clip(share[each, first], 1e-6, 1.0) * left[ids]
            sims.state[ids] = before[ids]
            self._advance(ids, until, forces)
            # Velocity is no straight line; once more through its start and where this came to.
            with np.errstate(divide="ignore", invalid="ignore"):
                better = until * start[each, first] / (start[each, first] - self.qvel[ids, first])
            until = np.where(np.isfinite(better), np.clip(better, 1e-6 * left[ids], left[ids]), until)
            sims.state[ids] = before[ids]
            self._advance(ids, until, forces)
            self.qvel[ids, first] = 0.0
            self.sign[ids, first] = 0.0
            left[ids] -= until
            self._hold(ids, forces)
            ids = ids[left[ids] > 1e-6 * self.step_size]
            if not len(ids):
                break
            before[ids] = sims.state[ids]
            speed[ids] = self.qvel[ids]
            self._advance(ids, left[ids], forces)
            ids = ids[(self.sign[ids] * self.qvel[ids] < 0).any(axis=1)]
            if not len(ids):
                break
        self.timestep[:] = self.step_size

    def _advance(self, ids: NDArray[np.intp], duration: Array, forces: Array) -> None:
        sims = self.sims
        stuck = (self.sign[ids] == 0) & (self.level[ids] > 0)
        place = self.qpos.copy()
        self.applied[ids] = forces[ids] + np.where(stuck, self._force[ids], -self.sign[ids] * self.level[ids])
        self.timestep[ids] = duration[:, None]
        sims.step(ids)
        mask = np.zeros(self.sign.shape, dtype=bool)
        mask[ids] = stuck
        self._keep(mask, place)

    def _keep(self, stuck: NDArray[np.bool_], place: Array) -> None:
        """Put stuck joints back where they stand.

        The force that held them was constant over the step, where it should have followed the other joints; what it
        lacked is an impulse, and the others feel it.
        """
        if not stuck.any():
            return
        ids = np.flatnonzero(stuck.any(axis=1))
        rows, dofs = np.nonzero(stuck)
        if stuck.shape[1] > 1:
            held = stuck[ids]
            inverse = self._inverse[ids]
            system = np.where(held[:, :, None] & held[:, None, :], inverse, np.eye(held.shape[1]))
            moved = (self.qpos[ids] - place[ids])[:, self.address]
            excess = np.where(held[..., None], np.stack([self.qvel[ids], moved], axis=2), 0.0)
            felt = inverse @ np.linalg.solve(system, excess)
            self.qvel[ids] -= felt[..., 0]
            self.qpos[ids[:, None], self.address] -= felt[..., 1]
        self.qvel[rows, dofs] = 0.0
        self.qpos[rows, self.address[dofs]] = place[rows, self.address[dofs]]

    def _hold(self, ids: NDArray[np.intp], forces: Array) -> None:
        """Find the forces that keep resting joints still; those that need more than friction gives begin to slide."""
        sims = self.sims
        for _ in range(2):
            resting = (self.sign[ids] == 0) & (self.level[ids] > 0)
            if not resting.any():
                return
            self.applied[ids] = forces[ids] - self.sign[ids] * self.level[ids]
            sims.forward(ids)
            padded = np.concatenate([self.inertia[ids], np.zeros((len(ids), 1))], axis=1)
            self._inverse[ids] = inverse = _inverse(padded[:, self.dense])
            both = resting[:, :, None] & resting[:, None, :]
            system = np.where(both, inverse, np.eye(resting.shape[1]))
            wanted = np.where(resting, -self.acceleration[ids], 0.0)
            force = (_inverse(system) @ wanted[..., None])[..., 0]
            released = resting & (np.abs(force) > self.level[ids])
            self._force[ids] = np.where(resting, force, 0.0)
            if not released.any():
                return
            self.sign[ids] = np.where(released, -np.sign(force), self.sign[ids])


def _inverse(matrices: Array) -> Array:
    """Inverses of matrices (n, k, k); LAPACK takes ten times as long for single numbers."""
    if matrices.shape[-1] == 1:
        return np.asarray(1.0 / matrices)
    try:
        return np.asarray(np.linalg.inv(matrices))
    except np.linalg.LinAlgError:  # a hypothesis took more mass from a body than it has; its simulation ends there
        sound = (np.linalg.cond(matrices) < _SINGULAR)[:, None, None]
        return np.where(sound, np.linalg.inv(np.where(sound, matrices, np.eye(matrices.shape[-1]))), np.nan)


def _dense_map(model: mujoco.MjModel) -> NDArray[np.intp]:
    """Where entries of the full inertia matrix (nv, nv) stand in MuJoCo's sparse one; one past its end for zeros."""
    where = np.full((model.nv, model.nv), model.nM)
    for row in range(model.nv):
        first = int(model.M_rowadr[row])
        for k in range(first, first + int(model.M_rownnz[row])):
            column = int(model.M_colind[k])
            where[row, column] = where[column, row] = k
    return where
