"""Estimators: what they see of a rig, one rig against many, files good and bad, garbage, and the wrappers."""

import copy
import json
import math
import pickle
import warnings
from dataclasses import replace

import gymnasium
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from dipc_gym import compensators, estimators, runs
from dipc_gym.compensators import Samples, StaticGain
from dipc_gym.controllers import LQR, lqr
from dipc_gym.dataflow import Program
from dipc_gym.env import DoublePendulumEnv
from dipc_gym.estimators import Command, EstimateWarning, EstimatorError, RigModel
from dipc_gym.estimators.kalman import FLOOR
from dipc_gym.plant import Encoders, Friction, Plant
from dipc_gym.wrappers import EstimateState, ForceCommand, VectorEstimateState, VectorForceCommand

NAMES = ("differences", "kalman", "kalman_friction", "disturbance", "ekf", "moving_horizon", "rigid_body")
FILTERS = NAMES[1:]
OBSERVERS = ("disturbance", "ekf", "moving_horizon", "rigid_body")
DRY = Friction(viscous=0.0)


@pytest.fixture(scope="module")
def rig():
    env = DoublePendulumEnv()
    return RigModel.of(*lqr.linear_model(env.model), env.plant, env.plant.motor.force_per_volt)


@pytest.fixture(scope="module")
def made(rig):
    return {name: estimators.kind(name)(rig, DRY) for name in NAMES}


def vector(n, **kwargs):
    return gymnasium.make_vec("DIPC-Friction-v0", n, vectorization_mode="vector_entry_point", **kwargs)


def course(estimator, rig, steps=200, push=0.0, counts=True):
    """A rig with a constant force that holds back, balanced by the printed gain: truth, estimate and memory."""
    F, G = lqr.sampled(np.array(rig.A), np.array(rig.B)[:, None], rig.period)
    truth = np.array([0.005, 0.004, -0.003, 0.0, 0.0, 0.0])
    step = np.array([rig.cart_step, rig.pole_step, rig.pole_step])
    state, rows = estimator.initial_state(np.array([[*truth[:3], 0.0, 0.0, 0.0]])), []
    for _ in range(steps):
        wanted = -lqr.PRINTED_GAIN @ truth
        truth = F @ truth + G[:, 0] * (wanted - push)
        read = np.round(truth[:3] / step) * step if counts else truth[:3]
        volts = np.array([wanted / rig.newtons_per_volt])
        state = estimator.update(state, read[None], Command(np.array([wanted]), volts))
        rows.append((truth.copy(), estimator.observation(state)[0], state))
    return rows


# What they see


LATE = ("kalman", "disturbance", "rigid_body")


@pytest.mark.parametrize("name", LATE)
@pytest.mark.parametrize("delay", [0.002, 0.01, 0.0225])
def test_a_known_delay_is_counted_with(rig, name, delay):
    """Told of it, a filter sees the state when the next command acts; untold, it is as wrong as a motion of `delay`."""
    told, untold = (estimators.kind(name)(replace(rig, delay=d), DRY) for d in (delay, 0.0))
    A, B, fine = np.array(rig.A), np.array(rig.B)[:, None], 0.00025
    F, G = lqr.sampled(A, B, fine)
    steps, late = round(rig.period / fine), round(delay / fine)
    truth, issued = np.array([0.005, 0.004, -0.003, 0.0, 0.0, 0.0]), [0.0] * late
    states = {est: est.initial_state(truth[None]) for est in (told, untold)}
    errors, then = {told: [], untold: []}, []
    path = []
    for k in range(150):
        wanted = 8.0 * math.sin(0.15 * k)
        issued += [wanted] * steps
        for _ in range(steps):
            path.append(truth)
            truth = F @ truth + G[:, 0] * issued[len(path) - 1]
        for est in states:
            command = Command(np.array([wanted]), np.array([wanted / rig.newtons_per_volt]))
            states[est] = est.update(states[est], truth[None, :3], command)
            then.append((est, len(path) + late, est.observation(states[est])[0]))
    for est, at, seen in then:
        if 400 < at < len(path):
            errors[est].append(np.abs(seen - path[at])[:4])
    worst = {est: np.max(errors[est], axis=0) for est in errors}
    assert worst[told][3] < 0.25 * worst[untold][3]


