"""A force that is any function of position."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from dipc_gym.mjcf.edit import Document
from dipc_gym.sim2real.effects.shared.base import Evidence, Values
from dipc_gym.sim2real.effects.shared.law import Array, Law
from dipc_gym.sim2real.effects.shared.tables import force_of_position, grow


class ForceOfPosition(Law):
    """A force that depends on where a joint is: a cable, a spring that stiffens, a catch, a weight on a cam."""

    id = "load.position:law"
    place = "joint"
    of, slide = "position", "m"
    kind = "force"
    unit = "N"
    rivals = ("friction.position:law", "motor.cogging")
    contains = ("load.constant", "load.spring", "load.position")

    def table(self, evidence: Evidence) -> tuple[Array, Array]:
        """The unexplained force by position, beside what goes with velocity."""
        return grow(
            evidence.position,
            evidence.force,
            np.ones_like(evidence.force),
            [evidence.velocity, evidence.direction],
            evidence.time,
            evidence.width,
        )

    def edit(self, document: Document, at: str, values: Values) -> None:
        """A ramp for each stretch."""
        force_of_position(document, f"{at}_force", at, self.knots, self.values(values))

    def sentence(self, at: str, values: Values, unit: Mapping[str, str]) -> str:
        """In words."""
        return f"A force at {at} that depends on position: {self.where(values, unit)} {self.per(unit)}."
