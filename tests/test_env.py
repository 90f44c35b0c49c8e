"""The environment: conventions, determinism, sensing, and what is refused."""

from __future__ import annotations

import copy
import json
import math
import os
import pickle
import subprocess
import sys
import warnings
from collections.abc import Iterator
from importlib import resources
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env, data_equivalence
from hypothesis import given
from hypothesis import strategies as st

import dipc_gym
from dipc_gym import kernels
from dipc_gym.controllers.lqr import PRINTED_GAIN
from dipc_gym.env import DoublePendulumEnv
from dipc_gym.mjcf import MjcfError
from dipc_gym.plant import Encoders, Friction, Plant, PlantError

RIG = resources.files("dipc_gym").joinpath("rig.xml").read_text()
# What Gymnasium's own test suite lets its environments say.
ALLOWED = (
    "A Box observation space minimum value is -infinity",
    "A Box observation space maximum value is infinity",
    "we recommend using a symmetric and normalized space",
    "We recommend you to use a symmetric and normalized Box action space",
)


def make(**kwargs: Any) -> DoublePendulumEnv:
    env = gymnasium.make(dipc_gym.ENV_ID, **kwargs).unwrapped
    assert isinstance(env, DoublePendulumEnv)
    return env


def driven(env: Any, actions: np.ndarray) -> Iterator[Any]:
    """Step by step, so that the environment can be looked at in between."""
    for action in actions:
        yield env.step(action)


def rollout(env: Any, actions: np.ndarray) -> list[Any]:
    return list(driven(env, actions))


@pytest.fixture
def actions() -> np.ndarray:
    return np.random.default_rng(0).uniform(-6, 6, (60, 1)).astype(np.float32)


@pytest.fixture
def only_allowed_warnings() -> Iterator[None]:
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        yield
    for warning in said:
        assert any(text in str(warning.message) for text in ALLOWED), warning.message


@pytest.mark.parametrize("kwargs", [{}, {"plant": {"encoders": {"noise": 0.5}}}, {"exact_state": True}])
@pytest.mark.usefixtures("only_allowed_warnings")
def test_gymnasium_finds_no_fault(kwargs: dict[str, Any]) -> None:
    check_env(make(**kwargs), skip_render_check=True)


@pytest.mark.usefixtures("only_allowed_warnings")
def test_stable_baselines3_finds_no_fault() -> None:
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    checker.check_env(make())


@pytest.mark.parametrize("noise", [0.0, 0.5])
def test_same_seed_same_bits(noise: float, actions: np.ndarray) -> None:
    plant = {"encoders": {"noise": noise}}
    a, b = gymnasium.make(dipc_gym.ENV_ID, plant=plant), gymnasium.make(dipc_gym.ENV_ID, plant=plant)
    a.reset(seed=1)
    rollout(a, actions)
    first, second = a.reset(seed=7), b.reset(seed=7)
    assert data_equivalence(first, second, exact=True)
    assert data_equivalence(rollout(a, actions), rollout(b, actions), exact=True)
    assert not np.array_equal(a.reset(seed=8)[0], first[0])