def test_a_late_loop_stands_with_the_delay_told_and_falls_without():
    plant = Plant(delay=0.025)
    found = runs.identify(plant, seed=0)
    assert found.rig.delay == 0.025
    told = found.fit_estimator("disturbance")
    untold = replace(told, rig=replace(told.rig, delay=0.0))
    courses = [
        runs.balance(LQR(), found.fit("observed"), seconds=8.0, seed=1, plant=plant, estimator=each)
        for each in (told, untold)
    ]
    assert [course.fell for course in courses] == [False, True]


@pytest.mark.parametrize(
    "plant",
    [
        Plant(),
        Plant(encoders=Encoders(cart=Plant().encoders.cart / 8)),
        Plant(control_period=0.01),
    ],
    ids=["paper's", "fine cart encoder", "long period"],
)
def test_a_filter_is_no_faster_than_what_it_observes_can_be_fed_forward(plant):
    """Without a limit, a finer encoder or a longer period makes it shake at the supply's limits, or fall."""
    found = runs.identify(plant, seed=0)
    sees, friction = found.fit_estimator("disturbance"), found.fit("observed")
    course = runs.balance(LQR(), friction, seconds=8.0, seed=1, plant=plant, estimator=sees)
    assert not course.fell
    assert course.force[200:].std() < 2.0
    assert course.clipped == 0


def test_a_file_without_a_delay_has_none(made):
    written = made["disturbance"].to_dict()
    del written["rig"]["delay"]
    assert estimators.load(written).rig.delay == 0.0


def test_names_come_in_the_order_of_the_table():
    assert tuple(estimators.names()) == NAMES


@pytest.mark.parametrize("name", FILTERS)
def test_a_filter_beats_differences_on_the_rates(made, rig, name):
    """On the rig of its own model, the rates of the poles, whose counts are coarse, are closer to the truth by half."""

    def error(estimator):
        rows = course(estimator, rig)[50:]
        return np.sqrt(np.mean([(seen - truth)[4:] ** 2 for truth, seen, _ in rows], axis=0))

    assert (error(made[name]) < 0.5 * error(made["differences"])).all()


@pytest.mark.parametrize("name", OBSERVERS)
def test_a_force_that_holds_back_is_found(made, rig, name):
    rows = course(made[name], rig, push=5.0)
    found = [made[name].friction(state)[0] for _, _, state in rows]
    assert np.mean(found[100:]) == pytest.approx(5.0, abs=0.5)
    assert max(found[2:10]) > 4.0  # within the first ten periods
    assert max(abs(seen - truth)[0] for truth, seen, _ in rows) < 2 * rig.cart_step


@pytest.mark.parametrize("name", ["differences", "kalman", "kalman_friction"])
def test_what_observes_no_friction_says_so(made, rig, name):
    with pytest.raises(TypeError, match="does not observe friction"):
        made[name].friction(made[name].initial_state(np.zeros((1, 6))))


def test_the_kalman_gain_solves_its_riccati_equation_and_holds_the_error(made, rig):
    """The error's dynamics are stable, for the unstable rig too."""
    for name, size in (("kalman", 6), ("disturbance", 7)):
        values = np.linalg.eigvals(made[name]._next[:, :size])
        assert np.abs(values).max() < 1


def test_differences_are_the_environments_own_observation(made):
    env = gymnasium.make("DIPC-Friction-v0")
    own, seen = gymnasium.make("DIPC-Friction-v0"), EstimateState(env, made["differences"])
    a, _ = own.reset(seed=3)
    b, _ = seen.reset(seed=3)
    for k in range(50):
        assert a.tolist() == b.tolist()
        volts = [3.0 * math.sin(k)]
        a, b = own.step(volts)[0], seen.step(volts)[0]


