"""The wrappers' twins for many environments at once."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium.vector import VectorEnv, VectorWrapper
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from dipc_gym.compensators import Compensator
from dipc_gym.safety.actions import many
from dipc_gym.vector import DIPCFrictionVectorEnv
from dipc_gym.wrappers.estimate import check_volts
from dipc_gym.wrappers.force_command import estimating, force_range, own_compensator
from dipc_gym.wrappers.record import EpisodeFiles, recordings_folder

Array = NDArray[np.float64]


class VectorForceCommand(VectorWrapper[Any, Any, Any, Any, Any]):
    """`ForceCommand` for many rigs: the compensator evaluates all of them in one call.

    Args:
        env: a `DIPCFrictionVectorEnv`, wrapped or not.
        compensator: a `Compensator`, the path of its file, or its dictionary.
        force_limit: largest force either way, N; by default what the blocked motor exerts at full supply.

    Raises:
        TypeError: `env` is another environment.
        ValueError: `force_limit` is not positive, or is needed because the plant's motor is not known; or a wrapper
            inside this one changes what an action is; or the compensator needs an estimator that observes friction,
            and there is none inside, or remembers from one control period to the next, and these are others.
        compensators.CompensatorError: the compensator's file or dictionary is broken, or a kind of compensator is
            named that has to be fitted first.

    Example:
        >>> import gymnasium, dipc_gym
        >>> from dipc_gym.compensators import StaticGain
        >>> envs = gymnasium.make_vec("DIPC-Friction-v0", num_envs=2, vectorization_mode="vector_entry_point")
        >>> envs = VectorForceCommand(envs, StaticGain(newtons_per_volt=4.0))
        >>> observations, infos = envs.reset(seed=1)
        >>> envs.step(np.array([[10.0], [-4.0]]))[4]["voltage"].tolist()
        [2.5, -1.0]
    """

    takes_force = True  # which wrappers that send volts must not get

    def __init__(
        self,
        env: VectorEnv[Any, Any, Any],
        compensator: Compensator | Mapping[str, Any] | str | Path,
        *,
        force_limit: float | None = None,
    ) -> None:
        super().__init__(env)
        self._inner = _own(env)
        check_volts("ForceCommand", env, env.single_action_space, self._inner.single_action_space)
        self._estimate = estimating(env)
        self.compensator = compensator
        self.force_limit, self.single_action_space = force_range(self._inner.plant, force_limit)
        self.action_space = batch_space(self.single_action_space, self.num_envs)

    @property
    def compensator(self) -> Compensator:
        """What turns forces into voltages. Another one may take its place, and begins with a memory of nothing."""
        return self._compensator

    @compensator.setter
    def compensator(self, compensator: Compensator | Mapping[str, Any] | str | Path) -> None:
        self._compensator = own_compensator(compensator, self._inner.plant, self._estimate)
        self._state = self._compensator.initial_state(self.num_envs)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """Reset environments and the compensator's memory of them."""
        observations, infos = self.env.reset(seed=seed, options=options)  # type: ignore[arg-type]
        self._forget()
        infos |= {"force": np.zeros(self.num_envs), "_force": self._inner.began.copy()}
        return observations, infos

    def step(self, actions: NDArray[Any]) -> tuple[Array, Any, Any, Any, dict[str, Any]]:
        """Hold the voltages that the compensator gives for forces.

        Args:
            actions: (num_envs, 1) N.

        Raises:
            ValueError: the actions have another shape or are not finite.
        """
        force = np.clip(many(actions, "force", self.num_envs), -self.force_limit, self.force_limit)
        estimate, compensator = self._estimate, self.compensator
        velocity, known = (estimate or self._inner).measured_velocity, {}
        if compensator.needs_friction:
            known["friction"] = estimate.friction_estimate if compensator.observed_friction else -self._inner.friction
        if estimate is not None:
            estimate.command(force, self._friction(force, self._state, known))
        volts, self._state = compensator.voltage_batch(force, velocity, self._state, **known)
        observations, rewards, terminated, truncated, infos = self.env.step(volts[:, None])
        self._forget()
        if "final_info" in infos:
            ended = infos["_final_info"]
            infos["final_info"] |= {"force": np.where(ended, force, 0.0), "_force": ended.copy()}
        infos |= {"force": np.where(self._inner.began, 0.0, force), "_force": np.ones(self.num_envs, dtype=bool)}
        return observations, rewards, terminated, truncated, infos

    def _friction(self, force: Array, state: Array, known: dict[str, Array]) -> Callable[[Array], Array]:
        """What the compensator, with the memory it has now, adds to forces beyond the motor's gain at velocities."""
        gain = self._estimate.estimator.rig.newtons_per_volt
        return lambda velocity: gain * self.compensator.voltage_batch(force, velocity, state, **known)[0] - force

    def _forget(self) -> None:
        """Let the compensator begin anew where an episode has begun."""
        began, fresh = self._inner.began, self.compensator.initial_state(self.num_envs)
        self._state = np.where(began if fresh.ndim == 1 else began[:, None], fresh, self._state)


