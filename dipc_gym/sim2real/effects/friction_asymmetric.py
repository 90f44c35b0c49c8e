"""Dry friction that differs between the two directions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import mujoco
import numpy as np

from dipc_gym.sim2real.document import Document
from dipc_gym.sim2real.effects.base import Effect, Evidence, Parameter, Values, dof, dry, passive_force


class Asymmetric(Effect):
    """One level of Coulomb friction forwards, another one backwards.

    Sliding, this is symmetric friction and a constant force, and at rest too: the joint holds between the two levels.
    So on one recording it is one model with friction.coulomb and load.constant together.
    """

    id = "friction.asymmetric"
    place = "joint"
    parameters = (Parameter("forward", "N", 0.0), Parameter("backward", "N", 0.0))
    rivals = ("friction.coulomb", "load.constant", "friction.stribeck")
    contains = ("friction.coulomb", "load.constant")

    def fits(self, model: mujoco.MjModel, at: str) -> bool:
        """Where the model has no dry friction yet."""
        return bool(model.dof_frictionloss[dof(model, at)] == 0)

    def guesses(self, evidence: Evidence) -> Sequence[Values]:
        """Force that opposes motion, and half of it more or less in one direction."""
        level = evidence.dry_level
        offset = float(np.clip(-np.mean(evidence.force), -0.8 * level, 0.8 * level)) or 0.1 * level
        return [{"forward": level + offset, "backward": level - offset}]

    def edit(self, document: Document, at: str, values: Values) -> None:
        """Friction at the mean level and a constant force of half the difference."""
        dry(document, at, (values["forward"] + values["backward"]) / 2)
        passive_force(document, f"{at}_asymmetry", at, (values["backward"] - values["forward"]) / 2)

    def sentence(self, at: str, values: Values, unit: Mapping[str, str]) -> str:
        """In words."""
        return (
            f"Dry friction at {at} that depends on direction: {values['forward']:.3g} {unit['forward']} forwards, "
            f"{values['backward']:.3g} {unit['backward']} backwards."
        )
