"""Compiled code beside MuJoCo: a program that says something else is refused."""

from __future__ import annotations

import copy
from collections.abc import Callable

import mujoco
import numpy as np
from numpy.typing import NDArray

from dipc_gym import mjcf
from dipc_gym.engine.constraints import soft_limits, stiff_limits
from dipc_gym.engine.layout import Head, Joint
from dipc_gym.engine.program import Program
from dipc_gym.engine.run import rates
from dipc_gym.engine.uncovered import Uncovered
from dipc_gym.physics import Physics

Array = NDArray[np.float64]

STATES = 6  # random states compared
TOLERANCE = 1e-9  # of the largest acceleration, and of the largest rate


def check(program: Program, parameters: Array, source: Physics, rates: Callable[..., Array] = rates) -> bool:
    """Compare accelerations and rates of hidden states with MuJoCo's at random states.

    Where joints would have less inertia than none, there is nothing to compare: both say nonsense.

    Args:
        program: of the model.
        parameters: those of `source`, (k,).
        source: the model.
        rates: what is compared; see `run.rates`.

    Returns:
        Whether there was something to compare.

    Raises:
        Uncovered: they differ; the message says where.
    """
    rng = np.random.default_rng(0)
    model = copy.copy(source.model)
    model.dof_frictionloss[:] = 0.0
    model.actuator_delay[:], model.sensor_delay[:] = 0.0, 0.0
    model.actuator_actearly[:] = False
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4  # its discrete one gives steps in the place of accelerations
    model.opt.tolerance = 0.0
    data, commanded = mujoco.MjData(model), int(program.codes[Head.CONTROLS])
    smooth = parameters.copy()
    first = int(program.codes[Head.JOINT_NUMBERS])
    smooth[first + Joint.FRICTION : first + model.nv * Joint.SIZE : Joint.SIZE] = 0.0
    n, size, limited = model.nv, _sizes(model), model.tendon_limited.astype(bool)
    yielding = np.flatnonzero(model.tendon_plasticadr >= 0)
    applied, levels, slides = np.zeros(n), np.zeros(n), np.ones(n)
    stiff, soft = stiff_limits(model), soft_limits(model)
    ends = np.concatenate([model.jnt_range[soft], model.tendon_range[limited]])
    margin = np.concatenate([model.jnt_margin[soft], model.tendon_margin[limited]])
    low, high = (np.where(stiff, model.jnt_range[:, k], sign * np.inf) for k, sign in ((0, -1), (1, 1)))
    inner = np.where(stiff, model.jnt_margin + 1e-3 * (model.jnt_range[:, 1] - model.jnt_range[:, 0]), 0.0)
    low, high = low + inner, high - inner
    compared = False
    for _ in range(STATES):
        data.qpos[:] = np.clip(model.qpos0 + rng.normal(size=n) * size, low, high)
        data.qvel[:] = rng.normal(size=n) * size
        data.act[:] = 0.01 * rng.normal(size=model.na)
        data.ctrl[:commanded] = rng.normal(size=commanded)
        data.qfrc_applied[:] = 0.0
        data.time = float(rng.uniform(0, 10))
        data.userdata[:] = rng.uniform(size=model.nuserdata) * size.min()
        mujoco.mj_forward(model, data)
        if len(yielding):  # MuJoCo holds them to what they bear at the end of a step, not in between
            bend = rng.uniform(-1, 1, len(yielding)) * model.tendon_springyield[yielding]
            rests = data.ten_length[yielding] - bend
            for at in model.tendon_plasticadr[yielding], model.tendon_plasticadr[yielding] + 1:
                data.plastic[at] = rests
            mujoco.mj_forward(model, data)
        if source.acts:
            applied[:], levels[:] = 0.0, 0.0
            source.act(data, levels, applied, slides=slides)
            data.qfrc_applied[:] = applied - np.sign(data.qvel) * levels
            mujoco.mj_forward(model, data)
        if not _inert(model, data):
            continue
        compared = True
        states = np.zeros(program.nx)
        states[:n], states[n : 2 * n], states[2 * n : 2 * n + model.na] = data.qpos, data.qvel, data.act
        if len(yielding):
            states[2 * n + model.na : 2 * n + model.na + len(yielding)] = rests
        first = 2 * n + model.na + len(yielding)
        remembered, grown = data.userdata.copy(), source.grown(data, slides)
        states[first : first + len(grown)] = remembered[len(remembered) - len(grown) :]
        length = np.concatenate([data.qpos[soft], data.ten_length[limited]])
        met = (length < ends[:, 0] + margin) | (length > ends[:, 1] - margin)
        found = rates(program, smooth, states, data.ctrl[:commanded].copy(), data.time, met.tolist())
        for what, ours, theirs in (
            ("accelerations", found[n : 2 * n], data.qacc),
            ("rates of hidden states", found[2 * n : 2 * n + model.na], data.act_dot),
            ("rates of what laws remember", found[first : first + len(grown)], grown),
        ):
            if not np.isfinite(theirs).all():
                raise Uncovered(f"{what} that are no numbers to MuJoCo itself")
            if len(theirs) and not np.allclose(ours, theirs, rtol=TOLERANCE, atol=TOLERANCE * np.abs(theirs).max()):
                worst = int(np.argmax(np.abs(ours - theirs)))
                raise Uncovered(f"{what} that differ from MuJoCo's: {ours[worst]:.9g}, not {theirs[worst]:.9g}")
    return compared


def _inert(model: mujoco.MjModel, data: mujoco.MjData) -> bool:
    """Whether all joints have inertia; a negative armature, which takes away what swings, may take more than that."""
    if model.dof_armature.min(initial=0.0) >= 0:
        return True
    inertia = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, inertia)
    return bool(np.linalg.eigvalsh(inertia)[0] > 0)


def _sizes(model: mujoco.MjModel) -> Array:
    """How far joints are moved: angles by about a radian, slides by about the model's size."""
    hinges = np.array([mjcf.is_hinge(model, joint) for joint in range(model.njnt)], dtype=bool)
    return np.where(hinges, 1.0, 0.1 * model.stat.extent)
