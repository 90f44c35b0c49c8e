"""LOLIMOT: the geometry of its boxes, its estimates, its stopping, and its manners as a regressor."""

import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dipc_gym.compensators.lolimot import LOLIMOT


def surface(rng, samples, noise=0.0):
    X = rng.uniform([-1, 0, 10], [1, 5, 30], size=(samples, 3))
    y = np.sin(3 * X[:, 0]) * X[:, 1] + np.tanh((X[:, 2] - 20) / 2) + noise * rng.normal(size=samples)
    return X, y


def validity(model, i, x):
    return np.exp(-0.5 * np.sum(((x - model.centres_[i]) / model.sigmas_[i]) ** 2))


@pytest.mark.parametrize("border", [0.3, 0.7, 0.95])
def test_validity_in_the_middle_of_each_face_is_the_border_validity(border):
    X, y = surface(np.random.default_rng(0), 400)
    model = LOLIMOT(max_models=1, border_validity=border).fit(X, y)
    low, high = X.min(axis=0), X.max(axis=0)
    np.testing.assert_allclose(model.centres_[0], (low + high) / 2)
    for axis in range(3):
        for end in (low, high):
            x = model.centres_[0].copy()
            x[axis] = end[axis]
            assert validity(model, 0, x) == pytest.approx(border, rel=1e-12)


def test_widths_at_0_7_agree_with_the_factor_worked_out_by_hand():
    X, y = surface(np.random.default_rng(0), 400)
    model = LOLIMOT(max_models=1).fit(X, y)
    np.testing.assert_allclose(model.sigmas_[0], 0.59200 * np.ptp(X, axis=0), rtol=1e-5)


def test_boxes_tile_the_data_range_and_halve():
    X, y = surface(np.random.default_rng(1), 3000)
    model = LOLIMOT(max_models=13).fit(X, y)
    root = LOLIMOT(max_models=1).fit(X, y).sigmas_[0]
    shares = model.sigmas_ / root
    assert len(model.centres_) == 13
    np.testing.assert_allclose(np.log2(shares), np.round(np.log2(shares)), atol=1e-9)
    assert np.prod(shares, axis=1).sum() == pytest.approx(1.0)
    assert (shares <= 1 + 1e-9).all()


def test_the_kink_is_where_the_boxes_get_small():
    x = np.linspace(-1, 1, 2001)[:, None]
    y = np.tanh(x[:, 0] / 0.05)
    model = LOLIMOT(max_models=10).fit(x, y)
    smallest = np.argsort(model.sigmas_[:, 0])[:2]
    assert np.abs(model.centres_[smallest, 0]).max() < 0.1


def test_the_cut_goes_along_the_axis_that_matters():
    rng = np.random.default_rng(2)
    X = rng.uniform(-1, 1, size=(2000, 4))
    model = LOLIMOT(max_models=6).fit(X, np.tanh(8 * X[:, 2] - 2))
    cut = (np.ptp(model.centres_, axis=0) > 0).tolist()
    assert cut == [False, False, True, False]


@settings(max_examples=40, deadline=None)
@given(
    st.integers(0, 2**32 - 1),
    st.integers(1, 5),
    st.floats(-6, 6),
    st.sampled_from(["local", "global"]),
)
def test_a_linear_function_is_reproduced_inside_and_far_outside(seed, inputs, decade, estimation):
    rng = np.random.default_rng(seed)
    X = rng.normal(size=(400, inputs)) * 10.0**decade + rng.normal() * 10.0**decade
    slope, offset = rng.normal(size=inputs) / 10.0**decade, rng.normal()
    model = LOLIMOT(max_models=4, estimation=estimation, ridge=1e-9).fit(X, X @ slope + offset)
    far = X[:50] * 7
    scale = np.abs(far @ slope).max() + abs(offset) + 1
    np.testing.assert_allclose(model.predict(far), far @ slope + offset, atol=1e-6 * scale)


def test_one_model_is_the_least_squares_line():
    rng = np.random.default_rng(3)
    X, y = surface(rng, 500, noise=0.3)
    weight = rng.uniform(0.2, 3, 500)
    root = np.sqrt(weight)[:, None]
    columns = np.column_stack([np.ones(500), X])
    expected = columns @ np.linalg.lstsq(columns * root, y * root[:, 0])[0]
    model = LOLIMOT(max_models=1, ridge=1e-9).fit(X, y, weight)
    np.testing.assert_allclose(model.predict(X), expected, atol=1e-8)


