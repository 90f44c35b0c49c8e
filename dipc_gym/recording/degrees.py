"""Angles that were most likely recorded in degrees, where the model reads radians."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from numpy.typing import NDArray

from dipc_gym.mjcf import is_hinge
from dipc_gym.recording.columns import SENSOR, called
from dipc_gym.recording.settings import DEGREES
from dipc_gym.recording.tables import RecordingError

if TYPE_CHECKING:
    from dipc_gym.recording.record import Recording

ON_COMMAND_LINE = "say --unit {name}=deg if these are, or --unit {name}=rad if they are not"
IN_PYTHON = (
    "read it with units={{{name!r}: 'deg'}} if these are, or 'rad' if they are not (a Recording made by hand says "
    "told=({name!r},), with its angles in rad)"
)


def look_like_degrees(recording: Recording, model: mujoco.MjModel) -> list[str]:
    """Names of the sensors whose angles go where their joint cannot, and would not in degrees.

    A joint without limits that carries no weight, such as a motor's axis, may turn as often as it likes, and is never
    among them; nor is a pole that goes round and round as its model says it must.

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
            suspect = peak > DEGREES.beyond * reach and math.radians(peak) <= DEGREES.beyond * reach
        else:
            suspect = 2 * math.pi * DEGREES.turns < peak <= DEGREES.most and _weighs(model, joint)
        if suspect:
            found.append(name)
    return found if found and not turns(recording, model, found) else []


def refuse_degrees(
    recordings: Iterable[Recording], model: mujoco.MjModel, told: Iterable[str] = (), *, mend: str = ON_COMMAND_LINE
) -> None:
    """Stop where angles look like degrees, unless their unit was told.

    Args:
        recordings: in SI units; each knows which units were told when it was read.
        model: of the rig.
        told: further sensors and columns that a unit was given for.
        mend: what to say in either case, with `{name}` for the sensor.

    Raises:
        RecordingError: with the file, the sensor, and what to say in either case.
    """
    told = set(told)
    for recording in recordings:
        for name in look_like_degrees(recording, model):
            if name not in recording.told and not told & {name, f"sensor:{name}"}:
                peak = float(np.max(np.abs(recording.sensors[:, recording.sensor_names.index(name)])))
                raise RecordingError(
                    f"{recording.path or recording.name}: sensor {name!r} reaches {peak:.4g} rad, which looks like "
                    f"degrees; {mend.format(name=called(SENSOR, name, recording.actuator_names))}"
                )


def turns(recording: Recording, model: mujoco.MjModel, names: list[str]) -> bool:
    """Whether a model's accelerations say that these angles are in radians: a pole may well go round and round."""
    columns = [recording.sensor_names.index(name) for name in names]
    in_degrees = recording.sensors.copy()
    in_degrees[:, columns] *= math.pi / 180
    far = [_off(recording, sensors, model, names) for sensors in (recording.sensors, in_degrees)]
    return far[0] < DEGREES.clearly * far[1]


def _off(recording: Recording, sensors: NDArray[np.float64], model: mujoco.MjModel, names: list[str]) -> float:
    """How far accelerations of these sensors are from the model's, relative to their size."""
    from scipy.signal import savgol_filter  # takes a second to import, and few recordings need it

    read = {
        name: int(model.sensor(name).objid[0])
        for name in recording.sensor_names
        if model.sensor(name).type[0] == mujoco.mjtSensor.mjSENS_JOINTPOS
    }
    period = float(np.median(np.diff(recording.time)))
    length = max(5, 2 * round(DEGREES.smooth / period / 2) + 1)
    if len(sensors) < length:
        return 1.0
    motion = [savgol_filter(sensors, length, 3, deriv=order, delta=period, axis=0) for order in range(3)]
    data = mujoco.MjData(model)
    which = np.linspace(0, len(sensors) - 1, min(DEGREES.samples, len(sensors))).astype(np.intp)
    found = np.empty((len(which), len(names)))
    for row, k in enumerate(which):
        for name, joint in read.items():
            column = recording.sensor_names.index(name)
            data.qpos[model.jnt_qposadr[joint]] = motion[0][k, column]
            data.qvel[model.jnt_dofadr[joint]] = motion[1][k, column]
        data.ctrl[: recording.commands.shape[1]] = recording.commands[k]
        mujoco.mj_forward(model, data)
        found[row] = [data.qacc[model.jnt_dofadr[read[name]]] for name in names]
    measured = motion[2][which][:, [recording.sensor_names.index(name) for name in names]]
    return float(np.linalg.norm(measured - found)) / max(float(np.linalg.norm(measured)), 1e-300)


def _weighs(model: mujoco.MjModel, joint: int) -> bool:
    """Whether gravity turns a joint: its torque changes with the angle."""
    data = mujoco.MjData(model)
    torques = []
    for angle in (0.5, 2.0, 4.0):
        data.qpos[model.jnt_qposadr[joint]] = angle
        mujoco.mj_forward(model, data)
        torques.append(float(data.qfrc_bias[model.jnt_dofadr[joint]]))
    return float(np.ptp(torques)) > DEGREES.weight
