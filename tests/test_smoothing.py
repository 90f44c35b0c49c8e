"""Forces that were worked out from motion, and what is to explain them, smoothed alike."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from dipc_gym.sim2real.effects.shared.smoothing import smoothing, width_for
from dipc_gym.sim2real.effects.shared.surfaces import surfaces
from dipc_gym.sim2real.effects.shared.tables import grow

Array = NDArray[np.float64]
RATE = 500.0


@given(
    lengths=st.lists(st.integers(1, 300), min_size=1, max_size=4),
    rate=st.floats(5.0, 2000.0),
    seed=st.integers(0, 1000),
)
def test_samples_of_a_recording_are_averaged_with_its_own(lengths: list[int], rate: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    time = np.concatenate([rng.uniform(0, 50) + np.arange(n) / rate for n in lengths])
    which = np.repeat(np.arange(len(lengths)), lengths)
    mean = smoothing(np.concatenate([time[which == k] - time[which == k][0] for k in range(len(lengths))]), 0.02)
    assert mean.shape[1] == len(time)
    np.testing.assert_allclose(mean @ np.ones(len(time)), 1.0)
    assert np.all(mean.data >= 0)
    own = mean @ which
    np.testing.assert_allclose(own, np.round(own), atol=1e-9)  # none of another's
    assert set(np.round(own).astype(int)) == set(range(len(lengths)))  # nor is one left out
    assert np.all(np.diff(mean @ np.arange(len(time))) > 0)


def test_one_sample_every_hundredth_of_a_second_and_what_shakes_faster_is_gone() -> None:
    time = np.arange(0.0, 10.0, 1 / RATE)
    mean = smoothing(time, 0.02)
    assert mean.shape == (1000, 5000)
    inner = slice(20, -20)
    for rate, left in ((1.0, 1.0), (8.0, 0.6), (30.0, 0.0)):
        size = np.sqrt(2) * (mean @ np.sin(2 * np.pi * rate * time))[inner].std()
        assert size == pytest.approx(left, abs=0.02)


@given(
    width=st.floats(0.004, 0.019),
    force=st.floats(0.01, 100.0),
    seed=st.integers(0, 1000),
    rate=st.sampled_from([1e3, 2e3]),
)
def test_a_hundredth_of_a_force_is_noise_once_it_is_smoothed(
    width: float, force: float, seed: int, rate: float
) -> None:
    period = 1 / rate
    noise = 0.01 * force * np.sqrt(8 * np.sqrt(np.pi) * width**5 / (3 * period))  # for which that width is asked
    assert width_for(force, noise, period) == pytest.approx(width, rel=1e-6)
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, 40.0, period)
    read = np.gradient(np.gradient(rng.normal(scale=noise, size=len(time)), period), period)
    left = smoothing(time, width) @ read
    assert left[10:-10].std() == pytest.approx(0.01 * force, rel=0.15)


@given(force=st.floats(0.0, 1e6), noise=st.floats(0.0, 1e3), period=st.floats(1e-4, 0.05))
def test_what_has_no_noise_stays_as_it_is_and_nothing_is_smoothed_away(
    force: float, noise: float, period: float
) -> None:
    width = width_for(force, noise, period)
    assert 0 < width <= max(0.02, 0.1 * period)
    assert width_for(force, 2 * noise, period) >= width >= width_for(2 * force, noise, period)
    time = np.arange(40) * period
    still = smoothing(time, width_for(1.0, 0.0, period))
    np.testing.assert_array_equal(still.toarray(), np.eye(40))


def worked_out(force: Array, rng: np.random.Generator) -> Array:
    """A force as motion tells it: smooth, with noise that an encoder has, differentiated twice."""
    noise = np.diff(rng.normal(size=len(force) + 2), 2)
    return gaussian_filter1d(force, 3.0) + 2.0 * gaussian_filter1d(noise, 1.0)


def shaking(seconds: float, rng: np.random.Generator) -> tuple[Array, Array]:
    """Time, and a command that follows the noise of readings more than it does anything slow."""
    time = np.arange(0.0, seconds, 1 / RATE)
    slow = np.sin(2 * np.pi * 0.7 * time) + 0.7 * np.sin(2 * np.pi * 1.9 * time + 1.0)
    return time, slow + rng.normal(scale=0.6, size=len(time))


def bent(x: Array) -> Array:
    """What a drive adds to a command."""
    return 0.5 * np.exp(-(((x - 0.5) / 0.7) ** 2))


def test_a_drive_is_told_by_a_command_that_shakes() -> None:
    """Against a smooth force the command as it comes would seem to do nothing, and all of it to be missing."""
    rng = np.random.default_rng(3)
    time, command = shaking(40.0, rng)
    knots, values = grow(command, worked_out(bent(command), rng), np.ones_like(time), [], time, 0.02)
    inside = np.linspace(-1.0, 1.8, 50)
    assert np.interp(inside, knots, values) == pytest.approx(bent(inside), abs=0.08)


def test_what_a_force_depends_on_is_told_though_it_shakes() -> None:
    rng = np.random.default_rng(4)
    time, command = shaking(40.0, rng)
    place = np.cumsum(rng.normal(size=len(time))) / 100
    found = surfaces({"command motor": command, "position cart": place}, worked_out(bent(command), rng), time, 0.02)
    assert found[0].inputs == ("command motor",)
    inside = np.linspace(-1.0, 1.8, 50)
    assert np.interp(inside, found[0].knots[0], found[0].levels) == pytest.approx(bent(inside), abs=0.12)
