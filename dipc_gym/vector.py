"""Many rigs at once: the environment on MuJoCo's batch, the same to the last bit."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import gymnasium
import mujoco
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from mujoco import batch as mjbatch
from numpy.typing import NDArray

from dipc_gym import kernels, mjcf
from dipc_gym.actions import many
from dipc_gym.env import DIVERGED, NAMES, DoublePendulumEnv, start_state
from dipc_gym.plant import Masses, Plant, PlantError
from dipc_gym.randomise import PlantFamily

__all__ = ["DIPCFrictionVectorEnv"]

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

COSTS = ("cost_cart", "cost_pole1", "cost_pole2", "cost_voltage")
INFO = ("reward_survive", *COSTS, "voltage", "friction", "time")  # and two flags


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
        model: path of an MJCF file, as for the single environment. Dry friction by `frictionloss`, delayed sensors and
            effects under `<custom>` are not for the batch: use `vectorization_mode="sync"`.
        exact_state: observe the simulation's state instead of encoder readings.
        max_episode_steps: steps after which an episode is truncated; None never truncates.
        autoreset_mode: `"NextStep"` (default), `"SameStep"` or `"Disabled"`, as Gymnasium defines them.
        threads: that step the batch; 0 is one a core.
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

    def __init__(
        self,
        num_envs: int = 1,
        *,
        plant: PlantFamily | Plant | Mapping[str, Any] | str | Path | None = None,
        model: str | Path | None = None,
        exact_state: bool = False,
        max_episode_steps: int | None = None,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        threads: int = 0,
        render_mode: str | None = None,
    ) -> None:
        if render_mode is not None:
            raise ValueError(
                f"render_mode is {render_mode!r}; the batch draws nothing: leave it None, or make it with "
                "vectorization_mode='sync'"
            )
        for name, value, least in (
            ("num_envs", num_envs, 1),
            ("max_episode_steps", 1 if max_episode_steps is None else max_episode_steps, 1),
            ("threads", threads, 0),
        ):
            if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < least:
                raise ValueError(f"{name} is {value!r}; it must be a whole number, {least} or more")
        # One rig knows names, addresses and spaces; it is never stepped.
        self._rig = rig = DoublePendulumEnv(plant=plant, model=model, exact_state=exact_state)
        self._family = rig._family
        # All rows share one layout, so all keep as much of the past as the longest delay asks for.
        rig._set_plant(dataclasses.replace(self._family.base, delay=self._family.longest_delay))
        if rig._physics.extras or rig._frictionloss or not rig._joint_readings:
            raise mjcf.MjcfError(
                f"{rig.source.name}: frictionloss of the cart, delayed sensors and <custom> effects do not run in the "
                "batch; make it with vectorization_mode='sync'"
            )
        self.num_envs, self.exact_state, self.max_episode_steps = int(num_envs), exact_state, max_episode_steps
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.metadata = {**rig.metadata, "render_modes": [], "autoreset_mode": self.autoreset_mode}
        self.single_observation_space, self.single_action_space = rig.observation_space, rig.action_space
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)

        self._sims = mjbatch.Batch(rig.model, self.num_envs, threads)
        self._ctrl, self._clock, self._force = (self._sims.bind(name) for name in ("ctrl", "time", "actuator_force"))
        self._sims.reset(stage=mujoco.mjtStage.mjSTAGE_NONE)
        self._new = self._sims.state[0].copy()  # written into rows that are reset, at a fifth of what a reset costs
        # MuJoCo's state begins with the time, qpos and qvel.
        first = 1 + rig.model.nq
        self._joints = np.array([*(1 + q for q in rig._qpos_address), *(first + dof for dof in rig._dof)])
        ties = [pair for q, led, dof, driven in rig._ties for pair in ((1 + q, 1 + led), (first + dof, first + driven))]
        self._followers, self._leaders = np.array(ties, dtype=np.intp).reshape(-1, 2).T
        self._generators: list[np.random.Generator | None] = [None] * self.num_envs
        self._seeds = [-1] * self.num_envs
        # The friction of motors without cogging is nothing where nothing has moved, so it need not be computed there.
        kind, numbers = rig.model.actuator_biastype, rig.model.actuator_biasprm
        self._free_at_rest = all(
            kind[i] == mujoco.mjtBias.mjBIAS_DCMOTOR and numbers[i, 0] == 0 for i, _ in rig._passive
        )
        n = self.num_envs
        self._plants = [rig.plant] * n
        self._numbers: _PlantNumbers | None = None
        # What is worked out at every step has rows for its last axis, which NumPy walks through faster.
        self._counts, self._noise, self._keep, self._gain = np.zeros((3, n)), *np.zeros((3, n))
        self._sense_as(np.arange(n), self._plants)
        # Readings of the encoders and velocities worked out from them; what is observed, unless the state is.
        self._measured = np.zeros((6, n))
        self._observed = np.zeros((6, n)) if exact_state else self._measured
        self._friction = np.zeros(n)
        self._can_fall, self._ended, self.began = (np.zeros(n, dtype=bool) for _ in range(3))
        self._steps = np.zeros(n, dtype=np.int64)

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
        infos: dict[str, Any] = {key: np.zeros(self.num_envs) for key in INFO}
        infos |= {key: np.zeros(self.num_envs, dtype=bool) for key in ("clipped", "diverged")}
        self._begin(rows, options, infos)
        self.began = mask
        return self._observations(), _masked(infos, mask)

    def step(self, actions: NDArray[Any]) -> tuple[Array, Array, Mask, Mask, dict[str, Any]]:
        """Hold a voltage in every row for one control period.

        Args:
            actions: (num_envs, 1) V.

        Raises:
            ValueError: the actions have another shape or are not finite.
            RuntimeError: autoreset is disabled and an ended episode was not reset.
        """
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
        self.began, self._ended = waiting, ended
        if self.autoreset_mode == AutoresetMode.SAME_STEP:
            self.began, self._ended = ended, np.zeros_like(ended)
            if ended.any():
                rows = np.flatnonzero(ended)
                final_obs, final_info = _final(self._observed.T, infos, ended)
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
        return _absolute(self._sims.state.T[self._joints]).T

    @property
    def measured_velocity(self) -> Array:
        """Velocities of the carts as last observed, (num_envs,) m/s."""
        return self._observed[3].copy()

    @property
    def encoders(self) -> Array:
        """Last readings of the encoders, (num_envs, 3), m and rad; the third is relative to the first pole."""
        readings = self._measured[:3].copy()
        readings[2] -= readings[1]
        return readings.T

    @property
    def time(self) -> Array:
        """Simulated time since each reset, (num_envs,) s."""
        return self._clock.reshape(self.num_envs).copy()

    @property
    def friction(self) -> Array:
        """Dry friction on each cart at the last physics step, (num_envs,) N."""
        return self._friction.copy()

    # -------------------------------------------------------------------------------------------- simulation

    def _advance(self, asked: Array, going: Mask) -> tuple[Array, Mask, Mask, dict[str, Any]]:
        """Step the rows that are `going`; what comes back for the others means nothing."""
        rig = self._rig
        supply, rail = self._family.base.supply, rig._rail
        volts = np.minimum(np.maximum(asked, -supply), supply)
        self._ctrl[:, rig._motor] = volts
        self._sims.step(None if going.all() else going, nstep=rig._nstep)
        joints = self._sims.state.T[self._joints]
        state = _absolute(joints.copy())
        size = np.abs(state)
        diverged = ~(size.sum(axis=0) < DIVERGED)
        fine = going & ~diverged
        if not fine.all():
            state[:, ~fine] = size[:, ~fine] = 0.0
        terms = kernels.costs(state[0], state[1], state[2], volts, rail, supply)
        fell = (size[1] > kernels.FALL) | (size[2] > kernels.FALL)
        terminated = going & ((size[0] >= rail) | (self._can_fall & fell) | diverged)
        self._measure(joints[:3], state, fine)
        self._steps += going
        limit = self.max_episode_steps
        truncated = np.zeros_like(going) if limit is None else going & (self._steps >= limit)
        rewards = np.where(fine, 1.0 - terms[0] - terms[1] - terms[2] - terms[3], 0.0)
        infos: dict[str, Any] = {"reward_survive": np.ones(self.num_envs), **dict(zip(COSTS, terms, strict=True))}
        self._friction = self._read_friction()
        infos |= {"friction": self.friction}
        if diverged.any():
            for value in infos.values():
                value[diverged] = 0.0
        infos |= {"voltage": volts, "clipped": volts != asked, "time": self.time, "diverged": diverged}
        return rewards, terminated, truncated, infos

    def _begin(self, rows: NDArray[np.intp], options: dict[str, Any], infos: dict[str, Any]) -> None:
        """Draw plants and states for `rows`, put them there, and note the `info` of their first moment."""
        plant, start, state = (options.pop(key, None) for key in ("plant", "start", "state"))
        if options:
            raise ValueError(
                f"unknown reset options {sorted(options)}; there are 'plant', 'start', 'state' and 'reset_mask'"
            )
        if start is not None and state is not None:
            raise ValueError("give either options['start'] or options['state'], not both")
        family = self._family if plant is None else self._fitting(PlantFamily.of(plant, base=self._family.base))
        plants, states = [], np.empty((len(rows), 6))
        for k, i in enumerate(rows.tolist()):
            generator = self._generator(i)
            plants.append(family.draw(generator))
            states[k] = start_state(generator, start, state)
        self._become(rows, plants)
        joints = states.copy()
        joints[:, 2] -= states[:, 1]
        joints[:, 5] -= states[:, 4]
        fresh = np.repeat(self._new[None], len(rows), axis=0)
        fresh[:, self._joints] = joints
        fresh[:, self._followers] = fresh[:, self._leaders]
        self._sims.state[rows] = fresh
        self._can_fall[rows] = (np.abs(states[:, 1:3]) <= kernels.FALL).all(axis=1)
        self._steps[rows], self._ended[rows] = 0, False
        joints = joints[:, :3]
        if self._noisy:
            joints += self._encoder_noise(rows)
        self._measured[:3, rows] = _readings(joints.T, self._counts[:, rows])
        self._measured[3:, rows] = states[:, 3:].T
        if self.exact_state:
            self._observed[:, rows] = states.T
        for value in infos.values():
            value[rows] = 0
        infos["reward_survive"][rows] = 1.0
        self._friction[rows] = 0.0
        if not self._free_at_rest or states[:, 3:].any():
            self._sims.forward(rows)
            self._friction[rows] = self._read_friction()[rows]
            infos["friction"][rows] = self._friction[rows]

    def _measure(self, joints: Array, state: Array, which: Mask) -> None:
        """Read the encoders of joints (3, n), update their velocity filters, and note what is observed of some rows."""
        if self._noisy:
            rows = np.flatnonzero(which)
            joints[:, rows] += self._encoder_noise(rows).T
        before, measured = self._measured, np.empty_like(self._measured)
        measured[:3] = _readings(joints, self._counts)
        measured[3:] = kernels.velocity(measured[:3], before[:3], before[3:], self._keep, self._gain)
        np.copyto(self._measured, measured, where=which)
        if self.exact_state:
            np.copyto(self._observed, state, where=which)

    def _observations(self) -> Array:
        """What is observed now, (num_envs, 6), as an array of its own."""
        return self._observed.T.copy()

    def _read_friction(self) -> Array:
        force = np.zeros(self.num_envs)
        for i, gear in self._rig._passive:
            force += gear * self._force[:, i]
        return force

    def _encoder_noise(self, rows: NDArray[np.intp]) -> Array:
        """What noise adds to the joints of rows before they are rounded, (rows, 3); drawn only where there is any."""
        noise = np.zeros((len(rows), 3))
        for k in np.flatnonzero(self._noise[rows] > 0):
            i = int(rows[k])
            noise[k] = self._noise[i] * self._counts[:, i] * self._generator(i).standard_normal(3)
        return noise

    # ------------------------------------------------------------------------------------------------ plants

    def _fitting(self, family: PlantFamily) -> PlantFamily:
        """The family, if all its plants have the layout of this batch."""
        mine, theirs = self._family.base, family.base
        if (theirs.supply, theirs.control_period) != (mine.supply, mine.control_period):
            raise PlantError("options['plant'] cannot change supply or control_period; make another environment")
        if family.longest_delay > self._family.longest_delay:
            raise PlantError(
                f"options['plant'] has a delay of up to {family.longest_delay:g} s; this environment was made for "
                f"{self._family.longest_delay:g} s"
            )
        if _actuators(theirs) != _actuators(mine):
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
        if self._numbers is None:
            self._numbers = _PlantNumbers(self._sims, self._rig)
        self._numbers.write(rows, plants)
        self._sense_as(rows, plants)
        for i, plant in zip(rows, plants, strict=True):
            self._plants[i] = plant

    def _sense_as(self, rows: NDArray[np.intp], plants: list[Plant]) -> None:
        for i, plant in zip(rows, plants, strict=True):
            encoders = plant.encoders
            self._counts[:, i], self._noise[i] = (encoders.cart, encoders.pole, encoders.pole), encoders.noise
            self._keep[i], self._gain[i] = kernels.velocity_gains(encoders.velocity_filter, plant.control_period)
        self._noisy = bool(self._noise.any())

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


class _PlantNumbers:
    """Writes plants into the rows of a batch, as compiling the text would, only a hundred times faster."""

    FIELDS = (
        "dof_damping",
        "actuator_gear",
        "actuator_gainprm",
        "actuator_biasprm",
        "actuator_dynprm",
        "actuator_delay",
        "body_mass",
        "body_inertia",
    )

    def __init__(self, sims: mjbatch.Batch, rig: DoublePendulumEnv) -> None:
        model = rig.model
        bare = dataclasses.replace(rig.plant, masses=Masses(), delay=0.0)
        self._nominal = mjcf.compile(rig.source.edited(bare.to_mjcf(rig.source.text)), trusted=True)
        self._delayed = bool((model.actuator_delay > 0).any())
        self._sims, self._fields = sims, {name: sims.expand(name) for name in self.FIELDS}
        self._motor, self._friction = (
            mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_ACTUATOR, name) for name in ("motor", "friction")
        )
        bodies = {name: mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name) for name in NAMES}
        self._bodies = {name: body for name, body in bodies.items() if body >= 0}
        self._cart_dof = rig._dof[0]

    def write(self, rows: NDArray[np.intp], plants: list[Plant]) -> None:
        field, nominal = self._fields, self._nominal
        for i, plant in zip(rows, plants, strict=True):
            motor, friction = plant.motor, plant.friction
            if motor is not None:
                field["actuator_gear"][i, self._motor, 0] = 1 / motor.pulley_radius
                field["actuator_gainprm"][i, self._motor, :2] = motor.resistance, motor.constant
            if friction is not None:
                field["dof_damping"][i, self._cart_dof] = friction.viscous
                if friction.coulomb > 0:
                    levels = friction.coulomb, friction.static, friction.stribeck_velocity
                    field["actuator_biasprm"][i, self._friction, 3:6] = levels
                    bristle = friction.bristle_stiffness, friction.bristle_damping
                    field["actuator_dynprm"][i, self._friction, 5:7] = bristle
            if self._delayed:
                field["actuator_delay"][i, self._motor] = plant.delay or nominal.actuator_delay[self._motor]
            masses = plant.masses.given()
            for name, body in self._bodies.items():
                mass = masses.get(name)
                scale = 1.0 if mass is None else mass / nominal.body_mass[body]
                field["body_mass"][i, body] = nominal.body_mass[body] if mass is None else mass
                field["body_inertia"][i, body] = nominal.body_inertia[body] * scale
        self._sims.set_const(rows)


def _actuators(plant: Plant) -> tuple[bool, bool | None]:
    return plant.motor is None, None if plant.friction is None else plant.friction.coulomb > 0


def _absolute(joints: Array) -> Array:
    """Positions and velocities of joints, (6, rows), with those of the second pole made absolute in place."""
    joints[2] += joints[1]
    joints[5] += joints[4]
    return joints


def _readings(joints: Array, counts: Array) -> Array:
    """What encoders with these counts say of joints, (3, rows); the second angle is absolute, as the first is."""
    readings = kernels.quantise(joints, counts)
    readings[2] += readings[1]
    return readings


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
