"""Angles that were most likely recorded in degrees for radians, and ways in millimetres for metres."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from numpy.typing import NDArray

from dipc_gym.mjcf import is_hinge
from dipc_gym.recording.columns import SENSOR, called
from dipc_gym.recording.settings import CHECKS, DEGREES
from dipc_gym.recording.tables import RecordingError

if TYPE_CHECKING:
    from dipc_gym.recording.record import Recording

ON_COMMAND_LINE = "say --unit {name}={odd} if these are, or --unit {name}={si} if they are not"
IN_PYTHON = (
    "read it with units={{{name!r}: '{odd}'}} if these are, or '{si}' if they are not (a Recording made by hand says "
    "told=({name!r},), with its numbers in {si})"
)


def refuse_odd_units(recordings: Sequence[Recording], model: mujoco.MjModel, *, mend: str = ON_COMMAND_LINE) -> None:
    """Stop where angles look like degrees or ways like millimetres, unless their unit was told.

    Args:
        recordings: in SI units; each knows which units were told when it was read.
        model: of the rig.
        mend: what to say, with `{name}` for the sensor, `{odd}` for the unit in doubt and `{si}` for the model's.

    Raises:
        RecordingError: with the file, the sensor, and what to say in either case.
    """
    refuse_degrees(recordings, model, mend=mend)
    refuse_millimetres(recordings, model, mend=mend)


def look_like_degrees(recording: Recording, model: mujoco.MjModel) -> list[str]:
    """Names of the sensors whose angles go where their joint cannot, and would not in degrees; and of all others, if
    their model moves as they say only where these are in degrees too.

    A joint without limits that carries no weight, such as a motor's axis, may turn as often as it likes, and is never
    among them; nor is a pole that goes round and round as its model says it must.

    Args:
        recording: in SI units, as `recording.read` gives it.
        model: of the rig.
    """
    found, angles = list[str](), list[str]()
    for name, values in zip(recording.sensor_names, recording.sensors.T, strict=True):
        sensor = model.sensor(name)
        if sensor.type[0] != mujoco.mjtSensor.mjSENS_JOINTPOS or not is_hinge(model, joint := int(sensor.objid[0])):
            continue
        angles.append(name)
        peak = float(np.max(np.abs(values)))
        if model.jnt_limited[joint]:
            reach = float(np.max(np.abs(model.jnt_range[joint])))
            suspect = peak > DEGREES.beyond * reach and math.radians(peak) <= DEGREES.beyond * reach
        else:
            suspect = 2 * math.pi * DEGREES.turns < peak <= DEGREES.most and _weighs(model, joint)
        if suspect:
            found.append(name)
    if not found:
        return []
    others = [name for name in angles if name not in recording.told]
    as_read, some, every = (_off_in_degrees(recording, model, found, which) for which in ([], found, others))
    if as_read < DEGREES.clearly * min(some, every):
        return []
    return others if every < DEGREES.clearly * some else found


def refuse_degrees(
    recordings: Iterable[Recording], model: mujoco.MjModel, told: Iterable[str] = (), *, mend: str = ON_COMMAND_LINE
) -> None:
    """Stop where angles look like degrees, unless their unit was told.

    Args:
        recordings: in SI units; each knows which units were told when it was read.
        model: of the rig.
        told: further sensors and columns that a unit was given for.
        mend: see `refuse_odd_units`.

    Raises:
        RecordingError: with the file, the sensor, and what to say in either case.
    """
    told = set(told)
    for recording in recordings:
        known = {*recording.told, *told}
        odd = [name for name in look_like_degrees(recording, model) if not known & {name, f"sensor:{name}"}]
        if odd:
            peaks = [float(np.max(np.abs(recording.sensors[:, recording.sensor_names.index(name)]))) for name in odd]
            reach = " and ".join(
                f"sensor {name!r} reaches {peak:.4g} rad" for name, peak in zip(odd, peaks, strict=True)
            )
            rates = [rate for name in odd for rate in _rates(recording, model, name) if rate not in known]
            mends = ", and ".join(
                [_mended(mend, recording, name, "deg", "rad") for name in odd]
                + [_mended(mend, recording, rate, "deg/s", "rad/s") for rate in rates]
            )
            raise RecordingError(f"{recording.path or recording.name}: {reach}, which looks like degrees; {mends}")


def refuse_millimetres(recordings: Iterable[Recording], model: mujoco.MjModel, *, mend: str = ON_COMMAND_LINE) -> None:
    """Stop where ways look like millimetres, unless their unit was told; see `refuse_degrees`.

    They do where a slide goes where it cannot, and would not in millimetres; or where one without limits goes further
    than rigs go, and faster by far than its model's forces drive it.

    Raises:
        RecordingError: with the file, the sensor, and what to say in either case.
    """
    for recording in recordings:
        for name, values in zip(recording.sensor_names, recording.sensors.T, strict=True):
            sensor = model.sensor(name)
            if {name, f"sensor:{name}"} & {*recording.told} or sensor.type[0] != mujoco.mjtSensor.mjSENS_JOINTPOS:
                continue
            joint, peak = int(sensor.objid[0]), float(np.max(np.abs(values)))
            if is_hinge(model, joint) or not _in_millimetres(recording, model, name, joint, peak):
                continue
            raise RecordingError(
                f"{recording.path or recording.name}: sensor {name!r} reaches {peak:.4g} m, which looks like "
                f"millimetres; {_mended(mend, recording, name, 'mm', 'm')}"
            )


def _in_millimetres(recording: Recording, model: mujoco.MjModel, name: str, joint: int, peak: float) -> bool:
    if model.jnt_limited[joint]:
        reach = DEGREES.beyond * float(np.max(np.abs(model.jnt_range[joint])))
        return peak > reach >= peak / 1e3
    if peak <= CHECKS.far_slide:
        return False
    smaller = recording.sensors.copy()
    smaller[:, recording.sensor_names.index(name)] /= 1e3
    known = _accelerations(recording, smaller, model, [name])
    if known is None:
        return False
    measured, found = (float(np.linalg.norm(each)) for each in known)
    return found < DEGREES.drives * 1e3 * measured


def _rates(recording: Recording, model: mujoco.MjModel, name: str) -> list[str]:
    """Names of the sensors that read the speed of the joint whose angle one reads."""
    rates = [one for one in recording.sensor_names if model.sensor(one).type[0] == mujoco.mjtSensor.mjSENS_JOINTVEL]
    return [one for one in rates if model.sensor(one).objid[0] == model.sensor(name).objid[0]]


def _mended(mend: str, recording: Recording, name: str, odd: str, si: str) -> str:
    """What to say of a sensor whose unit is in doubt."""
    return mend.format(name=called(SENSOR, name, recording.actuator_names), odd=odd, si=si)


def turns(recording: Recording, model: mujoco.MjModel, names: list[str]) -> bool:
    """Whether a model's accelerations say that these angles are in radians: a pole may well go round and round."""
    as_read, converted = (_off_in_degrees(recording, model, names, which) for which in ([], names))
    return as_read < DEGREES.clearly * converted


