"""Laws of any shape: effects whose parameters are the values of a table."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from dipc_gym.engine.remember import recall
from dipc_gym.mjcf.edit import Document
from dipc_gym.sim2real.effects.shared.base import Effect, Evidence, Parameter, Values, dry_beside
from dipc_gym.sim2real.effects.shared.settings import LAWS
from dipc_gym.sim2real.effects.shared.tables import bending, between, curve, grow

Array = NDArray[np.float64]

Outside = Literal["constant", "parallel"]

FAR = 100.0  # times the largest that data tell, to where a table goes of a law that goes on straight
BENT = 1e-5  # of the law's size, by which values begin off a line: a ramp that is nothing has no slope to fit by


def described(
    kind: str,
    inputs: Sequence[Mapping[str, Any]],
    levels: Any,
    unit: str,
    *,
    passive: bool | None,
    outside: Outside = "constant",
    driven_up_to: float | None = None,
    remembers: str | None = None,
    supported: Sequence[Sequence[float]] | None = None,
) -> dict[str, Any]:
    """A law as diagnosis.json holds it.

    Args:
        kind: what its values are, in words.
        inputs: `name`, `unit` and `knots` of each.
        levels: at the knots; of two inputs a row over the second for each knot of the first.
        unit: of these.
        passive: whether it can only take energy away; None where it exerts nothing.
        outside: beyond the first and last knots it goes on as it ends, or parallel to its input.
        driven_up_to: speed of the joint beyond which it drives no further; from there to twice as fast it fades.
        remembers: of an input that no sensor reads, how it comes about, as sentences.
        supported: range of the data along each input; None where knots go no further.
    """
    return {
        "of": [one["name"] for one in inputs],
        "kind": kind,
        "table": {"inputs": [dict(one) for one in inputs], "levels": levels, "unit": unit},
        "formula": None,
        "supported": list(supported or ([one["knots"][0], one["knots"][-1]] for one in inputs)),
        "outside": outside,
        "driven_up_to": driven_up_to,
        "passive": passive,
        "remembers": remembers,
    }


def either_way(values: Sequence[float]) -> list[float]:
    """Knots or levels of a law that is odd, from those of its half that begins at 0."""
    return [-one for one in values[:0:-1]] + list(values)


def bisected(knots: Array, narrowest: Array | float, told: NDArray[np.bool_] | None = None) -> Array:
    """Knots, and the middles of stretches that end at a told one and are twice as long as the narrowest may be."""
    wide = np.diff(knots) > LAWS.twice * narrowest
    if told is not None:
        wide &= told[1:] | told[:-1]
    return np.sort(np.append(knots, (0.5 * (knots[1:] + knots[:-1]))[wide]))


def extended(knots: Array, low: float, high: float) -> Array:
    """Knots of a table that goes as far as its input does, from `low` to `high`.

    The last knot is where data end: one beyond would be a value that no reading tells.
    """
    first, last = knots[[0, -1]]
    stretch = max(float(np.median(np.diff(knots))), max(first - low, high - last) / LAWS.most_beyond)
    more = [
        np.linspace(end, far, int(np.ceil(abs(far - end) / stretch)) + 1)[1:]
        for end, far in ((first, min(low, first)), (last, max(high, last)))
        if abs(far - end) > LAWS.beyond * (last - first)
    ]
    return np.sort(np.concatenate([knots, *more]))


def holding_new(parameters: Sequence[Parameter], new: NDArray[np.bool_]) -> tuple[Parameter, ...]:
    """Values of a law, of which those that are new hold on to where they begin."""
    return tuple(
        replace(p, sigma=LAWS.new / LAWS.step) if added else p for p, added in zip(parameters, new, strict=True)
    )


def recalled(evidence: Evidence, effect: str, tries: Array, follows: Array | None = None) -> Array:
    """What a law of `<custom>` would remember with each of several sets of numbers (k, m), at all samples, (k, n)."""
    parts = [
        recall(
            effect,
            tries,
            evidence.time[run],
            evidence.position[run],
            evidence.velocity[run],
            None if follows is None else follows[run],
        )
        for run in evidence.runs
    ]
    return np.concatenate(parts, axis=1)


def halved(table: Array) -> Array:
    """A table (k,) with a value more in the middle of each stretch, (2 k - 1,)."""
    places = np.arange(2 * len(table) - 1)
    return np.asarray(np.interp(places, places[::2], table))


def at_joint(slide: str, force: str) -> str:
    """The unit of a length as it is at a joint, by that of a force there: about an axis m is rad."""
    return slide.replace("m", "rad") if force.startswith("N m") else slide


def first_levels(evidence: Evidence, more: Array) -> Array:
    """Levels of friction that a law begins with: those that are there, and what forces ask for beside them, (m,)."""
    level = 0.0 if evidence.level is None else evidence.level
    return np.maximum(level + more, LAWS.driest * evidence.dry_level)


class Law(Effect):
    """An effect with a free shape.

    In the catalogue it has none yet; `proposals` gives one that the evidence asks for. Knots stay where they are, their
    values are fitted.

    Args:
        knots: inputs at which the law has its values, increasing; none in the catalogue.
        values: first guess there.
    """

    free = True
    of: str  # what it depends on
    slide: str  # unit of that at a joint that slides
    unit: str
    lowest = -np.inf  # value
    kind: str  # what the values are, in words
    passive: bool | None = True  # whether it can only take energy away; None where it exerts nothing
    outside: Outside = "constant"  # what it does where no data lie
    smooth = False  # whether it bends between its knots, or is straight from one to the next
    from_nothing = True  # whether the whole law at zero does nothing, and half of it half as much
    most = 1.0  # of what its values are in proportion to, where they hold

    def __init__(self, knots: Sequence[float] = (), values: Sequence[float] = ()) -> None:
        self.knots, self.first = tuple(map(float, knots)), tuple(map(float, values))
        # A map that leaves its input as it is does nothing; of it, what it changes tells the size.
        nothing = 0.0 if self.from_nothing else np.array(self.knots)
        size = float(np.max(np.abs(np.array(self.first) - nothing), initial=0.0)) or 1.0
        names = [f"value_{k + 1}" for k in range(len(self.knots))]
        self.parameters = tuple(
            Parameter(name, self.unit, self.lowest, step=LAWS.step * size, sigma=LAWS.loose / LAWS.step)
            for name in names
        )
        self.linear = tuple(names) if self.from_nothing else ()

    def inputs(self, at: str) -> tuple[str, ...]:
        """Its one input at this place."""
        return (f"{self.of} {at}",) if self.of in ("position", "speed", "command") else ()

    def axes(self, at: str) -> tuple[str, ...]:
        """Name of the input that its knots lie along, or `time`; none for one that no window tells of."""
        return ("time",) if self.of == "time" else self.inputs(at)

    @abstractmethod
    def table(self, evidence: Evidence) -> tuple[Array, Array] | None:
        """Knots and values that the evidence asks for; None where it asks for nothing."""

    def proposals(self, evidence: Evidence) -> Sequence[tuple[Effect, Values]]:
        """The law with the shape that the evidence asks for."""
        asked = self.table(evidence)
        if asked is None:
            return []
        shaped = type(self)(asked[0].tolist(), asked[1].tolist())
        return [(shaped, shaped.guess)]

    def guesses(self, evidence: Evidence) -> Sequence[Values]:
        """Of a law that has its shape, the values it was given."""
        return [self.guess] if self.knots else []

    def finer(self, values: Values, told: NDArray[np.bool_] | None = None) -> Sequence[tuple[Effect, Values]]:
        """A knot more in each stretch, there where the law was."""
        old = np.array(self.knots)
        knots = bisected(old, self.narrowest, told)
        if len(knots) == len(old):
            return []
        return [self._begun(knots, self._at(knots, values), ~np.isin(knots, old))]

    def reaching(self, values: Values, spans: Sequence[tuple[float, float]]) -> tuple[Effect, Values] | None:
        """The same law with a table that goes as far as its input does; it begins as it was. None where it goes as far.

        Args:
            values: of the parameters.
            spans: smallest and largest input.
        """
        old, levels = np.array(self.knots), np.array(self.values(values))
        knots = extended(old, *spans[0])
        if len(knots) == len(old):
            return None
        inside = np.clip(knots, old[0], old[-1])
        longer = self._at(inside, values) + (knots - inside if self.outside == "parallel" else 0.0)
        before, after = knots < old[0], knots > old[-1]
        beyond = np.cumsum(before[::-1])[::-1] * before + np.cumsum(after) * after
        # It goes on flat, but for what gives each stretch a slope to fit by.
        return self._begun(knots, longer + BENT * float(np.max(np.abs(levels))) * beyond**2, before | after)

    def shortened(self, values: Values, told: NDArray[np.bool_]) -> tuple[Effect, Values] | None:
        """The same law without values at its ends that no data tell, so that it goes on from the last that they do.

        None where all are told, or too few.

        Args:
            values: of the parameters.
            told: which of them data tell, (p,).
        """
        known = np.flatnonzero(told[: len(self.knots)])
        if len(known) < 2 or known[-1] - known[0] + 1 == len(self.knots):
            return None
        kept = slice(int(known[0]), int(known[-1]) + 1)
        knots, levels = np.array(self.knots)[kept], np.array(self.values(values))[kept]
        return self._begun(knots, levels, np.zeros(len(knots), dtype=bool))

    @property
    def narrowest(self) -> Array:
        """To what the stretches may be bisected, one less than there are knots."""
        return np.full(len(self.knots) - 1, (self.knots[-1] - self.knots[0]) / LAWS.narrowest)

    @property
    def bends(self) -> Array:
        """A law goes at random, as far off the line between two places as Brownian motion does between them: so a
        finer table is held as a coarser one is, and what hardly any motion comes near goes on as its neighbours do.
        """
        if len(self.knots) < 3:
            return super().bends
        knots = np.array(self.knots)
        stretches = np.diff(knots)
        apart = stretches[:-1] * stretches[1:] / (knots[2:] - knots[:-2]) / (knots[-1] - knots[0])
        return bending(knots) * (LAWS.step / (LAWS.walks * np.sqrt(apart)))[:, None]

    def off(self, new: NDArray[np.bool_]) -> Array:
        """By how much each value that is new lies off the law through the others, as weights of all values, (n, k).

        Args:
            new: which knots are, (k,); never the first or the last, nor two beside each other.
        """
        knots, unit = np.array(self.knots), np.eye(len(self.knots))
        if not self.smooth:
            return unit[new] - 0.5 * (np.roll(unit, -1, axis=0) + np.roll(unit, 1, axis=0))[new]
        return np.asarray(unit[new] - curve(knots[~new], unit[~new], knots[new]))

    def _at(self, knots: Array, values: Values) -> Array:
        """The law at other knots within its own."""
        levels = np.array(self.values(values))
        if not self.smooth:
            return np.interp(knots, self.knots, levels)
        return curve(np.array(self.knots), levels, knots)

    def written(self, values: Values) -> tuple[Array, Array]:
        """Knots and values of the table that is written, lines from one to the next."""
        knots = between(np.array(self.knots)) if self.smooth else np.array(self.knots)
        return knots, self._at(knots, values)

    def _begun(self, knots: Array, values: Array, new: NDArray[np.bool_]) -> tuple[Effect, Values]:
        """The same law with these knots, of which some are new."""
        shaped = type(self)(knots.tolist(), values.tolist())
        shaped.parameters = holding_new(shaped.parameters, new)
        return shaped, shaped.guess

    @property
    def guess(self) -> dict[str, float]:
        """First values, by name."""
        return {p.name: value for p, value in zip(self.parameters, self.first, strict=True)}

    def values(self, values: Values) -> list[float]:
        """The values of the table, in the order of its knots."""
        return [values[p.name] for p in self.parameters]

    @property
    def places(self) -> Array:
        """The input at its values, as a formula has it, (k,)."""
        return np.array(self.knots)

    def knot_at(self, place: float) -> float:
        """The knot that has its value at such an input."""
        return place

    def each(self, unit: str) -> str:
        """Unit of its values for each unit of what they are in proportion to, as a formula has it."""
        return unit

    def per(self, unit: Mapping[str, str]) -> str:
        """Unit of the input, from that of the values: what slides along an axis turns in radians about one."""
        return at_joint(self.slide, unit[self.parameters[0].name])

    def law_of(self, values: Values, unit: Mapping[str, str]) -> dict[str, Any]:
        """Knots and values, as they are written."""
        knots, levels = self.written(values)
        inputs = [{"name": self.of, "unit": self.per(unit), "knots": knots.tolist()}]
        per = unit[self.parameters[0].name]
        return described(self.kind, inputs, levels.tolist(), per, passive=self.passive, outside=self.outside)

    def where(self, values: Values, unit: Mapping[str, str]) -> str:
        """Range and place of the largest value, in words."""
        table = self.values(values)
        most = self.knots[int(np.argmax(np.abs(table)))]
        return f"{min(table):.3g} to {max(table):.3g} {unit[self.parameters[0].name]}, largest near {most:.3g}"


class Map(Law):
    """What becomes of a command or a reading. One that leaves it as it is does nothing."""

    slide = ""
    passive, outside = None, "parallel"
    from_nothing = False
    smooth = needs_loader = True

    def edit(self, document: Document, at: str, values: Values) -> None:
        """A table for the loader."""
        document.custom(self.id, at, np.concatenate(self.written(values)).tolist())


class FrictionLaw(Law):
    """Coulomb friction with a level for each value of one input."""

    place = "joint"
    one_of = kind = "dry friction"
    unit = "N"
    lowest = 0.0
    needs_loader = True
    entry: str  # of <custom>

    def __init__(self, knots: Sequence[float] = (), values: Sequence[float] = ()) -> None:
        super().__init__(knots, values)
        self.levels = self.linear

    def table(self, evidence: Evidence) -> tuple[Array, Array]:
        """Force that opposes motion, by the input."""
        beside = [np.ones_like(evidence.force), evidence.velocity]
        knots, more = grow(
            self.seen(evidence), evidence.force, -evidence.direction, beside, evidence.time, evidence.width
        )
        return knots, first_levels(evidence, more)

    @abstractmethod
    def seen(self, evidence: Evidence) -> Array:
        """The input at the samples of the evidence, (n,)."""

    @abstractmethod
    def in_stock(self, levels: Array) -> float:
        """The one level that stock MuJoCo gets."""

    def edit(self, document: Document, at: str, values: Values) -> None:
        """A table for the loader, and one level for stock MuJoCo."""
        levels = np.array(self.values(values))
        dry_beside(document, at, self.in_stock(levels))
        even = np.linspace(self.knots[0], self.knots[-1], LAWS.narrowest + 1)  # every knot is one of these
        document.custom(self.entry, at, [even[0], even[-1], *self._at(even, values)])
