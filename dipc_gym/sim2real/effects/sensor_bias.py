"""A sensor is off by a constant."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from dipc_gym.mjcf.edit import Document
from dipc_gym.sim2real.effects.shared.base import Effect, Evidence, Parameter, Values


class Bias(Effect):
    """A sensor whose zero is not where the model's is."""

    id = "sensor.bias"
    place = "sensor"
    linear = ("bias",)
    parameters = (Parameter("bias", "reading"),)
    rivals = ("load.constant", "load.tilt", "load.payload")
    needs_loader = True
    moves_readings = True

    def guesses(self, evidence: Evidence) -> Sequence[Values]:
        """A twentieth of the range."""
        return [{"bias": 0.05 * max(float(np.std(evidence.reading)), 1e-9)}]

    def edit(self, document: Document, at: str, values: Values) -> None:
        """An entry for the loader."""
        document.custom(self.id, at, [values["bias"]])

    def sentence(self, at: str, values: Values, unit: Mapping[str, str]) -> str:
        """In words."""
        return f"Sensor {at} reads {values['bias']:+.3g} {unit['bias']} too much."
