"""A rotor of its own, coupled to the load: what backlash and a soft coupling have in common."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from dipc_gym import mjcf
from dipc_gym.mjcf.edit import Document
from dipc_gym.sim2real.effects.shared.base import Evidence, dof, joint_of, limit_the_drive

Array = NDArray[np.float64]

# Of a contact: the smallest that MuJoCo allows. Whatever presses on the contact keeps all but this share of its effect,
# so the limit is a spring and a damper that only push. A large one holds a load without giving way.
IMPEDANCE = 1e-4
LIGHT = 1e-9  # kg and kg m^2, of a body whose inertia is its joint's armature: MuJoCo wants some of both


def limits_act(model: mujoco.MjModel) -> bool:
    """Whether the model's limits are not switched off."""
    off = mujoco.mjtDisableBit.mjDSBL_LIMIT | mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    return not model.opt.disableflags & off


def bumper(rate: float, damping: float) -> dict[str, tuple[float, ...]]:
    """Solver parameters of a limit that is a spring and a damper, and only pushes.

    Args:
        rate: natural frequency of what touches it, rad/s.
        damping: its damping ratio.
    """
    return {"solreflimit": (-(rate**2), -2 * damping * rate), "solimplimit": (IMPEDANCE, IMPEDANCE, 1.0)}


def can_split(model: mujoco.MjModel, actuator: str) -> bool:
    """Whether the actuator drives a joint."""
    return joint_of(model, actuator) is not None


def inertia_at(model: mujoco.MjModel, joint: str) -> float:
    """What the joint moves, kg or kg m^2, in the model's reference configuration."""
    return float(model.dof_M0[model.joint(joint).dofadr[0]])


def base_inertia(model: mujoco.MjModel) -> Array:
    """Mass matrix of the base joints, those that follow others moving with them, (nb, nb), in the same."""
    out = mjcf.spread_out(model)
    return np.asarray(out.T @ mjcf.mass_matrix(model) @ out)


def free_inertia(model: mujoco.MjModel, joint: str) -> float:
    """What a force at the joint accelerates while all others are free, kg or kg m^2, in the reference configuration.

    No more than that can be taken out of it: poles that hang on a cart are carried by it and are no part of it.
    """
    at = model.joint(joint).dofadr[0]
    return float(1.0 / np.linalg.inv(mjcf.mass_matrix(model))[at, at])


def rotor_guesses(evidence: Evidence, shares: Sequence[float]) -> list[float]:
    """Inertias that the rotor may have: the armature that the model gives the joint, or shares of what it moves."""
    joint = joint_of(evidence.model, evidence.at)
    armature = float(evidence.model.dof_armature[dof(evidence.model, joint)]) if joint else 0.0
    return [armature] if armature > 0 else [share * evidence.inertia for share in shares]


def split(document: Document, actuator: str, inertia: float) -> tuple[str, str]:
    """Give the motor a rotor beside the body it drives, and take its inertia from that of the joint.

    Args:
        document: to edit.
        actuator: drives the rotor from now on.
        inertia: of the rotor, as felt at the joint, kg or kg m^2.

    Returns:
        Names of the rotor's joint and of the joint it is to be coupled to.
    """
    element = document.actuator(actuator)
    joint = element.get("joint", "")
    limit_the_drive(document, joint)
    name = beside(document, f"{actuator}_rotor", joint, inertia)
    left = document.limits(document.joint(joint), "actuatorfrc")
    if left is not None:  # the drive has no such limit of its own
        document.set(document.joint(name), actuatorfrclimited="true", actuatorfrcrange=left)
    document.set(element, joint=name)
    return name, joint


def beside(document: Document, name: str, at: str, inertia: float) -> str:
    """Take a part of what a joint moves out of it, as a body of its own that moves along the same axis.

    The model held both as one, as an armature or as part of the body: what the two weigh together stays, so that a
    refit has nothing to make up for. The part is an armature of its own joint, for what carries that joint carries the
    body still, with all of its mass. Where the joint has no armature, a negative one takes the part out of the body.

    Args:
        document: to edit.
        name: of the body and its joint, if nothing is called so.
        at: the joint.
        inertia: of the part, as felt at the joint, kg or kg m^2.

    Returns:
        Name of the part's joint.
    """
    joint = document.joint(at)
    own = _alongside(document, document.fresh(name), at)
    document.set(own, armature=inertia - LIGHT)
    document.set(joint, armature=float(document.effective(joint, "armature", "0")) - inertia)
    return str(own.get("name"))


