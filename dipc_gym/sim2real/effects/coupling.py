"""A rotor of its own, coupled to the load: what backlash and a soft coupling have in common."""

from __future__ import annotations

import mujoco
import numpy as np

from dipc_gym.sim2real.document import Document
from dipc_gym.sim2real.effects.base import joint_of

SETTLE = 0.15  # s of simulation until a rotor is where it would be, whatever it was given to start with


def can_split(model: mujoco.MjModel, actuator: str) -> bool:
    """Whether the actuator drives a joint."""
    return joint_of(model, actuator) is not None


def inertia_at(model: mujoco.MjModel, joint: str) -> float:
    """What the joint moves, kg or kg m^2, in the model's reference configuration."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, full)
    return float(full[model.joint(joint).dofadr[0], model.joint(joint).dofadr[0]])


def split(document: Document, actuator: str, inertia: float) -> tuple[str, str]:
    """Give the motor a rotor beside the body it drives.

    Args:
        document: to edit.
        actuator: drives the rotor from now on.
        inertia: of the rotor, as felt at the joint, kg or kg m^2.

    Returns:
        Names of the rotor's joint and of the joint it is to be coupled to.
    """
    element = document.actuator(actuator)
    joint = document.joint(element.get("joint", ""))
    body = document.parent(joint)
    name = document.fresh(f"{actuator}_rotor")
    rotor = document.add(document.parent(body), "body", name=name, gravcomp=1)
    for attribute in ("pos", "quat", "axisangle", "xyaxes", "zaxis", "euler"):
        if body.get(attribute):
            document.set(rotor, **{attribute: body.get(attribute, "")})
    kind = document.effective(joint, "type", "hinge")
    place = document.effective(joint, "pos", "0 0 0")
    document.add(
        rotor,
        "inertial",
        pos=place,
        mass=1e-3 if kind == "hinge" else inertia,
        diaginertia=(inertia,) * 3 if kind == "hinge" else (1e-6,) * 3,
    )
    axis = document.effective(joint, "axis", "0 0 1")
    own = document.add(rotor, "joint", name=name, type=kind, axis=axis, pos=place)
    document.plain(own, damping="0 0 0", stiffness="0 0 0", frictionloss="0", armature="0", springdamper="0 0")
    document.plain(own, limited="auto", range="0 0")
    document.set(element, joint=name)
    document.follows(name, joint.get("name", ""))
    return name, joint.get("name", "")


def couple(document: Document, name: str, rotor: str, load: str, stiffness: float, damping: float, gap: float) -> None:
    """A fixed tendon between rotor and load; springlength is the play."""
    tendon = document.add(
        "tendon",
        "fixed",
        name=document.fresh(name),
        stiffness=stiffness,
        damping=damping,
        springlength=(-gap / 2, gap / 2),
    )
    document.plain(tendon, limited="auto", range="0 0", frictionloss="0", armature="0")
    document.add(tendon, "joint", joint=rotor, coef=1)
    document.add(tendon, "joint", joint=load, coef=-1)
