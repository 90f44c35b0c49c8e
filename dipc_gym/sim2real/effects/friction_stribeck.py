"""Dry friction that is larger at rest than in motion."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from dipc_gym.mjcf.edit import Document
from dipc_gym.sim2real.effects.shared.base import Effect, Evidence, Form, Parameter, Values, dry, passive_rate

# The curve exp(-(v / velocity)^2) is drawn with straight lines between these multiples of the Stribeck velocity. Chosen
# to minimise the mean fourth power of the error, which is nowhere above 0.7 %: chords from knots on the curve are off
# by up to 3.6 %, and the fit of a pendulum made up for that with a static level 1.5 % too high.
KNOTS = np.array([0.0, 0.170, 0.398, 1.056, 1.376, 1.735, 2.284])
CURVE = np.array([1.0, 0.9776, 0.8592, 0.3210, 0.1438, 0.0429, 0.0])  # heights of the curve at these knots


class Stribeck(Effect):
    """Static friction above kinetic friction; the excess fades out over a speed, the Stribeck velocity.

    Friction is level + (static - level) exp(-(v / velocity)^2), without memory: dry friction at the static level, and
    passive forces along the motion, each in proportion to speed up to a limit, that together take the excess away.
    `friction.stribeck:presliding` adds bristles, at steps four times as fine.
    """

    id = "friction.stribeck"
    place = "joint"
    one_of = "dry friction"
    parameters = (
        Parameter("level", "N", 0.0),
        Parameter("static", "N", 0.0, above="level"),
        Parameter("velocity", "m/s", 1e-5, log=True),
    )
    levels = ("level",)
    rivals = ("friction.coulomb", "friction.asymmetric", "transmission.backlash")
    contains = ("friction.coulomb",)
    element = "dry friction and passive forces that speed takes off it"

    def forms(self) -> Sequence[Form]:
        """Dry friction alone: at a long step the peak may last less than one."""
        return (LevelAlone(self.parameters),)

    def guesses(self, evidence: Evidence) -> Sequence[Values]:
        """Kinetic level from the force that opposes motion, a static one two fifths larger."""
        level = evidence.dry_level
        return [
            {"level": level, "static": 1.4 * level, "velocity": share * evidence.speed_scale} for share in (0.05, 0.2)
        ]

    def edit(self, document: Document, at: str, values: Values) -> None:
        """Friction at the static level, and what speed takes off it."""
        excess = max(values["static"] - values["level"], 1e-9)
        dry(document, at, values["level"] + excess)
        slope = np.append(-np.diff(CURVE) / np.diff(KNOTS), 0.0)
        for k, bend in enumerate(-np.diff(slope)):
            limit = abs(float(bend * KNOTS[k + 1])) * excess
            rate = float(bend) * excess / values["velocity"]
            passive_rate(document, f"{at}_stribeck_{k + 1}", at, rate, (-limit, limit))

    def sentence(self, at: str, values: Values, unit: Mapping[str, str]) -> str:
        """In words."""
        return (
            f"Stick-slip (Stribeck) friction at {at}: {values['static']:.3g} {unit['static']} to break away, "
            f"{values['level']:.3g} {unit['level']} in motion, with the change below "
            f"{values['velocity']:.2g} {unit['velocity']}."
        )


class LevelAlone(Form):
    """Stick-slip friction of any kind, written as dry friction at the level in motion."""

    id = "friction.stribeck:level"
    place = "joint"
    element = "dry friction at the level in motion alone"

    def __init__(self, parameters: Sequence[Parameter]) -> None:
        self.parameters = tuple(replace(p, fixed=p.name != "level", above="") for p in parameters)

    def edit(self, document: Document, at: str, values: Values) -> None:
        """Dry friction on the joint."""
        dry(document, at, values["level"])

    def sentence(self, at: str, values: Values, unit: Mapping[str, str]) -> str:
        """In words."""
        return f"Dry friction of {values['level']:.3g} {unit['level']} at {at}."
