"""What a compiled model commands and senses, which of its joints lead, and whether the diagnosis can treat it."""

from __future__ import annotations

import math
from typing import Any, NamedTuple
from xml.sax.saxutils import quoteattr

import mujoco
import numpy as np
from numpy.typing import NDArray

from dipc_gym.mjcf.scan import MjcfError

Array = NDArray[np.float64]

_WHOLE = 1e-9  # of a step, by which a whole number of them may be missed by rounding

PREFIX = "dipc_gym"  # of what `<custom>` holds for this package

# A `<text>` in `<custom>` with this prefix names an actuator that stands in for a passive force; its control stays 0.
PASSIVE = "dipc_gym:passive:"

# One with this prefix names a joint behind a gap or a spring; it says which joint it follows.
FOLLOWS = "dipc_gym:follows:"

# One with this prefix and then `1:EFFECT:PLACE` says what a law there depends on first: `position cart`.
INPUTS = "dipc_gym:input:"

SUPPORTED = (
    "Supported are models with hinge and slide joints and no contacts, with any number of actuators, "
    "whose scalar sensors determine the joints."
)


def command_ranges(model: mujoco.MjModel) -> tuple[Array, Array]:
    """Least and most of each control that the model takes, (nu,) each, infinite where it takes any."""
    limited = model.actuator_ctrllimited.astype(bool)
    if model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_CLAMPCTRL:
        limited[:] = False
    low, high = (np.where(limited, model.actuator_ctrlrange[:, k], sign * np.inf) for k, sign in ((0, -1), (1, 1)))
    return low, high


def control_delays(model: mujoco.MjModel, *, stepped: bool = False) -> Array:
    """By how much each control acts later than it is given, s, (nu,), by the model's integrator.

    The Runge-Kutta method asks for commands of the middle and the end of a step as well, which are newer ones.

    Args:
        model: compiled.
        stepped: whether it is what MuJoCo makes of it at the model's own step, which knows no command of this step: a
            delay of less than a step is one of a whole step.
    """
    delays, step = np.zeros(model.nu), float(model.opt.timestep)
    stages = [(1.0, 0.0)]
    if model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4:
        stages = [(1 / 6, 0.0), (2 / 3, 0.5 * step), (1 / 6, step)]
    for i in np.flatnonzero(model.actuator_delay):
        first, delay, interpolates = (
            int(model.actuator_ctrladr[i]),
            model.actuator_delay[i],
            model.actuator_history[i, 1],
        )
        late = sum(weight * _age(delay - ahead, step, interpolates, stepped) for weight, ahead in stages)
        delays[first : first + int(model.actuator_ctrlnum[i])] = late
    return delays


def _age(asked: float, step: float, interpolates: int, stepped: bool) -> float:
    """Age of what a history with an entry for each step gives for an age that is asked for, s: without interpolation
    none between its entries; see `control_delays`.
    """
    age = float(asked) if interpolates else math.ceil(asked / step - _WHOLE) * step
    return max(age, step if stepped else 0.0)


def with_delay(delay: float, step: float, integrator: str) -> float:
    """What `delay` a file has to say, with linear interpolation, for commands to act as late as that, s.

    Args:
        delay: by which commands act late, s.
        step: of the file, s.
        integrator: of the file, as it names it.

    Example:
        >>> with_delay(0.014, 0.002, "Euler"), round(with_delay(0.014, 0.002, "RK4"), 6)
        (0.014, 0.015)
    """
    if integrator != "RK4":
        return delay
    return float(np.interp(delay, [0.0, step / 12, step / 2], [0.0, step / 2, step])) + max(delay - step / 2, 0.0)


def controls(model: mujoco.MjModel, where: str = "") -> list[str]:
    """Names of the model's controls, in the order of `data.ctrl`.

    A passive actuator (`input="none"`) has no control and no name here. One with several inputs has one name for
    each: `servo.pos`, `servo.vel`. Controls of elements that `<custom>` calls passive come last and are left out.

    Args:
        model: compiled.
        where: what messages call it, as its file.

    Raises:
        MjcfError: an actuator with a control has no name.
    """
    names = [""] * model.nu
    passive = _passive(model)
    for actuator in range(model.nactuator):
        name = model.actuator(actuator).name
        if name in passive:
            continue
        first, count = int(model.actuator_ctrladr[actuator]), int(model.actuator_ctrlnum[actuator])
        if count and not name:
            said = f"actuator {actuator} has no name; recordings are matched by name, so give it one"
            raise MjcfError(f"{where}: {said}" if where else said)
        for k in range(count):
            part = mujoco.mj_actuatorInputName(model, actuator, k) or str(k)
            names[first + k] = name if count == 1 else f"{name}.{part}"
    commanded = sum(1 for name in names if name)
    if not all(names[:commanded]):
        raise MjcfError("passive actuators must come after all that are commanded")
    return names[:commanded]


