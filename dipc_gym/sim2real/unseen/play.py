"""An operator with memory: where an unseen part was dragged to, from how the joint moved that drags it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def play(length: Array, width: Array, begin: Array) -> Array:
    """What is dragged along at a distance: the play operator of Prandtl and Ishlinskii.

    It depends on where the motion turned round, and on nothing between two turns.

    Args:
        length: of what drags, (n,).
        width: distance from which it drags, either way, (k,).
        begin: where what is dragged is before the first of them, (k,).

    Returns:
        Where it is, (n, k).

    Example:
        >>> play(np.array([0.0, 3.0, 2.5, 0.0]), np.array([1.0]), np.array([0.0])).ravel().tolist()
        [0.0, 2.0, 2.0, 1.0]
    """
    turns, where = turned(length, width, begin)
    return dragged(where[np.searchsorted(turns, np.arange(len(length)), side="right") - 1], length, width)


def turned(length: Array, width: Array, begin: Array) -> tuple[NDArray[np.intp], Array]:
    """Where a motion begins and turns round, (m,), and where what is dragged is then, (m, k); see `play`."""
    turns = np.append(0, np.flatnonzero(np.diff(np.sign(np.diff(length))) != 0) + 1)
    where = np.empty((len(turns), len(width)))
    for k, at in enumerate(length[turns].tolist()):
        where[k] = begin = np.minimum(np.maximum(begin, at - width), at + width)
    return turns, where


def dragged(last: Array, length: Array, width: Array) -> Array:
    """Where it is after one way only, (n, k): the clip of each is the clip of the last.

    Args:
        last: where it was at the last turn, (n, k).
        length: of what drags, now, (n,).
        width: distance from which it drags, (k,).
    """
    return np.minimum(np.maximum(last, length[:, None] - width), length[:, None] + width)
