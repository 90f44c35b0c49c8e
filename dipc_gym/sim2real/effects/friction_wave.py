"""Dry friction that comes and goes along the way."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from dipc_gym.mjcf.edit import Document
from dipc_gym.sim2real.effects.shared.base import Effect, Evidence, Parameter, Values, dry_beside
from dipc_gym.sim2real.effects.shared.settings import EFFECTS
from dipc_gym.sim2real.effects.shared.waves import waves


class Uneven(Effect):
    """Coulomb friction whose level is a wave over position: a screw, a belt's teeth, a shaft that is not round."""

    id = "friction.position:wave"
    place = "joint"
    one_of = "dry friction"
    parameters = (
        Parameter("level", "N", 0.0),
        Parameter("sine", "N"),
        Parameter("cosine", "N"),
        Parameter("wavelength", "m", 1e-9, log=True, fine=EFFECTS.fine),
    )
    levels = ("level",)
    rivals = ("friction.position", "load.position", "friction.coulomb", "friction.load")
    contains = ("friction.coulomb",)
    needs_loader = True

    def guesses(self, evidence: Evidence) -> Sequence[Values]:
        """The waves that explain most of what opposes motion now more, now less."""
        return [{"level": evidence.dry_level} | wave for wave in waves(evidence, 2.0, -evidence.direction)]

    def edit(self, document: Document, at: str, values: Values) -> None:
        """An entry for the loader; stock MuJoCo gets the mean level."""
        dry_beside(document, at, values["level"])
        document.custom("friction.wave", at, [values[p.name] for p in self.parameters])

    def sentence(self, at: str, values: Values, unit: Mapping[str, str]) -> str:
        """In words."""
        size = float(np.hypot(values["sine"], values["cosine"]))
        return (
            f"Dry friction of {values['level']:.3g} {unit['level']} at {at} that comes and goes by up to "
            f"{size:.3g} {unit['sine']} every {values['wavelength']:.3g} {unit['wavelength']}."
        )
