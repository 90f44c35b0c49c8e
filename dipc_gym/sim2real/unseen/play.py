"""An operator with memory: where an unseen part was dragged to, from how the joint moved that drags it."""

from __future__ import annotations

import itertools

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
    out = np.empty((len(length), len(width)))
    turns = np.flatnonzero(np.diff(np.sign(np.diff(length)), prepend=0, append=0) != 0)
    begins = [0, *(turns + 1).tolist(), len(length)]
    for first, last in itertools.pairwise(begins):
        if first == last:
            continue
        # One way only from here to there: the clip of each is the clip of the last.
        out[first:last] = np.clip(begin, length[first:last, None] - width, length[first:last, None] + width)
        begin = out[last - 1]
    return out
