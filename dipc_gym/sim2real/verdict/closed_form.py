"""The simplest formula that says what a table says, from a small grammar; none where the data ask for more.

A table is known as well as the fit's quadratics tell: what its values may be off, each and together, costs in
likelihood what it costs in predictions. A formula is a constant and one or two terms; it has to pay for its parameters
as the table for its values (Schwarz 1978), so the formula that is kept predicts as well to within that.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from dipc_gym.sim2real.verdict.settings import FORMULAS

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Basis:
    """A kind of term: how it looks at nonlinear parameters, and which starts these have.

    Attributes:
        kind: in words.
        names: of its nonlinear parameters.
        columns: of an input (m,) and these: (m, k), each with a factor of its own.
        starts: of the ends of a table.
        bounds: of the same: smallest and largest, within which a term is seen as what it is called. The flank of a
            Gaussian far away is a curve, but nobody would say so.
        one_sided: whether it is a function of the size of the input alone, so that it needs one that begins at zero.
        settles: of its nonlinear parameters: input beyond which it changes no more; infinite if it may always do, as
            what sits somewhere does, for that may be beyond the table.
    """

    kind: str
    names: tuple[str, ...]
    columns: Callable[[Array, Sequence[float]], Array]
    starts: Callable[[float, float], list[tuple[float, ...]]]
    bounds: Callable[[float, float], list[tuple[float, float]]]
    one_sided: bool = False
    settles: Callable[[Sequence[float]], float] = lambda p: math.inf


def _spots(low: float, high: float) -> list[tuple[float, ...]]:
    places = np.linspace(low, high, FORMULAS.places + 2)[1:-1].tolist()
    return [(place, width * (high - low)) for place in places for width in FORMULAS.widths]


def _seen(low: float, high: float) -> list[tuple[float, float]]:
    length = high - low
    near = FORMULAS.aside * length
    return [(low - near, high + near), (FORMULAS.narrowest * length, length)]


def _lengths(low: float, high: float) -> list[tuple[float, float]]:
    return [(FORMULAS.narrowest * (high - low), FORMULAS.longest * (high - low))]


def _column(x: Array) -> Array:
    return np.asarray(x)[:, None]


GRAMMAR = (
    Basis("line", (), lambda x, _: _column(x), lambda low, high: [()], lambda low, high: []),
    Basis("Gaussian", ("at", "width"), lambda x, p: _column(np.exp(-0.5 * ((x - p[0]) / p[1]) ** 2)), _spots, _seen),
    Basis("step", ("at", "width"), lambda x, p: _column(np.tanh((x - p[0]) / p[1])), _spots, _seen),
    Basis(
        "sine",
        ("wavelength",),
        lambda x, p: np.stack([np.sin(2 * np.pi * x / p[0]), np.cos(2 * np.pi * x / p[0])], axis=1),
        lambda low, high: [((high - low) / count,) for count in FORMULAS.waves],
        _lengths,
    ),
    Basis(
        "power",
        ("power",),
        lambda x, p: _column(np.abs(x) ** p[0]),
        lambda low, high: [(power,) for power in FORMULAS.powers],
        lambda low, high: [(FORMULAS.flattest, FORMULAS.steepest)],
        one_sided=True,
    ),
    Basis(
        "exponential",
        ("scale",),
        lambda x, p: _column(np.exp(-np.abs(x) / p[0])),
        lambda low, high: [(width * (high - low),) for width in FORMULAS.widths],
        _lengths,
        one_sided=True,
        settles=lambda p: FORMULAS.over * p[0],
    ),
)


def _basis(kind: str) -> Basis:
    return next(one for one in GRAMMAR if one.kind == kind)


@dataclass(frozen=True)
class Formula:
    """A constant and terms.

    Attributes:
        constant: in the unit of the values.
        terms: kind, factors, and nonlinear parameters by name.
        told: ends of the table that told it.
    """

    constant: float
    terms: tuple[tuple[str, tuple[float, ...], dict[str, float]], ...]
    told: tuple[float, float]

    def __call__(self, x: Array) -> Array:
        """Values at inputs (m,)."""
        out = np.full(len(x), self.constant)
        for kind, factors, parameters in self.terms:
            out = out + _basis(kind).columns(x, list(parameters.values())) @ np.array(factors)
        return out

    @property
    def settles(self) -> float:
        """Input beyond which it changes no more; infinite for one that may always do."""
        return max((_basis(kind).settles(list(p.values())) for kind, _, p in self.terms), default=0.0)

    def text(self, unit: str, per: str) -> str:
        """In words.

        Args:
            unit: of the values.
            per: of the input.
        """
        said = [f"{self.constant:.3g} {unit}".strip(), *(_said(*term, unit, per) for term in self.terms)]
        return f"{', '.join(said[:-1])} and {said[-1]}" if len(said) > 1 else said[0]

    def to_dict(self, unit: str, per: str) -> dict[str, Any]:
        """As diagnosis.json holds it."""
        terms = [{"kind": kind, "factors": list(factors), **parameters} for kind, factors, parameters in self.terms]
        return {"text": self.text(unit, per), "constant": self.constant, "terms": terms}


def _said(kind: str, factors: Sequence[float], p: dict[str, float], unit: str, per: str) -> str:
    size = f"{factors[0]:.3g} {unit}".strip()
    if kind == "line":
        return f"{factors[0]:.3g} {unit} for each {per or 'unit'}".replace("  ", " ")
    if kind == "sine":
        return f"a sine of {math.hypot(*factors):.3g} {unit}, {p['wavelength']:.3g} {per} long"
    if kind == "power":
        return f"{size} times the {p['power']:.3g}th power of the input in {per or 'units'}"
    if kind == "exponential":
        return f"an exponential of {size} that falls over {p['scale']:.3g} {per}"
    if kind == "step":
        return f"a step of {2 * factors[0]:.3g} {unit}, {p['width']:.3g} {per} wide, at {p['at']:.3g} {per}"
    return f"a Gaussian of {size}, {p['width']:.3g} {per} wide, at {p['at']:.3g} {per}"


def formulas(x: Array, values: Array, precision: Array, samples: int) -> list[Formula]:
    """Formulas for a table, each with more parameters than the one before, and nearer; none where none is worth it.

    The last says as much as the table for fewer parameters. A table is straight between its knots and the law that it
    stands for is not, so one before may predict as well.

    Args:
        x: knots, (m,), increasing.
        values: at the knots, (m,).
        precision: inverse covariance of the values, (m, m).
        samples: that told them: windows, or readings.

    Example:
        >>> x = np.linspace(-1, 1, 21)
        >>> *_, found = formulas(x, 2 + 3 * np.exp(-0.5 * ((x - 0.3) / 0.2) ** 2), 1e4 * np.eye(21), 100)
        >>> found.text("N", "m")
        '2 N and a Gaussian of 3 N, 0.2 m wide, at 0.3 m'
    """
    size, axes = np.linalg.eigh(0.5 * (precision + precision.T))
    known = size > FORMULAS.singular * max(float(size.max()), 1e-300)
    root = np.sqrt(size[known])[:, None] * axes[:, known].T
    price = math.log(max(samples, 2))
    allowed = [term for term in GRAMMAR if not term.one_sided or x[0] >= 0]
    nothing = _fitted((), x, values, root)
    found = [nothing]
    singles = [_fitted((term,), x, values, root) for term in allowed]
    found += singles
    best = min(singles, key=lambda one: one[1] + one[2] * price)
    if best[1] + best[2] * price < nothing[1] + nothing[2] * price:
        first = next(term for term in allowed if term.kind == best[0].terms[0][0])
        found += [_fitted((first, term), x, values, root) for term in allowed]
    _, left, most = last = min(found, key=lambda one: one[1] + one[2] * price)
    if left + most * price >= int(known.sum()) * price:
        return []
    counts = sorted({parameters for _, _, parameters in found if parameters < most})
    plainer = [min((one for one in found if one[2] == count), key=lambda one: one[1]) for count in counts]
    return [formula for formula, _, _ in (*plainer, last)]


def _fitted(terms: Sequence[Basis], x: Array, values: Array, root: Array) -> tuple[Formula, float, int]:
    """A formula of these terms, the squares that it leaves, and how many parameters it has."""
    low, high = float(x[0]), float(x[-1])
    target, best = root @ values, (math.inf, np.zeros(0), np.zeros(0))
    count = sum(len(term.names) for term in terms)

    def columns(p: Array) -> Array:
        parts, given = [np.ones((len(x), 1))], p.tolist()
        for term in terms:
            own, given = given[: len(term.names)], given[len(term.names) :]
            parts.append(term.columns(x, own))
        return np.concatenate(parts, axis=1)

    def factors(p: Array) -> Array:
        return np.asarray(np.linalg.lstsq(root @ columns(p), target, rcond=1e-10)[0])

    def left(p: Array) -> Array:
        with np.errstate(all="ignore"):
            seen = root @ columns(p)
        if not np.isfinite(seen).all():
            return np.full(len(target), 1e6)
        return np.asarray(target - seen @ np.linalg.lstsq(seen, target, rcond=1e-10)[0])

    starts = [np.array(sum(one, ())) for one in itertools.product(*(term.starts(low, high) for term in terms))]
    within = [each for term in terms for each in term.bounds(low, high)]
    least, most = (np.array([each[k] for each in within]) for k in (0, 1))
    # A table is short, but two terms have hundreds of starts: those that begin best are followed.
    ahead = sorted(starts, key=lambda p: float(np.sum(left(p) ** 2)))[: FORMULAS.followed]
    for start in ahead:
        p = start
        if count:
            scale = np.maximum(np.abs(start), 1e-3)
            p = least_squares(left, start, bounds=(least, most), x_scale=scale, max_nfev=FORMULAS.most_values).x
        squares = float(np.sum(left(p) ** 2))
        if squares < best[0]:
            best = squares, p, factors(p)
    squares, p, weights = best
    at, said = 1, []
    given = p.tolist()
    for term in terms:
        own, given = given[: len(term.names)], given[len(term.names) :]
        width = term.columns(x[:1], own).shape[1]
        said.append((term.kind, tuple(weights[at : at + width].tolist()), dict(zip(term.names, own, strict=True))))
        at += width
    return Formula(float(weights[0]), tuple(said), (low, high)), squares, count + len(weights)
