"""A model compiled for a plant, and where the environment finds its cart and poles in it."""

from __future__ import annotations

import copy
import functools
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from dipc_gym import kernels, mjcf
from dipc_gym.physics import Physics, from_model
from dipc_gym.plant import Plant, physics_steps

NAMES = ("cart", "pole1", "pole2")
DIVERGED = 1e6  # no state of a rig is this large, in m, rad or their rates


@dataclass(frozen=True)
class Rig:
    """A cart with two poles as MuJoCo's compiled model has it.

    Attributes:
        source: text of the model, before the plant is written into it.
        plant: that is written into it.
        physics: the compiled model, with what stands under `<custom>`.
        steps: of the physics in a control period.
        motor: index among the controls.
        positions: of cart and joints among the positions.
        dofs: the same among the speeds.
        sensors: their readings among the sensors' data.
        joint_readings: whether readings are the joints' positions, which neither the model nor `<custom>` changes.
        ties: position and speed of what starts where another does, and of that: (one, other, one's speed, other's).
        rail: m from the middle to the nearer stop.
        frictionloss: whether the cart has dry friction that MuJoCo's constraints exert.
        passive: actuators of the cart without a command, and their gears.
        slips: of springs that yield, where their rests stand among those of all, and how far they go with each
            position.
    """

    source: mjcf.Source
    plant: Plant
    physics: Physics
    steps: int
    motor: int
    positions: tuple[int, ...]
    dofs: tuple[int, ...]
    sensors: tuple[int, ...]
    joint_readings: bool
    ties: tuple[tuple[int, int, int, int], ...]
    rail: float
    frictionloss: bool
    passive: tuple[tuple[int, float], ...]
    slips: tuple[tuple[int, tuple[float, ...]], ...]

    @property
    def model(self) -> mujoco.MjModel:
        """The compiled model."""
        return self.physics.model

    @functools.cached_property
    def endless(self) -> Physics:
        """Its physics on a rail without stops: an episode ends where those are."""
        model = copy.copy(self.model)
        model.jnt_limited[model.jnt_qposadr == self.positions[0]] = False
        return replace(self.physics, model=model)

    @classmethod
    def of(cls, source: mjcf.Source, plant: Plant) -> Rig:
        """Compile a model for a plant.

        Raises:
            MjcfError: the model lacks a sensor, or its rail does not reach to both sides.
            PlantError: the plant does not go with the model.
        """
        model = mjcf.compile(source.edited(plant.to_mjcf(source.text)), trusted=True)
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
        steps = physics_steps(plant.control_period, model.opt.timestep)
        physics = from_model(model, source.name)
        joints = []
        for name in NAMES:
            i = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SENSOR, name)
            if i < 0 or model.sensor_type[i] != mujoco.mjtSensor.mjSENS_JOINTPOS:
                raise mjcf.MjcfError(
                    f"{source.name}: needs a sensor <jointpos name='{name}' joint=.../>; the environment is a "
                    f"cart with two poles, and reads {', '.join(NAMES)}"
                )
            joints.append(int(model.sensor_objid[i]))
        cart = joints[0]
        low, high = map(float, model.jnt_range[cart] if model.jnt_limited[cart] else (-kernels.RAIL, kernels.RAIL))
        if not low < 0 < high:
            raise mjcf.MjcfError(
                f"{source.name}: joint {model.joint(cart).name!r} has range {low:g} to {high:g}; the rail must "
                "reach to both sides of 0, where episodes begin"
            )
        # What hides behind a gap or a spring starts where its joint does.
        ties = [(model.joint(one), model.joint(leader)) for one, leader in mjcf.followers(model).items()]
        return cls(
            source=source,
            plant=plant,
            physics=physics,
            steps=steps,
            motor=mjcf.controls(model).index("motor"),
            positions=tuple(int(model.jnt_qposadr[j]) for j in joints),
            dofs=tuple(int(model.jnt_dofadr[j]) for j in joints),
            sensors=tuple(int(model.sensor(name).adr[0]) for name in NAMES),
            joint_readings=not (
                physics.stage("sensor")
                or physics.stage("lag")
                or bool(np.any(model.sensor_delay > 0) or np.any(model.sensor_interval > 0))
            ),
            ties=tuple((int(a.qposadr[0]), int(b.qposadr[0]), int(a.dofadr[0]), int(b.dofadr[0])) for a, b in ties),
            rail=min(-low, high),
            frictionloss=bool(model.dof_frictionloss[int(model.jnt_dofadr[cart])] > 0 or physics.stage("friction")),
            passive=tuple(
                (i, mjcf.gear(model, i))
                for i in mjcf.passive_actuators(model)
                if model.actuator_trntype[i] == mujoco.mjtTrn.mjTRN_JOINT and model.actuator_trnid[i, 0] == cart
            ),
            slips=tuple((int(model.tendon_plasticadr[t]), _per_position(model, t)) for t in mjcf.yielding(model)),
        )


def _per_position(model: mujoco.MjModel, tendon: int) -> tuple[float, ...]:
    """How far a tendon goes with each position, (nq,); of hinges and slides there are as many as speeds."""
    found = np.zeros(model.nq)
    for joint, coefficient in mjcf.along(model, tendon):
        found[joint] += coefficient
    return tuple(found.tolist())
