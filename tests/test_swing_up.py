"""The swing-up environment: conventions, starts and goals, reward, physics, and many at once."""

from __future__ import annotations

import copy
import math
import pickle
import warnings
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env, data_equivalence
from gymnasium.vector import SyncVectorEnv
from hypothesis import given
from hypothesis import strategies as st
from test_vector import RANDOM, WILD, drive, same

import dipc_gym
from dipc_gym import kernels, postures
from dipc_gym.mechanics.rigid import Rigid
from dipc_gym.swing_up import SwingUpEnv, SwingUpVectorEnv, observed, state_of

ENGINES = ("mujoco", "compiled")
IDEAL = {"friction": {"coulomb": 0.0, "static": 0.0, "viscous": 0.0}, "motor": {"constant": 1e-6}}
"""A cart that nothing brakes, back-EMF included."""


def make(**kwargs: Any) -> SwingUpEnv:
    env = gymnasium.make(dipc_gym.SWING_UP_ID, **kwargs).unwrapped
    assert isinstance(env, SwingUpEnv)
    return env


def batched(num_envs: int = 5, **kwargs: Any) -> SwingUpVectorEnv:
    env = gymnasium.make_vec(dipc_gym.SWING_UP_ID, num_envs, "vector_entry_point", **kwargs).unwrapped
    assert isinstance(env, SwingUpVectorEnv)
    return env


def rollout(env: Any, actions: np.ndarray) -> list[Any]:
    return [env.step(action) for action in actions]


@pytest.mark.parametrize("kwargs", [{}, {"start": "anywhere", "goal": "up-down"}, {"exact_state": True}])
def test_checkers_find_no_fault(kwargs: dict[str, Any]) -> None:
    with warnings.catch_warnings():
        for said in (
            ".*space minimum value is -inf",
            ".*space maximum value is inf",
            ".*symmetric and normalized",
        ):
            warnings.filterwarnings("ignore", said)
        check_env(make(**kwargs), skip_render_check=True)
        pytest.importorskip("stable_baselines3.common.env_checker").check_env(make(**kwargs))


@pytest.mark.parametrize("engine", ENGINES)
def test_same_seed_same_bits(engine: str) -> None:
    actions = np.random.default_rng(0).uniform(-24, 24, (60, 1))
    kwargs = {"engine": engine, "plant": {"encoders": {"noise": 0.5}}, "start": "anywhere"}
    a, b = make(**kwargs), make(**kwargs)
    assert data_equivalence(a.reset(seed=3), b.reset(seed=3), exact=True)
    assert data_equivalence(rollout(a, actions[:30]), rollout(b, actions[:30]), exact=True)
    for twin in (copy.deepcopy(a), pickle.loads(pickle.dumps(a))):
        before = copy.deepcopy(b)
        assert data_equivalence(rollout(twin, actions[30:]), rollout(before, actions[30:]), exact=True)
    assert not np.array_equal(a.reset(seed=4)[0], b.reset(seed=5)[0])


def test_arguments_are_checked_and_recorded() -> None:
    spec = gymnasium.make(dipc_gym.SWING_UP_ID, goal="up-down", start="down-up").spec
    assert spec is not None
    again = gymnasium.make(type(spec).from_json(spec.to_json())).unwrapped
    assert isinstance(again, SwingUpEnv)
    assert (again.goal, again.start) == ("up-down", "down-up")
    for wrong in ({"goal": "up"}, {"goal": "anywhere"}, {"goal": None}, {"start": "hanging"}, {"start": 3}):
        for maker in (make, batched):
            with pytest.raises(ValueError, match="first pole first"):
                maker(**wrong)
    with pytest.raises(ValueError, match="did you mean 'up-up'"):
        make(goal="upup")
    with pytest.raises(ValueError, match=r"options\['start'\]"):
        make().reset(options={"start": "upright"})
    with pytest.raises(ValueError, match="not both"):
        make().reset(options={"start": "up-up", "state": [0.0] * 6})
    with pytest.raises(ValueError, match="no task has the tag 'up'"):
        postures.tagged("up")


