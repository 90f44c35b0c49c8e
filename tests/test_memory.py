"""Compensators with a memory: the physics that each remembers, and what garbage does to them."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from dipc_gym import compensators, runs
from dipc_gym.compensators import (
    AdaptiveLLNF,
    DisturbanceObserver,
    FallbackWarning,
    Friedland,
    LuGre,
    MaxwellSlip,
    RigConstants,
    Samples,
)
from dipc_gym.compensators.memory import stretches
from dipc_gym.plant import Friction, Plant

GIVEN = (4.0, 24.0, 0.005)  # N/V, V, s
LUGRE = LuGre(*GIVEN, 2e4, 60.0, 8.0, 3.0, 0.02)
SLIP = MaxwellSlip(*GIVEN, (1e-4, 4e-4), (3.0, 5.0), (1.0, 2.0), 0.02, 0.0)
FLAT = ((0.0, 0.0, 0.0),), ((1e3, 1e3, 1e3),), (0.0,), ((0.25, 0.0, 0.0),)  # one local model: a gain
KINDS = (
    LUGRE,
    SLIP,
    Friedland(*GIVEN, 8.0, 5.0, 0.02, 1.26, 40.0),
    DisturbanceObserver(*GIVEN, 0.3, 1.26, 40.0),
    AdaptiveLLNF(*GIVEN, *FLAT, 3.0, 1.26, 40.0),
)


def names(kinds):
    return [kind.name for kind in kinds]


@pytest.fixture(scope="module")
def run():
    """The paper's identification run on a rig of which only the encoder and the voltage are known."""
    return runs.identify(Plant(friction=Friction(coulomb=6.0, static=9.0)), seed=4)


def friction(kind, velocity, memory=None):
    """What it adds to no force, N, along velocities."""
    memory, forces = kind.begin(1) if memory is None else memory, []
    for v in velocity:
        volts, memory = kind.respond(np.zeros(1), np.array([v]), memory)
        forces.append(4.0 * volts[0])
    return np.array(forces)


# What they remember


@pytest.mark.parametrize("kind", [LUGRE, SLIP], ids=names([LUGRE, SLIP]))
def test_before_it_slips_friction_is_a_spring_and_afterwards_a_level(kind):
    """A tenth of a millimetre is mostly given back; half a metre a second is the Coulomb level, and turns with it."""
    to_and_fro = friction(kind, [0.01] * 2 + [-0.01] * 2)
    assert to_and_fro[1] > 1.0
    assert abs(to_and_fro[3]) < 0.75 * to_and_fro[1]
    assert friction(kind, [0.5] * 100)[-1] == pytest.approx(8.0, rel=1e-3)
    assert friction(kind, [0.5] * 100 + [-0.5] * 100)[-1] == pytest.approx(-8.0, rel=1e-3)


@settings(max_examples=60, deadline=None)
@given(v=arrays(np.float64, 40, elements=st.floats(-1, 1)))
def test_the_bristle_never_holds_more_than_static_friction(v):
    """The bound of the LuGre model: stiffness times bristle stays within the static level, at any step."""
    memory = LUGRE.begin(1)
    for speed in v:
        _, memory = LUGRE.respond(np.zeros(1), np.array([speed]), memory)
        assert abs(LUGRE.stiffness * memory[0, 0]) <= LUGRE.coulomb + LUGRE.excess + 1e-9


def test_slow_motion_costs_the_static_level():
    assert friction(LUGRE, [0.002] * 400)[-1] == pytest.approx(11.0, rel=0.02)
    assert friction(SLIP, [0.002] * 400)[-1] == pytest.approx(11.0, rel=0.02)


def test_friedlands_level_goes_to_the_friction_that_is_there():
    kind = replace(KINDS[2], level=2.0)
    memory = kind.begin(1)
    for _ in range(400):  # a cart at constant speed: the motor carries viscous drag and 6 N
        memory[0, -1] = (40 * 0.3 + 6.0) / 4.0
        _, memory = kind.respond(np.zeros(1), np.array([0.3]), memory)
    assert memory[0, 0] == pytest.approx(6.0, rel=1e-3)


@settings(max_examples=20, deadline=None)
@given(force=st.floats(-20, 20), share=st.floats(0.1, 1.0))
def test_the_observer_finds_what_holds_a_cart_that_stands(force, share):
    """A cart that does not move under a voltage is held by just as much; it is then added to the force wanted."""
    kind = replace(KINDS[3], share=share)
    memory = kind.begin(1)
    for _ in range(200):
        memory[0, -1] = force / 4.0
        _, memory = kind.respond(np.zeros(1), np.zeros(1), memory)
    assert memory[0, 0] == pytest.approx(force, abs=1e-6)


