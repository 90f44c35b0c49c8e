"""Feed the friction forward that the estimator observes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from dipc_gym.compensators.static import Ideal


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