def _passive(model: mujoco.MjModel) -> set[str]:
    """Names of the actuators that `<custom>` calls passive."""
    return {name.removeprefix(PASSIVE) for name in texts(model) if name.startswith(PASSIVE)}


def gear(model: mujoco.MjModel, actuator: int) -> float:
    """How far an actuator goes with the joint or tendon that it moves; of one with several outputs with the first."""
    return float(model.actuator_gear[model.actuator_outadr[actuator], 0])


def commanded(model: mujoco.MjModel) -> int:
    """How many controls there are up to the last that somebody commands; what only passive elements have comes after.

    Names do not matter here, other than for `controls`.
    """
    passive = _passive(model)
    ends = [
        int(model.actuator_ctrladr[i] + model.actuator_ctrlnum[i])
        for i in range(model.nactuator)
        if model.actuator_ctrlnum[i] and model.actuator(i).name not in passive
    ]
    return max(ends, default=0)


def is_hinge(model: mujoco.MjModel, joint: str | int) -> bool:
    """Whether a joint turns, and is measured in rad and N m; else it slides, in m and N."""
    return bool(model.jnt_type[model.joint(joint).id] == mujoco.mjtJoint.mjJNT_HINGE)


class Units(NamedTuple):
    """What a joint's numbers are in.

    Attributes:
        force: `N`, or `N m` where it turns.
        length: `m` or `rad`.
        inertia: `kg` or `kg m^2`.
    """

    force: str
    length: str
    inertia: str


def units(model: mujoco.MjModel, joint: str | int) -> Units:
    """Units of a joint, by whether it turns or slides.

    Args:
        model: compiled.
        joint: name or number of a hinge or a slide.

    Raises:
        KeyError: there is no joint of that name.

    Example:
        >>> model = mujoco.MjModel.from_xml_string(
        ...     '<mujoco><worldbody><body><joint name="arm"/><geom size="1"/></body></worldbody></mujoco>'
        ... )
        >>> units(model, "arm").force
        'N m'
    """
    return Units("N m", "rad", "kg m^2") if is_hinge(model, joint) else Units("N", "m", "kg")


def passive_actuators(model: mujoco.MjModel) -> list[int]:
    """Numbers of the actuators that nobody commands: friction, cogging and other forces in an actuator's clothes."""
    first = commanded(model)
    return [i for i in range(model.nactuator) if model.actuator_ctrlnum[i] == 0 or model.actuator_ctrladr[i] >= first]


def passive_moments(model: mujoco.MjModel) -> tuple[list[int], Array]:
    """What a unit of force of each actuator that nobody commands does at the joints, the same wherever these are.

    Args:
        model: compiled, its actuators on joints and fixed tendons.

    Returns:
        Where their forces stand among those of all actuators, and forces at the joints, (those, nv).
    """
    at = [
        int(model.actuator_outadr[i]) + k
        for i in passive_actuators(model)
        for k in range(int(model.actuator_outnum[i]))
    ]
    data, moments = mujoco.MjData(model), np.zeros((model.nout, model.nv))
    mujoco.mj_fwdPosition(model, data)
    mujoco.mju_sparse2dense(moments, data.actuator_moment, data.moment_rownnz, data.moment_rowadr, data.moment_colind)
    return at, moments[at]


def yielding(model: mujoco.MjModel) -> list[int]:
    """Tendons whose springs yield, in the order of their states in the engine."""
    return [int(t) for t in np.flatnonzero(model.tendon_plasticadr >= 0)]


def along(model: mujoco.MjModel, tendon: int) -> list[tuple[int, float]]:
    """Degrees of freedom of a fixed tendon, and its coefficients; none of a spatial one, which winds round sites."""
    first = int(model.tendon_adr[tendon])
    span = range(first, first + int(model.tendon_num[tendon]))
    joints = [w for w in span if model.wrap_type[w] == mujoco.mjtWrap.mjWRAP_JOINT]
    return [(int(model.jnt_dofadr[model.wrap_objid[w]]), float(model.wrap_prm[w])) for w in joints]


