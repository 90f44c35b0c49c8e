"""Extended Kalman filter with the bristle of the LuGre model in its state."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from dipc_gym.controllers import lqr
from dipc_gym.estimators.base import Array, Command, Estimator
from dipc_gym.estimators.kalman import FLOOR, wander

STEP = 0.001
"""Longest step of the bristle's integration, s."""
SIZE = 8
"""Six states of the rig, the bristle, and the force that the model leaves unexplained."""
LEVEL = 0.2
"""Share of the Coulomb level by which the friction of a rig of the same build may differ; see `compare.Spread`."""


@dataclass(frozen=True)
class ExtendedKalman(Estimator):
    """Extended Kalman filter with a LuGre bristle and a disturbance (`ekf`).

    The friction is the model's, with the numbers learned from the identification run,

        f = stiffness z + damping dz/dt,  dz/dt = v - stiffness abs(v) z / g(v),
        g(v) = coulomb + (static - coulomb) exp(-(v / stribeck)^2),

    plus a wandering force for what it misses. The bristle takes implicit steps of at most 1 ms; the rig's linear part
    is exact. The covariance follows every step. A fifth of the Coulomb level, the spread within a build, is what the
    disturbance has in a time in which the rig would fall over.

    Source:
        Canudas de Wit, Olsson, Astrom, Lischinsky, IEEE Transactions on Automatic Control 40 (1995) 419-425.
    """

    observes_friction: ClassVar[bool] = True
    _linear: tuple[Array, Array] = field(init=False, repr=False, compare=False)
    _walk: float = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        F, G = lqr.sampled(np.array(self.rig.A), np.array(self.rig.B)[:, None], self.rig.period / self.substeps)
        object.__setattr__(self, "_linear", (F, G[:, 0]))
        object.__setattr__(self, "_walk", wander(self.dry, self.rig))

    @property
    def substeps(self) -> int:
        """Steps of the bristle in a period."""
        return max(1, math.ceil(self.rig.period / STEP - 1e-9))

    def begin(self, observations: Array) -> Array:
        """What is observed at first, bristle at rest, friction not known."""
        n = len(observations)
        P = np.zeros((SIZE, SIZE))
        P[:3, :3] = self.rig.reading_covariance
        P[3:6, 3:6] = P[:3, :3] / self.rig.period**2
        P[6, 6] = (self.dry.static / self.dry.bristle_stiffness) ** 2
        P[7, 7] = (LEVEL * self.dry.coulomb) ** 2
        return np.hstack([observations, np.zeros((n, 2)), np.tile(P.ravel(), (n, 1))])

    def advance(self, state: Array, readings: Array, command: Command) -> Array:
        """Predict through the bristle's steps, correct with the readings."""
        x, P = state[:, :SIZE], state[:, SIZE:].reshape(-1, SIZE, SIZE)
        motor = self.rig.newtons_per_volt * command.voltage
        jacobian = np.eye(SIZE)
        for _ in range(self.substeps):
            x, slope = self._step(x, motor)
            jacobian = slope @ jacobian
        P = jacobian @ P @ jacobian.transpose(0, 2, 1) + FLOOR * np.eye(SIZE)
        P[:, 7, 7] += (LEVEL * self._walk / 2) ** 2
        P[:, 6, 6] += (self._walk / self.dry.bristle_stiffness) ** 2
        S = P[:, :3, :3] + self.rig.reading_covariance
        gain = P[:, :, :3] @ np.linalg.inv(S)
        x = x + (gain @ (readings - x[:, :3])[:, :, None])[:, :, 0]
        P = P - gain @ P[:, :3, :]
        P = 0.5 * (P + P.transpose(0, 2, 1))
        return np.hstack([x, P.reshape(len(x), -1)])

    def observation(self, state: Array) -> Array:
        """The filtered state."""
        return state[:, :6].copy()

    def friction(self, state: Array) -> Array:
        """Mean over the coming period if the cart kept its velocity, within what the motor can exert."""
        v, z = state[:, 3], state[:, 6]
        total = np.zeros(len(state))
        for _ in range(self.substeps):
            z, force, *_ = self._bristle(v, z)
            total += force
        largest = self.rig.largest_force
        return np.clip(total / self.substeps + state[:, 7], -largest, largest)

    def _step(self, x: Array, motor: Array) -> tuple[Array, Array]:
        """States (n, 8) a substep later, and their slopes (n, 8, 8) against those before."""
        F, G = self._linear
        z, force, dz, df = self._bristle(x[:, 3], x[:, 6])
        total = motor - force - x[:, 7]
        rig = (F @ x[:, :6, None])[:, :, 0] + total[:, None] * G
        after = np.concatenate([rig, z[:, None], x[:, 7:]], axis=1)
        slope = np.zeros((len(x), SIZE, SIZE))
        slope[:, :6, :6] = F
        slope[:, :6, 3] -= df[0][:, None] * G
        slope[:, :6, 6] = -df[1][:, None] * G
        slope[:, :6, 7] = -G
        slope[:, 6, 3], slope[:, 6, 6], slope[:, 7, 7] = dz[0], dz[1], 1.0
        return after, slope

    def _bristle(self, v: Array, z: Array) -> tuple[Array, Array, tuple[Array, Array], tuple[Array, Array]]:
        """Bristle (n,) after a substep, m; force in it, N; slopes of both against velocity and bristle before."""
        dry, h = self.dry, self.rig.period / self.substeps
        bump = (dry.static - dry.coulomb) * np.exp(-((v / dry.stribeck_velocity) ** 2))
        level = np.maximum(dry.coulomb, 1e-3) + bump
        rate = dry.bristle_stiffness * np.abs(v) / level
        bent = -2 * v / dry.stribeck_velocity**2 * bump  # slope of the level
        rate_slope = dry.bristle_stiffness * (np.sign(v) * level - np.abs(v) * bent) / level**2
        damped = 1 + h * rate
        after = (z + h * v) / damped
        dz = ((h - after * h * rate_slope) / damped, 1 / damped)
        force = dry.bristle_stiffness * after + dry.bristle_damping * (after - z) / h
        df = (
            (dry.bristle_stiffness + dry.bristle_damping / h) * dz[0],
            (dry.bristle_stiffness + dry.bristle_damping / h) * dz[1] - dry.bristle_damping / h,
        )
        return after, force, dz, df
