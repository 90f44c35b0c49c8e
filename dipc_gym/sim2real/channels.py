"""What the single channels of a recording look like: their noise, and what their owner should know about them."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import mujoco
import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from dipc_gym.sim2real.recording import Recording

ORDERS = range(3, 8)  # of the differences that remove the motion
BLOCK = 64  # samples over which the differences are averaged before the median is taken


def noise(recording: Recording) -> NDArray[np.float64]:
    """Standard deviation of each sensor's own noise, white noise and quantisation together.

    Motion is removed by divided differences of order 3 to 7 (scaled so that white noise keeps its size; exact for
    irregular stamps); the order that leaves least is used, and the median over short blocks keeps impacts and
    stick-slip out. Never less than the quantisation step over sqrt(12).

    Args:
        recording: at least 20 samples, sampled several times faster than the motion.

    Returns:
        (ns,) in the sensors' units; `inf` for a sensor that never changes, of which nothing is known.
    """
    return np.array([_noise(recording.time, values) for values in recording.sensors.T])


def _noise(time: NDArray[np.float64], values: NDArray[np.float64]) -> float:
    step = quantum(values)
    if np.ptp(values) == 0:
        return math.inf
    white = min(_white(time, values, order) for order in ORDERS if order < len(values) - 1)
    return max(white, step / math.sqrt(12))


def _white(time: NDArray[np.float64], values: NDArray[np.float64], order: int) -> float:
    stamps = np.lib.stride_tricks.sliding_window_view(time, order + 1)
    spacing = (stamps[:, -1] - stamps[:, 0])[:, None]
    gaps = (stamps[:, :, None] - stamps[:, None, :]) / spacing[:, :, None]
    gaps[:, range(order + 1), range(order + 1)] = 1.0
    weights = 1.0 / gaps.prod(axis=2)
    weights /= np.linalg.norm(weights, axis=1, keepdims=True)
    rest = np.einsum("ij,ij->i", weights, np.lib.stride_tricks.sliding_window_view(values, order + 1))
    blocks = max(1, len(rest) // BLOCK)
    return float(np.median([math.sqrt(np.mean(part**2)) for part in np.array_split(rest, blocks)]))


def quantum(values: NDArray[np.float64]) -> float:
    """Step of a quantised signal; 0 where its values are on no lattice.

    The smallest change between neighbouring samples, if nearly all changes are multiples of it.
    """
    steps = np.abs(np.diff(values))
    steps = steps[steps > 64 * np.finfo(float).eps * np.max(np.abs(values), initial=0.0)]
    if not len(steps):
        return 0.0
    smallest = float(np.min(steps))
    multiples = steps / smallest
    near = multiples < 50
    on_lattice = np.abs(multiples[near] - np.round(multiples[near])) < 0.05
    if np.mean(on_lattice) < 0.95:
        return 0.0
    return float(np.median(steps[near] / np.round(multiples[near])))


def notes(recording: Recording, model: mujoco.MjModel) -> tuple[str, ...]:
    """Sentences about what is odd but usable in a recording."""
    found: list[str] = []
    if recording.ignored:
        found.append(f"columns {list(recording.ignored)} are not in the model and are ignored")
    return tuple(found)
