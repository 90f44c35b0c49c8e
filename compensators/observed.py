"""Feed the friction forward that the estimator observes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from dipc_gym.compensators.static import Ideal

if TYPE_CHECKING:
    from dipc_gym.dataflow import Program, Value


@dataclass(frozen=True)
class Observed(Ideal):
    """The motor adds the friction that the estimator observes (`observed`): no law of friction, nothing learned here.

    It wants an estimator that observes friction, such as `disturbance`, and gets its estimate as `friction` with every
    call, positive when it resists motion towards +x.

    Example:
        >>> Observed(newtons_per_volt=4.0).voltage(force=10.0, velocity=0.3, friction=8.0)
        4.5
    """

    observed_friction: ClassVar[bool] = True

    def express(self, program: Program, force: Value, velocity: Value, friction: Value | None = None) -> Value:
        """Write it into a program that can be exported, with the friction that the estimator there observes, N."""
        if friction is None:
            raise TypeError("it wants the friction that an estimator observes")
        return (force + friction) / self.newtons_per_volt
