"""What a law of `<custom>` comes to remember along a motion that is known, as code.

Windows of a recording begin in its midst, with what the motion before has left: one pass over the whole of it tells.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from llvmlite import ir
from numpy.typing import NDArray

from dipc_gym.engine import machine
from dipc_gym.engine.code import Code, Numbers
from dipc_gym.engine.follow import write_following
from dipc_gym.engine.laws import Says, Table, written
from dipc_gym.engine.values import INT, POINTER, Value
from dipc_gym.physics import Moment, entry_of
from dipc_gym.physics.formulas import SOONEST

Array = NDArray[np.float64]

FINEST = SOONEST / 4  # s: Runge-Kutta follows what fades in SOONEST closely, and up to ten times faster safely


def recall(
    effect: str, numbers: Array, time: Array, position: Array, velocity: Array, follows: Array | None = None
) -> Array:
    """What a law of `<custom>` remembers at each sample of a motion, for several sets of its numbers; it begins at 0.

    Args:
        effect: id of its entry.
        numbers: of the law, (variants, k).
        time: s, increasing, (n,).
        position: of its joint, m or rad, (n,).
        velocity: m/s or rad/s, (n,).
        follows: what else it depends on, (n,).

    Returns:
        (variants, n).

    Raises:
        KeyError: the effect remembers nothing.

    Example:
        >>> t = np.linspace(0.0, 1.0, 101)
        >>> rested = recall("friction.resting", np.array([[1.0, 0.5, 0.1, 1e-3]]), t, 0 * t, 0 * t)
        >>> round(float(rested[0, -1]), 6)
        1.0
    """
    entry = entry_of(effect)
    if entry is None or entry.memory is None:
        raise KeyError(effect)
    rate = entry.memory
    track = (time, position, velocity, np.zeros(len(time)) if follows is None else follows)
    if not written(rate):
        return _stepped(rate, numbers, track)
    out = np.zeros((len(numbers), len(time)))
    arrays = [np.ascontiguousarray(one, dtype=float) for one in (numbers, *track)]
    _function(rate)(*(one.ctypes.data for one in (*arrays, out)), *numbers.shape, len(time))
    return out


def _stepped(rate: Says, numbers: Array, track: tuple[Array, ...]) -> Array:
    """The same for a rate that is more than arithmetic, by the midpoint rule from sample to sample."""
    out, zero = np.zeros((len(numbers), len(track[0]))), np.zeros(len(numbers))
    for k, step in enumerate(np.diff(track[0])):
        middle = [0.5 * (one[k] + one[k + 1]) + zero for one in track]
        now = Moment(middle[0], middle[1], zero, zero, zero, middle[2], (middle[3], zero), out[:, k])
        half = out[:, k] + 0.5 * step * rate(numbers, now)
        out[:, k + 1] = out[:, k] + step * rate(numbers, replace(now, memory=half))
    return out


@functools.lru_cache(maxsize=64)
def _function(rate: Says) -> Any:
    module = ir.Module("remember")
    code = Code(module, "remember", [POINTER] * 6 + [INT] * 3)
    numbers, *moving, out = (code.numbers(one) for one in code.function.args[:6])
    variants, count, n = code.function.args[6:]
    with code.count(variants) as variant:
        table = Table(code, numbers.since(code.product(variant, count)), count)
        into, memory = out.since(code.product(variant, n)), code.scratch(1)
        into[0] = memory[0] = 0.0
        with code.count(n, 1) as k:
            before = code.sum(k, -1)
            track = [(one[before], one[k]) for one in moving]
            steps = ((track[0][1] - track[0][0]) / FINEST).ceil()
            write_following(code, memory, 1, track, steps, partial(_rates, code, rate, table))
            into[k] = memory[0]
    code.finish()
    return machine.load([str(module)], ["remember"]).function("remember", pointers=6, counts=3)


def _rates(code: Code, rate: Says, table: Table, now: Sequence[Value], memory: Numbers) -> tuple[Value]:
    """The rate of what is remembered, at one moment of the motion."""
    time, position, speed, follows = now
    zero: Any = code.value(0.0)
    moment: Any = Moment
    values = moment(time, position, zero, zero, zero, speed=speed, inputs=(follows, zero), memory=memory[0])
    return (rate(table, values),)