def test_the_bristle_of_the_filter_is_that_of_the_compensator(made, rig):
    dry = made["ekf"].dry
    bristle = compensators.LuGre(
        *(4.0, 24.0, rig.period, dry.bristle_stiffness, dry.bristle_damping, dry.coulomb),
        *(dry.static - dry.coulomb, dry.stribeck_velocity),
    )
    state = made["ekf"].initial_state(np.array([[0.0, 0.0, 0.0, 0.03, 0.0, 0.0]]))
    v = np.array([0.03])
    assert made["ekf"].friction(state)[0] == pytest.approx(bristle.period_of(v, v, np.zeros(1))[1][0], rel=1e-12)


@settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(v=st.floats(-0.5, 0.5), z=st.floats(-4e-4, 4e-4))
def test_the_filters_slopes_are_those_of_its_step(made, v, z):
    """The Jacobian of a bristle's step against central differences; at rest friction has a kink, and one side's slope
    is as good."""
    step, program = 1e-7, Program()
    if abs(v) < 1e-5:
        v = 1e-5
    after, force, of_bristle, of_force = made["ekf"]._bristle(program.input("v"), program.input("z"))
    program.output("after", program.join(after, force))
    program.output("slope", program.join(*of_bristle, *of_force))

    def found(name, v, z):
        return program.run({"v": [v], "z": [z]}, {})[0][name][:, 0]

    slope = found("slope", v, z).reshape(2, 2)
    for i, (dv, dz) in enumerate(((step, 0.0), (0.0, 1e-3 * step))):
        difference = (found("after", v + dv, z + dz) - found("after", v - dv, z - dz)) / (2 * (dv + dz))
        np.testing.assert_allclose(slope[:, i], difference, rtol=2e-3, atol=2e-5)


@pytest.mark.parametrize("period", [0.001, 0.005, 0.023])
def test_the_filters_covariance_is_what_products_of_full_matrices_give(rig, period):
    """A period, worked out anew: the slope of the whole motion by differences, the textbook's gain and covariance."""
    rig = replace(rig, period=period)
    ekf = estimators.kind("ekf")(rig, DRY)
    noise = np.diag([FLOOR] * 6 + [FLOOR + (ekf._walk / DRY.bristle_stiffness) ** 2, (0.2 * ekf._walk / 2) ** 2])
    readings, volts = np.array([[0.01, 0.002, -0.001]]), np.array([1.5])
    state = np.array([[0.01, 0.002, -0.001, 0.08, 0.05, -0.02, 1e-4, 0.5]])
    state = np.hstack([state, ekf.begin(np.zeros((1, 6)))[:, 8:]])
    blind = replace(ekf, rig=replace(rig, cart_step=0.1, pole_step=1.0))  # so coarse that nothing is corrected

    def moved(x):
        return blind.advance(np.hstack([x, 0.0 * state[:, 8:]]), x[:, :3], Command(np.zeros(1), volts))[0, :8]

    steps = np.array([1e-6] * 6 + [1e-9, 1e-6])
    slope = [(moved(state[:, :8] + d) - moved(state[:, :8] - d)) / (2 * d.sum()) for d in np.diag(steps)]
    F, P, R = np.array(slope).T, np.zeros((8, 8)), rig.reading_covariance
    P[np.tril_indices(8)] = state[0, 8:]
    P = F @ (P + P.T - np.diag(np.diag(P))) @ F.T + noise
    gain = P[:, :3] @ np.linalg.inv(P[:3, :3] + R)
    x = moved(state[:, :8])
    found = ekf.advance(state, readings, Command(np.zeros(1), volts))[0]
    np.testing.assert_allclose(found[:8], x + gain @ (readings[0] - x[:3]), rtol=1e-5, atol=1e-8)
    expected = P - gain @ P[:3]
    size = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    rows, columns = np.tril_indices(8)
    np.testing.assert_allclose(found[8:] / size[rows, columns], (expected / size)[rows, columns], rtol=0, atol=1e-5)


