"""The wrapper that lets a controller command force."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from dipc_gym import compensators
from dipc_gym.compensators import Compensator, CompensatorError
from dipc_gym.compensators.memory import check_period
from dipc_gym.plant import Plant
from dipc_gym.safety import actions
from dipc_gym.safety.naming import suggestion
from dipc_gym.wrappers.estimate import EstimateState, check_volts, refuse_blind, wrappers
from dipc_gym.wrappers.vector_estimate import VectorEstimateState

Array = NDArray[np.float64]


class ForceCommand(
    gymnasium.Wrapper[Array, NDArray[np.float32], Array, NDArray[np.float32]], gymnasium.utils.RecordConstructorArgs
):
    """Turn the action from motor voltage into force on the cart, through a friction compensator.

    The force is the one that the linear controller's model assumes: the friction left in that model (40 N s/m,
    back-EMF included) still acts, the rest is compensated. The compensator gets the velocity that the environment
    last observed, or that `EstimateState` inside this one estimates; so any other wrapper may stand around this one.
    `info["force"]` is the force as commanded, after the limit; `info["voltage"]` and `info["clipped"]` say what became
    of it.

    Args:
        env: a `DIPC-Friction-v0`, or any environment whose `unwrapped` has `measured_velocity`, `friction` and `plant`.
        compensator: a `Compensator`, the path of its file, or its dictionary (as JSON holds it).
        force_limit: largest force either way, N; by default what the blocked motor exerts at full supply.

    Raises:
        TypeError: `env` cannot say how fast its cart is.
        ValueError: `force_limit` is not positive, or is needed because the plant's motor is not known; or a wrapper
            inside this one changes what an action is, so that a voltage would not arrive as one; or the compensator
            needs an estimator that observes friction, and there is none inside, or remembers from one control period
            to the next, and these are others than the environment's.
        compensators.CompensatorError: the compensator's file or dictionary is broken, or a kind of compensator is
            named that has to be fitted first.

    Example:
        >>> import gymnasium, dipc_gym
        >>> from dipc_gym.compensators import StaticGain
        >>> from dipc_gym.wrappers import ForceCommand
        >>> env = ForceCommand(gymnasium.make("DIPC-Friction-v0"), StaticGain(newtons_per_volt=4.0))
        >>> observation, info = env.reset(seed=1)
        >>> observation, reward, terminated, truncated, info = env.step([10.0])
        >>> info["force"], info["voltage"]
        (10.0, 2.5)
    """

    takes_force = True  # which wrappers that send volts must not get

    def __init__(
        self,
        env: gymnasium.Env[Array, NDArray[np.float32]],
        compensator: Compensator | Mapping[str, Any] | str | Path,
        *,
        force_limit: float | None = None,
    ) -> None:
        inner: Any = env.unwrapped
        if not hasattr(inner, "measured_velocity"):
            raise TypeError(f"{inner} has no measured_velocity; ForceCommand goes around DIPC-Friction-v0")
        check_volts("ForceCommand", env, env.action_space, inner.action_space)
        self._inner, self._estimate = inner, estimating(env)
        self.compensator = compensator
        recorded = compensator.to_dict() if isinstance(compensator, Compensator) else _plain(compensator)
        gymnasium.utils.RecordConstructorArgs.__init__(self, compensator=recorded, force_limit=force_limit)
        gymnasium.Wrapper.__init__(self, env)
        self.force_limit, self.action_space = force_range(inner.plant, force_limit)

    @property
    def compensator(self) -> Compensator:
        """What turns force into voltage. Another one may take its place, and begins with a memory of nothing."""
        return self._compensator

    @compensator.setter
    def compensator(self, compensator: Compensator | Mapping[str, Any] | str | Path) -> None:
        self._compensator = own_compensator(compensator, self._inner.plant, self._estimate)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """Reset the environment and the compensator's memory."""
        observation, info = self.env.reset(seed=seed, options=options)
        self.compensator.reset()
        info["force"] = 0.0
        return observation, info

    def step(self, action: NDArray[Any]) -> tuple[Array, Any, bool, bool, dict[str, Any]]:
        """Hold the voltage that the compensator gives for a force.

        Args:
            action: (1,) N.

        Raises:
            ValueError: the action is not one finite number.
        """
        force = min(max(actions.one(action, "force"), -self.force_limit), self.force_limit)
        estimate, compensator = self._estimate, self.compensator
        velocity = (estimate or self._inner).measured_velocity
        known: dict[str, float] = {}
        if compensator.needs_friction:
            observed = estimate is not None and compensator.observed_friction
            known["friction"] = estimate.friction_estimate if observed else -self._inner.friction
        if estimate is not None:
            estimate.command(force, self._friction(force, compensator.state(), known))
        volts = compensator.voltage(force, velocity, **known)
        observation, reward, terminated, truncated, info = self.env.step(np.array((volts,)))
        info["force"] = force
        return observation, reward, terminated, truncated, info

    def _friction(self, force: float, state: Array, known: dict[str, float]) -> Callable[[Array], Array]:
        """What the compensator, with the memory it has now, adds to a force beyond the motor's gain at velocities."""
        gain, wanted = self._estimate.estimator.rig.newtons_per_volt, np.array([force])
        given = {name: np.array([value]) for name, value in known.items()}
        return lambda velocity: gain * self.compensator.voltage_batch(wanted, velocity, state, **given)[0] - wanted


