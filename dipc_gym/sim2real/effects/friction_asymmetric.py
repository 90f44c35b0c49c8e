"""Dry friction that differs between the two directions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from dipc_gym.mjcf.edit import Document
from dipc_gym.sim2real.effects.shared.base import Effect, Evidence, Parameter, Values, dry, passive_force, passive_rate


class Asymmetric(Effect):
    """One level of Coulomb friction forwards, another one backwards.

    Sliding, this is symmetric friction and a constant force, and at rest too: the joint holds between the two levels.
    So on one recording it is one model with friction.coulomb and load.constant together.
    """

    id = "friction.asymmetric"
    place = "joint"
    one_of = "dry friction"
    parameters = (Parameter("forward", "N", 0.0), Parameter("backward", "N", 0.0))
    levels = ("forward", "backward")
    rivals = ("friction.coulomb", "load.constant", "friction.stribeck")
    contains = ("friction.coulomb", "load.constant")

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


class AsymmetricDrag(Effect):
    """Viscous friction that differs between the two directions.

    Drives of machine tools show it beside dry friction; Janot, Gautier and Brunot (2019) identify it on a ball screw.
    """

    id = "friction.asymmetric:viscous"
    place = "joint"
    linear = ("drag",)
    parameters = (Parameter("drag", "N s/m"),)
    rivals = ("load.constant", "drag.quadratic", "friction.asymmetric")

    def guesses(self, evidence: Evidence) -> Sequence[Values]:
        """Some drag forwards, and some backwards."""
        drag = 0.05 * evidence.force_scale / evidence.speed_scale
        return [{"drag": drag}, {"drag": -drag}]

    def edit(self, document: Document, at: str, values: Values) -> None:
        """A passive drag with a force limit that leaves one direction of it."""
        drag = values["drag"]
        name = f"{at}_drag_{'forward' if drag > 0 else 'backward'}"
        passive_rate(document, name, at, -abs(drag), (-_UNLIMITED, 0) if drag > 0 else (0, _UNLIMITED))

    def sentence(self, at: str, values: Values, unit: Mapping[str, str]) -> str:
        """In words."""
        more, less = ("forwards", "backwards") if values["drag"] > 0 else ("backwards", "forwards")
        drag = f"{abs(values['drag']):.3g} {unit['drag']}"
        return f"Friction at {at} that depends on direction: {drag} more {more} than {less}."


_UNLIMITED = 1e9  # N, far above any force of a rig