def followers(model: mujoco.MjModel) -> dict[str, str]:
    """Joints behind a gap or a spring, and for each the one where it starts.

    Raises:
        MjcfError: an entry names a joint that is not there, or a leader that follows another one itself.
    """
    found = {name.removeprefix(FOLLOWS): leader for name, leader in texts(model).items() if name.startswith(FOLLOWS)}
    names = [model.joint(j).name for j in range(model.njnt)]
    for follower, leader in found.items():
        for name, known in ((follower, names), (leader, [name for name in names if name not in found])):
            if name not in known:
                raise MjcfError(
                    f"<custom> entry '{FOLLOWS}{follower}': no {name!r} among the joints {', '.join(known)}"
                )
    return found


def coupled(model: mujoco.MjModel) -> dict[str, tuple[str, float]]:
    """Joints that an equality constraint holds in proportion to another, as gears and mirrored fingers are: for each
    the one that leads it, and how many times as far it goes.

    Of two the one that is driven leads; where both are, neither does. One may lead several, also by way of others.

    Example:
        >>> body = '<body><joint name="{}" type="slide"/><geom size="1"/></body>'
        >>> tie = '<equality><joint joint1="b" joint2="a" polycoef="0 -1 0 0 0"/></equality>'
        >>> world = f"<worldbody>{body.format('a')}{body.format('b')}</worldbody>"
        >>> coupled(mujoco.MjModel.from_xml_string(f"<mujoco>{world}{tie}</mujoco>"))
        {'b': ('a', -1.0)}
    """
    if not model.neq or model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_EQUALITY:
        return {}
    following, found, passive = followers(model), dict[str, tuple[str, float]](), set(passive_actuators(model))
    driven = {
        following.get(name, name)  # a rotor is driven for the joint that it turns
        for i in set(np.flatnonzero(model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT)) - passive
        for name in [model.joint(int(model.actuator_trnid[i, 0])).name]
    }
    for e in range(model.neq):
        joints = [int(model.eq_obj1id[e]), int(model.eq_obj2id[e])]
        if model.eq_type[e] != mujoco.mjtEq.mjEQ_JOINT or not model.eq_active0[e] or joints[1] < 0:
            continue
        offset, ratio, *bends = model.eq_data[e, :5].tolist()
        scalar = np.isin(model.jnt_type[joints], (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)).all()
        if not (scalar and ratio) or offset or any(bends) or model.qpos0[model.jnt_qposadr[joints]].any():
            continue
        led, leader = (model.joint(joint).name for joint in joints)
        if led in driven:
            led, leader, ratio = leader, led, 1 / ratio
        leader = following.get(leader, leader)
        leader, times = found.get(leader, (leader, 1.0))
        if led in driven or led in found or led in following or led == leader:
            continue
        ties = {name: (leader, further * ratio * times) for name, (of, further) in found.items() if of == led}
        found |= {led: (leader, ratio * times), **ties}
    return found


def base_joints(model: mujoco.MjModel) -> tuple[str, ...]:
    """Names of the joints whose state is estimated: all but those that follow another one, unseen or held to it.

    Raises:
        MjcfError: a joint without a name, or an entry of `<custom>` that ties joints which cannot be tied.
    """
    return tuple(_ties(model)[0])


def spread_out(model: mujoco.MjModel) -> Array:
    """Matrix (nq, nb) from the base joints to all joints, with followers where their leaders are, and what is coupled
    to these in proportion.
    """
    base, ties = _ties(model)
    out = np.zeros((model.njnt, len(base)))
    for j in range(model.njnt):
        leader, ratio = ties[model.joint(j).name]
        out[j, base.index(leader)] = ratio
    return out


def mass_matrix(model: mujoco.MjModel) -> Array:
    """Mass matrix in the reference configuration, (nv, nv), kg and kg m^2."""
    data, full = mujoco.MjData(model), np.zeros((model.nv, model.nv))
    mujoco.mj_fwdPosition(model, data)
    mujoco.mj_fullM(model, data, full)
    return full


def _ties(model: mujoco.MjModel) -> tuple[list[str], dict[str, tuple[str, float]]]:
    """The base joints, and for every joint the base joint that says where it is, and how many times as far."""
    names = [model.joint(j).name for j in range(model.njnt)]
    if "" in names:
        raise MjcfError(f"joint {names.index('')} of the model has no name; reports speak of joints, so name it")
    ties, following = coupled(model), followers(model)
    base = [name for name in names if name not in ties and name not in following]
    ties |= {name: (name, 1.0) for name in base}
    return base, ties | {follower: ties[leader] for follower, leader in following.items()}


