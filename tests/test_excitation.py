"""Smoothing as much as the noise asks for, and what a run must cover before a compensator is trained from it."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dipc_gym import compensators, recording
from dipc_gym.cli import main
from dipc_gym.compensators import RigConstants, Samples
from dipc_gym.env import DoublePendulumEnv
from dipc_gym.identification.excitation import examine, force_noise
from dipc_gym.identification.run import Sweep, cart, cart_model, record, samples
from dipc_gym.identification.settings import EXCITATION
from dipc_gym.identification.smoothing import smooth
from dipc_gym.plant import Encoders, Plant
from dipc_gym.recording import Recording
from dipc_gym.runs import identify

RIG = RigConstants(newtons_per_volt=4.0, viscous=40.0, supply_voltage=24.0)


# --------------------------------------------------------------------------------------------- smoothing


def penalised(y: np.ndarray, weight: float) -> tuple[np.ndarray, float]:
    """The minimum written out, and the exact generalised cross-validation score."""
    differences = np.diff(np.eye(len(y)), n=3, axis=0)
    hat = np.linalg.inv(np.eye(len(y)) + weight * differences.T @ differences)
    rest = y - hat @ y
    return hat @ y, float(np.sum(rest**2) / (len(y) - np.trace(hat)) ** 2)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(-5, 1))
def test_the_values_are_the_penalised_minimum_at_the_lowest_score(seed: int, decade: float) -> None:
    rng = np.random.default_rng(seed)
    time = np.linspace(0, 6, 150)
    y = np.sin(time * rng.uniform(0.5, 3)) + 10.0**decade * rng.standard_normal(150)
    done = smooth(y)
    values, score = penalised(y, done.weight)
    np.testing.assert_allclose(done.values, values, atol=1e-8)
    # The trace in use leaves the ends out; of 150 readings that moves the minimum by very little.
    assert score <= 1.05 * min(penalised(y, weight)[1] for weight in np.geomspace(1e-5, 1e7, 60))


@pytest.mark.parametrize("noise", [1e-5, 1e-4, 1e-3])
def test_the_noise_is_found(noise: float) -> None:
    time = 0.005 * np.arange(12_000)
    y = 0.2 * np.sin(time * (1 + 0.05 * time)) + noise * np.random.default_rng(1).standard_normal(12_000)
    assert smooth(y).noise == pytest.approx(noise, rel=0.1)


def test_a_parabola_passes_whatever_the_weight() -> None:
    time = np.linspace(-1, 1, 60)
    np.testing.assert_allclose(smooth(3 * time**2 - time + 4).values, 3 * time**2 - time + 4, atol=1e-9)


def test_unusable_readings_are_refused() -> None:
    for bad in (np.zeros(19), np.zeros((30, 2)), np.full(30, np.nan)):
        with pytest.raises(ValueError, match="20 finite readings"):
            smooth(bad)
    assert smooth(np.zeros(30)).noise == 0.0


def exact_run(plant: Plant, sweep: Sweep) -> tuple[Recording, np.ndarray]:
    """The run as its encoder reads it, and the force behind the motion as nothing but the simulation knows it."""
    model = cart_model(DoublePendulumEnv().source, plant)
    run, linear, period = record(model, plant, sweep, seed=3), cart(model), plant.control_period
    data, state = mujoco.MjData(model), np.empty((len(run) + 1, 2))
    for k, volts in enumerate([*run.commands[:, 0], 0.0]):
        state[k] = data.qpos[0], data.qvel[0]
        data.ctrl[0] = volts
        mujoco.mj_step(model, data, round(period / model.opt.timestep))
    moved = np.diff(state, axis=0) / period
    return run, linear.mass * moved[:, 1] + linear.constants.viscous * moved[:, 0]


@pytest.mark.parametrize(("counts", "noise", "at_most"), [(1, 0.25, 1.02), (1, 4.0, 0.5), (16, 0.25, 0.4)])
def test_the_force_is_no_worse_with_a_good_encoder_and_far_better_with_a_poor_one(
    counts: int, noise: float, at_most: float
) -> None:
    """Measured over the paper's run: 0.68 N either way, 4.0 to 1.3 N, and 6.1 to 1.5 N."""
    plant = Plant(encoders=Encoders(cart=counts * Encoders().cart, noise=noise))
    run, truth = exact_run(plant, Sweep(duration=20.0))
    linear = cart(cart_model(DoublePendulumEnv().source, plant))
    period, p = plant.control_period, run.sensors[:, 0]
    raw = linear.mass * np.diff(np.gradient(p, period)) / period + linear.constants.viscous * np.diff(p) / period
    estimated = samples(run, linear, plant.encoders, period, smoothed=True).force
    part = slice(1, len(p) - 2)
    errors = [np.sqrt(np.mean((force - truth[:-1][part]) ** 2)) for force in (estimated, raw[part])]
    assert errors[0] < at_most * errors[1]


