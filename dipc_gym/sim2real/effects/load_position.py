"""A force that varies along the way."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from dipc_gym.mjcf.edit import Document
from dipc_gym.sim2real.effects.shared.base import Effect, Evidence, Parameter, Values, passive_wave
from dipc_gym.sim2real.effects.shared.settings import EFFECTS
from dipc_gym.sim2real.effects.shared.waves import waves


class Wave(Effect):
    """A force that depends on position and repeats along it: a rack's teeth, an unbalanced pulley, a wavy rail."""

    id = "load.position"
    place = "joint"
    linear = ("sine", "cosine")
    parameters = (
        Parameter("sine", "N"),
        Parameter("cosine", "N"),
        Parameter("wavelength", "m", 0.0, log=True, fine=EFFECTS.fine),
    )
    rivals = ("motor.cogging", "load.spring", "friction.position")
    contains = ("load.constant", "load.spring")

    def guesses(self, evidence: Evidence) -> Sequence[Values]:
        """The wavelengths that explain most of the force."""
        return waves(evidence, 0.5)

    def edit(self, document: Document, at: str, values: Values) -> None:
        """A passive force that is a sine of position."""
        size, phase = np.hypot(values["sine"], values["cosine"]), np.arctan2(values["cosine"], values["sine"])
        passive_wave(document, f"{at}_wave", at, float(size), 2 * np.pi / values["wavelength"], float(phase))

    def sentence(self, at: str, values: Values, unit: Mapping[str, str]) -> str:
        """In words."""
        size = float(np.hypot(values["sine"], values["cosine"]))
        return (
            f"A force of up to {size:.3g} {unit['sine']} at {at} that repeats every "
            f"{values['wavelength']:.3g} {unit['wavelength']}."
        )
