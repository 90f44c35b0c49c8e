"""Dry friction whose level is any function of position."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from dipc_gym.sim2real.effects.shared.base import Evidence, Values
from dipc_gym.sim2real.effects.shared.law import Array, FrictionLaw


class FrictionOfPosition(FrictionLaw):
    """Coulomb friction with a level for each place: a stiff spot, a worn stretch, a bent rail."""

    id = "friction.position:law"
    entry = "friction.position"
    of, slide = "position", "m"
    rivals = ("friction.speed", "load.position:law")
    contains = ("friction.coulomb", "friction.position", "friction.position:wave")

    def seen(self, evidence: Evidence) -> Array:
        """Where the joint is."""
        return evidence.position

    def in_stock(self, levels: Array) -> float:
        """The mean along the way."""
        return float(np.trapezoid(levels, self.knots) / (self.knots[-1] - self.knots[0]))

    def sentence(self, at: str, values: Values, unit: Mapping[str, str]) -> str:
        """In words."""
        return f"Dry friction at {at} that depends on position: {self.where(values, unit)} {self.per(unit)}."
