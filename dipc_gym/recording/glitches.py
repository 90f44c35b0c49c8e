"""Single samples that jump and come back: of an encoder or of the log, for no joint moves so.

Two good samples on either side tell what one should have been; where samples are missing, or others beside it jump as
well, nothing is told.
"""

from __future__ import annotations

from collections.abc import Sequence
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
        single = "one single sample" if len(where) == 1 else f"{len(where)} single samples"
        notes.append(
            f"sensor {name!r} jumps at {single} and back, by up to {off:.3g} {unit}, first at {when:.6g} s: no joint "
            "moves so, and they are taken from their neighbours; check the encoder and its cable"
        )
    return replace(recording, sensors=sensors, notes=(*recording.notes, *notes)) if notes else recording


def glitches(
    time: NDArray[np.float64], values: NDArray[np.float64], noise: float
) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """Samples that a cubic through two neighbours on either side misses by far, while these lie on curves of their own
    without it; and what it says of them. Where a joint hits something, the neighbours do not.

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
    foretold = _from_neighbours(time, values)
    off = np.where(_spans(time) < GLITCHES.span * np.median(np.diff(time)), np.abs(values - foretold), 0.0)
    far = np.flatnonzero(off > GLITCHES.far * noise)
    found = list[int]()
    for i in far.tolist():
        near = slice(max(i - 4, 0), i + 5)
        without = values[near].copy()
        without[i - near.start] = foretold[i]
        left = np.abs(without - _from_neighbours(time[near], without))[max(i - 2, 0) - near.start : i + 3 - near.start]
        if left.max() < max(GLITCHES.beside * noise, GLITCHES.left * off[i]):
            found.append(i)
    where = np.array(found if len(found) <= max(1.0, GLITCHES.most * len(values)) else [], dtype=np.intp)
    return where, foretold[where]


def _spans(time: NDArray[np.float64]) -> NDArray[np.float64]:
    """Time from the second sample before each to the second after, s, (n,); infinite at the ends."""
    out = np.full(len(time), np.inf)
    out[2:-2] = time[4:] - time[:-4]
    return out


def _from_neighbours(time: NDArray[np.float64], values: NDArray[np.float64]) -> NDArray[np.float64]:
    """What a cubic through the two samples before and the two after says of each sample; of the outer ones what they
    are.
    """
    out, beside = values.copy(), (0, 1, 3, 4)
    if len(values) < 5:
        return out
    stamps, read = (np.lib.stride_tricks.sliding_window_view(x, 5) for x in (time, values))
    said = np.zeros(len(stamps))
    for j in beside:
        weight = np.ones(len(stamps))
        for k in beside:
            if k != j:
                weight *= (stamps[:, 2] - stamps[:, k]) / (stamps[:, j] - stamps[:, k])
        said += weight * read[:, j]
    out[2:-2] = said
    return out
