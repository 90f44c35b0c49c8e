"""How far a LOLIMOT network can be trusted: standard errors of its output, and of what would be measured."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from dipc_gym.compensators.lolimot import LOLIMOT
from dipc_gym.compensators.lolimot_tree import validities
from dipc_gym.compensators.tables import checked_inputs, checked_outputs, checked_weights

Array = npt.NDArray[np.float64]

__all__ = ["Uncertainty", "uncertainty"]


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """Standard deviations that go with a network's predictions.

    Attributes:
        model: The network.
        covariance: (numbers, numbers) of all its linear numbers: level and slopes of the first model, of the second...
        noise: (models,) root mean square of what the network leaves, weighted with each model's validity, in units of
            y. What the network fits badly counts as noise.
    """

    model: LOLIMOT
    covariance: Array
    noise: Array

    def of_mean(self, X: npt.ArrayLike) -> Array:
        """Standard error of the prediction, (samples,): how much another set of training data would move it."""
        X = checked_inputs(X)
        regressors = _regressors(_rows(self.model, X), validities(X, self.model.centres_, self.model.sigmas_))
        return np.sqrt(np.maximum(np.einsum("pk,pk->k", regressors, self.covariance @ regressors), 0.0))

    def of_samples(self, X: npt.ArrayLike) -> Array:
        """Standard deviation of a new measurement from its prediction, (samples,): standard error and noise."""
        X = checked_inputs(X)
        noise = self.noise**2 @ validities(X, self.model.centres_, self.model.sigmas_)
        return np.sqrt(self.of_mean(X) ** 2 + noise)


def uncertainty(
    model: LOLIMOT, X: npt.ArrayLike, y: npt.ArrayLike, sample_weight: npt.ArrayLike | None = None
) -> Uncertainty:
    """Estimate the uncertainty of a network from the data that it was fitted to.

    The network is linear in y once its boxes are laid out, theta = U y, so the numbers' covariance is U diag(e^2) U'
    with the residuals e: noise may differ from place to place, and neighbours that share samples err together. That the
    boxes were chosen by the same data, and that ridge and misfit bias the mean, is not in it. Samples must be
    independent; of a time series whose errors hang together, take every few.

    Args:
        model: Fitted.
        X: (samples, inputs) inputs of the training.
        y: (samples,) outputs of the training.
        sample_weight: (samples,) weights of the training.

    Raises:
        ValueError: Not fitted yet, or data that are not usable.

    Source: H. White, "A heteroskedasticity-consistent covariance matrix estimator", Econometrica 48 (1980) 817-838; for
        local models O. Nelles, Nonlinear System Identification, Springer 2001, section 13.

    Example:
        >>> rng = np.random.default_rng(0)
        >>> x = rng.uniform(-1, 1, (800, 1))
        >>> y = np.abs(x[:, 0]) + 0.1 * rng.normal(size=800)
        >>> known = uncertainty(LOLIMOT(max_models=6).fit(x, y), x, y)
        >>> known.of_samples([[0.5]]).round(1).tolist(), bool(known.of_mean([[0.5]])[0] < 0.03)
        ([0.1], True)
    """
    X = checked_inputs(X)
    residual = checked_outputs(y, len(X)) - model.predict(X)
    weight = checked_weights(sample_weight, len(X))
    rows, validity = _rows(model, X), validities(X, model.centres_, model.sigmas_)
    prior = [model.ridge * np.append(1.0, sigma**2) for sigma in model.sigmas_]
    if model.estimation == "global":
        parts = [(_regressors(rows, validity), weight, np.concatenate(prior))]
    else:
        parts = [(rows[i], weight * validity[i], prior[i]) for i in range(len(rows))]
    solved = [np.linalg.solve((table * pull) @ table.T + np.diag(own), table * pull) for table, pull, own in parts]
    # Each sample's pull on its own prediction, summed: how many numbers the data had to pay for.
    operator = np.concatenate(solved)
    used = float(np.sum(_regressors(rows, validity) * operator))
    squares = residual**2 * weight.sum() / max(weight.sum() - used, 1.0)
    share = validity * weight
    noise = np.sqrt(share @ squares / np.maximum(share.sum(axis=1), 1e-300))
    # A sample of weight w stands for w equal ones: their errors are independent, where one would pull w times as hard.
    apart = np.divide(squares, weight, out=np.zeros_like(squares), where=weight > 0)
    return Uncertainty(model, (operator * apart) @ operator.T, noise)


def _rows(model: LOLIMOT, X: Array) -> Array:
    """(models, 1 + inputs, samples): 1 and the distances from each centre."""
    distance = (X[None] - model.centres_[:, None]).swapaxes(1, 2)
    return np.concatenate([np.ones((len(distance), 1, len(X))), distance], axis=1)


def _regressors(rows: Array, validity: Array) -> Array:
    """(numbers, samples): what each linear number is multiplied with in the output."""
    return (rows * validity[:, None]).reshape(-1, rows.shape[2])
