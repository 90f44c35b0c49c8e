"""A part of what a joint moves swings on its own: a load on a rope, a fluid in a tank, a link that bends."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from dipc_gym.mjcf.edit import Document
from dipc_gym.sim2real.effects.shared.base import Effect, Evidence, Parameter, Values
from dipc_gym.sim2real.effects.shared.coupling import beside, couple
from dipc_gym.sim2real.effects.shared.loads import RATES, Load, most_alike

PEAKS, APART = 2, 1.35  # first guesses, and how far apart their rates are: what is nearer falls into the same valley


class SwingingLoad(Effect):
    """One hidden mode: a mass on a spring and a damper, that no sensor sees.

    It is taken out of what the joint moves, so that both together weigh as much as before. What it does at a window's
    start follows from the motion before (`simulation.memory`).
    """

    id = "load.swinging"
    place = "joint"
    one_of = "swinging load"
    parameters = (
        Parameter("mass", "kg", 1e-9, log=True),
        Parameter("frequency", "Hz", 0.05, 60.0, log=True, fine=0.1),
        Parameter("damping_ratio", "", 1e-3, 3.0, log=True),
    )
    rivals = ("transmission.compliance", "transmission.backlash", "load.spring", "friction.hysteresis")

    def guesses(self, evidence: Evidence) -> Sequence[Values]:
        """The loads at two rates that pull most like the unexplained force."""
        found = most_alike(evidence, map(Load, RATES.tolist()), count=PEAKS, ratio=APART)
        return [
            {"mass": mass, "frequency": load.rate / (2 * np.pi), "damping_ratio": load.ratio} for load, mass in found
        ]

    def edit(self, document: Document, at: str, values: Values) -> None:
        """A body beside the one that the joint moves, and a spring between them."""
        mass, rate = values["mass"], 2 * np.pi * values["frequency"]
        name = beside(document, f"{at}_load", at, mass)
        couple(document, name, name, at, mass * rate**2, 2 * values["damping_ratio"] * rate * mass)

    def sentence(self, at: str, values: Values, unit: Mapping[str, str]) -> str:
        """In words."""
        return (
            f"A part of what {at} moves, {values['mass']:.3g} {unit['mass']}, swings on its own: at "
            f"{values['frequency']:.3g} Hz, with a damping ratio of {values['damping_ratio']:.2g}."
        )
