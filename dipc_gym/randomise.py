"""Plants that differ from episode to episode: distributions in the place of numbers."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dipc_gym.plant import FORMAT, MAX_DELAY, RANGES, Encoders, Friction, Masses, Motor, Plant, PlantError

__all__ = ["Normal", "PlantFamily", "Uniform"]

PARTS = {"motor": Motor, "friction": Friction, "encoders": Encoders, "masses": Masses}
FIELDS = {field.name for field in dataclasses.fields(Plant)}
FIXED = ("supply", "control_period")  # they set the action space and the rhythm of all environments
MAY_BE_ZERO = ("delay", "friction.bristle_damping", "friction.viscous", "encoders.noise", "encoders.velocity_filter")
FARTHEST = 1e12  # beyond the range of any field
REACH = 3.0  # a normal distribution is cut at this many standard deviations


@dataclass(frozen=True)
class Uniform:
    """Any number between two, all alike.

    Attributes:
        low: smallest, in the unit of the field.
        high: largest.
    """

    low: float
    high: float

    @property
    def centre(self) -> float:
        """The middle."""
        return (self.low + self.high) / 2

    def draw(self, rng: np.random.Generator) -> float:
        """One number."""
        return float(rng.uniform(self.low, self.high))


@dataclass(frozen=True)
class Normal:
    """Numbers around a mean, cut at three standard deviations, so that what can be drawn is known beforehand.

    Attributes:
        mean: in the unit of the field.
        sd: standard deviation before the cut.
    """

    mean: float
    sd: float

    @property
    def centre(self) -> float:
        """The mean."""
        return self.mean

    @property
    def low(self) -> float:
        """Smallest number that can be drawn."""
        return self.mean - REACH * self.sd

    @property
    def high(self) -> float:
        """Largest number that can be drawn."""
        return self.mean + REACH * self.sd

    def draw(self, rng: np.random.Generator) -> float:
        """One number."""
        while True:
            score = float(rng.standard_normal())
            if abs(score) <= REACH:
                return self.mean + self.sd * score


@dataclass(frozen=True)
class PlantFamily:
    """A plant of which some numbers are drawn anew for every episode.

    In a file or dictionary, `{"uniform": [low, high]}` or `{"normal": [mean, sd]}` stands where a plant has a number.
    Numbers are drawn independently, in the order in which they are given; where static friction comes out below
    Coulomb friction, all are drawn again.

    Attributes:
        base: the plant with the centre of each distribution.
        spreads: name of each drawn number, such as `friction.coulomb`, and its distribution.

    Raises:
        PlantError: a distribution is not understood or can give an impossible plant; the message names file and field.

    Example:
        >>> family = PlantFamily.of({"friction": {"coulomb": {"uniform": [5.0, 9.0]}}})
        >>> family.base.friction.coulomb
        7.0
        >>> 5.0 <= family.draw(np.random.default_rng(0)).friction.coulomb <= 9.0
        True
    """

    base: Plant
    spreads: tuple[tuple[str, Uniform | Normal], ...] = ()

    def __post_init__(self) -> None:
        centres: dict[str, Any] = {}
        for name, spread in self.spreads:
            _check(name, spread)
            part, _, field = name.rpartition(".")
            (centres.setdefault(part, {}) if part else centres)[field] = spread.centre
        if Plant.from_dict(centres, self.base) != self.base:
            raise PlantError(
                f"base has other numbers than the centres of {', '.join(name for name, _ in self.spreads)}; "
                "give it these centres"
            )

    def check_fixed(self, plant: Plant) -> None:
        """Refuse plants that would change the action space and the rhythm of an environment made with another.

        Args:
            plant: what it was made with.

        Raises:
            PlantError: supply or control period are others.
        """
        if any(getattr(self.base, name) != getattr(plant, name) for name in FIXED):
            raise PlantError(f"options['plant'] cannot change {' or '.join(FIXED)}; make another environment")

    @classmethod
    def of(
        cls, value: PlantFamily | Plant | Mapping[str, Any] | str | Path | None, base: Plant | None = None
    ) -> PlantFamily:
        """A family from any of the forms that the environment's `plant` argument takes.

        Args:
            value: a family, a plant, a dictionary of changed fields, or the path of a JSON file.
            base: has what `value` leaves out; by default the default rig.
        """
        if isinstance(value, PlantFamily):
            return value
        if isinstance(value, Plant):
            return cls(value)
        if isinstance(value, (str, Path)):
            data = FORMAT.read(value)
            try:
                return cls._from_dict(data, base)
            except PlantError as error:
                raise PlantError(f"{value}: {error}") from None
        return cls._from_dict({} if value is None else value, base)

    @classmethod
    def _from_dict(cls, data: Mapping[str, Any], base: Plant | None) -> PlantFamily:
        if not isinstance(data, Mapping):
            return cls(Plant.from_dict(data, base))  # says what is wrong with it
        spreads: list[tuple[str, Uniform | Normal]] = []
        plain: dict[str, Any] = {}
        for name, value in data.items():
            if name in PARTS and isinstance(value, Mapping):
                plain[name] = {key: _centre(f"{name}.{key}", entry, spreads) for key, entry in value.items()}
            else:  # of a name that there is not, the plant says so
                plain[name] = _centre(name, value, spreads) if name in FIELDS else value
        return cls(Plant.from_dict(plain, base), tuple(spreads))

    def draw(self, rng: np.random.Generator) -> Plant:
        """One plant."""
        if not self.spreads:
            return self.base
        # The centres are possible and distributions symmetric, so at least every second draw is.
        while True:
            numbers = {name: spread.draw(rng) for name, spread in self.spreads}
            friction = self.base.friction
            if friction is None or (
                numbers.get("friction.static", friction.static) >= numbers.get("friction.coulomb", friction.coulomb)
            ):
                return _with(self.base, numbers)

    @property
    def longest_delay(self) -> float:
        """The longest delay that can be drawn, s."""
        return max([self.base.delay, *(spread.high for name, spread in self.spreads if name == "delay")])


def _centre(name: str, value: Any, spreads: list[tuple[str, Uniform | Normal]]) -> Any:
    """The number for the base plant, or the value itself if it is no distribution."""
    if not isinstance(value, Mapping) or name in PARTS:
        return value
    forms = {"uniform": "low, high", "normal": "mean, sd"}
    kind = next(iter(value), None)
    if len(value) != 1 or kind not in forms:
        raise PlantError(
            f'{name} is {dict(value)!r:.80}; write a number, {{"uniform": [low, high]}} or {{"normal": [mean, sd]}}'
        )
    numbers = value[kind]
    numbers = numbers.tolist() if isinstance(numbers, np.ndarray) else numbers
    if (
        not isinstance(numbers, (list, tuple))
        or len(numbers) != 2
        or not all(isinstance(n, (int, float)) and not isinstance(n, bool) and abs(n) <= FARTHEST for n in numbers)
    ):
        raise PlantError(f"{name}: {kind} takes two finite numbers [{forms[kind]}], not {numbers!r:.80}")
    first, second = map(float, numbers)
    spread = Uniform(first, second) if kind == "uniform" else Normal(first, second)
    _check(name, spread)
    spreads.append((name, spread))
    return spread.centre


def _check(name: str, spread: Uniform | Normal) -> None:
    """Refuse a distribution of a number that cannot be drawn, or that can come out impossible."""
    if name in FIXED:
        raise PlantError(f"{name} is the same for all episodes and cannot be drawn; give it one number")
    kind = "uniform" if isinstance(spread, Uniform) else "normal"
    first, second = (spread.low, spread.high) if isinstance(spread, Uniform) else (spread.mean, spread.sd)
    if not (math.isfinite(first) and math.isfinite(second)):
        raise PlantError(f"{name}: {kind} [{first:g}, {second:g}] is not of finite numbers")
    if kind == "uniform" and first > second:
        raise PlantError(f"{name}: uniform [{first:g}, {second:g}] has its low end above its high end; swap them")
    if kind == "normal" and second < 0:
        raise PlantError(f"{name}: normal [{first:g}, {second:g}] has a negative standard deviation")
    if spread.low < 0 or (spread.low == 0 and name not in MAY_BE_ZERO):
        must = "not be negative" if name in MAY_BE_ZERO else "be positive"
        how = "its low end" if kind == "uniform" else f"{REACH:g} standard deviations below its mean, where it is cut,"
        raise PlantError(f"{name}: {kind} [{first:g}, {second:g}] reaches {spread.low:g}, {how} but must {must}")
    if name == "delay" and spread.high > MAX_DELAY:
        raise PlantError(
            f"delay: {kind} [{first:g}, {second:g}] reaches {spread.high:g} s; it can be {MAX_DELAY:g} s at most"
        )
    least, most, unit = RANGES.get(name, (-math.inf, math.inf, ""))  # an unknown field is named by the plant
    if not (least <= spread.low and spread.high <= most):
        raise PlantError(
            f"{name}: {kind} [{first:g}, {second:g}] reaches from {spread.low:g} to {spread.high:g}; all that is drawn "
            f"must be from {least:g} to {most:g} {unit}"
        )


def _with(base: Plant, numbers: Mapping[str, float]) -> Plant:
    parts: dict[str, dict[str, float]] = {}
    changes: dict[str, Any] = {}
    for name, value in numbers.items():
        part, _, field = name.rpartition(".")
        if part:
            parts.setdefault(part, {})[field] = value
        else:
            changes[name] = value
    for part, fields in parts.items():
        changes[part] = dataclasses.replace(getattr(base, part), **fields)
    return dataclasses.replace(base, **changes)