def texts(model: mujoco.MjModel) -> dict[str, str]:
    """The `<text>` entries of `<custom>`, by name; those without one are left out."""
    found = {}
    for i in range(model.ntext):
        name = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_TEXT, i)
        if not name:
            continue
        start, size = int(model.text_adr[i]), int(model.text_size[i])
        found[name] = bytes(model.text_data[start : start + size]).rstrip(b"\0").decode(errors="replace")
    return found


def scalar_sensors(model: mujoco.MjModel) -> list[str]:
    """Names of the sensors that measure one number, in the model's order; unnamed ones are left out."""
    sensors = (model.sensor(i) for i in range(model.nsensor) if model.sensor_dim[i] == 1)
    return [sensor.name for sensor in sensors if sensor.name]


def sensor_addresses(model: mujoco.MjModel) -> NDArray[np.intp]:
    """Where the `scalar_sensors` stand in `data.sensordata`."""
    return np.array([model.sensor(name).adr[0] for name in scalar_sensors(model)], dtype=np.intp)


def sensor_delays(model: mujoco.MjModel, *, stepped: bool = False) -> Array:
    """By how much each of the `scalar_sensors` reads late, s; for `stepped` see `control_delays`."""

    def late(k: int) -> float:
        delay, interpolates = model.sensor_delay[k], model.sensor_history[k, 1]
        return _age(delay, float(model.opt.timestep), interpolates, stepped) if delay else 0.0

    return np.array([late(model.sensor(name).id) for name in scalar_sensors(model)])


def latest_sensor(model: mujoco.MjModel) -> float:
    """Delay of the one of the `scalar_sensors` that reads latest, s; 0 where none is late."""
    return float(sensor_delays(model).max(initial=0.0))


def slowest_activation(model: mujoco.MjModel) -> float:
    """Longest time constant of a filtered command, a muscle or a cylinder, s; 0 where there is none.

    Example:
        >>> body = '<worldbody><body><joint name="x" type="slide"/><geom size="1"/></body></worldbody>'
        >>> drive = '<actuator><cylinder name="drive" joint="x" timeconst="0.05"/></actuator>'
        >>> slowest_activation(mujoco.MjModel.from_xml_string(f"<mujoco>{body}{drive}</mujoco>"))
        0.05
    """
    kinds, longest = mujoco.mjtDyn, 0.0
    for kind, numbers in zip(model.actuator_dyntype.tolist(), model.actuator_dynprm, strict=True):
        if kind in (kinds.mjDYN_FILTER, kinds.mjDYN_FILTEREXACT):
            longest = max(longest, float(numbers[0]))
        elif kind == kinds.mjDYN_MUSCLE:
            longest = max(longest, *numbers[:2].tolist())
    return longest


