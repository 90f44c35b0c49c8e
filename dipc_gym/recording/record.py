"""Recordings: what was commanded and what was sensed, by the model's names, in SI units.

A command holds from its time stamp until the next; a sensor is read at its time stamp, before that command
acts. Sampling may be irregular. Where an actuator and a sensor share a name, `ctrl:` and `sensor:` tell their
columns apart.
"""

from __future__ import annotations

import functools
import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from dipc_gym.recording.columns import COMMAND, SENSOR
from dipc_gym.recording.settings import CHECKS
from dipc_gym.recording.tables import RecordingError, row_label

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

LARGEST = 1e20
"""Of all numbers, whatever their unit; squares of much larger ones are no numbers."""


@dataclass(frozen=True, eq=False)
class Recording:
    """One run of a rig.

    Attributes:
        name: short name, the file's stem.
        time: (n,) s, strictly increasing.
        commands: (n, nu) held from their stamp until the next, in the actuators' units.
        sensors: (n, ns) read at their stamp, SI.
        actuator_names: names of the columns of `commands`.
        sensor_names: names of the columns of `sensors`.
        path: the file, if there is one.
        ignored: columns of the file that the model does not know.
        notes: what the owner should know about this recording, in sentences.
        sha256: digest of the file, or of the numbers where there is none.
        told: sensors, and commands as `ctrl:NAME`, whose unit was told; they are believed, whatever their numbers look
            like.

    Raises:
        RecordingError: shapes that do not fit, numbers that are not finite, time that does not increase.
    """

    name: str
    time: NDArray[np.float64]
    commands: NDArray[np.float64]
    sensors: NDArray[np.float64]
    actuator_names: tuple[str, ...]
    sensor_names: tuple[str, ...]
    path: Path | None = None
    ignored: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    sha256: str = ""
    told: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        where = str(self.path or self.name)
        for attribute in ("actuator_names", "sensor_names"):
            object.__setattr__(self, attribute, tuple(getattr(self, attribute)))
        for attribute in ("time", "commands", "sensors"):
            object.__setattr__(self, attribute, _frozen(getattr(self, attribute)))
        n = len(self.time) if self.time.ndim == 1 else 0
        if not n:
            raise RecordingError(f"{where}: time has shape {self.time.shape}; it must list at least one number")
        for kind, names, values in (
            ("commands", self.actuator_names, self.commands),
            ("sensors", self.sensor_names, self.sensors),
        ):
            if values.shape != (n, len(names)):
                raise RecordingError(
                    f"{where}: {kind} has shape {values.shape}, but {n} samples of {list(names)} need {(n, len(names))}"
                )
        check_numbers(where, (), self.columns())
        if not self.sha256:
            digest = hashlib.sha256(repr((self.actuator_names, self.sensor_names)).encode())
            for values in (self.time, self.commands, self.sensors):
                digest.update(values.tobytes())
            object.__setattr__(self, "sha256", digest.hexdigest())

    def __len__(self) -> int:
        return len(self.time)

    @property
    def duration(self) -> float:
        """Time from the first to the last sample, s."""
        return float(self.time[-1] - self.time[0])

    @functools.cached_property
    def period(self) -> float:
        """Median time between samples, s (0 for a single sample)."""
        return float(np.median(np.diff(self.time))) if len(self) > 1 else 0.0

    @functools.cached_property
    def goes_on(self) -> NDArray[np.float64]:
        """When it begins, and when it goes on after each gap, in which samples are missing, s: what was commanded in
        one is not known.
        """
        steps = np.diff(self.time)
        if not len(steps):
            return self.time[:1]
        gaps = steps > CHECKS.gap * np.quantile(steps, CHECKS.steady_clock)
        return self.time[np.append(True, gaps)]

    def slice(self, start: int, stop: int) -> Recording:
        """Samples `start` to `stop` (exclusive), counted as Python counts; time stamps stay as they are.

        Raises:
            RecordingError: the slice is empty.
        """
        part = slice(start, stop)
        first, last, _ = part.indices(len(self))
        if first >= last:
            raise RecordingError(f"{self.name}: no samples between {start} and {stop} of {len(self)}")
        return replace(
            self,
            name=f"{self.name}[{first}:{last}]",
            time=self.time[part],
            commands=self.commands[part],
            sensors=self.sensors[part],
        )

    def split(self, fraction: float) -> tuple[Recording, Recording]:
        """The first `fraction` of the samples, and the rest.

        Raises:
            RecordingError: one of the two would be empty.
        """
        border = round(fraction * len(self))
        if not 0 < border < len(self):
            raise RecordingError(f"{self.name}: cannot split {len(self)} samples at the fraction {fraction}")
        return self.slice(0, border), self.slice(border, len(self))

    def columns(self) -> dict[str, NDArray[np.float64]]:
        """All columns under the names they have in a file, time first."""
        shared = {"time", *self.actuator_names} & {"time", *self.sensor_names} | {
            name for name in (*self.actuator_names, *self.sensor_names) if name.startswith((COMMAND, SENSOR))
        }
        table = {"time": self.time}
        for prefix, names, values in (
            (COMMAND, self.actuator_names, self.commands),
            (SENSOR, self.sensor_names, self.sensors),
        ):
            for k, name in enumerate(names):
                label = prefix + name if name in shared else name
                if label in table:
                    raise RecordingError(f"{self.name}: the name {name!r} appears twice")
                table[label] = values[:, k]
        return table


