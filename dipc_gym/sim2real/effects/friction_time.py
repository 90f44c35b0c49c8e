"""Dry friction that changes while the rig runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from dipc_gym.mjcf.edit import Document
from dipc_gym.sim2real.effects.base import Evidence, Values, dry
from dipc_gym.sim2real.effects.law import Array, Law
from dipc_gym.sim2real.effects.settings import LAWS
from dipc_gym.sim2real.effects.tables import grow


class FrictionOfTime(Law):
    """Coulomb friction with a level for each time since the recording began: grease that warms up, a brake that wears.

    After the last time that it was fitted to it stays as it is, so that what still changes then is told by validation
    data. Other recordings share it if they begin as the fitted ones did, with the rig as cold.
    """

    id = "friction.time"
    place = "joint"
    law = "dry friction"
    of, slide = "time", "s"
    kind = "dry friction"
    unit = "N"
    lowest = 0.0
    of_the_clock = True
    rivals = ("friction.coulomb", "friction.speed", "motor.thermal")
    contains = ("friction.coulomb",)
    needs_loader = True

    def __init__(self, knots: Sequence[float] = (), values: Sequence[float] = ()) -> None:
        super().__init__(knots, values)
        self.levels = self.linear

    def table(self, evidence: Evidence) -> tuple[Array, Array]:
        """Force that opposes motion, by time."""
        beside = [np.ones_like(evidence.force), evidence.velocity]
        knots, more = grow(evidence.time, evidence.force, -evidence.direction, beside, evidence.time)
        level = 0.0 if evidence.level is None else evidence.level
        return knots, np.maximum(level + more, 0.05 * evidence.dry_level)

    def edit(self, document: Document, at: str, values: Values) -> None:
        """A table for the loader; stock MuJoCo gets the level that it ends at."""
        levels = self.values(values)
        dry(document, at, max(levels[-1], 1e-9))
        even = np.linspace(self.knots[0], self.knots[-1], LAWS.narrowest + 1)  # every knot is one of these
        document.custom(self.id, at, [even[0], even[-1], *np.interp(even, self.knots, levels)])

    def sentence(self, at: str, values: Values, unit: Mapping[str, str]) -> str:
        """In words."""
        levels = self.values(values)
        return (
            f"Dry friction at {at} that changes while the rig runs: from {levels[0]:.3g} to {levels[-1]:.3g} "
            f"{unit[self.parameters[0].name]} in {self.knots[-1] - self.knots[0]:.3g} s."
        )
