"""The parameters a model has already: what a refit may change before any new physics is considered."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import mujoco
import numpy as np
from numpy.typing import NDArray

from dipc_gym import mjcf, physics
from dipc_gym.mjcf.bare import bare
from dipc_gym.mjcf.edit import Document, text, written_out
from dipc_gym.safety.naming import suggestion
from dipc_gym.sim2real.effects.shared.base import is_dcmotor
from dipc_gym.sim2real.model.settings import MODEL

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ModelParameter:
    """A positive parameter of the nominal model, as an effect has `Parameter`s.

    Attributes:
        attribute: of the MJCF, as `damping`.
        at: joint, body or actuator.
        value: in the nominal model; a negative gear counts by its size, and keeps its sign.
        unit: SI.
        write: puts another value into a document.
        sigma: how far, as a ratio, it may plausibly be off; loosely holds what the data does not determine.
        expected: where its owner expects it; the nominal value if None.
    """

    attribute: str
    at: str
    value: float
    unit: str
    write: Callable[[Document, float], None]
    sigma: float = MODEL.springs
    expected: float | None = None

    @property
    def key(self) -> str:
        """`at.attribute`, as on the command line."""
        return f"{self.at}.{self.attribute}"


def in_full(source: mjcf.Source, given: physics.Physics) -> tuple[mjcf.Source, physics.Physics]:
    """A model whose text says all that its compiler makes up, and the same loaded; see `mjcf.edit.written_out`."""
    said = written_out(source, given.model)
    return (source, given) if said is source else (said, physics.load(said))


def model_parameters(document: Document, model: mujoco.MjModel) -> list[ModelParameter]:
    """Every parameter of the model that a refit may change, those that are zero left out: they are absent structure."""
    found: list[ModelParameter] = []
    for name in document.joint_names():
        if not _exists(model, mujoco.mjtObj.mjOBJ_JOINT, name):
            continue
        joint = model.joint(name)
        dof = int(joint.dofadr[0])
        force, length, inertia = mjcf.units(model, name)
        for attribute, value, unit, sigma in (
            ("damping", model.dof_damping[dof], f"{force} s/{length}", MODEL.friction),
            ("frictionloss", model.dof_frictionloss[dof], force, MODEL.friction),
            ("stiffness", model.jnt_stiffness[joint.id], f"{force}/{length}", MODEL.springs),
            ("armature", model.dof_armature[dof], inertia, MODEL.springs),
        ):
            if np.ravel(value)[0] > 0:
                write = _first_of("joint", name, attribute)
                found.append(ModelParameter(attribute, name, float(np.ravel(value)[0]), unit, write, sigma))
    for name in document.actuator_names():
        if not _exists(model, mujoco.mjtObj.mjOBJ_ACTUATOR, name):
            continue
        i = model.actuator(name).id
        if is_dcmotor(model, name):
            element = document.actuator(name)
            for attribute, unit in (("resistance", "ohm"), ("motorconst", "N m/A")):
                values = document.effective(element, attribute, "0").split()
                if values and float(values[0]) > 0:
                    found.append(
                        ModelParameter(attribute, name, float(values[0]), unit, _all_of(name, attribute), MODEL.motors)
                    )
        elif servo := _servo(document, model, name):
            found += servo
        elif model.actuator_ctrlnum[i]:
            gear = mjcf.gear(model, i)
            if gear:
                write = _first_of("actuator", name, "gear", sign=math.copysign(1.0, gear))
                found.append(ModelParameter("gear", name, abs(gear), "", write, MODEL.motors))
    for name in _moving_bodies(document, model):
        write = _mass(model, name)
        if not _takes_mass(document, model, name, write):
            continue
        found.append(ModelParameter("mass", name, float(model.body(name).mass[0]), "kg", write, MODEL.mass))
        # How far the mass is from the joint is as often wrong as how much it is, and looks like a tilt where it is not
        # refitted: a pendulum's weight and its inertia no longer go together.
        arm = _arm(model, name)
        if arm is not None and np.linalg.norm(arm) > MODEL.least_arm:
            write, away = _com(model, name, arm), float(np.linalg.norm(arm))
            found.append(ModelParameter("centre_of_mass", name, away, "m", write, MODEL.centre))
    return found


def _servo(document: Document, model: mujoco.MjModel, name: str) -> list[ModelParameter]:
    """Gains of a servo of position or speed, whatever its element is called; empty where an actuator is none.

    A gear would stretch what it is asked for as well.
    """
    element, i = document.actuator(name), model.actuator(name).id
    kind, gain, bias = mjcf.servo(model, i), float(model.actuator_gainprm[i, 0]), model.actuator_biasprm[i]
    if not kind:
        return []
    force, length = "", ""
    if model.actuator_trntype[i] == mujoco.mjtTrn.mjTRN_JOINT and abs(mjcf.gear(model, i)) == 1:
        force, length, _ = mjcf.units(model, int(model.actuator_trnid[i, 0]))
    gains = {"kp": (gain, force and f"{force}/{length}")} if kind == "pos" else {}
    if not document.effective(element, "dampratio"):  # of which the compiler makes a damping by the mass
        gains["kv"] = -float(bias[2]), force and f"{force} s/{length}"
    named = element.tag in ("position", "velocity")
    return [
        ModelParameter(
            attribute,
            name,
            value,
            unit,
            _first_of("actuator", name, attribute) if named else _gain(model, name, attribute, drives=kind == "vel"),
            MODEL.servos,
        )
        for attribute, (value, unit) in gains.items()
        if value > 0
    ]


def _gain(model: mujoco.MjModel, name: str, attribute: str, *, drives: bool) -> Callable[[Document, float], None]:
    """Sets a gain of a servo that is written as `<general>`, whatever its default class says.

    Args:
        model: compiled.
        name: of the actuator.
        attribute: `kp`, or `kv`, what `<position>` and `<velocity>` call them.
        drives: whether it is a servo of speed.
    """
    i = model.actuator(name).id
    compiled = {"gainprm": model.actuator_gainprm[i, :1], "biasprm": model.actuator_biasprm[i, :3]}

    def write(document: Document, value: float) -> None:
        element = document.actuator(name)
        own = {key: [float(word) for word in element.get(key, "").split()] for key in compiled}
        gain, bias = (own[key] or numbers.tolist() for key, numbers in compiled.items())
        bias = [*bias, 0.0, 0.0][:3]
        if attribute == "kp":
            gain[0], bias[1] = value, -value
        else:
            bias[2] = -value
        if drives:
            gain[0] = value
        document.set(element, gaintype="fixed", biastype="affine", gainprm=gain, biasprm=bias)

    return write


def fixed_masses(document: Document, model: mujoco.MjModel, parameters: Sequence[ModelParameter]) -> list[str]:
    """A sentence about the moving bodies whose mass no refit can change, if there are any."""
    free = {n.at for n in parameters if n.attribute == "mass"}
    fixed = [name for name in _moving_bodies(document, model) if name not in free]
    if not fixed:
        return []
    return [
        f"The mass of {', '.join(fixed)} is not refitted, for the compiler settings of the model (settotalmass, "
        "fusestatic, inertiafromgeom) override what is written for it; if it may be wrong, take them out."
    ]


@dataclass(frozen=True)
class Wishes:
    """What the owner of a rig knows of the model's parameters, which are named `place.attribute`.

    Attributes:
        fix: parameters that are right; no fit moves them.
        prior: mean and standard deviation of others, in the parameter's own unit.

    Example:
        >>> Wishes(fix=("cart.mass",), prior={"motor.resistance": (1.2, 0.05)}).prior["motor.resistance"]  # ohm
        (1.2, 0.05)
    """

    fix: tuple[str, ...] = ()
    prior: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    def apply(self, parameters: Sequence[ModelParameter]) -> list[ModelParameter]:
        """The parameters that are free, with their priors.

        Raises:
            ValueError: a name that is no parameter of the model, or one that is to be held and to have a spread.
        """
        known = [n.key for n in parameters]
        for key in (*self.fix, *self.prior):
            if key not in known:
                names = f"{', '.join(known)}{suggestion(key, known)}"
                raise ValueError(f"fix or prior of {key!r}: the model's parameters are {names}")
        both = next((key for key in self.fix if key in self.prior), None)
        if both is not None:
            raise ValueError(f"fix and prior of {both}: what is held has no spread; leave one of them out")
        out = []
        for parameter in parameters:
            if parameter.key in self.fix:
                continue
            if parameter.key in self.prior:
                mean, spread = self.prior[parameter.key]
                if not (0 < mean < math.inf and 0 < spread < math.inf):
                    raise ValueError(f"prior of {parameter.key}: mean and spread must be positive and finite")
                # Of the log-normal distribution with this mean and spread, whose reach stays finite.
                parameter = replace(parameter, sigma=math.sqrt(math.log1p((spread / mean) ** 2)), expected=mean)
            out.append(parameter)
        return out


def _moving_bodies(document: Document, model: mujoco.MjModel) -> list[str]:
    """Names of the bodies that have a mass and joints of their own."""
    names = [element.get("name", "") for element in document.root.iterfind(".//worldbody//body")]
    there = [model.body(name) for name in names if _exists(model, mujoco.mjtObj.mjOBJ_BODY, name)]
    return [body.name for body in there if model.body_dofnum[body.id] and body.mass[0] > 0]


def _exists(model: mujoco.MjModel, kind: mujoco.mjtObj, name: str) -> bool:
    """Whether the compiled model has it by this name; what `<replicate>` repeats gets others."""
    return bool(name) and mujoco.mj_name2id(model, kind, name) >= 0


def _first_of(kind: str, name: str, attribute: str, sign: float = 1.0) -> Callable[[Document, float], None]:
    """Sets the size of an attribute's first number; further ones, as polynomial coefficients, stay."""

    def write(document: Document, value: float) -> None:
        element = document.joint(name) if kind == "joint" else document.actuator(name)
        others = document.effective(element, attribute).split()[1:]
        document.set(element, **{attribute: " ".join([text(sign * value), *others])})

    return write