def _off_in_degrees(recording: Recording, model: mujoco.MjModel, names: list[str], which: list[str]) -> float:
    """How far accelerations of some sensors are from the model's, relative to their size, with some in degrees."""
    sensors = recording.sensors.copy()
    sensors[:, [recording.sensor_names.index(name) for name in which]] *= math.pi / 180
    return _off(recording, sensors, model, names)


def _off(recording: Recording, sensors: NDArray[np.float64], model: mujoco.MjModel, names: list[str]) -> float:
    """How far accelerations of these sensors are from the model's, relative to their size."""
    known = _accelerations(recording, sensors, model, names)
    if known is None:
        return 1.0
    measured, found = known
    return float(np.linalg.norm(measured - found)) / max(float(np.linalg.norm(measured)), 1e-300)


def _accelerations(
    recording: Recording, sensors: NDArray[np.float64], model: mujoco.MjModel, names: list[str]
) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    """Accelerations of some sensors as measured, and the model's, (k, names) each; None of too few samples."""
    from scipy.signal import savgol_filter  # takes a second to import, and few recordings need it

    read = {
        name: int(model.sensor(name).objid[0])
        for name in recording.sensor_names
        if model.sensor(name).type[0] == mujoco.mjtSensor.mjSENS_JOINTPOS
    }
    period = float(np.median(np.diff(recording.time)))
    length = max(5, 2 * round(DEGREES.smooth / period / 2) + 1)
    if len(sensors) < length:
        return None
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
    return motion[2][which][:, [recording.sensor_names.index(name) for name in names]], found


def _weighs(model: mujoco.MjModel, joint: int) -> bool:
    """Whether gravity turns a joint: its torque changes with the angle."""
    data = mujoco.MjData(model)
    torques = []
    for angle in (0.5, 2.0, 4.0):
        data.qpos[model.jnt_qposadr[joint]] = angle
        mujoco.mj_forward(model, data)
        torques.append(float(data.qfrc_bias[model.jnt_dofadr[joint]]))
    return float(np.ptp(torques)) > DEGREES.weight
