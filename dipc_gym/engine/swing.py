"""What a load on a spring does while it is carried along a motion that is known, as code."""

from __future__ import annotations

import ctypes
import functools
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from llvmlite import ir
from numpy.typing import NDArray

from dipc_gym.engine import machine
from dipc_gym.engine.code import Code, Numbers
from dipc_gym.engine.follow import write_following
from dipc_gym.engine.values import INT, POINTER, REAL, Value, maximum, sign

Array = NDArray[np.float64]
Springs = Sequence[tuple[float, float]]

TURN = 0.1  # rad of its fastest swing in a step: Runge-Kutta is then off by a ten-millionth of the swing
LONGEST = 2e-3  # s: where slack ends within a step, its order is lost
FADE = 0.25  # of the time in which its fastest part fades: a hundred-thousandth


def swing(
    springs: Springs, drag: float, position: Array, velocity: Array, stamps: Array, *, ground: float = 0.0
) -> Array:
    """Where a load on springs is against what it hangs on, and how fast; at rest at the first stamp.

    Args:
        springs: of each the slack either way, m or rad, and stiffness per inertia, 1/s^2; below zero it softens others.
        drag: damping per inertia, 1/s.
        position: of what it hangs on at the stamps, m or rad, (n,).
        velocity: m/s or rad/s, (n,).
        stamps: s, increasing, (n,).
        ground: damping per inertia against what does not move, 1/s; with some, it stands still at the first stamp.

    Returns:
        m or rad, then m/s or rad/s, (2, n).

    Example:
        >>> t = np.linspace(0.0, 20.0, 2001)
        >>> behind, _ = swing([(0.0, 25.0)], 2.0, 0.5 * t**2, t, t)  # hangs back by 1/25 m at 1 m/s^2
        >>> round(float(behind[-1]), 4)
        -0.04
    """
    stiffest = sum(max(stiffness, 0.0) for _, stiffness in springs)
    longest = min(LONGEST, TURN / math.sqrt(max(stiffest, 1e-12)), FADE / max(drag + ground, 1e-12))
    out = np.empty((2, len(stamps)))
    # Less where it begins, and less the speed then, which the load shares where nothing holds it back.
    shared = 0.0 if ground else velocity[0]
    carried = (position - position[0] - shared * (stamps - stamps[0]), velocity - shared)
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
            at = springs.since(code.product(spring, 2))
            beyond = maximum(abs(apart) - at[0], 0.0)
            pull[0] = pull[0] + at[1] * sign(apart) * beyond
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
