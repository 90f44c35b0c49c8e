"""Rigs in MuJoCo's batch."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import mujoco
import numpy as np
from mujoco import batch as mjbatch

from dipc_gym import kernels, mjcf
from dipc_gym.physics import stack
from dipc_gym.plant import Masses, Plant, bristles, worked_out
from dipc_gym.rigs.rig import DIVERGED, NAMES, Rig
from dipc_gym.rigs.together import COSTS, Array, Encoders, Mask, Period, Rows, absolute, readings


class MujocoRigs:
    """Rigs of one layout; see `together.Rigs`.

    Args:
        rig: that knows the model; its plant has the longest delay.
        encoders: theirs, one a rig.
        exact_state: whether the state is observed.
        threads: 0 for one a core.

    Raises:
        MjcfError: the model needs the single environment.
    """

    def __init__(self, rig: Rig, encoders: Encoders, *, exact_state: bool, threads: int) -> None:
        tied = rig.model.neq or rig.model.tendon_limited.any() or rig.model.tendon_frictionloss.any()
        for left_out, there in (
            ("delayed sensors, and what <custom> does to sensors,", not rig.joint_readings),
            ("frictionloss of the cart beside other constraints", rig.frictionloss and tied),
        ):
            if there:
                raise mjcf.MjcfError(
                    f"{rig.source.name}: {left_out} do not run in the batch; make it with vectorization_mode='sync'"
                )
        n = len(encoders.noise)
        self.rig, self._encoders, self.count = rig, encoders, n
        self.sims = mjbatch.Batch(rig.model, n, threads)
        self._ctrl, self._clock, self._force = (self.sims.bind(name) for name in ("ctrl", "time", "actuator_force"))
        self.sims.reset(stage=mujoco.mjtStage.mjSTAGE_NONE)
        self._new = self.sims.state[0].copy()  # written into rows that are reset, at a fifth of what a reset costs
        # MuJoCo's state begins with the time, qpos and qvel.
        first = 1 + rig.model.nq
        self._joints = np.array([*(1 + q for q in rig.positions), *(first + dof for dof in rig.dofs)])
        ties = [pair for q, led, dof, driven in rig.ties for pair in ((1 + q, 1 + led), (first + dof, first + driven))]
        self._followers, self._leaders = np.array(ties, dtype=np.intp).reshape(-1, 2).T
        # The friction of motors without cogging is nothing where nothing has moved, so it need not be computed there.
        self._free_at_rest = free_at_rest(rig)
        self._numbers: _PlantNumbers | None = None
        # Readings of the encoders and velocities worked out from them; what is observed, unless the state is.
        self._measured = np.zeros((6, n))
        self._observed = np.zeros((6, n)) if exact_state else self._measured
        self._exact = exact_state
        self._friction, self._can_fall = np.zeros(n), np.zeros(n, dtype=bool)
        self._physics = stack([rig.physics], np.zeros(n, dtype=np.intp))
        self._held = self.sims.bind("qfrc_constraint") if rig.frictionloss else None
        self._level = self.sims.expand("dof_frictionloss") if rig.physics.stage("friction") else np.zeros((n, 0))
        self._applied = self.sims.bind("qfrc_applied") if rig.physics.stage("force") else np.zeros((n, 0))
        if rig.physics.pressed:
            self.sims.bind("qfrc_actuator"), self.sims.bind("actuator_force"), self.sims.bind("qfrc_bias")
        if rig.physics.remembering:
            self.sims.bind("qacc")

    @property
    def time(self) -> Array:
        """Since each reset, (n,) s."""
        return self._clock.reshape(self.count).copy()

    @property
    def friction(self) -> Array:
        """Dry friction on each cart at the last physics step, (n,) N."""
        return self._friction.copy()

    @property
    def state(self) -> Array:
        """Exact states, (n, 6), as observed."""
        return absolute(self.sims.state.T[self._joints]).T

    @property
    def measured(self) -> Array:
        """Readings of the encoders, angles absolute, and velocities worked out from them, (6, n)."""
        return self._measured.copy()

    def observations(self) -> Array:
        """What is observed now, (n, 6), as an array of its own."""
        return self._observed.T.copy()

    def become(self, rows: Rows, plants: Sequence[Plant]) -> None:
        """Give plants to rows, whose encoders have them already."""
        if self._numbers is None:
            self._numbers = _PlantNumbers(self.sims, self.rig)
        self._numbers.write(rows, plants)

    def begin(self, rows: Rows, states: Array, can_fall: Mask, noise: Array) -> Array:
        """Put rows into states (rows, 6), the motor at rest; the dry friction there, (rows,) N."""
        joints = states.copy()
        joints[:, 2] -= states[:, 1]
        joints[:, 5] -= states[:, 4]
        fresh = np.repeat(self._new[None], len(rows), axis=0)
        fresh[:, self._joints] = joints
        fresh[:, self._followers] = fresh[:, self._leaders]
        self.sims.state[rows] = fresh
        for address, along in self.rig.slips:  # unbent where the episode begins
            self.sims.plastic[rows, address : address + 2] = (fresh[:, 1 : 1 + len(along)] @ along)[:, None]
        self._can_fall[rows] = can_fall
        self._measured[:3, rows] = readings((joints[:, :3] + noise).T, self._encoders.counts[:, rows])
        self._measured[3:, rows] = states[:, 3:].T
        if self._exact:
            self._observed[:, rows] = states.T
        self._friction[rows] = 0.0
        # What laws remember goes on with the acceleration of the moment, which must not be that of another episode.
        if not self._free_at_rest or states[:, 3:].any() or self.rig.physics.remembering:
            self.sims.forward(rows)
            self._friction[rows] = self._read_friction()[rows]
        return self._friction[rows]

    def advance(self, asked: Array, going: Mask, noise: Callable[[Mask], Array] | None) -> Period:
        """Hold voltages for one control period; what is said of rows that are not `going` means nothing."""
        rig = self.rig
        supply, rail = rig.plant.supply, rig.rail
        volts = np.minimum(np.maximum(asked, -supply), supply)
        self._ctrl[:, rig.motor] = volts
        self._step(None if going.all() else going)
        joints = self.sims.state.T[self._joints]
        state = absolute(joints.copy())
        size = np.abs(state)
        diverged = ~(size.sum(axis=0) < DIVERGED)
        fine = going & ~diverged
        if not fine.all():
            state[:, ~fine] = size[:, ~fine] = 0.0
        terms = kernels.costs(state[0], state[1], state[2], volts, rail, supply)
        fell = (size[1] > kernels.FALL) | (size[2] > kernels.FALL)
        terminated = going & ((size[0] >= rail) | (self._can_fall & fell) | diverged)
        if noise is not None:
            joints[:3] += noise(fine)
        self._measure(joints[:3], state, fine)
        rewards = np.where(fine, 1.0 - terms[0] - terms[1] - terms[2] - terms[3], 0.0)
        infos: dict[str, Any] = {"reward_survive": np.ones(self.count), **dict(zip(COSTS, terms, strict=True))}
        self._friction = self._read_friction()
        infos |= {"friction": self.friction}
        if diverged.any():
            for value in infos.values():
                value[diverged] = 0.0
        infos |= {"voltage": volts, "clipped": volts != asked, "time": self.time, "diverged": diverged}
        return Period(rewards, terminated, infos)

    def _step(self, going: Mask | None) -> None:
        """Hold the commands for a control period, with what stands under `<custom>`."""
        physics, steps = self._physics, self.rig.steps
        if physics.stage("command"):
            self._ctrl[:] = physics.command(self._ctrl, self.sims.time)
        if not physics.acts:
            self.sims.step(going, nstep=steps)
            return
        for _ in range(steps):
            physics.act(self.sims, self._level, self._applied, self.rig.model.opt.timestep)
            self.sims.step(going)

    def _measure(self, joints: Array, state: Array, which: Mask) -> None:
        """Read the encoders of joints (3, n), update their velocity filters, and note what is observed of some rows."""
        own, before, measured = self._encoders, self._measured, np.empty_like(self._measured)
        measured[:3] = readings(joints, own.counts)
        measured[3:] = kernels.velocity(measured[:3], before[:3], before[3:], own.keep, own.gain)
        np.copyto(self._measured, measured, where=which)
        if self._exact:
            np.copyto(self._observed, state, where=which)

    def _read_friction(self) -> Array:
        force = np.zeros(self.count)
        for i, gear in self.rig.passive:
            force += gear * self._force[:, i]
        if self._held is not None:
            cart = self.rig.dofs[0]
            most = self._level[:, cart] if self._level.size else self.rig.model.dof_frictionloss[cart]
            force += np.clip(self._held[:, cart], -most, most)  # the rail's stop pushes on the cart as well
        return force


def free_at_rest(rig: Rig) -> bool:
    """Whether a cart on which nothing has moved feels no dry friction, as without cogging."""
    kind, numbers = rig.model.actuator_biastype, rig.model.actuator_biasprm
    return not (rig.frictionloss or rig.physics.pressed) and all(
        kind[i] == mujoco.mjtBias.mjBIAS_DCMOTOR and numbers[i, 0] == 0 for i, _ in rig.passive
    )


class _PlantNumbers:
    """Writes plants into the rows of a batch, as compiling the text would, only a hundred times faster."""

    FIELDS = (
        "dof_damping",
        "actuator_gear",
        "actuator_gainprm",
        "actuator_biasprm",
        "actuator_dynprm",
        "actuator_delay",
        "actuator_forcerange",
        "body_mass",
        "body_inertia",
    )

    def __init__(self, sims: mjbatch.Batch, rig: Rig) -> None:
        model = rig.model
        self._nominal = Rig.of(rig.source, dataclasses.replace(rig.plant, masses=Masses(), delay=0.0)).model
        self._delayed = bool((model.actuator_delay > 0).any())
        self._sims, self._fields = sims, {name: sims.expand(name) for name in self.FIELDS}
        self._motor, self._friction = (
            mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_ACTUATOR, name)
            for name in ("motor", bristles(rig.source.text) or "friction")
        )
        self._gear = int(model.actuator_outadr[self._motor])
        self._inductance, self._current = worked_out(rig.source.text)
        bodies = {name: mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name) for name in NAMES}
        self._bodies = {name: body for name, body in bodies.items() if body >= 0}
        self._cart_dof = rig.dofs[0]

    def write(self, rows: Rows, plants: Sequence[Plant]) -> None:
        field, nominal = self._fields, self._nominal
        for i, plant in zip(rows, plants, strict=True):
            motor, friction = plant.motor, plant.friction
            if motor is not None:
                field["actuator_gear"][i, self._gear, 0] = 1 / motor.pulley_radius
                field["actuator_gainprm"][i, self._motor, :2] = motor.resistance, motor.constant
                if self._inductance > 0:
                    field["actuator_dynprm"][i, self._motor, 0] = self._inductance / motor.resistance
                if self._current > 0:
                    most = motor.constant * self._current
                    field["actuator_forcerange"][i, self._motor] = -most, most
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
