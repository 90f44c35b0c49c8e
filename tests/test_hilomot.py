"""HILOMOT: cuts in any direction, one formula for one rig, many rigs and exports."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dipc_gym import compensators
from dipc_gym.compensators import HILOMOT, LOLIMOT, RigConstants, Samples, hilomot
from dipc_gym.dataflow import Program


def diagonal(samples: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    X = rng.uniform([-10, 0, 3], [20, 1, 3.5], (samples, 3))
    return X, np.tanh(6 * ((X[:, 0] + 10) / 30 + X[:, 1] - 1)) + 0.02 * rng.normal(size=samples)


def test_an_oblique_edge_takes_far_fewer_cells() -> None:
    (X, y), (T, t) = diagonal(1500, 0), diagonal(1500, 1)
    grown = hilomot.grow(X, y, 4)
    rms = float(np.sqrt(np.mean((grown.predict(T) - t) ** 2)))
    halved = float(np.sqrt(np.mean((LOLIMOT(max_models=4).fit(X, y).predict(T) - t) ** 2)))
    assert rms < 0.5 * halved


def test_a_linear_function_is_reproduced_and_cells_share_everything() -> None:
    X, _ = diagonal(500, 2)
    grown = hilomot.grow(X, X @ [1.0, 2.0, -3.0] + 4, 5)
    np.testing.assert_allclose(grown.predict(X), X @ [1.0, 2.0, -3.0] + 4, atol=0.05)
    shares = hilomot._cells(np.column_stack([np.ones(500), X]) @ grown.cuts.T, grown.signs)
    np.testing.assert_allclose(shares.sum(axis=1), 1.0, atol=1e-12)


def test_the_size_of_the_lowest_test_error_is_kept() -> None:
    (X, y), test = diagonal(600, 3), diagonal(600, 4)
    grown = hilomot.grow(X, y, 8, test=test)
    assert np.mean((grown.predict(test[0]) - test[1]) ** 2) == grown.errors.min()
    assert len(grown.lines) == int(np.argmin(grown.errors)) + 2


def test_it_is_a_compensator_like_the_others(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    time = 0.005 * np.arange(2000)
    v = 0.5 * np.sin(time * (1 + time))
    volts = 12 * np.sin(time * (1 + time) + 0.7) + rng.normal(size=2000)
    before = np.roll(v, 1)
    force = 4 * volts - 8 * np.tanh(v / 0.05)
    samples = Samples(force, v, before, volts, time % 2 < 1)
    made = compensators.fit("hilomot", samples, RigConstants(4.0, 40.0, 24.0))
    assert isinstance(made, HILOMOT)
    assert made.figures is not None
    assert made.figures.test_mse < 0.2  # of voltages of 8.5 V rms, and 2 V of friction
    compensators.save(made, tmp_path / "hilomot.json")
    assert compensators.load(tmp_path / "hilomot.json") == made

    rows = rng.uniform([-50, -2, -2], [50, 2, 2], (40, 3))
    many = made.volts(*rows.T)
    assert many.tolist() == [made.volts(*row) for row in rows.tolist()]
    program = Program()
    program.output("volts", made.express(program, program.input("force"), program.input("velocity")))
    given = {"force": rows[:, 0], "velocity": rows[:, 1]}
    outputs, _ = program.run(given, program.memory(40))
    np.testing.assert_allclose(outputs["volts"][0], made.volts(rows[:, 0], rows[:, 1], rows[:, 1]), atol=1e-10)
