"""Checks of the tables a regressor is given, with messages that say what to mend."""

from __future__ import annotations

import sys
import warnings
from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


def sklearn_class(name: str, fallback: type[Exception]) -> Any:
    """Scikit-learn's class of that name where scikit-learn is loaded, so that its tools recognise it."""
    return getattr(sys.modules.get("sklearn.exceptions"), name, fallback)


def checked_inputs(X: Any) -> Array:
    """Return X as a finite (samples, inputs) table of floats."""
    if hasattr(X, "toarray"):
        raise TypeError("X is a sparse matrix; LOLIMOT needs a dense array: pass X.toarray()")
    X = np.asarray(X)
    if np.iscomplexobj(X):
        raise ValueError("Complex data not supported: X must be real")
    if X.ndim != 2:
        raise ValueError(
            f"X must be a table (samples, inputs), got {X.ndim} dimension(s). Reshape your data: "
            "X.reshape(-1, 1) for one input, X.reshape(1, -1) for one sample"
        )
    X = X.astype(np.float64)
    if X.shape[0] < 1:
        raise ValueError(f"Found array with 0 sample(s) (shape={X.shape}) while a minimum of 1 is required.")
    if X.shape[1] < 1:
        raise ValueError(f"0 feature(s) (shape={X.shape}) while a minimum of 1 is required.")
    if not np.isfinite(X).all():
        raise ValueError("X has NaN or infinity; drop or repair those samples")
    return X


def checked_outputs(y: Any, samples: int) -> Array:
    """Return y as a finite (samples,) array of floats."""
    if y is None:
        raise ValueError("requires y to be passed, but the target y is None")
    y = np.asarray(y)
    if np.iscomplexobj(y):
        raise ValueError("Complex data not supported: y must be real")
    if y.ndim == 2 and y.shape[1] == 1:
        warnings.warn(
            "A column-vector y was passed when a 1d array was expected: use y.ravel()",
            sklearn_class("DataConversionWarning", UserWarning),
            stacklevel=3,
        )
        y = y.ravel()
    if y.shape != (samples,):
        raise ValueError(f"y has shape {y.shape}, but X has {samples} samples: y must be ({samples},)")
    y = y.astype(np.float64)
    if not np.isfinite(y).all():
        raise ValueError("y has NaN or infinity (inf); drop or repair those samples")
    return y


def checked_weights(sample_weight: Any, samples: int) -> Array:
    """Return weights as a (samples,) array that is finite, not negative and not all zero."""
    if sample_weight is None:
        return np.ones(samples)
    weight = np.asarray(sample_weight, dtype=np.float64)
    if weight.ndim == 0:
        weight = np.full(samples, float(weight))
    if weight.shape != (samples,):
        raise ValueError(f"sample_weight has shape {weight.shape}, but X has {samples} samples")
    if not (np.isfinite(weight).all() and (weight >= 0).all()):
        raise ValueError("sample_weight must be finite and not negative")
    if not weight.any():
        raise ValueError("sample_weight is zero everywhere: at least one sample must count")
    return weight