def test_the_adapting_network_learns_an_offset_and_stays_within_its_bound():
    """It was trained without friction; 6 N of it are 1.5 V, and 40 N are more than it may correct."""
    for resisting, correction in ((6.0, 1.5), (40.0, 3.0)):
        kind, memory = KINDS[4], KINDS[4].begin(1)
        for _ in range(600):
            memory[0, -1] = (40 * 0.3 + resisting) / 4.0
            _, memory = kind.respond(np.zeros(1), np.array([0.3]), memory)
        assert memory[0, 0] == pytest.approx(correction, rel=0.02)


# What they learn from a rig's run, and nothing else


def test_lugre_is_found_in_a_run(run):
    """The level to a twentieth; the bristle, which the cart crosses within a few samples, to a half."""
    found = run.fit("lugre").friction
    assert found.coulomb == pytest.approx(6.0, rel=0.05)
    assert found.bristle_stiffness == pytest.approx(2e4, rel=0.5)


def test_the_level_is_found_in_a_run(run):
    found = run.fit("maxwell_slip")
    assert sum(found.levels) + 0.5 * found.per_velocity == pytest.approx(6.0, rel=0.15)


def test_what_weighs_motion_wants_the_mass(run):
    rig = RigConstants(4.0, 40.0, 24.0)
    for name in ("friedland", "disturbance_observer", "llnf_adaptive"):
        with pytest.raises(ValueError, match=rf"{name} compensator .* needs RigConstants.mass, in kg"):
            compensators.fit(name, run.samples, rig)


def test_the_lags_that_matter_are_chosen():
    """Friction that follows the velocity of three periods ago: v(k-3) is taken before any other lag."""
    rng = np.random.default_rng(0)
    velocity = np.convolve(rng.normal(size=1203), [0.3, 0.4, 0.3], "valid")[:1200]
    late = np.concatenate([np.zeros(3), velocity[:-3]])
    voltage = rng.normal(0, 3, 1200)
    force = 4 * voltage - 8 * np.tanh(2 * late)
    previous = np.concatenate([velocity[:1], velocity[:-1]])
    samples = Samples(force, velocity, previous, voltage, np.arange(1200) % 4 < 2)
    chosen = compensators.fit("llnf_lagged", samples, RigConstants(4.0, 40.0, 24.0))
    assert chosen.inputs[2] == 8.0


# Garbage


@pytest.mark.parametrize("kind", KINDS, ids=names(KINDS))
@pytest.mark.parametrize("bad", [math.nan, math.inf, -1e300])
def test_garbage_falls_back_to_the_trained_self_and_says_so(kind, bad):
    fed, fresh = replace(kind), replace(kind)
    for _ in range(20):
        fed.voltage(5.0, 0.2)
    with pytest.warns(FallbackWarning, match="goes on as it was trained"):
        assert abs(fed.voltage(5.0, bad)) <= 24.0
    fresh.voltage(0.0, 0.0)
    assert fed.voltage(3.0, 0.0) == fresh.voltage(3.0, 0.0)
    assert abs(fed.voltage(bad, 0.1)) <= 24.0  # not said again: pytest would turn that into an error


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(inputs=arrays(np.float64, (6, 2), elements=st.floats(allow_nan=True, allow_infinity=True)))
@pytest.mark.filterwarnings("ignore::dipc_gym.compensators.FallbackWarning")
@pytest.mark.parametrize("kind", KINDS, ids=names(KINDS))
def test_no_input_gives_more_than_the_supply(kind, inputs):
    one = replace(kind)
    for force, velocity in inputs.tolist():
        assert abs(one.voltage(force, velocity)) <= 24.0


@settings(deadline=None)
@given(n=st.integers(1, 2000))
def test_stretches_cover_a_run(n):
    index, first = stretches(n)
    assert set(index[first:].ravel().tolist()) == set(range(n))
    assert (np.diff(index[first:], axis=0) == 1).all()


@pytest.mark.parametrize(
    ("name", "field", "value", "message"),
    [
        ("lugre", "damping", -1.0, "must not be negative"),
        ("disturbance_observer", "share", 1.5, "at most 1"),
        ("friedland", "mass", 0.0, "above zero"),
        ("maxwell_slip", "levels", [1.0], "entries"),
    ],
)
def test_impossible_numbers_are_refused(name, field, value, message):
    data = next(kind for kind in KINDS if kind.name == name).to_dict()
    data["parameters"][field] = value
    with pytest.raises(compensators.CompensatorError, match=message):
        compensators.load(data)
