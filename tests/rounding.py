"""What rounding to single precision may do to a program: a bound on the error of every value, computed beside it.

Running error analysis, as in Higham, "Accuracy and Stability of Numerical Algorithms" (2nd ed., 2002), chapter 3: every
operation hands on the errors of its operands, and adds what rounding its own result makes, half a unit in the last
place. Nothing is assumed about the numbers, and no constant is tuned.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from dipc_gym.dataflow import Program, Step

UNIT = 2.0**-24
"""Largest relative error of a rounded result in single precision."""
TINY = 1e-36
"""What the header takes for zero, and what may be lost by underflow."""
ROUNDED = {"exp": 2, "tanh": 16, "sigmoid": 6}
"""Units for a function: of the C library's exponential, which is right to one unit in the last place, and of the
operations of the header's own hyperbolic tangent and sigmoid, each counted."""

Pair = tuple[np.ndarray, np.ndarray]
"""Values (size, runs) and the bounds of their errors."""


def bounded(program: Program, inputs: Mapping[str, np.ndarray], memory: Mapping[str, np.ndarray]) -> tuple[Any, Any]:
    """One period in double precision from a memory that is exact, with what single precision may be off by.

    Returns:
        Value and bound of every output, and of every state of the next period. A bound is infinite where rounding may
        turn a comparison.
    """
    found: list[Pair] = []
    with np.errstate(all="ignore"):
        for step in program.steps:
            if step.operation == "input":
                value = np.asarray(inputs[step.name], dtype=float)[None]
                found.append(_rounded(value, 0.0 * value))
            elif step.operation == "state":
                found.append(_rounded(memory[step.name], 0.0 * memory[step.name]))
            else:
                found.append(_bounded(step, [found[place] for place in step.operands]))
    outputs = {name: found[place] for name, place in program.outputs.items()}
    return outputs, {name: found[program.updates.get(place, place)] for name, place in program.states.items()}


def _rounded(value: np.ndarray, error: np.ndarray, units: float = 1) -> Pair:
    added = units * UNIT * (np.abs(value) + error) + TINY
    return value, np.where(value == 0.0, error, error + added)


def _bounded(step: Step, operands: list[Pair]) -> Pair:
    match step.operation, operands:
        case "comment", _:
            return np.zeros((0, 1)), np.zeros((0, 1))
        case "constant", _:
            return _rounded(step.numbers[:, None], np.zeros((step.size, 1)))
        case "add" | "subtract", ((a, da), (b, db)):
            return _rounded(a + b if step.operation == "add" else a - b, da + db)
        case "multiply", ((a, da), (b, db)):
            return _rounded(a * b, np.abs(a) * db + np.abs(b) * da + da * db)
        case "divide", ((a, da), (b, db)):
            least = np.abs(b) - db
            error = (da + np.abs(a / b) * db) / least
            return _rounded(a / b, np.where(least > 0, error, np.inf))
        case "minimum" | "maximum", ((a, da), (b, db)):
            first = a < b if step.operation == "minimum" else a > b
            either = np.abs(a - b) <= da + db
            return np.where(first, a, b), np.where(either, np.maximum(da, db), np.where(first, da, db))
        case "less", ((a, da), (b, db)):
            return (a < b).astype(float), np.where(np.abs(a - b) <= da + db, np.inf, 0.0)
        case "within", ((a, da), (limit, dl)):
            near = np.abs(np.abs(a) - limit) <= da + dl
            return (np.abs(a) < limit).astype(float), np.where(near, np.inf, 0.0)
        case "choose", ((test, turned), (yes, dy), (no, dn)):
            taken = test > 0.5
            return np.where(taken, yes, no), np.where(turned > 0.1, np.inf, np.where(taken, dy, dn))
        case "exp", ((a, da),):
            return _rounded(np.exp(a), np.exp(a) * np.expm1(da), ROUNDED["exp"])
        case "tanh", ((a, da),):
            return _rounded(np.tanh(a), da, ROUNDED["tanh"])
        case "sigmoid", ((a, da),):
            return _rounded(1 / (1 + np.exp(-a)), 0.25 * da, ROUNDED["sigmoid"])
        case "total", ((a, da),):
            value, error = a[:1], da[:1]
            for row, own in zip(a[1:], da[1:], strict=True):
                value, error = _rounded(value + row[None], error + own[None])
            return value, error
        case "least", ((a, da),):
            return a.min(axis=0, keepdims=True), da.max(axis=0, keepdims=True)
        case "part", ((a, da),):
            return a[step.start : step.start + step.size], da[step.start : step.start + step.size]
        case "pick", ((a, da),):
            return a[list(step.places)], da[list(step.places)]
        case "product", ((a, da), (b, db)):
            value = error = np.zeros(0)
            for k in range(step.inner):
                first, off = (x.reshape(-1, step.inner, x.shape[1])[:, k, None] for x in (a, da))
                second, away = (x.reshape(step.inner, -1, x.shape[1])[None, k] for x in (b, db))
                product, lost = _rounded(first * second, np.abs(first) * away + off * (np.abs(second) + away))
                value, error = (product, lost) if k == 0 else _rounded(value + product, error + lost)
            half = np.tril_indices(len(value)) if step.half else (slice(None), slice(None))
            return tuple(x[half].reshape(step.size, -1) for x in (value, error))
        case "join", parts:
            runs = max(a.shape[1] for a, _ in parts)
            wide = [[np.broadcast_to(x, (len(x), runs)) for x in part] for part in parts]
            return np.concatenate([a for a, _ in wide]), np.concatenate([da for _, da in wide])
        case "affine", ((a, da),):
            value, error = _rounded(step.numbers[:, None], np.zeros((step.size, 1)))
            for column, entry, own in zip(step.weights.T, a, da, strict=True):
                weight, off = _rounded(column[:, None], np.zeros((step.size, 1)))
                product, lost = _rounded(weight * entry, np.abs(weight) * own + off * (np.abs(entry) + own))
                value, error = _rounded(value + product, error + lost)
            return value, error
    raise ValueError(f"no operation {step.operation!r}")
