"""Replay a recording in a model, window by window, and say where the two part.

Every window has an initial state of its own: the one that the sensors show, corrected so that the model predicts that
window best. What is left is the model's: wrong parameters, absent physics, or a time step too long.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from dipc_gym import mjcf
from dipc_gym import physics as custom
from dipc_gym import recording as recordings
from dipc_gym.drawing import style
from dipc_gym.provenance import made_with
from dipc_gym.recording import Recording
from dipc_gym.recording import units as si
from dipc_gym.recording.clock import clocked
from dipc_gym.recording.glitches import without_glitches
from dipc_gym.safety.files import whole
from dipc_gym.sim2real.estimation.fit import readings
from dipc_gym.sim2real.estimation.segments import joined, prepare
from dipc_gym.sim2real.simulation.batch import Stepping, grid_step
from dipc_gym.sim2real.simulation.windows import Windows

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["Replay", "SensorError", "replay"]

Array = NDArray[np.float64]

SCHEMA = "dipc-gym/replay/1"
FINEST = 1e-6  # s, of a step that is asked for: windows of a quarter of a second then take as many steps
WORST = 3  # windows that are named for each sensor
NARROWEST, WIDEST = 2.0, 30.0  # inches of a picture


@dataclass(frozen=True)
class SensorError:
    """How far predictions of one sensor are off.

    Attributes:
        name: of the sensor.
        unit: SI; empty if unknown.
        error: root mean square over all windows, each counting alike, in that unit.
        noise: standard deviation of the sensor's own noise; infinite if it never changes, so that nothing is known.
        median: of the windows' root mean square errors.
        high: the same, 90th percentile.
        worst: start times of the windows that are farthest off, s.
    """

    name: str
    unit: str
    error: float
    noise: float
    median: float
    high: float
    worst: tuple[float, ...]

    @property
    def ratio(self) -> float:
        """Error over noise; NaN for a sensor that never changes."""
        return self.error / self.noise if math.isfinite(self.noise) else math.nan


@dataclass(frozen=True)
class Replay:
    """A recording beside its prediction.

    Attributes:
        model: file.
        recording: what was replayed.
        window: length of a window, s.
        step: of the simulation, s.
        sensors: errors, in the model's order.
        windows: what was predicted.
        predicted: readings, (n, m, ns).
        inputs: sha256 of the model, with all that it includes, and of the recording.
    """

    model: Path
    recording: Recording
    window: float
    step: float
    sensors: tuple[SensorError, ...]
    windows: Windows = field(repr=False)
    predicted: Array = field(repr=False)
    inputs: Mapping[str, str] = field(repr=False)

    @property
    def errors(self) -> Array:
        """Root mean square error of each window over all sensors, in units of their noise, (n,)."""
        w = self.windows
        alive = np.isfinite(w.noise)
        residual = np.where(w.valid[..., None], w.observed - self.predicted, 0.0)[..., alive] / w.noise[alive]
        return np.asarray(np.sqrt(np.sum(residual**2, axis=(1, 2)) / (w.valid.sum(axis=1) * alive.sum())))

    @property
    def error(self) -> float:
        """Root mean square of all windows' errors, in units of noise: 1 is a model that lacks nothing."""
        return float(np.sqrt(np.mean(self.errors**2)))

    def to_dict(self) -> dict[str, Any]:
        """What `--json` writes; numbers that do not exist are None."""
        errors = self.errors
        return {
            "schema": SCHEMA,
            "error": _or_none(self.error),
            "median_error": _or_none(float(np.median(errors))),
            "window": self.window,
            "sensors": {
                s.name: {
                    "unit": s.unit,
                    "error": _or_none(s.error),
                    "noise": _or_none(s.noise),
                    "ratio": _or_none(s.ratio),
                    "median": _or_none(s.median),
                    "high": _or_none(s.high),
                    "worst": list(s.worst),
                }
                for s in self.sensors
            },
            "windows": [
                {"start": float(t), "error": _or_none(float(e))}
                for t, e in zip(self.windows.start, errors, strict=True)
            ],
            "notes": list(self.recording.notes),
            "provenance": made_with("mujoco", "numpy", timestep=self.step, inputs=self.inputs),
        }

    def table(self) -> str:
        """One line a sensor, and one for all."""
        head = ("sensor", "unit", "rms error", "noise", "ratio", "median", "90 %", f"worst windows, s (of {len(self)})")
        rows = [head]
        for s in self.sensors:
            known = math.isfinite(s.noise)
            rows.append(
                (
                    s.name,
                    s.unit,
                    f"{s.error:.3g}",
                    f"{s.noise:.3g}" if known else "constant",
                    f"{s.ratio:.3g}" if known else "",
                    f"{s.median:.3g}",
                    f"{s.high:.3g}",
                    ", ".join(f"{t:.2f}" for t in s.worst),
                )
            )
        widths = [max(len(row[k]) for row in rows) for k in range(len(head))]
        lines = []
        for row in rows:
            cells = [
                cell.ljust(width) if k in (0, 1, len(head) - 1) else cell.rjust(width)
                for k, (cell, width) in enumerate(zip(row, widths, strict=True))
            ]
            lines.append("  ".join(cells).rstrip())
        return "\n".join([*lines, f"error: {self.error:.3g} x noise, in windows of {self.window:.3g} s"])

    def __len__(self) -> int:
        return len(self.windows)

    def plot(self, path: str | Path, *, width: float = style.WIDE) -> Path:
        """Draw observed against predicted, and their difference below, a pair of axes for each sensor.

        Args:
            path: of the picture: `.png`, `.pdf` or `.svg`.
            width: inches; 7 are two columns of a journal, 3.4 are one.

        Raises:
            ValueError: matplotlib cannot write such a file, or the width is no width of a page.
        """
        path = Path(path)
        check_width(width)
        points = 6 if width <= style.NARROW else 8
        with style.text(points, text__parse_math=False), whole(path) as file:  # a sensor may be called $x^
            style.write(self._drawn(width), file, path.suffix[1:].lower())
        return path

    def _drawn(self, width: float) -> Figure:
        from matplotlib.figure import Figure

        figure = Figure((width, (0.5 + 0.25 * width) * len(self.sensors) + 0.5), layout="constrained")
        figure.suptitle(f"{self.recording.name} in {self.model.name}: error {self.error:.3g} x noise")
        axes = np.ravel(
            figure.subplots(2 * len(self.sensors), 1, sharex=True, height_ratios=[2, 1] * len(self.sensors))
        )
        w = self.windows
        time = joined(w.start[:, None] + w.times, w.valid)
        for k, sensor in enumerate(self.sensors):
            above, below = axes[2 * k : 2 * k + 2]
            seen, said = joined(w.observed[..., k], w.valid), joined(self.predicted[..., k], w.valid)
            above.plot(time, seen, color=style.GREY, lw=1.6, label="observed")
            above.plot(time, said, color=style.VERMILION, lw=0.6, label="predicted")
            above.set_ylabel(f"{sensor.name}, {sensor.unit}" if sensor.unit else sensor.name)
            below.plot(time, seen - said, color=style.BLUE, lw=0.5)
            if math.isfinite(sensor.noise):
                below.axhspan(-2 * sensor.noise, 2 * sensor.noise, color=style.GREY, alpha=0.35, lw=0)
            below.set_ylabel("difference")
            for start in sensor.worst:
                for axis in (above, below):
                    axis.axvspan(start, start + self.window, color=style.YELLOW, alpha=0.5, lw=0)
        for axis in axes:
            axis.spines[["top", "right"]].set_visible(False)
            axis.grid(alpha=0.25)
        axes[0].legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, frameon=False)
        axes[-1].set_xlabel("time, s; yellow: worst windows; grey: twice the noise")
        return figure