def test_a_horizon_reads_within_its_counts(made, rig):
    """The past that it finds agrees with what was read, to a tenth of a count on the mean."""
    horizon, width = made["moving_horizon"], 3 * 41
    _, _, state = course(horizon, rig)[-1]
    past, inputs = state[:, 7 : 7 + width], state[:, 7 + width :]
    fitted = (horizon._fitted @ np.concatenate([past, inputs], axis=1)[:, :, None])[0, :width, 0]
    off = np.abs(fitted - past[0]).reshape(-1, 3) / np.array([rig.cart_step, rig.pole_step, rig.pole_step])
    assert (off.mean(axis=0) < [0.5, 0.5, 1.0]).all()


def test_what_is_learned_comes_from_the_run_alone():
    """Coulomb level to a twentieth and the bristle to a third, from sixty seconds of cart encoder and voltage."""
    learned = runs.estimator("ekf", Plant(friction=Friction(coulomb=10.0, static=14.0)), seed=1).dry
    assert learned.coulomb == pytest.approx(10.0, rel=0.05)
    assert learned.bristle_stiffness == pytest.approx(2e4, rel=0.33)
    assert learned.viscous == 0.0


# One rig and many


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("n", [1, 2, 5, 33])
def test_many_rigs_get_what_single_rigs_get_to_the_last_bit(made, name, n):
    estimator, rng = made[name], np.random.default_rng(n)
    start = rng.normal(0, 0.01, (n, 6))
    many, single = estimator.initial_state(start), [estimator.initial_state(row[None]) for row in start]
    for _ in range(4):
        readings, force = rng.normal(0, 0.01, (n, 3)), rng.normal(0, 10, n)
        many = estimator.update(many, readings, Command(force, force / 4))
        for i in range(n):
            command = Command(force[i : i + 1], force[i : i + 1] / 4)
            single[i] = estimator.update(single[i], readings[i : i + 1], command)
    assert many.tolist() == np.vstack(single).tolist()


@pytest.mark.parametrize("name", ["kalman", "kalman_friction", "disturbance"])
@pytest.mark.parametrize("compensator", ["none", "lugre"])
def test_the_vector_environment_is_the_single_one(made, name, compensator):
    inverse = {
        "none": StaticGain(4.0),
        "lugre": compensators.LuGre(4.0, 24.0, 0.005, 2e4, 60.0, 8.0, 3.0, 0.02),
    }[compensator]
    envs = VectorForceCommand(VectorEstimateState(vector(2), made[name]), inverse)
    singles = [ForceCommand(EstimateState(gymnasium.make("DIPC-Friction-v0"), made[name]), inverse) for _ in range(2)]
    seen, _ = envs.reset(seed=4)
    alone = [env.reset(seed=4 + i)[0] for i, env in enumerate(singles)]
    for _ in range(40):
        assert seen.tolist() == [row.tolist() for row in alone]
        forces = -seen @ lqr.PRINTED_GAIN
        seen = envs.step(forces[:, None])[0]
        alone = [env.step([force])[0] for env, force in zip(singles, forces.tolist(), strict=True)]


@pytest.mark.parametrize("make", [gymnasium.make, lambda _, **kwargs: vector(1, **kwargs)])
def test_a_voltage_that_the_rig_does_not_have_was_never_sent(made, make):
    """An estimator fitted at 24 V, on a rig of 6 V that is asked for 20."""
    friction = []
    for volts in (6.0, 20.0):
        env = make("DIPC-Friction-v0", plant={"supply": 6.0})
        env = (EstimateState if isinstance(env, gymnasium.Env) else VectorEstimateState)(env, made["disturbance"])
        env.reset(seed=2)
        for _ in range(40):
            env.step(np.full(np.shape(env.action_space.sample()), volts))
        friction.append(np.ravel(env.friction_estimate).tolist())
    assert friction[0] == friction[1]


def test_a_reset_of_some_rows_says_nothing_of_the_others(made):
    envs = VectorEstimateState(vector(2, autoreset_mode="Disabled", max_episode_steps=3), made["disturbance"])
    envs.reset(seed=7)
    for _ in range(3):
        envs.step(np.full((2, 1), 3.0))
    _, infos = envs.reset(options={"reset_mask": np.array([False, True])})
    assert infos["_friction_estimate"].tolist() == [False, True]


