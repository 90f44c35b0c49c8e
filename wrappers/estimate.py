"""The wrapper that puts an estimator's state in the place of the environment's observation."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.vector import VectorObservationWrapper, VectorWrapper
from numpy.typing import NDArray

from dipc_gym import estimators
from dipc_gym.estimators import Command, Estimator

Array = NDArray[np.float64]


class EstimateState(
    gymnasium.Wrapper[Array, NDArray[np.float32], Array, NDArray[np.float32]], gymnasium.utils.RecordConstructorArgs
):
    """Observe what an estimator makes of encoder readings and commands, instead of filtered differences.

    `ForceCommand` goes around it: the compensator then gets the estimated velocity, the compensator `observed` also the
    estimated friction, and the estimator hears what force was wanted and which friction the compensator takes for
    granted. Without `ForceCommand`, force is the voltage times the motor's gain. `info["friction_estimate"]` is the
    estimated friction for estimators that observe it, positive where it holds back motion towards +x, N.

    Args:
        env: a `DIPC-Friction-v0` or `DIPC-Friction-SwingUp-v0`, with wrappers that leave actions and observations
            alone.
        estimator: an `Estimator`, the path of its file, or its dictionary. To swing up, it is `rigid_body`.

    Raises:
        TypeError: `env` has no encoders to read.
        estimators.EstimatorError: the estimator's file or dictionary is broken.
        ValueError: the estimator is for another control period, or knows the rig near upright alone; or a wrapper
            inside this one changes what an action is, such as `ForceCommand`, or what an observation is: those go
            around it.

    Example:
        >>> import gymnasium, dipc_gym
        >>> from dipc_gym import runs
        >>> from dipc_gym.wrappers import EstimateState
        >>> env = EstimateState(gymnasium.make("DIPC-Friction-v0"), runs.estimator("disturbance"))
        >>> observation, info = env.reset(seed=1)
        >>> for _ in range(8):  # 4 V are 16 N; stiction takes the most of it
        ...     observation, reward, terminated, truncated, info = env.step([1.0])
        >>> 3.0 < info["friction_estimate"] < 5.0
        True
    """

    def __init__(
        self,
        env: gymnasium.Env[Array, NDArray[np.float32]],
        estimator: Estimator | Mapping[str, Any] | str | Path,
    ) -> None:
        inner: Any = env.unwrapped
        if not hasattr(inner, "encoders"):
            raise TypeError(f"{inner} has no encoders; EstimateState goes around DIPC-Friction-v0")
        check_volts("EstimateState", env, env.action_space, inner.action_space)
        check_readings(env, env.observation_space, inner.observation_space)
        self.estimator = own_estimator(estimator)
        check_period(self.estimator, inner.plant.control_period)
        refuse_near(self.estimator, inner)
        gymnasium.utils.RecordConstructorArgs.__init__(self, estimator=self.estimator.to_dict())
        gymnasium.Wrapper.__init__(self, env)
        self._inner = inner
        self._state: Array = self.estimator.initial_state(np.zeros((1, 6)))
        self._wanted: tuple[Array, Callable[[Array], Array] | None] | None = None

    @property
    def measured_velocity(self) -> float:
        """Estimated velocity of the cart, m/s."""
        return float(self.estimator.observation(self._state)[0, 3])

    @property
    def friction_estimate(self) -> float:
        """Estimated friction over the coming period, N, positive where it holds back motion towards +x."""
        return float(self.estimator.friction(self._state)[0])

    def command(self, force: float, friction: Callable[[Array], Array]) -> None:
        """Say which force the next voltage stands for, N, and what friction was added to it for velocities (n,)."""
        self._wanted = np.array([force]), friction

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """Reset environment and estimator; at first, the environment's own observation is believed."""
        _, info = self.env.reset(seed=seed, options=options)
        self._state, self._wanted = self.estimator.initial_state(self._inner.measured_state[None]), None
        return self._observation(), self._noted(info)

    def step(self, action: NDArray[Any]) -> tuple[Array, Any, bool, bool, dict[str, Any]]:
        """Hold a voltage, read the encoders, and estimate."""
        _, reward, terminated, truncated, info = self.env.step(action)
        rig = self.estimator.rig
        supply = min(rig.supply, self._inner.plant.supply)
        voltage = np.clip(np.array([float(action[0])]), -supply, supply)
        force, friction = self._wanted or (rig.newtons_per_volt * voltage, None)
        self._wanted = None
        x, theta1, relative = self._inner.encoders
        readings = np.array([[x, theta1, theta1 + relative]])
        self._state = self.estimator.update(self._state, readings, Command(force, voltage, friction))
        return self._observation(), reward, terminated, truncated, self._noted(info)

    def _observation(self) -> Array:
        return self._inner.observation_of(self.estimator.observation(self._state)[0].copy())

    def _noted(self, info: dict[str, Any]) -> dict[str, Any]:
        if self.estimator.observes_friction:
            info["friction_estimate"] = self.friction_estimate
        return info


