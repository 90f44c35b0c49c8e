"""A rival of the diagnosis: PySINDy, which looks for a sum of few terms that is the force the model lacks.

Its sparse regression (sequentially thresholded least squares; Brunton, Proctor and Kutz 2016) picks among products,
squares, sines, directions and quadratic drags of positions, velocities and command. It regresses what is estimated from
derivatives, as `network` does, and is added to the model if the recordings are then simulated better. It writes a
formula; which part of the rig that belongs to it cannot say.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from dipc_gym.trials.replayed import Array, Motion, early_and_late, kept, lacking

THRESHOLDS = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5)
"""Coefficients below this go, in forces of usual size by inputs of usual size; the held-back part chooses."""
RIDGE = 1e-3  # on the coefficients, in the same units
SLOW = 0.05
"""Of a usual size: the direction of what is smaller is not told from noise."""


@dataclass(frozen=True)
class SparseForce:
    """A sum of few terms.

    Attributes:
        library: of the terms, fitted.
        spread: of the inputs (positions, velocities, command).
        scale: of the forces, N or N m.
        coefficients: (nv, terms).
    """

    library: Any
    spread: Array
    scale: Array
    coefficients: Array

    def __call__(self, q: Array, v: Array, command: Array) -> Array:
        """Generalised force, (n, nv)."""
        x = np.nan_to_num(np.concatenate([q, v, command], axis=1) / self.spread)  # what diverged is judged elsewhere
        terms = np.asarray(self.library.transform(x))
        return np.asarray(terms @ self.coefficients.T * self.scale)


def discover(model: mujoco.MjModel, motions: Sequence[Motion], noise: Array) -> SparseForce | None:
    """The force that a trial's nominal model lacks, or None if adding it makes simulations of the recordings worse.

    Args:
        model: the nominal model.
        motions: training recordings.
        noise: standard deviation of each reading's noise.

    Raises:
        ImportError: PySINDy is not installed.
    """
    force = regress(model, motions)
    return force if kept(model, motions, noise, force) else None


def regress(model: mujoco.MjModel, motions: Sequence[Motion]) -> SparseForce:
    """Few terms fitted to the unexplained force, sample by sample.

    Args:
        model: the nominal model.
        motions: training recordings.
    """
    try:
        import pysindy
    except ImportError:
        raise ImportError("the rival PySINDy is not installed: pip install pysindy") from None
    inputs, forces = lacking(model, motions)
    spread = np.concatenate(inputs).std(axis=0) + 1e-12
    scale = np.concatenate(forces).std(axis=0) + 1e-12
    x, x_late = (part / spread for part in early_and_late(inputs))
    y, y_late = (part / scale for part in early_and_late(forces))
    library = (
        pysindy.PolynomialLibrary(degree=2)
        + pysindy.FourierLibrary(n_frequencies=2)
        + pysindy.CustomLibrary(
            [lambda z: np.tanh(z / SLOW), lambda z: z * np.abs(z)],
            function_names=[lambda z: f"sign({z})", lambda z: f"{z}|{z}|"],
        )
    )
    library.fit(x)
    terms, late = np.asarray(library.transform(x)), np.asarray(library.transform(x_late))
    found = [np.zeros((y.shape[1], terms.shape[1]))]  # without evidence nothing is added
    for threshold in THRESHOLDS:
        with warnings.catch_warnings():  # that nothing is left of a sum is an answer as well
            warnings.simplefilter("ignore", UserWarning)
            fit = pysindy.STLSQ(threshold=threshold, alpha=RIDGE * len(x)).fit(terms, y)
        found.append(np.asarray(fit.coef_))
    errors = [float(np.mean((late @ each.T - y_late) ** 2)) for each in found]
    return SparseForce(library, spread, scale, found[int(np.argmin(errors))])