@pytest.mark.parametrize("clone", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
def test_a_copy_goes_on_bit_for_bit(clone: Any, actions: np.ndarray) -> None:
    env = gymnasium.make(dipc_gym.ENV_ID, plant={"encoders": {"noise": 0.5}}, exact_state=False)
    env.reset(seed=3)
    rollout(env, actions[:30])
    twin = clone(env)
    assert twin.unwrapped.plant == env.unwrapped.plant  # type: ignore[attr-defined]
    assert data_equivalence(rollout(env, actions[30:]), rollout(twin, actions[30:]), exact=True)
    assert data_equivalence(env.reset(), twin.reset(), exact=True)


def test_a_copy_lives_on_its_own(actions: np.ndarray) -> None:
    env = make()
    env.reset(seed=3)
    twin = copy.deepcopy(env)
    before = twin.state
    rollout(env, actions)
    np.testing.assert_array_equal(twin.state, before)


def test_spec_goes_through_json() -> None:
    plant = Plant(friction=Friction(coulomb=5.0, static=6.0))
    for given_plant in (plant, plant.to_dict(), {"supply": 12.0}):
        spec = gymnasium.make(dipc_gym.ENV_ID, plant=given_plant, exact_state=True).spec
        assert spec is not None
        again = gymnasium.make(type(spec).from_json(spec.to_json()))
        inner = again.unwrapped
        assert isinstance(inner, DoublePendulumEnv)
        assert inner.plant == Plant.of(given_plant)
        assert inner.exact_state


def test_time_limit() -> None:
    assert gymnasium.spec(dipc_gym.ENV_ID).max_episode_steps == 2_000
    env = gymnasium.make(dipc_gym.ENV_ID, max_episode_steps=3)
    env.reset(seed=0)
    assert [step[3] for step in rollout(env, np.zeros((3, 1)))] == [False, False, True]


def test_start_is_random_and_near_upright() -> None:
    env = make(exact_state=True)
    initial = np.array([env.reset(seed=seed)[0] for seed in range(50)])
    assert (np.abs(initial[:, :3]) <= 0.02).all()
    assert (np.ptp(initial[:, :3], axis=0) > 0.03).all()
    assert not initial[:, 3:].any()


def test_no_observation_stands_still() -> None:
    env = make()
    env.reset(seed=0)
    seen = np.array([step[0] for step in rollout(env, 3 * np.ones((40, 1)))])
    assert (np.ptp(seen, axis=0) > 0).all()


def test_hanging_start_does_not_fall() -> None:
    env = make(exact_state=True)
    observation, _ = env.reset(seed=0, options={"start": "hanging"})
    assert (np.abs(observation[1:3] - np.pi) <= 0.02).all()
    steps = rollout(env, np.zeros((100, 1)))
    assert not any(step[2] for step in steps)
    assert steps[-1][1] < -30  # far from upright costs


def test_state_option_sets_exactly_this_state() -> None:
    env = make(exact_state=True)
    wanted = np.array([0.1, 0.2, -0.1, 0.3, -0.4, 0.5])
    observation, _ = env.reset(options={"state": wanted})
    np.testing.assert_array_equal(observation, wanted)
    np.testing.assert_allclose(env.state, wanted, atol=1e-15)


@pytest.mark.parametrize("plant", [{"supply": 48.0}, {"control_period": 0.01}])
def test_spaces_and_rhythm_stay_for_all_episodes(plant: dict[str, float]) -> None:
    env = make()
    with pytest.raises(PlantError, match="cannot change supply or control_period"):
        env.reset(seed=0, options={"plant": plant})
    env.reset(seed=0)
    assert env.plant == Plant()


def test_plant_option_holds_for_one_episode() -> None:
    env = make()
    env.reset(seed=0, options={"plant": {"friction": {"coulomb": 1.0, "static": 2.0}}})
    assert env.plant.friction == Friction(coulomb=1.0, static=2.0)
    env.reset(seed=0)
    assert env.plant == Plant()


@pytest.mark.parametrize(
    "options", [{"speed": 1}, {"start": "sideways"}, {"state": [0.0] * 5}, {"state": [math.nan] * 6}, {"state": "up"}]
)
def test_unknown_options_are_refused(options: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match="options"):
        make().reset(options=options)
    with pytest.raises(ValueError, match="not both"):
        make().reset(options={"start": "upright", "state": [0.0] * 6})


@pytest.mark.parametrize(("options", "meant"), [({"strat": "hanging"}, "start"), ({"start": "hangng"}, "hanging")])
def test_slips_in_options_are_told_what_was_meant(options: dict[str, Any], meant: str) -> None:
    for env in (make(), gymnasium.make_vec(dipc_gym.ENV_ID, num_envs=2, vectorization_mode="vector_entry_point")):
        with pytest.raises(ValueError, match=f"did you mean '{meant}'"):
            env.reset(options=options)
        env.close()


@pytest.mark.parametrize(
    "action", [[math.nan], [math.inf], [], [1.0, 2.0], 3.0, None, "x", np.zeros((1, 1, 2)), np.zeros((2, 1))]
)
def test_wrong_actions_are_refused_and_change_nothing(action: Any) -> None:
    env = make()
    env.reset(seed=0)
    before = env.state
    with pytest.raises(ValueError, match=r"voltage"):
        env.step(action)
    np.testing.assert_array_equal(env.state, before)


def test_actions_beyond_the_supply_are_clipped_and_told() -> None:
    env, limit = make(), make()
    env.reset(seed=0)
    limit.reset(seed=0)
    for sign in (1.0, -1.0):
        beyond, at = env.step(np.array([sign * 100.0])), limit.step(np.array([sign * 24.0]))
        assert beyond[4]["clipped"]
        assert not at[4]["clipped"]
        assert beyond[4]["voltage"] == at[4]["voltage"] == sign * 24.0
        np.testing.assert_array_equal(beyond[0], at[0])


def test_same_info_keys_at_every_step() -> None:
    env = make()
    _, info = env.reset(seed=0)
    for step in rollout(env, 24 * np.ones((100, 1))):
        assert step[4].keys() == info.keys()


def test_reward_is_one_minus_its_terms() -> None:
    env = make(exact_state=True)
    env.reset(options={"state": [0.2, 0.1, -0.2, 0, 0, 0]})
    observation, reward, _, _, info = env.step(np.array([6.0]))
    expected = [0.25 * (observation[i] / limit) ** 2 for i, limit in ((0, 0.45), (1, 0.35), (2, 0.35))]
    terms = [info["cost_cart"], info["cost_pole1"], info["cost_pole2"]]
    np.testing.assert_allclose(terms, expected)
    assert info["cost_voltage"] == pytest.approx(0.25 * 0.25**2)
    assert reward == pytest.approx(info["reward_survive"] - sum(terms) - info["cost_voltage"])


def test_episode_ends_at_the_rail_and_when_a_pole_falls() -> None:
    env = make(exact_state=True)
    env.reset(options={"state": [0.4, math.pi, math.pi, 0, 0, 0]})
    steps = rollout(env, 24 * np.ones((200, 1)))
    end = next(i for i, step in enumerate(steps) if step[2])
    assert 0.45 <= steps[end][0][0] < 0.46
    env.reset(seed=0)
    steps = rollout(env, np.zeros((600, 1)))
    end = next(i for i, step in enumerate(steps) if step[2])
    assert 0.35 < np.abs(steps[end][0][1:3]).max() < 0.45


def test_printed_gain_balances_with_encoders_and_friction() -> None:
    env = make()
    observation, _ = env.reset(seed=0)
    for _ in range(2_000):
        observation, _, terminated, _, _ = env.step(np.array([-PRINTED_GAIN @ observation / 4.0]))
        assert not terminated


def test_control_period_is_apart_from_the_physics_step(actions: np.ndarray) -> None:
    slow, fast = make(plant={"control_period": 0.01}, exact_state=True), make(exact_state=True)
    assert slow.metadata["render_fps"] == 100
    slow.reset(seed=0)
    fast.reset(seed=0)
    for action in actions[:20]:
        fast.step(action)
        np.testing.assert_array_equal(slow.step(action)[0], fast.step(action)[0])
    with pytest.raises(PlantError, match="whole number of physics steps"):
        make(plant={"control_period": 0.0015})


# ------------------------------------------------------------------------------------------------ sensing


def test_encoders_read_whole_counts() -> None:
    env = make()
    encoders = Encoders()
    env.reset(seed=0)
    for step in driven(env, 4 * np.ones((50, 1))):
        x, theta1, theta2 = step[0][:3]
        for reading, count in ((x, encoders.cart), (theta1, encoders.pole), (theta2 - theta1, encoders.pole)):
            assert reading / count == pytest.approx(round(reading / count), abs=1e-9)
        np.testing.assert_allclose(step[0][:3], env.state[:3], atol=encoders.pole + 1e-12)


def test_velocity_is_the_filtered_difference() -> None:
    env = make()
    before, _ = env.reset(seed=0)
    estimate = np.zeros(3)
    a = math.exp(-0.005 / 0.01)
    for step in rollout(env, 4 * np.ones((50, 1))):
        estimate = a * estimate + (1 - a) * (step[0][:3] - before[:3]) / 0.005
        before = step[0]
        np.testing.assert_allclose(step[0][3:], estimate, rtol=1e-9, atol=1e-9)


def test_noise_has_the_declared_size() -> None:
    env = make(plant={"encoders": {"noise": 3.0}})
    env.reset(options={"state": [0.0, math.pi, math.pi, 0, 0, 0]})
    readings = np.array([env.encoders for _ in driven(env, np.zeros((2_000, 1)))])
    counts = readings - np.array([0.0, math.pi, 0.0])
    std = counts.std(axis=0) / [Encoders().cart, Encoders().pole, Encoders().pole]
    # Rounding adds 1/12 of a count squared; 2,000 samples know a standard deviation to 1.6 %.
    np.testing.assert_allclose(std, math.sqrt(9 + 1 / 12), rtol=0.1)


values = st.floats(-100, 100, allow_subnormal=False)


@given(st.lists(st.tuples(*[values] * 4), min_size=1, max_size=20), st.floats(1e-5, 1e-1))
def test_kernels_give_numbers_and_arrays_the_same_bits(rows: list[tuple[float, ...]], step: float) -> None:
    a, b, c, d = (np.array(column) for column in zip(*rows, strict=True))
    many = [
        kernels.quantise(a, step),
        kernels.velocity(a, b, c, 0.6, step),
        *kernels.costs(a, b, c, d, 0.45, 24.0),
    ]
    single = [
        [
            kernels.quantise(row[0], step),
            kernels.velocity(row[0], row[1], row[2], 0.6, step),
            *kernels.costs(row[0], row[1], row[2], row[3], 0.45, 24.0),
        ]
        for row in rows
    ]
    assert np.array(many).T.tobytes() == np.array(single).tobytes()


# ------------------------------------------------------------------------------------- what goes wrong


def test_a_diverging_simulation_ends_the_episode(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    env = make(exact_state=True)
    start = [0.0, 0.0, 0.0, 0.0, 1e4, -1e4]  # two turns a step: no integrator follows that
    env.reset(options={"state": start})
    observation, reward, terminated, _, info = env.step(np.zeros(1))
    assert info["diverged"]
    assert terminated
    assert reward == 0.0
    np.testing.assert_array_equal(observation, start)  # the last finite one
    assert all(math.isfinite(value) for value in info.values())
    observation, info = env.reset(seed=0)
    assert np.isfinite(observation).all()
    assert not info["diverged"]
    assert not list(tmp_path.iterdir())  # no MUJOCO_LOG.TXT


def own_model(folder: Path, *changes: tuple[str, str]) -> Path:
    text = RIG
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    file = folder / "own.xml"
    file.write_text(text)
    return file


def test_own_model_keeps_its_physics(tmp_path: Path) -> None:
    file = own_model(tmp_path, ('lugre="2e4 60 8 11 0.02"', 'lugre="1e4 50 3 4 0.01"'), ('"-24 24"', '"-12 12"'))
    env = make(model=str(file))
    assert env.plant.friction == Friction(
        coulomb=3.0, static=4.0, stribeck_velocity=0.01, bristle_stiffness=1e4, bristle_damping=50.0
    )
    assert env.action_space.high == 12.0  # type: ignore[attr-defined]
    assert make(model=str(file), plant={"supply": 6.0}).plant.friction == env.plant.friction


def test_own_model_keeps_what_a_plant_knows_nothing_of(tmp_path: Path) -> None:
    """Damping that grows with speed or stands in a default class, and a motor that drives and brakes differently."""
    file = own_model(
        tmp_path,
        (' damping="20.8"', ""),
        ("<worldbody>", '<default><joint damping="20.8 5 0"/></default><worldbody>'),
        ('motorconst="0.06"', 'motorconst="0.06 0.05"'),
    )
    for plant in ({}, {"motor": {"resistance": 1.3}, "friction": {"coulomb": 7.0}}):
        env = make(model=str(file), plant=plant)
        cart, motor = env.model.joint("cart"), env.model.actuator("motor")
        assert (cart.damping[0], cart.dampingpoly[0, 0]) == (20.8, 5.0)
        assert motor.gainprm[1] == pytest.approx(math.sqrt(0.06 * 0.05))
        assert env.plant.motor.constant == pytest.approx(math.sqrt(0.06 * 0.05))


def test_own_model_with_frictionloss_reports_its_friction(tmp_path: Path) -> None:
    file = own_model(
        tmp_path,
        (' lugre="2e4 60 8 11 0.02"', ""),
        ('damping="20.8"', 'damping="20.8" frictionloss="6"'),
    )
    env = make(model=str(file))
    assert env.plant.friction is None
    env.reset(seed=0, options={"start": "hanging"})
    step = rollout(env, 6 * np.ones((30, 1)))[-1]
    assert step[4]["friction"] == pytest.approx(-6.0, rel=0.01)


def test_own_model_with_physics_that_mjcf_cannot_say(tmp_path: Path) -> None:
    extras = (
        '<custom><numeric name="dipc_gym:motor.deadzone:motor" data="2.0"/>'
        '<numeric name="dipc_gym:sensor.bias:pole1" data="0.1"/></custom>'
    )
    env = make(model=str(own_model(tmp_path, ("<sensor>", extras + "<sensor>"))))
    env.reset(options={"state": [0.0, math.pi, math.pi, 0, 0, 0]})
    step = rollout(env, 1.9 * np.ones((100, 1)))[-1]
    assert abs(step[0][0]) < 1e-4  # the dead zone swallows the command
    assert step[0][1] == pytest.approx(math.pi + 0.1, abs=1e-3)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (('name="motor" joint', 'name="engine" joint'), r"\.xml: no actuator 'motor' .*'engine'"),
        (('<jointpos name="pole2"', '<jointvel name="pole2"'), "jointpos name='pole2'"),
        (('<jointpos name="cart" joint="cart"/>', ""), "jointpos name='cart'"),
        (('joint="cart" gear', 'joint="carriage" gear'), "carriage"),
        (("<asset>", '<include file="../secret.xml"/><asset>'), "leads out of"),
        (('range="-0.45 0.45"', 'range="0 0.9"'), r"\.xml: joint 'cart' has range 0 to 0.9"),
        (('gear="80"', 'gear="-80"'), r"\.xml: <dcmotor name='motor'>: gear is -80"),
        (('lugre="2e4 60 8 11 0.02"', 'lugre="2e4 60 8 11"'), r"\.xml: <dcmotor name='friction'>: lugre has 4"),
    ],
)
def test_unusable_models_are_refused(change: tuple[str, str], says: str, tmp_path: Path) -> None:
    with pytest.raises((MjcfError, PlantError), match=says):
        make(model=str(own_model(tmp_path, change)))
    with pytest.raises(MjcfError, match="no such model file"):
        make(model=str(tmp_path / "none.xml"))


