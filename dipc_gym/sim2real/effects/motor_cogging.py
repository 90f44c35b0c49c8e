"""The motor's magnets pull at its teeth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import mujoco
import numpy as np

from dipc_gym.mjcf.edit import Document
from dipc_gym.sim2real.effects.shared.base import Effect, Evidence, Parameter, Values, is_dcmotor
from dipc_gym.sim2real.effects.shared.settings import EFFECTS
from dipc_gym.sim2real.effects.shared.waves import waves


class Cogging(Effect):
    """Cogging torque of a DC motor, a sine of the rotor's angle."""

    id = "motor.cogging"
    place = "actuator"
    linear = ("sine", "cosine")
    parameters = (
        Parameter("sine", "N m"),
        Parameter("cosine", "N m"),
        Parameter("poles", "", 0.0, log=True, fine=EFFECTS.fine),
    )
    rivals = ("load.position", "load.spring")

    def fits(self, model: mujoco.MjModel, at: str) -> bool:
        """On a DC motor, at the rotor's own angle."""
        return is_dcmotor(model, at)

    def guesses(self, evidence: Evidence) -> Sequence[Values]:
        """Waves over position of at least one a turn."""
        gear = abs(evidence.gear) or 1.0
        turns = np.sign(evidence.gear) or 1.0  # which way the rotor goes when the joint goes forwards
        return [
            {
                "sine": w["sine"] / gear,
                "cosine": turns * w["cosine"] / gear,
                "poles": 2 * np.pi / w["wavelength"] / gear,
            }
            for w in waves(evidence, 1.0)
        ]

    def own(self, model: mujoco.MjModel, at: str) -> float:
        """Amplitude of the cogging that the motor has."""
        return float(model.actuator_biasprm[model.actuator(at).id, 0])

    def edit(self, document: Document, at: str, values: Values) -> None:
        """The motor's cogging attribute."""
        size, phase = np.hypot(values["sine"], values["cosine"]), np.arctan2(values["cosine"], values["sine"])
        document.set(document.actuator(at), cogging=(float(size), values["poles"], float(phase)))

    def sentence(self, at: str, values: Values, unit: Mapping[str, str]) -> str:
        """In words."""
        size = float(np.hypot(values["sine"], values["cosine"]))
        return f"Cogging of {at}: up to {size:.3g} {unit['sine']}, {values['poles']:.3g} times a turn."
