"""Plants as numbers of the engine: what reading a model compiled for each would give, only a thousand times faster."""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Sequence

import mujoco
import numpy as np

from dipc_gym import mjcf
from dipc_gym.engine import rigid
from dipc_gym.engine.layout import Element, Force, Head, Joint
from dipc_gym.engine.program import Program
from dipc_gym.plant import Masses, Plant, bristles, worked_out
from dipc_gym.rigs.rig import NAMES, Rig
from dipc_gym.rigs.together import Array


class PlantNumbers:
    """Parameters of plants of one layout.

    Args:
        rig: whose model the program is of.
        program: its structure.
        parameters: its own, (k,).
    """

    def __init__(self, rig: Rig, program: Program, parameters: Array) -> None:
        model, dof = rig.model, rig.dofs[0]
        bare = Rig.of(rig.source, dataclasses.replace(rig.plant, masses=Masses(), delay=0.0)).model
        self._nominal = parameters.copy()
        self._delay = int(program.codes[Head.DELAYS]) + rig.motor
        self._own_delay = float(bare.actuator_delay[rig.motor])
        first = int(program.codes[Head.JOINT_NUMBERS]) + dof * int(Joint.SIZE)
        self._damping, self._armature = slice(first + Joint.DAMPING, first + Joint.STIFFNESS), first + Joint.ARMATURE
        dry = bristles(rig.source.text) or "friction"
        self._motor, self._friction = (_element(model, program, name) for name in ("motor", dry))
        self._inductance, self._current = worked_out(rig.source.text)
        # The joint feels damping and armature of one actuator, by the square of its gear.
        by = int(model.jnt_actuatorid[int(model.dof_jntid[dof])])
        self._by_motor = by >= 0 and model.actuator(by).name == "motor"
        self._per_gear, self._armature_per_gear, self._own_gear = np.zeros(3), 0.0, 0.0
        if by >= 0:
            self._own_gear = mjcf.gear(model, by)
            self._per_gear[:] = model.actuator_damping[by], *np.ravel(model.actuator_dampingpoly[by])
            self._armature_per_gear = float(model.actuator_armature[by])
        self._own_damping = np.array([model.dof_damping[dof], *np.ravel(model.dof_dampingpoly[dof])])
        self._own_armature = float(model.dof_armature[dof])
        self._damped = not model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_DAMPER
        # First and second moments grow in proportion to the masses of the bodies on a link.
        self._bodies = {}
        for name in NAMES:
            body = mujoco.mj_name2id(bare, mujoco.mjtObj.mjOBJ_BODY, name)
            if body >= 0 and bare.body_mass[body] > 0:
                self._bodies[name] = float(bare.body_mass[body]), _moments(bare, [body])
        others = [b for b in range(bare.nbody) if bare.body(b).name not in self._bodies]
        self._other_moments = _moments(bare, others)

    def of(self, plants: Sequence[Plant]) -> Array:
        """Parameters, (plants, k)."""
        out = np.repeat(self._nominal[None], len(plants), axis=0)
        for numbers, plant in zip(out, plants, strict=True):
            motor, friction, damping, gear = plant.motor, plant.friction, self._own_damping.copy(), self._own_gear
            if motor is not None:
                at = self._motor
                numbers[at + Force.GAIN], numbers[at + Force.GAIN + 1] = motor.resistance, motor.constant
                numbers[at + Force.SIZE] = 1 / motor.pulley_radius
                if self._inductance > 0:
                    numbers[at + Force.TIME] = self._inductance / motor.resistance
                if self._current > 0:
                    most = motor.constant * self._current
                    numbers[at + Force.LOWEST], numbers[at + Force.HIGHEST] = -most, most
                gear = 1 / motor.pulley_radius if self._by_motor else gear
            if friction is not None:
                damping[0] = friction.viscous
                if friction.coulomb > 0:
                    first = self._friction + Force.BRISTLES
                    numbers[first : first + 3] = friction.coulomb, friction.static, friction.stribeck_velocity
                    numbers[first + 3 : first + 5] = friction.bristle_stiffness, friction.bristle_damping
            numbers[self._damping] = (damping + self._per_gear * gear**2) * self._damped
            numbers[self._armature] = self._own_armature + self._armature_per_gear * gear**2
            numbers[self._delay] = plant.delay or self._own_delay
            masses, links = plant.masses.given(), self._other_moments
            for name, (nominal, own) in self._bodies.items():
                mass = masses.get(name)
                links = links + (own if mass is None else own * (mass / nominal))
            tree = numbers[rigid.GRAVITY : rigid.GRAVITY + rigid.LINK * len(links)].reshape(-1, rigid.LINK)
            tree[:, _MASS:] = links
        return out


_MASS = 13  # of a link's numbers, from which on they come of masses


def _element(model: mujoco.MjModel, program: Program, name: str) -> int:
    """Index of an actuator's first parameter, -1 where it is not there."""
    actuator = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_ACTUATOR, name)
    if actuator < 0:
        return -1
    codes, element = program.codes, program.actuators[actuator]
    if element < 0:  # a ramp, which no plant changes
        return -1
    return int(codes[int(codes[Head.ELEMENT_AT]) + element * int(Element.SIZE) + Element.NUMBERS])


def _moments(model: mujoco.MjModel, bodies: Sequence[int]) -> Array:
    """What of the links' numbers these bodies contribute, (links, moments)."""
    alone = copy.copy(model)
    others = np.setdiff1d(np.arange(model.nbody), bodies)
    alone.body_mass[others], alone.body_inertia[others] = 0.0, 0.0
    _, numbers = rigid.tree_of(alone)
    return numbers[rigid.GRAVITY :].reshape(-1, rigid.LINK)[:, _MASS:].copy()
