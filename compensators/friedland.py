"""Friedland and Park's adaptive compensator: one number, the Coulomb level, learned on the run."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np

from dipc_gym.compensators.base import Array, RigConstants, Samples, numbers
from dipc_gym.compensators.memory import FRESH, Remembering, given, gone_on, just_reset, known_mass

if TYPE_CHECKING:
    from dipc_gym.dataflow import Program, Value

RATES = np.geomspace(0.3, 100.0, 16)  # of learning, of which the run chooses
WIDTHS = np.geomspace(1e-3, 0.1, 11)  # m/s, of the smooth sign, of which the run chooses


@dataclass(frozen=True)
class Friedland(Remembering):
    """Coulomb friction whose level is observed from the motion that it spoils (`friedland`).

        friction = a s(v),  s = tanh(v / sign_velocity),
        a(k) = a(k-1) + rate T s (force expected of the motor - friction - inertia - viscous drag).

    It is the published observer with exponent one, sampled, with the force of inertia from the change of velocity. The
    level stays between 0 and what the motor can exert. Rate, width of the sign and first level are those with which it
    would have foreseen the run's friction best. It knows the cart's mass with the poles locked; free poles make the
    cart seem a third lighter, which the observer takes for friction while the cart accelerates.

    Memory: level, last velocity, last voltage.

    Attributes:
        level: Coulomb level after a reset, N.
        rate: of learning, 1/s.
        sign_velocity: Velocity within which the sign is smoothed, m/s.
        mass: kg.
        viscous: N s/m.

    Source:
        Friedland, Park, "On adaptive friction compensation", IEEE Transactions on Automatic Control 37 (1992)
        1609-1612.
    """

    remembers_voltage: ClassVar[bool] = True

    level: float = numbers()
    rate: float = numbers(positive=True)
    sign_velocity: float = numbers(positive=True)
    mass: float = numbers(positive=True)
    viscous: float = numbers()

    @classmethod
    def fit(cls, samples: Samples, rig: RigConstants, *, seed: int = 0) -> Self:
        """Try 16 rates and 11 widths along the training part, all side by side.

        Raises:
            ValueError: The rig's mass is not known.
        """
        mass = known_mass(rig, "friedland")
        rates, widths = (grid.ravel() for grid in np.meshgrid(RATES, WIDTHS))
        lost = rig.newtons_per_volt * samples.voltage - samples.force
        signs = np.tanh(samples.velocity[:, None] / widths)
        weight = samples.train.astype(float)[:, None]
        first = np.sum(weight * signs * lost[:, None], axis=0) / np.maximum(np.sum(weight * signs**2, axis=0), 1e-12)
        level, error = np.maximum(first, 0.0), np.zeros(len(rates))
        for sign, force, counts in zip(signs, lost, samples.train, strict=True):
            miss = force - level * sign
            error += counts * miss * miss
            level = np.clip(level + np.minimum(rates * rig.period, 1.0) * sign * miss, 0.0, None)
        best = int(np.argmin(error))
        first_level = float(max(first[best], 0.0))
        return cls(*given(rig), first_level, float(rates[best]), float(widths[best]), mass, rig.viscous)

    def begin(self, n: int) -> Array:
        """The trained level, no motion known, no voltage."""
        return np.tile([self.level, FRESH, 0.0], (n, 1))

    def respond(self, force: Array, velocity: Array, memory: Array) -> tuple[Array, Array]:
        """Learn from the past period, then compensate in the coming one."""
        fresh = just_reset(memory[:, 1])
        before = gone_on(memory[:, 1], velocity)
        volts, level = self.learned(force, velocity, memory[:, 0], before, memory[:, 2], fresh)
        return volts, np.stack([level, velocity, volts], axis=1)

    def express(self, program: Program, force: Value, velocity: Value) -> Value:
        """Write it into a program that can be exported: the same formula, on values of the program."""
        before = program.previous("velocity_before", velocity)
        memory = [program.state(name, first) for name, first in (("level", self.level), ("applied", 0.0))]
        volts, level = self.learned(force, velocity, memory[0], before, memory[1], program.first())
        for state, value in zip(memory, (level, volts), strict=True):
            program.update(state, value)
        return volts

    def learned(self, force: Any, velocity: Any, level: Any, before: Any, volts: Any, fresh: Any) -> tuple[Any, Any]:
        """Voltage (n,) and the level (n,) that was learned from the past period; where that is not known, as it was."""
        inertia = self.mass * (velocity - before) / self.period
        speed = 0.5 * (velocity + before)
        sign = np.tanh(speed / self.sign_velocity)
        miss = self.newtons_per_volt * volts - self.viscous * speed - inertia - level * sign
        most = self.newtons_per_volt * self.supply_voltage
        rate = np.minimum(self.rate * self.period, 1.0)
        level = (level + (1.0 - fresh) * rate * sign * miss).clip(0.0, most)
        friction = level * np.tanh(velocity / self.sign_velocity)
        return ((force + friction) / self.newtons_per_volt).clip(-self.supply_voltage, self.supply_voltage), level
