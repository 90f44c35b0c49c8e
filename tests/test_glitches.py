"""Single samples that jump and come back are taken from their neighbours; what a joint does is left as it is."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sim2real_rigs import CART, NOISE, RK4, record, sweep

from dipc_gym import mjcf, physics
from dipc_gym.recording import Recording, write
from dipc_gym.recording.glitches import glitches, without_glitches
from dipc_gym.sim2real.diagnosis import diagnose
from dipc_gym.sim2real.model.parameters import Wishes
from dipc_gym.sim2real.replay import replay
from dipc_gym.sim2real.verdict.withheld import gather

SIGMA = 1e-4
TIME = np.arange(500) * 0.004


def moving(rng: np.random.Generator) -> np.ndarray:
    """A joint that swings at up to 3 Hz, as an encoder reads it."""
    rates, sizes, phases = rng.uniform(0.2, 3.0, 3), rng.uniform(0.1, 0.5, 3), rng.uniform(0, 6, 3)
    angle = (sizes[:, None] * np.sin(2 * np.pi * rates[:, None] * TIME + phases[:, None])).sum(axis=0)
    return np.asarray(angle + rng.normal(0, SIGMA, len(TIME)))


@given(st.integers(0, 10_000), st.lists(st.integers(10, 480), min_size=1, max_size=4, unique_by=lambda k: k // 8))
@settings(max_examples=60, deadline=None)
def test_what_jumps_and_comes_back_is_found_and_nothing_else(seed: int, where: list[int]) -> None:
    rng = np.random.default_rng(seed)
    angle = moving(rng)
    true = angle.copy()
    jumps = rng.choice([-1, 1], len(where)) * rng.uniform(150, 3000, len(where)) * SIGMA
    apart = [k for k in where if all(abs(k - other) > 4 for other in where if other != k)]
    angle[where] += jumps
    found, instead = glitches(TIME, angle, SIGMA)
    assert set(apart) <= set(found.tolist()) <= set(where)
    assert np.all(np.abs(instead - true[found]) < 8 * SIGMA)


@given(st.integers(0, 10_000), st.integers(2, 3), st.integers(10, 480), st.booleans())
@settings(max_examples=60, deadline=None)
def test_a_few_in_a_row_are_found_as_one_is(seed: int, run: int, first: int, alike: bool) -> None:
    """A counter that is off for a few samples, by the same or by whatever comes."""
    rng = np.random.default_rng(seed)
    angle = moving(rng)
    true = angle.copy()
    angle[first : first + run] += rng.uniform(200, 3000, 1 if alike else run) * SIGMA
    found, instead = glitches(TIME, angle, SIGMA)
    assert found.tolist() == list(range(first, first + run))
    assert np.all(np.abs(instead - true[found]) < 20 * SIGMA)


def test_more_in_a_row_are_left() -> None:
    angle = np.sin(3 * TIME)
    angle[200:204] += 0.2
    assert not len(glitches(TIME, angle, SIGMA)[0])


@pytest.mark.parametrize("bounces", [0.0, 0.7, 1.0])
def test_an_impact_is_no_glitch(bounces: float) -> None:
    """Against a stop a joint turns round within a sample, and goes on from there."""
    for at in np.linspace(0.9, 0.904, 9):
        angle = np.where(at > TIME, 4.0 * (TIME - at), -4.0 * bounces * (TIME - at))
        found, _ = glitches(TIME, angle, SIGMA)
        assert not len(found)


def test_counts_and_steps_of_an_encoder_are_no_glitches() -> None:
    count = 2 * np.pi / 4096
    angle = np.round(0.3 * np.sin(7 * TIME) / count) * count
    assert not len(glitches(TIME, angle, count / np.sqrt(12))[0])
    moved = np.where(TIME < 1.0, 0.0, 0.2)  # another zero from there on
    assert not len(glitches(TIME, moved + angle, count / np.sqrt(12))[0])


def test_a_sample_between_gaps_is_left_as_it_is() -> None:
    """Nothing near tells what it should have been."""
    time = np.arange(0.0, 4.0, 0.004)
    for gap in (0.048, 0.1):
        kept = np.ones(len(time), dtype=bool)
        for alone in np.arange(0.5, 3.5, 0.2):
            kept &= (np.abs(time - alone) < 0.002) | (np.abs(time - alone) > gap)
        angle = 0.5 * np.sin(2 * np.pi * 3 * time[kept])
        assert not len(glitches(time[kept], angle, SIGMA)[0])


def test_glitches_of_irregular_stamps_are_found() -> None:
    rng = np.random.default_rng(5)
    time = TIME + rng.uniform(-0.0012, 0.0012, len(TIME))
    angle = np.sin(7 * time) + rng.normal(0, SIGMA, len(time))
    angle[[100, 333]] += 0.05
    found, instead = glitches(time, angle, SIGMA)
    assert found.tolist() == [100, 333]
    assert np.abs(instead - np.sin(7 * time[found])).max() < 10 * SIGMA


def test_what_happens_often_is_how_the_sensor_reads() -> None:
    angle = np.sin(3 * TIME)
    angle[::40] += 0.2
    assert not len(glitches(TIME, angle, SIGMA)[0])


def test_a_rig_with_glitches_is_not_taken_for_one_that_lacks_physics() -> None:
    rig = physics.load(mjcf.from_text(CART))
    plain = record(rig, sweep(4.0), 10.0, noise=NOISE["cart"], integrator=RK4)
    sensors = plain.sensors.copy()
    sensors[[700, 1800, 3100, 4700], 0] += 0.02
    run = replace(plain, sensors=sensors)
    (mended,) = without_glitches([run], rig.model)
    (note,) = mended.notes
    assert note.startswith("sensor 'cart' jumps at 4 samples and back, by up to 0.02")
    assert np.abs(mended.sensors - plain.sensors).max() < 1e-3
    said = diagnose(mjcf.from_text(CART), [run])
    assert said.verdict == "consistent"
    assert any("sensor 'cart' jumps at 4 samples and back" in told for told in said.notes)
    assert without_glitches([plain], rig.model)[0] is plain


def test_a_rate_may_jump() -> None:
    """A knock shows in a velocity for one sample."""
    rig = physics.load(mjcf.from_text(CART.replace("</sensor>", '<jointvel name="rate" joint="cart"/></sensor>')))
    run: Recording = record(rig, sweep(4.0), 6.0, noise=(*NOISE["cart"], 1e-3), integrator=RK4)
    sensors = run.sensors.copy()
    sensors[900, 1] += 1.0
    (mended,) = without_glitches([replace(run, sensors=sensors)], rig.model)
    assert mended.sensors[900, 1] == sensors[900, 1]
    assert not mended.notes


def test_what_is_withheld_does_not_say_what_is_fitted() -> None:
    """More jumps in the last quarter of a recording would be too many to be glitches, were they counted together."""
    source = mjcf.from_text(CART)
    plain = record(physics.load(source), sweep(4.0), 8.0, noise=NOISE["cart"], integrator=RK4)
    few = plain.sensors.copy()
    few[[300, 1500], 0] += 0.5
    many = few.copy()
    many[3100::30, 0] += 0.5
    fitted = [
        gather(source, [replace(plain, sensors=sensors)], [], Wishes())[0].recordings[0] for sensors in (few, many)
    ]
    assert np.array_equal(fitted[0].sensors, fitted[1].sensors)
    assert np.abs(fitted[0].sensors - plain.sensors[: len(fitted[0])]).max() < 1e-3
    given, withheld = gather(source, [replace(plain, sensors=few)], [], Wishes())
    assert np.array_equal(withheld.recordings[0].sensors[: len(fitted[0])], given.recordings[0].sensors)
    assert sum("jumps" in note for note in given.notes) == 1


def test_a_replay_takes_glitches_as_a_diagnosis_does(tmp_path: Path) -> None:
    rig = physics.load(mjcf.from_text(CART))
    run = record(rig, sweep(4.0), 4.0, noise=NOISE["cart"], integrator=RK4)
    (tmp_path / "cart.xml").write_text(CART)
    sensors = run.sensors.copy()
    sensors[[700, 1300], 0] += 0.02
    for name, read in (("plain", run.sensors), ("jumps", sensors)):
        write(replace(run, sensors=read), tmp_path / f"{name}.csv")
    plain, mended = (replay(tmp_path / "cart.xml", tmp_path / f"{name}.csv") for name in ("plain", "jumps"))
    assert mended.error == pytest.approx(plain.error, rel=0.05)
    assert any("jumps at 2 samples" in note for note in mended.recording.notes)
