"""What simulates many rigs together, and the encoders that they all have."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from dipc_gym import kernels
from dipc_gym.plant import Plant

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Rows = NDArray[np.intp]

COSTS = ("cost_cart", "cost_pole1", "cost_pole2", "cost_voltage")


class Encoders:
    """Resolution, noise and velocity filter of each rig; rows come last, which NumPy walks through faster.

    Attributes:
        counts: of cart and two joints, (3, n), m and rad.
        noise: standard deviation of a reading, counts, (n,).
        keep: of the last velocity, (n,).
        gain: of a new difference, 1/s, (n,).
    """

    def __init__(self, count: int) -> None:
        self.counts, self.noise, self.keep, self.gain = np.zeros((3, count)), *np.zeros((3, count))

    def become(self, rows: Rows, plants: Sequence[Plant]) -> None:
        """Take those of plants."""
        for i, plant in zip(rows, plants, strict=True):
            own = plant.encoders
            self.counts[:, i], self.noise[i] = (own.cart, own.pole, own.pole), own.noise
            self.keep[i], self.gain[i] = kernels.velocity_gains(own.velocity_filter, plant.control_period)


@dataclass(frozen=True)
class Period:
    """What a control period gave.

    Attributes:
        rewards: (n,).
        terminated: (n,).
        infos: of each row, without masks.
    """

    rewards: Array
    terminated: Mask
    infos: dict[str, Any]


class Rigs(Protocol):
    """Rigs that are stepped together."""

    @property
    def time(self) -> Array:
        """Since each reset, (n,) s."""

    @property
    def friction(self) -> Array:
        """Dry friction on each cart at the last physics step, (n,) N."""

    @property
    def state(self) -> Array:
        """Exact states, (n, 6), as observed."""

    @property
    def measured(self) -> Array:
        """Readings of the encoders, angles absolute, and velocities worked out from them, (6, n)."""

    def observations(self) -> Array:
        """What is observed now, (n, 6), as an array of its own."""

    def become(self, rows: Rows, plants: Sequence[Plant]) -> None:
        """Give plants to rows, whose encoders have them already."""

    def begin(self, rows: Rows, states: Array, can_fall: Mask, noise: Array) -> Array:
        """Put rows into states (rows, 6), the motor at rest; the dry friction there, (rows,) N.

        Args:
            rows: which.
            states: as observed.
            can_fall: whether a pole beyond its limit ends the episode, (rows,).
            noise: on the joints' readings, (rows, 3).
        """

    def advance(self, asked: Array, going: Mask, noise: Callable[[Mask], Array] | None) -> Period:
        """Hold voltages for one control period; what is said of rows that are not `going` means nothing.

        Args:
            asked: (n,) V.
            going: (n,).
            noise: on the joints' readings of the rows that it is given, (3, n); None where there is none.
        """


def readings(joints: Array, counts: Array) -> Array:
    """What encoders with these counts say of joints, (3, rows); the second angle is absolute, as the first is."""
    said = kernels.quantise(joints, counts)
    said[2] += said[1]
    return said


def absolute(joints: Array) -> Array:
    """Positions and velocities of joints, (6, rows), with those of the second pole made absolute in place."""
    joints[2] += joints[1]
    joints[5] += joints[4]
    return joints
