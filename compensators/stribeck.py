"""Feedforward with a Stribeck bump: dry friction that is larger at low speed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from dipc_gym.compensators.base import Array, Compensator, RigConstants, Samples, Signal, elementwise, numbers
from dipc_gym.compensators.feedforward import SIGN_VELOCITIES

BUMP_VELOCITIES = np.geomspace(5e-3, 0.3, 13)  # m/s, widths of the Stribeck bump, of which least squares choose


@dataclass(frozen=True)
class Stribeck(Compensator):
    """The `feedforward` compensator with a friction level that falls with speed (`stribeck`).

        volts = per_newton F + (coulomb + bump exp(-(v / bump_velocity)^2)) tanh(v / sign_velocity)
                + per_velocity v + offset.

    Linear least squares for each of 41 widths of the sign and 13 of the bump; the best is kept.

    Attributes:
        per_newton: Volts per newton of wanted force, V/N.
        coulomb: Voltage against friction at speed, V.
        bump: What low speed adds to it, V.
        per_velocity: Voltage per cart velocity, V s/m.
        offset: Constant voltage, V.
        sign_velocity: Velocity within which the sign is smoothed, m/s.
        bump_velocity: Velocity at which the bump has fallen to 1/e, m/s.

    Source:
        Armstrong-Helouvry, Dupont, Canudas de Wit, "A survey of models, analysis tools and compensation methods for
        the control of machines with friction", Automatica 30 (1994) 1083-1138.

    Example:
        >>> Stribeck(per_newton=0.25, coulomb=2.0, bump=1.0, per_velocity=0.0, offset=0.0, sign_velocity=0.01,
        ...          bump_velocity=0.05).voltage(force=10.0, velocity=0.5)
        4.5
    """

    per_newton: float
    coulomb: float
    bump: float
    per_velocity: float
    offset: float
    sign_velocity: float = numbers(positive=True)
    bump_velocity: float = numbers(positive=True)

    @classmethod
    def fit(cls, samples: Samples, rig: RigConstants, *, seed: int = 0) -> Self:
        """Identify the seven numbers on the training part by least squares."""
        force, velocity = samples.force[samples.train], samples.velocity[samples.train]
        voltage = samples.voltage[samples.train]
        bumps = {width: np.exp(-((velocity / width) ** 2)) for width in BUMP_VELOCITIES.tolist()}
        fixed = np.column_stack([force, velocity, np.ones_like(force)])

        def solve(sign_velocity: float, bump_velocity: float) -> tuple[float, Array]:
            sign = np.tanh(velocity / sign_velocity)
            columns = np.column_stack([fixed, sign, sign * bumps[bump_velocity]])
            gram = columns.T @ columns
            ridge = 1e-12 * max(np.trace(gram), 1e-300) * np.eye(5)  # a rig that stood still has no velocities
            coefficients = np.linalg.solve(gram + ridge, columns.T @ voltage)
            return float(np.mean((voltage - columns @ coefficients) ** 2)), coefficients

        widths = [(a, b) for a in SIGN_VELOCITIES.tolist() for b in BUMP_VELOCITIES.tolist()]
        best = min(widths, key=lambda pair: solve(*pair)[0])
        per_newton, per_velocity, offset, coulomb, bump = solve(*best)[1].tolist()
        return cls(per_newton, coulomb, bump, per_velocity, offset, *best)

    def volts(self, force: Signal, velocity: Signal, previous_velocity: Signal) -> Signal:
        """Sum of the terms."""
        (sign,) = elementwise(np.tanh, [velocity / self.sign_velocity])
        share = velocity / self.bump_velocity
        (bump,) = elementwise(np.exp, [-(share * share)])
        level = self.coulomb + self.bump * bump
        return self.per_newton * force + level * sign + self.per_velocity * velocity + self.offset
