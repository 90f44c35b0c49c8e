"""Limits and ties of a compiled model, as numbers of the engine: what `limits` and `pushes` write code for.

The formulas are those of MuJoCo's documentation, "Solver parameters".
"""

from __future__ import annotations

import contextlib
import math
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from dipc_gym.engine.layout import Stop
from dipc_gym.engine.uncovered import Uncovered

Array = NDArray[np.float64]

ODD = "a solref of mixed signs or a power of solimp other than 1 and 2"


class Constraint(NamedTuple):
    """A limit, or a tie of joints.

    Attributes:
        dofs: joints that it acts on.
        coefficients: how far its length goes with each.
        numbers: see `layout.Stop`.
    """

    dofs: list[int]
    coefficients: list[float]
    numbers: list[float]


def soft_limits(model: mujoco.MjModel) -> NDArray[np.intp]:
    """Joints with limits that the engine has; their indices."""
    limited = np.flatnonzero(model.jnt_limited)
    ends = np.array([within(model.jnt_range[k], model.jnt_margin[k]) for k in limited]).reshape(-1, 2)
    known = [_known(model.jnt_solref[k], model.jnt_solimp[k]) for k in limited]
    return limited[np.array(known, dtype=bool) & (ends[:, 0] < ends[:, 1])]


def stiff_limits(model: mujoco.MjModel) -> NDArray[np.bool_]:
    """Which joints have limits that only MuJoCo's solver knows, (joints,)."""
    limited = model.jnt_limited.astype(bool)
    limited[soft_limits(model)] = False
    return limited


def within(ends: Array, margin: float) -> tuple[float, float]:
    """Between which positions a limit does not act."""
    return float(ends[0]) + float(margin), float(ends[1]) - float(margin)


def of_joint(model: mujoco.MjModel, k: int) -> Constraint:
    """The limit of a joint."""
    ends, weight = within(model.jnt_range[k], model.jnt_margin[k]), float(model.dof_invweight0[k])
    return Constraint([k], [1.0], _numbers(model, ends, model.jnt_solref[k], model.jnt_solimp[k], weight))


def of_tendon(model: mujoco.MjModel, t: int, dofs: list[int], coefficients: list[float]) -> Constraint:
    """The limit of a fixed tendon along joints.

    Raises:
        Uncovered: it acts otherwise than the engine's do.
    """
    solref, solimp = model.tendon_solref_lim[t], model.tendon_solimp_lim[t]
    ends = within(model.tendon_range[t], model.tendon_margin[t])
    if not (_known(solref, solimp) and ends[0] < ends[1]):
        raise Uncovered(f"tendon {model.tendon(t).name!r} has a limit with {ODD}, or of which both ends act at once")
    return Constraint(dofs, coefficients, _numbers(model, ends, solref, solimp, float(model.tendon_invweight0[t])))


def ties(model: mujoco.MjModel) -> list[Constraint]:
    """Joints that an equality constraint holds in proportion to another, or where they are.

    Raises:
        Uncovered: there is another equality constraint.
    """
    if model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_EQUALITY:
        return []
    return [_tie(model, e) for e in np.flatnonzero(model.eq_active0).tolist()]


def settles(model: mujoco.MjModel) -> float:
    """The shortest time in which one of a model's limits or ties that the engine has settles, s; infinite without any.

    Example:
        >>> body = '<body><joint name="x" range="-1 1" limited="true" solreflimit="0.01 1"/><geom size="1"/></body>'
        >>> model = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{body}</worldbody></mujoco>")
        >>> round(settles(model), 4)
        0.01
    """
    found = [of_joint(model, k) for k in soft_limits(model).tolist()]
    with contextlib.suppress(Uncovered):  # then another simulates it
        found += ties(model)
        for t in np.flatnonzero(model.tendon_limited).tolist():
            found.append(of_tendon(model, t, [], []))
    fastest = 0.0
    for one in found:
        pull, half = _spring(one)
        fastest = max(fastest, half + math.sqrt(half**2 - pull) if half**2 > pull else math.sqrt(pull))
    return 1 / fastest if fastest > 0 else math.inf


