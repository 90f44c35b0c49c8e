"""`EstimateState` for many environments at once."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium.vector import VectorEnv, VectorWrapper
from numpy.typing import NDArray

from dipc_gym.estimators import Command, Estimator
from dipc_gym.vector import DIPCFrictionVectorEnv
from dipc_gym.wrappers.estimate import check_period, check_readings, check_volts, own_estimator, refuse_near

Array = NDArray[np.float64]


class VectorEstimateState(VectorWrapper[Any, Any, Any, Any, Any]):
    """`EstimateState` for many rigs: the estimator observes all of them in one call, and each as if it were alone.

    Args:
        env: a `DIPCFrictionVectorEnv` or `SwingUpVectorEnv`, with wrappers that leave actions and observations alone.
        estimator: an `Estimator`, the path of its file, or its dictionary.

    Raises:
        TypeError: `env` is another environment.
        estimators.EstimatorError: the estimator's file or dictionary is broken.
        ValueError: the estimator is for another control period, or knows the rig near upright alone; or a wrapper
            inside this one changes what actions or observations are.

    Example:
        >>> import gymnasium, dipc_gym
        >>> from dipc_gym import runs
        >>> envs = gymnasium.make_vec("DIPC-Friction-v0", num_envs=2, vectorization_mode="vector_entry_point")
        >>> envs = VectorEstimateState(envs, runs.estimator("kalman"))
        >>> observations, infos = envs.reset(seed=1)
        >>> envs.step(np.zeros((2, 1)))[0].shape
        (2, 6)
    """

    def __init__(self, env: VectorEnv[Any, Any, Any], estimator: Estimator | Mapping[str, Any] | str | Path) -> None:
        super().__init__(env)
        inner = env.unwrapped
        if not isinstance(inner, DIPCFrictionVectorEnv):
            raise TypeError(f"{inner} is not DIPC-Friction-v0 made with vectorization_mode='vector_entry_point'")
        check_volts("EstimateState", env, env.single_action_space, inner.single_action_space)
        check_readings(env, env.single_observation_space, inner.single_observation_space)
        self._inner = inner
        self.estimator = own_estimator(estimator)
        check_period(self.estimator, inner.plant.control_period)
        refuse_near(self.estimator, inner)
        self._state = self.estimator.initial_state(np.zeros((self.num_envs, 6)))
        self._wanted: tuple[Array, Callable[[Array], Array] | None] | None = None

    @property
    def measured_velocity(self) -> Array:
        """Estimated velocities of the carts, (num_envs,) m/s."""
        return self.estimator.observation(self._state)[:, 3].copy()

    @property
    def friction_estimate(self) -> Array:
        """Estimated friction over the coming period, (num_envs,) N, positive where it holds back motion towards +x."""
        return self.estimator.friction(self._state)

    def command(self, force: Array, friction: Callable[[Array], Array]) -> None:
        """Say which forces (num_envs,) the next voltages stand for, and what friction was added for velocities."""
        self._wanted = force, friction

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """Reset environments and the estimator's memory of them."""
        _, infos = self.env.reset(seed=seed, options=options)  # type: ignore[arg-type]
        self._wanted = None
        self._begin()
        self._note(infos, self._inner.began)
        return self._observations(), infos

    def step(self, actions: NDArray[Any]) -> tuple[Array, Any, Any, Any, dict[str, Any]]:
        """Hold voltages, read the encoders, and estimate."""
        _, rewards, terminated, truncated, infos = self.env.step(actions)
        rig = self.estimator.rig
        supply = min(rig.supply, self._inner.plant.supply)
        voltage = np.clip(np.asarray(actions, dtype=np.float64)[:, 0], -supply, supply)
        force, friction = self._wanted or (rig.newtons_per_volt * voltage, None)
        self._wanted = None
        ended = infos.get("_final_obs")  # rows that were reset within this step
        readings = self._inner.encoders if ended is None else self._inner.last_encoders
        readings[:, 2] += readings[:, 1]
        self._state = self.estimator.update(self._state, readings, Command(force, voltage, friction))
        if ended is not None:
            last = self._observations()
            for i in np.flatnonzero(ended):
                infos["final_obs"][i] = last[i].copy()
            self._note(infos["final_info"], ended)
        self._begin()
        self._note(infos, np.ones(self.num_envs, dtype=bool))
        return self._observations(), rewards, terminated, truncated, infos

    def _observations(self) -> Array:
        return self._inner.observation_of(self.estimator.observation(self._state).copy())

    def _begin(self) -> None:
        """Begin anew where an episode has begun."""
        began = self._inner.began
        if began.any():
            fresh = self.estimator.initial_state(self._inner.measured_state)
            self._state = np.where(began[:, None], fresh, self._state)

    def _note(self, infos: dict[str, Any], rows: NDArray[np.bool_]) -> None:
        """Add the friction of some rows to what is said of a step, or of the last one of episodes."""
        if self.estimator.observes_friction:
            infos["friction_estimate"] = np.where(rows, self.friction_estimate, 0.0)
            infos["_friction_estimate"] = rows.copy()