class Recorder:
    """Collects samples while something runs.

    Args:
        actuator_names: names of the commands.
        sensor_names: names of the sensors.

    Example:
        >>> recorder = Recorder(["motor"], ["cart"])
        >>> recorder.append(0.0, [1.0], [0.0])
        >>> recorder.append(0.1, [1.0], [0.002])
        >>> recorder.recording("run").duration
        0.1
    """

    def __init__(self, actuator_names: Sequence[str], sensor_names: Sequence[str]) -> None:
        self.actuator_names, self.sensor_names = tuple(actuator_names), tuple(sensor_names)
        self._rows: list[NDArray[np.float64]] = []

    def __len__(self) -> int:
        return len(self._rows)

    def append(self, time: float, command: ArrayLike, sensors: ArrayLike) -> None:
        """Add a sample: sensors read at `time`, and the command that holds from then on.

        Raises:
            RecordingError: not as many numbers as there are names.
        """
        command, sensors = np.ravel(command), np.ravel(sensors)
        if len(command) != len(self.actuator_names) or len(sensors) != len(self.sensor_names):
            raise RecordingError(
                f"a sample has {len(command)} commands and {len(sensors)} sensors, but the names are "
                f"{list(self.actuator_names)} and {list(self.sensor_names)}"
            )
        self._rows.append(np.concatenate([[time], command, sensors]).astype(np.float64))

    def recording(self, name: str) -> Recording:
        """What was collected so far.

        Raises:
            RecordingError: nothing was; a number is not finite; time does not increase.
        """
        if not self._rows:
            raise RecordingError(f"{name}: nothing was recorded")
        table = np.stack(self._rows)
        nu = len(self.actuator_names)
        return Recording(
            name,
            table[:, 0],
            table[:, 1 : nu + 1],
            table[:, nu + 1 :],
            self.actuator_names,
            self.sensor_names,
        )


def _frozen(values: ArrayLike) -> NDArray[np.float64]:
    array = np.array(values, dtype=np.float64, order="C")
    array.flags.writeable = False
    return array


def check_numbers(where: str, lines: Sequence[int], columns: Mapping[str, NDArray[np.float64]]) -> None:
    """Refuse columns (the first is time) that hold what no rig gives, or a time that does not increase.

    Raises:
        RecordingError: with file, row and column.
    """
    for name, values in columns.items():
        bad = np.flatnonzero(~(np.abs(values) <= LARGEST))
        if len(bad):
            what = "beyond all measure" if np.isfinite(values[bad[0]]) else "not a finite number"
            raise RecordingError(
                f"{where}, {row_label(lines, int(bad[0]))}, column {name!r}: {values[bad[0]]} is {what} "
                f"({len(bad)} such cells); remove these rows or fill them"
            )
    time = next(iter(columns.values()))
    back = np.flatnonzero(np.diff(time) <= 0)
    if len(back):
        k = int(back[0]) + 1
        mend = "drop the rows that repeat a time, and cut the file in two where a clock began anew"
        if len(back) > CHECKS.rounded * len(time) and not (np.diff(time) < 0).any():
            mend = "only rounded stamps repeat so often: write more digits, or number evenly sampled rows evenly"
        raise RecordingError(
            f"{where}, {row_label(lines, k)}, column {next(iter(columns))!r}: time must increase, but "
            f"{time[k]} follows {time[k - 1]} ({len(back)} such places); {mend}"
        )
