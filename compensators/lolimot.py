"""LOLIMOT: local linear models, grown by halving the cell that fits worst."""

from __future__ import annotations

import inspect
import math
from typing import TYPE_CHECKING, Any, Self

import numpy as np
import numpy.typing as npt

from dipc_gym.compensators.lolimot_tree import Tree, blend
from dipc_gym.compensators.tables import checked_inputs, checked_outputs, checked_weights, sklearn_class

if TYPE_CHECKING:
    from sklearn.utils import Tags

Array = npt.NDArray[np.float64]


class LOLIMOT:
    """Regression by local linear models whose Gaussian validities a tree of boxes lays out.

    The prediction is a weighted mean of linear models (Takagi-Sugeno rules, a locally linear neuro-fuzzy
    network):

        y(x) = sum_i phi_i(x) (level_i + slope_i . (x - centre_i)),      phi_i = mu_i / sum_m mu_m,
        mu_i(x) = exp(-1/2 sum_j ((x_j - centre_ij) / sigma_ij)^2).

    Training starts with one box around the data. Again and again the box with the largest local error
    sum_k phi_i(x_k) e_k^2 is cut in half, once along every axis, and the cut that leaves the smallest error
    over all samples stays. Only the two new linear models are estimated, by least squares weighted with
    their validity; all others keep their numbers.

    **Width of the Gaussians.** A box of width w has sigma = k w, the same k on all axes, chosen so that the
    validity mu is `border_validity` in the middle of each face of the box. There one axis is w/2 from the
    centre and the others are at it, so exp(-(w/2)^2 / (2 k^2 w^2)) = b and

        k = 1 / sqrt(-8 ln b);    b = 0.7 gives k = 0.59200,    the usual k = 1/3 is b = 0.325.

    **Poor data.** A box may hold fewer directions than a linear model has slopes (few samples, an input
    that does not move, two inputs that move together). So every new model is estimated as if `ridge` samples,
    spread like its validity, agreed with its parent's model: what the data do not say, the parent says.
    The parent of the first model is the mean of y. A box is cut only where both halves hold twice as many
    samples as a linear model has numbers.

    Args:
        max_models: Most local models to grow.
        border_validity: Validity b at the border of a box, between 0 and 1.
        estimation: `"local"`, or `"global"` to estimate the linear models of all boxes together once the
            boxes are laid out: a smaller training error for a longer training, and slopes that mean less on
            their own. The boxes are the same, laid out with local estimates.
        ridge: Number of imagined samples that agree with the parent's model.
        patience: Cuts in a row that do not lower the test error after which growing ends, if `fit` is given
            test data. One or two such cuts are no reason to stop: cutting a symmetric problem in its middle
            gains nothing by itself, but the cuts that follow do.
        tolerance: What counts as lowering: by more than this share of the test error of a single linear
            model. The network after the last such cut is kept.

    Attributes:
        centres_: (models, inputs) centres of the boxes, in units of X.
        sigmas_: (models, inputs) standard deviations of the validities, in units of X.
        levels_: (models,) values of the linear models at their centres, in units of y.
        slopes_: (models, inputs) slopes of the linear models, units of y over units of X.
        train_errors_: (steps,) weighted mean squared training error with 1, 2, ... models.
        test_errors_: (steps,) mean squared test error with 1, 2, ... models; empty without test data.
        n_features_in_: Number of inputs.

    Source: O. Nelles, Nonlinear System Identification, Springer 2001, chapter 13; the validity of 0.7 at the
    border from H. Nejadfard, M. J. Yazdanpanah, I. Hassanzadeh, Neural Computing and Applications 22 (2013).

    Example:
        >>> import numpy as np
        >>> x = np.linspace(-1, 1, 400)[:, None]
        >>> model = LOLIMOT(max_models=8).fit(x, np.abs(x[:, 0]))
        >>> bool(np.max(np.abs(model.predict(x) - np.abs(x[:, 0]))) < 0.1)
        True
    """

    def __init__(
        self,
        *,
        max_models: int = 30,
        border_validity: float = 0.7,
        estimation: str = "local",
        ridge: float = 1e-3,
        patience: int = 3,
        tolerance: float = 0.01,
    ) -> None:
        self.max_models = max_models
        self.border_validity = border_validity
        self.estimation = estimation
        self.ridge = ridge
        self.patience = patience
        self.tolerance = tolerance

    def fit(
        self,
        X: npt.ArrayLike,
        y: npt.ArrayLike,
        sample_weight: npt.ArrayLike | None = None,
        *,
        test: tuple[npt.ArrayLike, npt.ArrayLike] | None = None,
    ) -> Self:
        """Grow the network.

        Args:
            X: (samples, inputs) inputs.
            y: (samples,) outputs.
            sample_weight: (samples,) weights, not negative; a weight of 2 counts as two equal samples.
            test: Inputs and outputs on which the error is watched; growing stops when it stops falling.

        Returns:
            The fitted network itself.

        Raises:
            ValueError: An option, a shape or a value is not usable; the message says which.
        """
        self._check_options()
        X = checked_inputs(X)
        y = checked_outputs(y, len(X))
        weight = checked_weights(sample_weight, len(X))
        X, y, weight = X[weight > 0], y[weight > 0], weight[weight > 0]

        low = X.min(axis=0)
        span = X.max(axis=0) - low
        scale = np.where(span > 0, span, 1.0)
        low = np.where(span > 0, low, low - 0.5)  # an input that does not move sits in the middle of its box
        spread = 1 / math.sqrt(-8 * math.log(self.border_validity))
        tree = Tree((X - low) / scale, y, weight, spread=spread, ridge=self.ridge)
        watch = None
        if test is not None:
            test_X = checked_inputs(test[0])
            if test_X.shape[1] != X.shape[1]:
                raise ValueError(f"test has {test_X.shape[1]} inputs, the training data {X.shape[1]}")
            watch = ((test_X - low) / scale, checked_outputs(test[1], len(test_X)))
        kept, self.train_errors_, self.test_errors_ = self._grow(tree, watch)

        centres, widths, theta = kept
        self.centres_ = low + scale * centres
        self.sigmas_ = spread * widths * scale
        self.levels_ = theta[:, 0] + np.einsum("ij,ij->i", theta[:, 1:], centres)
        self.slopes_ = theta[:, 1:] / scale
        self.n_features_in_ = X.shape[1]
        return self

    def _grow(self, tree: Tree, watch: tuple[Array, Array] | None) -> tuple[tuple[Array, Array, Array], Array, Array]:
        """Cut boxes until a stopping rule holds; return the network to keep and both error curves."""
        train_errors: list[float] = []
        test_errors: list[float] = []
        kept = tree.centres, tree.widths, tree.theta
        lowest, cuts_in_vain = math.inf, 0
        total = tree.squared_error_of_mean()
        while True:
            theta = tree.theta if self.estimation == "local" else tree.estimate_together()
            train_errors.append(tree.mean_squared_error(theta))
            if watch is None:
                kept = tree.centres, tree.widths, theta
            else:
                test_errors.append(float(np.mean((tree.predict(watch[0], theta) - watch[1]) ** 2)))
                if test_errors[-1] < lowest - self.tolerance * test_errors[0]:
                    kept = tree.centres, tree.widths, theta
                    lowest, cuts_in_vain = test_errors[-1], 0
                else:
                    cuts_in_vain += 1
                if cuts_in_vain >= self.patience:
                    break
            at_rounding = train_errors[-1] <= 1e-20 * total
            if tree.models >= self.max_models or at_rounding or not tree.cut_worst():
                break
        return kept, np.array(train_errors), np.array(test_errors)

    def predict(self, X: npt.ArrayLike) -> Array:
        """Predict the output.

        Args:
            X: (samples, inputs) inputs.

        Returns:
            (samples,) outputs.

        Raises:
            ValueError: Not fitted yet, or X is not usable.
        """
        if not hasattr(self, "centres_"):
            error = sklearn_class("NotFittedError", ValueError)
            raise error("This LOLIMOT instance is not fitted yet: call fit first.")
        X = checked_inputs(X)
        if X.shape[1] != self.n_features_in_:
            raise ValueError(
                f"X has {X.shape[1]} features, but LOLIMOT is expecting {self.n_features_in_} features as input"
            )
        return blend(X, self.centres_, self.sigmas_, self.levels_, self.slopes_)

    def score(self, X: npt.ArrayLike, y: npt.ArrayLike, sample_weight: npt.ArrayLike | None = None) -> float:
        """Return the coefficient of determination R^2 of the prediction."""
        prediction = self.predict(X)
        y = checked_outputs(y, len(prediction))
        weight = checked_weights(sample_weight, len(y))
        mean = np.average(y, weights=weight)
        if np.ptp(y[weight > 0]) == 0:  # of a constant nothing varies that could be explained: right or wrong
            return float(np.allclose(prediction, y, rtol=1e-9, atol=0.0))
        return float(1 - np.sum(weight * (y - prediction) ** 2) / np.sum(weight * (y - mean) ** 2))

    def get_params(self, deep: bool = True) -> dict[str, Any]:
        """Return the options by name; `deep` is there for scikit-learn and changes nothing."""
        return {name: getattr(self, name) for name in _option_names()}

    def set_params(self, **params: Any) -> Self:
        """Set options by name.

        Raises:
            ValueError: There is no option of that name.
        """
        for name, value in params.items():
            if name not in _option_names():
                raise ValueError(f"LOLIMOT has no parameter {name!r}; it has {', '.join(_option_names())}")
            setattr(self, name, value)
        return self

    def __repr__(self) -> str:
        options = ", ".join(f"{name}={value!r}" for name, value in self.get_params().items())
        return f"LOLIMOT({options})"

    def __sklearn_tags__(self) -> Tags:
        """Tell scikit-learn what this is; only scikit-learn calls it, so only then is it imported."""
        from sklearn.utils import InputTags, RegressorTags, Tags, TargetTags

        return Tags(
            estimator_type="regressor",
            target_tags=TargetTags(required=True),
            regressor_tags=RegressorTags(),
            input_tags=InputTags(),
        )

    def _check_options(self) -> None:
        if self.max_models < 1:
            raise ValueError(f"max_models is {self.max_models}; it must be at least 1")
        if not 0 < self.border_validity < 1:
            raise ValueError(f"border_validity is {self.border_validity}; it must lie between 0 and 1")
        if self.estimation not in ("local", "global"):
            raise ValueError(f"estimation is {self.estimation!r}; it must be 'local' or 'global'")
        if not (self.ridge > 0 and math.isfinite(self.ridge)):
            raise ValueError(f"ridge is {self.ridge}; it must be a positive number")
        if self.patience < 1:
            raise ValueError(f"patience is {self.patience}; it must be at least 1")
        if not 0 <= self.tolerance < 1:
            raise ValueError(f"tolerance is {self.tolerance}; it must be at least 0 and below 1")


def _option_names() -> list[str]:
    return [name for name in inspect.signature(LOLIMOT.__init__).parameters if name != "self"]
