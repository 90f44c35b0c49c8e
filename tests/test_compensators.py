"""Compensators: the physics of each kind, one rig against many, files good and bad, the control loop's budget."""

import copy
import dataclasses
import json
import math
import pickle
import re
import subprocess
import sys
import warnings
from dataclasses import FrozenInstanceError, dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from dipc_gym import compensators
from dipc_gym.compensators import (
    LLNF,
    MLP,
    Compensator,
    CompensatorError,
    Feedforward,
    FitFigures,
    Ideal,
    InputRange,
    OutOfRangeWarning,
    RigConstants,
    Samples,
    StaticGain,
    fit,
    load,
    names,
    register,
    registry,
    save,
)
from dipc_gym.compensators.llnf import MAX_MODELS

RIG = RigConstants(newtons_per_volt=4.0, viscous=40.0, supply_voltage=24.0, mass=1.26)
PAPER = ("none", "feedforward", "mlp", "llnf", "ideal")
REMEMBERING = (
    *("lugre", "maxwell_slip", "friedland", "disturbance_observer", "llnf_lagged", "llnf_adaptive", "history"),
    "history_adapted",
)
KINDS = (*PAPER, "curve", "hilomot", "stribeck", *REMEMBERING, "observed")
SLOW = ("llnf_lagged", "history", "history_adapted", "lugre")  # to fit


def stribeck(velocity):
    """Dry friction in N: 8 N Coulomb, 11 N at its peak, smooth through zero."""
    return (8 + 3 * np.exp(-((velocity / 0.1) ** 2))) * np.tanh(velocity / 0.02)


def run_with(friction, seed=0, n=3000):
    """A run on a plant u -> F = N u - friction(v): force and friction are known exactly."""
    rng = np.random.default_rng(seed)
    time = np.arange(n) * 0.005
    phase = 2 * np.pi * (0.3 * time + 2.0 * time**2 / time[-1])
    velocity = 0.6 * np.sin(phase) + 0.05 * rng.normal(size=n)
    previous = np.concatenate([velocity[:1], velocity[:-1]])
    voltage = 14 * np.sin(phase + 0.7) + rng.normal(size=n)
    force = RIG.newtons_per_volt * voltage - friction(velocity)
    return Samples(force, velocity, previous, voltage, (time * 2).astype(int) % 2 == 0)


@pytest.fixture(scope="module")
def fitted():
    samples, short = run_with(stribeck), run_with(stribeck, n=600)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("dipc_gym.compensators.history.EPOCHS", 5)  # enough to have weights; a run of its own trains it
        return {name: fit(name, short if name in SLOW else samples, RIG) for name in KINDS}


def small_llnf(models=2):
    rng = np.random.default_rng(models)

    def rows(low, high):
        return tuple(tuple(row) for row in rng.uniform(low, high, (models, 3)).tolist())

    return LLNF(rows(-1, 1), rows(0.1, 1), tuple(rng.normal(size=models).tolist()), rows(-1, 1))


# The physics


@settings(deadline=None)
@given(voltage=st.floats(-24, 24), velocity=st.floats(-2, 2), friction=st.floats(-12, 12))
def test_ideal_after_the_plant_is_the_identity(voltage, velocity, friction):
    force = RIG.newtons_per_volt * voltage - friction
    ideal = Ideal(RIG.newtons_per_volt)
    assert ideal.voltage(force, velocity, friction=friction) == pytest.approx(voltage, abs=1e-12)


def test_ideal_resists_what_holds_the_cart_back():
    """Friction against motion to the right costs positive voltage."""
    ideal = Ideal(4.0)
    assert ideal.needs_friction
    assert ideal.voltage(0.0, 0.1, friction=8.0) == 2.0


def test_ideal_says_what_it_needs():
    ideal = Ideal(4.0)
    with pytest.raises(TypeError, match="friction"):
        ideal.voltage(1.0, 0.0)
    with pytest.raises(TypeError, match="friction"):
        ideal.voltage_batch(np.ones(2), np.zeros(2), ideal.initial_state(2))