def test_local_models_are_their_own_weighted_least_squares():
    """Freshly cut models satisfy the normal equations of their validities, written out independently."""
    X, y = surface(np.random.default_rng(4), 1500, noise=0.1)
    model = LOLIMOT(max_models=2, ridge=1e-9).fit(X, y)
    mu = np.array([[validity(model, i, x) for x in X] for i in range(2)])
    phi = mu / mu.sum(axis=0)
    for i in range(2):
        columns = np.column_stack([np.ones(len(X)), X - model.centres_[i]])
        root = np.sqrt(phi[i])
        expected = np.linalg.lstsq(columns * root[:, None], y * root)[0]
        np.testing.assert_allclose(np.append(model.levels_[i], model.slopes_[i]), expected, atol=1e-6)


def test_global_estimation_is_the_least_squares_of_all_models_together():
    X, y = surface(np.random.default_rng(5), 1500, noise=0.1)
    model = LOLIMOT(max_models=5, estimation="global", ridge=1e-9).fit(X, y)
    mu = np.array([[validity(model, i, x) for x in X] for i in range(5)])
    phi = mu / mu.sum(axis=0)
    columns = np.hstack([phi[i][:, None] * np.column_stack([np.ones(len(X)), X]) for i in range(5)])
    expected = columns @ np.linalg.lstsq(columns, y)[0]
    np.testing.assert_allclose(model.predict(X), expected, atol=1e-5)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 12))
def test_global_estimation_has_the_same_boxes_and_no_larger_training_error(seed, models):
    X, y = surface(np.random.default_rng(seed), 800, noise=0.1)
    local = LOLIMOT(max_models=models).fit(X, y)
    together = LOLIMOT(max_models=models, estimation="global").fit(X, y)
    np.testing.assert_array_equal(together.centres_, local.centres_)
    assert (together.train_errors_ <= local.train_errors_ * (1 + 1e-6)).all()


def test_error_curves_are_the_errors_of_the_network():
    rng = np.random.default_rng(7)
    X, y = surface(rng, 2000, noise=0.1)
    T, t = surface(rng, 700, noise=0.1)
    model = LOLIMOT(max_models=9, tolerance=0.0, patience=9).fit(X, y, test=(T, t))
    assert len(model.train_errors_) == len(model.test_errors_) == 9
    assert np.mean((model.predict(T) - t) ** 2) == pytest.approx(model.test_errors_.min(), rel=1e-9)
    same = LOLIMOT(max_models=int(np.argmin(model.test_errors_)) + 1).fit(X, y)
    np.testing.assert_allclose(same.predict(T), model.predict(T), rtol=1e-12)
    assert np.mean((same.predict(X) - y) ** 2) == pytest.approx(same.train_errors_[-1], rel=1e-9)


def test_growing_stops_when_the_test_error_stops_falling():
    rng = np.random.default_rng(8)
    x, t = rng.uniform(-1, 1, (300, 1)), rng.uniform(-1, 1, (3000, 1))
    model = LOLIMOT(max_models=60).fit(
        x,
        np.abs(x[:, 0]) + 0.2 * rng.normal(size=300),
        test=(t, np.abs(t[:, 0]) + 0.2 * rng.normal(size=3000)),
    )
    steps = len(model.test_errors_)
    assert 2 <= len(model.levels_) < steps < 60
    gain = model.test_errors_[len(model.levels_) - 1] - model.test_errors_[len(model.levels_) :].min()
    assert gain <= 0.01 * model.test_errors_[0]


def test_a_first_cut_in_vain_does_not_stop_growing():
    """Cut at its middle, an odd function gains nothing; the next cuts do."""
    x = np.linspace(-1, 1, 1000)[:, None]
    y = np.where(np.abs(x[:, 0]) < 0.5, -1.0, 1.0)
    model = LOLIMOT().fit(x, y, test=(x, y))
    assert model.test_errors_[len(model.levels_) - 1] < 0.3 * model.test_errors_[0]


def test_a_weight_of_two_counts_as_two_samples():
    rng = np.random.default_rng(9)
    X, y = surface(rng, 600, noise=0.2)
    weight = rng.integers(0, 4, 600)
    repeated = LOLIMOT(max_models=7).fit(np.repeat(X, weight, axis=0), np.repeat(y, weight))
    np.testing.assert_allclose(LOLIMOT(max_models=7).fit(X, y, weight).predict(X), repeated.predict(X), rtol=1e-6)


@pytest.mark.parametrize("estimation", ["local", "global"])
def test_inputs_that_do_not_move_or_move_together_leave_the_rest_intact(estimation):
    rng = np.random.default_rng(10)
    x = rng.uniform(-1, 1, 1000)
    X = np.column_stack([x, np.full(1000, 3.0), 2 * x + 1])
    model = LOLIMOT(max_models=12, estimation=estimation).fit(X, np.tanh(3 * x))
    assert model.train_errors_[-1] < 1e-3
    np.testing.assert_allclose(model.slopes_[:, 1], 0, atol=1e-6)
    assert np.abs(model.slopes_).max() < 10
    np.testing.assert_allclose(model.predict(X + np.array([0, 5.0, 0])), model.predict(X), atol=1e-4)


