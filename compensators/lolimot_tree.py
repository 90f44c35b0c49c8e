"""The growing network of LOLIMOT: boxes, the estimates in them, and what a cut costs."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


class Tree:
    """The growing network, on inputs scaled to the unit box, with what makes a cut cheap.

    Per sample it keeps the validity and the output of every model, the sum of validities and the blended
    numerator. A candidate cut changes two models, so its error costs the same however many models there are.
    """

    def __init__(self, Z: Array, y: Array, weight: Array, *, spread: float, ridge: float) -> None:
        samples, inputs = Z.shape
        self.rows = np.vstack([np.ones(samples), Z.T])  # regressors [1, z], one row each
        self.y, self.weight, self.spread, self.ridge = y, weight, spread, ridge
        self.home = np.zeros(samples, dtype=np.intp)  # the box each sample lies in
        self.centres = np.full((1, inputs), 0.5)
        self.widths = np.ones((1, inputs))
        self.mu = np.exp(-self._exponent(self.centres[0], self.widths[0]))[None]
        mean = np.zeros(inputs + 1)
        mean[0] = np.average(y, weights=weight)
        self.theta = self._estimate(self.centres[0], self.widths[0], np.ones(samples), mean)[None]
        self.total, self.numerator = self.mu[0], self._blended(self.theta)

    @property
    def models(self) -> int:
        """Number of boxes."""
        return len(self.centres)

    def predict(self, Z: Array, theta: Array) -> Array:
        """Outputs (samples,) at scaled inputs Z."""
        levels = theta[:, 0] + np.einsum("ij,ij->i", theta[:, 1:], self.centres)
        return blend(Z, self.centres, self.spread * self.widths, levels, theta[:, 1:])

    def squared_error_of_mean(self) -> float:
        """What is left if the mean of y is all that is predicted."""
        return float(np.average((self.y - np.average(self.y, weights=self.weight)) ** 2, weights=self.weight))

    def mean_squared_error(self, theta: Array) -> float:
        """Weighted, on the training data."""
        numerator = self.numerator if theta is self.theta else self._blended(theta)
        return float(np.average((self.y - numerator / self.total) ** 2, weights=self.weight))

    def cut_worst(self) -> bool:
        """Halve the box with the largest local error along its best axis; False if no box can be cut."""
        error = self.weight * (self.y - self.numerator / self.total) ** 2
        for worst in np.argsort(-(self.mu @ (error / self.total)), kind="stable"):
            axes = self._divisible_axes(worst)
            if len(axes):
                break
        else:
            return False
        rest_total = self.total - self.mu[worst]
        rest_numerator = self.numerator - self.mu[worst] * (self.theta[worst] @ self.rows)
        best = math.inf
        for axis in axes:
            centres, widths, mu = self._halves(worst, axis)
            total = rest_total + mu[0] + mu[1]
            theta = np.stack([self._estimate(centres[h], widths, mu[h] / total, self.theta[worst]) for h in (0, 1)])
            outputs = theta @ self.rows
            numerator = rest_numerator + mu[0] * outputs[0] + mu[1] * outputs[1]
            residual = self.y - numerator / total
            loss = float(self.weight @ (residual * residual))
            if loss < best:
                best, chosen = loss, (axis, centres, widths, mu, theta, total, numerator)
        axis, centres, widths, mu, theta, self.total, self.numerator = chosen
        upper = (self.home == worst) & (self.rows[1 + axis] > self.centres[worst, axis])
        self.home[upper] = self.models
        self.centres = _replace(self.centres, worst, centres)
        self.widths = _replace(self.widths, worst, np.stack([widths, widths]))
        self.mu = _replace(self.mu, worst, mu)
        self.theta = _replace(self.theta, worst, theta)
        return True

    def estimate_together(self) -> Array:
        """Least squares for the linear models of all boxes at once, as a correction of the local estimates."""
        models, size = self.theta.shape
        regressors = ((self.mu / self.total)[:, None, :] * self.rows).reshape(models * size, -1)
        normal = (regressors * self.weight) @ regressors.T
        for i in range(models):
            block = slice(i * size, (i + 1) * size)
            normal[block, block] += self._prior(self.centres[i], self.widths[i])
        gradient = regressors @ (self.weight * (self.y - self.numerator / self.total))
        return self.theta + np.linalg.solve(normal, gradient).reshape(models, size)

    def _blended(self, theta: Array) -> Array:
        """Sum of the models' outputs at every sample, weighted with their validities."""
        return np.einsum("ik,ik->k", self.mu, theta @ self.rows)

    def _divisible_axes(self, box: int) -> npt.NDArray[np.intp]:
        """Axes along which both halves of the box hold enough samples for a linear model each."""
        members = np.flatnonzero(self.home == box)
        weight = self.weight[members]
        upper = (self.rows[1:, members] > self.centres[box][:, None]) @ weight
        need = 2 * len(self.rows)
        return np.flatnonzero((upper >= need) & (weight.sum() - upper >= need))

    def _halves(self, box: int, axis: int) -> tuple[Array, Array, Array]:
        """Centres (2, inputs), widths (inputs,) and validities (2, samples) of the two halves of a box."""
        widths = self.widths[box].copy()
        widths[axis] /= 2
        centres = np.stack([self.centres[box], self.centres[box]])
        centres[:, axis] += (-widths[axis] / 2, widths[axis] / 2)
        return centres, widths, np.exp(-np.stack([self._exponent(centre, widths) for centre in centres]))

    def _exponent(self, centre: Array, widths: Array) -> Array:
        """Half the squared distance of every sample from a centre, in standard deviations."""
        distance = (self.rows[1:] - centre[:, None]) * (math.sqrt(0.5) / (self.spread * widths))[:, None]
        return np.einsum("jk,jk->k", distance, distance)

    def _estimate(self, centre: Array, widths: Array, validity: Array, parent: Array) -> Array:
        """Least squares weighted with the validity, as a correction of the parent's model."""
        weighted = self.rows * (self.weight * validity)
        normal = weighted @ self.rows.T
        gradient = weighted @ self.y - normal @ parent
        return parent + np.linalg.solve(normal + self._prior(centre, widths), gradient)

    def _prior(self, centre: Array, widths: Array) -> Array:
        """Normal matrix of `ridge` samples that are spread like a box's validity."""
        mean = np.concatenate([[1.0], centre])
        prior = np.outer(mean, mean)
        prior[np.arange(1, len(mean)), np.arange(1, len(mean))] += (self.spread * widths) ** 2
        return self.ridge * prior


def _replace(stack: Array, index: int, halves: Array) -> Array:
    """Put the first half in the place of the whole and append the second."""
    stack = np.concatenate([stack, halves[1:]])
    stack[index] = halves[0]
    return stack


def blend(X: Array, centres: Array, sigmas: Array, levels: Array, slopes: Array) -> Array:
    """Evaluate the network: (samples,)."""
    outputs = np.stack(
        [level + (X - centre) @ slope for level, centre, slope in zip(levels, centres, slopes, strict=True)]
    )
    return np.einsum("ik,ik->k", validities(X, centres, sigmas), outputs)


def validities(X: Array, centres: Array, sigmas: Array) -> Array:
    """Shares of the models at each sample, (models, samples); shifted exponents keep them defined far outside."""
    exponents = np.empty((len(centres), len(X)))
    for i in range(len(centres)):
        offset = (X - centres[i]) * (math.sqrt(0.5) / sigmas[i])
        exponents[i] = np.einsum("kj,kj->k", offset, offset)
    validity = np.exp(exponents.min(axis=0) - exponents)
    return validity / validity.sum(axis=0)
