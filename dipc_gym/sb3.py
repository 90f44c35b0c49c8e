"""stable-baselines3's view of the vector environment. Needs the `rl` extra."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from numpy.typing import NDArray
from stable_baselines3.common.running_mean_std import RunningMeanStd
from stable_baselines3.common.vec_env import VecEnv, VecNormalize
from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices

from dipc_gym.controllers.normalisation import SIZE, Statistics
from dipc_gym.vector import DIPCFrictionVectorEnv

__all__ = ["DIPCFrictionVecEnv", "load_statistics", "save_statistics"]

Array = NDArray[np.float64]


class DIPCFrictionVecEnv(VecEnv):
    """A `VecEnv` around `DIPCFrictionVectorEnv` or its wrappers; `VecNormalize` and `VecMonitor` go around it.

    Only an episode's last step has an `info`: that of the environment, `terminal_observation` and
    `TimeLimit.truncated`. Thousands of dictionaries a step would cost more than the simulation; `infos` has the rest as
    arrays. Rows share one object, so methods and attributes are asked of the batch, not row by row.

    Args:
        env: with `autoreset_mode="SameStep"`, which is how stable-baselines3 resets.

    Attributes:
        env: what was given.
        infos: the last step's `infos` as the vector environment gave them.

    Raises:
        TypeError: `env` is no such environment.
        ValueError: it resets in another mode.

    Example:
        >>> import gymnasium, dipc_gym
        >>> from stable_baselines3 import PPO
        >>> envs = gymnasium.make_vec(
        ...     "DIPC-Friction-v0", num_envs=8, vectorization_mode="vector_entry_point", autoreset_mode="SameStep"
        ... )
        >>> model = PPO("MlpPolicy", DIPCFrictionVecEnv(envs), n_steps=8, batch_size=64, device="cpu").learn(64)
        >>> model.num_timesteps
        64
    """

    def __init__(self, env: VectorEnv[Any, Any, Any]) -> None:
        inner = env.unwrapped
        if not isinstance(inner, DIPCFrictionVectorEnv):
            raise TypeError(f"{inner} is not DIPC-Friction-v0 made with vectorization_mode='vector_entry_point'")
        if inner.autoreset_mode != AutoresetMode.SAME_STEP:
            raise ValueError(
                f"the environment resets in mode {inner.autoreset_mode.value}; stable-baselines3 needs "
                "autoreset_mode='SameStep'"
            )
        self.env, self._inner = env, inner
        self.infos: dict[str, Any] = {}
        self._actions: NDArray[Any] = np.zeros((env.num_envs, 1))
        super().__init__(env.num_envs, env.single_observation_space, env.single_action_space)

    def reset(self) -> Array:
        """Start all episodes, with what `seed` and `set_options` said, which then is used up."""
        options = self._options[0]
        if any(other != options for other in self._options):
            raise ValueError(
                "all environments of the batch take the same reset options; give set_options one dictionary"
            )
        seeds = None if all(seed is None for seed in self._seeds) else list(self._seeds)
        observations, self.infos = self.env.reset(seed=seeds, options=options)  # type: ignore[arg-type]
        self.reset_infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        self._reset_seeds()
        self._reset_options()
        return observations

    def step_async(self, actions: NDArray[Any]) -> None:
        """Note the actions, (n, 1); `step_wait` takes the step."""
        self._actions = actions

    def step_wait(self) -> tuple[Array, NDArray[np.float32], NDArray[np.bool_], list[dict[str, Any]]]:
        """Take the step: observations (n, 6), rewards (n,), which episodes ended (n,), and an `info` for each."""
        observations, rewards, terminated, truncated, self.infos = self.env.step(self._actions)
        ended = terminated | truncated
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        if ended.any():
            final = {key: value for key, value in self.infos["final_info"].items() if not key.startswith("_")}
            for i in np.flatnonzero(ended):
                infos[i] = {key: value[i].item() for key, value in final.items()}
                infos[i]["terminal_observation"] = self.infos["final_obs"][i]
                infos[i]["TimeLimit.truncated"] = bool(truncated[i] and not terminated[i])
        return observations, rewards.astype(np.float32), ended, infos

    def close(self) -> None:
        """Close the environment."""
        self.env.close()

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """An attribute of the batch, once for each of the rows asked for."""
        return [getattr(self._owner(attr_name), attr_name)] * self._count(indices)

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Set an attribute that the batch has; only for all rows together."""
        self._all(indices, attr_name)
        setattr(self._owner(attr_name), attr_name, value)

    def env_method(
        self, method_name: str, *method_args: Any, indices: VecEnvIndices = None, **method_kwargs: Any
    ) -> list[Any]:
        """Call a method of the batch, once, for all rows together."""
        self._all(indices, method_name)
        return [getattr(self._owner(method_name), method_name)(*method_args, **method_kwargs)] * self.num_envs

    def env_is_wrapped(self, wrapper_class: type[Any], indices: VecEnvIndices = None) -> list[bool]:
        """Whether the batch has a wrapper of this class around it."""
        env: Any = self.env
        while env is not self._inner and not isinstance(env, wrapper_class):
            env = env.env
        return [isinstance(env, wrapper_class)] * self._count(indices)

    def _owner(self, name: str) -> Any:
        """The outermost wrapper, or else the environment: whichever has the attribute."""
        for owner in (self.env, self._inner):
            if hasattr(owner, name):
                return owner
        raise AttributeError(f"neither {self.env} nor {self._inner} has an attribute {name!r}")

    def _count(self, indices: VecEnvIndices) -> int:
        return len(list(self._get_indices(indices)))

    def _all(self, indices: VecEnvIndices, name: str) -> None:
        chosen: Iterable[int] | Sequence[int] = self._get_indices(indices)
        if sorted(chosen) != list(range(self.num_envs)):
            raise ValueError(f"{name} belongs to the whole batch; leave out indices")


