"""A sensor follows late."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from dipc_gym.mjcf.edit import Document
from dipc_gym.sim2real.effects.shared.base import Effect, Evidence, Parameter, Values
from dipc_gym.sim2real.effects.shared.settings import EFFECTS


class SensorLag(Effect):
    """A sensor whose filter follows its quantity with a time constant."""

    id = "timing.sensor_lag"
    place = "sensor"
    parameters = (Parameter("time_constant", "s", 2e-5, 0.2, log=True),)
    rivals = ("timing.sensor_lag:delay", "timing.delay", "motor.inductance", "transmission.compliance")
    warm = EFFECTS.warm
    finest = EFFECTS.fast  # between steps what it follows goes straight
    needs_loader = True
    moves_readings = True
    linear = ("time_constant",)  # the reading stays behind in proportion to it

    def guesses(self, evidence: Evidence) -> Sequence[Values]:
        """A short and a long one."""
        return [{"time_constant": 0.002}, {"time_constant": 0.01}]

    def edit(self, document: Document, at: str, values: Values) -> None:
        """An entry for the loader."""
        document.custom(self.id, at, [values["time_constant"]])

    def sentence(self, at: str, values: Values, unit: Mapping[str, str]) -> str:
        """In words."""
        return f"Sensor {at} lags with a time constant of {1e3 * values['time_constant']:.3g} ms."
