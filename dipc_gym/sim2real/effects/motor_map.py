"""An amplifier that makes of a command any function of it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from dipc_gym.sim2real.effects.shared.base import Evidence, Values
from dipc_gym.sim2real.effects.shared.drives import drive_of
from dipc_gym.sim2real.effects.shared.law import Array, Map
from dipc_gym.sim2real.effects.shared.tables import grow


class CommandMap(Map):
    """A map from the command that was sent to the one that acts: an amplifier with a bent characteristic."""

    id = "motor.map"
    place = "actuator"
    one_of = "command"
    of, kind, unit = "command", "command that acts", "command"
    rivals = ("motor.deadzone", "motor.saturation")
    contains = ("motor.deadzone", "motor.saturation")
    at_its_joint = ("load.constant",)  # one that shifts all commands alike

    def table(self, evidence: Evidence) -> tuple[Array, Array] | None:
        """The unexplained force by command, in commands."""
        gain, _ = drive_of(evidence.model, evidence.at)
        if not gain or not len(evidence.command) or np.ptp(evidence.command) == 0:
            return None
        beside = [evidence.velocity, evidence.direction]
        knots, more = grow(
            evidence.command, evidence.force / gain, np.ones_like(evidence.force), beside, evidence.time, evidence.width
        )
        return knots, knots + more

    def sentence(self, at: str, values: Values, unit: Mapping[str, str]) -> str:
        """In words."""
        off = np.subtract(self.values(values), self.knots)
        k = int(np.argmax(np.abs(off)))
        name = unit[self.parameters[0].name]
        acts = f"{self.knots[k]:.3g} acts as {self.knots[k] + off[k]:.3g} {name}".strip()
        return f"{at} does not act in proportion to its command: {acts}."
