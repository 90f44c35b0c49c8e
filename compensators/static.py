"""The two ends of the scale: no compensation at all, and the exact friction of the simulation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from dipc_gym.compensators.base import Array, Compensator, RigConstants, Samples, Signal, numbers


@dataclass(frozen=True)
class StaticGain(Compensator):
    """No compensation (`none`): volts = force / (newtons per volt).

    Example:
        >>> StaticGain(newtons_per_volt=4.0).voltage(force=10.0, velocity=0.3)
        2.5
    """

    newtons_per_volt: float = numbers(positive=True)

    @classmethod
    def fit(cls, samples: Samples, rig: RigConstants, *, seed: int = 0) -> Self:
        """Take the motor gain from the rig; the samples are not looked at."""
        return cls(rig.newtons_per_volt)

    @property
    def parameters(self) -> int:
        """Count of learned numbers: none, the motor gain is given."""
        return 0

    def volts(self, force: Signal, velocity: Signal, previous_velocity: Signal) -> Signal:
        """Divide by the motor gain."""
        return force / self.newtons_per_volt


@dataclass(frozen=True)
class Ideal(Compensator):
    """What no rig can have: the motor adds exactly the dry friction of the simulation (`ideal`, the bound).

    It wants the true friction with every call: `friction` in N is the force by which dry friction holds the
    cart back, positive when it resists motion towards +x (minus the friction force that acts on the cart).
    It holds for the instant of the call; during the control period that follows, friction may change.

    Example:
        >>> Ideal(newtons_per_volt=4.0).voltage(force=10.0, velocity=0.3, friction=8.0)
        4.5
    """

    needs_friction: ClassVar[bool] = True

    newtons_per_volt: float = numbers(positive=True)

    @classmethod
    def fit(cls, samples: Samples, rig: RigConstants, *, seed: int = 0) -> Self:
        """Take the motor gain from the rig; the samples are not looked at."""
        return cls(rig.newtons_per_volt)

    @property
    def parameters(self) -> int:
        """Count of learned numbers: none, the motor gain is given."""
        return 0

    def volts(self, force: Signal, velocity: Signal, previous_velocity: Signal) -> Signal:
        """Divide by the motor gain; `force` already has the friction added."""
        return force / self.newtons_per_volt

    def voltage(self, force: float, velocity: float, friction: float | None = None) -> float:
        """Return the voltage that gives the wanted force on top of the friction.

        Args:
            force: Force wanted on the cart, N.
            velocity: Cart velocity now, m/s.
            friction: Force by which dry friction holds the cart back now, N.

        Raises:
            TypeError: No friction given.
        """
        return super().voltage(force + _known(friction), velocity)

    def voltage_batch(
        self, force: Array, velocity: Array, state: Array, friction: Array | None = None
    ) -> tuple[Array, Array]:
        """Return the voltages (n,) for many rigs, given the friction (n,) in N of each; see `voltage`.

        Raises:
            TypeError: No friction given.
        """
        with np.errstate(invalid="ignore", over="ignore"):
            wanted = np.asarray(force) + _known(friction)
        return super().voltage_batch(wanted, velocity, state)


def _known(friction: Signal | None) -> Signal:
    if friction is None:
        raise TypeError("the ideal compensator needs the true friction: pass friction=... in newtons")
    return friction