class VectorRecordRun(VectorWrapper[Any, Any, Any, Any, Any]):
    """`RecordRun` for many rigs: every episode becomes a file `NAME-ROW-EPISODE.csv`.

    Args:
        env: a `DIPCFrictionVectorEnv`, wrapped or not.
        folder: where the files go; made if missing.
        name: what the files are called.
        suffix: `"csv"`, `"npz"`, or `"parquet"` (with the `parquet` extra).
        overwrite: replace files of an earlier run instead of refusing.

    Raises:
        FileExistsError: the folder has recordings of that name, and `overwrite` is not set.
        ValueError: the suffix is not known, or the name is none of a file in the folder.
        TypeError: `env` is another environment.

    Example:
        >>> import gymnasium, dipc_gym, tempfile
        >>> envs = gymnasium.make_vec("DIPC-Friction-v0", num_envs=2, vectorization_mode="vector_entry_point")
        >>> envs = VectorRecordRun(envs, folder := tempfile.mkdtemp())
        >>> observations, infos = envs.reset(seed=1)
        >>> for _ in range(20):
        ...     transitions = envs.step(np.ones((2, 1)))
        >>> envs.close()
        >>> sorted(path.name for path in Path(folder).iterdir())
        ['run-0-0.csv', 'run-1-0.csv']
    """

    def __init__(
        self,
        env: VectorEnv[Any, Any, Any],
        folder: str | Path,
        *,
        name: str = "run",
        suffix: str = "csv",
        overwrite: bool = False,
    ) -> None:
        super().__init__(env)
        self._inner = _own(env)
        self.folder = recordings_folder(folder, name, suffix, overwrite, indices=2)
        self._episodes = [EpisodeFiles(self.folder, f"{name}-{i}", suffix, overwrite) for i in range(self.num_envs)]

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """Finish the files of the episodes that are cut off, and start others."""
        result = self.env.reset(seed=seed, options=options)  # type: ignore[arg-type]
        self._finish(np.flatnonzero(self._inner.began))
        return result

    def step(self, actions: NDArray[Any]) -> tuple[Array, Any, Any, Any, dict[str, Any]]:
        """Step, and note what the encoders read before it and the voltages that were applied."""
        times, readings = self._inner.time.tolist(), self._inner.encoders.tolist()
        result = self.env.step(actions)
        _, _, terminated, truncated, infos = result
        ended, volts = terminated | truncated, infos["voltage"]
        if "final_info" in infos:
            volts = np.where(ended, infos["final_info"]["voltage"], volts)
        stepped = np.flatnonzero(~self._inner.began | ended)  # not those that spent the step on their reset
        for i in stepped:
            self._episodes[i].append(times[i], float(volts[i]), readings[i])
        self._finish(np.flatnonzero(ended))
        return result

    def close(self, **kwargs: Any) -> None:
        """Finish the last files."""
        self._finish(np.arange(self.num_envs))
        self.env.close(**kwargs)

    def _finish(self, rows: NDArray[np.intp]) -> None:
        for i in rows:
            self._episodes[i].finish()


def _own(env: VectorEnv[Any, Any, Any]) -> DIPCFrictionVectorEnv:
    inner = env.unwrapped
    if not isinstance(inner, DIPCFrictionVectorEnv):
        raise TypeError(f"{inner} is not DIPC-Friction-v0 made with vectorization_mode='vector_entry_point'")
    return inner
