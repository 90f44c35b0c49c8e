"""A constant force."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from dipc_gym.mjcf.edit import Document
from dipc_gym.sim2real.effects.shared.base import Effect, Evidence, Parameter, Values, passive_force


class Constant(Effect):
    """A force that always pulls the same way: a cable, an unbalanced weight, an offset of the amplifier."""

    id = "load.constant"
    place = "joint"
    linear = ("force",)
    parameters = (Parameter("force", "N"),)
    rivals = ("load.tilt", "friction.asymmetric", "sensor.bias")

    def guesses(self, evidence: Evidence) -> Sequence[Values]:
        """Mean of the unexplained force."""
        force = float(np.mean(evidence.force))
        return [{"force": force if abs(force) > 0.02 * evidence.force_scale else 0.1 * evidence.force_scale}]

    def edit(self, document: Document, at: str, values: Values) -> None:
        """A passive force on the joint."""
        passive_force(document, f"{at}_load", at, values["force"])

    def sentence(self, at: str, values: Values, unit: Mapping[str, str]) -> str:
        """In words."""
        return f"A constant force of {values['force']:.3g} {unit['force']} on {at}."