@pytest.mark.filterwarnings("ignore::dipc_gym.compensators.OutOfRangeWarning")  # its form holds outside too
@settings(max_examples=25, deadline=None)
@given(
    coulomb=st.floats(1, 15),
    viscous=st.floats(-10, 30),
    load_=st.floats(-3, 3),
    width=st.integers(5, 35),
    voltage=st.floats(-24, 24),
    velocity=st.floats(-1, 1),
)
def test_feedforward_after_a_coulomb_plant_is_the_identity(coulomb, viscous, load_, width, voltage, velocity):
    """With friction of the form it knows, it finds all five numbers, and its inverse is exact."""
    from dipc_gym.compensators.feedforward import SIGN_VELOCITIES

    def friction(v):
        return coulomb * np.tanh(v / SIGN_VELOCITIES[width]) + viscous * v + load_

    compensator = fit("feedforward", run_with(friction, n=800), RIG)
    assert compensator.sign_velocity == SIGN_VELOCITIES[width]
    assert compensator.coulomb * RIG.newtons_per_volt == pytest.approx(coulomb, rel=1e-6)
    force = RIG.newtons_per_volt * voltage - friction(velocity)
    assert compensator.voltage(force, velocity) == pytest.approx(voltage, abs=1e-7)


@pytest.mark.parametrize("gain", [0.0, -4.0, math.nan, math.inf, "4", None])
@pytest.mark.parametrize("kind", [compensators.StaticGain, compensators.Ideal])
def test_a_motor_gain_that_is_none_is_refused_when_a_compensator_is_made(kind, gain):
    with pytest.raises(ValueError, match="newtons_per_volt is"):
        kind(newtons_per_volt=gain)


def test_none_divides_by_the_motor_gain(fitted):
    assert fitted["none"].voltage(10.0, 0.5) == 2.5


def test_learned_inverses_after_the_plant_are_nearly_the_identity(fitted):
    """On a run not used in training, at least nine tenths of what friction takes is given back."""
    fresh = run_with(stribeck, seed=1)
    lost = np.sqrt(np.mean((stribeck(fresh.velocity) / RIG.newtons_per_volt) ** 2))

    def left(name):
        volts = fitted[name].volts(fresh.force, fresh.velocity, fresh.previous_velocity)
        return np.sqrt(np.mean((volts - fresh.voltage) ** 2)) / lost

    assert left("none") == pytest.approx(1.0, abs=1e-9)
    assert left("llnf") < 0.1
    assert left("mlp") < 0.1
    assert left("feedforward") < 0.25


def test_fit_figures_are_the_errors_on_both_parts(fitted):
    samples = run_with(stribeck)
    for name in set(KINDS) - {"ideal", "observed", *SLOW}:
        compensator = fitted[name]
        compensator.reset()
        error = (compensator.replay(samples) - samples.voltage) ** 2
        figures = compensator.figures
        assert figures.train_mse == pytest.approx(error[samples.train].mean())
        assert figures.test_mse == pytest.approx(error[~samples.train].mean())
        assert figures.train_samples + figures.test_samples == 3000
    assert fitted["ideal"].figures is None


def test_parameters_are_counted_as_in_the_paper():
    assert small_llnf(5).parameters == 50
    mlp = MLP(((0.0,) * 3,) * 5, (0.0,) * 5, (0.0,) * 5)
    assert mlp.parameters == 25
    assert Feedforward(1.0, 1.0, 1.0, 1.0, 1.0).parameters == 5
    assert StaticGain(1.0).parameters == Ideal(1.0).parameters == 0


def test_llnf_is_the_network_lolimot_grew():
    from dipc_gym.compensators import LOLIMOT

    samples = run_with(stribeck)
    train = samples.train
    model = LOLIMOT(max_models=MAX_MODELS).fit(
        samples.inputs[train], samples.voltage[train], test=(samples.inputs[~train], samples.voltage[~train])
    )
    volts = fit("llnf", samples, RIG).volts(samples.force, samples.velocity, samples.previous_velocity)
    np.testing.assert_allclose(volts, model.predict(samples.inputs), rtol=1e-9, atol=1e-9)


def test_mlp_training_repeats_from_its_seed_and_leaves_the_global_one_alone():
    import torch

    samples = run_with(stribeck, n=600)
    torch.manual_seed(3)
    before = torch.get_rng_state()
    first = fit("mlp", samples, RIG, seed=5)
    assert torch.equal(before, torch.get_rng_state())
    assert fit("mlp", samples, RIG, seed=5) == first
    assert fit("mlp", samples, RIG, seed=6) != first