@pytest.mark.parametrize("samples", [1, 2, 3, 5, 17])
def test_few_samples_give_one_tame_model(samples):
    rng = np.random.default_rng(samples)
    X, y = rng.normal(size=(samples, 4)), rng.normal(size=samples)
    model = LOLIMOT().fit(X, y)
    assert len(model.levels_) == 1
    assert np.isfinite(model.predict(1e3 * X)).all()


def test_far_outside_the_nearest_model_speaks():
    X, y = surface(np.random.default_rng(11), 2000)
    model = LOLIMOT(max_models=10).fit(X, y)
    assert np.isfinite(model.predict(X * 1e6 + 1e6)).all()


def test_scaling_an_input_changes_nothing():
    X, y = surface(np.random.default_rng(12), 1000)
    factor, offset = np.array([1e-6, 1e4, 3.0]), np.array([2.0, -1e5, 7.0])
    plain = LOLIMOT(max_models=8).fit(X, y).predict(X)
    scaled = LOLIMOT(max_models=8).fit(X * factor + offset, y).predict(X * factor + offset)
    np.testing.assert_allclose(scaled, plain, atol=1e-6)


@pytest.mark.parametrize(
    ("option", "value"),
    [
        ("max_models", 0),
        ("border_validity", 1.0),
        ("border_validity", 0.0),
        ("estimation", "both"),
        ("ridge", 0.0),
        ("patience", 0),
        ("tolerance", -0.1),
    ],
)
def test_bad_options_are_named(option, value):
    X, y = surface(np.random.default_rng(0), 50)
    with pytest.raises(ValueError, match=option):
        LOLIMOT(**{option: value}).fit(X, y)


@pytest.mark.parametrize(
    ("X", "y", "weight", "message"),
    [
        ([[0.0], [np.nan]], [0, 1], None, "X has NaN"),
        ([[0.0], [1.0]], [0, np.inf], None, "y has NaN or infinity"),
        ([[0.0], [1.0]], [0, 1, 2], None, "y has shape"),
        ([0.0, 1.0], [0, 1], None, "reshape"),
        ([[0.0], [1.0]], [0, 1], [1, -1], "not negative"),
        ([[0.0], [1.0]], [0, 1], [0, 0], "zero everywhere"),
        ([[0.0], [1.0]], [0, 1], [1, 1, 1], "sample_weight has shape"),
    ],
)
def test_bad_data_are_named(X, y, weight, message):
    with pytest.raises(ValueError, match=message):
        LOLIMOT().fit(X, y, weight)


def test_test_data_need_the_same_inputs():
    X, y = surface(np.random.default_rng(0), 50)
    with pytest.raises(ValueError, match="test has 2 inputs"):
        LOLIMOT().fit(X, y, test=(X[:, :2], y))


def test_an_unknown_option_lists_the_known():
    with pytest.raises(ValueError, match="max_models"):
        LOLIMOT().set_params(models=3)


@pytest.mark.filterwarnings("ignore:Estimator LOLIMOT does not inherit from:UserWarning")
@pytest.mark.parametrize("estimation", ["local", "global"])
def test_scikit_learn_takes_it_for_a_regressor(estimation):
    """The one warning let through says that it does not derive from scikit-learn's class: that is the point."""
    from sklearn.utils.estimator_checks import check_estimator

    results = check_estimator(LOLIMOT(estimation=estimation), on_skip=None)
    assert sum(result["status"] == "passed" for result in results) > 40
    assert not [result for result in results if result["status"] == "failed"]


def test_grid_search_of_scikit_learn_works_on_it():
    from sklearn.model_selection import GridSearchCV

    X, y = surface(np.random.default_rng(13), 600)
    search = GridSearchCV(LOLIMOT(), {"max_models": [1, 8]}, cv=3).fit(X, y)
    assert search.best_params_ == {"max_models": 8}


def test_scikit_learn_is_not_needed():
    script = (
        "import sys; sys.modules['sklearn'] = None\n"
        "import numpy as np\n"
        "from dipc_gym.compensators.lolimot import LOLIMOT\n"
        "x = np.linspace(0, 1, 99)[:, None]\n"
        "model = LOLIMOT()\n"
        "try: model.predict(x)\n"
        "except ValueError as error: assert 'not fitted' in str(error)\n"
        "assert model.fit(x, x[:, 0] ** 2).score(x, x[:, 0] ** 2) > 0.99\n"
    )
    subprocess.run([sys.executable, "-W", "error", "-c", script], check=True)
