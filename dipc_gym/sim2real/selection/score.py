"""Whether one fit predicts better than another, beyond chance: the errors of the same windows, compared by blocks."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, stdtrit

from dipc_gym.sim2real.estimation.shooting import loss, typical

Array = NDArray[np.float64]

CLEAR = 2.5  # standard errors by which an improvement must stand out
MANY = 40  # blocks of a second: a recording of the usual length
LARGE = 0.5  # improvement of the mean log square error (an error one fifth smaller) that no chance brings about
ALIKE = 2.0  # standard errors within which two fits are not told apart
WORTH = 0.02  # smallest improvement of the mean log square error that is worth an effect
QUIET = 1.5  # usual square error up to which windows are at the noise
TELLING = 3  # blocks that tell two fits apart at the noise, if no other says the opposite


@dataclass(frozen=True)
class Improvement:
    """How much better one fit predicts than another.

    Attributes:
        gain: mean fall of the log square error over the windows compared on; 0.7 is a factor of two.
        error: standard error of it, over blocks of a second.
        shows: whether it shows at the noise in a few blocks, far beyond it, and in none the other way: an effect that
            acts in three of eighty windows is there, though its gain is as uncertain as it is uneven.
    """

    gain: float
    error: float
    shows: bool = False

    @property
    def clear(self) -> bool:
        """Better beyond chance, and by enough to matter; a large gain need not be as even over the windows."""
        return self.gain > WORTH and (self.shows or self.gain > (CLEAR if self.gain < LARGE else 1.0) * self.error)

    @property
    def told(self) -> bool:
        """Better beyond chance, by more than simulations of one and the same model may differ."""
        return self.gain > max(WORTH / 4, CLEAR * self.error)

    @property
    def alike(self) -> bool:
        """Not told from the other, or hardly better than it."""
        return not self.shows and self.gain < max(WORTH / 2, ALIKE * self.error)


def compare(new: Array, old: Array, blocks: NDArray[np.intp]) -> Improvement:
    """Paired comparison of mean square errors (n,) of windows, by blocks."""
    usual = min(typical(new), typical(old))
    difference = loss(old, usual) - loss(new, usual)
    sums = np.bincount(blocks, difference)
    sizes = np.bincount(blocks)
    sums, sizes = sums[sizes > 0], sizes[sizes > 0]
    mean = float(np.sum(sums) / np.sum(sizes))
    if len(sums) < 3:
        return Improvement(mean, math.inf)
    each = sums / sizes
    shows = usual < QUIET and int(np.sum(each > LARGE)) >= TELLING and not np.any(each < -LARGE)
    spread = np.sqrt(np.sum((sums - mean * sizes) ** 2) * len(sums) / (len(sums) - 1)) / np.sum(sizes)
    return Improvement(mean, float(spread) * _few_blocks(len(sums)), shows)


def _few_blocks(count: int) -> float:
    """By how much a standard error from so few blocks is to be widened to mean what it does with many (Student's t)."""
    many, tail = stdtrit([MANY - 1, count - 1], ndtr(CLEAR))
    return max(1.0, float(tail / many))
