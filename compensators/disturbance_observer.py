"""The classical disturbance observer: what the motor gave and the motion did not get was friction."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np

from dipc_gym.compensators.base import Array, RigConstants, Samples, numbers
from dipc_gym.compensators.memory import FRESH, Remembering, given, gone_on, just_reset, known_mass

if TYPE_CHECKING:
    from dipc_gym.dataflow import Program, Value

SHARES = np.linspace(0.05, 1.0, 20)  # of what is felt anew that the observer takes on in a period; the run chooses


@dataclass(frozen=True)
class DisturbanceObserver(Remembering):
    """Add the low-passed force that inertia and viscous drag do not account for (`disturbance_observer`).

        d(k) = d(k-1) + share (gain u(k-1) - viscous v - mass (v(k) - v(k-1)) / T - d(k-1)),  volts = (F + d) / gain.

    It knows the cart with its poles locked, and a velocity, no more; the estimator `disturbance` with the compensator
    `observed` is the same idea with the whole rig's model. The share is the one that foresees the run's friction best.
    What it adds stays within the supply. Memory: d, last velocity, last voltage.

    Attributes:
        share: of the low-pass filter, how much of a new value is taken at once, 0 to 1.
        mass: kg.
        viscous: N s/m.

    Source:
        Ohnishi, Shibata, Murakami, "Motion control for advanced mechatronics", IEEE/ASME Transactions on Mechatronics
        1 (1996) 56-67.
    """

    remembers_voltage: ClassVar[bool] = True

    share: float = numbers(positive=True)
    mass: float = numbers(positive=True)
    viscous: float = numbers()

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.share > 1:
            raise ValueError(f"share is {self.share}; a filter's share is at most 1")

    @classmethod
    def fit(cls, samples: Samples, rig: RigConstants, *, seed: int = 0) -> Self:
        """Try twenty shares along the training part.

        Raises:
            ValueError: The rig's mass is not known.
        """
        mass = known_mass(rig, "disturbance_observer")
        v, lost = samples.velocity, rig.newtons_per_volt * samples.voltage - samples.force
        speed, change = 0.5 * (v[1:] + v[:-1]), np.diff(v)
        felt = rig.newtons_per_volt * samples.voltage[:-1] - rig.viscous * speed - mass * change / rig.period
        observed, error = np.zeros(len(SHARES)), np.zeros(len(SHARES))
        for force, truth, counts in zip(felt, lost[1:], samples.train[1:], strict=True):
            observed = observed + SHARES * (force - observed)
            error += counts * (truth - observed) ** 2
        return cls(*given(rig), float(SHARES[np.argmin(error)]), mass, rig.viscous)

    def begin(self, n: int) -> Array:
        """Nothing observed, no motion known, no voltage."""
        return np.tile([0.0, FRESH, 0.0], (n, 1))

    def respond(self, force: Array, velocity: Array, memory: Array) -> tuple[Array, Array]:
        """Observe the past period, compensate in the coming one."""
        fresh = just_reset(memory[:, 1])
        volts, observed = self.felt(force, velocity, memory[:, 0], gone_on(memory[:, 1], velocity), memory[:, 2], fresh)
        return volts, np.stack([observed, velocity, volts], axis=1)

    def express(self, program: Program, force: Value, velocity: Value) -> Value:
        """Write it into a program that can be exported: the same formula, on values of the program."""
        before = program.previous("velocity_before", velocity)
        memory = [program.state(name, 0.0) for name in ("disturbance", "applied")]
        volts, observed = self.felt(force, velocity, memory[0], before, memory[1], program.first())
        for state, value in zip(memory, (observed, volts), strict=True):
            program.update(state, value)
        return volts

    def felt(self, force: Any, velocity: Any, observed: Any, before: Any, volts: Any, fresh: Any) -> tuple[Any, Any]:
        """Voltage (n,) and what is observed (n,), N, after the past period; where that is not known, nothing anew."""
        felt = self.newtons_per_volt * volts - self.viscous * 0.5 * (velocity + before)
        felt = felt - self.mass * (velocity - before) / self.period
        most = self.newtons_per_volt * self.supply_voltage
        observed = (observed + (1.0 - fresh) * self.share * (felt - observed)).clip(-most, most)
        return ((force + observed) / self.newtons_per_volt).clip(-self.supply_voltage, self.supply_voltage), observed
