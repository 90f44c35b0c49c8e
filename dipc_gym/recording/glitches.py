"""Samples that jump and come back, one or a few in a row: of an encoder or of the log, for no joint moves so.

Two good samples on either side tell what they should have been; where samples are missing, or others beside them jump
as well, nothing is told.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from dipc_gym.recording.checks import noise
from dipc_gym.recording.settings import GLITCHES
from dipc_gym.recording.units import of_sensor

if TYPE_CHECKING:
    import mujoco
    from numpy.typing import NDArray

    from dipc_gym.recording.record import Recording


def without_glitches(recordings: Sequence[Recording], model: mujoco.MjModel) -> list[Recording]:
    """Recordings with glitches of position sensors taken from their neighbours; a note says where they were.

    Args:
        recordings: of the model.
        model: says which sensors read positions.
    """
    return [_mended(recording, model) for recording in recordings]


def _mended(recording: Recording, model: mujoco.MjModel) -> Recording:
    if len(recording) < GLITCHES.fewest:
        return recording
    sensors, notes, noises = recording.sensors.copy(), list[str](), noise(recording)
    for k, name in enumerate(recording.sensor_names):
        unit = of_sensor(model, name)
        if unit not in ("m", "rad"):
            continue
        where, instead = glitches(recording.time, recording.sensors[:, k], float(noises[k]))
        if not len(where):
            continue
        off = float(np.abs(sensors[where, k] - instead).max())
        sensors[where, k] = instead
        when = recording.time[where[0]]
        several = "one single sample" if len(where) == 1 else f"{len(where)} samples"
        notes.append(
            f"sensor {name!r} jumps at {several} and back, by up to {off:.3g} {unit}, first at {when:.6g} s: no joint "
            "moves so, and they are taken from their neighbours; check the encoder and its cable"
        )
    return replace(recording, sensors=sensors, notes=(*recording.notes, *notes)) if notes else recording


def glitches(
    time: NDArray[np.float64], values: NDArray[np.float64], noise: float
) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """Samples, alone or a few in a row, that a cubic through two neighbours on either side misses by far, while these
    lie on curves of their own without them; and what it says of them. Where a joint hits something, the neighbours do
    not.

    Args:
        time: s, (n,).
        values: of a position, (n,).
        noise: its standard deviation.

    Returns:
        Indices (k,), none where they are so many that they are no glitches, and values (k,).

    Example:
        >>> time = np.linspace(0, 1, 101)
        >>> angle = np.sin(6 * time)
        >>> angle[40] += 0.1
        >>> where, instead = glitches(time, angle, 1e-4)
        >>> where.tolist(), float(abs(instead - np.sin(6 * time[40]))[0]) < 1e-5
        ([40], True)
    """
    mended, count = values.copy(), 0
    for run in range(1, GLITCHES.longest + 1):
        for first, instead in _alone(time, mended.copy(), noise, run):
            mended[first : first + run] = instead
            count += 1
    if count > max(1.0, GLITCHES.most * len(values)):
        mended = values
    where = np.flatnonzero(mended != values)
    return where, mended[where]


def _alone(
    time: NDArray[np.float64], values: NDArray[np.float64], noise: float, run: int
) -> Iterator[tuple[int, NDArray[np.float64]]]:
    """The first of so many samples in a row that are off together, and what they should have been, (run,)."""
    foretold, spans = _from_neighbours(time, values, run)
    near = spans < (GLITCHES.span + run - 1) * np.median(np.diff(time))
    off = np.abs(np.stack([values[2 + k : 2 + k + len(spans)] for k in range(run)], axis=1) - foretold).min(axis=1)
    for k in np.flatnonzero(near & (off > GLITCHES.far * noise)).tolist():
        first, begin = k + 2, max(k - 2, 0)
        around = slice(begin, first + run + 4)
        without = values[around].copy()
        without[first - begin : first - begin + run] = foretold[k]
        left = np.zeros(len(without))
        left[2:-2] = np.abs(without[2:-2] - _from_neighbours(time[around], without, 1)[0][:, 0])
        if left[k - begin : first - begin + run + 2].max() < max(GLITCHES.beside * noise, GLITCHES.left * off[k]):
            yield first, foretold[k]


def _from_neighbours(
    time: NDArray[np.float64], values: NDArray[np.float64], run: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """What a cubic through the two samples before and the two after says of so many in a row, from the third sample on,
    (n - run - 3, run); and the time that these four span, s, (n - run - 3,).
    """
    count, beside = max(len(values) - run - 3, 0), (0, 1, run + 2, run + 3)
    inner = np.stack([time[2 + k : 2 + k + count] for k in range(run)], axis=1)
    stamps, read = ({j: x[j : j + count, None] for j in beside} for x in (time, values))
    said = np.zeros((count, run))
    for j in beside:
        weight = np.ones((count, run))
        for k in beside:
            if k != j:
                weight *= (inner - stamps[k]) / (stamps[j] - stamps[k])
        said += weight * read[j]
    return said, (stamps[run + 3] - stamps[0])[:, 0]
