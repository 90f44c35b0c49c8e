"""Stamps and readings: which of them are even, only the readings can tell."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dipc_gym.recording import Recording
from dipc_gym.recording.checks import IRREGULAR
from dipc_gym.recording.clock import clocked

PERIOD = 0.004


def recorded(read_at: np.ndarray, stamped: np.ndarray, noise: float = 1e-5, seed: int = 0) -> Recording:
    """Two joints that move at some m/s, read at times of which stamps may say something else."""
    rng = np.random.default_rng(seed)
    position = np.stack([np.sin(7 * read_at), 0.5 * np.cos(5 * read_at + np.sin(read_at))], axis=1)
    read = position + noise * rng.normal(size=position.shape)
    return Recording("run", stamped, np.zeros((len(stamped), 0)), read, [], ["one", "other"])


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000), st.floats(0.02, 0.2), st.floats(-5.0, 50.0), st.lists(st.integers(1, 1998), max_size=20))
def test_rows_that_were_read_evenly_are_put_there(seed: int, share: float, begin: float, gone: list[int]) -> None:
    """Whatever the clock begins with, and whichever rows are missing."""
    rng, even = np.random.default_rng(seed), PERIOD * np.delete(np.arange(2000), gone)
    late = even + share * PERIOD * rng.uniform(size=len(even))
    (mended,) = clocked([recorded(even, begin + late)])
    # A line through stamps has a rate of its own, which is theirs to a hundred-thousandth.
    assert np.abs(mended.time - even).max() < 1e-5 * even[-1] + 1e-9 * abs(begin)
    assert any("read evenly and stamped unevenly" in note for note in mended.notes)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000), st.floats(0.02, 0.4))
def test_stamps_that_are_right_stay(seed: int, share: float) -> None:
    uneven = PERIOD * (np.arange(2000) + share * np.random.default_rng(seed).uniform(-1, 1, 2000))
    given = recorded(uneven, uneven - uneven[0])
    assert clocked([given])[0] is given


@pytest.mark.parametrize(
    "given",
    [
        recorded(PERIOD * np.arange(2000), PERIOD * np.arange(2000)),  # even as they are
        recorded(PERIOD * np.arange(20), PERIOD * np.arange(20)),  # too few
        recorded(PERIOD * np.arange(2), PERIOD * np.arange(2)),
    ],
)
def test_nothing_is_mended_where_nothing_is_wrong(given: Recording) -> None:
    assert clocked([given])[0] is given


def test_where_noise_hides_it_nothing_is_mended() -> None:
    rng, even = np.random.default_rng(1), PERIOD * np.arange(2000)
    late = even + 0.1 * PERIOD * rng.uniform(size=2000)
    given = recorded(even, late - late[0], noise=1e-2)
    assert clocked([given])[0] is given


def test_what_comes_later_decides_nothing() -> None:
    """Not even whether stamps are uneven: what is tested with says nothing of what is fitted."""
    rng, even = np.random.default_rng(2), PERIOD * np.arange(2000)
    late = even + 0.1 * PERIOD * rng.uniform(size=2000)
    given = recorded(even, late - late[0])
    sensors = given.sensors.copy()
    sensors[1500:] = rng.normal(size=(500, 2))
    one, other = clocked([given, replace(given, sensors=sensors)], until=0.75)
    np.testing.assert_array_equal(one.time, other.time)
    np.testing.assert_allclose(one.time, even, atol=1e-4)


def test_sampling_is_not_called_irregular_that_is_not() -> None:
    rng, even = np.random.default_rng(3), PERIOD * np.arange(2000)
    late = even + 0.1 * PERIOD * rng.uniform(size=2000)
    given = replace(recorded(even, late - late[0]), notes=(f"{IRREGULAR}: 0.0036 to 0.0044 s apart", "another note"))
    (mended,) = clocked([given])
    assert mended.notes[0] == "another note"
    assert not any(note.startswith(IRREGULAR) for note in mended.notes)