def _all_of(name: str, attribute: str) -> Callable[[Document, float], None]:
    """Scales all numbers of an attribute, as torque and back-EMF constant of a motor."""

    def write(document: Document, value: float) -> None:
        element = document.actuator(name)
        numbers = [float(word) for word in document.effective(element, attribute, "0").split()]
        document.set(element, **{attribute: [number * value / numbers[0] for number in numbers]})

    return write


def _takes_mass(document: Document, model: mujoco.MjModel, name: str, write: Callable[[Document, float], None]) -> bool:
    """Whether a mass that is written becomes that of the body and leaves all others as they are."""
    light = bare(document, model)
    mass, inertia, edited = model.body_mass.copy(), model.body_inertia.copy(), light.copy()
    mass[model.body(name).id] *= 1.1
    inertia[model.body(name).id] *= 1.1
    write(edited, float(mass[model.body(name).id]))
    try:
        made = mjcf.compile(light.source.edited(edited.text()), trusted=True)
    except mjcf.MjcfError:
        return False
    pairs = (made.body_mass, mass), (made.body_inertia, inertia), (made.body_ipos, model.body_ipos)
    return all(one.shape == other.shape and np.allclose(one, other, rtol=1e-6, atol=1e-12) for one, other in pairs)


def _arm(model: mujoco.MjModel, name: str) -> Array | None:
    """From the axis of a body's first hinge to its centre of mass, at right angles, in the body's frame, (3,) m; None
    where it has no hinge.
    """
    body = model.body(name)
    joints = range(int(body.jntadr[0]), int(body.jntadr[0]) + int(body.jntnum[0]))
    hinge = next((j for j in joints if mjcf.is_hinge(model, j)), None)
    if hinge is None:
        return None
    away, axis = body.ipos - model.jnt_pos[hinge], model.jnt_axis[hinge]
    return np.asarray(away - (away @ axis) * axis)


