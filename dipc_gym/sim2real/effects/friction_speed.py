"""Friction that is any function of speed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from dipc_gym.mjcf.edit import Document
from dipc_gym.sim2real.effects.shared.base import Effect, Evidence, Values, dry_beside
from dipc_gym.sim2real.effects.shared.law import BENT, Array, Law, first_levels
from dipc_gym.sim2real.effects.shared.tables import grow, odd_force_of_speed

SLOW = 0.05  # of the usual speed, below which an estimated velocity does not tell the direction of motion
AT_REST = 1e-3  # share of its speeds to which the law may be told apart near rest


class FrictionOfSpeed(Law):
    """Friction against motion whose size depends on speed alone, in whatever way; at rest it holds.

    Coulomb, Stribeck, viscous and quadratic laws are all such; this one has the shape that the data ask for.
    """

    id = "friction.speed"
    place = "joint"
    one_of = "dry friction"
    of, slide = "speed", "m/s"
    kind = "friction against motion"
    unit = "N"
    lowest = 0.0
    rivals = ("friction.position:law", "friction.asymmetric")
    contains = ("friction.coulomb", "friction.stribeck", "friction.viscous", "drag.quadratic")

    def __init__(self, knots: Sequence[float] = (), values: Sequence[float] = ()) -> None:
        super().__init__(knots, values)
        self.levels = self.linear[:1]

    def table(self, evidence: Evidence) -> tuple[Array, Array]:
        """Force that opposes motion, by speed."""
        moves = np.abs(evidence.velocity) > SLOW * evidence.speed_scale
        velocity, time = evidence.velocity[moves], evidence.time[moves]
        beside = [np.ones_like(velocity)]
        knots, more = grow(np.abs(velocity), evidence.force[moves], -np.sign(velocity), beside, time, evidence.width)
        knots[0] = 0.0
        return knots, first_levels(evidence, more)

    @property
    def narrowest(self) -> Array:
        """Near rest finer, for that is where a law of speed is steep (Stribeck)."""
        knots = np.array(self.knots)
        return np.minimum(super().narrowest, np.maximum(0.5 * knots[1:], knots[-1] * AT_REST))

    def shortened(self, values: Values, told: NDArray[np.bool_]) -> tuple[Effect, Values] | None:
        """The same law without speeds that no data tell; it begins at rest, whether they do or not."""
        return super().shortened(values, np.append(True, told[1:]))

    def _begun(self, knots: Array, values: Array, new: NDArray[np.bool_]) -> tuple[Effect, Values]:
        """The same law with these knots, of which some are new."""
        return super()._begun(knots, values + BENT * float(np.max(np.abs(values))) * new, new)

    def edit(self, document: Document, at: str, values: Values) -> None:
        """Dry friction of the level at rest, and what speed adds to it or takes away."""
        levels = self.values(values)
        dry_beside(document, at, levels[0])
        odd_force_of_speed(document, f"{at}_speed", at, self.knots, np.subtract(levels, levels[0]).tolist())

    def sentence(self, at: str, values: Values, unit: Mapping[str, str]) -> str:
        """In words."""
        levels, force = self.values(values), unit[self.parameters[0].name]
        most, per = self.knots[-1], self.per(unit)
        return (
            f"Friction at {at} that depends on speed: {levels[0]:.3g} {force} at rest, {min(levels):.3g} to "
            f"{max(levels):.3g} {force} up to {most:.3g} {per}."
        )
