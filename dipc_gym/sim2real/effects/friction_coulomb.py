"""Dry friction of a constant level."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import mujoco

from dipc_gym.mjcf.edit import Document
from dipc_gym.sim2real.effects.shared.base import Effect, Evidence, Parameter, Values, dof, dry


class Coulomb(Effect):
    """Friction that opposes motion with the same force at every speed, and holds a joint at rest."""

    id = "friction.coulomb"
    place = "joint"
    one_of = "dry friction"
    linear = ("level",)
    parameters = (Parameter("level", "N", 0.0),)
    levels = ("level",)
    rivals = ("friction.stribeck", "motor.deadzone", "friction.viscous", "transmission.backlash")

    def fits(self, model: mujoco.MjModel, at: str) -> bool:
        """Where the model has no dry friction yet."""
        return bool(model.dof_frictionloss[dof(model, at)] == 0)

    def guesses(self, evidence: Evidence) -> Sequence[Values]:
        """The part of the unexplained force that opposes motion."""
        return [{"level": evidence.dry_level}]

    def edit(self, document: Document, at: str, values: Values) -> None:
        """Dry friction on the joint."""
        dry(document, at, values["level"])

    def sentence(self, at: str, values: Values, unit: Mapping[str, str]) -> str:
        """In words."""
        return f"Dry (Coulomb) friction of {values['level']:.3g} {unit['level']} at {at}."
