"""The environment's arithmetic, on numbers or on arrays of any shape alike.

Nothing but + - * /, absolute values and rounding down is used, which IEEE 754 defines to the last bit. So one
simulation on Python floats and a thousand on arrays give the same bits, as long as both call these functions.
"""

from __future__ import annotations

import math
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

Number = TypeVar("Number", float, NDArray[np.float64])

TURN = 2 * math.pi  # rad
QUARTER = math.pi / 2  # of a turn, rad
SERIES = [(-1.0) ** k / math.factorial(2 * k + 1) for k in range(1, 11)]
"""Of the sine divided by its angle, after the 1: within a quarter of a turn the next term is below 2e-18."""
RAIL = 0.45  # m, from the middle of the rail to a stop, where the model sets no range
FALL = 0.35  # rad from upright, beyond which a balancing pole has fallen


def floor(number: Number) -> Number:
    """The next whole number below; NumPy's own is ten times as fast as // on arrays, Python's on floats.

    Example:
        >>> floor(-0.5)
        -1.0
    """
    return np.floor(number) if isinstance(number, np.ndarray) else number // 1.0


def sine(angle: Number) -> Number:
    """Sine, within 4e-16 for angles of a few turns; the library's own differs from one to another in the last bit.

    Args:
        angle: rad.

    Example:
        >>> round(sine(0.5), 12), round(sine(2.5), 12)
        (0.479425538604, 0.598472144104)
    """
    within = angle - TURN * floor(angle / TURN + 0.5)  # half a turn either way
    folded = abs(within + QUARTER) - abs(within - QUARTER) - within  # a quarter of a turn, with the same sine
    square = folded * folded
    series = SERIES[-1] * square
    for term in SERIES[-2::-1]:
        series = (series + term) * square
    return folded * series + folded


def cosine(angle: Number) -> Number:
    """Cosine, as `sine`.

    Example:
        >>> round(cosine(0.5), 12), round(cosine(2.5), 12)
        (0.87758256189, -0.801143615547)
    """
    return sine(angle + QUARTER)


def quantise(position: Number, step: Number | float) -> Number:
    """The reading of an encoder with counts of `step`, same unit as `position`.

    Example:
        >>> quantise(0.26, 0.1)
        0.30000000000000004
    """
    return floor(position / step + 0.5) * step


def velocity(
    position: Number, previous: Number, estimate: Number, keep: Number | float, gain: Number | float
) -> Number:
    """One step of the filtered difference; `keep` and `gain` are those of `velocity_gains`."""
    return keep * estimate + gain * (position - previous)


def velocity_gains(time_constant: float, period: float) -> tuple[float, float]:
    """How much of the last estimate the velocity filter keeps, and the weight of a new difference, 1/s."""
    keep = math.exp(-period / time_constant) if time_constant > 0 else 0.0
    return keep, (1.0 - keep) / period


def costs(
    cart: Number, theta1: Number, theta2: Number, volts: Number, rail: float, supply: Number | float
) -> tuple[Number, Number, Number, Number]:
    """The four terms that the reward subtracts from 1, each a quarter where cart, pole or voltage is at its limit.

    Poles count from the nearest upright, so whole turns cost nothing.

    Args:
        cart: m from the middle.
        theta1: absolute angle of the first pole from upright, rad.
        theta2: the same of the second pole.
        volts: motor voltage.
        rail: m, where `cart` reaches its limit.
        supply: V, the limit of `volts`.

    Example:
        >>> costs(0.45, 0.0, 2 * math.pi, 12.0, 0.45, 24.0)
        (0.25, 0.0, 0.0, 0.0625)
    """
    x, u = cart / rail, volts / supply
    a = (theta1 - TURN * floor((theta1 + math.pi) / TURN)) / FALL
    b = (theta2 - TURN * floor((theta2 + math.pi) / TURN)) / FALL
    return 0.25 * x * x, 0.25 * a * a, 0.25 * b * b, 0.25 * u * u
