"""Dry friction that grows while a joint rests, by a law of its own."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dipc_gym.mjcf.edit import Document
from dipc_gym.physics.entries import RESTED_BY_LAW
from dipc_gym.sim2real.effects.friction_resting import SLOW, Resting, nearest
from dipc_gym.sim2real.effects.shared.base import Effect, Evidence, Parameter, Values, dry_beside
from dipc_gym.sim2real.effects.shared.increments import LawOfIncrements, dense_knots, dense_table
from dipc_gym.sim2real.effects.shared.law import described
from dipc_gym.sim2real.effects.shared.rests import Rests

Array = NDArray[np.float64]

FIRST = 16  # stretches between the knots of a law at first
SOON = 0.05  # of the longest rest, up to which half of the knots lie, or a little more: contacts age fast at first
EVEN = 0.3  # weight of a stretch in which it grows by more than in the one before
LEAST = 1e-2  # of all that it grows by, by which it grows more from one knot to the next, to begin with


class RestingOfAnyLaw(LawOfIncrements):
    """Breakaway friction that grows with the time at rest as any function that never falls; motion wears it off.

    Contacts of rock and paper age with the logarithm of time (Dieterich 1979), lubricated ones with a power of it (Kato
    et al. 1972); `friction.resting` has one exponential.

    Increments say how much it grows with each stretch of the table, from no rest to the longest.
    """

    id = "friction.resting:law"
    place = "joint"
    one_of = "dry friction"
    levels = ("level",)
    rivals = ("friction.speed", "friction.stribeck", "friction.hysteresis")
    contains = ("friction.coulomb", "friction.resting")
    shown_by = Resting.shown_by

    increment = "more", "N"
    beside = (
        Parameter("level", "N", 0.0),
        Parameter("longest", "s", 1e-6, fixed=True),
        Parameter("slow", "m/s", 0.0, fixed=True),
    )

    def __init__(self, first: Values | None = None) -> None:
        super().__init__(first)
        self.by_steps = tuple(p.name for p in self.parameters[len(self.beside) :])

    def proposals(self, evidence: Evidence) -> Sequence[tuple[Effect, Values]]:
        """What rests and the forces that ended them tell, as nearly as a law can that never falls."""
        rests = Rests.of(evidence)
        if not rests.tell:
            return []
        longest = float(max(rests.rested.max(), rests.ages.max(initial=0.0)))
        held = {"level": rests.level, "longest": longest, "slow": SLOW * evidence.speed_scale}
        at = dense_knots(held["longest"], SOON, FIRST + 1)
        passed = np.arange(len(at)) > np.arange(FIRST)[:, None]  # stretches that lie before each knot
        rise, time = nearest(rests)
        begin = rise * np.diff(-np.expm1(-at / time))
        rises, _ = rests.nearest(lambda ages, now: np.interp(ages, at, now @ passed), begin, even=EVEN)
        return [self._shaped(held, rises)]

    def reshaped(self, levels: Array, values: Values) -> tuple[Effect, Values]:
        """The law with other rises."""
        return self._shaped({p.name: values[p.name] for p in self.beside}, np.diff(levels))

    def edit(self, document: Document, at: str, values: Values) -> None:
        """A table for the loader, which keeps the time at rest in mind; the level in motion for stock MuJoCo."""
        dry_beside(document, at, values["level"])
        longest = values["longest"]
        numbers = [values["level"], longest, SOON * longest, values["slow"], *self.at_knots(values)]
        document.remembering(RESTED_BY_LAW, at, numbers)

    def law_of(self, values: Values, unit: Mapping[str, str]) -> dict[str, Any]:
        """What it takes to break away, by the time at rest."""
        times, levels = dense_table(values["longest"], SOON, values["level"] + self.at_knots(values))
        inputs = [{"name": "time at rest", "unit": "s", "knots": times.tolist()}]
        how = "The time at rest grows while the joint stands, and is nothing as soon as it moves."
        kind = "force to break away"
        return described(kind, inputs, levels.tolist(), unit["level"], passive=True, remembers=how)

    def sentence(self, at: str, values: Values, unit: Mapping[str, str]) -> str:
        """In words."""
        force, rises = unit["level"], self.at_knots(values)
        half = float(np.interp(0.5 * rises[-1], rises, dense_knots(values["longest"], SOON, len(rises))))
        return (
            f"Dry friction at {at} that grows at rest by a law of its own: {values['level']:.3g} {force} in motion, "
            f"and up to {values['level'] + rises[-1]:.3g} {force} to break away after a rest of "
            f"{values['longest']:.2g} s, half of that rise within {half:.2g} s."
        )

    def _shaped(self, held: Values, rises: Array) -> tuple[Effect, Values]:
        begin = {**held, **self.by_name(np.maximum(rises, LEAST * float(np.sum(rises))))}
        return type(self)(begin), begin
