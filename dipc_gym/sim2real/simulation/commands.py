"""Recorded commands as the steps of a simulation feel them, and what tells those of two models apart."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from dipc_gym.physics import Physics
from dipc_gym.recording import Recording
from dipc_gym.recording.held import stamps_between
from dipc_gym.sim2real.simulation.windows import Windows

Array = NDArray[np.float64]


def per_step(
    of: Callable[[Recording, Array, int], Array],
    windows: Windows,
    delays: Array,
    step: float,
    first: int,
    nstep: int,
) -> Array:
    """What `of` says of the commands within each step from the `first` on, (variants, n, nstep, controls).

    Args:
        of: of a recording, the edges of steps (n, nstep + 1), s, and a control.
        windows: where commands are recorded.
        delays: of each variant's controls, s, (variants, controls); those that no recording holds stay at zero.
        step: s.
        first: index of a step, counted from each window's start.
        nstep: number of steps.
    """
    out = np.zeros((len(delays), len(windows), nstep, delays.shape[1]))
    edges = (first + np.arange(nstep + 1)) * step
    for k in range(len(delays)):
        same = next((j for j in range(k) if np.array_equal(delays[j], delays[k])), None)
        if same is not None:
            out[k] = out[same]
            continue
        for i, recording in enumerate(windows.recordings):
            mine = np.flatnonzero(windows.source == i)
            if not len(mine):
                continue
            at = windows.start[mine, None] + edges
            for c in range(recording.commands.shape[1]):
                out[k, mine, :, c] = of(recording, at - delays[k, c], c)
    return out


def first_moments(recording: Recording, edges: Array, control: int) -> Array:
    """Integral of a held command times the distance from the middle between edges (n, m + 1), (n, m)."""
    command = recording.commands[:, control]
    first, last = stamps_between(recording, edges)
    half, middle = np.diff(edges, axis=1) / 2, (edges[:, :-1] + edges[:, 1:]) / 2
    moments = np.zeros(first.shape)
    for k in range(int((last - first).max(initial=0))):
        inside = first + k < last
        at = first[inside] + k
        jump = command[at] - command[np.maximum(at - 1, 0)]
        moments[inside] += jump * (half[inside] ** 2 - (recording.time[at] - middle[inside]) ** 2) / 2
    return moments


def changed_by(variant: Physics) -> bytes:
    """What tells the commands that one variant of a model makes of recorded ones from another's."""
    return b"".join(extra.data.tobytes() for extra in variant.stage("command"))
