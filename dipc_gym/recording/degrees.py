"""Angles that were most likely recorded in degrees, where the model reads radians."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from dipc_gym.mjcf import is_hinge
from dipc_gym.recording.tables import RecordingError

if TYPE_CHECKING:
    from dipc_gym.recording import Recording

TURNS = 2.0  # either way, that a joint with a weight on it seldom makes
BEYOND = 3.0  # times its range, where a joint has one
MOST = 1.1 * 360.0  # beyond this it would be many turns in degrees too


def look_like_degrees(recording: Recording, model: mujoco.MjModel) -> list[str]:
    """Names of the sensors whose angles go where their joint cannot, and would not in degrees.

    A joint without limits that carries no weight, such as a motor's axis, may turn as often as it likes, and is never
    among them.

    Args:
        recording: in SI units, as `recording.read` gives it.
        model: of the rig.
    """
    found = []
    for name, values in zip(recording.sensor_names, recording.sensors.T, strict=True):
        sensor = model.sensor(name)
        if sensor.type[0] != mujoco.mjtSensor.mjSENS_JOINTPOS or not is_hinge(model, joint := int(sensor.objid[0])):
            continue
        peak = float(np.max(np.abs(values)))
        if model.jnt_limited[joint]:
            reach = float(np.max(np.abs(model.jnt_range[joint])))
            suspect = peak > BEYOND * reach and math.radians(peak) <= BEYOND * reach
        else:
            suspect = 2 * math.pi * TURNS < peak <= MOST and _weighs(model, joint)
        if suspect:
            found.append(name)
    return found


def refuse_degrees(recordings: Iterable[Recording], model: mujoco.MjModel, told: Iterable[str]) -> None:
    """Stop where angles look like degrees, unless their unit was told.

    Args:
        recordings: as `recording.read` gives them.
        model: of the rig.
        told: sensors and columns that a unit was given for.

    Raises:
        RecordingError: with the file, the sensor, and what to say in either case.
    """
    told = set(told)
    for recording in recordings:
        for name in look_like_degrees(recording, model):
            if not told & {name, f"sensor:{name}"}:
                peak = float(np.max(np.abs(recording.sensors[:, recording.sensor_names.index(name)])))
                raise RecordingError(
                    f"{recording.path or recording.name}: sensor {name!r} reaches {peak:.4g} rad, which looks like "
                    f"degrees; say --unit {name}=deg if these are, or --unit {name}=rad if they are not"
                )


def _weighs(model: mujoco.MjModel, joint: int) -> bool:
    """Whether gravity turns a joint: its torque changes with the angle."""
    data = mujoco.MjData(model)
    torques = []
    for angle in (0.5, 2.0, 4.0):
        data.qpos[model.jnt_qposadr[joint]] = angle
        mujoco.mj_forward(model, data)
        torques.append(float(data.qfrc_bias[model.jnt_dofadr[joint]]))
    return float(np.ptp(torques)) > 1e-9
