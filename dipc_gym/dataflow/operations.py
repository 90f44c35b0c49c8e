"""What each operation of a program is: what it computes, in NumPy, and what it costs."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

Floats = NDArray[np.floating[Any]]

UNARY = ("exp", "tanh", "sigmoid")
BINARY = ("add", "subtract", "multiply", "divide", "minimum", "maximum", "less", "within")
ELEMENTWISE = (*UNARY, *BINARY, "choose")
REDUCTIONS = ("total", "least")


@dataclass(frozen=True, eq=False)
class Step:
    """One operation.

    Attributes:
        operation: one of `ELEMENTWISE` or `REDUCTIONS`, or `input`, `state`, `constant`, `affine`, `product`, `join`,
            `part`, `pick`, or `comment`.
        operands: places of the values that it works on.
        size: of the result, a vector.
        name: of an input, a state or a comment.
        numbers: (size,) of a constant, or what a state is at first.
        weights: (size, inputs) of an affine map.
        start: of a part.
        places: of the entries that are picked.
        inner: of a product, columns of its first matrix and rows of its second.
        half: whether a product is symmetric, and only its lower triangle is computed.
    """

    operation: str
    operands: tuple[int, ...]
    size: int
    name: str = ""
    numbers: Floats = field(default_factory=lambda: np.zeros(0))
    weights: Floats = field(default_factory=lambda: np.zeros((0, 0)))
    start: int = 0
    places: tuple[int, ...] = ()
    inner: int = 0
    half: bool = False


# What each operation costs a microcontroller, for one number.
_COSTS = {
    "add": {"additions": 1},
    "subtract": {"additions": 1},
    "multiply": {"multiplications": 1},
    "divide": {"divisions": 1},
    "minimum": {"comparisons": 1},
    "maximum": {"comparisons": 1},
    "less": {"comparisons": 1},
    "within": {"comparisons": 2},
    "choose": {"comparisons": 1},
    "exp": {"exponentials": 1},
    "tanh": {"multiplications": 2, "additions": 6, "divisions": 7, "exponentials": 1, "comparisons": 2},
    "sigmoid": {"additions": 1, "divisions": 1, "exponentials": 1, "comparisons": 1, "multiplications": 1},
    "total": {"additions": 1},
    "least": {"comparisons": 1},
}


def cost(step: Step, entries: int) -> Counter[str]:
    """Additions, multiplications and so on of a step whose first operand has so many entries."""
    count: Counter[str] = Counter()
    for kind, times in _COSTS.get(step.operation, {}).items():
        count[kind] = times * (entries if step.operation in REDUCTIONS else step.size)
    if step.operation == "affine":
        count["multiplications"] = count["additions"] = step.weights.size
    if step.operation == "product":
        count["multiplications"], count["additions"] = step.size * step.inner, step.size * (step.inner - 1)
    return count


def computing(step: Step, dtype: DTypeLike) -> Callable[..., Floats]:
    """What computes a step: a function from operands (size, runs) to the result.

    Raises:
        ValueError: there is no such operation, or none that is computed.
    """
    match step.operation:
        case "part":
            return partial(_entries, slice(step.start, step.start + step.size))
        case "pick":
            return partial(_entries, np.array(step.places))
        case "affine":
            weights, biases = step.weights.astype(dtype), step.numbers.astype(dtype)
            return partial(_affine, weights[:, :, None], biases[:, None])
        case "product":
            return partial(_product, step.inner, step.half)
        case "less":
            return partial(_less, dtype)
        case "within":
            return partial(_within, dtype)
        case operation if operation in _COMPUTED:
            return _COMPUTED[operation]
    raise ValueError(f"no operation {step.operation!r}")


def wide(value: Floats, runs: int) -> Floats:
    """A value (size, 1) as one of so many runs."""
    return value if value.shape[1] == runs else np.broadcast_to(value, (len(value), runs))


def _minimum(a: Floats, b: Floats) -> Floats:
    return np.where(a < b, a, b)


def _maximum(a: Floats, b: Floats) -> Floats:
    return np.where(a > b, a, b)


def _less(dtype: DTypeLike, a: Floats, b: Floats) -> Floats:
    return (a < b).astype(dtype)


def _within(dtype: DTypeLike, a: Floats, limit: Floats) -> Floats:
    return ((a < limit) & (-limit < a)).astype(dtype)


def _choose(test: Floats, yes: Floats, no: Floats) -> Floats:
    return np.where(test > 0.5, yes, no)


def _sigmoid(a: Floats) -> Floats:
    e = np.exp(-np.abs(a))
    return np.where(a < 0, e, 1) / (1 + e)


def _total(a: Floats) -> Floats:
    return np.add.accumulate(a)[-1:]  # in order, as C adds; np.sum adds in pairs


def _least(a: Floats) -> Floats:
    smallest = a[0]
    for row in a[1:]:
        smallest = np.where(row < smallest, row, smallest)
    return smallest[None]


def _entries(which: Any, a: Floats) -> Floats:
    return a[which]


def _join(*parts: Floats) -> Floats:
    runs = max(part.shape[1] for part in parts)
    return np.concatenate([wide(part, runs) for part in parts])


def _affine(weights: Floats, biases: Floats, a: Floats) -> Floats:
    result = biases
    for column, entry in zip(weights.swapaxes(0, 1), a, strict=True):
        result = result + column * entry
    return result if result.shape[1] == a.shape[1] else np.repeat(result, a.shape[1], axis=1)


def _product(inner: int, half: bool, a: Floats, b: Floats) -> Floats:
    first, second = a.reshape(-1, inner, 1, a.shape[1]), b.reshape(1, inner, -1, b.shape[1])
    found = first[:, 0] * second[:, 0]
    for k in range(1, inner):  # in order, as C adds; NumPy's own products add in another one
        found = found + first[:, k] * second[:, k]
    return found[np.tril_indices(len(found))] if half else found.reshape(-1, found.shape[2])


_COMPUTED: dict[str, Callable[..., Floats]] = {
    "add": np.add,
    "subtract": np.subtract,
    "multiply": np.multiply,
    "divide": np.divide,
    "minimum": _minimum,
    "maximum": _maximum,
    "choose": _choose,
    "exp": np.exp,
    "tanh": np.tanh,
    "sigmoid": _sigmoid,
    "total": _total,
    "least": _least,
    "join": _join,
}
