"""What is known of parameters before any data weighs the same wherever it is asked."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import approx_fprime

from dipc_gym.sim2real.model.prior import Prior, product


@given(st.integers(0, 10_000), st.integers(1, 6), st.integers(1, 30))
def test_slope_and_curvature_are_those_of_what_a_fit_lowers(seed: int, p: int, n: int) -> None:
    """Losses are log1p of quadratics; half of the derivatives of n times their mean and the penalty, by differences."""
    rng = np.random.default_rng(seed)
    jacobian, left, counts = rng.normal(size=(n, 9, p)), rng.normal(size=(n, 9)), rng.integers(50, 200, n).astype(float)
    root = rng.normal(size=(p, p))
    prior = Prior(root @ root.T, rng.normal(size=p))
    z = rng.normal(size=p)

    def lowered(step: np.ndarray) -> float:
        mse = np.sum((left - jacobian @ step) ** 2, axis=1) / counts
        return float(np.sum(np.log1p(mse)) + n * prior.penalty(z + step, counts))

    A, b = np.swapaxes(jacobian, 1, 2) @ jacobian, np.einsum("nmp,nm->np", jacobian, left)
    weight = 1 / (1 + np.sum(left**2, axis=1) / counts) / counts
    curvature, slope = prior.in_fit(A, b, z, weight, counts)
    np.testing.assert_allclose(-2 * slope, approx_fprime(np.zeros(p), lowered, 1e-7), rtol=1e-4, atol=1e-4)
    assert np.linalg.eigvalsh(curvature).min() >= -1e-12


@given(st.integers(0, 10_000), st.integers(1, 40))
def test_what_no_data_tell_is_known_as_well_as_before(seed: int, n: int) -> None:
    """However many windows there are: of two parameters data tell the first alone."""
    rng = np.random.default_rng(seed)
    prior, weight = Prior(np.diag([0.1, 4.0]), np.zeros(2)), rng.uniform(0.1, 1.0, n)
    curvature = np.diag([np.sum(weight * rng.uniform(1, 100, n)), 0.0])
    covariance = np.linalg.inv(prior.in_covariance(curvature, weight)) * weight.mean()
    assert np.isclose(covariance[1, 1], 1 / 4.0)
    assert covariance[0, 0] < 1 / 0.1


def test_parameters_that_come_before_are_free() -> None:
    assert Prior(np.array([[2.0]]), np.array([1.0])).after(2).precision.tolist() == np.diag([0.0, 0.0, 2.0]).tolist()


@given(st.integers(0, 10_000), st.integers(1, 5), st.integers(1, 5))
def test_what_else_is_known_costs_what_it_costs_alone(seed: int, p: int, m: int) -> None:
    """The penalty of a product is the sum of both, but for what is the same wherever the parameters are."""
    rng = np.random.default_rng(seed)
    # Of the last parameter nothing is known before.
    prior = Prior(np.diag([*rng.uniform(0.1, 4, p - 1), 0.0]), rng.normal(size=p))
    rows, values, counts = rng.normal(size=(m, p)), rng.normal(size=m), np.full(3, 50.0)
    both = product(prior, rows, values)

    def apart(z: np.ndarray) -> float:
        return prior.penalty(z, counts) + float(np.sum((rows @ z - values) ** 2)) / 50.0

    z, other = rng.normal(size=(2, p))
    difference = both.penalty(z, counts) - both.penalty(other, counts)
    assert np.isclose(difference, apart(z) - apart(other), rtol=1e-6, atol=1e-8)
