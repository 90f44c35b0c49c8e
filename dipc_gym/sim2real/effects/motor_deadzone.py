"""The amplifier ignores small commands."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from dipc_gym.mjcf.edit import Document
from dipc_gym.sim2real.effects.shared.base import Effect, Evidence, Parameter, Values


class Deadzone(Effect):
    """A dead zone: commands below a width do nothing, larger ones are shortened by it."""

    id = "motor.deadzone"
    place = "actuator"
    linear = ("width",)
    parameters = (Parameter("width", "command", 0.0),)
    rivals = ("friction.coulomb", "transmission.backlash")
    needs_loader = True

    def guesses(self, evidence: Evidence) -> Sequence[Values]:
        """A twentieth of the command."""
        size = float(np.sqrt(np.mean(evidence.command**2))) if len(evidence.command) else 1.0
        return [{"width": 0.05 * size}]

    def edit(self, document: Document, at: str, values: Values) -> None:
        """An entry for the loader."""
        document.custom(self.id, at, [values["width"]])

    def sentence(self, at: str, values: Values, unit: Mapping[str, str]) -> str:
        """In words."""
        width = f"{values['width']:.3g} {unit['width']}".strip()
        return f"A dead zone in {at}: commands below {width} do nothing."
