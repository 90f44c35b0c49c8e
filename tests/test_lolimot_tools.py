"""What goes with a LOLIMOT network: uncertainty, choice of size, pictures; and inputs in any number."""

from __future__ import annotations

import numpy as np
import pytest

from dipc_gym.compensators.lolimot import LOLIMOT
from dipc_gym.compensators.lolimot_plot import boxes, plot_partition
from dipc_gym.compensators.lolimot_selection import select
from dipc_gym.compensators.lolimot_uncertainty import uncertainty


def surface(X: np.ndarray) -> np.ndarray:
    return np.sin(3 * X[:, 0]) * X[:, 1] + np.tanh((X[:, 2] - 0.5) * 4)


def drawn(seed: int, samples: int, noise: float = 0.1) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    X = rng.uniform(size=(samples, 3))
    return X, surface(X) + noise * rng.normal(size=samples)


# ------------------------------------------------------------------------------------------- uncertainty


def test_the_standard_error_is_the_spread_over_many_sets_of_data() -> None:
    T = np.random.default_rng(99).uniform(0.05, 0.95, (300, 3))
    predictions, errors = [], []
    for seed in range(25):
        X, y = drawn(seed, 2000)
        model = LOLIMOT(max_models=8).fit(X, y)
        predictions.append(model.predict(T))
        errors.append(uncertainty(model, X, y).of_mean(T))
    ratio = np.mean(errors, axis=0) / np.std(predictions, axis=0)
    assert 0.85 < np.median(ratio) < 1.2