def test_the_last_estimate_of_a_row_is_the_single_environments(made):
    """Of an episode that ends within a step, whose observation says the exact state and not what encoders read."""
    how = {"exact_state": True, "max_episode_steps": 10, "plant": {"encoders": {"noise": 0.2}}}
    envs = VectorEstimateState(vector(2, autoreset_mode="SameStep", **how), made["disturbance"])
    alone = EstimateState(gymnasium.make("DIPC-Friction-v0", **how), made["disturbance"])
    envs.reset(seed=7)
    alone.reset(seed=7)
    for _ in range(10):
        _, _, _, ended, infos = envs.step(np.full((2, 1), 3.0))
        seen, _, _, _, info = alone.step([3.0])
    assert ended.all()
    assert infos["final_obs"][0].tolist() == seen.tolist()
    assert infos["final_info"]["friction_estimate"][0] == info["friction_estimate"]


@pytest.mark.parametrize("name", FILTERS)
def test_a_missing_reading_is_none_of_a_cart_that_stopped(made, rig, name):
    """At 0.2 m/s, one reading lost: the velocity goes on as it was foretold."""
    F, G = lqr.sampled(np.array(rig.A), np.array(rig.B)[:, None], rig.period)
    truth, estimator = np.array([0.05, 0.0, 0.0, 0.2, 0.0, 0.0]), made[name]
    state = estimator.initial_state(truth[None])
    for k in range(24):
        force = -float(lqr.PRINTED_GAIN @ truth)
        truth = F @ truth + G[:, 0] * force
        read = np.full((1, 3), np.nan) if k == 20 else truth[None, :3]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", EstimateWarning)
            state = estimator.update(state, read, Command(np.array([force]), np.array([force / rig.newtons_per_volt])))
        if k >= 20:
            assert estimator.observation(state)[0, 3] == pytest.approx(truth[3], abs=0.08)


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_estimates_begin_anew_with_the_episode(made, mode):
    envs = VectorEstimateState(vector(2, max_episode_steps=5, autoreset_mode=mode), made["disturbance"])
    envs.reset(seed=1)
    anew = ended = 0
    for _ in range(12):
        seen, _, _, truncated, infos = envs.step(np.full((2, 1), 2.0))
        anew, ended = anew + int(envs.unwrapped.began.any()), ended + int(truncated.any())
        if envs.unwrapped.began.any():
            assert (infos["friction_estimate"] == 0).all()
            assert (seen[:, 3:] == 0).all()
        if mode == "SameStep" and truncated.any():
            last = np.stack(list(infos["final_obs"]))
            assert (last[:, 3] != 0).all()  # the estimate, and not what the encoders' filter says
            assert (infos["final_info"]["friction_estimate"] != 0).all()
    assert anew == 2
    assert ended == 2


# In the loop


def test_observed_friction_takes_the_limit_cycle_away(made):
    """A seed of its own; without compensation this rig's cart swings 40 mm."""
    run = runs.balance(LQR(), compensators.Observed(4.0), seconds=12.0, seed=11, estimator=made["disturbance"])
    late = run.state[run.time > 6]
    assert not run.fell
    assert np.abs(late[:, 0]).max() < 0.03
    assert np.sqrt(np.mean(run.force[run.time > 6] ** 2)) < 2.5
    plain = runs.balance(LQR(), StaticGain(4.0), seconds=12.0, seed=11)
    assert np.sqrt(np.mean(plain.force[plain.time > 6] ** 2)) > 10


@pytest.mark.parametrize("scale", [0.25, 4.0])
def test_observed_friction_needs_no_training(made, scale):
    friction = Friction(coulomb=8.0 * scale, static=11.0 * scale)
    plant = Plant(friction=friction)
    run = runs.balance(
        LQR(), compensators.Observed(4.0), seconds=8.0, seed=2, estimator=made["disturbance"], plant=plant
    )
    assert not run.fell
    assert np.abs(run.state[run.time > 4, 0]).max() < 0.05


