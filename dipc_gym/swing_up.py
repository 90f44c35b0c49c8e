"""The environment of going from one equilibrium to another, single and many at once."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from dipc_gym import postures
from dipc_gym.env import DoublePendulumEnv, State
from dipc_gym.mechanics.motion import SIZE, observed, state_of
from dipc_gym.plant import Plant
from dipc_gym.randomise import PlantFamily
from dipc_gym.rigs.together import Mask, Period
from dipc_gym.vector import DIPCFrictionVectorEnv

__all__ = ["SwingUpEnv", "SwingUpVectorEnv", "observed", "state_of"]

Array = NDArray[np.float64]
PlantLike = PlantFamily | Plant | Mapping[str, Any] | str | Path | None


class SwingUpEnv(DoublePendulumEnv):
    """Take the double pendulum from one of its equilibria to another, and keep it there.

    ## Description
    The rig of `DIPC-Friction-v0`: same cart, motor, friction, encoders and control period. Here both poles hang at
    first, and are to be swung up and held. Starts and goals are the four equilibria, named first pole first:
    `down-down`, `down-up`, `up-down` and `up-up`; `dipc_gym.postures.TASKS` has all sixteen tasks, with tags.

    ## Action space
    `Box(-24, 24, (1,), float32)`: motor voltage, as in `DIPC-Friction-v0`. `ForceCommand` makes it a force.

    ## Observation space
    `Box(-inf, inf, (8,), float64)`; angles are absolute, from upright.

    | index | meaning | unit |
    |---|---|---|
    | 0 | position of the cart | m |
    | 1, 2 | cosine and sine of the first pole's angle | |
    | 3, 4 | the same of the second pole | |
    | 5 | velocity of the cart | m/s |
    | 6, 7 | rates of the angles | rad/s |

    An angle itself either jumps by a turn somewhere, or tells a pole that went round from one that did not, which the
    motion does not: a network would have to learn each turn anew. Encoders round and differentiate as in
    `DIPC-Friction-v0`, before cosine and sine; `exact_state=True` observes the simulation's state.

    ## Reward
    Between 0 and 1 in every step, the sum of four terms, each with its share at most:

    | term | share | what it is |
    |---|---|---|
    | `reward_poles` | 0.4 | the product of (1 + cos)/2 of each pole's angle from the goal |
    | `reward_rest` | 0.4 | 1 / (1 + e/0.02 + w/4 + v^2/0.25) |
    | `reward_cart` | 0.1 | 1 - (x / 0.45 m)^2 |
    | `reward_voltage` | 0.1 | 1 - (u / supply)^2 |

    Here e is the mean of the poles' (1 - cos)/2 from the goal, w that of their squared rates, and v the cart's
    velocity: to pass through the goal earns little of `reward_rest`. The poles multiply because a sum pays half for
    one pole at its goal, where the other hangs at ease: policies stayed there.

    ## Info
    At every step and at reset: the four terms, `at_goal` (both poles within 0.35 rad of it), `voltage` (V, as applied),
    `clipped`, `friction` (N, dry friction on the cart), `time` (s) and `diverged`. Terms are 0 at a reset.

    ## Initial state
    At rest, cart and angles uniform within 0.02 (m, rad) of the equilibrium `start`. With `anywhere`, which helps to
    learn, the cart is within 0.225 m, the poles have any angle, and all move, by up to 0.5 m/s and 5 rad/s. Where
    `start` is states, such as those of a planned motion, one is drawn, and positions vary by 0.02 about it.
    `reset(options=...)` takes `start`, `state` (six numbers: cart, absolute angles, rates) and `plant`.

    ## Episode end
    Terminated when the cart is as far out as the nearer rail stop, or when the simulation diverges; a pole that falls
    ends nothing. Truncated by Gymnasium's `TimeLimit` after 2,000 steps (10 s).

    ## Arguments
    All are keywords and may be given to `gymnasium.make`.

    Args:
        goal: equilibrium to reach and hold.
        start: equilibrium to begin at, `anywhere`, or states (k, 6), of which each episode draws one.
        plant: as for `DIPC-Friction-v0`.
        model: the same.
        exact_state: the same.
        engine: the same.
        render_mode: `"human"`, `"rgb_array"` or None.
        width: of the picture, pixels.
        height: of the picture, pixels.
        camera: name of the camera, `"side"` or `"follow"` in `rig.xml`; None is MuJoCo's free camera.

    Raises:
        ValueError: no such start or goal.
        PlantError: the plant is impossible or its file is.
        MjcfError: the model is refused, or has what the engine does not simulate.

    Example:
        >>> import gymnasium, dipc_gym
        >>> env = gymnasium.make("DIPC-Friction-SwingUp-v0", goal="up-up")
        >>> observation, info = env.reset(seed=1)
        >>> observation[[1, 3]].round(2).tolist()
        [-1.0, -1.0]
        >>> observation, reward, terminated, truncated, info = env.step([12.0])
        >>> bool(info["at_goal"]), bool(0 <= reward <= 1)
        (False, True)

    ## Version history
    - v0: first version.
    """

    _balances = False

    def __init__(
        self,
        *,
        goal: str = "up-up",
        start: str | Sequence[Sequence[float]] = "down-down",
        plant: PlantLike = None,
        model: str | Path | None = None,
        exact_state: bool = False,
        engine: str = "mujoco",
        render_mode: str | None = None,
        width: int = 640,
        height: int = 480,
        camera: str | None = "side",
    ) -> None:
        self.goal = postures.checked(goal, "goal")
        self.start = postures.checked_start(start, "start")
        super().__init__(
            plant=plant,
            model=model,
            exact_state=exact_state,
            engine=engine,
            render_mode=render_mode,
            width=width,
            height=height,
            camera=camera,
        )
        self.observation_space = spaces.Box(-np.inf, np.inf, (SIZE,), np.float64)

    def _start_state(self, start: Any, state: Any) -> State:
        return _start_state(self.np_random, start, state, self.start)

    @staticmethod
    def observation_of(state: Array) -> Array:
        """What is observed of states (..., 6), (..., 8)."""
        return observed(state)

    def _earned(self, state: State, volts: float) -> tuple[float, dict[str, Any]]:
        reward, terms, there = postures.earned(state, volts, self.goal, self._rig.rail, self._rig.plant.supply)
        return reward, {**terms, "at_goal": there}

    def _nothing_earned(self, diverged: bool) -> dict[str, Any]:
        return dict(postures.NOTHING)


class SwingUpVectorEnv(DIPCFrictionVectorEnv):
    """`DIPC-Friction-SwingUp-v0` many times over, as `DIPCFrictionVectorEnv` has `DIPC-Friction-v0`.

    Observations, rewards, endings and `info` are those of `SyncVectorEnv` around single environments, to the last bit.

    Args:
        num_envs: how many.
        goal: equilibrium to reach and hold.
        start: equilibrium to begin at, `anywhere`, or states (k, 6), of which each episode draws one.
        plant: as for the single environment; numbers may be distributions (`PlantFamily`).
        model: path of an MJCF file.
        exact_state: observe the simulation's state instead of encoder readings.
        max_episode_steps: steps after which an episode is truncated; None never truncates.
        autoreset_mode: `"NextStep"` (default), `"SameStep"` or `"Disabled"`, as Gymnasium defines them.
        engine: `"mujoco"`, its batch, or `"compiled"`.
        threads: that step the rigs; 0 is one a core.
        render_mode: None; the batch draws nothing.

    Raises:
        ValueError: no such start or goal, a count that is not positive, or a render mode.
        PlantError: the plant is impossible or its file is.
        MjcfError: the model is refused, or needs the single environment.

    Example:
        >>> import gymnasium, dipc_gym
        >>> envs = gymnasium.make_vec("DIPC-Friction-SwingUp-v0", 4, "vector_entry_point", goal="up-down")
        >>> observations, infos = envs.reset(seed=1)
        >>> envs.step(np.zeros((4, 1)))[4]["at_goal"].tolist()
        [False, False, False, False]
    """

    _balances = False
    _terms = {name: type(value) for name, value in postures.NOTHING.items()}  # noqa: RUF012

    def __init__(
        self,
        num_envs: int = 1,
        *,
        goal: str = "up-up",
        start: str | Sequence[Sequence[float]] = "down-down",
        plant: PlantLike = None,
        model: str | Path | None = None,
        exact_state: bool = False,
        max_episode_steps: int | None = None,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        engine: str = "mujoco",
        threads: int = 0,
        render_mode: str | None = None,
    ) -> None:
        self.goal = postures.checked(goal, "goal")
        self.start = postures.checked_start(start, "start")
        super().__init__(
            num_envs,
            plant=plant,
            model=model,
            exact_state=exact_state,
            max_episode_steps=max_episode_steps,
            autoreset_mode=autoreset_mode,
            engine=engine,
            threads=threads,
            render_mode=render_mode,
        )

    def _single(self, **arguments: Any) -> SwingUpEnv:
        return SwingUpEnv(goal=self.goal, start=self.start, **arguments)

    def _start_state(self, generator: np.random.Generator, start: Any, state: Any) -> State:
        return _start_state(generator, start, state, self.start)

    @staticmethod
    def observation_of(state: Array) -> Array:
        """What is observed of states (..., 6), (..., 8)."""
        return observed(state)

    def _rewarded(self, period: Period, going: Mask) -> Period:
        infos = dict(period.infos)
        for name in super()._terms:
            del infos[name]
        diverged = infos["diverged"]
        x, theta1, theta2, v, w1, w2 = np.where(diverged, 0.0, self._rigs.state.T)
        state = (x, theta1, theta2, v, w1, w2)
        supply = self._family.base.supply
        rewards, terms, there = postures.earned(state, infos["voltage"], self.goal, self._rail, supply)
        rewards = np.where(going & ~diverged, rewards, 0.0)
        terms = {name: np.where(diverged, 0.0, value) for name, value in terms.items()}
        infos |= {**terms, "at_goal": there & ~diverged}
        return dataclasses.replace(period, rewards=rewards, infos=infos)

    def _begin_terms(self, rows: NDArray[np.intp], infos: dict[str, Any]) -> None:
        pass


def _start_state(generator: np.random.Generator, start: Any, state: Any, own: postures.Start) -> State:
    begin = own if start is None else postures.checked_start(start, "options['start']")
    return postures.starting(generator, begin, state)