def test_the_past_value_is_the_previous_velocity():
    @dataclass(frozen=True)
    class Echo(Compensator):
        @classmethod
        def fit(cls, samples, rig, *, seed=0):
            return cls()

        def volts(self, force, velocity, previous_velocity):
            return previous_velocity

    echo = Echo()
    assert [echo.voltage(0.0, v) for v in (0.3, 0.5, 0.7)] == [0.3, 0.3, 0.5]
    echo.reset()
    assert echo.voltage(0.0, 0.9) == 0.9


# One rig and many


def trained_or_made(fitted, name):
    return {"small": small_llnf(), "twelve": small_llnf(12)}.get(name) or fitted[name]


@pytest.mark.filterwarnings("ignore::dipc_gym.compensators.OutOfRangeWarning")
@pytest.mark.parametrize("name", ["none", "feedforward", "mlp", "llnf", "small", "twelve", "stribeck", *REMEMBERING])
@pytest.mark.parametrize("n", [1, 2, 3, 7, 8, 64, 501])
def test_many_rigs_get_what_single_rigs_get_to_the_last_bit(fitted, name, n):
    compensator = trained_or_made(fitted, name)
    rng = np.random.default_rng(n)
    singles = [copy.deepcopy(compensator) for _ in range(n)]
    for single in singles:
        single.reset()
    state = compensator.initial_state(n)
    for step in range(4):
        force, velocity = rng.normal(0, 30, n), rng.normal(0, 0.4, n)
        volts, state = compensator.voltage_batch(force, velocity, state)
        expected = [
            single.voltage(f, v) for single, f, v in zip(singles, force.tolist(), velocity.tolist(), strict=True)
        ]
        assert volts.tolist() == expected
        if step == 1:
            state[0] = compensator.initial_state(1)[0]
            singles[0].reset()