def test_unknown_render_mode_is_refused() -> None:
    with pytest.raises(ValueError, match="render_mode"):
        DoublePendulumEnv(render_mode="ascii")


# ------------------------------------------------------------------------------------------------ drawing

DRAW = """
import gymnasium, dipc_gym, numpy as np
pictures = []
for camera in ("side", "follow"):
    env = gymnasium.make("DIPC-Friction-v0", render_mode="rgb_array", width=96, height=72, camera=camera)
    env.reset(options={"state": [0.2, 0.3, -0.3, 0, 0, 0]})
    pictures.append(env.render())
    env.reset(options={"state": [-0.2, -0.3, 0.3, 0, 0, 0], "plant": {"delay": 0.004}})
    pictures.append(env.render())
    env.close()
for engine in ("mujoco", "compiled"):
    env = gymnasium.make("DIPC-Friction-v0", render_mode="rgb_array", width=96, height=72, engine=engine)
    env.reset(options={"state": [-0.3, 0, 0, 0, 0, 0]})
    frames = [env.render()]
    for _ in range(60):
        env.step([12.0])
    frames.append(env.render())
    assert (frames[0] != frames[1]).sum() > 100, f"{engine} draws one picture for ever"
    pictures += frames
    env.close()
for picture in pictures:
    assert picture.shape == (72, 96, 3) and picture.dtype == np.uint8 and picture.std() > 5
assert (pictures[0] != pictures[1]).any() and (pictures[0] != pictures[2]).any()
print("drawn")
"""


