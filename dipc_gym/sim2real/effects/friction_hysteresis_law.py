"""Friction with memory whose loops have a shape of their own, by a stiffness that falls as the force builds up."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dipc_gym.mjcf.edit import Document
from dipc_gym.sim2real.effects.shared.base import Effect, Evidence, Parameter, Values
from dipc_gym.sim2real.effects.shared.increments import LawOfIncrements
from dipc_gym.sim2real.effects.shared.law import at_joint, described, either_way, recalled
from dipc_gym.sim2real.effects.shared.sought import Sought

Array = NDArray[np.float64]

ENTRY = "friction.hysteresis"  # of <custom>
WIDTHS = np.geomspace(2e-3, 1.0, 20)  # over which the force builds up, in ranges of the joint's motion
POWERS = (1.0, 2.0)  # with which the stiffness falls from where the motion turned round, at first
FIRST = 8  # stretches between the knots of a law at first
SOFTEST = 1e-6  # of the steepest that is tried, by which a first guess falls: next to nothing
LEAST = 1e-3  # of the largest stiffness, by which it falls at least from one knot to the next, at first


class HysteresisOfAnyLaw(LawOfIncrements):
    """Friction whose force grows with the way, by a stiffness that is any falling function of that force.

    Duhem's operator. Dahl's friction (1968) and that of Bouc and Wen (1976) are such, with formulas; Maxwell-slip
    elements are not: their loops close, and these drift. A stiffness that falls makes every loop take energy.

    Increments say by how much the stiffness falls in each stretch of the table, from all of the force along the motion
    to all of it against it, where none is left.
    """

    id = "friction.hysteresis:law"
    place = "joint"
    one_of = "hysteresis"
    rivals = ("friction.stribeck", "friction.coulomb", "load.position:law", "load.swinging")
    contains = ("friction.hysteresis",)

    increment = "fall", "N/m"
    beside = (Parameter("bound", "N", 1e-9, log=True),)

    def proposals(self, evidence: Evidence) -> Sequence[tuple[Effect, Values]]:
        """The law of Bouc and Wen, with the width and the power that give most of the unexplained force."""
        span = float(np.ptp(evidence.position))
        if not span > 0:
            return []
        along = np.linspace(-1.0, 1.0, FIRST + 1)
        shapes = [1.0 - np.maximum(along, 0.0) ** power for power in POWERS]
        tries = np.array([[1.0, *(shape / (width * span))] for shape in shapes for width in WIDTHS])
        sought = Sought(evidence, (evidence.velocity, evidence.direction))
        found = [sought.explained(-built) for built in recalled(evidence, ENTRY, tries)]
        best = int(np.argmin([one.left for one in found]))
        if not found[best].weight > 0:
            return []

        def pull(falls: Array) -> Array:
            return np.asarray(-recalled(evidence, ENTRY, np.array([[1.0, *_stiffness(falls)]]))[0])

        steepest = 1.0 / (WIDTHS[0] * span)
        begin, bounds = -np.diff(tries[best, 1:]), ([SOFTEST * steepest] * FIRST, [2 * steepest] * FIRST)
        falls = sought.nearest(pull, begin.tolist(), *bounds)
        bound = sought.explained(pull(falls)).weight
        return [self._shaped(bound, bound * _stiffness(falls))] if bound > 0 else []

    def at_knots(self, values: Values) -> Array:
        """Stiffness, from all of the force along the motion to all of it against it: it falls to 0 at the last knot."""
        return _stiffness(self.increments(values))

    def reshaped(self, levels: Array, values: Values) -> tuple[Effect, Values]:
        """The law with other stiffness."""
        return self._shaped(values["bound"], levels)

    def edit(self, document: Document, at: str, values: Values) -> None:
        """A table for the loader, which keeps the force in mind."""
        document.remembering(ENTRY, at, [values["bound"], *self.at_knots(values)])

    def curve(self, values: Values) -> tuple[Array, Array]:
        """The way from rest, and the force that has built up there."""
        bound, stiffness = values["bound"], self.at_knots(values)
        force = np.linspace(0.0, 0.99, 33) * bound
        soft = np.interp(force, np.linspace(-bound, bound, len(stiffness)), stiffness)
        compliance = 1.0 / np.maximum(soft, 1e-3 * stiffness.max())
        way = np.append(0.0, np.cumsum(np.diff(force) * 0.5 * (compliance[1:] + compliance[:-1])))
        return way, force

    def law_of(self, values: Values, unit: Mapping[str, str]) -> dict[str, Any]:
        """The curve along which the force builds up from rest."""
        way, force = self.curve(values)
        slide = at_joint("m", unit["bound"])
        inputs = [{"name": "distance from rest", "unit": slide, "knots": either_way(way.tolist())}]
        stiffness = ", ".join(f"{one:.4g}" for one in self.at_knots(values))
        how = (
            "It holds from rest on. Wherever it is, the force F builds up against the motion by a stiffness for each "
            f"{slide}: {stiffness} {unit['bound']}/{slide} at equal distances of F from {values['bound']:.4g} along "
            "the motion to as much against it."
        )
        levels = either_way(force.tolist())
        return described("friction with memory", inputs, levels, unit["bound"], passive=True, remembers=how)

    def sentence(self, at: str, values: Values, unit: Mapping[str, str]) -> str:
        """In words."""
        way, force = self.curve(values)
        half = float(np.interp(values["bound"] / 2, force, way))
        slide = at_joint("m", unit["bound"])
        return (
            f"Friction with memory (Duhem) at {at}: up to {values['bound']:.3g} {unit['bound']} that builds up from "
            f"where the motion turned round, from rest half of it within {half:.3g} {slide}."
        )

    def _shaped(self, bound: float, stiffness: Array) -> tuple[Effect, Values]:
        falls = np.maximum(-np.diff(stiffness), LEAST * stiffness.max())
        begin = {"bound": bound, **self.by_name(falls)}
        return type(self)(begin), begin


def _stiffness(falls: Array) -> Array:
    """At the knots, from all of the force along the motion to all of it against it, where none is left."""
    return np.append(np.cumsum(falls[::-1])[::-1], 0.0)
