"""The vector environment under stable-baselines3."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest

import dipc_gym
from dipc_gym import controllers
from dipc_gym.compensators import StaticGain
from dipc_gym.wrappers import VectorForceCommand

pytest.importorskip("stable_baselines3")

from stable_baselines3 import PPO, SAC
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.vec_env import DummyVecEnv, VecMonitor, VecNormalize

from dipc_gym.sb3 import DIPCFrictionVecEnv, load_statistics, save_statistics

N = 4


def batch(mode: str = "SameStep", n: int = N, **kwargs: Any) -> Any:
    return gymnasium.make_vec(
        dipc_gym.ENV_ID, num_envs=n, vectorization_mode="vector_entry_point", autoreset_mode=mode, **kwargs
    )


def test_equals_stable_baselines3s_own_vector_environment() -> None:
    kwargs = {"max_episode_steps": 30, "plant": {"encoders": {"noise": 0.5}}}
    ours = DIPCFrictionVecEnv(batch(**kwargs))
    theirs = DummyVecEnv([lambda: gymnasium.make(dipc_gym.ENV_ID, **kwargs)] * N)
    for env in (ours, theirs):
        env.seed(5)
    np.testing.assert_array_equal(ours.reset(), theirs.reset())
    rng = np.random.default_rng(0)
    ended = {True: 0, False: 0}
    for _ in range(200):
        actions = rng.choice([-24.0, 24.0], (N, 1)).repeat(1, 0).astype(np.float32) * np.array([[1], [1], [0.1], [0]])
        mine, other = ours.step(actions), theirs.step(actions)
        for a, b in zip(mine[:3], other[:3], strict=True):
            np.testing.assert_array_equal(a, b)
            assert a.dtype == b.dtype or a is mine[0]
        for i in np.flatnonzero(mine[2]):
            np.testing.assert_array_equal(
                mine[3][i].pop("terminal_observation"), other[3][i].pop("terminal_observation")
            )
            assert mine[3][i] == other[3][i]
            ended[mine[3][i]["TimeLimit.truncated"]] += 1
    assert ended[True] > 5


def test_terminations_are_no_truncations() -> None:
    env = DIPCFrictionVecEnv(batch())
    env.reset()
    for _ in range(2_000):
        _, _, done, infos = env.step(np.full((N, 1), 24.0, np.float32))
        if done.any():
            row = int(np.flatnonzero(done)[0])
            assert not infos[row]["TimeLimit.truncated"]
            assert np.abs(infos[row]["terminal_observation"][:3]).max() > 0.3
            return
    pytest.fail("full voltage never ended an episode")


@pytest.mark.parametrize(
    ("algorithm", "settings"),
    [
        (PPO, {"n_steps": 32, "batch_size": 64, "n_epochs": 2}),
        (SAC, {"learning_starts": 40, "batch_size": 32, "train_freq": 8, "buffer_size": 500}),
    ],
)
def test_trains_saves_and_evaluates_with_statistics(algorithm: Any, settings: dict[str, Any], tmp_path: Path) -> None:
    compensator = StaticGain(newtons_per_volt=4.0)
    env = VecNormalize(VecMonitor(DIPCFrictionVecEnv(VectorForceCommand(batch(max_episode_steps=50), compensator))))
    model = algorithm("MlpPolicy", env, seed=0, device="cpu", policy_kwargs={"net_arch": [16]}, **settings)
    before = [weights.clone() for weights in model.policy.parameters()]
    model.learn(256)
    assert model.num_timesteps >= 256
    assert any((a != b).any() for a, b in zip(before, model.policy.parameters(), strict=True))
    assert all(bool(weights.isfinite().all()) for weights in model.policy.parameters())
    assert len(model.ep_info_buffer) >= N  # VecMonitor saw episodes end
    assert {info["l"] for info in model.ep_info_buffer} <= set(range(1, 51))

    model.save(tmp_path / "policy")
    env.training, env.norm_reward = False, False
    again = algorithm.load(tmp_path / "policy", device="cpu")
    observation = env.reset()
    np.testing.assert_array_equal(
        model.predict(observation, deterministic=True)[0], again.predict(observation, deterministic=True)[0]
    )
    reward, _ = evaluate_policy(again, env, n_eval_episodes=N, warn=False)
    assert 0 < reward <= 50

    file = save_statistics(env, tmp_path / "policy.zip")
    plain = DIPCFrictionVecEnv(VectorForceCommand(batch(max_episode_steps=50), compensator))
    restored = load_statistics(plain, tmp_path / "policy.zip")
    raw = np.random.default_rng(0).normal(0.0, 0.3, (50, 6))
    np.testing.assert_array_equal(restored.normalize_obs(raw), env.normalize_obs(raw))
    assert not restored.training
    brain = controllers.load(str(tmp_path / "policy.zip"))
    theirs, _ = again.predict(env.normalize_obs(raw).astype(np.float32), deterministic=True)
    np.testing.assert_allclose([brain.force(row) for row in raw], theirs[:, 0], rtol=1e-4, atol=1e-3)

    text = file.read_text()
    for broken, says in (("[1]", "top level"), (text.replace('"count"', '"cuont"'), "cuont"), (text[:40], "not JSON")):
        file.write_text(broken)
        with pytest.raises(controllers.ControllerError, match=says):
            controllers.load(str(tmp_path / "policy.zip"))
    with pytest.raises(ValueError, match="nothing to save"):
        save_statistics(VecNormalize(plain, norm_obs=False), tmp_path / "policy.zip")


def test_attributes_and_methods() -> None:
    wrapped = VectorForceCommand(batch(), StaticGain(newtons_per_volt=4.0))
    env = DIPCFrictionVecEnv(wrapped)
    assert env.render_mode is None
    assert env.get_attr("force_limit", [0, 2]) == [wrapped.force_limit] * 2
    assert env.get_attr("exact_state") == [False] * N
    assert env.env_is_wrapped(VectorForceCommand) == [True] * N
    assert env.env_is_wrapped(VecMonitor, 1) == [False]
    with pytest.raises(ValueError, match="belongs to the whole batch"):
        env.set_attr("exact_state", True, [0])
    env.set_attr("max_episode_steps", 5)
    assert wrapped.unwrapped.max_episode_steps == 5  # of the environment, which reads it, and not of the wrapper
    with pytest.raises(AttributeError, match="has an attribute 'max_steps'"):
        env.set_attr("max_steps", 5)
    env.set_attr("max_episode_steps", None)
    env.set_options({"start": "hanging"})
    assert (np.abs(env.reset()[:, 1]) > 3).all()
    assert (np.abs(env.reset()[:, 1]) < 0.1).all()  # options hold for one reset
    env.set_options([{"start": "hanging"}, {}, {}, {}])
    with pytest.raises(ValueError, match="the same reset options"):
        env.reset()


def test_other_environments_are_refused() -> None:
    with pytest.raises(ValueError, match="autoreset_mode='SameStep'"):
        DIPCFrictionVecEnv(batch("NextStep"))
    with pytest.raises(TypeError, match="vector_entry_point"):
        DIPCFrictionVecEnv(gymnasium.make_vec(dipc_gym.ENV_ID, num_envs=2, vectorization_mode="sync"))