def test_the_force_noise_is_what_noise_makes_of_the_force() -> None:
    rng, period = np.random.default_rng(5), 0.005
    p = 1e-5 * rng.standard_normal(200_000)
    force = 1.26 * np.diff(np.gradient(p, period)) / period + 40 * np.diff(p) / period
    w = np.linspace(0, math.pi, 2001)
    expected = force_noise(1e-5, np.ones(2001), w, mass=1.26, viscous=40.0, period=period)
    assert np.std(force[2:-2]) == pytest.approx(expected, rel=0.01)


# -------------------------------------------------------------------------------------------- excitation


def sweep_samples(seconds: float = 20.0) -> Samples:
    time = np.arange(0, seconds, 0.005)
    v = 0.4 * np.sin(time * (1 + time))
    force = 40 * v + 1.26 * np.gradient(v, 0.005)
    return Samples(force, v, np.roll(v, 1), force / 4 + 2 * np.tanh(v / 0.01), time % 2 < 1)


def test_a_sweep_covers_what_it_must() -> None:
    found = examine(sweep_samples(), RIG, force_noise=0.1)
    assert found.refusal is None
    assert found.missing == ()
    assert found.counts.shape == (EXCITATION.rows, EXCITATION.columns)
    assert found.counts.sum() == sweep_samples().train.sum()
    assert found.most_force == 96.0
    report = found.report()
    assert f"{found.reversals} reversals" in report
    rows = [line for line in report.splitlines() if set(line.strip()) <= {"#", "."} and "#" in line]
    assert len(rows) == EXCITATION.rows


def test_the_map_has_force_upwards_and_velocity_to_the_right() -> None:
    data = sweep_samples()
    drag = dataclasses.replace(data, force=40 * data.velocity)
    counts = examine(drag, RIG, force_noise=0.0).counts
    assert counts[0, -1] > 0
    assert counts[-1, 0] > 0
    assert counts[0, 0] == counts[-1, -1] == 0


def spoiled(change: str) -> Samples:
    data = sweep_samples()
    v, n = data.velocity, len(data.velocity)
    changes: dict[str, dict[str, np.ndarray]] = {
        "one way": {"velocity": np.where(v < -0.1, -0.1, v)},
        "no slow motion": {"velocity": np.where(np.abs(v) < 0.05, 0.05 * np.sign(v), v)},
        "no braking": {"force": np.abs(data.force) * np.sign(v)},
        "narrow": {"force": 40 * v + 0.2 * data.force * (np.arange(n) % 7 == 0)},
        "nothing weak": {"force": np.where(np.abs(data.force) < 25, 25 * np.sign(data.force), data.force)},
    }
    return dataclasses.replace(data, **changes[change])


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ("one way", "towards -x the cart reaches 0.1 m/s, the other way 0.4"),
        ("no slow motion", r"slow motion towards \+x: 0 samples"),
        ("no braking", r"braking while moving towards -x"),
        ("narrow", "% of the map"),
        ("nothing weak", "where balancing takes place"),
    ],
)
def test_what_is_not_covered_is_named(change: str, says: str) -> None:
    found = examine(spoiled(change), RIG, force_noise=0.0)
    with pytest.raises(AssertionError, match=says):
        raise AssertionError("; ".join(found.missing))
    assert "not covered: " in found.report()


def useless(change: str) -> tuple[Samples, float]:
    data = sweep_samples()
    v = data.velocity
    changes: dict[str, dict[str, np.ndarray]] = {
        "constant voltage": {"voltage": np.full_like(v, 3.0)},
        "one direction": {"velocity": np.abs(v) + 0.01},
        "standstill": {"velocity": 0 * v, "force": 0 * v},
        "drag alone": {"force": 40 * v},
        "other clock": {"voltage": np.roll(data.voltage[::-1], 777)},
        "noise": {},
    }
    return dataclasses.replace(data, **changes[change]), 15.0 if change == "noise" else 0.1


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ("constant voltage", "the voltage is 3 V throughout"),
        ("one direction", "turns round 0 times"),
        ("standstill", "turns round 0 times"),
        ("drag alone", "independently of velocity"),
        ("other clock", "% of the voltage"),
        ("noise", "drive the cart harder"),
    ],
)
def test_runs_that_teach_nothing_are_refused(change: str, says: str) -> None:
    data, noise = useless(change)
    refusal = examine(data, RIG, force_noise=noise).refusal
    assert refusal is not None
    assert says in refusal