@pytest.mark.parametrize("name", postures.TASKS)
def test_every_task_starts_where_it_says_and_knows_its_goal(name: str) -> None:
    task = postures.TASKS[name]
    env = make(**task.arguments, exact_state=True)
    starts = np.array([env.reset(seed=seed)[0] for seed in range(30)])
    up = np.array([1.0 if p else -1.0 for p in postures.POSTURES[task.start]])
    np.testing.assert_allclose(starts[:, [1, 3]], np.tile(up, (30, 1)), atol=0.02**2)
    assert (np.abs(starts[:, [0, 2, 4]]) <= 0.02 + 1e-12).all()
    assert (np.ptp(starts[:, [0, 2, 4]], axis=0) > 0.03).all()
    assert not starts[:, 5:].any()
    info = env.step([0.0])[4]
    assert info["at_goal"] == ("hold" in task.tags)
    goal = [math.pi * (not p) for p in postures.POSTURES[task.goal]]
    env.reset(options={"state": [0.0, *goal, 0.0, 0.0, 0.0]})
    _, reward, _, _, info = env.step([0.0])
    assert info["at_goal"]
    assert reward == pytest.approx(1.0, abs=1e-4)


def test_tags_cover_all_tasks() -> None:
    tags = ("hold", "swing-up", "swing-down", "swing-across")
    assert [len(postures.tagged(tag)) for tag in tags] == [4, 5, 5, 2]
    assert list(postures.tagged("benchmarking")) == ["down-down to up-up"]


def test_start_anywhere_reaches_everywhere() -> None:
    env = make(start="anywhere", exact_state=True)
    starts = np.array([state_of(env.reset(seed=seed)[0]) for seed in range(200)])
    reach = np.array([0.225, math.pi, math.pi, 0.5, 5.0, 5.0])
    assert (np.abs(starts) <= reach).all()
    assert (np.ptp(starts, axis=0) > 1.8 * reach).all()


@given(st.tuples(*[st.floats(-50, 50)] * 6), st.floats(-24, 24), st.sampled_from(list(postures.POSTURES)))
def test_reward_is_the_sum_of_its_terms_within_bounds(state: Any, volts: float, goal: str) -> None:
    state = (0.45 * state[0] / 50, *state[1:])
    reward, terms, there = postures.earned(state, volts, goal, 0.45, 24.0)
    assert reward == pytest.approx(sum(terms.values()))
    for name, value in terms.items():
        assert -1e-15 <= value <= postures.SHARES[name.removeprefix("reward_")] + 1e-15
    up = [1 if p else -1 for p in postures.POSTURES[goal]]
    off = [math.acos(min(1, max(-1, s * math.cos(a)))) for s, a in zip(up, state[1:3], strict=True)]
    if max(off) < 0.349 or max(off) > 0.351:
        assert there == (max(off) < 0.35)
    turned = (*state[:2], state[2] + 2 * math.pi, *state[3:])
    assert postures.earned(turned, volts, goal, 0.45, 24.0)[0] == pytest.approx(reward, abs=1e-9)


@given(st.floats(-300, 300))
def test_sine_and_cosine_are_the_library_s(angle: float) -> None:
    size = 1 + abs(angle)  # the angle itself is rounded by that much
    assert abs(kernels.sine(angle) - math.sin(angle)) < 4e-16 * size
    assert abs(kernels.cosine(angle) - math.cos(angle)) < 4e-16 * size
    assert kernels.sine(np.array([angle, 1.0]))[0] == kernels.sine(angle)


@given(st.tuples(*[st.floats(-3.1, 3.1)] * 6))
def test_states_come_back_from_observations(state: Any) -> None:
    np.testing.assert_allclose(state_of(observed(np.array(state))), state, atol=1e-14)


def test_info_has_the_same_keys_and_the_reward_its_terms() -> None:
    env = make()
    _, first = env.reset(seed=0)
    for action in 24 * np.sign(np.sin(np.arange(60) / 8))[:, None]:
        _, reward, terminated, _, info = env.step(action)
        assert info.keys() == first.keys()
        assert reward == pytest.approx(sum(info[f"reward_{name}"] for name in postures.SHARES))
        assert not terminated


def test_ends_at_the_rail_and_not_for_a_pole() -> None:
    env = make(start="up-up")
    env.reset(seed=0)
    steps = rollout(env, np.zeros((400, 1)))  # both poles fall
    assert not any(step[2] for step in steps)
    assert max(abs(step[0][2]) for step in steps) > 0.9
    env.reset(seed=0)
    ends = [step[2] for step in rollout(env, 24 * np.ones((200, 1)))]
    assert any(ends)


