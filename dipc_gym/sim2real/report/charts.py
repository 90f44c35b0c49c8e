"""Numbers into the small charts of the report: SVG paths that stretch to any width, labels that stay HTML.

A path is drawn in a box of fixed coordinates that the page stretches, with strokes that keep their width; the labels
around it are ordinary text. So a chart is as readable on a telephone as on paper, and no font enters the file.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Kind = Literal["line", "dots", "area"]
Tone = Literal["observed", "nominal", "before", "after", "shade"]

WIDTH, HEIGHT = 2000, 1000  # of the box; twice the pixels of the widest chart
FEWEST = 5  # samples in a bin that is drawn: the mean of fewer is chance
PREFIXES = {-9: "n", -6: "µ", -3: "m", 0: "", 3: "k", 6: "M"}  # of units, by powers of ten
PREFIXED = ("m", "rad", "N", "V", "A", "s")  # units that a prefix may stand before


@dataclass(frozen=True)
class Axis:
    """One axis.

    Attributes:
        low: value at the left or lower end.
        high: value at the right or upper end.
        label: what is shown, with the unit.
        ticks: place (percent from the low end) and text of each tick.
    """

    low: float
    high: float
    label: str
    ticks: tuple[tuple[float, str], ...]

    def fraction(self, values: Array) -> Array:
        """Where values lie between the ends, 0 to 1."""
        return (values - self.low) / (self.high - self.low)


@dataclass(frozen=True)
class Layer:
    """One path of a chart: what it is, whose colour it has, and its coordinates."""

    kind: Kind
    tone: Tone
    d: str


@dataclass(frozen=True)
class Chart:
    """A chart: the sentence that stands for it when it is not seen, axes, and layers from back to front."""

    description: str
    x: Axis
    y: Axis
    layers: tuple[Layer, ...]

    @property
    def grid(self) -> str:
        """Path of the horizontal lines at the ticks."""
        return "".join(f"M0 {HEIGHT * (1 - place / 100):.0f}h{WIDTH}" for place, _ in self.y.ticks)


def axis(low: float, high: float, name: str, unit: str, count: int = 6, room: int = 28) -> Axis:
    """An axis with round ticks; a prefix, a power of ten or an offset keeps their texts short.

    Args:
        low: smallest value shown.
        high: largest value shown.
        name: quantity, may be empty.
        unit: SI unit, may be empty.
        count: most ticks.
        room: most characters in all ticks together, a space after each; there are two ticks at least.

    Example:
        >>> shown = axis(-0.002, 0.002, "error", "m")
        >>> shown.label, [text for _, text in shown.ticks]
        ('error, mm', ['−2', '−1', '0', '1', '2'])
    """
    if not math.isfinite(high - low):
        low, high = 0.0, 1.0
    if high - low <= 1e-9 * max(abs(low), abs(high), 1e-300):
        middle, half = (low + high) / 2, max(abs(low), abs(high), 1.0) / 2
        low, high = middle - half, middle + half
    largest = max(abs(low), abs(high))
    if high - low < largest / 100:
        offset = f"{low:.{max(0, 1 - math.floor(math.log10(high - low)))}f}"
        near = axis(
            low - float(offset), high - float(offset), f"{name} − {offset} {unit}".replace("− -", "+ "), unit, count
        )
        return Axis(low, high, near.label, near.ticks)
    power = 0 if 0.1 <= largest < 1e4 else 3 * math.floor(math.log10(largest) / 3)
    scale = 10.0**power
    for most in range(count, 1, -1):
        ticks = _ticks(low / scale, high / scale, _step((high - low) / scale, most))
        if sum(len(text) + 1 for _, text in ticks) <= room:
            break
    return Axis(low, high, ", ".join(part for part in (name, _scaled(unit, power)) if part), ticks)


def _ticks(low: float, high: float, step: float) -> tuple[tuple[float, str], ...]:
    decimals = max(0, -math.floor(math.log10(step) + 1e-9))
    numbers = range(math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9) + 1)
    return tuple((100 * (k * step - low) / (high - low), f"{k * step:.{decimals}f}".replace("-", "−")) for k in numbers)


def _step(span: float, count: int) -> float:
    """The smallest of 1, 2, 5 times a power of ten that gives at most `count` ticks."""
    power = 10.0 ** math.floor(math.log10(span / count))
    return next(m * power for m in (1, 2, 5, 10, 20) if math.floor(span / (m * power) + 1e-9) < count)


def _scaled(unit: str, power: int) -> str:
    if power == 0:
        return unit
    if power in PREFIXES and unit.replace("/", " ").split(" ")[0] in PREFIXED:
        return PREFIXES[power] + unit
    return f"10{superscript(power)} {unit}".rstrip()


def superscript(power: int) -> str:
    """An exponent in raised digits."""
    return str(power).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))


def span(series: Sequence[Array], share: float = 1.0, zero: bool = False) -> tuple[float, float]:
    """Range that holds the middle `share` of all finite values, or all if that is not much wider; with a margin.

    Args:
        series: values; what is not finite is left out.
        share: of the values that must be seen.
        zero: whether zero must be.
    """
    values = np.concatenate([s[np.isfinite(s)] for s in series]) if series else np.zeros(0)
    if len(values) == 0:
        return 0.0, 1.0
    least, low, high, most = (float(v) for v in np.quantile(values, [0, (1 - share) / 2, (1 + share) / 2, 1]))
    if most - least <= 2 * (high - low):
        low, high = least, most
    if zero:
        low, high = min(low, 0.0), max(high, 0.0)
    margin = 0.06 * (high - low)
    return low - margin, high + margin


def line(tone: Tone, x: Array, y: Array, across: Axis, up: Axis, most: int = 800) -> Layer:
    """A line, interrupted where a value is not finite, thinned so that every peak stays.

    Args:
        tone: whose line.
        x: does not fall within a stretch, (n,).
        y: (n,).
        across: horizontal axis.
        up: vertical axis.
        most: points wanted at most; about twice as many are possible where there are many gaps.
    """
    X, Y = _box(x, y, across, up)
    shown = np.flatnonzero(np.isfinite(X) & np.isfinite(Y) & (X >= 0) & (X <= WIDTH))
    if len(shown) == 0:
        return Layer("line", tone, "")
    run = np.cumsum(np.diff(shown, prepend=shown[0]) > 1)
    X, Y = X[shown], Y[shown]
    if len(shown) > most:
        if run[-1] > most / 4:  # gaps finer than what is drawn
            run[:] = 0
        bucket = run * most + np.floor(X * (most / 2 - 1) / WIDTH).astype(int)
        order = np.lexsort((Y, bucket))
        ends = np.flatnonzero(np.diff(bucket[order])) + 1
        keep = np.unique(np.concatenate([order[[0, *ends]], order[[*(ends - 1), -1]]]))
        X, Y, run = X[keep], Y[keep], run[keep]
    first = np.diff(run, prepend=-1) > 0
    pieces = [f"{'M' if f else ' '}{a:.0f} {b:.0f}" for f, a, b in zip(first, X, Y, strict=True)]
    return Layer("line", tone, "".join(pieces))


def dots(tone: Tone, x: Array, y: Array, across: Axis, up: Axis, most: int = 700) -> Layer:
    """A scatter, thinned evenly; dots outside the axes are left out. Each is a stroke of no length with a round cap."""
    X, Y = _box(x, y, across, up)
    shown = np.flatnonzero((X >= 0) & (X <= WIDTH) & (Y >= 0) & (Y <= HEIGHT))
    if len(shown) > most:
        shown = shown[np.linspace(0, len(shown) - 1, most).astype(int)]
    return Layer("dots", tone, "".join(f"M{a:.0f} {b:.0f}h0" for a, b in zip(X[shown], Y[shown], strict=True)))


def area(tone: Tone, x: Array, low: Array, high: Array, across: Axis, up: Axis) -> Layer:
    """The band between two curves; where either is not finite it is left out."""
    fine = np.isfinite(x) & np.isfinite(low) & np.isfinite(high)
    X, bottom = _box(x[fine], low[fine], across, up)
    _, top = _box(x[fine], high[fine], across, up)
    X = np.clip(X, 0, WIDTH)
    outline = np.column_stack([np.append(X, X[::-1]), np.append(bottom, top[::-1])])
    if len(outline) == 0:
        return Layer("area", tone, "")
    return Layer("area", tone, "M" + " ".join(f"{a:.0f} {b:.0f}" for a, b in outline) + "z")


def _box(x: Array, y: Array, across: Axis, up: Axis) -> tuple[Array, Array]:
    """Coordinates in the box; far outside of it one place is as good as another."""
    with np.errstate(over="ignore", invalid="ignore"):
        X = WIDTH * across.fraction(np.asarray(x, float))
        Y = HEIGHT * (1 - up.fraction(np.asarray(y, float)))
    return X, np.clip(Y, -HEIGHT, 2 * HEIGHT)


def binned(x: Array, y: Array, count: int) -> tuple[Array, Array, Array]:
    """Mean of y over x, with its spread.

    Half of the edges divide the range, half the samples: fine where there are many, nowhere blind.

    Args:
        x: (n,).
        y: (n,).
        count: most bins.

    Returns:
        Centre, mean and standard deviation of each bin; NaN where fewer than five samples are.
    """
    fine = np.isfinite(x) & np.isfinite(y)
    x, y = x[fine], y[fine]
    if len(x) < FEWEST:
        return np.zeros(0), np.zeros(0), np.zeros(0)
    even = np.linspace(x.min(), x.max(), count // 2 + 1)
    edges = np.unique(np.concatenate([even, np.quantile(x, np.linspace(0, 1, count // 2 + 1))]))
    index = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, max(len(edges) - 2, 0))
    n = np.bincount(index, minlength=1).astype(float)
    n[n < FEWEST] = np.nan
    centre = np.bincount(index, x) / n
    mean = np.bincount(index, y) / n
    variance = np.bincount(index, (y - np.nan_to_num(mean)[index]) ** 2) / n
    return centre, mean, np.sqrt(variance)
