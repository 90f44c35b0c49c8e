"""Numbers of a compiled model that MuJoCo lets pass and nothing can be simulated with."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from dipc_gym.mjcf.scan import MjcfError

SHORTEST, LONGEST = 1e-7, 1.0
"""Time steps, s."""
LARGEST = 1e12
"""Of numbers that forces and motion are worked out from; MuJoCo's own bound on a state is 1e10."""
SINGULAR = 1e-13
"""Share of a joint's inertia that is left to it once all others are free to move."""
LIGHTEST = 1e-10
"""Inertia of a joint, kg or kg m^2; a force of 1 N on less moves it out of sight within a step."""
MOVING = ("body_", "dof_", "jnt_", "qpos", "actuator_", "tendon_", "eq_", "sensor_")


def check_numbers(model: mujoco.MjModel, name: str) -> None:
    """Refuse a model whose numbers are no numbers, or leave a joint without inertia.

    Args:
        model: compiled.
        name: what messages call it, as its file.

    Raises:
        MjcfError: the time step is absurd; a NaN, or a number beyond all measure, in what moves; or a joint that
            nothing with a mass hangs on.

    Example:
        >>> check_numbers(mujoco.MjModel.from_xml_string('<mujoco><option timestep="nan"/></mujoco>'), "rig.xml")
        Traceback (most recent call last):
        dipc_gym.mjcf.scan.MjcfError: rig.xml: the timestep is nan s; give <option timestep=...> from 1e-07 to 1 s
    """
    step = model.opt.timestep
    if not SHORTEST <= step <= LONGEST:
        raise MjcfError(
            f"{name}: the timestep is {step:g} s; give <option timestep=...> from {SHORTEST:g} to {LONGEST:g} s"
        )
    for field in ("gravity", "wind", "magnetic", "density", "viscosity"):
        _check(np.atleast_1d(getattr(model.opt, field)), f"<option {field}>", name)
    for field in (field for field in dir(model) if field.startswith(MOVING)):
        values = getattr(model, field)
        # Inverse weights are MuJoCo's own, and large where two tendons are one.
        if isinstance(values, np.ndarray) and values.dtype.kind == "f" and "invweight" not in field:
            _check(values, field, name)
    _check_inertia(model, name)


def _check(values: NDArray[np.float64], field: str, name: str) -> None:
    wrong = ~(np.abs(values) <= LARGEST)
    if wrong.any():
        place = np.unravel_index(int(np.argmax(wrong)), values.shape)
        raise MjcfError(
            f"{name}: compiles to {values[place]:g} in {field}, entry {int(place[0])}; correct the number that this "
            "comes from"
        )


def _check_inertia(model: mujoco.MjModel, name: str) -> None:
    """By the pivots of the mass matrix at the reference position."""
    if not model.nv:
        return
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    mujoco.mj_tendon(model, data)  # its armature is in the mass matrix
    mujoco.mj_crb(model, data)
    mujoco.mj_factorM(model, data)
    whole = np.zeros((model.nv, 1))
    unit = np.zeros((model.nv, 1))
    left = 1.0 / np.asarray(data.qLDiagInv)
    for j in range(model.nv):
        unit[:] = 0.0
        unit[j] = 1.0
        mujoco.mj_mulM(model, data, whole[:, 0], unit[:, 0])
        if not (left[j] > SINGULAR * whole[j, 0] and left[j] >= LIGHTEST):
            joint = model.joint(int(model.dof_jntid[j]))
            raise MjcfError(
                f"{name}: joint {joint.name or joint.id!r} has an inertia of {left[j]:.3g} (kg, or kg m^2) of its own; "
                f"it needs {LIGHTEST:g} or more: give its body a mass, or the joint an armature"
            )
