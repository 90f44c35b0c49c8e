"""Which windows of a recording stay where others have been: of what lies beyond, no law of any shape can know."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

BEYOND = 0.02
"""Share of a range by which a window may go beyond it; what a law says so near to its data is hardly wrong."""
APART_ALTOGETHER = 1e12
"""Stands for the error of a model whose simulation ends in no number: in whatever unit, no other is as large."""
APART = 5
"""Samples from which a rate is taken: of neighbours, the encoder's steps are most of it."""


def error_of(said: Mapping[str, Any]) -> float:
    """The error that a replay says of a sensor or a window; of a simulation that came apart it says none, and that is
    the worst of all.
    """
    return APART_ALTOGETHER if said["error"] is None else float(said["error"])


def error_within(seen: Sequence[Path], asked: Path, replayed: Mapping[str, Any]) -> float | None:
    """Root mean square error, in units of noise, of the windows that stay within what was seen; None without any.

    Args:
        seen: CSV files of one format, first column time.
        asked: another.
        replayed: what `dipc-gym replay` says of it, with its windows.
    """
    columns, (low, high) = _columns(asked), _range([_columns(path) for path in seen])
    there = np.all((columns >= low) & (columns <= high), axis=1)
    time, length = columns[:, 0], float(replayed["window"])
    kept = [
        error_of(one)
        for one in replayed["windows"]
        if there[(time >= one["start"]) & (time < one["start"] + length)].all()
    ]
    return math.sqrt(sum(error**2 for error in kept) / len(kept)) if kept else None


def _columns(path: Path) -> Array:
    """Time, commands and readings, then the rates of these, (n, k)."""
    values = np.loadtxt(path, delimiter=",", skiprows=1, ndmin=2)
    rates = (values[APART:, 1:] - values[:-APART, 1:]) / (values[APART:, :1] - values[:-APART, :1])
    return np.hstack([values, np.vstack([rates, np.repeat(rates[-1:], APART, axis=0)])])


def _range(recordings: Sequence[Array]) -> tuple[Array, Array]:
    """Smallest and largest of each column, a little wider, (k,) each."""
    whole = np.vstack(recordings)
    low, high = whole.min(axis=0), whole.max(axis=0)
    slack = BEYOND * (high - low)
    return low - slack, high + slack