def test_draws_without_a_display() -> None:
    hidden = ("DISPLAY", "WAYLAND_DISPLAY", "MUJOCO_GL")
    environment = {key: value for key, value in os.environ.items() if key not in hidden}
    done = subprocess.run([sys.executable, "-c", DRAW], env=environment, capture_output=True, text=True, check=False)
    if "drawn" not in done.stdout and not any(_has_library(name) for name in ("libEGL.so.1", "libOSMesa.so.8")):
        pytest.skip("this machine has neither EGL nor OSMesa; apt install libegl1 or libosmesa6")
    assert "drawn" in done.stdout, done.stderr


def _has_library(name: str) -> bool:
    import ctypes

    try:
        ctypes.CDLL(name)
    except OSError:
        return False
    return True


def test_users_choice_of_renderer_is_kept() -> None:
    code = (
        "import os; from dipc_gym.drawing.viewer import choose_renderer; "
        "choose_renderer(); print(os.environ.get('MUJOCO_GL'))"
    )
    for given_variables, kept in (({"MUJOCO_GL": "disabled"}, "disabled"), ({"DISPLAY": ":7"}, "None")):
        environment = {k: v for k, v in os.environ.items() if k not in ("DISPLAY", "WAYLAND_DISPLAY", "MUJOCO_GL")}
        done = subprocess.run(
            [sys.executable, "-c", code], env=environment | given_variables, capture_output=True, text=True, check=True
        )
        assert done.stdout.strip() == kept


