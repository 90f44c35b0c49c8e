"""The textbook rival: Coulomb friction, viscous friction and back-EMF, identified by least squares."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from dipc_gym.compensators.base import Array, Compensator, RigConstants, Samples, Signal, elementwise, numbers

SIGN_VELOCITIES = np.geomspace(1e-3, 0.3, 41)  # m/s, widths of the smooth sign, of which least squares choose


@dataclass(frozen=True)
class Feedforward(Compensator):
    """Add what Coulomb friction, viscous friction and back-EMF take (`feedforward`).

        volts = per_newton F + coulomb tanh(v / sign_velocity) + per_velocity v + offset.

    The hyperbolic tangent stands for the sign of the velocity: a jump at zero would chatter on encoder
    noise, and the cart at rest would get no help either way. Its width is learned like the rest: least
    squares for each of 41 widths from 1 to 300 mm/s, evenly spaced in the logarithm, and the best is kept.
    Viscous friction and back-EMF are one term, and only what exceeds the viscous friction in the
    controller's model remains in it.

    Attributes:
        per_newton: Volts per newton of wanted force, V/N.
        coulomb: Voltage against Coulomb friction, V.
        per_velocity: Voltage per cart velocity, V s/m.
        offset: Constant voltage, V.
        sign_velocity: Velocity within which the sign is smoothed, m/s.

    Example:
        >>> Feedforward(per_newton=0.25, coulomb=2.0, per_velocity=0.0, offset=0.0,
        ...             sign_velocity=0.01).voltage(force=10.0, velocity=0.3)
        4.5
    """

    per_newton: float
    coulomb: float
    per_velocity: float
    offset: float
    sign_velocity: float = numbers(positive=True)

    @classmethod
    def fit(cls, samples: Samples, rig: RigConstants, *, seed: int = 0) -> Self:
        """Identify the five numbers on the training part by least squares."""
        force, velocity = samples.force[samples.train], samples.velocity[samples.train]
        voltage = samples.voltage[samples.train]

        def solve(sign_velocity: float) -> tuple[float, Array]:
            sign = np.tanh(velocity / sign_velocity)
            columns = np.column_stack([force, sign, velocity, np.ones_like(force)])
            coefficients = np.linalg.lstsq(columns, voltage)[0]
            return float(np.mean((voltage - columns @ coefficients) ** 2)), coefficients

        best = min(SIGN_VELOCITIES.tolist(), key=lambda width: solve(width)[0])
        per_newton, coulomb, per_velocity, offset = solve(best)[1].tolist()
        return cls(per_newton, coulomb, per_velocity, offset, best)

    def volts(self, force: Signal, velocity: Signal, previous_velocity: Signal) -> Signal:
        """Sum of the four terms."""
        (sign,) = elementwise(np.tanh, [velocity / self.sign_velocity])
        return self.per_newton * force + self.coulomb * sign + self.per_velocity * velocity + self.offset
