"""Commands act late."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence

import mujoco

from dipc_gym import mjcf
from dipc_gym.mjcf.edit import Document
from dipc_gym.sim2real.effects.shared.base import Effect, Evidence, Parameter, Values


class Delay(Effect):
    """A pure delay between a command's time stamp and its effect."""

    id = "timing.delay"
    place = "actuator"
    linear = ("delay",)
    parameters = (Parameter("delay", "s", 0.0, 0.2),)
    rivals = ("timing.sensor_lag:delay", "motor.inductance", "timing.sensor_lag", "transmission.compliance")

    def guesses(self, evidence: Evidence) -> Sequence[Values]:
        """Shorter and longer ones."""
        return delays(evidence, self.own(evidence.model, evidence.at))

    def own(self, model: mujoco.MjModel, at: str) -> float:
        """The actuator's delay."""
        return float(model.actuator_delay[model.actuator(at).id])

    def edit(self, document: Document, at: str, values: Values) -> None:
        """The actuator's delay."""
        delay = mjcf.with_delay(values["delay"], document.timestep, document.get_option("integrator"))
        set_delay(document, document.actuator(at), delay)

    def sentence(self, at: str, values: Values, unit: Mapping[str, str]) -> str:
        """In words."""
        return f"Commands to {at} act {1e3 * values['delay']:.3g} ms late."


def delays(evidence: Evidence, own: float) -> Sequence[Values]:
    """A quarter of a sample, two samples, and ten milliseconds, more than the model has; and half of what it has."""
    more = sorted({0.25 * evidence.period, 2 * evidence.period, 0.01})
    return [{"delay": d} for d in ([0.5 * own] if own > 0 else []) + [own + d for d in more]]


def set_delay(document: Document, element: ET.Element, delay: float) -> None:
    """Delay an actuator or a sensor, with as many samples of history as that needs."""
    document.set(element, delay=delay, interp="linear", nsample=str(int(delay / document.timestep) + 3))
