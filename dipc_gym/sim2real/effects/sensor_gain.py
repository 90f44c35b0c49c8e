"""A sensor is off by a factor."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from dipc_gym.mjcf.edit import Document
from dipc_gym.sim2real.effects.shared.base import Effect, Evidence, Parameter, Values


class Gain(Effect):
    """A sensor whose scale is wrong: a wrong count of lines, a stretched belt, a pulley of another radius."""

    id = "sensor.gain"
    place = "sensor"
    parameters = (Parameter("gain", "", 0.2, 5.0, log=True),)
    needs_loader = True
    moves_readings = True

    def guesses(self, evidence: Evidence) -> Sequence[Values]:
        """Two per cent more, two per cent less."""
        return [{"gain": 1.02}, {"gain": 1 / 1.02}]

    def edit(self, document: Document, at: str, values: Values) -> None:
        """An entry for the loader."""
        document.custom(self.id, at, [values["gain"]])

    def sentence(self, at: str, values: Values, unit: Mapping[str, str]) -> str:
        """In words."""
        return f"Sensor {at} reads {100 * (values['gain'] - 1):+.3g} % off scale."