def own_estimator(estimator: Estimator | Mapping[str, Any] | str | Path) -> Estimator:
    """An estimator of one's own, from any of the forms that the wrappers take."""
    return copy.deepcopy(estimator if isinstance(estimator, Estimator) else estimators.load(estimator))


def check_period(estimator: Estimator, period: float) -> None:
    """Refuse an estimator whose filter was worked out for another rate.

    Raises:
        ValueError: it was.
    """
    if abs(estimator.rig.period - period) > 1e-9:
        raise ValueError(
            f"the estimator {estimator.name!r} is for a control period of {estimator.rig.period:g} s; the "
            f"environment's is {period:g} s: fit it on this rig"
        )


def wrappers(env: Any) -> Iterator[Any]:
    """The wrappers around an environment, or around many, from outside."""
    while isinstance(env, (gymnasium.Wrapper, VectorWrapper)):
        yield env
        env = env.env


def check_readings(env: Any, outer: spaces.Space[Any], inner: spaces.Space[Any]) -> None:
    """Refuse an environment whose wrappers change observations, which an estimator would throw away.

    Args:
        env: the environment.
        outer: observation space of the environment, wrappers included.
        inner: observation space without them.

    Raises:
        ValueError: one of them does.
    """
    changing = [
        one for one in wrappers(env) if isinstance(one, (gymnasium.ObservationWrapper, VectorObservationWrapper))
    ]
    if changing or outer != inner:
        name = type(changing[0]).__name__ if changing else "such as FrameStackObservation"
        raise ValueError(
            "EstimateState puts its own observation in the place of the environment's: put the wrapper that changes "
            f"observations, {name}, around EstimateState instead of inside"
        )


def check_volts(wrapper: str, env: Any, outer: spaces.Space[Any], inner: spaces.Space[Any]) -> None:
    """Refuse an environment whose wrappers want something else than the motor's voltage.

    Args:
        wrapper: name of the one that is to go around it, and that sends volts or passes them on.
        env: the environment.
        outer: action space of the environment, wrappers included.
        inner: action space without them.

    Raises:
        ValueError: one of its wrappers turns force into voltage; or the two spaces differ, and not only in that one has
            no bounds.
    """
    if any(getattr(type(one), "takes_force", False) for one in wrappers(env)):
        raise ValueError(
            f"{wrapper} sends volts, and a ForceCommand inside it takes newtons: put that around {wrapper} instead of "
            "inside"
        )
    if isinstance(outer, spaces.Box) and outer.shape == inner.shape and not outer.is_bounded("both"):
        return  # as `ClipAction` has it, which leaves voltages voltages
    if outer != inner:
        raise ValueError(
            f"{wrapper} sends volts, {inner}, and the environment takes {outer}: put the wrapper that changes actions, "
            f"such as RescaleAction, around {wrapper} instead of inside"
        )


def refuse_near(estimator: Estimator, env: Any) -> None:
    """Refuse an estimator that knows the rig near upright alone where poles swing.

    Raises:
        ValueError: it is one.
    """
    if hasattr(env, "goal") and not estimator.everywhere:
        raise ValueError(
            f"the estimator {estimator.name!r} knows the rig near upright alone; to swing up, take 'rigid_body'"
        )


def refuse_blind(observes: bool, compensator: Any) -> None:
    """Refuse a compensator that feeds observed friction forward where none is observed.

    Raises:
        ValueError: it does.
    """
    if compensator.observed_friction and not observes:
        raise ValueError(
            f"the compensator {compensator.name!r} feeds forward the friction that an estimator observes; put "
            "EstimateState with an estimator that does, such as 'disturbance', inside ForceCommand"
        )