def test_the_force_after_friction_is_what_the_compensator_leaves(made):
    """Voltage that the compensator adds for friction is not taken for a force on the cart."""

    filter_ = made["kalman_friction"]
    state = filter_.initial_state(np.zeros((1, 6)))
    state[0, 3] = 0.1
    command = Command(np.array([2.0]), np.array([2.5]), lambda velocity: np.full_like(velocity, 8.0))
    assert filter_.force(state, command)[0] == pytest.approx(2.0)
    assert filter_.force(state, replace(command, friction=None))[0] == pytest.approx(10.0)


def test_a_compensator_that_needs_observed_friction_wants_an_observer(made):
    env, observed = gymnasium.make("DIPC-Friction-v0"), compensators.Observed(4.0)
    for inner in (env, EstimateState(env, made["kalman"])):
        with pytest.raises(ValueError, match="'observed' feeds forward the friction that an estimator observes"):
            ForceCommand(inner, observed)
    with pytest.raises(ValueError, match="inside ForceCommand"):
        VectorForceCommand(vector(1), observed)
    ForceCommand(EstimateState(env, made["disturbance"]), observed)


def test_an_estimator_for_another_rate_is_refused(made):
    env = gymnasium.make("DIPC-Friction-v0", plant={"control_period": 0.01})
    with pytest.raises(ValueError, match=r"control period of 0.005 s; the environment's is 0.01 s"):
        EstimateState(env, made["kalman"])


def test_wrapped_environments_are_recorded_and_copied(made):
    env = EstimateState(gymnasium.make("DIPC-Friction-v0"), made["disturbance"].to_dict())
    env.reset(seed=1)
    env.step([1.0])
    twin = copy.deepcopy(env)
    assert env.step([2.0])[0].tolist() == twin.step([2.0])[0].tolist()
    assert json.loads(json.dumps(env.spec.additional_wrappers[-1].kwargs))["estimator"]["kind"] == "disturbance"


# Garbage


@pytest.mark.parametrize("name", NAMES)
def test_garbage_is_said_once_and_leaves_no_trace(made, name):
    estimator = replace(made[name])
    state = estimator.initial_state(np.zeros((2, 6)))
    calm = Command(np.zeros(2), np.zeros(2))
    with pytest.warns(EstimateWarning, match="reading is not finite"):
        state = estimator.update(state, np.array([[np.nan, 0.0, 0.0], [0.0, 0.0, 0.0]]), calm)
    for bad in (np.inf, -1e300):  # not said again: pytest would turn that into an error
        state = estimator.update(state, np.array([[bad, 0.0, 0.0], [0.0, 0.0, 0.0]]), calm)
    with pytest.warns(EstimateWarning, match="command is not finite"):
        state = estimator.update(state, np.zeros((2, 3)), Command(np.array([np.nan, 0.0]), np.array([np.inf, 0.0])))
    assert np.isfinite(state).all()
    assert np.abs(estimator.observation(state)).max() < 0.01


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(values=arrays(np.float64, (3, 5), elements=st.floats(allow_nan=True, allow_infinity=True)))
@pytest.mark.filterwarnings("ignore::dipc_gym.estimators.EstimateWarning")
@pytest.mark.parametrize("name", NAMES)
def test_whatever_comes_in_what_goes_out_is_finite_and_within_the_motor(made, rig, name, values):
    estimator = made[name]
    state = estimator.initial_state(np.zeros((1, 6)))
    for row in values:
        state = estimator.update(state, row[None, :3], Command(row[3:4], row[4:]))
        assert np.isfinite(estimator.observation(state)).all()
        if estimator.observes_friction:
            assert np.abs(estimator.friction(state)) <= rig.largest_force


