"""Dry friction whose level is any function of position."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from dipc_gym.mjcf.edit import Document
from dipc_gym.sim2real.effects.base import Evidence, Values, dry
from dipc_gym.sim2real.effects.law import Array, Law
from dipc_gym.sim2real.effects.settings import LAWS
from dipc_gym.sim2real.effects.tables import grow


class FrictionOfPosition(Law):
    """Coulomb friction with a level for each place: a stiff spot, a worn stretch, a bent rail."""

    id = "friction.position:law"
    place = "joint"
    law = "dry friction"
    of, slide = "position", "m"
    kind = "dry friction"
    unit = "N"
    lowest = 0.0
    rivals = ("friction.speed", "load.position:law")
    contains = ("friction.coulomb", "friction.position", "friction.position:wave")
    needs_loader = True

    def __init__(self, knots: Sequence[float] = (), values: Sequence[float] = ()) -> None:
        super().__init__(knots, values)
        self.levels = self.linear

    def table(self, evidence: Evidence) -> tuple[Array, Array]:
        """Force that opposes motion, by position."""
        beside = [np.ones_like(evidence.force), evidence.velocity]
        knots, more = grow(evidence.position, evidence.force, -evidence.direction, beside, evidence.time)
        level = 0.0 if evidence.level is None else evidence.level
        return knots, np.maximum(level + more, 0.05 * evidence.dry_level)

    def edit(self, document: Document, at: str, values: Values) -> None:
        """A table for the loader; stock MuJoCo gets the mean level."""
        levels = self.values(values)
        mean = np.trapezoid(levels, self.knots) / (self.knots[-1] - self.knots[0])
        dry(document, at, max(float(mean), 1e-9))
        even = np.linspace(self.knots[0], self.knots[-1], LAWS.narrowest + 1)  # every knot is one of these
        document.custom("friction.position", at, [even[0], even[-1], *np.interp(even, self.knots, levels)])

    def sentence(self, at: str, values: Values, unit: Mapping[str, str]) -> str:
        """In words."""
        return f"Dry friction at {at} that depends on position: {self.where(values, unit)} {self.per(unit)}."