def check_width(width: float) -> None:
    """Refuse what is no width of a page.

    Raises:
        ValueError: it is none.
    """
    if not NARROWEST <= width <= WIDEST:
        raise ValueError(f"width is {width:g} inches; it can be {NARROWEST:g} to {WIDEST:g}")


def replay(
    model: str | Path,
    recording: str | Path,
    *,
    window: float | None = None,
    step: float | None = None,
    mapping: Mapping[str, str] | None = None,
    units: Mapping[str, str] | None = None,
    threads: int = 0,
) -> Replay:
    """Predict windows of a recording with a model as it stands in its file.

    The model is simulated with its own integrator at its own time step, read between two steps where a sample lies
    there, with what `<custom>` says for `dipc_gym.physics`. Given a `step`, it is simulated as exactly as
    that allows instead: what is left is then owed to the model, not to its integration.

    Args:
        model: MJCF file.
        recording: `.csv`, `.parquet` or `.npz` file.
        window: s; None means 0.25 s, forty samples below 160 Hz, or less where an unstable rig amplifies an initial
            error more than tenfold.
        step: s; Runge-Kutta with dry friction's reversals located. None means the model's own integrator and step.
        mapping: column of the file -> name in the model.
        units: column or name -> unit that it is in.
        threads: of the simulation, 0 for all cores.

    Raises:
        ValueError: a step or window that is not positive, or a step below a microsecond.
        mjcf.MjcfError: the model does not compile, or cannot be treated.
        RecordingError: the recording cannot be used, or holds no such window.
        states.Undetermined: the sensors do not say where the joints are.

    Example:
        >>> import tempfile
        >>> from dipc_gym import recording
        >>> folder = Path(tempfile.mkdtemp())
        >>> _ = (folder / "fall.xml").write_text('''
        ...     <mujoco><worldbody><body><joint name="z" type="slide"/><geom size="1"/></body></worldbody>
        ...     <sensor><jointpos name="z" joint="z"/></sensor></mujoco>''')
        >>> recorder = recording.Recorder([], ["z"])
        >>> for k in range(200):
        ...     recorder.append(0.01 * k, [], [-9.81 * (0.01 * k) ** 2 / 2])
        >>> file = recording.write(recorder.recording("fall"), folder / "fall.csv")
        >>> replay(folder / "fall.xml", file).sensors[0].error < 1e-6
        True
    """
    source = mjcf.read(model)
    physics = custom.load(source)
    mjcf.check_supported(physics.model, source.name)
    read = recordings.read(recording, physics.model, mapping=mapping, units=units)
    (read,) = without_glitches(clocked([read]), physics.model)
    stepping = Stepping(physics.model.opt.timestep, None)
    if step is not None:
        if not (math.isfinite(step) and step > 0):
            raise ValueError(f"a step of {step} s is no step; give a positive number of seconds")
        if step < FINEST:
            raise ValueError(f"a step of {step:g} s would take for ever; give {FINEST:g} s or more")
        stepping = Stepping(step, mujoco.mjtIntegrator.mjINT_RK4)
    prepared = prepare(source, physics, [read], stepping, length=window, threads=threads)
    problem = prepared.problem
    windows = problem.windows
    told = windows.start - windows.went_on >= prepared.structure.activated
    if not told.any():
        raise recordings.RecordingError(
            f"{recording}: ends before the {prepared.structure.activated:.3g} s after which what an actuator's "
            "activation was before it began is forgotten; record longer"
        )
    if not told.all():
        problem = problem.pick(told)
        left_out = (
            f"{np.sum(~told)} windows are left out, in which an activation of the model still shows where it was "
            "before the recording began, or in a gap"
        )
        read = replace(read, notes=(*read.notes, left_out))
    predicted = readings(problem, prepared.structure, prepared.structure.first)
    return Replay(
        Path(model),
        read,
        prepared.length,
        grid_step(problem.windows, problem.stepping),
        _sensor_errors(problem.windows, predicted, physics.model, read.sensor_names),
        problem.windows,
        predicted,
        {str(model): source.sha256, str(recording): read.sha256},
    )


def _sensor_errors(
    w: Windows, predicted: Array, model: mujoco.MjModel, names: tuple[str, ...]
) -> tuple[SensorError, ...]:
    square = np.where(w.valid[..., None], w.observed - predicted, 0.0) ** 2
    count = w.valid.sum(axis=1)
    each = np.sqrt(square.sum(axis=1) / count[:, None])
    worst = np.argsort(-np.nan_to_num(each, nan=np.inf), axis=0, kind="stable")[:WORST]  # what diverges is worst
    return tuple(
        SensorError(
            name,
            si.of_sensor(model, name),
            float(np.sqrt(np.mean(each[:, k] ** 2))),
            float(w.noise[k]),
            float(np.median(each[:, k])),
            float(np.quantile(each[:, k], 0.9)),
            tuple(float(t) for t in w.start[worst[:, k]]),
        )
        for k, name in enumerate(names)
    )


def _or_none(number: float) -> float | None:
    return number if math.isfinite(number) else None
