"""A spring that creeps by a law of its own: hardly at a small stretch, faster the further it is stretched."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dipc_gym.mjcf.edit import Document
from dipc_gym.sim2real.effects.load_creeping import FAST, TIMES, usual
from dipc_gym.sim2real.effects.shared.base import Effect, Evidence, Parameter, Values
from dipc_gym.sim2real.effects.shared.increments import MOST, LawOfIncrements
from dipc_gym.sim2real.effects.shared.law import FAR, at_joint, described, either_way, recalled
from dipc_gym.sim2real.effects.shared.sought import Sought

Array = NDArray[np.float64]

ENTRY = "load.creeping"  # of <custom>
BENDS = (0.05, 0.15, 0.5, 1e3)  # stretches over which it bends, in ranges of the joint's motion; the last is straight
FIRST = 4  # stretches between the knots of a law at first
FURTHEST = 0.995  # quantile of how far the spring is stretched, which the table goes up to
LEAST = 1e-4  # of the fastest, by which it begins to give way faster from one knot to the next
SLOWEST = 1e-6  # of the speed in the next line, which a first guess gives way by: next to nothing
SHORTEST = 4e-3  # s, in which it may give way by as much as it is stretched


class CreepingSpringOfAnyLaw(LawOfIncrements):
    """A spring that gives way at a speed that is any function of its stretch; Maxwell's element in proportion.

    Rubber, belts and cables creep the faster the more they bear (Eyring 1936: by the hyperbolic sine of it). The law
    can but give way, so it takes energy and never gives any.

    Increments say how much faster it gives way with each stretch of the table, which is never slower.

    Args:
        furthest: stretch that the table goes up to, m or rad; none in the catalogue.
        first: guess of the stiffness, and of the increments.
    """

    id = "load.creeping:law"
    place = "joint"
    one_of = "creeping spring"
    finest = 1e-3
    rivals = ("friction.hysteresis", "load.swinging", "residual.force")
    contains = ("load.creeping",)

    increment = "faster", "m/s"
    beside = (Parameter("stiffness", "N/m", 1e-9, log=True),)

    def __init__(self, furthest: float = 1.0, first: Values | None = None) -> None:
        super().__init__(first, largest=furthest / SHORTEST)
        self.furthest = furthest

    @property
    def knots(self) -> Array:
        """Stretches at which the law has its speeds, the first 0, (k + 1,)."""
        return np.linspace(0.0, self.furthest, len(self.parameters))

    def proposals(self, evidence: Evidence) -> Sequence[tuple[Effect, Values]]:
        """A spring that creeps by a hyperbolic sine, whose pace and bend pull most like the unexplained force; and fast
        ones that creep in proportion.
        """
        span = float(np.ptp(evidence.position))
        if not span > 0:
            return []
        knots = np.linspace(0.0, 1.0, MOST + 1)
        speeds = np.array([np.sinh(knots / bent) * bent / time for bent in BENDS for time in TIMES[::2]])
        tries = np.column_stack([np.ones(len(speeds)), np.full(len(speeds), span), span * speeds])
        stretched = recalled(evidence, ENTRY, tries)
        sought = Sought(evidence)
        found = [sought.explained(-one) for one in stretched]
        best = int(np.argmin([one.left for one in found]))
        furthest = float(np.quantile(np.abs(stretched[best]), FURTHEST))
        fast = [self._straight(time, span, evidence) for time in FAST]
        if not (furthest > 0 and found[best].weight > 0):
            return fast

        def pull(faster: Array) -> Array:
            entry = np.concatenate([[1.0, furthest, 0.0], np.cumsum(faster)])
            return np.asarray(-recalled(evidence, ENTRY, entry[None])[0])

        begin = np.interp(np.linspace(0.0, furthest, FIRST + 1)[1:], span * knots, span * speeds[best])
        fastest = furthest / SHORTEST
        bounds = [SLOWEST * fastest] * FIRST, [fastest] * FIRST
        faster = sought.nearest(pull, np.diff(begin, prepend=0.0).tolist(), *bounds)
        stiffness = sought.explained(pull(faster)).weight
        return [self._shaped(furthest, stiffness, np.cumsum(faster)), *fast] if stiffness > 0 else fast

    def _straight(self, time: float, span: float, evidence: Evidence) -> tuple[Effect, Values]:
        """A law that creeps in proportion, with this time constant."""
        entry = np.concatenate([[1.0, span, 0.0], span * np.linspace(0.0, 1.0, FIRST + 1)[1:] / time])
        stretch = recalled(evidence, ENTRY, entry[None])[0]
        furthest = max(float(np.quantile(np.abs(stretch), FURTHEST)), 1e-12)
        return self._shaped(furthest, usual(evidence, stretch), furthest * np.linspace(0.0, 1.0, FIRST + 1)[1:] / time)

    def reshaped(self, levels: Array, values: Values) -> tuple[Effect, Values]:
        """The law with other speeds."""
        return self._shaped(self.furthest, values["stiffness"], levels[1:])

    def edit(self, document: Document, at: str, values: Values) -> None:
        """A table for the loader, which keeps the stretch in mind."""
        document.remembering(ENTRY, at, [values["stiffness"], self.furthest, *self.at_knots(values)])

    def law_of(self, values: Values, unit: Mapping[str, str]) -> dict[str, Any]:
        """How fast it gives way, by stretch."""
        slide, speeds, last = at_joint("m", unit["stiffness"]), self.at_knots(values).tolist(), self.furthest
        knots, levels = [*self.knots.tolist(), FAR * last], [*speeds, FAR * speeds[-1]]
        inputs = [{"name": "stretch", "unit": slide, "knots": either_way(knots)}]
        how = (
            "The stretch grows as fast as the joint moves, less this speed; the spring pulls the joint back with "
            f"{values['stiffness']:.4g} {unit['stiffness']} times the stretch."
        )
        told, per = [[-last, last]], f"{slide}/s"
        return described("speed of creep", inputs, either_way(levels), per, passive=True, remembers=how, supported=told)

    def sentence(self, at: str, values: Values, unit: Mapping[str, str]) -> str:
        """In words."""
        speeds, slide = self.at_knots(values), at_joint("m", unit["stiffness"])
        half = len(speeds) // 2
        return (
            f"A spring of {values['stiffness']:.3g} {unit['stiffness']} at {at} creeps by a law of its own: stretched "
            f"by {self.knots[half]:.3g} {slide} it gives way at {speeds[half]:.3g} {slide}/s, by {self.furthest:.3g} "
            f"{slide} at {speeds[-1]:.3g}."
        )

    def _shaped(self, furthest: float, stiffness: float, speeds: Array) -> tuple[Effect, Values]:
        faster = np.maximum(np.diff(speeds, prepend=0.0), LEAST * speeds.max())
        begin = {"stiffness": stiffness, **self.by_name(faster)}
        return type(self)(furthest, begin), begin
