"""Dry friction that gives way a little before it slips."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from dipc_gym.mjcf.edit import Document
from dipc_gym.sim2real.effects.friction_stribeck import LevelAlone, Stribeck
from dipc_gym.sim2real.effects.shared.base import Effect, Evidence, Form, Parameter, Values, passive_motor
from dipc_gym.sim2real.effects.shared.settings import EFFECTS

SOFTER = (4.0, 16.0, 64.0)  # times; MuJoCo's bristles are integrated explicitly, so a long step bears only soft ones


class Presliding(Effect):
    """LuGre friction (Canudas de Wit et al. 1995): bristles that bend like springs until they slip.

    While they bend, what is pushed springs back; once they slip it is friction with a Stribeck curve.
    """

    id = "friction.stribeck:presliding"
    place = "joint"
    one_of = "dry friction"
    parameters: tuple[Parameter, ...] = (
        *Stribeck.parameters,
        Parameter("stiffness", "N/m", 1e-9, log=True),
        Parameter("damping", "N s/m", 1e-12, log=True),
    )
    levels = ("level",)
    rivals = ("friction.stribeck", "friction.coulomb", "transmission.compliance", "transmission.backlash")
    contains = ("friction.coulomb", "friction.stribeck")
    finest = EFFECTS.fast
    warm = EFFECTS.warm
    element = "LuGre bristles of a passive motor"

    def forms(self) -> Sequence[Form]:
        """Friction that does not give way, with its peak or without, and softer bristles."""
        return (WithoutBristles(), LevelAlone(self.parameters), *(Softer(times) for times in SOFTER))

    def guesses(self, evidence: Evidence) -> Sequence[Values]:
        """Bristles that bend by a few thousandths of the way, or by a few ten-thousandths."""
        level, reach = evidence.dry_level, float(np.ptp(evidence.position))
        found = []
        for bend in (5e-3, 5e-4):
            stiffness = level / max(bend * reach, 1e-12)
            found.append(
                {
                    "level": level,
                    "static": 1.5 * level,
                    "velocity": 0.1 * evidence.speed_scale,
                    "stiffness": stiffness,
                    "damping": float(np.sqrt(stiffness * evidence.inertia)),
                }
            )
        return found

    def edit(self, document: Document, at: str, values: Values) -> None:
        """The LuGre friction of a motor that has no winding."""
        document.set(document.joint(at), frictionloss=0)
        level, static = values["level"], max(values["static"], values["level"])
        numbers = (values["stiffness"], values["damping"], max(level, 1e-12), max(static, 1e-12), values["velocity"])
        passive_motor(document, f"{at}_bristles", at, lugre=numbers)

    def sentence(self, at: str, values: Values, unit: Mapping[str, str]) -> str:
        """In words."""
        bend = values["level"] / values["stiffness"]
        way = unit["velocity"].partition("/")[0]
        return (
            f"Stick-slip friction with presliding (LuGre) at {at}: {values['static']:.3g} {unit['static']} to break "
            f"away, {values['level']:.3g} {unit['level']} in motion; it gives way by {bend:.2g} {way} before it slips."
        )


class WithoutBristles(Form, Presliding):
    """Presliding friction, written without what gives way: dry friction, and passive forces for its peak."""

    id = "friction.stribeck:rigid"
    parameters = tuple(replace(p, fixed=p.name in ("stiffness", "damping")) for p in Presliding.parameters)
    warm = 0.0
    element = "dry friction that does not give way, and passive forces that speed takes off it"

    def edit(self, document: Document, at: str, values: Values) -> None:
        """As friction without memory is."""
        Stribeck().edit(document, at, values)


class Softer(Form, Presliding):
    """Presliding friction whose bristles are softer than the rig's, for the file's step does not bear those."""

    id = "friction.stribeck:softer"

    def __init__(self, times: float) -> None:
        self.times = times
        self.element = f"LuGre bristles of a passive motor, {times:g} times softer than the rig's"

    def edit(self, document: Document, at: str, values: Values) -> None:
        """Less stiffness, and damping that damps it as well."""
        softer = {"stiffness": values["stiffness"] / self.times, "damping": values["damping"] / self.times**0.5}
        super().edit(document, at, {**values, **softer})
