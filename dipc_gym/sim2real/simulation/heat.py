"""How hot a motor's winding is when a window begins.

A winding remembers minutes, a window lasts a quarter of a second. So the temperature at each window's start comes
from one pass over the whole recording before it: the current follows from the command and from the measured speed,
i = (V - K w) / R, heats the winding by i^2 R, and the winding cools towards its surroundings. The recording is taken
to begin with a cold motor.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from dipc_gym import mjcf
from dipc_gym.physics import Physics
from dipc_gym.recording import Recording
from dipc_gym.recording.held import held_at
from dipc_gym.sim2real.simulation.motion import Motion

Array = NDArray[np.float64]

_BLOCK = 0.02  # s over which heating is averaged


def heating_motors(model: mujoco.MjModel) -> list[int]:
    """Parameters of the DC motors driven by a voltage whose resistance depends on their temperature."""
    return [
        i
        for i in range(model.nactuator)
        if model.actuator_gaintype[i] == mujoco.mjtGain.mjGAIN_DCMOTOR
        and model.actuator_ctrlspec[i] == mujoco.mjtCtrlInput.mjINPUT_VOLTAGE
        and model.actuator_dynprm[i, 2] > 0
    ]


@dataclass(frozen=True)
class _Winding:
    """One motor in several variants of a model; arrays (variants,), but for `lever`.

    Attributes:
        resistance: at the reference temperature, ohm.
        constant: torque per ampere and volt per speed, N m/A.
        coefficient: growth of the resistance, 1/K.
        offset: ambient above reference temperature, K.
        thermal: rise of the temperature per watt, K/W.
        time: of the temperature, s.
        lever: speed of the motor for unit speed of each base joint, (variants, nb).
    """

    resistance: Array
    constant: Array
    coefficient: Array
    offset: Array
    thermal: Array
    time: Array
    lever: Array

    def rise(self, drive: Array) -> Array:
        """Temperature above ambient at the borders of blocks with mean square drives (V - K w)^2 (variants, blocks).

        Over half a block, then over all of it with the resistance of its middle.
        """
        out = np.zeros((drive.shape[1] + 1, drive.shape[0]))
        half, whole = np.exp(-_BLOCK / 2 / self.time), np.exp(-_BLOCK / self.time)
        heating = self.thermal * drive.T / self.resistance
        towards_half, towards = (1 - half) * heating, (1 - whole) * heating
        cold = 1 + self.coefficient * self.offset
        for k in range(drive.shape[1]):
            middle = half * out[k] + towards_half[k] / (cold + self.coefficient * out[k])
            out[k + 1] = whole * out[k] + towards[k] / (cold + self.coefficient * middle)
        return out.T


def _winding(variants: Sequence[Physics], motor: int) -> _Winding:
    gain = np.stack([v.model.actuator_gainprm[motor] for v in variants])
    dynamics = np.stack([v.model.actuator_dynprm[motor] for v in variants])
    return _Winding(
        resistance=gain[:, 0],
        constant=gain[:, 1],
        coefficient=gain[:, 2],
        offset=dynamics[:, 4] - gain[:, 3],
        thermal=dynamics[:, 2],
        time=dynamics[:, 2] * dynamics[:, 3],
        lever=np.stack([_lever(v.model, motor) for v in variants]),
    )


def _lever(model: mujoco.MjModel, motor: int) -> Array:
    data, out = mujoco.MjData(model), mjcf.spread_out(model)
    speeds = []
    for column in out.T:
        data.qvel[:] = column
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        speeds.append(float(data.actuator_velocity[model.actuator_outadr[motor]]))
    return np.array(speeds)


def winding_temperatures(
    variants: Sequence[Physics], delays: Array, motor: int, recording: Recording, motion: Motion, time: Array
) -> Array:
    """Temperature of a winding above its surroundings, at times within a recording.

    Args:
        variants: one model with different parameters.
        delays: of each control, s, (variants, nu), on the clock of the motion.
        motor: number of the actuator.
        recording: the commands.
        motion: of the base joints in it.
        time: s, (n,); before the recording the motor is cold.

    Returns:
        K, (variants, n).
    """
    winding, model = _winding(variants, motor), variants[0].model
    control = int(model.actuator_ctrladr[motor])
    stamps = recording.time
    middle, step = (stamps[1:] + stamps[:-1]) / 2, np.diff(stamps)
    speed = motion.at(middle)[:, motion.velocity.shape[1] :]
    count = max(1, math.ceil((stamps[-1] - stamps[0]) / _BLOCK))
    borders = stamps[0] + _BLOCK * np.arange(count + 1)
    drive = np.empty((len(variants), count))
    for v, variant in enumerate(variants):
        volts = variant.command(held_at(recording, middle - delays[v, control]), middle)[:, control]
        volts = np.clip(volts, *(end[control] for end in variant.taken))
        square = (volts - winding.constant[v] * (speed @ winding.lever[v])) ** 2
        until = np.interp(borders, stamps, np.append(0.0, np.cumsum(square * step)))
        drive[v] = np.diff(until) / _BLOCK
    return np.stack([np.interp(time, borders, rise) for rise in winding.rise(drive)])
