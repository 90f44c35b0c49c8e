"""Dry friction that changes while the rig runs."""

from __future__ import annotations

from collections.abc import Mapping

from dipc_gym.sim2real.effects.shared.base import Evidence, Values
from dipc_gym.sim2real.effects.shared.law import Array, FrictionLaw


class FrictionOfTime(FrictionLaw):
    """Coulomb friction with a level for each time since the recording began: grease that warms up, a brake that wears.

    After the last time that it was fitted to it stays as it is, so that what still changes then is told by validation
    data. Other recordings share it if they begin as the fitted ones did, with the rig as cold.
    """

    id = entry = "friction.time"
    of, slide = "time", "s"
    of_the_clock = True
    rivals = ("friction.coulomb", "friction.speed", "motor.thermal")
    contains = ("friction.coulomb",)

    def seen(self, evidence: Evidence) -> Array:
        """The recording's clock."""
        return evidence.time

    def in_stock(self, levels: Array) -> float:
        """What it ends at."""
        return float(levels[-1])

    def sentence(self, at: str, values: Values, unit: Mapping[str, str]) -> str:
        """In words."""
        levels = self.values(values)
        return (
            f"Dry friction at {at} that changes while the rig runs: from {levels[0]:.3g} to {levels[-1]:.3g} "
            f"{unit[self.parameters[0].name]} in {self.knots[-1] - self.knots[0]:.3g} s."
        )