@pytest.mark.filterwarnings("ignore::dipc_gym.estimators.EstimateWarning")
@pytest.mark.parametrize("bad", [math.nan, math.inf, 1e300])
@pytest.mark.parametrize("name", NAMES)
def test_garbage_of_one_rig_is_its_own_and_passes(made, rig, name, bad):
    """Readings and commands of the second of three rigs are garbage for a while; soon it sees what it would have."""
    estimator, rng = replace(made[name]), np.random.default_rng(5)
    force, read = rng.normal(0, 2, (400, 3)), np.zeros((400, 3, 3))
    states = [estimator.initial_state(np.zeros((3, 6))) for _ in range(2)]
    long = 80 if name == "moving_horizon" else 400  # slow, and forgets what is older than its horizon
    for k in range(long):
        for struck in (0, 1):
            command, seen = force[k].copy(), read[k].copy()
            if struck and 20 <= k < 23:
                command[1], seen[1] = bad, bad
            volts = np.clip(command / rig.newtons_per_volt, -rig.supply, rig.supply) if np.isfinite(bad) else command
            states[struck] = estimator.update(states[struck], seen, Command(command, volts))
            assert np.isfinite(states[struck]).all()
        np.testing.assert_array_equal(states[0][[0, 2]], states[1][[0, 2]])
    seen, missed = (estimator.observation(state)[1] for state in states)
    np.testing.assert_allclose(missed, seen, atol=1e-3)


# Files


@pytest.mark.parametrize("name", NAMES)
def test_a_file_brings_everything_back_to_the_last_bit(made, name, tmp_path):
    path = tmp_path / "mine.json"
    estimators.save(made[name], path)
    back = estimators.load(path)
    assert back == made[name] == pickle.loads(pickle.dumps(made[name]))
    assert back.to_dict() == made[name].to_dict()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d.update(kind="kalmann"), "kind: is 'kalmann'; there are differences, kalman"),
        (lambda d: d.update(schema="dipc-gym/estimator/2"), "schema"),
        (lambda d: d["rig"].pop("period"), "rig.period"),
        (lambda d: d["rig"].update(period=-1.0), "period is -1.0; it must be from 0.0001 to 1 s"),
        (lambda d: d["rig"].update(pole_step=1e300), r"pole_step is 1e\+300; it must be from 1e-09 to 1 rad"),
        (lambda d: d["rig"]["B"].__setitem__(3, 1e300), r"RigModel.B must be \(6,\) numbers of 1e\+10 at most"),
        (lambda d: d["rig"]["A"][2].pop(), r"rig.A\[2\].*has 5 entries"),
        (lambda d: d["rig"]["B"].__setitem__(3, math.nan), r"rig.B\[3\]"),
        (lambda d: d["friction"].update(coulomb="8"), "friction.coulomb"),
        (lambda d: d["friction"].update(static=1.0), "friction.static is 1 N, below"),
        (lambda d: d.update(note=1), "note"),
    ],
)
def test_a_broken_file_is_refused_with_its_field(made, tmp_path, change, message):
    data = json.loads(json.dumps(made["kalman"].to_dict()))
    change(data)
    path = tmp_path / "broken.json"
    path.write_text(json.dumps(data))
    with pytest.raises(EstimatorError, match=f"(?s)broken.json.*{message}"):
        estimators.load(path)


def test_a_rig_that_cannot_be_filtered_is_refused(rig):
    with pytest.raises(ValueError, match=r"too fast for a control period of 0.005 s"):
        replace(rig, A=((1e6,) * 6,) * 6)
    blind = np.zeros((6, 6))  # an unstable rate that no encoder sees
    blind[5, 5] = 1.0
    with pytest.raises(ValueError, match="no Kalman filter"):
        estimators.Kalman(replace(rig, A=tuple(map(tuple, blind.tolist()))), DRY)


def test_an_unknown_name_lists_what_there_is():
    samples = Samples(*np.zeros((4, 4)), np.array([True, True, False, False]))
    constants = compensators.RigConstants(4.0, 40.0, 24.0)
    with pytest.raises(ValueError, match="no estimator 'luenberger'; there are differences, kalman"):
        estimators.fit("luenberger", samples, constants, None)