def node(document: Document, name: str, at: str, *, armature: float, damping: float) -> str:
    """A joint of next to no mass that moves along another's axis, with a damper under it.

    Args:
        document: to edit.
        name: of the body and its joint, if nothing is called so.
        at: the other joint.
        armature: kg or kg m^2; it moves nothing but the node.
        damping: N s/m or N m s/rad.

    Returns:
        Name of the node's joint.
    """
    own = _alongside(document, document.fresh(name), at)
    document.set(own, armature=armature, damping=damping)
    return str(own.get("name"))


def _alongside(document: Document, name: str, at: str) -> ET.Element:
    """The joint of a body of next to no mass that moves along another joint's axis, carried by what carries that one's
    body; it begins, also in the file's keyframes, where the other one is.
    """
    joint, frames = document.joint(at), list[ET.Element]()
    body = document.parent(joint)
    while body.tag == "frame":
        frames.append(body)
        body = document.parent(body)
    part = document.add(document.parent(body), "body", name=name, gravcomp=1)
    _as_placed(document, part, body)
    place = document.effective(joint, "pos", "0 0 0")
    document.add(part, "inertial", pos=place, mass=LIGHT, diaginertia=(LIGHT,) * 3)
    holder = part
    for frame in reversed(frames):
        holder = document.add(holder, "frame")
        _as_placed(document, holder, frame)
    kind, axis = document.effective(joint, "type", "hinge"), document.effective(joint, "axis", "0 0 1")
    own = document.add(holder, "joint", name=name, type=kind, axis=axis, pos=place)
    document.plain(own, damping="0 0 0", stiffness="0 0 0", frictionloss="0", armature="0", springdamper="0 0")
    document.plain(own, limited="auto", range="0 0")
    reference = document.effective(joint, "ref", "0")
    if document.effective(own, "ref", "0") != reference:
        document.set(own, ref=reference)
    document.follows(name, at)
    document.in_keyframes(own, joint)
    return own


def _as_placed(document: Document, element: ET.Element, other: ET.Element) -> None:
    """Give a body or a frame the pose of another."""
    for attribute in ("pos", "quat", "axisangle", "xyaxes", "zaxis", "euler"):
        if other.get(attribute):
            document.set(element, **{attribute: other.get(attribute, "")})


def couple(
    document: Document, name: str, rotor: str, load: str, stiffness: float, damping: float, cubic: float = 0.0
) -> None:
    """A spring, with a share of the third power if need be, and a damper between rotor and load, as a fixed tendon."""
    pull, drag = (stiffness, 0.0, cubic), (damping, 0.0, 0.0)  # of fewer numbers a default class would add its own
    tendon = document.add("tendon", "fixed", name=document.fresh(name), stiffness=pull, damping=drag, springlength="0")
    document.plain(tendon, limited="auto", range="0 0", frictionloss="0", armature="0")
    _between(document, tendon, rotor, load)


def bend(document: Document, name: str, rotor: str, load: str, slack: float, stiffness: float, cubic: float) -> None:
    """A spring between rotor and load that pulls from some stretch on, either way, as a fixed tendon.

    Args:
        document: to edit.
        name: of the tendon.
        rotor: joint.
        load: joint.
        slack: stretch up to which it does not pull, m or rad.
        stiffness: beyond, N/m or N m/rad; below zero it softens another spring there.
        cubic: of the third power of what it is stretched beyond, N/m^3 or N m/rad^3.
    """
    ends, pull = (-slack, slack), (stiffness, 0.0, cubic)
    tendon = document.add("tendon", "fixed", name=document.fresh(name), stiffness=pull, springlength=ends)
    document.plain(tendon, limited="auto", range="0 0", frictionloss="0", armature="0", damping="0 0 0")
    _between(document, tendon, rotor, load)


def limit(document: Document, name: str, rotor: str, load: str, gap: float, rate: float, damping: float) -> None:
    """A contact at each end of a gap between rotor and load, as the limits of a fixed tendon.

    A spring with a dead band in its place gives back all of a blow, or with damping drags in the gap as well; fitted to
    play that does neither, it leaves twice to four times the error.

    Args:
        document: to edit.
        name: of the tendon.
        rotor: joint.
        load: joint.
        gap: m or rad.
        rate: natural frequency of rotor against load while they touch, rad/s.
        damping: its damping ratio.
    """
    tendon = document.add(
        "tendon",
        "fixed",
        name=document.fresh(name),
        limited="true",
        range=(-gap / 2, gap / 2),
        **bumper(rate, damping),
    )
    document.plain(tendon, margin="0", frictionloss="0", armature="0", stiffness="0 0 0", damping="0 0 0")
    _between(document, tendon, rotor, load)


def _between(document: Document, tendon: ET.Element, rotor: str, load: str) -> None:
    document.add(tendon, "joint", joint=rotor, coef=1)
    document.add(tendon, "joint", joint=load, coef=-1)
