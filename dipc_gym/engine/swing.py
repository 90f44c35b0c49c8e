"""What a load on a spring does while it is carried along a motion that is known, as code."""

from __future__ import annotations

import ctypes
import functools
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir
from numpy.typing import NDArray

from dipc_gym.engine import machine
from dipc_gym.engine.code import Code, Numbers
from dipc_gym.engine.follow import write_following
from dipc_gym.engine.values import INT, POINTER, REAL, Value, maximum, sign

Array = NDArray[np.float64]

TURN = 0.1  # rad of its fastest swing in a step: Runge-Kutta is then off by a ten-millionth of the swing
LONGEST = 2e-3  # s: where slack ends within a step, its order is lost
FADE = 0.25  # of the time in which its fastest part fades: a hundred-thousandth


class Spring(NamedTuple):
    """One that pulls back a load of unit inertia by a polynomial of what it is stretched beyond its slack, either way.

    Attributes:
        slack: m or rad.
        stiffness: 1/s^2; below zero it softens others.
        cubic: of the third power, 1/(m^2 s^2) or 1/(rad^2 s^2).
    """

    slack: float
    stiffness: float
    cubic: float = 0.0

    def pull(self, stretch: Array) -> Array:
        """Back, m/s^2 or rad/s^2, for stretches of any shape."""
        beyond = np.maximum(np.abs(stretch) - self.slack, 0.0)
        return np.sign(stretch) * beyond * (self.stiffness + self.cubic * beyond**2)

    def slope(self, stretch: Array) -> Array:
        """Of the pull, 1/s^2, for stretches of any shape from 0 on."""
        beyond = stretch - self.slack
        return np.where(beyond < 0, 0.0, self.stiffness + 3 * self.cubic * beyond**2)


def swing(
    springs: Sequence[Spring], drag: float, position: Array, velocity: Array, stamps: Array, *, ground: float = 0.0
) -> Array:
    """Where a load on springs is against what it hangs on, and how fast; at rest at the first stamp.

    Args:
        springs: that hold it.
        drag: damping per inertia, 1/s.
        position: of what it hangs on at the stamps, m or rad, (n,).
        velocity: m/s or rad/s, (n,).
        stamps: s, increasing, (n,).
        ground: damping per inertia against what does not move, 1/s; with some, it stands still at the first stamp.

    Returns:
        m or rad, then m/s or rad/s, (2, n).

    Example:
        >>> t = np.linspace(0.0, 20.0, 2001)
        >>> behind, _ = swing([Spring(0.0, 25.0)], 2.0, 0.5 * t**2, t, t)  # hangs back by 1/25 m at 1 m/s^2
        >>> round(float(behind[-1]), 4)
        -0.04
    """
    # Less where it begins, and less the speed then, which the load shares where nothing holds it back.
    shared = 0.0 if ground else velocity[0]
    carried = (position - position[0] - shared * (stamps - stamps[0]), velocity - shared)
    # They are about stiffest where one begins to pull, or where the load is left as far behind as it was carried.
    ends = np.array([*(one.slack for one in springs), float(np.ptp(carried[0]))])
    stiffest = float(np.max(sum((one.slope(ends) for one in springs), np.zeros(len(ends))), initial=1e-12))
    longest = min(LONGEST, TURN / math.sqrt(stiffest), FADE / max(drag + ground, 1e-12))
    out = np.empty((2, len(stamps)))
    arrays = [np.ascontiguousarray(one, dtype=float) for one in (springs, *carried, stamps)]
    numbers = (ctypes.c_double(one) for one in (drag, ground, longest))
    _function()(*(one.ctypes.data for one in (*arrays, out)), len(springs), len(stamps), *numbers)
    return out


@functools.lru_cache(maxsize=1)
def _function() -> Any:
    module = ir.Module("swing")
    code = Code(module, "swing", [POINTER] * 5 + [INT] * 2 + [REAL] * 3)
    springs, position, velocity, stamps, out = (code.numbers(one) for one in code.function.args[:5])
    count, n = code.function.args[5:7]
    drag, ground, longest = (Value(code, one) for one in code.function.args[7:])
    load, pull = code.scratch(2), code.scratch(1)  # where the load is and how fast

    def rates(now: Sequence[Value], load: Numbers) -> tuple[Value, Value]:
        _, place, speed = now
        apart, pull[0] = load[0] - place, 0.0
        with code.count(count) as spring:
            at = springs.since(code.product(spring, len(Spring._fields)))
            beyond = maximum(abs(apart) - at[0], 0.0)
            pull[0] = pull[0] + sign(apart) * beyond * (at[1] + at[2] * beyond * beyond)
        return load[1], -(pull[0] + drag * (load[1] - speed) + ground * load[1])

    load[0], load[1] = 0.0, 0.0
    out[0], out[n] = 0.0 - position[0], 0.0 - velocity[0]
    with code.count(n, 1) as k:
        before = code.sum(k, -1)
        track = [(one[before], one[k]) for one in (stamps, position, velocity)]
        steps = maximum((track[0][1] - track[0][0]) / longest, 1.0).ceil()
        write_following(code, load, 2, track, steps, rates)
        out[k], out[code.sum(n, k)] = load[0] - track[1][1], load[1] - track[2][1]
    code.finish()
    return machine.load([str(module)], ["swing"]).function("swing", pointers=5, counts=2, numbers=3)
