"""What learns: a model of stable-baselines3, its scaled environments, and the average of its weights."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3 import PPO, SAC
from stable_baselines3.common import logger
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecEnvWrapper, VecMonitor

from dipc_gym.compensators import OutOfRangeWarning
from dipc_gym.policy import Policy
from dipc_gym.safety.intact import fit
from dipc_gym.sb3 import DIPCFrictionVecEnv
from dipc_gym.training.rig import Rig
from dipc_gym.training.task import Training

Array = NDArray[np.float64]

# By which observations are divided, so that a network sees numbers of size one.
SCALES = {
    "balance": np.array([0.1, 0.05, 0.05, 0.5, 0.5, 0.5]),  # m, rad and their rates: what balancing looks like
    "swing-up": np.array([0.2, 1.0, 0.3, 1.0, 0.3, 1.0, 3.0, 3.0]),  # m, cosines and sines, rates
}
AVERAGED = 160_000  # control periods over which the weights are averaged, if the training is that long
REPLAY = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")


class ScaledRigs(VecEnvWrapper):
    """Rigs as a network likes them: observations near 1, commands within -1..1, a value near 1.

    Args:
        envs: the rigs.
        scales: (k,) what observations are divided by.
        limit: command that 1 stands for, N or V.
        reward: factor on the reward.
        action_repeat: control periods that a command lasts. The step's reward is their mean. A rig whose episode ends
            meanwhile begins the next, without a command until the step is over.
    """

    def __init__(
        self, envs: DIPCFrictionVecEnv, scales: Array, limit: float, reward: float, action_repeat: int = 1
    ) -> None:
        super().__init__(
            envs,
            observation_space=spaces.Box(-np.inf, np.inf, scales.shape, np.float32),
            action_space=spaces.Box(-1.0, 1.0, (1,), np.float32),
        )
        self._scales = scales
        self._limit, self._reward, self._repeat = limit, reward / action_repeat, action_repeat
        self._commands = np.zeros((envs.num_envs, 1))

    def reset(self) -> NDArray[np.float32]:
        """Start all episodes."""
        return self._scaled(self.venv.reset())

    def step_async(self, actions: NDArray[Any]) -> None:
        """Note the actions, (n, 1) in shares of the limit."""
        self._commands = actions.astype(np.float64) * self._limit
        self.venv.step_async(self._commands)

    def step_wait(self) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_], list[dict[str, Any]]]:
        """Take the step."""
        observations, rewards, ended, infos = self.venv.step_wait()
        for _ in range(self._repeat - 1):
            self._commands = np.where(ended[:, None], 0.0, self._commands)
            observations, later, over, final = self.venv.step(self._commands)
            rewards = rewards + np.where(ended, 0.0, later).astype(np.float32)
            for i in np.flatnonzero(over & ~ended):
                infos[i] = final[i]
            ended = ended | over
        for i in np.flatnonzero(ended):
            infos[i]["terminal_observation"] = self._scaled(infos[i]["terminal_observation"])
        return self._scaled(observations), rewards * self._reward, ended, infos

    def _scaled(self, observations: Any) -> NDArray[np.float32]:
        return (observations / self._scales).astype(np.float32)


class Learner:
    """A model of stable-baselines3 in its environment, and the average of its weights.

    What acts in the end has the average of the weights over the last 160,000 control periods. Single updates make a
    balancing policy better and worse by turns; the average is better than most of them.

    Args:
        training: what to learn.
        rig: where.
        folder: for TensorBoard's files; None writes none.
    """

    def __init__(self, training: Training, rig: Rig, folder: Path | None = None) -> None:
        torch.set_num_threads(1)  # networks this small are slower on two
        self.training, self.rig, recipe = training, rig, training.recipe
        self._scales = SCALES[training.task]
        rigs = DIPCFrictionVecEnv(rig.learning(recipe))
        envs = VecMonitor(ScaledRigs(rigs, self._scales, rig.limit, recipe.reward, recipe.action_repeat))
        shape: dict[str, Any] = {"net_arch": [recipe.width] * 2, "activation_fn": torch.nn.Tanh}
        common: dict[str, Any] = {
            "gamma": recipe.gamma**recipe.action_repeat,
            "learning_rate": self._rate,
            "batch_size": recipe.batch_size,
            "device": "cpu",
        }
        common |= {"seed": training.seed}
        self.model: Any = None
        if training.algorithm == "ppo":
            self.model = PPO(
                "MlpPolicy",
                envs,
                n_steps=recipe.rollout,
                n_epochs=recipe.epochs,
                gae_lambda=recipe.gae_lambda,
                policy_kwargs=shape | {"log_std_init": recipe.log_std_init},
                **common,
            )
        else:
            self.model = SAC(
                "MlpPolicy",
                envs,
                buffer_size=recipe.buffer_size,
                learning_starts=recipe.learning_starts,
                train_freq=1,
                gradient_steps=recipe.gradient_steps,
                tau=recipe.tau,
                ent_coef=f"auto_{recipe.ent_coef_init}",
                policy_kwargs=shape | {"optimizer_kwargs": {"fused": True}},  # a tenth faster
                **common,
            )
        self.model.set_logger(
            logger.configure(None if folder is None else str(folder), ["tensorboard"] if folder else [])
        )
        self.average = {key: value.clone() for key, value in self._actor().items()}
        self._averaged_at = 0

    @property
    def steps(self) -> int:
        """Control periods so far."""
        return 0 if self.model is None else int(self.model.num_timesteps) * self.training.recipe.action_repeat

    def learn(self, stage: int, each_step: Callable[[], None]) -> None:
        """Learn for one stage.

        Args:
            stage: its number, from 0; episodes and random state begin anew.
            each_step: called after each control period of all rigs.
        """
        recipe = self.training.recipe
        self.model.set_random_seed(int(np.random.SeedSequence([self.training.seed, stage]).generate_state(1)[0] >> 1))
        self.model._last_obs = None  # so that learn() resets the environments
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", OutOfRangeWarning)  # exploring leaves the identified range on purpose
            self.model.learn(
                math.ceil(min(recipe.stage * recipe.num_envs, recipe.steps - self.steps) / recipe.action_repeat),
                callback=_Watch(self.keep_average, each_step),
                reset_num_timesteps=False,
                log_interval=None if self.training.algorithm == "sac" else 1,
            )
        self.keep_average()

    def log(self, figures: Mapping[str, float]) -> None:
        """Give figures to TensorBoard, with all that the model has noted."""
        for key, value in figures.items():
            self.model.logger.record(key, value)
        self.model.logger.dump(self.steps)

    def keep_average(self) -> None:
        """Let the average follow the weights, as far as steps have been taken."""
        keep = math.exp(-(self.steps - self._averaged_at) / min(AVERAGED, self.training.recipe.steps / 8))
        self._averaged_at = self.steps
        for key, value in self._actor().items():
            self.average[key].mul_(keep).add_(value, alpha=1 - keep)

    def policy(self) -> Policy:
        """The policy with averaged weights."""
        weights = {key: shortest(value.numpy()) for key, value in self.average.items()}
        names = sorted({key.rpartition(".")[0] for key in weights})
        ppo = self.training.algorithm == "ppo"
        names.sort(key=lambda name: name in ("action_net", "actor.mu"))  # hidden layers are numbered; the last is not
        layers = tuple((weights[f"{name}.weight"], weights[f"{name}.bias"]) for name in names)
        return self.rig.policy(self.training, layers, self._scales, "clip" if ppo else "tanh", self.steps)

    def state(self) -> dict[str, Any]:
        """All that the next stage depends on: tensors, numbers and strings."""
        state = {"steps": self.steps, "updates": int(self.model._n_updates), "average": dict(self.average)}
        state["model"] = self.model.get_parameters()
        if self.training.algorithm == "sac":
            buffer = self.model.replay_buffer
            filled = buffer.buffer_size if buffer.full else buffer.pos
            state["entropy"] = self.model.log_ent_coef.detach().clone()
            state["replay"] = {name: torch.from_numpy(getattr(buffer, name)[:filled].copy()) for name in REPLAY}
            state["replay_at"], state["replay_full"] = int(buffer.pos), bool(buffer.full)
        return state

    def restore(self, state: Mapping[str, Any]) -> None:
        """Take up what `state` gave.

        Raises:
            Exception: of many kinds, for the state of another training or of none; the learner is then of no use.
        """
        fit(state, {"steps": int, "updates": int})
        self.model.set_parameters(state["model"])
        self.model.num_timesteps = state["steps"] // self.training.recipe.action_repeat
        self.model._n_updates = state["updates"]
        for key, value in self.average.items():
            value[:] = state["average"][key].reshape(value.shape)
        self._averaged_at = state["steps"]
        if self.training.algorithm == "sac":
            self.model.log_ent_coef.data.copy_(state["entropy"])
            buffer = self.model.replay_buffer
            for name in REPLAY:
                stored = state["replay"][name].numpy()
                getattr(buffer, name)[: len(stored)] = stored
            fit(state, {"replay_at": int, "replay_full": bool})
            if state["replay_at"] >= buffer.buffer_size:
                raise ValueError(f"the replay buffer has no place {state['replay_at']}")
            buffer.pos, buffer.full = state["replay_at"], state["replay_full"]

    def _actor(self) -> dict[str, Any]:
        """The tensors that act."""
        parts = ("mlp_extractor.policy_net.", "action_net.", "actor.latent_pi.", "actor.mu.")
        return {k: v.detach() for k, v in self.model.policy.state_dict().items() if k.startswith(parts)}

    def _rate(self, _: float) -> float:
        """The learning rate now; stable-baselines3's own progress would start again with every stage."""
        recipe = self.training.recipe
        return recipe.learning_rate * max(1.0 - self.steps / recipe.steps, 0.05)


class _Watch(BaseCallback):
    """Calls one function before each rollout and another after each step."""

    def __init__(self, before: Callable[[], None], after: Callable[[], None]) -> None:
        super().__init__()
        self._before, self._after = before, after

    def _on_rollout_start(self) -> None:
        self._before()

    def _on_step(self) -> bool:
        self._after()
        return True


def shortest(weights: NDArray[np.float32]) -> Array:
    """Single-precision numbers as the double of their shortest decimal form, which keeps the files small."""
    return np.array([float(str(w)) for w in weights.ravel()]).reshape(weights.shape)