@settings(max_examples=200, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(inputs=arrays(np.float64, (3, 2), elements=st.floats(-1e3, 1e3)))
@pytest.mark.filterwarnings("ignore::dipc_gym.compensators.OutOfRangeWarning")
@pytest.mark.parametrize("name", ["feedforward", "mlp", "llnf", "stribeck", "lugre", "llnf_adaptive"])
def test_one_rig_in_a_batch_gets_the_same_bits(fitted, name, inputs):
    compensator = fitted[name]
    compensator.reset()
    state = compensator.initial_state(1)
    for force, velocity in inputs:
        volts, state = compensator.voltage_batch(np.array([force]), np.array([velocity]), state)
        assert volts[0] == compensator.voltage(force, velocity)


def test_ideal_in_a_batch():
    ideal = Ideal(4.0)
    state = ideal.initial_state(2)
    volts, _ = ideal.voltage_batch(np.array([1.0, 2.0]), np.zeros(2), state, friction=np.array([3.0, -4.0]))
    assert volts.tolist() == [1.0, -0.5]


def test_a_batch_leaves_the_callers_arrays_and_the_object_alone(fitted):
    compensator = fitted["llnf"]
    compensator.reset()
    force, velocity, state = np.ones(3), np.full(3, 0.1), compensator.initial_state(3)
    _, after = compensator.voltage_batch(force, velocity, state)
    assert np.isnan(state).all()
    after[:] = 9.0
    assert velocity.tolist() == [0.1] * 3
    assert compensator.voltage(1.0, 0.2) == replace(compensator).voltage(1.0, 0.2)


@pytest.mark.parametrize("name", KINDS)
def test_copies_carry_the_memory_and_then_go_their_own_way(fitted, name):
    compensator = fitted[name]
    extra = {"friction": 2.0} if compensator.needs_friction else {}
    compensator.reset()
    compensator.voltage(1.0, 0.4, **extra)
    twins = [copy.deepcopy(compensator), pickle.loads(pickle.dumps(compensator))]
    expected = compensator.voltage(2.0, -0.1, **extra)
    for twin in twins:
        assert twin == compensator
        assert twin.voltage(2.0, -0.1, **extra) == expected
        assert isinstance(expected, float)


@pytest.mark.parametrize("name", KINDS)
def test_it_is_frozen(fitted, name):
    with pytest.raises(FrozenInstanceError):
        fitted[name].figures = None


# Far outside the training data


@pytest.mark.parametrize(("force", "velocity"), [(1e4, 0.0), (-1e4, 0.0), (0.0, 30.0), (0.0, -30.0)])
@pytest.mark.parametrize("name", ["feedforward", "mlp", "llnf", "stribeck", *REMEMBERING])
def test_far_outside_warns_once(fitted, name, force, velocity):
    compensator = replace(fitted[name])
    with pytest.warns(OutOfRangeWarning, match="far outside its training data"):
        compensator.voltage(force, velocity)
    compensator.reset()
    assert math.isfinite(compensator.voltage(force, velocity))
    batch = replace(fitted[name])
    with pytest.warns(OutOfRangeWarning, match="far outside"):
        batch.voltage_batch(np.array([0.0, force]), np.array([0.0, velocity]), batch.initial_state(2))


def test_the_margin_is_half_the_range():
    ranges = (InputRange(-10.0, 10.0), InputRange(-1.0, 3.0), InputRange(-1.0, 3.0))
    compensator = Feedforward(0.25, 1.0, 0.0, 0.0, 0.1, ranges=ranges)
    for force, velocity in ((20.0, 0.0), (-20.0, 0.0), (0.0, 5.0), (0.0, -3.0)):
        compensator.voltage(force, velocity)
        with pytest.warns(OutOfRangeWarning):
            replace(compensator).voltage(force * 1.001, velocity * 1.001)


def test_what_learned_nothing_never_warns(fitted):
    fitted["none"].voltage(9e5, 9e5)
    fitted["ideal"].voltage(9e5, 9e5, friction=0.0)


# Garbage in


BAD = (math.nan, math.inf, -math.inf, 1e300, -1e300, 2e6)
SIGNALS = st.one_of(st.sampled_from(BAD), st.floats(), st.floats(-50, 50))


def fed(compensator, rows):
    """Keyword arguments and the other inputs of rows (force, velocity, friction)."""
    force, velocity, friction = np.array(rows, dtype=float).T
    return force, velocity, {"friction": friction} if compensator.needs_friction else {}


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(rows=st.lists(st.lists(st.tuples(SIGNALS, SIGNALS, SIGNALS), min_size=3, max_size=3), min_size=4, max_size=4))
@pytest.mark.filterwarnings("ignore::dipc_gym.compensators.OutOfRangeWarning")
@pytest.mark.filterwarnings("ignore::dipc_gym.compensators.FallbackWarning")
@pytest.mark.parametrize("name", KINDS)
def test_no_input_gives_more_than_the_supply(fitted, name, rows):
    """Three rigs, four periods of anything: alone and together the same voltages, finite and within the supply."""
    many, alone = replace(fitted[name]), [replace(fitted[name]) for _ in range(3)]
    state = many.initial_state(3)
    for row in rows:
        force, velocity, known = fed(many, row)
        volts, state = many.voltage_batch(force, velocity, state, **known)
        assert (np.abs(volts) <= RIG.supply_voltage).all()  # also that there is no NaN among them
        for i, one in enumerate(alone):
            given_one = {key: float(value[i]) for key, value in known.items()}
            assert one.voltage(float(force[i]), float(velocity[i]), **given_one) == volts[i]


@pytest.mark.parametrize("bad", BAD)
@pytest.mark.parametrize("name", KINDS)
def test_after_garbage_it_is_as_trained_and_the_other_rigs_never_knew(fitted, name, bad):
    struck, spared = replace(fitted[name]), replace(fitted[name])
    usual = [(5.0, 0.2, 1.0), (-4.0, 0.1, 1.0), (3.0, -0.1, -1.0)]
    force, velocity, known = fed(struck, usual)
    _, before = struck.voltage_batch(force, velocity, struck.initial_state(3), **known)
    expected, after_expected = spared.voltage_batch(force, velocity, before, **known)
    for column in range(2 + struck.needs_friction):
        rows = [list(row) for row in usual]
        rows[1][column] = bad
        force, velocity, known = fed(struck, rows)
        again = replace(struck)
        with pytest.warns(compensators.FallbackWarning, match=f"the {name} compensator: .* as it was trained"):
            volts, after = again.voltage_batch(force, velocity, before, **known)
        again.voltage_batch(force, velocity, before, **known)  # not said again: pytest would turn that into an error
        assert volts[[0, 2]].tolist() == expected[[0, 2]].tolist()
        np.testing.assert_array_equal(after[[0, 2]], after_expected[[0, 2]])
        fresh = replace(fitted[name])
        if isinstance(fresh, compensators.Remembering):
            _, begun = fresh.voltage_batch(np.zeros(1), np.zeros(1), fresh.initial_state(1))
        else:
            begun = fresh.initial_state(1)
        np.testing.assert_array_equal(after[1], begun[0])


@pytest.mark.filterwarnings("ignore::dipc_gym.compensators.OutOfRangeWarning")
def test_without_a_known_supply_it_is_finite_and_no_more(fitted):
    """As made by hand, or read from a file of an earlier version."""
    made = replace(fitted["feedforward"], supply=None)
    assert made.voltage(1e5, 0.0) > 1e4
    with pytest.warns(compensators.FallbackWarning):
        assert abs(made.voltage(math.nan, 0.0)) < RIG.supply_voltage
    early = made.to_dict()
    assert early["output"] == {"name": "voltage", "unit": "V"}
    assert load(early) == made
    assert load(fitted["feedforward"].to_dict()).supply == RIG.supply_voltage


def test_a_formula_that_overflows_gives_no_voltage_and_says_so():
    steep = Feedforward(1e305, 0.0, 0.0, 0.0, 0.01)
    with pytest.warns(compensators.FallbackWarning, match="no finite voltage"):
        assert steep.voltage(1e5, 0.0) == 0.0
    with pytest.warns(compensators.FallbackWarning, match="no finite voltage"), np.errstate(over="ignore"):
        volts, _ = replace(steep).voltage_batch(np.array([1e5, 1e-305]), np.zeros(2), steep.initial_state(2))
    assert volts.tolist() == [0.0, pytest.approx(1.0)]


@pytest.mark.parametrize("supply", [0.0, -24.0, math.nan, math.inf])
def test_an_impossible_supply_is_refused(supply):
    with pytest.raises(ValueError, match="supply is"):
        StaticGain(4.0, supply=supply)


# Names


@pytest.mark.parametrize("name", ["llnf_lagged", "disturbance_observer", "llnf_adaptive", "friedland"])
def test_a_cart_that_moves_when_it_begins_was_not_at_rest(fitted, name):
    """The first voltage of a steady motion is like those that follow, also after a force that is not a number."""
    compensator = fitted[name]
    compensator.reset()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        steady = [compensator.voltage(float("nan") if k == 30 else 16.0, 0.3) for k in range(60)]
    # What is still to be learned of friction, 8 N, is 2 V; the step from rest was 24 V and more.
    assert np.abs(np.diff(steady[:6])).max() < 3.0
    assert np.abs(np.diff(steady[31:36])).max() < 3.0


@pytest.mark.parametrize("change", [{"supply": 12.0}, {"supply_voltage": 12.0}])
def test_the_smaller_supply_holds(fitted, change):
    weak = dataclasses.replace(fitted["lugre"], **change)
    assert (weak.supply, weak.supply_voltage, weak.voltage(57.0, 0.1)) == (12.0, 12.0, 12.0)


def test_friction_may_be_strong():
    """A rig of a ton: 1,500 N of dry friction."""
    strong = run_with(lambda velocity: 1500 * np.tanh(velocity / 0.02), n=600)
    assert fit("lugre", strong, RIG).coulomb == pytest.approx(1500, rel=0.2)


def test_names_come_in_the_order_of_the_table():
    assert tuple(names()) == KINDS


def test_an_unknown_name_lists_what_there_is():
    with pytest.raises(ValueError, match="no compensator 'lnf'; there are none, feedforward, mlp, llnf"):
        fit("lnf", run_with(stribeck, n=400), RIG)


def test_a_class_derived_from_a_compensator_has_a_name_of_its_own():
    @dataclass(frozen=True)
    class Milder(Feedforward):
        pass

    register("milder", Milder)
    try:
        assert (Milder.name, Feedforward.name) == ("milder", "feedforward")
        assert registry.kind("milder") is Milder
    finally:
        del registry._KINDS["milder"]


def test_an_own_compensator_takes_part_in_everything(tmp_path):
    @dataclass(frozen=True)
    class Halved(Compensator):
        gain: float

        @classmethod
        def fit(cls, samples, rig, *, seed=0):
            return cls(0.5 / rig.newtons_per_volt)

        def volts(self, force, velocity, previous_velocity):
            return self.gain * force

    register("halved", Halved)
    try:
        own = fit("halved", run_with(stribeck, n=400), RIG)
        save(own, tmp_path / "own.json")
        assert load(tmp_path / "own.json") == own
        assert own.voltage(8.0, 0.0) == 1.0
        assert own.parameters == 1
        with pytest.raises(ValueError, match="registered as 'halved'"):
            register("other", Halved)
    finally:
        del registry._KINDS["halved"]


@pytest.mark.parametrize("bad", [object, StaticGain(1.0), "none"])
def test_only_compensator_classes_can_be_registered(bad):
    with pytest.raises(TypeError, match="derived from Compensator"):
        register("bad", bad)


def test_a_name_must_be_one_word():
    with pytest.raises(ValueError, match="no name"):
        register("two words", StaticGain)


# Data to fit


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"velocity": np.zeros(3)}, r"Samples.velocity has shape \(3,\)"),
        ({"voltage": np.array([0, 1, np.nan, 0.0])}, r"Samples.voltage\[2\] is nan"),
        ({"train": np.array([1, 1, 0, 0])}, "boolean"),
        ({"train": np.ones(4, dtype=bool)}, "both training and test"),
        ({"train": np.zeros(4, dtype=bool)}, "both training and test"),
    ],
)
def test_unusable_samples_are_refused(change, message):
    good = {name: np.zeros(4) for name in ("force", "velocity", "previous_velocity", "voltage")}
    good["train"] = np.array([True, True, False, False])
    Samples(**good)
    with pytest.raises(ValueError, match=message):
        Samples(**{**good, **change})


