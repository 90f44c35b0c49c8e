"""How the joints moved in a recording, as estimated from its sensors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Motion:
    """Smoothed motion of one recording.

    Attributes:
        time: s, (n,).
        position: of each base joint, m or rad, (n, nb).
        velocity: m/s or rad/s, (n, nb).
        acceleration: m/s^2 or rad/s^2, (n, nb).
        noise: standard deviation of the positions as they were read, before they were smoothed, (nb,).
        read: what sensors read, as they gave it, but smoothed, (n, ns); None of a motion that no sensor told.
    """

    time: Array
    position: Array
    velocity: Array
    acceleration: Array
    noise: Array
    read: Array | None = None

    def spread(self, out: Array) -> Motion:
        """That of other joints, which move by these: positions are `out` (n, nb) times those of the base joints."""
        position, velocity, acceleration = (x @ out.T for x in (self.position, self.velocity, self.acceleration))
        return Motion(self.time, position, velocity, acceleration, np.abs(out) @ self.noise)

    def at(self, time: Array) -> Array:
        """Positions and velocities (..., 2 nb) at any time, linear between samples."""
        columns = [np.interp(time, self.time, c) for c in (*self.position.T, *self.velocity.T)]
        return np.stack(columns, axis=-1)


def initial_states(motions: Sequence[Motion], source: NDArray[np.intp], time: Array) -> Array:
    """Initial states (n, 2 nb) of windows that begin at `time` in the recordings `source`."""
    out = np.empty((len(time), 2 * motions[0].position.shape[1]))
    for i, motion in enumerate(motions):
        mine = source == i
        out[mine] = motion.at(time[mine])
    return out