# ------------------------------------------------------------------------------------------ command line


@pytest.fixture(scope="module")
def run() -> Recording:
    return identify(sweep=Sweep(duration=30.0)).run


def train(path: Path, *more: str) -> int:
    out = str(path.parent / "mine.json")
    return main(["train", "--compensator", "feedforward", "--out", out, "--recording", str(path), *more])


def test_training_from_a_recording_tells_what_it_covers(
    run: Recording, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recording.write(run, path := tmp_path / "sweep.csv")
    assert train(path) == 0
    said = capsys.readouterr().out
    assert "% of what the motor can exert" in said
    assert "reversals" in said
    assert "not covered" not in said
    assert compensators.load(tmp_path / "mine.json").parameters == 5


def test_training_refuses_what_cannot_support_it(
    run: Recording, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    spoilt: dict[str, Any] = {
        "constant": ({"commands": np.full_like(run.commands, 2.0)}, "the voltage is 2 V throughout"),
        "mixed": ({"commands": np.roll(run.commands[::-1], 333, axis=0)}, "% of the voltage"),
    }
    for name, (change, says) in spoilt.items():
        recording.write(dataclasses.replace(run, **change, sha256=""), path := tmp_path / f"{name}.csv")
        assert train(path) == 2
        said = capsys.readouterr().err
        assert f"{name}.csv: no compensator can be trained from this: " in said
        assert says in said
        assert not (tmp_path / "mine.json").exists()


@pytest.mark.parametrize(("amplitude", "refused"), [(0.5, True), (1.0, True), (2.0, True), (2.9, False), (3.5, False)])
def test_training_refuses_a_cart_that_does_not_slide(
    amplitude: float, refused: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The motor breaks the static friction of 11 N at 2.8 V; below, the cart moves on its bristles."""
    recording.write(identify(sweep=Sweep(duration=30.0, amplitude=amplitude)).run, path := tmp_path / "sweep.csv")
    assert train(path) == (2 if refused else 0)
    assert ("it does not slide; drive it harder" in capsys.readouterr().err) == refused


def test_a_spring_beside_friction_is_no_reason_to_refuse() -> None:
    """A strong run whose losses follow position most: a cable that pulls, say."""
    data = sweep_samples()
    position = 0.005 * np.cumsum(data.velocity)
    pulled = dataclasses.replace(data, voltage=data.force / 4 + 40 * position, position=position)
    assert examine(pulled, RIG, force_noise=0.1).refusal is None


def test_training_refuses_a_run_whose_poles_swing(
    run: Recording, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    swing = np.sin(run.time)[:, None] * [0.2, 0.0005]
    for size, code in ((1.0, 2), (0.01, 0)):
        whole = Recording(
            "x", run.time, run.commands, np.hstack([run.sensors, size * swing]), ("motor",), ("cart", "pole1", "pole2")
        )
        recording.write(whole, path := tmp_path / f"{code}.csv")
        assert train(path) == code
    assert "2.csv: pole1 swings by 0.4 rad; identification needs the poles locked" in capsys.readouterr().err


def test_a_way_in_another_unit_is_refused(tmp_path: Path) -> None:
    """A run in millimetres would train a compensator that gives the same voltage to all forces."""
    env = DoublePendulumEnv()
    fixed = cart_model(env.source, env.plant)
    run = record(fixed, env.plant, Sweep(), seed=1)
    path = tmp_path / "sweep.csv"
    columns = ["time", "motor", "cart"]

    def written(scale: float) -> str:
        table = np.column_stack([run.time, run.commands[:, 0], scale * run.sensors[:, 0]])
        np.savetxt(path, table, delimiter=",", header=",".join(columns), comments="")
        return str(path)

    with pytest.raises(ValueError, match="looks like millimetres; say --unit cart=mm"):
        identify(from_recording=written(1000.0))
    with pytest.raises(ValueError, match=r"check the cart's unit .*--unit"):
        identify(from_recording=written(1.0), units={"cart": "mm"})
    assert identify(from_recording=written(1000.0), units={"cart": "mm"}).excitation.refusal is None
