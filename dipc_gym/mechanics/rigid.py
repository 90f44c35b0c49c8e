"""A rig as linear controllers see it: how its joints accelerate, without dry friction, lags or play."""

from __future__ import annotations

import copy
from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from dipc_gym import mjcf

Array = NDArray[np.float64]

_AT_ONCE = 1e-9  # s; time constant of a winding whose current follows at once


class Rigid:
    """A copy of a model whose commands act at once and whose hidden rotors move with the joints that they follow.

    Args:
        model: hinges and slides.
        dofs: degrees of freedom looked at: of every joint that follows no other, in any order.

    Example:
        >>> text = '<mujoco><worldbody><body><joint name="x" type="slide" axis="1 0 0"/><geom size="1" mass="2"/>'
        >>> Rigid(mjcf.compile(text + "</body></worldbody></mujoco>"), [0]).acceleration([0], [0], [3.0]).tolist()
        [1.5]
    """

    def __init__(self, model: mujoco.MjModel, dofs: Sequence[int]) -> None:
        self.model = copy.copy(model)
        self.model.dof_frictionloss[:] = 0.0
        passive = model.actuator_outadr[mjcf.passive_actuators(model)]  # they hold the dry friction
        self.model.actuator_gear[passive] = 0.0
        self.model.actuator_delay[:] = 0.0
        wound = (model.actuator_gaintype == mujoco.mjtGain.mjGAIN_DCMOTOR) & (model.actuator_dynprm[:, 0] > 0)
        self.model.actuator_dynprm[wound, 0], self.model.actuator_actearly[wound] = _AT_ONCE, True
        self.data = mujoco.MjData(self.model)
        self.dofs = list(dofs)
        self._places = model.jnt_qposadr[model.dof_jntid]
        self._ties = np.zeros((model.nv, len(self.dofs)))
        self._ties[self.dofs, range(len(self.dofs))] = 1.0
        for follower, leader in mjcf.followers(model).items():
            led = int(model.joint(leader).dofadr[0])
            if led in self.dofs:
                self._ties[int(model.joint(follower).dofadr[0]), self.dofs.index(led)] = 1.0

    def acceleration(
        self,
        position: ArrayLike | None,
        velocity: ArrayLike,
        force: ArrayLike,
        command: tuple[int, float] | None = None,
    ) -> Array:
        """Accelerations (n,) of the joints looked at.

        Args:
            position: of these joints, (n,), or None for where the model has them; those that follow stand where their
                leaders do.
            velocity: (n,).
            force: applied to them beside what the model has, N or N m, (n,).
            command: control and its value; None leaves all at zero.
        """
        model, data, ties = self.model, self.data, self._ties
        mujoco.mj_resetData(model, data)
        if position is not None:
            data.qpos[self._places] += ties @ (np.asarray(position, dtype=float) - data.qpos[self._places[self.dofs]])
        data.qvel[:] = ties @ np.asarray(velocity, dtype=float)
        data.qfrc_applied[self.dofs] = force
        if command is not None:
            data.ctrl[command[0]] = command[1]
        mujoco.mj_forward(model, data)
        inertia = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, inertia)
        return np.asarray(np.linalg.solve(ties.T @ inertia @ ties, ties.T @ data.qfrc_smooth))