def test_render_without_a_mode_says_so() -> None:
    with pytest.warns(UserWarning, match="render mode"):
        assert make().render() is None


def test_the_page_tells_what_info_holds() -> None:
    _, info = make().reset(seed=0)
    page = DoublePendulumEnv.__doc__ or ""
    for key in info:
        assert key in page or key.startswith("cost_"), key
    json.dumps(info)


def test_stand_ins_for_passive_forces_are_not_commanded(tmp_path: Path) -> None:
    stand_in = '<general name="drag" joint="cart" gainprm="1" biastype="affine" biasprm="0 0 -5"/></actuator>'
    extras = (
        '<custom><text name="dipc_gym:passive:drag" data="drag"/>'
        '<numeric name="dipc_gym:motor.deadzone:motor" data="0.1"/></custom>'
    )
    env = make(model=str(own_model(tmp_path, ("</actuator>", stand_in), ("<sensor>", extras + "<sensor>"))))
    env.reset(options={"state": [0.0, math.pi, math.pi, 0.5, 0, 0]})
    env.step(np.array([6.0]))
    speed = env.state[3]
    # Dry friction as the motor does not command it: LuGre's Coulomb level and the stand-in's drag.
    assert env.friction == pytest.approx(-8.0 - 5.0 * speed, rel=0.05)


