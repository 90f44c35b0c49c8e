"""How many local models a LOLIMOT network should have, by cross-validation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from dipc_gym.compensators.lolimot import LOLIMOT
from dipc_gym.compensators.tables import checked_inputs, checked_outputs

Array = npt.NDArray[np.float64]

__all__ = ["Selection", "select"]


@dataclass(frozen=True, eq=False)
class Selection:
    """What cross-validation chose.

    Attributes:
        model: The network of the chosen size, fitted to all data.
        errors: (folds, sizes) mean squared error on each fold with 1, 2, ... models, fitted to the others.
        standard_error: (sizes,) of the mean over the folds.
        lowest: Size of the lowest mean error.
        models: The chosen size: the smallest whose mean error is within one standard error of the lowest.
    """

    model: LOLIMOT
    errors: Array
    standard_error: Array
    lowest: int
    models: int

    @property
    def error(self) -> float:
        """Mean squared error of the chosen size on data it was not fitted to; a little low, for it was chosen by it."""
        return float(self.errors[:, self.models - 1].mean())


def select(
    template: LOLIMOT,
    X: npt.ArrayLike,
    y: npt.ArrayLike,
    *,
    folds: int = 5,
    groups: npt.ArrayLike | None = None,
    seed: int = 0,
) -> Selection:
    """Choose the number of local models by cross-validation, and fit a network of that size to all data.

    A network grows one model at a time, so one training for each fold tries every size up to `template.max_models`.

    Args:
        template: Its options; `patience` and `tolerance` do not matter here.
        X: (samples, inputs) inputs.
        y: (samples,) outputs.
        folds: Number of parts, each of which is held out once.
        groups: (samples,) labels; samples of one label are held out together. For time series, number the stretches:
            neighbours in time know each other's errors, and single samples would choose too many models.
        seed: Of the shuffle that makes the folds.

    Raises:
        ValueError: Data are not usable, or there are fewer groups than folds.

    Source: L. Breiman, J. Friedman, R. Olshen, C. Stone, Classification and Regression Trees, 1984, section 3.4.3, for
        the rule of one standard error.

    Example:
        >>> rng = np.random.default_rng(0)
        >>> x = rng.uniform(-1, 1, (400, 1))
        >>> select(LOLIMOT(max_models=8), x, 2 * x[:, 0] + 0.1 * rng.normal(size=400)).models
        1
    """
    X = checked_inputs(X)
    y = checked_outputs(y, len(X))
    labels = np.arange(len(X)) if groups is None else np.asarray(groups)
    if labels.shape != (len(X),):
        raise ValueError(f"groups has shape {labels.shape}, but X has {len(X)} samples")
    distinct, member = np.unique(labels, return_inverse=True)
    if not 2 <= folds <= len(distinct):
        raise ValueError(
            f"folds is {folds}; there are {len(distinct)} groups of samples, so it can be 2 to {len(distinct)}"
        )
    fold = np.random.default_rng(seed).permutation(np.arange(len(distinct)) % folds)[member]
    sizes = template.max_models
    errors = np.empty((folds, sizes))
    for k in range(folds):
        inside = fold != k
        options = {**template.get_params(), "patience": sizes, "tolerance": 0.0}
        grown = LOLIMOT(**options).fit(X[inside], y[inside], test=(X[~inside], y[~inside]))
        curve = grown.test_errors_
        errors[k] = np.append(curve, np.full(sizes - len(curve), curve[-1]))  # no box could be cut any more
    mean = errors.mean(axis=0)
    standard_error = errors.std(axis=0, ddof=1) / np.sqrt(folds)
    lowest = int(np.argmin(mean))
    chosen = int(np.argmax(mean <= mean[lowest] + standard_error[lowest]))
    model = LOLIMOT(**{**template.get_params(), "max_models": chosen + 1}).fit(X, y)
    return Selection(model, errors, standard_error, lowest + 1, chosen + 1)
