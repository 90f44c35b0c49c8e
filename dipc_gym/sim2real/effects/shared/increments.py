"""Laws that only grow or only fall: effects whose parameters say by how much from each knot of a table to the next."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Sequence
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from dipc_gym.sim2real.effects.shared.base import Effect, Evidence, Parameter, Values
from dipc_gym.sim2real.effects.shared.law import halved
from dipc_gym.sim2real.effects.shared.settings import LAWS

Array = NDArray[np.float64]

MOST = 16  # stretches between the knots of such a law
FINER = 32  # times as many in a table that bends nowhere else: off by a thousandth of what a stretch rises by


def dense_knots(most: float, near: float, count: int) -> Array:
    """Knots from 0 to the most, dense near 0: half of them lie below about a share `near` of it, (count,)."""
    share = np.linspace(0.0, 1.0, count)
    return most * near * share / (1.0 + near - share)


def dense_table(most: float, near: float, levels: Array) -> tuple[Array, Array]:
    """A law with levels at `dense_knots`, straight in the share along these, as a table that is straight between knots
    of its own, (FINER k + 1,) of each: as nearly as that goes.
    """
    knots, share = dense_knots(most, near, len(levels)), np.linspace(0.0, 1.0, len(levels))
    # A line misses the share by its second derivative, 1 / (x + near)^3: in steps of this root it does so evenly.
    along = 1.0 / np.sqrt(knots / most + near)
    fine = np.interp(np.arange(FINER * (len(levels) - 1) + 1) / FINER, np.arange(len(levels)), along)
    x = 1.0 / fine**2 - near
    x[::FINER] = knots / most
    return most * x, np.interp(x * (1.0 + near) / (x + near), share, levels)


class LawOfIncrements(Effect):
    """An effect with a free shape that is monotone, as its increments are never negative.

    In the catalogue it has no shape yet; `proposals` gives one that the evidence asks for. Knots lie at equal distances
    and stay where they are.

    Args:
        first: guess of the parameters, its increments among them, numbered from 1; none in the catalogue.
        largest: increment that is allowed.
    """

    free = True
    needs_loader = True
    increment: ClassVar[tuple[str, str]]  # name of its increments, without a number, and unit
    beside: ClassVar[tuple[Parameter, ...]]  # the law's other parameters

    def __init__(self, first: Values | None = None, *, largest: float = math.inf) -> None:
        self.first = dict(first or {})
        name, unit = self.increment
        names = [one for one in self.first if one.startswith(f"{name}_")]
        step = LAWS.step * (sum(self.first[one] for one in names) or 1.0)
        increments = [Parameter(one, unit, 0.0, largest, step=step, sigma=LAWS.loose / LAWS.step) for one in names]
        self.parameters = (*self.beside, *increments) if self.first else ()

    def guesses(self, evidence: Evidence) -> Sequence[Values]:
        """Of a law that has its shape, what it begins with."""
        return [self.first] if self.first else []

    def finer(self, values: Values, told: NDArray[np.bool_] | None = None) -> Sequence[tuple[Effect, Values]]:
        """A knot more in each stretch of the table."""
        levels = halved(self.at_knots(values))
        return [self.reshaped(levels, values)] if len(levels) - 1 <= MOST else []

    def increments(self, values: Values) -> Array:
        """By how much the law grows or falls in each stretch, (k,)."""
        return np.array([values[p.name] for p in self.parameters[len(self.beside) :]])

    def by_name(self, increments: Array) -> dict[str, float]:
        """Increments (k,) by the names of their parameters."""
        return {f"{self.increment[0]}_{k + 1}": float(one) for k, one in enumerate(increments)}

    def at_knots(self, values: Values) -> Array:
        """The law at its knots, (k + 1,): it grows from 0 at the first."""
        return np.append(0.0, np.cumsum(self.increments(values)))

    @abstractmethod
    def reshaped(self, levels: Array, values: Values) -> tuple[Effect, Values]:
        """The law with other levels (k + 1,) and as many knots, and its parameters; the others as they are."""
