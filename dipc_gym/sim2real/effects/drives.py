"""What a command to an actuator does at its joint, told by MuJoCo."""

from __future__ import annotations

import mujoco

from dipc_gym.sim2real.effects.base import dof, joint_of


def drive_of(model: mujoco.MjModel, actuator: str) -> tuple[float, float]:
    """Force at the joint for each unit of command at rest, and the command that each unit of velocity is worth; none
    for an actuator of something else.
    """
    joint, data = joint_of(model, actuator), mujoco.MjData(model)
    if joint is None:
        return 0.0, 0.0
    at, control = dof(model, joint), int(model.actuator_ctrladr[model.actuator(actuator).id])
    forces = []
    for command, velocity in ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0)):
        data.ctrl[:], data.qvel[:] = 0.0, 0.0
        data.ctrl[control], data.qvel[at] = command, velocity
        mujoco.mj_forward(model, data)
        forces.append(float(data.qfrc_actuator[at]))
    none, driven, moved = forces
    gain = driven - none
    return gain, (none - moved) / gain if gain else 0.0
