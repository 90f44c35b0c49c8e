"""Commands between their time stamps: each holds until the next, the first before all, the last after all."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from dipc_gym.recording.tables import RecordingError

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from dipc_gym.recording.record import Recording

    Array = NDArray[np.float64]

ROUNDING = 1e-8  # of a step: a stamp so near to an edge stands on it


def held_at(recording: Recording, time: Array) -> Array:
    """The commands (n, nu) that hold at times (n,), s."""
    last = np.searchsorted(recording.time, time, side="right") - 1
    return recording.commands[np.maximum(last, 0)]


def held_mean(recording: Recording, edges: Array, control: int) -> Array:
    """Mean of a held command between edges (n, m + 1), s; exactly the command where no stamp falls between them."""
    mean = np.diff(_integral(recording, edges, control), axis=1) / np.diff(edges, axis=1)
    first, last = stamps_between(recording, edges)
    held = recording.commands[np.maximum(first - 1, 0), control]
    return np.where(first == last, held, mean)


def stamps_between(recording: Recording, edges: Array) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """The first stamp within each step between edges (n, m + 1), and the first behind it, (n, m) each."""
    rounding = ROUNDING * (edges[0, 1] - edges[0, 0])
    first = np.searchsorted(recording.time, edges[:, :-1] + rounding, side="right")
    last = np.searchsorted(recording.time, edges[:, 1:] - rounding, side="right")
    return first, last


def resample_commands(recording: Recording, grid: ArrayLike) -> Array:
    """Average the held command over each physics step.

    Taking the value at the start of each step instead shifts commands by up to a step where stamps are irregular.

    Args:
        recording: gives time stamps and commands.
        grid: (m + 1,) s, the borders of m steps, increasing.

    Returns:
        (m, nu) mean of the command over `[grid[i], grid[i + 1])`.

    Raises:
        RecordingError: the grid does not increase.
    """
    grid = np.asarray(grid, dtype=np.float64)
    if grid.ndim != 1 or len(grid) < 2 or not np.all(np.diff(grid) > 0):
        raise RecordingError(f"{recording.name}: the time grid needs at least two borders that increase")
    columns = [held_mean(recording, grid[None], control)[0] for control in range(recording.commands.shape[1])]
    return np.stack(columns, axis=1) if columns else np.empty((len(grid) - 1, 0))


def _integral(recording: Recording, time: Array, control: int) -> Array:
    """Integral of a held command up to `time`."""
    stamps, held = recording.time, recording.commands[:, control]
    total = np.append(0.0, np.cumsum(held[:-1] * np.diff(stamps)))
    inside = np.interp(time, stamps, total)
    before = np.minimum(time - stamps[0], 0.0) * held[0]
    return inside + before + np.maximum(time - stamps[-1], 0.0) * held[-1]