def _com(model: mujoco.MjModel, name: str, arm: Array) -> Callable[[Document, float], None]:
    """Moves a body's centre of mass along its arm; the inertia about it stays."""
    place, away = model.body(name).ipos.copy(), float(np.linalg.norm(arm))

    def write(document: Document, value: float) -> None:
        document.set(_inertial(document, model, name), pos=list(place + arm * (value / away - 1.0)))

    return write


def _mass(model: mujoco.MjModel, name: str) -> Callable[[Document, float], None]:
    """Scales a body's mass and inertia together, written as an explicit `<inertial>`."""
    body = model.body(name)
    mass, inertia = float(body.mass[0]), body.inertia.copy()

    def write(document: Document, value: float) -> None:
        inertial = _inertial(document, model, name)
        document.set(inertial, mass=value, diaginertia=list(inertia * value / mass))

    return write


def _inertial(document: Document, model: mujoco.MjModel, name: str) -> ET.Element:
    """The `<inertial>` of a body, with its numbers; one is made where geoms have stood for it.

    No compiler setting passes over it, see `mjcf.edit.written_out`.
    """
    element, body = document.body(name), model.body(name)
    inertial = element.find("inertial")
    if inertial is None:
        return document.add_inertial(element, model, body.id)
    if inertial.get("fullinertia"):
        del inertial.attrib["fullinertia"]
        for orientation in ("axisangle", "xyaxes", "zaxis", "euler"):
            inertial.attrib.pop(orientation, None)
        document.set(inertial, quat=list(body.iquat), mass=float(body.mass[0]), diaginertia=list(body.inertia))
    return inertial