def test_time_limit() -> None:
    assert gymnasium.spec(dipc_gym.SWING_UP_ID).max_episode_steps == 2_000
    env = gymnasium.make(dipc_gym.SWING_UP_ID, max_episode_steps=3)
    env.reset(seed=0)
    assert [step[3] for step in rollout(env, np.zeros((3, 1)))] == [False, False, True]


def energy(env: SwingUpEnv) -> float:
    """Kinetic and potential, J, worked out from the mass matrix and the heights that the model file gives."""
    x, theta1, theta2, v, w1, w2 = env.state
    rigid = Rigid(env.model, list(env.rig.dofs))
    mass = np.array([rigid.acceleration([x, theta1, theta2 - theta1], [0.0] * 3, force) for force in np.eye(3)])
    free = rigid.acceleration([x, theta1, theta2 - theta1], [0.0] * 3, [0.0] * 3)
    rates = np.array([v, w1, w2 - w1])
    kinetic = 0.5 * rates @ np.linalg.solve((mass - free).T, rates)
    heights = 0.57159 * 0.22 * math.cos(theta1) + 0.128 * (0.4 * math.cos(theta1) + 0.275 * math.cos(theta2))
    return float(kinetic) + 9.81 * heights


@pytest.mark.parametrize("engine", ENGINES)
def test_energy_is_kept_where_nothing_takes_it(engine: str) -> None:
    env = make(plant=IDEAL, exact_state=True, engine=engine)
    env.reset(options={"state": [0.0, 2.0, 2.5, 0.0, 0.0, 0.0]})
    before, most = energy(env), 0.0
    for _ in range(200):
        env.step([0.0])
        most = max(most, abs(energy(env) - before))
    assert most < (0.02 if engine == "mujoco" else 1e-3)  # of 2.6 J; MuJoCo's integrator is of first order


def test_friction_takes_energy_and_gives_none_back() -> None:
    env = make(exact_state=True, start="up-up", goal="down-down")
    env.reset(seed=0)
    energies = []
    for _ in range(600):
        env.step([0.0])
        energies.append(energy(env))
    assert energies[-1] < energies[0] - 0.1
    assert max(np.diff(energies)) < 5e-3  # what the bristle had stored, and the integrator of first order adds


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("mode", ["NextStep", "SameStep", "Disabled"])
@pytest.mark.parametrize("plant", [None, {"encoders": {"noise": 0.5}}, RANDOM], ids=["home", "noise", "random"])
def test_many_equal_single_ones_to_the_last_bit(mode: str, plant: Any, engine: str) -> None:
    kwargs = {"plant": plant, "engine": engine, "max_episode_steps": 25, "start": "anywhere", "goal": "up-down"}
    theirs = SyncVectorEnv(
        [lambda: gymnasium.make(dipc_gym.SWING_UP_ID, **kwargs) for _ in range(5)], autoreset_mode=mode
    )
    towards_the_stop = {"state": [0.42, 3.0, 3.1, 2.0, 0.0, 0.0]}
    seen = drive(batched(autoreset_mode=mode, **kwargs), theirs, mode, 60, 100.0, options=towards_the_stop)
    assert seen["truncated"] >= 5
    assert seen["terminated"] > 2


@pytest.mark.parametrize("engine", ENGINES)
def test_many_equal_single_ones_where_simulations_diverge(engine: str) -> None:
    kwargs = {"exact_state": True, "engine": engine}
    theirs = SyncVectorEnv([lambda: gymnasium.make(dipc_gym.SWING_UP_ID, **kwargs) for _ in range(5)])
    assert drive(batched(**kwargs), theirs, "NextStep", 20, options={"state": WILD})["diverged"] == 5


def test_vector_options_reach_the_rows_that_are_asked() -> None:
    env = batched(3)
    env.reset(seed=0)
    mask = np.array([False, True, False])
    observations, _ = env.reset(options={"reset_mask": mask, "start": "up-down"})
    np.testing.assert_allclose(observations[:, 1], [-1, 1, -1], atol=1e-3)
    assert not same(observations[0], observations[1])
