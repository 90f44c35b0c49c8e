"""Two operators with memory: what an unseen part has come to, from how the joint moved that it hangs on."""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

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


def swing(
    pull: float, drag: float, position: Array, velocity: Array, stamps: Array, time: Array, *, ground: float = 0.0
) -> Array:
    """Where a load on a spring is against what it hangs on, and how fast; at rest at the first stamp.

    Args:
        pull: stiffness per inertia, 1/s^2.
        drag: damping per inertia, 1/s.
        position: of what it hangs on at the stamps, m or rad, (samples,).
        velocity: m/s or rad/s, (samples,).
        stamps: s, increasing, (samples,).
        time: s, (n,).
        ground: damping per inertia against what does not move, 1/s; with some, it stands still at the first stamp.

    Returns:
        m or rad, then m/s or rad/s, (2, n).

    Example:
        >>> t = np.linspace(0.0, 20.0, 2001)
        >>> behind, _ = swing(25.0, 2.0, 0.5 * t**2, t, t, t)  # hangs back by 1/25 m at 1 m/s^2
        >>> round(float(behind[-1]), 4)
        -0.04
    """
    step = float(np.median(np.diff(stamps)))
    even = np.arange(stamps[0], stamps[-1] + step, step)
    # Less a motion at the speed of the beginning, which the load shares where nothing holds it back.
    gone, shared = stamps - stamps[0], 0.0 if ground else velocity[0]
    carried = (
        np.interp(even, stamps, position - position[0] - shared * gone),
        np.interp(even, stamps, velocity - shared),
    )
    drive = pull * carried[0] + drag * carried[1]
    # One pole at a time: as one filter of the second order its numbers would lose half their digits at small steps.
    damped = drag + ground
    apart = np.sqrt(complex(damped**2 - 4 * pull))
    if abs(apart) < 1e-3 * damped:  # a double pole, nearly
        apart = complex(1e-3 * damped)
    one, other = (-damped + apart) / 2, (-damped - apart) / 2
    first, second = _one_pole(one, step, drive), _one_pole(other, step, drive)
    place, speed = ((first - second) / apart).real, ((one * first - other * second) / apart).real
    return np.stack([np.interp(time, even, place - carried[0]), np.interp(time, even, speed - carried[1])])


def _one_pole(pole: complex, step: float, drive: Array) -> NDArray[np.complex128]:
    """What z' = pole z + drive comes to, drive straight between its samples, (n,); it begins at 0 with the drive."""
    x = pole * step
    late = (np.exp(x) - 1 - x) / x**2 if abs(x) > 1e-3 else 1 / 2 + x / 6 + x**2 / 24 + x**3 / 120
    early = (np.exp(x) - 1) / x - late
    return np.asarray(lfilter([step * late, step * early], [1.0, -np.exp(x)], drive))
