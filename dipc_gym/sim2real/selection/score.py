"""Whether one fit predicts better than another, beyond chance: the errors of the same windows, compared by blocks."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, stdtrit

from dipc_gym.sim2real.estimation.settings import ESTIMATION
from dipc_gym.sim2real.estimation.shooting import loss, typical
from dipc_gym.sim2real.selection.settings import SCORE

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Improvement:
    """How much better one fit predicts than another.

    Attributes:
        gain: mean fall of the log square error over the windows compared on; 0.7 is a factor of two. Far from the
            noise that of the forces is added.
        error: standard error of it, over blocks of a second.
        shows: whether it shows at the noise in a few blocks, far beyond it, and in none the other way: an effect that
            acts in three of eighty windows is there, though its gain is as uncertain as it is uneven.
        worst: mean gain of the block that lost most.
    """

    gain: float
    error: float
    shows: bool = False
    worst: float = 0.0

    @property
    def clear(self) -> bool:
        """Better beyond chance, and by enough to matter; a large gain need not be as even over the windows."""
        return self.gain > SCORE.worth and (
            self.shows or self.gain > (SCORE.clear if self.gain < SCORE.large else SCORE.clear_at_large) * self.error
        )

    @property
    def told(self) -> bool:
        """Better beyond chance, by more than simulations of one and the same model may differ."""
        return self.gain > max(SCORE.told_apart, SCORE.clear * self.error)

    @property
    def matters(self) -> bool:
        """Better by enough to be worth an effect, and by more than a standard error."""
        return self.gain > max(SCORE.worth, self.error)

    @property
    def alike(self) -> bool:
        """Not told from the other, or hardly better than it."""
        return not self.shows and self.gain < max(SCORE.hardly, SCORE.alike * self.error)


def compare(new: Array, old: Array, blocks: NDArray[np.intp], forces: tuple[Array, Array] | None = None) -> Improvement:
    """Paired comparison of windows, by blocks.

    Args:
        new: mean square errors of the windows, in units of noise, (n,).
        old: of the other fit.
        blocks: a number for each window, (n,); windows of one block share it.
        forces: mean squares of the force that either fit leaves unexplained, (n, nb) each: what explains motion has to
            explain forces as well. The joints' mean counts as much as the motion does.
    """
    usual = min(typical(new), typical(old))
    difference = loss(old, usual) - loss(new, usual)
    if forces is not None:
        joints = zip(forces[0].T, forces[1].T, strict=True)
        difference = difference + np.mean([_fall(after, before) for after, before in joints], axis=0)
    sums = np.bincount(blocks, difference)
    sizes = np.bincount(blocks)
    sums, sizes = sums[sizes > 0], sizes[sizes > 0]
    mean = float(np.sum(sums) / np.sum(sizes))
    each = sums / sizes
    worst = float(each.min())
    if len(sums) < SCORE.fewest_blocks:
        return Improvement(mean, math.inf, worst=worst)
    shows = usual < SCORE.usual and int(np.sum(each > SCORE.large)) >= SCORE.blocks and not np.any(each < -SCORE.large)
    spread = np.sqrt(np.sum((sums - mean * sizes) ** 2) * len(sums) / (len(sums) - 1)) / np.sum(sizes)
    return Improvement(mean, float(spread) * _few_blocks(len(sums)), shows, worst)


def _fall(after: Array, before: Array) -> Array:
    """By how much the logarithms of mean squares (n,) fell; what is far below the usual hardly counts."""
    usual = min(np.quantile(after, ESTIMATION.typical), np.quantile(before, ESTIMATION.typical)) or 1.0
    return loss(before, usual) - loss(after, usual)


def _few_blocks(count: int) -> float:
    """By how much a standard error from so few blocks is to be widened to mean what it does with many (Student's t)."""
    many, tail = stdtrit([SCORE.many - 1, count - 1], ndtr(SCORE.clear))
    return max(1.0, float(tail / many))
