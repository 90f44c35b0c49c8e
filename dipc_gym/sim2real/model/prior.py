"""What is known of parameters before any data, and what it weighs beside them: all of that stands here."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Prior:
    """A normal distribution of mapped parameters.

    Attributes:
        precision: inverse covariance, (p, p); 0 where nothing is known.
        centre: mean, (p,).
    """

    precision: Array
    centre: Array

    def after(self, count: int) -> Prior:
        """The same of parameters that come after so many of which nothing is known."""
        return Prior(np.pad(self.precision, (count, 0)), np.pad(self.centre, (count, 0)))

    def penalty(self, z: Array, counts: Array) -> float:
        """What a fit adds to the mean loss of windows: a prior weighs as much as one reading of each window.

        Args:
            z: mapped parameters, (p,).
            counts: readings in each window, (n,).
        """
        off = z - self.centre
        return float(off @ self.precision @ off / counts.mean())

    def in_fit(self, A: Array, b: Array, z: Array, weight: Array, counts: Array) -> tuple[Array, Array]:
        """Curvature (p, p) and slope (p,) of what a fit lowers, losses and this penalty, summed over windows.

        Args:
            A: curvatures of the windows' sums of squares, (n, p, p).
            b: their slopes at z, (n, p); see `estimation.fit.Quadratics`.
            z: mapped parameters, (p,).
            weight: of each window's sum of squares in its loss, (n,).
            counts: readings in each window, (n,).
        """
        own = len(weight) * self.precision / counts.mean()
        return np.einsum("n,nij->ij", weight, A) + own, weight @ b - own @ (z - self.centre)

    def in_covariance(self, curvature: Array, weight: Array) -> Array:
        """Inverse covariance of parameters, times the mean weight: what data and prior say together, (..., p, p).

        Unlike in a fit, a prior counts once here, however many windows there are: what no data tell is known no better
        than before them.

        Args:
            curvature: summed over windows of these weights, (..., p, p).
            weight: of each window, (n,).
        """
        return np.asarray(curvature + weight.mean() * self.precision)


def product(one: Prior, rows: Array, values: Array) -> Prior:
    """The product of a prior and of what else is known: that some sums of parameters are about these values.

    Args:
        one: prior.
        rows: weights of the sums, each over its standard deviation, (m, p).
        values: likewise, (m,).
    """
    precision = one.precision + rows.T @ rows
    # Where nothing is known both sides are zero, and the centre is anything.
    centre = np.linalg.pinv(precision, hermitian=True) @ (one.precision @ one.centre + rows.T @ values)
    return Prior(precision, centre)
