"""Readings smoothed as much as their own noise asks for."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import linalg, optimize

Array = NDArray[np.float64]

ORDER = 3  # of the difference whose square is penalised
WEIGHTS = (1e-5, 1e7)
"""Smoothest and roughest; at the lower end nothing is smoothed, at the upper one all but trends of 50 samples is."""


@dataclass(frozen=True, eq=False)
class Smoothed:
    """Smoothed readings.

    Attributes:
        values: (n,) in the readings' unit.
        weight: of the penalty, as chosen.
        noise: standard deviation of the readings' noise, in their unit.
    """

    values: Array
    weight: float
    noise: float

    def response(self, frequency: Array) -> Array:
        """How much of a sine passes, between 0 and 1; `frequency` in radians per sample."""
        return 1 / (1 + self.weight * (2 - 2 * np.cos(frequency)) ** ORDER)


def smooth(readings: ArrayLike) -> Smoothed:
    """Smooth equally spaced readings of a position whose second derivative is wanted.

    The values z minimise |y - z|^2 + weight |third differences of z|^2, which is to say that acceleration changes as
    little as the readings allow. The weight is the one of the lowest generalised cross-validation score,
    |y - z|^2 / trace(I - H)^2 with z = H y: how well every reading is predicted by all others.

    Args:
        readings: (n,), n of at least 20.

    Raises:
        ValueError: fewer readings, or one that is not finite.

    Source: P. H. C. Eilers, "A perfect smoother", Analytical Chemistry 75 (2003) 3631-3636; P. Craven, G. Wahba,
        "Smoothing noisy data with spline functions", Numerische Mathematik 31 (1979) 377-403.

    Example:
        >>> time = np.linspace(0, 4, 400)
        >>> noise = 0.01 * np.random.default_rng(0).standard_normal(400)
        >>> done = smooth(np.sin(time) + noise)
        >>> round(done.noise, 3), bool(np.std(done.values - np.sin(time)) < 0.003)
        (0.01, True)
    """
    y = np.asarray(readings, dtype=np.float64)
    if y.ndim != 1 or len(y) < 20 or not np.isfinite(y).all():
        raise ValueError(f"smoothing needs 20 finite readings or more in one row; these are of shape {y.shape}")
    diagonals = _penalty(len(y))
    # Of third differences without their ends, whose few eigenvalues do not matter to a trace.
    eigenvalues = (2 - 2 * np.cos(np.pi * (np.arange(len(y)) + 0.5) / len(y))) ** ORDER

    def fitted(weight: float) -> tuple[Array, float, float]:
        values = linalg.solveh_banded(weight * diagonals + _unit(len(y)), y, lower=True, check_finite=False)
        freedom = float(np.sum(weight * eigenvalues / (1 + weight * eigenvalues)))
        return values, float(np.sum((y - values) ** 2)), freedom

    def score(log_weight: float) -> float:
        _, squares, freedom = fitted(math.exp(log_weight))
        return math.log(squares + 1e-300) - 2 * math.log(freedom)

    low, high = (math.log(weight) for weight in WEIGHTS)
    coarse = np.linspace(low, high, 15)
    best = int(np.argmin([score(x) for x in coarse]))
    ends = coarse[max(best - 1, 0)], coarse[min(best + 1, len(coarse) - 1)]
    weight = math.exp(optimize.minimize_scalar(score, bounds=ends, method="bounded", options={"xatol": 0.05}).x)
    values, squares, _ = fitted(weight)
    # What white noise alone would leave; where little is smoothed, a sound estimate still, unlike squares / freedom.
    stopped = weight * eigenvalues / (1 + weight * eigenvalues)
    return Smoothed(values, weight, math.sqrt(squares / float(np.sum(stopped**2))))


def _penalty(n: int) -> Array:
    """D'D of the third differences D, in the lower banded form of SciPy: (ORDER + 1, n)."""
    coefficients = np.array([-1.0, 3.0, -3.0, 1.0])
    bands = np.zeros((ORDER + 1, n))
    for i, a in enumerate(coefficients):
        for j, b in enumerate(coefficients[: i + 1]):
            bands[i - j, j : n - ORDER + j] += a * b
    return bands


def _unit(n: int) -> Array:
    unit = np.zeros((ORDER + 1, n))
    unit[0] = 1.0
    return unit