@pytest.mark.parametrize("estimation", ["local", "global"])
def test_intervals_cover_fresh_samples_where_noise_differs_from_place_to_place(estimation: str) -> None:
    rng = np.random.default_rng(1)

    def noisy(samples: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        X = rng.uniform(size=(samples, 3))
        spread = 0.05 + 0.4 * X[:, 0]
        return X, surface(X) + spread * rng.normal(size=samples), spread

    X, y, _ = noisy(4000)
    T, t, spread = noisy(4000)
    model = LOLIMOT(max_models=12, estimation=estimation).fit(X, y)
    deviation = uncertainty(model, X, y).of_samples(T)
    inside = np.abs(t - model.predict(T)) < 1.96 * deviation
    assert inside.mean() == pytest.approx(0.95, abs=0.015)
    for part in (spread < 0.15, spread > 0.35):
        assert inside[part].mean() == pytest.approx(0.95, abs=0.04)
    assert np.corrcoef(deviation, spread)[0, 1] > 0.85


def test_of_one_model_it_is_the_textbook_of_least_squares() -> None:
    rng = np.random.default_rng(2)
    X = rng.normal(size=(5000, 2))
    y = X @ [1.0, -2.0] + 0.3 * rng.normal(size=5000)
    model = LOLIMOT(max_models=1, ridge=1e-9, border_validity=0.999999).fit(X, y)  # as good as equal weights
    known = uncertainty(model, X, y)
    columns = np.column_stack([np.ones(5000), X])
    T = rng.normal(size=(50, 2))
    at = np.column_stack([np.ones(50), T])
    textbook = 0.3 * np.sqrt(np.einsum("ki,ij,kj->k", at, np.linalg.inv(columns.T @ columns), at))
    np.testing.assert_allclose(known.of_mean(T), textbook, rtol=0.1)
    assert known.noise[0] == pytest.approx(0.3, rel=0.03)


def test_it_grows_outside_the_data_and_shrinks_with_more() -> None:
    few, many = ((X, y, LOLIMOT(max_models=6).fit(X, y)) for X, y in (drawn(3, 500), drawn(3, 8000)))
    inside, outside = np.full((1, 3), 0.5), np.full((1, 3), 3.0)
    known = [uncertainty(model, X, y) for X, y, model in (few, many)]
    assert known[0].of_mean(outside) > 5 * known[0].of_mean(inside)
    assert known[1].of_mean(inside) < 0.5 * known[0].of_mean(inside)
    assert known[0].of_samples(inside) > known[0].of_mean(inside)


def test_a_weight_of_two_counts_as_two_samples_in_the_prediction() -> None:
    X, y = drawn(4, 600)
    weight = np.random.default_rng(4).integers(0, 2, 600)
    model = LOLIMOT(max_models=4).fit(X, y, weight)
    kept = weight > 0
    np.testing.assert_allclose(
        uncertainty(model, X, y, weight).covariance, uncertainty(model, X[kept], y[kept]).covariance, rtol=1e-9
    )


def test_a_network_that_is_not_fitted_has_no_uncertainty() -> None:
    X, y = drawn(0, 50)
    with pytest.raises(ValueError, match="not fitted"):
        uncertainty(LOLIMOT(), X, y)


# --------------------------------------------------------------------------------------------- selection


def test_the_chosen_size_is_right_on_fresh_data() -> None:
    X, y = drawn(5, 1500, noise=0.2)
    chosen = select(LOLIMOT(max_models=24), X, y)
    assert chosen.errors.shape == (5, 24)
    assert 2 <= chosen.models <= chosen.lowest <= 24
    assert len(chosen.model.levels_) == chosen.models
    T, t = drawn(6, 20_000, noise=0.2)
    fresh = np.mean((chosen.model.predict(T) - t) ** 2)
    assert chosen.error == pytest.approx(fresh, rel=0.12)
    assert fresh < 1.1 * min(np.mean((LOLIMOT(max_models=n).fit(X, y).predict(T) - t) ** 2) for n in (2, 8, 16, 24))


def test_noise_alone_gets_one_model() -> None:
    rng = np.random.default_rng(7)
    assert select(LOLIMOT(max_models=12), rng.uniform(size=(600, 3)), rng.normal(size=600)).models == 1


def test_samples_of_one_group_are_held_out_together() -> None:
    """Errors that last: every stretch has an offset of its own, which no other stretch can tell."""
    rng = np.random.default_rng(8)
    stretch = np.repeat(np.arange(30), 40)
    x = (stretch[:, None] + rng.uniform(size=(1200, 1))) / 30
    y = rng.normal(size=30)[stretch] + 0.1 * rng.normal(size=1200)
    alone = select(LOLIMOT(max_models=16), x, y)
    together = select(LOLIMOT(max_models=16), x, y, groups=stretch)
    assert together.models < alone.models
    assert together.error > 2 * alone.error


@pytest.mark.parametrize(
    ("folds", "groups", "says"),
    [(1, None, "folds is 1"), (51, None, "folds is 51"), (3, [0, 1] * 25, "2 groups"), (2, [0, 1], "groups has shape")],
)
def test_unusable_folds_are_refused(folds: int, groups: list[int] | None, says: str) -> None:
    X, y = drawn(0, 50)
    with pytest.raises(ValueError, match=says):
        select(LOLIMOT(max_models=2), X, y, folds=folds, groups=groups)


# ---------------------------------------------------------------------------------------------- pictures


def test_boxes_tile_the_data() -> None:
    X, y = drawn(9, 2000)
    low, high = boxes(LOLIMOT(max_models=14, border_validity=0.5).fit(X, y))
    assert np.prod(high - low, axis=1).sum() == pytest.approx(np.prod(np.ptp(X, axis=0)))
    holds = ((low[:, None] < X) & (high[:, None] > X)).all(axis=2).sum(axis=0)
    on_a_border = (np.isclose(X[:, None], low) | np.isclose(X[:, None], high)).any(axis=(1, 2))
    assert (holds[~on_a_border] == 1).all()
    assert on_a_border.mean() < 0.01


def test_the_picture_shows_the_boxes_that_its_plane_meets() -> None:
    import matplotlib.pyplot as plt

    X, y = drawn(10, 3000)
    model = LOLIMOT(max_models=10).fit(X, y)
    low, high = boxes(model)
    for at in (np.array([0.5, 0.5, 0.1]), np.array([0.5, 0.5, 0.9])):
        ax = plot_partition(model, (0, 1), at=at, names=("force", "velocity", "before"))
        met = (low[:, 2] <= at[2]) & (at[2] < high[:, 2])
        areas = [patch.get_width() * patch.get_height() for patch in ax.patches]
        assert len(areas) == met.sum()
        assert sum(areas) == pytest.approx(np.prod(np.ptp(X[:, :2], axis=0)))
        assert (ax.get_xlabel(), ax.get_ylabel()) == ("force", "velocity")
        plt.close(ax.figure)


def test_unusable_axes_and_points_are_refused() -> None:
    model = LOLIMOT(max_models=2).fit(*drawn(0, 200))
    for axes in ((0, 0), (0, 3)):
        with pytest.raises(ValueError, match="two different inputs out of 0 to 2"):
            plot_partition(model, axes)
    with pytest.raises(ValueError, match="a point has 3 numbers"):
        plot_partition(model, at=[0.0])


# -------------------------------------------------------------------------------------------- dimensions


@pytest.mark.parametrize("inputs", [1, 2, 20])
def test_any_number_of_inputs(inputs: int) -> None:
    rng = np.random.default_rng(inputs)
    X, T = rng.uniform(-1, 1, (2000, inputs)), rng.uniform(-1, 1, (1000, inputs))
    model = LOLIMOT(max_models=10).fit(X, np.tanh(4 * X[:, 0]) + X.sum(axis=1))
    truth = np.tanh(4 * T[:, 0]) + T.sum(axis=1)
    linear = LOLIMOT(max_models=1).fit(X, np.tanh(4 * X[:, 0]) + X.sum(axis=1))
    errors = [np.sqrt(np.mean((m.predict(T) - truth) ** 2)) for m in (model, linear)]
    assert errors[0] < 0.4 * errors[1]
    assert (np.ptp(model.centres_[:, 1:], axis=0) == 0).all()  # only the axis that bends is cut


@pytest.mark.parametrize("seed", range(8))
def test_boxes_of_a_plane_cover_it_once(seed: int) -> None:
    """Cuts go through the middle of the data, where the plane lies: corners that differ by rounding are one cut."""
    rng = np.random.default_rng(seed)
    X = rng.uniform(-1, 1, (400, 3))
    model = LOLIMOT(max_models=8).fit(X, np.sin(3 * X[:, 0]) + X[:, 1] * np.abs(X[:, 2]))
    low, high = boxes(model)
    for at in (None, high.max(axis=0)):
        drawn = [patch for patch in plot_partition(model, at=at).patches]
        area = sum(patch.get_width() * patch.get_height() for patch in drawn)
        assert area == pytest.approx(float(np.prod((high.max(axis=0) - low.min(axis=0))[:2])))


@pytest.mark.parametrize("value", [3.0, 0.1, 3.3, 1e-13])
def test_a_constant_is_right_or_wrong(value: float) -> None:
    X = np.linspace(0, 1, 30)[:, None]
    model = LOLIMOT(max_models=2).fit(X, np.full(30, value))
    assert model.score(X, np.full(30, value)) == 1.0
    assert model.score(X, np.full(30, 1.5 * value)) == 0.0


def test_a_weight_of_two_is_two_samples() -> None:
    rng = np.random.default_rng(3)
    X = rng.uniform(-1, 1, (200, 1))
    y = np.sin(2 * X[:, 0]) + 0.1 * rng.normal(size=200)
    doubled = LOLIMOT(max_models=3).fit(np.vstack([X, X]), np.append(y, y))
    weighted = LOLIMOT(max_models=3).fit(X, y, sample_weight=np.full(200, 2.0))
    twice = uncertainty(doubled, np.vstack([X, X]), np.append(y, y))
    by_weight = uncertainty(weighted, X, y, sample_weight=np.full(200, 2.0))
    np.testing.assert_allclose(by_weight.of_mean(X), twice.of_mean(X), rtol=1e-6)