@pytest.mark.parametrize("name", ["newtons_per_volt", "viscous", "supply_voltage"])
def test_unusable_rig_constants_are_refused(name):
    with pytest.raises(ValueError, match=name):
        replace(RIG, **{name: math.nan})


@pytest.mark.parametrize("name", KINDS)
def test_a_rig_that_stood_still_can_be_fitted(name):
    zeros = np.zeros(200)
    compensator = fit(name, Samples(zeros, zeros, zeros, zeros, np.arange(200) % 2 == 0), RIG)
    extra = {"friction": 0.0} if compensator.needs_friction else {}
    assert compensator.voltage(0.0, 0.0, **extra) == pytest.approx(0.0, abs=1e-6)


# Files


@pytest.mark.parametrize("name", KINDS)
def test_a_file_brings_everything_back_to_the_last_bit(fitted, name, tmp_path):
    compensator = fitted[name]
    path = tmp_path / f"{name}.json"
    save(compensator, path)
    assert load(path) == load(str(path)) == compensator
    assert load(compensator.to_dict()) == compensator
    assert json.loads(json.dumps(compensator.to_dict())) == compensator.to_dict()
    assert load(path).to_dict() == compensator.to_dict()
    assert [entry.name for entry in tmp_path.iterdir()] == [path.name]


