"""Extended Kalman filter on the whole motion of cart and poles, for swinging up as for balancing."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from dipc_gym.dataflow import NoForm
from dipc_gym.estimators.base import LARGEST, Array, Command, Estimator
from dipc_gym.estimators.kalman import FLOOR, wander, with_friction
from dipc_gym.estimators.late import Late
from dipc_gym.mechanics.motion import Motion

if TYPE_CHECKING:
    from dipc_gym.dataflow import Program, Value

SIZE = 7
"""Six states of the rig, and friction."""
PAST = SIZE + SIZE * SIZE
"""Where past commands begin, after state and covariance."""


@dataclass(frozen=True)
class RigidBody(Estimator):
    """Extended Kalman filter of the whole motion, with dry friction as a force that wanders (`rigid_body`).

    What `disturbance` is near upright, everywhere: the poles may turn. The motion follows from the linear model, see
    `motion.Motion`; a period is one step of Runge and Kutta's fourth order, and the covariance follows the model that
    is linear about the estimate. Every row follows its own covariance, at ten times the cost of `disturbance`.

    Raises:
        ValueError: the linear model is not that of a cart with two poles in a plane.

    Source:
        Simon, "Optimal State Estimation" (2006), chapter 13.
    """

    observes_friction: ClassVar[bool] = True
    everywhere: ClassVar[bool] = True
    motion: Motion = field(init=False, repr=False, compare=False)
    _late: Late = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        A, B = with_friction(self.rig)
        object.__setattr__(self, "_late", Late.of(A, B, period=self.rig.period, delay=self.rig.delay))
        object.__setattr__(self, "motion", Motion.of(np.array(self.rig.A), np.array(self.rig.B)))

    def begin(self, observations: Array) -> Array:
        """What is observed at first, at rest within a count a period, friction not known."""
        P = np.zeros((SIZE, SIZE))
        P[:3, :3] = self.rig.reading_covariance
        P[3:6, 3:6] = P[:3, :3] / self.rig.period**2
        P[6, 6] = self.dry.static**2
        n = len(observations)
        return np.hstack(
            [observations, np.zeros((n, 1)), np.tile(P.ravel(), (n, 1)), np.zeros((n, self._late.columns))]
        )

    def advance(self, state: Array, readings: Array, command: Command) -> Array:
        """Predict with the motor's force, correct with the readings."""
        x, P = state[:, :SIZE], state[:, SIZE:PAST].reshape(-1, SIZE, SIZE)
        motor, past = self._late.arrived(state[:, PAST:], self.rig.newtons_per_volt * command.voltage)
        T, total = self.rig.period, motor - x[:, 6]
        half = self.motion.after(x[:, :6], total, 0.5 * T)
        A, B = self.motion.linear(half, total)
        F = np.zeros_like(P)
        once, power = np.zeros_like(P), np.tile(np.eye(SIZE), (len(x), 1, 1))
        once[:, :6, :6], once[:, :6, 6] = T * A, -T * B
        for k in range(1, 5):  # the exponential of the slope over a period
            F = F + power
            power = power @ once / k
        F = F + power
        x = np.hstack([self.motion.after(x[:, :6], total, T), x[:, 6:]])
        P = F @ P @ F.transpose(0, 2, 1) + FLOOR * np.eye(SIZE)
        P[:, 6, 6] += wander(self.dry, self.rig) ** 2
        S = P[:, :3, :3] + self.rig.reading_covariance
        lost = ~(np.abs(S) < LARGEST).all(axis=(1, 2))  # a row that is as unsure begins anew, as `update` sees to
        S[lost], x[lost] = np.eye(3), np.nan
        gain = P[:, :, :3] @ np.linalg.inv(S)
        x = x + (gain @ (readings - x[:, :3])[:, :, None])[:, :, 0]
        P = P - gain @ P[:, :3, :]
        P = 0.5 * (P + P.transpose(0, 2, 1))
        return np.hstack([x, P.reshape(len(x), -1), past])

    def observation(self, state: Array) -> Array:
        """The filtered state, when the next command will act."""
        x, past, late = state[:, :6].copy(), state[:, PAST:], self._late
        for column in range(late.columns - 1, -1, -1):
            length = self.rig.period * (late.share if column == late.whole else 1.0)
            x = self.motion.after(x, past[:, column] - state[:, 6], length)
        return x

    def friction(self, state: Array) -> Array:
        """The seventh state, within what the motor can exert."""
        return np.clip(state[:, 6], -self.rig.largest_force, self.rig.largest_force)

    def express(self, program: Program, readings: Value, voltage: Value, force: Value) -> Value:
        """Nothing: exported code calls no sine.

        Raises:
            NoForm: always.
        """
        raise NoForm("it needs sine and cosine, and exported code calls the exponential alone; `ekf` has a form")
