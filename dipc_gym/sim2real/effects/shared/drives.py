"""What a command to an actuator does at its joint, told by MuJoCo."""

from __future__ import annotations

import copy

import mujoco

from dipc_gym import mjcf
from dipc_gym.sim2real.effects.shared.base import dof, joint_of


def drive_of(model: mujoco.MjModel, actuator: str) -> tuple[float, float]:
    """Force at the joint for each unit of command at rest, and the command that each unit of velocity is worth; none
    for an actuator of something else.

    A unit may be more than the actuator takes or gives, and may come later: limits and delays are left out.
    """
    joint = joint_of(model, actuator)
    if joint is None:
        return 0.0, 0.0
    model = copy.copy(model)
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CLAMPCTRL
    model.actuator_forcelimited[:], model.actuator_delay[:] = 0, 0.0
    data = mujoco.MjData(model)
    at, i = dof(model, joint), model.actuator(actuator).id
    out, gear = int(model.actuator_outadr[i]), mjcf.gear(model, i)
    control = int(model.actuator_ctrladr[i])
    kind = mujoco.mjtDyn
    filtered = int(model.actuator_dyntype[i]) in (int(kind.mjDYN_FILTER), int(kind.mjDYN_FILTEREXACT))
    winding = bool(model.actuator_dyntype[i] == kind.mjDYN_DCMOTOR and model.actuator_dynprm[i, 0] > 0)
    forces = []
    for command, velocity in ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0)):
        data.ctrl[:], data.qvel[:] = 0.0, 0.0
        data.ctrl[control], data.qvel[at] = command, velocity
        if filtered:
            data.act[model.actuator_actadr[i]] = command
        if winding:  # its current is the last of a motor's states, and at rest where it has settled
            current, rates = int(model.actuator_actadr[i] + model.actuator_actnum[i]) - 1, []
            for data.act[current] in (0.0, 1.0):
                mujoco.mj_forward(model, data)
                rates.append(float(data.act_dot[current]))
            data.act[current] = rates[0] / (rates[0] - rates[1])
        mujoco.mj_forward(model, data)
        forces.append(gear * float(data.actuator_force[out]))
    none, driven, moved = forces
    gain = driven - none
    return gain, (none - moved) / gain if gain else 0.0
