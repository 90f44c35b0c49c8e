"""Gains against the paper and against python-control."""

from __future__ import annotations

import control
import numpy as np
import pytest

from dipc_gym.controllers import lqr
from dipc_gym.env import DoublePendulumEnv

RECOVERED_PERIOD = 0.12e-3  # s, at which the recovered weights give the gain that the paper prints


@pytest.fixture(scope="module")
def upright() -> tuple[np.ndarray, np.ndarray]:
    return lqr.linear_model(DoublePendulumEnv().model)


def test_printed_gain_follows_from_the_recovered_weights(upright: tuple[np.ndarray, np.ndarray]) -> None:
    K = lqr.dlqr(*lqr.sampled(*upright, RECOVERED_PERIOD), lqr.RECOVERED_Q, lqr.R)
    np.testing.assert_allclose(K[0], lqr.PRINTED_GAIN, rtol=0.004)


def test_printed_gain_follows_from_the_printed_weights_at_no_sample_time(
    upright: tuple[np.ndarray, np.ndarray],
) -> None:
    for period in np.geomspace(1e-5, 0.02, 30):
        K = lqr.dlqr(*lqr.sampled(*upright, period), lqr.PRINTED_Q, lqr.R)
        assert np.abs(K[0] / lqr.PRINTED_GAIN - 1).max() > 0.5


def test_printed_gain_holds_the_rig_at_5_ms(upright: tuple[np.ndarray, np.ndarray]) -> None:
    A, B = lqr.sampled(*upright, 0.005)
    assert np.abs(np.linalg.eigvals(A - B @ lqr.PRINTED_GAIN[None])).max() < 1
    assert np.abs(np.linalg.eigvals(A)).max() > 1


def test_gains_agree_with_python_control(upright: tuple[np.ndarray, np.ndarray]) -> None:
    A, B = upright
    np.testing.assert_allclose(lqr.lqr(A, B, lqr.RECOVERED_Q, lqr.R), control.lqr(A, B, lqr.RECOVERED_Q, lqr.R)[0])
    Ad, Bd = lqr.sampled(A, B, 0.005)
    np.testing.assert_allclose(
        lqr.dlqr(Ad, Bd, lqr.RECOVERED_Q, lqr.R), control.dlqr(Ad, Bd, lqr.RECOVERED_Q, lqr.R)[0]
    )
    exact = control.c2d(control.ss(A, B, np.eye(6), 0), 0.005)
    np.testing.assert_allclose(Ad, exact.A, rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(Bd, exact.B, rtol=1e-10, atol=1e-12)


def test_a_rig_that_cannot_be_held_is_refused() -> None:
    with pytest.raises(np.linalg.LinAlgError):
        lqr.lqr([[1.0]], [[0.0]], [[1.0]], [[1.0]])
    with pytest.raises(ValueError, match="sample time"):
        lqr.sampled([[1.0]], [[1.0]], 0.0)