def test_a_file_says_what_it_holds(fitted):
    data = fitted["llnf"].to_dict()
    assert data["schema"] == "dipc-gym/compensator/1"
    assert [(entry["name"], entry["unit"]) for entry in data["inputs"]] == [
        ("force", "N"),
        ("velocity", "m/s"),
        ("previous_velocity", "m/s"),
    ]
    samples = run_with(stribeck)
    assert data["inputs"][0]["high"] == samples.force[samples.train].max()
    assert set(data["fit"]) == {"train_mse", "test_mse", "train_samples", "test_samples"}


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "empty"),
        (b"  \n", "empty"),
        (b"\x80\x81\xff\x00", "nor any text"),
        (b'{"schema": "dipc-gym/compensator/1", "kind": ', "cut short"),
        (b"[" * 100_000, "nested too deeply"),
        (b"3", "top level: is 3"),
        (b"[]", "top level: is a list"),
        (b'{"a": ' + b"9" * 5000 + b"}", "not JSON"),
        (b" " * 10_000_001, "larger than"),
    ],
)
def test_what_is_no_compensator_file_is_refused(tmp_path, content, message):
    path = tmp_path / "broken.json"
    path.write_bytes(content)
    with pytest.raises(CompensatorError, match=message) as caught:
        load(path)
    assert "broken.json" in str(caught.value)


@pytest.mark.parametrize("path", ["missing.json", ".", "nul\0byte", "a/b/c.json"])
def test_a_path_that_cannot_be_read_is_named(tmp_path, path):
    with pytest.raises(CompensatorError, match="cannot be read"):
        load(tmp_path / path)


@pytest.mark.parametrize("source", [None, 3, b"llnf.json", [1]])
def test_only_paths_and_dicts_are_loaded(source):
    with pytest.raises(CompensatorError, match="from a path or a dict"):
        load(source)


def put(*keys, value):
    def edit(data):
        for key in keys[:-1]:
            data = data[key]
        data[keys[-1]] = value

    return edit