def check_supported(model: mujoco.MjModel, name: str) -> None:
    """Refuse models that system identification cannot treat.

    Args:
        model: compiled.
        name: what messages call it, as its file.

    Raises:
        MjcfError: free or ball joints, flexible bodies, geoms that can touch, no joint, no named scalar sensor, an
            actuator with a control and no name, one that integrates its commands, a sensor that holds its reading, or
            dry friction switched off.
    """
    for joint in range(model.njnt):
        kind = int(model.jnt_type[joint])  # a NumPy integer in a tuple of MuJoCo's enums is not found
        if kind in (mujoco.mjtJoint.mjJNT_FREE, mujoco.mjtJoint.mjJNT_BALL):
            word = "free" if kind == mujoco.mjtJoint.mjJNT_FREE else "ball"
            body = _label(model.body(model.jnt_bodyid[joint]))
            raise MjcfError(
                f"{name}: joint {_label(model.joint(joint))} is a {word} joint. {SUPPORTED} If body {body} has nothing "
                "to do with what was recorded, take it out of the file."
            )
    if model.nflex:
        raise MjcfError(f"{name}: the model has flexible bodies (flex). {SUPPORTED}")
    if not model.nv:
        raise MjcfError(f"{name}: the model has no joints, so nothing in it moves. {SUPPORTED}")
    if not scalar_sensors(model):
        joints = [model.joint(k).name for k in range(model.njnt)]
        first = "" if all(joints) else "Give all joints that were recorded names. "
        if not any(joints):
            raise MjcfError(
                f"{name}: the model has no named scalar sensor. {first}Then write one for each of them, under the name "
                'of its column: <sensor><jointpos name="COLUMN" joint="JOINT"/></sensor>'
            )
        lines = "".join(f"<jointpos name={quoteattr(one)} joint={quoteattr(one)}/>" for one in joints if one)
        raise MjcfError(
            f"{name}: the model has no named scalar sensor. {first}Write one for each joint that was recorded, under "
            f"the name of its column, before </mujoco>: <sensor>{lines}</sensor>"
        )
    controls(model, name)
    for i in np.flatnonzero(model.actuator_dyntype == mujoco.mjtDyn.mjDYN_INTEGRATOR):
        raise MjcfError(
            f"{name}: actuator {_label(model.actuator(i))} integrates its command, and where that has come to when a "
            "recording begins is in no column. Write a <position> or <velocity> servo in its place, and give its "
            "command that sum."
        )
    for one in scalar_sensors(model):
        if model.sensor_interval[model.sensor(one).id].any():
            raise MjcfError(
                f"{name}: sensor {one!r} has an interval, over which its reading stays as it was. Remove it, and "
                "record at the times at which the sensor reads."
            )
    off = {"constraint": "dry friction", "frictionloss": "dry friction", "damper": "damping", "spring": "springs"}
    for flag, switched in off.items():
        if model.opt.disableflags & getattr(mujoco.mjtDisableBit, f"mjDSBL_{flag.upper()}"):
            raise MjcfError(
                f'{name}: <flag {flag}="disable"/> switches {switched} off, so that none could be found or written; '
                "remove it" + (', and write <flag contact="disable"/> for it' if flag == "constraint" else "")
            )
    pair = touching_pair(model)
    if pair:
        raise MjcfError(
            f'{name}: geoms {pair[0]} and {pair[1]} can touch. {SUPPORTED} If they never touch, set contype="0" '
            'conaffinity="0" on them, or <option><flag contact="disable"/></option>.'
        )


def servo(model: mujoco.MjModel, actuator: int) -> str:
    """Whether an actuator is a servo, of position (`pos`) or speed (`vel`), by whatever element; empty for any other.

    What it exerts is its gain times how far it is from what it is asked for.
    """
    gain, bias = model.actuator_gainprm[actuator, 0], model.actuator_biasprm[actuator]
    kinds = model.actuator_gaintype[actuator], model.actuator_biastype[actuator]
    if kinds != (mujoco.mjtGain.mjGAIN_FIXED, mujoco.mjtBias.mjBIAS_AFFINE) or gain <= 0:
        return ""
    if bias[1] == -gain:
        return "pos"
    return "vel" if bias[1] == 0 and bias[2] == -gain else ""


def touching_pair(model: mujoco.MjModel) -> tuple[str, str] | None:
    """The first two geoms whose contact the model allows, or None; by MuJoCo's filters, whatever the geometry."""
    disabled = model.opt.disableflags
    if disabled & (mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_CONSTRAINT):
        return None
    if model.npair:
        return _label(model.geom(model.pair_geom1[0])), _label(model.geom(model.pair_geom2[0]))
    weld = model.body_weldid.tolist()
    parent = [weld[model.body_parentid[body]] for body in weld]  # of the welded group that a body belongs to
    parents_touch = bool(disabled & mujoco.mjtDisableBit.mjDSBL_FILTERPARENT)
    excluded = set(model.exclude_signature.tolist())
    type_of, affinity, body_of = model.geom_contype, model.geom_conaffinity, model.geom_bodyid.tolist()
    bits = np.stack([model.geom_bodyid, type_of, affinity], axis=1)
    _, firsts = np.unique(bits, axis=0, return_index=True)  # of a body's geoms that may touch the same, one tells
    solid = [geom for geom in np.sort(firsts).tolist() if type_of[geom] or affinity[geom]]
    for i, g in enumerate(solid):
        for h in solid[i + 1 :]:
            a, b = sorted((body_of[g], body_of[h]))
            if weld[a] == weld[b] or (a << 16) + b in excluded:
                continue
            related = weld[a] and weld[b] and (parent[a] == weld[b] or parent[b] == weld[a])
            if related and not parents_touch:
                continue
            if type_of[g] & affinity[h] or type_of[h] & affinity[g]:
                return _label(model.geom(g)), _label(model.geom(h))
    return None


def _label(element: Any) -> str:
    return repr(element.name) if element.name else f"number {element.id}"
