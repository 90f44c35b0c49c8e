"""Many rigs at once: the environment on MuJoCo's batch, the same to the last bit."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from dipc_gym import kernels
from dipc_gym.env import DoublePendulumEnv, State, start_state, unknown_options
from dipc_gym.plant import Plant, PlantError
from dipc_gym.randomise import PlantFamily
from dipc_gym.rigs import ENGINES, unknown_engine
from dipc_gym.rigs.rig import Rig
from dipc_gym.rigs.together import COSTS, Encoders, Period, Rigs
from dipc_gym.safety.actions import many

__all__ = ["DIPCFrictionVectorEnv"]

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

TERMS = {"reward_survive": float, **dict.fromkeys(COSTS, float)}
SHARED = {**dict.fromkeys(("voltage", "friction", "time"), float), "clipped": bool, "diverged": bool}


class DIPCFrictionVectorEnv(VectorEnv[Array, NDArray[np.float32], NDArray[Any]]):
    """`DIPC-Friction-v0` many times over, stepped inside MuJoCo's batch on all cores.

    Observations, rewards, endings and `info` are those of `SyncVectorEnv` around single environments, to the last bit;
    `DoublePendulumEnv` describes them. Each row has its own random generator, seeded with `seed + row`, its own hidden
    friction state and, where the plant has distributions, its own plant, drawn at every reset.

    `reset(options=...)` takes what the single environment takes, for all rows that are reset, and `reset_mask` (bool,
    one a row). A `plant` given there must have the actuators of the environment's own, and its supply and period.

    Args:
        num_envs: how many.
        plant: as for the single environment; numbers may be distributions (`PlantFamily`).
        model: path of an MJCF file, as for the single environment, with what stands under `<custom>`. Sensors that are
            delayed, or changed there, are not for the batch, nor is frictionloss of the cart beside tendon limits or
            equalities: use `vectorization_mode="sync"`. With frictionloss, the `friction` of the step in which the cart
            meets the rail's end holds what the stop does to it.
        exact_state: observe the simulation's state instead of encoder readings.
        max_episode_steps: steps after which an episode is truncated; None never truncates.
        autoreset_mode: `"NextStep"` (default), `"SameStep"` or `"Disabled"`, as Gymnasium defines them.
        engine: `"mujoco"`, its batch, or `"compiled"`, as for the single environment.
        threads: that step the rigs; 0 is one a core.
        render_mode: None; the batch draws nothing.

    Raises:
        ValueError: a count that is not positive, or a render mode.
        PlantError: the plant is impossible or its file is.
        MjcfError: the model is refused, or needs the single environment.

    Example:
        >>> import gymnasium, dipc_gym
        >>> envs = gymnasium.make_vec("DIPC-Friction-v0", num_envs=64, vectorization_mode="vector_entry_point")
        >>> observations, infos = envs.reset(seed=1)
        >>> observations, rewards, terminations, truncations, infos = envs.step(np.zeros((64, 1)))
        >>> observations.shape
        (64, 6)
    """

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012

    _terms: Mapping[str, type] = TERMS  # of the reward, in `info`
    _balances = True

    def __init__(
        self,
        num_envs: int = 1,
        *,
        plant: PlantFamily | Plant | Mapping[str, Any] | str | Path | None = None,
        model: str | Path | None = None,
        exact_state: bool = False,
        max_episode_steps: int | None = None,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        engine: str = "mujoco",
        threads: int = 0,
        render_mode: str | None = None,
    ) -> None:
        if render_mode is not None:
            raise ValueError(
                f"render_mode is {render_mode!r}; the batch draws nothing: leave it None, or make it with "
                "vectorization_mode='sync'"
            )
        if engine not in list(ENGINES):
            raise ValueError(unknown_engine(engine))
        for name, value, least in (
            ("num_envs", num_envs, 1),
            ("max_episode_steps", 1 if max_episode_steps is None else max_episode_steps, 1),
            ("threads", threads, 0),
        ):
            if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < least:
                raise ValueError(f"{name} is {value!r}; it must be a whole number, {least} or more")
        # One environment knows names, numbers and spaces; it is never stepped.
        one = self._single(plant=plant, model=model, exact_state=exact_state)
        self._family = one.family
        # All rows share one layout, so all keep as much of the past as the longest delay asks for.
        base, delay = self._family.base, self._family.longest_delay
        longest = base if delay == base.delay else dataclasses.replace(base, delay=delay)
        rig = one.rig if longest is base else Rig.of(one.source, longest)
        self._rail = rig.rail
        self.num_envs, self.exact_state, self.max_episode_steps = int(num_envs), exact_state, max_episode_steps
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.metadata = {**one.metadata, "render_modes": [], "autoreset_mode": self.autoreset_mode}
        self.single_observation_space, self.single_action_space = one.observation_space, one.action_space
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)

        self._generators: list[np.random.Generator | None] = [None] * self.num_envs
        self._seeds = [-1] * self.num_envs
        n = self.num_envs
        self._plants = [longest] * n
        self._encoders = Encoders(n)
        self._encoders.become(np.arange(n), self._plants)
        self._noisy = bool(self._encoders.noise.any())
        self._rigs: Rigs = ENGINES[engine](rig, self._encoders, exact_state=exact_state, threads=threads)
        self._ended, self.began = np.zeros((2, n), dtype=bool)
        self._last, self._over = np.zeros((n, 3)), np.zeros(n, dtype=bool)
        self._steps = np.zeros(n, dtype=np.int64)
        self._was_reset = np.zeros(n, dtype=bool)

    # ------------------------------------------------------------------------------------------------ Gymnasium

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """Start episodes, in all rows or those of `options["reset_mask"]`.

        Args:
            seed: of the first row, the others counting up from it; or one a row.
            options: see the class.

        Raises:
            ValueError: an unknown option, a mask or seeds that do not fit.
            PlantError: `options["plant"]` is impossible, or not for this batch.
        """
        options = dict(options or {})
        mask = self._mask(options.pop("reset_mask", None))
        if seed is None or isinstance(seed, (int, np.integer)):
            seeds = [None if seed is None else int(seed) + i for i in range(self.num_envs)]
        else:
            seeds = list(seed)
        if len(seeds) != self.num_envs:
            raise ValueError(f"{len(seeds)} seeds for {self.num_envs} environments; give one each, or a single number")
        rows = np.flatnonzero(mask)
        for i in rows:
            if seeds[i] is not None:
                self._generators[i], self._seeds[i] = gymnasium.utils.seeding.np_random(seeds[i])
        infos: dict[str, Any] = {
            key: np.zeros(self.num_envs, dtype=kind) for key, kind in {**self._terms, **SHARED}.items()
        }
        self._begin(rows, options, infos)
        self.began, self._over = mask, np.zeros_like(mask)
        self._was_reset |= mask
        return self._observations(), _masked(infos, mask)

    def step(self, actions: NDArray[Any]) -> tuple[Array, Array, Mask, Mask, dict[str, Any]]:
        """Hold a voltage in every row for one control period.

        Args:
            actions: (num_envs, 1) V.

        Raises:
            ValueError: the actions have another shape or are not finite.
            RuntimeError: autoreset is disabled and an ended episode was not reset.
            gymnasium.error.ResetNeeded: a row was never reset.
        """
        if not self._was_reset.all():
            row = int(np.flatnonzero(~self._was_reset)[0])
            raise gymnasium.error.ResetNeeded(f"call reset() before the first step(); row {row} was never reset")
        asked = many(actions, "voltage", self.num_envs)
        waiting = self._ended.copy()
        if self.autoreset_mode == AutoresetMode.DISABLED and waiting.any():
            raise RuntimeError(
                f"the episode of row {int(np.flatnonzero(waiting)[0])} is over; "
                "reset it with options={'reset_mask': ...}"
            )
        with np.errstate(over="ignore", invalid="ignore"):  # of simulations that diverge
            rewards, terminated, truncated, infos = self._advance(asked, ~waiting)
        if waiting.any():
            rows = np.flatnonzero(waiting)
            self._begin(rows, {}, infos)
        ended = terminated | truncated
        everywhere = np.ones(self.num_envs, dtype=bool)
        self.began, self._ended, self._over = waiting, ended, np.zeros_like(ended)
        if self.autoreset_mode == AutoresetMode.SAME_STEP:
            self.began, self._ended = ended, np.zeros_like(ended)
            if ended.any():
                rows = np.flatnonzero(ended)
                final_obs, final_info = _final(self._observations(), infos, ended)
                self._last, self._over = self.encoders, ended
                self._begin(rows, {}, infos)
                infos = _masked(infos, everywhere)
                infos |= {"final_obs": final_obs, "_final_obs": ended.copy()}
                infos |= {"final_info": final_info, "_final_info": ended.copy()}
                return self._observations(), rewards, terminated, truncated, infos
        return self._observations(), rewards, terminated, truncated, _masked(infos, everywhere)

    # ------------------------------------------------------------------------------- what wrappers may ask for

    @property  # type: ignore[misc]
    def np_random(self) -> tuple[np.random.Generator, ...]:  # type: ignore[override]
        """The random generator of each row."""
        return tuple(self._generator(i) for i in range(self.num_envs))

    @property
    def np_random_seed(self) -> tuple[int, ...]:  # type: ignore[override]
        """The seed of each row's generator."""
        self.np_random  # noqa: B018  makes the generators that were not seeded
        return tuple(self._seeds)

    @property
    def plant(self) -> Plant:
        """The plant with the centre of every distribution."""
        return self._family.base

    @property
    def plants(self) -> tuple[Plant, ...]:
        """The plant of each row's episode."""
        return tuple(self._plants)

    @property
    def state(self) -> Array:
        """The simulations' exact states, (num_envs, 6), as the observation orders them."""
        return self._rigs.state

    @property
    def waiting(self) -> Mask:
        """Rows whose episode is over, and which the next step begins anew, whatever it is told, (num_envs,)."""
        return self._ended.copy()

    @property
    def measured_state(self) -> Array:
        """States as last observed, (num_envs, 6): cart, absolute angles, which count turns, and their rates."""
        return self._rigs.observations()

    @staticmethod
    def observation_of(state: Array) -> Array:
        """What the environment observes of states (..., 6)."""
        return state

    @property
    def measured_velocity(self) -> Array:
        """Velocities of the carts as last observed, (num_envs,) m/s."""
        return self._rigs.observations()[:, 3]

    @property
    def encoders(self) -> Array:
        """Last readings of the encoders, (num_envs, 3), m and rad; the third is relative to the first pole."""
        readings = self._rigs.measured[:3]
        readings[2] -= readings[1]
        return readings.T

    @property
    def last_encoders(self) -> Array:
        """The same (num_envs, 3), but of rows whose episode ended in this step what they read in the end."""
        return np.where(self._over[:, None], self._last, self.encoders)

    @property
    def time(self) -> Array:
        """Simulated time since each reset, (num_envs,) s."""
        return self._rigs.time

    @property
    def friction(self) -> Array:
        """Dry friction on each cart at the last physics step, (num_envs,) N."""
        return self._rigs.friction

    # --------------------------------------------------------------------- what makes a task of the rigs

    def _single(self, **arguments: Any) -> DoublePendulumEnv:
        """One environment of the task."""
        return DoublePendulumEnv(**arguments)

    def _start_state(self, generator: np.random.Generator, start: Any, state: Any) -> State:
        """The state in which an episode starts, as the reset options `start` and `state` want it."""
        return start_state(generator, start, state)

    def _observations(self) -> Array:
        """What is observed now, (num_envs, k), as an array of its own."""
        return self.observation_of(self._rigs.observations())

    def _rewarded(self, period: Period, going: Mask) -> Period:
        """What the task makes of a period, in the place of the balancing one's rewards and terms."""
        return period

    def _begin_terms(self, rows: NDArray[np.intp], infos: dict[str, Any]) -> None:
        """Note the terms of rows at a reset; they are zero so far."""
        infos["reward_survive"][rows] = 1.0

    # -------------------------------------------------------------------------------------------- simulation

    def _advance(self, asked: Array, going: Mask) -> tuple[Array, Mask, Mask, dict[str, Any]]:
        """Step the rows that are `going`; what comes back for the others means nothing."""
        period = self._rewarded(self._rigs.advance(asked, going, self._noise_of if self._noisy else None), going)
        self._steps += going
        limit = self.max_episode_steps
        truncated = np.zeros_like(going) if limit is None else going & (self._steps >= limit)
        return period.rewards, period.terminated, truncated, period.infos

    def _noise_of(self, which: Mask) -> Array:
        """What noise adds to the joints' readings of some rows, (3, n)."""
        noise, rows = np.zeros((3, self.num_envs)), np.flatnonzero(which)
        noise[:, rows] = self._encoder_noise(rows).T
        return noise

    def _begin(self, rows: NDArray[np.intp], options: dict[str, Any], infos: dict[str, Any]) -> None:
        """Draw plants and states for `rows`, put them there, and note the `info` of their first moment."""
        plant, start, state = (options.pop(key, None) for key in ("plant", "start", "state"))
        if options:
            raise ValueError(unknown_options(options, ("plant", "start", "state", "reset_mask")))
        if start is not None and state is not None:
            raise ValueError("give either options['start'] or options['state'], not both")
        family = self._family if plant is None else self._fitting(PlantFamily.of(plant, base=self._family.base))
        plants, states = [], np.empty((len(rows), 6))
        for k, i in enumerate(rows.tolist()):
            generator = self._generator(i)
            plants.append(family.draw(generator))
            states[k] = self._start_state(generator, start, state)
        self._become(rows, plants)
        can_fall: Mask = self._balances & np.all(np.abs(states[:, 1:3]) <= kernels.FALL, axis=1)
        noise = self._encoder_noise(rows) if self._noisy else np.zeros((len(rows), 3))
        self._steps[rows], self._ended[rows] = 0, False
        for value in infos.values():
            value[rows] = 0
        self._begin_terms(rows, infos)
        infos["friction"][rows] = self._rigs.begin(rows, states, can_fall, noise)

    def _encoder_noise(self, rows: NDArray[np.intp]) -> Array:
        """What noise adds to the joints of rows before they are rounded, (rows, 3); drawn only where there is any."""
        noise = np.zeros((len(rows), 3))
        own = self._encoders
        for k in np.flatnonzero(own.noise[rows] > 0):
            i = int(rows[k])
            noise[k] = own.noise[i] * own.counts[:, i] * self._generator(i).standard_normal(3)
        return noise

    # ------------------------------------------------------------------------------------------------ plants

    def _fitting(self, family: PlantFamily) -> PlantFamily:
        """The family, if all its plants have the layout of this batch."""
        mine, theirs = self._family.base, family.base
        family.check_fixed(mine)
        if family.longest_delay > self._family.longest_delay:
            raise PlantError(
                f"options['plant'] has a delay of up to {family.longest_delay:g} s; this environment was made for "
                f"{self._family.longest_delay:g} s"
            )
        if theirs.layout != mine.layout:
            raise PlantError("options['plant'] adds or removes an actuator; make another environment for it")
        return family

    def _become(self, rows: NDArray[np.intp], plants: list[Plant]) -> None:
        """Give plants to rows."""
        # Without distributions all share one plant; comparing it field by field would be most of a reset.
        changed = [
            k for k, i in enumerate(rows.tolist()) if self._plants[i] is not plants[k] and self._plants[i] != plants[k]
        ]
        if not changed:
            return
        rows, plants = rows[changed], [plants[k] for k in changed]
        self._encoders.become(rows, plants)
        self._noisy = bool(self._encoders.noise.any())
        self._rigs.become(rows, plants)
        for i, plant in zip(rows, plants, strict=True):
            self._plants[i] = plant

    # ------------------------------------------------------------------------------------------------ details

    def _generator(self, row: int) -> np.random.Generator:
        generator = self._generators[row]
        if generator is None:
            generator, self._seeds[row] = gymnasium.utils.seeding.np_random()
            self._generators[row] = generator
        return generator

    def _mask(self, mask: Any) -> Mask:
        if mask is None:
            return np.ones(self.num_envs, dtype=bool)
        if not isinstance(mask, np.ndarray) or mask.dtype != np.bool_ or mask.shape != (self.num_envs,):
            raise ValueError(f"options['reset_mask'] must be a boolean array of shape ({self.num_envs},)")
        if not mask.any():
            raise ValueError("options['reset_mask'] selects no environment")
        return mask.copy()


def _masked(infos: dict[str, Any], mask: Mask) -> dict[str, Any]:
    """Every value with the mask of the rows it is given for, as Gymnasium wants it."""
    return infos | {f"_{key}": mask.copy() for key in infos}


def _final(observed: Array, infos: dict[str, Any], ended: Mask) -> tuple[NDArray[np.object_], dict[str, Any]]:
    """Last observation and `info` of the episodes that ended, as Gymnasium's vector environments give them."""
    final_obs = np.full(len(ended), None, dtype=object)
    for i in np.flatnonzero(ended):
        final_obs[i] = observed[i].copy()
    kept = {key: np.where(ended, value, np.zeros_like(value)) for key, value in infos.items()}
    return final_obs, _masked(kept, ended)