def relaxes(model: mujoco.MjModel) -> float:
    """The longest time constant with which one of a model's ties that the engine has gives way, s; 0 without any.

    Example:
        >>> bodies = "".join(f'<body><joint name="{x}" type="slide"/><geom size="1"/></body>' for x in "ab")
        >>> tie = '<equality><joint joint1="a" joint2="b" solref="0.02 1"/></equality>'
        >>> model = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{bodies}</worldbody>{tie}</mujoco>")
        >>> round(relaxes(model), 4)
        0.02
    """
    found, slowest = list[Constraint](), 0.0
    with contextlib.suppress(Uncovered):
        found = ties(model)
    for one in found:
        pull, half = _spring(one)
        slow = half - math.sqrt(max(half**2 - pull, 0.0))
        slowest = max(slowest, 1 / slow if slow > 0 else math.inf)
    return slowest


def _spring(one: Constraint) -> tuple[float, float]:
    """Square of a constraint's rate, 1/s^2, and half its damping, 1/s: of what is wanted, as much comes about as it is
    hard.
    """
    hard = max(one.numbers[Stop.FIRST], one.numbers[Stop.LAST])
    return hard**2 * one.numbers[Stop.PULL], hard * one.numbers[Stop.DRAG] / 2


def _tie(model: mujoco.MjModel, e: int) -> Constraint:
    name = model.equality(e).name or e
    offset, ratio, *bends = model.eq_data[e, :5].tolist()
    if model.eq_type[e] != mujoco.mjtEq.mjEQ_JOINT or any(bends):
        raise Uncovered(f"equality constraint {name!r}, which is no proportion of two joints")
    solref, solimp = model.eq_solref[e], model.eq_solimp[e]
    if not _known(solref, solimp):
        raise Uncovered(f"equality constraint {name!r}, with {ODD}")
    joints = [int(k) for k in (model.eq_obj1id[e], model.eq_obj2id[e]) if k >= 0]
    along, dofs = [1.0, -ratio][: len(joints)], model.jnt_dofadr[joints].tolist()
    rest = offset + float(model.qpos0[model.jnt_qposadr[joints]] @ along)
    weight = float(model.dof_invweight0[dofs].sum())
    return Constraint(dofs, along, _numbers(model, (rest, rest), solref, solimp, weight))


def _known(solref: Array, solimp: Array) -> bool:
    """Whether a constraint is one of the two kinds of `solref`, and becomes harder by a formula that the engine has."""
    kind = (solref[0] > 0 and solref[1] > 0) or (solref[0] < 0 and solref[1] <= 0)
    harder = solimp[4] <= 1 or solimp[4] == 2 or solimp[0] == solimp[1]
    return bool(kind and harder)


def _numbers(
    model: mujoco.MjModel, ends: tuple[float, float], solref: Array, solimp: Array, weight: float
) -> list[float]:
    """What stands in the program; `weight` is the inverse inertia that MuJoCo takes for it."""
    first, last = np.clip(solimp[:2], mujoco.mjMINIMP, mujoco.mjMAXIMP).tolist()
    middle = float(np.clip(solimp[3], mujoco.mjMINIMP, mujoco.mjMAXIMP))
    if solref[0] < 0:
        pull, drag = -float(solref[0]), -float(solref[1])
    else:
        time, ratio = solref.tolist()
        if not model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_REFSAFE:
            time = max(time, 2 * model.opt.timestep)
        pull, drag = 1 / (time * ratio) ** 2, 2 / time
    if solimp[2] < mujoco.mjMINVAL:  # no depth at all from one impedance to the other
        impedances = [(first + last) / 2, (first + last) / 2, 1.0]
    else:
        impedances = [first, last, float(solimp[2])]
    return [*ends, pull / last**2, drag / last, weight, *impedances, middle, float(solimp[4] > 1)]
