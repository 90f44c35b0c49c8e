"""Recordings as files: read them by a model's names, and write them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from dipc_gym import mjcf
from dipc_gym.recording import checks
from dipc_gym.recording.columns import COMMAND, SENSOR, match_columns, unit_factors
from dipc_gym.recording.record import Recording, check_numbers
from dipc_gym.recording.tables import RecordingError, check_format, read_table, write_table
from dipc_gym.recording.units import of_command, of_sensor

if TYPE_CHECKING:
    import mujoco

MIN_SAMPLES = 20  # fewer rows cannot tell motion from noise


def read(
    path: str | Path,
    model: mujoco.MjModel,
    *,
    mapping: Mapping[str, str] | None = None,
    units: Mapping[str, str] | None = None,
) -> Recording:
    """Read a recording of the rig that `model` describes.

    Args:
        path: a `.csv`, `.parquet` or `.npz` file with the columns `time`, one per control and one per scalar sensor.
        model: gives the names.
        mapping: file column -> name in the model (or `time`), for files with other names.
        units: file column or model name -> unit it is in, as `{"theta1": "deg", "time": "ms"}`; converted to SI.

    Returns:
        The recording. Angles that start again after a turn are counted on. That, and what is odd but usable
        (constant or clipped channels, ignored columns, values that look like degrees, velocities that are not the
        rates of their positions), stands in its `notes`.

    Raises:
        RecordingError: a missing or ambiguous column, a cell that is not a finite number, time that does not
            increase, fewer than 20 samples, a unit that measures something else, or a file that cannot be read.
    """
    path = Path(path)
    mapping, units = dict(mapping or {}), dict(units or {})
    wanted: dict[str, str] = {}  # channel, with prefix -> file column
    ctrl, sensor = mjcf.controls(model), mjcf.scalar_sensors(model)

    def choose(names: Sequence[str]) -> Sequence[str]:
        wanted.update(match_columns(str(path), names, ctrl, sensor, mapping))
        return list(wanted.values())

    table = read_table(path, choose)
    read_in = {SENSOR + name: of_sensor(model, name) for name in sensor}
    # A model does not say what its commands are measured in, but for servos, that are asked for where to be.
    asked = {COMMAND + name: of_command(model, name) for name in ctrl}
    sent_in = {channel: unit for channel, unit in asked.items() if unit.removesuffix("/s") in ("m", "rad")}
    factors = unit_factors(str(path), wanted, units, {"time": "s"} | read_in | sent_in)
    columns = {channel: table.columns[name] * factors.get(channel, 1.0) for channel, name in wanted.items()}
    if len(columns["time"]) < MIN_SAMPLES:
        raise RecordingError(f"{path}: {len(columns['time'])} samples are too few; at least {MIN_SAMPLES} are needed")
    check_numbers(str(path), table.lines, {wanted[channel]: values for channel, values in columns.items()})
    ignored = tuple(name for name in table.names if name not in wanted.values())
    angles = [channel for channel, unit in read_in.items() if unit == "rad"]
    turned = {channel: checks.counted_on(columns[channel]) for channel in angles}
    notes = [
        f"sensor {channel.removeprefix(SENSOR)!r} starts again after a turn, {jumps} times; turns are counted on"
        for channel, on in turned.items()
        if (jumps := np.count_nonzero(np.abs(np.diff(columns[channel] - on)) > 1))
    ]
    columns |= turned
    n = len(columns["time"])
    recording = Recording(
        name=path.stem,
        time=columns["time"],
        commands=np.column_stack([np.empty((n, 0)), *(columns[COMMAND + name] for name in ctrl)]),
        sensors=np.column_stack([np.empty((n, 0)), *(columns[SENSOR + name] for name in sensor)]),
        actuator_names=tuple(ctrl),
        sensor_names=tuple(sensor),
        path=path,
        ignored=ignored,
        sha256=table.sha256,
        told=(
            *(name for name in sensor if SENSOR + name in factors),
            *(COMMAND + name for name in ctrl if COMMAND + name in factors),
        ),
    )
    return replace(recording, notes=(*notes, *checks.notes(recording, model)))


def read_all(
    paths: Iterable[str | Path],
    model: mujoco.MjModel,
    *,
    mapping: Mapping[str, str] | None = None,
    units: Mapping[str, str] | None = None,
) -> list[Recording]:
    """Read several recordings of one rig; arguments and errors as `read`."""
    return [read(path, model, mapping=mapping, units=units) for path in paths]


def write(recording: Recording, path: str | Path, *, overwrite: bool = False) -> Path:
    """Write a recording as CSV, Parquet or npz; read again it has the same bits, but for angles that `read` counts on.

    The file appears whole or not at all.

    Raises:
        RecordingError: unknown suffix, missing folder, or the file exists and `overwrite` is not set.
    """
    path = Path(path)
    check_format(path)
    write_table(path, recording.columns(), overwrite=overwrite)
    return path
