"""Moving-horizon estimation: the calmest recent past that no reading contradicts."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from dipc_gym.estimators.base import Array, Command, Estimator
from dipc_gym.estimators.kalman import disturbed

HORIZON = 40
"""Periods looked back: 0.2 s at 5 ms, longer than the rig takes to fall by 1/e."""
PASSES = 15
"""Of projecting onto the roundings, in each period."""


@dataclass(frozen=True)
class MovingHorizon(Estimator):
    """Least squares over the last 40 periods, readings as intervals (`moving_horizon`): a reference, not for a rig.

    The model is that of `disturbance`: friction wanders. A Kalman filter takes rounding for white noise, which it is
    not where a pole hardly moves: the same count comes again and again. Here a reading says only that the truth is
    within half a count of it (a count, for the sum of two angles). Of all pasts that agree with this, the one is sought
    that needs the least change of friction. It is approached by turns: solve the weighted least-squares problem, which
    is one product with a matrix, then move what counts as read to the nearest value that the counts allow. What was
    before the horizon is forgotten: an estimate from there, believed as much as the filter believes its own, is never
    contradicted by an interval, and errors live on (the cart then wandered 135 mm instead of 12).

    Source:
        Rawlings, Mayne, Diehl, "Model Predictive Control" (2nd ed., 2017), chapter 4.
    """

    observes_friction: ClassVar[bool] = True
    _fitted: Array = field(init=False, repr=False, compare=False)
    """(3 (H + 1) + 7, 3 (H + 1) + H): fitted readings and the last state, from readings and inputs."""

    def __post_init__(self) -> None:
        F, G, noise = disturbed(self)
        C, H = np.eye(3, 7), HORIZON
        # States are linear in what is unknown, the first state and the changes of friction, and in the inputs.
        states = np.zeros((H + 1, 7, 7 + H + H))
        states[0, :, :7] = np.eye(7)
        for k in range(H):
            states[k + 1] = F @ states[k]
            states[k + 1, 6, 7 + k] += 1.0
            states[k + 1, :, 7 + H + k] += G[:, 0]
        free, forced = states[:, :, : 7 + H], states[:, :, 7 + H :]
        seen, driven = (C @ free).reshape(-1, 7 + H), (C @ forced).reshape(-1, H)
        whiten = np.kron(np.eye(H + 1), np.linalg.inv(np.linalg.cholesky(self.rig.reading_covariance)))
        calm = np.hstack([np.zeros((H, 7)), np.eye(H) / np.sqrt(noise[6, 6])])
        try:
            solve = np.linalg.pinv(np.vstack([whiten @ seen, calm]))[:, : len(seen)] @ whiten
        except np.linalg.LinAlgError as error:
            raise ValueError(f"there is no estimator for this rig's linear model ({error})") from None
        unknown = solve @ np.hstack([np.eye(len(seen)), -driven])
        inputs = np.hstack([np.zeros((H, len(seen))), np.eye(H)])
        matrix = np.vstack([seen @ unknown + driven @ inputs, free[-1] @ unknown + forced[-1] @ inputs])
        object.__setattr__(self, "_fitted", matrix)

    def begin(self, observations: Array) -> Array:
        """A past that led to the first observation in a straight line, without friction."""
        ago = self.rig.period * np.arange(HORIZON, -1, -1)[:, None]
        past = observations[:, None, :3] - ago * observations[:, None, 3:]
        n = len(observations)
        return np.hstack([observations, np.zeros((n, 1)), past.reshape(n, -1), np.zeros((n, HORIZON))])

    def advance(self, state: Array, readings: Array, command: Command) -> Array:
        """Shift the horizon by a period, and solve."""
        width = 3 * (HORIZON + 1)
        past = np.concatenate([state[:, 10 : 7 + width], readings], axis=1)
        force = self.rig.newtons_per_volt * command.voltage[:, None]
        inputs = np.concatenate([state[:, 8 + width :], force], axis=1)
        steps = np.tile([self.rig.cart_step / 2, self.rig.pole_step / 2, self.rig.pole_step], HORIZON + 1)
        read = past
        for _ in range(PASSES):
            known = np.concatenate([read, inputs], axis=1)
            found = (self._fitted @ known[:, :, None])[:, :, 0]
            read = np.clip(found[:, :width], past - steps, past + steps)
        return np.concatenate([found[:, width:], past, inputs], axis=1)

    def observation(self, state: Array) -> Array:
        """The last state of the past that was found."""
        return state[:, :6].copy()

    def friction(self, state: Array) -> Array:
        """Its last friction, within what the motor can exert."""
        return np.clip(state[:, 6], -self.rig.largest_force, self.rig.largest_force)
