"""Dry friction that grows with the load, less and less the faster the joint moves, by a law of its own."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dipc_gym.mjcf.edit import Document
from dipc_gym.sim2real.effects.friction_load import UnderLoad
from dipc_gym.sim2real.effects.shared.base import Effect, Evidence, Parameter, Values, dry_beside
from dipc_gym.sim2real.effects.shared.increments import LawOfIncrements, dense_knots, dense_table
from dipc_gym.sim2real.effects.shared.law import at_joint, described

Array = NDArray[np.float64]

ENTRY = "friction.load_by_speed"  # of <custom>
FIRST = 8  # stretches between the knots of a law at first
AT_REST = 0.3  # share by which friction under load is larger at rest, at first
FURTHEST = 0.995  # quantile of the speed, up to which it weakens
SLOW = 0.1  # of that speed, up to which half of the knots lie, or a little more: near rest such a law is steep


class UnderLoadOfAnyLaw(LawOfIncrements):
    """Friction under load that weakens with speed: level + (by_drive |drive| + by_weight |weight|) (1 + more(|v|)).

    A gear's teeth that slide carry on a film of grease, and touch at rest: the models of Duclusaud et al. (BAM, 2024)
    have `friction.load:stribeck`, this one the shape that the data ask for. It never grows with speed.

    Increments say how much more it is with each stretch of the table, from the fastest knot to rest.
    """

    id = "friction.load:law"
    place = "joint"
    one_of = "dry friction"
    levels = ("level",)
    rivals = ("friction.speed", "friction.load", "friction.resting")
    contains = ("friction.coulomb", "friction.load", "friction.load:stribeck")

    increment = "more", ""
    beside = (*UnderLoad.parameters, Parameter("fastest", "m/s", 1e-9, fixed=True))

    def proposals(self, evidence: Evidence) -> Sequence[tuple[Effect, Values]]:
        """Friction under load as it is guessed without speed, and more at rest in equal steps."""
        fastest = float(np.quantile(np.abs(evidence.velocity), FURTHEST))
        if not fastest > 0:
            return []
        more = self.by_name(np.full(FIRST, AT_REST / FIRST))
        begins = [{**values, "fastest": fastest, **more} for values in UnderLoad().guesses(evidence)]
        return [(type(self)(begin), begin) for begin in begins]

    def reshaped(self, levels: Array, values: Values) -> tuple[Effect, Values]:
        """The law with other steps."""
        begin = {**{p.name: values[p.name] for p in self.beside}, **self.by_name(np.diff(levels))}
        return type(self)(begin), begin

    def edit(self, document: Document, at: str, values: Values) -> None:
        """An entry for the loader; stock MuJoCo gets the level without load."""
        dry_beside(document, at, values["level"])
        held = [values[name] for name in ("level", "by_drive", "by_weight", "fastest")]
        document.custom(ENTRY, at, [*held, SLOW * values["fastest"], *self.at_knots(values)[::-1]])

    def curve(self, values: Values) -> tuple[Array, Array]:
        """Speeds from rest, (k,), and how many times friction under load is there what it is in fast motion."""
        times = 1.0 + self.at_knots(values)[::-1]
        return dense_knots(values["fastest"], SLOW, len(times)), times

    def law_of(self, values: Values, unit: Mapping[str, str]) -> dict[str, Any]:
        """How many times friction under load is at a speed what it is in fast motion."""
        speeds, times = dense_table(values["fastest"], SLOW, 1.0 + self.at_knots(values)[::-1])
        inputs = [{"name": "speed", "unit": at_joint("m/s", unit["level"]), "knots": speeds.tolist()}]
        kind = "friction under load, in multiples of what it is in fast motion"
        return described(kind, inputs, times.tolist(), "", passive=True)

    def sentence(self, at: str, values: Values, unit: Mapping[str, str]) -> str:
        """In words."""
        grows, (speeds, times) = UnderLoad().sentence(at, values, unit)[:-1], self.curve(values)
        half = float(np.interp(0.5 * (times[0] + 1.0), times[::-1], speeds[::-1]))
        return (
            f"{grows} in fast motion; what is under load weakens with speed by a law of its own: it is {times[0]:.3g} "
            f"times as much at rest, with half of that gone at {half:.2g} {at_joint('m/s', unit['level'])}."
        )