def cut(*keys):
    def edit(data):
        for key in keys[:-1]:
            data = data[key]
        del data[keys[-1]]

    return edit


@pytest.mark.parametrize(
    ("edit", "field", "message"),
    [
        (put("schema", value="dipc-gym/compensator/2"), "schema", "update dipc-gym"),
        (put("schema", value=None), "schema", "update dipc-gym"),
        (cut("schema"), "schema", "missing"),
        (put("kind", value="lnf"), "kind", "there are none, feedforward, mlp, llnf, ideal"),
        (put("kind", value=["llnf"]), "kind", "there are"),
        (put("kind", value="mlp"), "parameters.'centres'", "unknown"),
        (cut("parameters"), "parameters", "missing"),
        (put("parameters", value=[]), "parameters", "must be an object"),
        (cut("parameters", "levels"), "parameters.levels", "missing"),
        (put("parameters", "extra", value=1.0), "parameters.'extra'", "unknown"),
        (put("parameters", "levels", 1, value=math.nan), r"parameters.levels\[1\]", "finite"),
        (put("parameters", "slopes", 1, 2, value=math.inf), r"parameters.slopes\[1\]\[2\]", "finite"),
        (
            put("parameters", "slopes", 0, 0, value="0.1"),
            r"parameters.slopes\[0\]\[0\]",
            "is '0.1'; it must be a finite number",
        ),
        (put("parameters", "slopes", 0, 0, value=True), r"parameters.slopes\[0\]\[0\]", "must be a finite number"),
        (put("parameters", "slopes", 0, 0, value=None), r"parameters.slopes\[0\]\[0\]", "is null"),
        (put("parameters", "slopes", 0, 0, value=10**400), r"parameters.slopes\[0\]\[0\]", "finite"),
        (cut("parameters", "levels", 0), "parameters.levels", "has 1 entries; it must have 2"),
        (cut("parameters", "slopes", 1, 0), r"parameters.slopes\[1\]", "has 2 entries; it must have 3"),
        (put("parameters", "centres", value=[]), "parameters.centres", "at least one"),
        (put("parameters", "sigmas", 0, 1, value=0.0), r"parameters.sigmas\[0\]\[1\]", "above zero"),
        (
            put("parameters", "slopes", value=[[1e308] * 3] * 2),
            "parameters",
            "give nan V for -50 N .*100,000 V at most",
        ),
        (put("parameters", "slopes", value=[[1e300] * 3] * 2), "parameters", "at -1 m/s, within the ranges"),
        (put("parameters", "levels", value=[2e5, 2e5]), "parameters", r"give 2e\+05 V for -50 N"),
        (put("inputs", value=[{}]), "inputs", "list of the 3 inputs"),
        (put("inputs", 1, value=3), r"inputs\[1\]", "must be an object"),
        (put("inputs", 0, "unit", value="lbf"), r"inputs\[0\].unit", "must be 'N'"),
        (put("inputs", 0, "name", value="velocity"), r"inputs\[0\].name", "must be 'force'"),
        (put("inputs", 2, "low", value=1e3), r"inputs\[2\].low", "exchange"),
        (put("inputs", 2, "high", value=math.nan), r"inputs\[2\].high", "finite"),
        (put("output", value={"name": "voltage", "unit": "mV"}), "output", "must be"),
        (put("output", value={"name": "voltage", "unit": "V", "high": 24.0}), "output.low", "is missing"),
        (put("output", "low", value=-12.0), "output.low", "as large either way"),
        (put("output", "high", value=-1.0), "output.high", "above zero"),
        (put("fit", "test_mse", value=-1.0), "fit.test_mse", "not negative"),
        (put("fit", "test_samples", value=1.5), "fit.test_samples", "must be a whole number"),
        (put("fit", value=7), "fit", "must be an object"),
        (cut("fit", "train_mse"), "fit.train_mse", "missing"),
        (put("note", value="mine"), "'note'", "unknown"),
    ],
)
def test_a_hand_edited_file_is_refused_with_its_field(tmp_path, edit, field, message):
    ranges = (InputRange(-50.0, 50.0), InputRange(-1.0, 1.0), InputRange(-1.0, 1.0))
    data = replace(small_llnf(), ranges=ranges, figures=FitFigures(0.1, 0.2, 50, 50), supply=24.0).to_dict()
    data = json.loads(json.dumps(data))
    load(data)
    edit(data)
    path = tmp_path / "edited.json"
    path.write_text(json.dumps(data))
    for source, name in ((path, "edited.json"), (data, "compensator dict")):
        with pytest.raises(CompensatorError, match=rf"(?s){name}: {field}: .*{message}"):
            load(source)