def save_statistics(envs: VecNormalize, policy: str | Path) -> Path:
    """Keep what observations are normalised with beside a saved policy, as plain JSON: `VecNormalize.save` pickles.

    Args:
        envs: that the policy was trained with.
        policy: its file, as given to `model.save`, with its ending.

    Returns:
        The file, `NAME.statistics.json`; `compare --controller NAME.zip` finds it there.

    Raises:
        ValueError: observations are not normalised, or are not those of this environment.
        OSError: it cannot be written.
    """
    seen = envs.obs_rms if envs.norm_obs else None
    if not isinstance(seen, RunningMeanStd) or seen.mean.shape != (SIZE,):
        raise ValueError("these environments normalise no observations of DIPC-Friction-v0: nothing to save")
    return Statistics(seen.mean, seen.var, float(seen.count), envs.epsilon, envs.clip_obs).save(policy)


def load_statistics(envs: VecEnv, policy: str | Path) -> VecNormalize:
    """Normalise observations as those of a saved policy were, without executing anything in its files.

    Args:
        envs: without `VecNormalize`.
        policy: file of the policy, beside which `save_statistics` has put them.

    Returns:
        The environments, ready to evaluate in: statistics stay as they are, rewards are not normalised. To go on
        training, set `training` and `norm_reward`.

    Raises:
        ControllerError: the statistics are absent or broken.

    Example:
        >>> import gymnasium, tempfile, dipc_gym
        >>> rigs = gymnasium.make_vec(
        ...     "DIPC-Friction-v0", num_envs=4, vectorization_mode="vector_entry_point", autoreset_mode="SameStep"
        ... )
        >>> envs = VecNormalize(DIPCFrictionVecEnv(rigs))
        >>> _ = envs.reset()
        >>> file = save_statistics(envs, Path(tempfile.mkdtemp(), "policy.zip"))
        >>> again = load_statistics(DIPCFrictionVecEnv(rigs), file.with_name("policy.zip"))
        >>> bool((again.obs_rms.mean == envs.obs_rms.mean).all())
        True
    """
    kept = Statistics.load(policy)
    wrapped = VecNormalize(envs, training=False, norm_reward=False, clip_obs=kept.clip, epsilon=kept.epsilon)
    wrapped.obs_rms = RunningMeanStd(shape=kept.mean.shape)
    wrapped.obs_rms.mean, wrapped.obs_rms.var, wrapped.obs_rms.count = kept.mean, kept.variance, kept.count
    return wrapped