def test_a_rotor_behind_a_soft_belt_starts_where_the_cart_does(tmp_path: Path) -> None:
    """What `improved.xml` adds to a rig has to begin with it, or it is flung across the rail."""
    from dipc_gym.mjcf.edit import Document
    from dipc_gym.sim2real.effects import catalogue

    document = Document(DoublePendulumEnv().source)
    belt = {"stiffness": 2e4, "damping": 5.0, "rotor_inertia": 0.2}
    effect = catalogue()["transmission.compliance"]
    effect.edit(document, "motor", {p.name: belt[p.name] for p in effect.parameters})
    model = tmp_path / "improved.xml"
    model.write_text(document.text(), encoding="utf-8")
    start = {"state": [0.2, 0.0, 0.0, 0.1, 0.0, 0.0]}
    single = DoublePendulumEnv(model=model, exact_state=True)
    many = gymnasium.make_vec(
        "DIPC-Friction-v0", num_envs=2, vectorization_mode="vector_entry_point", model=model, exact_state=True
    )
    single.reset(seed=0, options=start)
    many.reset(seed=0, options=start)
    one, all_of_them = single.step([0.0])[0], many.step(np.zeros((2, 1)))[0]
    assert abs(one[3]) < 0.15
    assert np.array_equal(all_of_them, [one, one])


def test_a_model_in_which_something_follows_no_joint_is_refused(tmp_path: Path) -> None:
    text = DoublePendulumEnv().source.text
    model = tmp_path / "rig.xml"
    entry = '<custom><text name="dipc_gym:follows:rotor" data="cart"/></custom></mujoco>'
    model.write_text(text.replace("</mujoco>", entry), encoding="utf-8")
    with pytest.raises(MjcfError, match="no 'rotor' among the joints"):
        DoublePendulumEnv(model=model)


@pytest.mark.parametrize("part", ["actuator", "option", "two options"])
def test_a_plant_is_written_into_a_model_of_several_parts(part: str, tmp_path: Path) -> None:
    """Its actuators and its time step may stand in an include, and of two options the last one holds."""
    text = DoublePendulumEnv().source.text
    model = tmp_path / "rig.xml"
    if part == "two options":
        model.write_text(text.replace("<option timestep", '<option timestep="0.01"/>\n  <option timestep'))
    else:
        section = text[text.index(f"<{part}") : text.index(f"</{part}>")] + f"</{part}>"
        (tmp_path / "part.xml").write_text(f"<mujoco>{section}</mujoco>")
        model.write_text(text.replace(section, '<include file="part.xml"/>'))
    rigs = [DoublePendulumEnv(model=path, plant={"delay": 0.02}) for path in (None, model)]
    for rig in rigs:
        rig.reset(seed=0)
    for _ in range(10):
        np.testing.assert_array_equal(rigs[1].step([5.0])[0], rigs[0].step([5.0])[0])


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"camera": "folow"}, "camera is 'folow'.*did you mean 'follow'"),
        ({"camera": 1}, "camera is 1.*has side, follow"),
        ({"width": 0}, "width is 0; it is a whole number of pixels"),
        ({"height": "a"}, "height is 'a'"),
        ({"width": -3}, "width is -3"),
    ],
)
def test_a_picture_that_cannot_be_drawn_is_refused_at_once(options: dict[str, object], says: str) -> None:
    with pytest.raises(ValueError, match=says):
        gymnasium.make("DIPC-Friction-v0", render_mode="rgb_array", **options)
