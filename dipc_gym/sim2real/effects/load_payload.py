"""A mass sits somewhere on what a joint moves: a tool, a battery, a cable's weight, a part that no drawing shows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from dipc_gym.mjcf.edit import Document
from dipc_gym.sim2real.effects.shared.base import Effect, Evidence, Parameter, Values
from dipc_gym.sim2real.effects.shared.payloads import seat

Array = NDArray[np.float64]

AXES = "xyz"
SHARE = 0.05  # of all that the body carries, which a first guess weighs
FAR = 5.0  # half sizes of the body, beyond which nothing sits on it
NEAR = 3.0  # half sizes within which a first guess is looked for
FELT = 1e-6  # of what a mass does to any joint's force, that moving it by half the body's size has to change
SMALL = 0.1  # of the body's size, radius of a ball that is first guessed
LIGHT = 1e-12  # kg and kg m^2, less than which MuJoCo takes for nothing


class Payload(Effect):
    """A ball of some mass and size, fixed to the body that a joint moves.

    A refit of the body's own mass scales its inertia along, and moves its centre along the arm alone: what sits at the
    end of a link, or beside it, is neither. Along axes of the body that no joint feels its place stays at the body's
    centre of mass. Its inertia about its own centre is the same about all axes: of a planar rig mass, place and that
    are all that a rigid body has.

    Args:
        size: half the extent of the body along its own axes, m, (3,).
        felt: axes of the body along which a mass that moves is felt.
    """

    id = "load.payload"
    place = "joint"
    linear = ("mass", "inertia")
    rivals = ("load.inertia", "load.tilt", "sensor.bias", "load.constant", "load.spring")
    shown_by = "postures in which gravity pulls at the joint in other directions, and faster motion of all joints"

    def __init__(self, size: Sequence[float] = (1.0, 1.0, 1.0), felt: str = AXES) -> None:
        places = (
            Parameter(
                axis, "m", -FAR * max(size), FAR * max(size), step=max(size), sigma=FAR, fixed=axis not in felt,
                translated=False,
            )
            for axis in AXES
        )  # fmt: skip
        own = Parameter("inertia", "kg m^2", 0.0, translated=False)
        self.parameters = (Parameter("mass", "kg", 0.0, translated=False), own, *places)

    def fits(self, model: mujoco.MjModel, at: str) -> bool:
        """Where several joints feel it, and also where it sits; at the last joint of a body. To one joint alone it is
        another mass and centre of mass.
        """
        joint = model.joint(at)
        body = int(joint.bodyid[0])
        last = int(model.body_jntadr[body] + model.body_jntnum[body]) - 1
        alone = int(model.dof_parentid[joint.dofadr[0]]) < 0
        return joint.id == last and not alone and bool(_felt(model, body, _half_sizes(model, body)))

    def proposals(self, evidence: Evidence) -> Sequence[tuple[Effect, Values]]:
        """Where a mass would pull most like the unexplained force of all joints; its centre of mass, without these."""
        model = evidence.model
        body = int(model.joint(evidence.at).bodyid[0])
        size = _half_sizes(model, body)
        felt = _felt(model, body, size)
        payload = Payload(size.tolist(), felt)
        found = [(SHARE * float(model.body_subtreemass[body]), model.body_ipos[body])]
        if evidence.together is not None:
            axes = [AXES.index(axis) for axis in felt]
            found = seat(evidence, body, axes, NEAR * float(size.max()))
        ball = 0.4 * (SMALL * float(size.max())) ** 2
        return [
            (payload, {"mass": mass, "inertia": ball * mass, **dict(zip(AXES, place.tolist(), strict=True))})
            for mass, place in found
        ]

    def guesses(self, evidence: Evidence) -> Sequence[Values]:
        """Those of `proposals`."""
        return [values for _, values in self.proposals(evidence)]

    def edit(self, document: Document, at: str, values: Values) -> None:
        """A body that is fixed to the joint's, with a ball for those who look at it."""
        body = document.parent(document.joint(at))
        while body.tag == "frame":
            body = document.parent(body)
        place = [values[axis] for axis in AXES]
        name = document.fresh(f"{body.get('name') or at}_payload")
        load = document.add(body, "body", name=name, pos=place)
        own = max(values["inertia"], LIGHT)
        document.add(load, "inertial", pos=(0, 0, 0), mass=values["mass"], diaginertia=(own,) * 3)
        document.add(load, "site", name=document.fresh(name), size=_radius(values))

    def sentence(self, at: str, values: Values, unit: Mapping[str, str]) -> str:
        """In words."""
        place = ", ".join(f"{1e3 * values[axis]:.0f}" for axis in AXES).replace("-0,", "0,").replace("-0)", "0)")
        radius = f"{1e3 * _radius(values):.0f}"
        ball = f", and turns like a ball of {radius} mm radius" * (radius != "0")
        where = f"at ({place}) mm in the frame of its body"
        return f"A load of {values['mass']:.3g} kg sits on what {at} moves, {where}{ball}."


def _radius(values: Values) -> float:
    """Of a uniform ball of that mass and inertia, m."""
    return float(np.sqrt(2.5 * max(values["inertia"], LIGHT) / max(values["mass"], LIGHT)))


def _half_sizes(model: mujoco.MjModel, body: int) -> Array:
    """Half the extent along the body's own axes of the uniform box that has its mass and inertia, (3,) m."""
    a, b, c = model.body_inertia[body]
    squares = 1.5 * np.array([b + c - a, a + c - b, a + b - c]) / max(float(model.body_mass[body]), LIGHT)
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, model.body_iquat[body])
    return np.asarray(np.abs(turn.reshape(3, 3)) @ np.sqrt(np.maximum(squares, 0.0)))


def _felt(model: mujoco.MjModel, body: int, size: Array) -> str:
    """Axes of a body along which joints feel that a mass on it is elsewhere."""
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    changes, whole, reach = np.zeros(3), 0.0, float(size.max())
    if reach <= 0:
        return ""
    for _ in range(4):
        data.qpos[:] = model.qpos0 + rng.normal(size=model.nq)
        data.qvel[:] = rng.normal(size=model.nv)
        acceleration = rng.normal(size=model.nv)
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        place = model.body_ipos[body] + reach * rng.uniform(-1, 1, size=3)
        here = _force_of_a_mass(model, data, body, place, acceleration)
        whole = max(whole, float(np.abs(here).max()))
        for k, axis in enumerate(np.eye(3)):
            there = _force_of_a_mass(model, data, body, place + reach * axis, acceleration)
            changes[k] = max(changes[k], float(np.abs(there - here).max()))
    return "".join(axis for axis, change in zip(AXES, changes, strict=True) if change > FELT * whole)


def _force_of_a_mass(model: mujoco.MjModel, data: mujoco.MjData, body: int, place: Array, acceleration: Array) -> Array:
    """Generalised force that a kilogram at a place of a body asks for in a motion, (nv,)."""
    point = data.xpos[body] + data.xmat[body].reshape(3, 3) @ place
    moves, turning = np.zeros((3, model.nv)), np.zeros((3, model.nv))
    mujoco.mj_jac(model, data, moves, None, point, body)
    mujoco.mj_jacDot(model, data, turning, None, point, body)
    return np.asarray(moves.T @ (moves @ acceleration + turning @ data.qvel - model.opt.gravity))
