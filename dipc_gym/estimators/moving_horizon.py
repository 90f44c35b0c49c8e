"""Moving-horizon estimation: the most likely recent past in which no reading contradicts the rounding of its encoder."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from scipy import linalg

from dipc_gym.controllers import lqr
from dipc_gym.estimators.base import Array, Command, Estimator
from dipc_gym.estimators.kalman import FLOOR, disturbed

HORIZON = 40
"""Periods looked back: 0.2 s at 5 ms, longer than the rig takes to fall by 1/e."""
PASSES = 15
"""Of projecting onto the roundings, in each period."""


@dataclass(frozen=True)
class MovingHorizon(Estimator):
    """Least squares over the last 40 periods, readings as intervals (`moving_horizon`): a reference, not for a rig.

    The model is that of `disturbance`: friction wanders. A Kalman filter takes rounding for white noise, which it is
    not where a pole hardly moves: the same count comes again and again. Here a reading says only that the truth is
    within half a count of it. Of all pasts that agree with this, the one is sought that needs the least change of
    friction and starts nearest to what was estimated when the horizon began there. Found by alternating between that
    weighted least-squares problem, one product with a matrix, and moving the readings within their counts.

    Source:
        Rawlings, Mayne, Diehl, "Model Predictive Control" (2nd ed., 2017), chapter 4; projections: Boyle, Dykstra
        (1986).
    """

    observes_friction: ClassVar[bool] = True
    _fitted: Array = field(init=False, repr=False, compare=False)
    """(3 (H + 1) + 7, 3 (H + 1) + H + 7): fitted readings and last state from readings, inputs and first state."""

    def __post_init__(self) -> None:
        F, G, noise = disturbed(self)
        C, R, H = np.eye(3, 7), self.rig.reading_covariance, HORIZON
        noise = noise + FLOOR * np.eye(7)
        try:
            P = linalg.solve_discrete_are(F.T, C.T, noise, R)
        except (np.linalg.LinAlgError, ValueError) as error:
            raise ValueError(f"there is no estimator for this rig's linear model ({error})") from None
        prior = P - P @ C.T @ np.linalg.solve(C @ P @ C.T + R, C @ P)  # of the estimate where the horizon begins
        # Unknown: first state and the friction's changes. States are linear in them and in the inputs.
        walk = np.eye(7)[:, 6:]
        states = np.zeros((H + 1, 7, 7 + H + H))  # from first state, changes, inputs
        states[0, :, :7] = np.eye(7)
        for k in range(H):
            states[k + 1] = F @ states[k]
            states[k + 1, :, 7 + k] += walk[:, 0]
            states[k + 1, :, 7 + H + k] += G[:, 0]
        free, forced = states[:, :, : 7 + H], states[:, :, 7 + H :]
        seen = (C @ free).reshape(-1, 7 + H)
        whiten = np.kron(np.eye(H + 1), np.linalg.inv(np.linalg.cholesky(R)))
        start = np.linalg.inv(np.linalg.cholesky(prior))
        rows = np.zeros((3 * (H + 1) + 7 + H, 7 + H))
        rows[: 3 * (H + 1)] = whiten @ seen
        rows[3 * (H + 1) : 3 * (H + 1) + 7, :7] = start
        rows[3 * (H + 1) + 7 :, 7:] = np.eye(H) / np.sqrt(noise[6, 6])
        solve = np.linalg.pinv(rows)
        known = np.hstack([whiten, -whiten @ (C @ forced).reshape(-1, H), np.zeros((3 * (H + 1), 7))])
        sides = np.vstack([known, np.hstack([np.zeros((7, 3 * (H + 1) + H)), start]), np.zeros((H, known.shape[1]))])
        unknown = solve @ sides
        inputs = np.zeros((H, known.shape[1]))
        inputs[:, 3 * (H + 1) : 3 * (H + 1) + H] = np.eye(H)
        fitted = seen @ unknown + (C @ forced).reshape(-1, H) @ inputs
        last = free[-1] @ unknown + forced[-1] @ inputs
        first = unknown[:7]
        object.__setattr__(self, "_fitted", np.vstack([fitted, last, first @ np.eye(known.shape[1])]))

    def begin(self, observations: Array) -> Array:
        """A past at rest where the rig is first seen."""
        n, H = len(observations), HORIZON
        state = np.hstack([observations, np.zeros((n, 1))])
        readings = np.tile(observations[:, :3], (1, H + 1))
        return np.hstack([state, readings, np.zeros((n, H)), np.tile(state, (1, H + 1))])

    def advance(self, state: Array, readings: Array, command: Command) -> Array:
        """Shift the horizon by a period, and solve."""
        n, H = len(state), HORIZON
        width = 3 * (H + 1)
        past, inputs, estimates = (
            state[:, 7 : 7 + width],
            state[:, 7 + width : 7 + width + H],
            state[:, 7 + width + H :],
        )
        past = np.hstack([past[:, 3:], readings])
        inputs = np.hstack([inputs[:, 1:], self.rig.newtons_per_volt * command.voltage[:, None]])
        start = estimates[:, 7:14]
        steps = np.tile([self.rig.cart_step / 2, self.rig.pole_step / 2, self.rig.pole_step], H + 1)
        moved = past
        for _ in range(PASSES):
            known = np.concatenate([moved, inputs, start], axis=1)
            found = (self._fitted @ known[:, :, None])[:, :, 0]
            moved = np.clip(found[:, :width], past - steps, past + steps)
        last = found[:, width : width + 7]
        return np.hstack([last, past, inputs, estimates[:, 7:], last])

    def observation(self, state: Array) -> Array:
        """The last state of the most likely past."""
        return state[:, :6].copy()

    def friction(self, state: Array) -> Array:
        """Its last friction, within what the motor can exert."""
        return np.clip(state[:, 6], -self.rig.largest_force, self.rig.largest_force)
