"""Dry friction that grows with the load, and is larger at rest than in motion."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from dipc_gym.mjcf.edit import Document
from dipc_gym.sim2real.effects.friction_load import UnderLoad
from dipc_gym.sim2real.effects.shared.base import Effect, Evidence, Parameter, Values, dry_beside

ENTRY = "friction.load_stribeck"  # of <custom>: ids of effects have no colon there


class UnderLoadStribeck(Effect):
    """Friction under load that weakens with speed: as `friction.load` in motion, and more of it at rest.

    (level + by_drive |drive| + by_weight |weight|) (1 + excess exp(-(v / velocity)^2)): a gear under load that sticks,
    as in the servo models of Duclusaud et al. (BAM, 2024).
    """

    id = "friction.load:stribeck"
    place = "joint"
    one_of = "dry friction"
    parameters = (
        *UnderLoad.parameters,
        Parameter("excess", "", 0.0, 10.0),
        Parameter("velocity", "m/s", 1e-4, log=True),
    )
    levels = ("level",)
    rivals = ("friction.load", "friction.stribeck", "friction.resting")
    contains = ("friction.coulomb", "friction.load", "friction.stribeck")
    needs_loader = True

    def guesses(self, evidence: Evidence) -> Sequence[Values]:
        """Friction under load as it is guessed there, a third of it more at rest."""
        return [
            {**values, "excess": 0.3, "velocity": share * evidence.speed_scale}
            for values in UnderLoad().guesses(evidence)
            for share in (0.05, 0.2)
        ]

    def edit(self, document: Document, at: str, values: Values) -> None:
        """An entry for the loader; stock MuJoCo gets the level without load."""
        dry_beside(document, at, values["level"])
        document.custom(ENTRY, at, [values[p.name] for p in self.parameters])

    def sentence(self, at: str, values: Values, unit: Mapping[str, str]) -> str:
        """In words."""
        grows, more = UnderLoad().sentence(at, values, unit)[:-1], 100 * values["excess"]
        slow = f"{values['velocity']:.2g} {unit['velocity']}"
        return f"{grows}; at rest it is {more:.3g} % larger, with the change below {slow}."
