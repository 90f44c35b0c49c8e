"""A motor that does not do what it is told: noise on its voltage, and a response that lags or overshoots."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import VectorEnv, VectorWrapper
from numpy.typing import NDArray

from dipc_gym.safety import actions

Array = NDArray[np.float64]


class FaultyMotor(
    gymnasium.Wrapper[Array, NDArray[np.float32], Array, NDArray[np.float32]], gymnasium.utils.RecordConstructorArgs
):
    """Disturb the voltage between whoever commands it and the motor.

        applied(k) = response command(k) + (1 - response) applied(k-1) + noise.

    What stands around it knows nothing of this: estimators believe in the command. The supply limits what is applied,
    not what is commanded.

    Args:
        env: a `DIPC-Friction-v0`; no wrapper that turns the action into something else may stand inside.
        noise: standard deviation of the noise, drawn anew in every period from the environment's generator, V.
        response: share of a change that arrives; below 1 the motor lags, above it overshoots. Beyond 2 what was
            applied once would grow without end.

    Raises:
        ValueError: `noise` is negative or not finite, or `response` not above 0 and at most 2.

    Example:
        >>> import gymnasium, dipc_gym
        >>> env = FaultyMotor(gymnasium.make("DIPC-Friction-v0"), response=0.5)
        >>> observation, info = env.reset(seed=1)
        >>> env.step([4.0])[4]["voltage"], env.step([4.0])[4]["voltage"]
        (2.0, 3.0)
    """

    def __init__(
        self, env: gymnasium.Env[Array, NDArray[np.float32]], *, noise: float = 0.0, response: float = 1.0
    ) -> None:
        if not (math.isfinite(noise) and noise >= 0):
            raise ValueError(f"noise is {noise}; it must be a finite number of volts, 0 or more")
        if not 0 < response <= 2:
            raise ValueError(
                f"response is {response}; it must be above 0 and at most 2, or what is applied grows without end"
            )
        gymnasium.utils.RecordConstructorArgs.__init__(self, noise=noise, response=response)
        gymnasium.Wrapper.__init__(self, env)
        self.noise, self.response = noise, response
        self._applied = 0.0

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """Reset the environment; the motor is without voltage."""
        self._applied = 0.0
        return self.env.reset(seed=seed, options=options)

    def step(self, action: NDArray[Any]) -> tuple[Array, Any, bool, bool, dict[str, Any]]:
        """Apply what becomes of the voltage (1,), V.

        Raises:
            ValueError: the action is not one finite number; the motor does not hear of it.
        """
        asked = actions.one(action, "voltage")
        self._applied = self.response * asked + (1 - self.response) * self._applied
        volts = self._applied
        if self.noise:
            volts += self.noise * self.env.unwrapped.np_random.standard_normal()
        return self.env.step(np.array((volts,)))


class VectorFaultyMotor(VectorWrapper[Any, Any, Any, Any, Any]):
    """`FaultyMotor` for many rigs, each with a motor of its own.

    Args:
        env: a `DIPCFrictionVectorEnv`; no wrapper that turns the action into something else may stand inside.
        noise: standard deviation of each motor's noise, (num_envs,) or one for all, V.
        response: share of a change that arrives, (num_envs,) or one for all.

    Raises:
        ValueError: a `noise` is negative or not finite, or a `response` not above 0 and at most 2.

    Example:
        >>> import gymnasium, dipc_gym
        >>> envs = gymnasium.make_vec("DIPC-Friction-v0", num_envs=2, vectorization_mode="vector_entry_point")
        >>> envs = VectorFaultyMotor(envs, response=np.array([0.5, 1.0]))
        >>> observations, infos = envs.reset(seed=1)
        >>> envs.step(np.array([[4.0], [4.0]]))[4]["voltage"].tolist()
        [2.0, 4.0]
    """

    def __init__(
        self, env: VectorEnv[Any, Any, Any], *, noise: Array | float = 0.0, response: Array | float = 1.0
    ) -> None:
        super().__init__(env)
        self.noise, self.response = (np.broadcast_to(x, env.num_envs).astype(float) for x in (noise, response))
        if not (np.isfinite(self.noise) & (self.noise >= 0)).all():
            raise ValueError(f"noise is {noise}; it must be finite numbers of volts, 0 or more")
        if not ((self.response > 0) & (self.response <= 2)).all():
            raise ValueError(
                f"response is {response}; it must be above 0 and at most 2, or what is applied grows without end"
            )
        self._applied = np.zeros(env.num_envs)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Reset the environments; their motors are without voltage."""
        found = self.env.reset(seed=seed, options=options)  # type: ignore[arg-type]
        self._applied[self.env.unwrapped.began] = 0.0  # type: ignore[attr-defined]
        return found

    def step(self, asked: NDArray[Any]) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Apply what becomes of the voltages (num_envs, 1), V.

        Raises:
            ValueError: they have another shape or are not finite; no motor hears of them.
        """
        voltages = actions.many(asked, "voltage", self.num_envs)
        self._applied = self.response * voltages + (1 - self.response) * self._applied
        volts = self._applied.copy()
        # A row that begins anew hears no command; a draw would leave its generator elsewhere than alone.
        for i in np.flatnonzero((self.noise > 0) & ~self.env.unwrapped.waiting):  # type: ignore[attr-defined]
            volts[i] += self.noise[i] * self.env.unwrapped.np_random[i].standard_normal()  # type: ignore[index]
        found = self.env.step(volts[:, None])
        self._applied[self.env.unwrapped.began] = 0.0  # type: ignore[attr-defined]
        return found