def test_numbers_without_which_a_formula_divides_by_zero_are_refused(fitted):
    for name, field in (("none", "newtons_per_volt"), ("feedforward", "sign_velocity")):
        data = fitted[name].to_dict()
        data["parameters"][field] = 0.0
        with pytest.raises(CompensatorError, match=f"{field}: is 0.0; it must be above zero"):
            load(data)


def places(data, path=()):
    """Every place in nested data, as a path of keys."""
    yield path
    items = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
    for key, value in items:
        yield from places(value, (*path, key))


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=6,
)


def usable_or_refused(source):
    """Load; whatever comes of it must be a working compensator or a CompensatorError, without a warning."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            compensator = load(source)
        except CompensatorError:
            return
    extra = {"friction": 0.0} if compensator.needs_friction else {}
    low = [limits.low for limits in compensator.ranges[:2]] or [1.0, 1.0]
    assert math.isfinite(compensator.voltage(*low, **extra))


@pytest.mark.parametrize("period", [1e300, 3.6e3, 1e-5])
@pytest.mark.parametrize("name", REMEMBERING)
def test_a_period_that_no_controller_has_is_refused(fitted, name, period):
    data = fitted[name].to_dict()
    data["parameters"]["period"] = period  # the bristle would be stepped through it, a millisecond at a time
    with pytest.raises(CompensatorError, match=f"parameters: period is {re.escape(f'{period:g}')}; .* 0.0001 to 1 s"):
        load(data)


@settings(max_examples=400, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_mutated_data_are_refused_or_work(fitted, data):
    mutant = fitted[data.draw(st.sampled_from(KINDS))].to_dict()
    for _ in range(data.draw(st.integers(1, 3))):
        path = data.draw(st.sampled_from(list(places(mutant))[1:]))
        spot = mutant
        for key in path[:-1]:
            spot = spot[key]
        if data.draw(st.booleans()):
            spot[path[-1]] = data.draw(JSON | st.floats(allow_nan=False, allow_infinity=False))
        else:
            del spot[path[-1]]
        if not mutant:
            break
    usable_or_refused(mutant)


@settings(max_examples=300, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_mutated_bytes_are_refused_or_work(fitted, tmp_path, data):
    content = bytearray(json.dumps(fitted[data.draw(st.sampled_from(KINDS))].to_dict()).encode())
    for _ in range(data.draw(st.integers(1, 4))):
        start = data.draw(st.integers(0, len(content)))
        end = data.draw(st.integers(start, min(start + 8, len(content))) | st.just(len(content)))
        content[start:end] = data.draw(st.binary(max_size=6) | st.sampled_from([b"NaN", b"1e999", b"-", b"]"]))
    path = tmp_path / "mutant.json"
    path.write_bytes(bytes(content))
    usable_or_refused(path)


# The package


def test_without_torch_the_mlp_says_how_to_install_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "torch", None)
    with pytest.raises(
        ImportError,
        match=r"add its extra: pip install '\.\[mlp\]' in a clone",
    ):
        fit("mlp", run_with(stribeck, n=400), RIG)


def test_running_a_compensator_imports_neither_torch_nor_scikit_learn(fitted, tmp_path):
    save(fitted["mlp"], tmp_path / "mlp.json")
    script = (
        "import sys; from dipc_gym import compensators\n"
        f"compensators.load({str(tmp_path / 'mlp.json')!r}).voltage(1.0, 0.1)\n"
        "heavy = {'torch', 'sklearn', 'matplotlib'} & set(sys.modules)\n"
        "assert not heavy, heavy\n"
    )
    subprocess.run([sys.executable, "-W", "error", "-c", script], check=True)


def test_the_own_compensator_example_runs():
    script = Path(__file__).parents[1] / "examples" / "own_compensator.py"
    output = subprocess.run([sys.executable, "-W", "error", script], check=True, capture_output=True, text=True).stdout
    forwards, backwards = (float(part.split()[-2]) for part in output.splitlines()[-2].split(","))
    assert forwards == pytest.approx(9.0, rel=0.05)
    assert backwards == pytest.approx(6.0, rel=0.05)
