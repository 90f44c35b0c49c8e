"""Commands act late."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from dipc_gym.sim2real.document import Document
from dipc_gym.sim2real.effects.base import Effect, Evidence, Parameter, Values


class Delay(Effect):
    """A pure delay between a command's time stamp and its effect."""

    id = "timing.delay"
    place = "actuator"
    linear = ("delay",)
    parameters = (Parameter("delay", "s", 0.0, 0.2),)
    rivals = ("timing.sensor_lag:delay", "motor.inductance", "timing.sensor_lag", "transmission.compliance")

    def guesses(self, evidence: Evidence) -> Sequence[Values]:
        """A quarter of a sample, two samples, and ten milliseconds."""
        return [{"delay": d} for d in sorted({0.25 * evidence.period, 2 * evidence.period, 0.01})]

    def edit(self, document: Document, at: str, values: Values) -> None:
        """The actuator's delay, with as many samples of history as it needs."""
        document.set(
            document.actuator(at),
            delay=values["delay"],
            interp="linear",
            nsample=str(int(values["delay"] / document.timestep) + 3),
        )

    def sentence(self, at: str, values: Values, unit: Mapping[str, str]) -> str:
        """In words."""
        return f"Commands to {at} act {1e3 * values['delay']:.3g} ms late."
