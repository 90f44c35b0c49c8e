"""A sensor reads late."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import mujoco

from dipc_gym.mjcf.edit import Document
from dipc_gym.sim2real.effects.shared.base import Effect, Evidence, Parameter, Values
from dipc_gym.sim2real.effects.timing_delay import delays, set_delay


class SensorDelay(Effect):
    """A pure delay between a quantity and its reading: a bus, a camera, a buffer."""

    id = "timing.sensor_lag:delay"
    place = "sensor"
    linear = ("delay",)
    parameters = (Parameter("delay", "s", 0.0, 0.05),)
    rivals = ("timing.sensor_lag", "timing.delay", "motor.inductance", "transmission.compliance")
    moves_readings = True

    def guesses(self, evidence: Evidence) -> Sequence[Values]:
        """Shorter and longer ones."""
        return delays(evidence, self.own(evidence.model, evidence.at))

    def own(self, model: mujoco.MjModel, at: str) -> float:
        """The sensor's delay."""
        return float(model.sensor_delay[model.sensor(at).id])

    def edit(self, document: Document, at: str, values: Values) -> None:
        """The sensor's delay."""
        set_delay(document, document.sensor(at), values["delay"])

    def sentence(self, at: str, values: Values, unit: Mapping[str, str]) -> str:
        """In words."""
        return f"Sensor {at} reads {1e3 * values['delay']:.3g} ms late."