def estimating(env: Any) -> Any:
    """The `EstimateState` (or its vector twin) among an environment's wrappers, or None."""
    return next((one for one in wrappers(env) if isinstance(one, (EstimateState, VectorEstimateState))), None)


def own_compensator(
    compensator: Compensator | Mapping[str, Any] | str | Path, plant: Plant, estimate: Any
) -> Compensator:
    """A compensator of one's own: it has a memory, which two environments must not share, and the environment's
    amplifier limits its voltages and says where it did.

    Args:
        compensator: in any form that the wrappers take.
        plant: of the environment.
        estimate: the `EstimateState` around it, or its vector twin, or None.

    Raises:
        ValueError: its memory is for another control period, or it feeds forward friction that nothing observes.
        compensators.CompensatorError: a file or dictionary is broken, or a kind is named that has to be fitted first.
    """
    if not isinstance(compensator, Compensator | Mapping | str | Path):
        raise CompensatorError(
            f"ForceCommand takes a compensator, its dictionary, or the path of a saved one, not {compensator!r}; "
            'for none, give dipc_gym.runs.compensator("none")'
        )
    if isinstance(compensator, str) and not compensator.endswith(".json") and not Path(compensator).exists():
        if compensator == "none":
            raise CompensatorError(
                "'none' is a kind of compensator, which has to know the rig's gain; give "
                'ForceCommand(env, dipc_gym.runs.compensator("none"))'
            )
        if compensator in compensators.names():
            mend = f"fit it to a rig: ForceCommand(env, dipc_gym.runs.identify().fit({compensator!r}))"
            raise CompensatorError(f"{compensator!r} is a kind of compensator; {mend}, or give the path of a saved one")
        near = suggestion(compensator, compensators.names())
        raise CompensatorError(
            f"{compensator}: neither a file nor a kind of compensator; kinds, which have to be fitted to a rig, are "
            f"{', '.join(compensators.names())}{near}"
        )
    known = compensator if isinstance(compensator, Compensator) else compensators.load(_plain(compensator))
    check_period(known, plant.control_period)
    refuse_blind(estimate is not None and estimate.estimator.observes_friction, known)
    return known.behind(plant.supply)


def force_range(plant: Plant, force_limit: float | None) -> tuple[float, spaces.Space[NDArray[np.float32]]]:
    """Largest force either way, N, and the action space of one environment.

    Raises:
        ValueError: `force_limit` is not positive, or is needed because the plant's motor is not known.
    """
    if force_limit is None:
        if plant.motor is None:
            raise ValueError("the model's motor is not known, so give ForceCommand a force_limit in newtons")
        force_limit = plant.motor.force_per_volt * plant.supply
    if not (math.isfinite(force_limit) and force_limit > 0):
        raise ValueError(f"force_limit is {force_limit}; it must be a positive number of newtons")
    limit = actions.bound(force_limit)
    return float(force_limit), spaces.Box(-limit, limit, (1,), np.float32)


def _plain(compensator: Mapping[str, Any] | str | Path) -> dict[str, Any] | str:
    """The argument in a form that JSON can hold."""
    return dict(compensator) if isinstance(compensator, Mapping) else str(compensator)
