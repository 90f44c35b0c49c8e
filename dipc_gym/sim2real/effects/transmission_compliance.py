"""Motor and load are coupled softly."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import mujoco
import numpy as np

from dipc_gym.mjcf.edit import Document
from dipc_gym.sim2real.effects.shared.base import Effect, Evidence, Parameter, Values
from dipc_gym.sim2real.effects.shared.coupling import can_split, couple, rotor_guesses, split
from dipc_gym.sim2real.effects.shared.settings import EFFECTS


class Compliance(Effect):
    """A belt or shaft that gives way: rotor and load swing against each other."""

    id = "transmission.compliance"
    place = "actuator"
    one_of = "rotor"
    parameters = (
        Parameter("stiffness", "N/m", 1e-9, log=True),
        Parameter("damping", "N s/m", 1e-12, log=True),
        Parameter("rotor_inertia", "kg", 1e-12, log=True),
    )
    rivals = ("transmission.backlash", "motor.inductance", "timing.delay", "timing.sensor_lag")
    finest = EFFECTS.fast
    warm = EFFECTS.swing

    def fits(self, model: mujoco.MjModel, at: str) -> bool:
        """Where a motor drives a joint."""
        return can_split(model, at)

    def guesses(self, evidence: Evidence) -> Sequence[Values]:
        """Resonances at two frequencies."""
        found = []
        (small,) = rotor_guesses(evidence, (0.2,))
        for hertz in (8.0, 25.0):
            stiffness = small * (2 * np.pi * hertz) ** 2
            found.append(
                {
                    "stiffness": stiffness,
                    "damping": 0.2 * float(np.sqrt(stiffness * small)),
                    "rotor_inertia": small,
                }
            )
        return found

    def edit(self, document: Document, at: str, values: Values) -> None:
        """A rotor beside the load, and a spring between them."""
        rotor, load = split(document, at, values["rotor_inertia"])
        couple(document, f"{at}_coupling", rotor, load, values["stiffness"], values["damping"])

    def sentence(self, at: str, values: Values, unit: Mapping[str, str]) -> str:
        """In words."""
        return f"A soft coupling of {values['stiffness']:.3g} {unit['stiffness']} between {at} and what it drives."
