"""The amplifier gives less than was asked."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from dipc_gym.sim2real.document import Document
from dipc_gym.sim2real.effects.base import Effect, Evidence, Parameter, Values


class Saturation(Effect):
    """A limit of the drive below the largest command that was sent."""

    id = "motor.saturation"
    place = "actuator"
    parameters = (Parameter("limit", "command", 0.0),)
    rivals = ("motor.back_emf", "drag.quadratic", "motor.thermal")

    def guesses(self, evidence: Evidence) -> Sequence[Values]:
        """Three shares of the largest command."""
        most = float(np.quantile(np.abs(evidence.command), 0.999)) if len(evidence.command) else 0.0
        return [{"limit": share * most} for share in (0.95, 0.8, 0.6)] if most > 0 else []

    def edit(self, document: Document, at: str, values: Values) -> None:
        """The actuator's control range."""
        document.set(document.actuator(at), ctrllimited="true", ctrlrange=(-values["limit"], values["limit"]))

    def sentence(self, at: str, values: Values, unit: Mapping[str, str]) -> str:
        """In words."""
        return f"{at} saturates at {values['limit']:.3g} {unit['limit']}, less than was commanded."
