"""From recordings and a model to the windows that are predicted: noise, motion, window length, uncertainty of initial
states.

A window must be long enough for physics to show above the noise, and so short that its initial state is not forgotten:
on a rig that balances or tumbles, an initial error grows exponentially, and what it explains away grows with it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dipc_gym import mjcf, recording
from dipc_gym.mjcf.edit import Document
from dipc_gym.physics import Physics
from dipc_gym.recording import Recording, RecordingError
from dipc_gym.recording.settings import CHECKS
from dipc_gym.recording.units import likely_time
from dipc_gym.sim2real.estimation import states
from dipc_gym.sim2real.estimation.problem import Problem, predict
from dipc_gym.sim2real.estimation.settings import ESTIMATION
from dipc_gym.sim2real.model.structure import Structure
from dipc_gym.sim2real.simulation.batch import Stepping
from dipc_gym.sim2real.simulation.motion import Motion
from dipc_gym.sim2real.simulation.windows import Windows, cut

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Prepared:
    """A prediction problem, and what it was made from.

    Attributes:
        problem: windows and their estimated initial states.
        structure: the model as it is, with no parameter free.
        motions: of the base joints, one for each recording.
        length: of the windows, s.
    """

    problem: Problem
    structure: Structure
    motions: tuple[Motion, ...]
    length: float


def prepare(
    source: mjcf.Source,
    physics: Physics,
    recordings: Sequence[Recording],
    stepping: Stepping,
    *,
    length: float | None = None,
    span: tuple[float, float] = (0.0, 1.0),
    threads: int = 0,
) -> Prepared:
    """Cut recordings into windows and estimate the initial state of each.

    Args:
        source: text of the model.
        physics: the same, loaded.
        recordings: of one rig, with the model's sensors.
        stepping: of the simulations.
        length: of a window, s; None means 0.25 s, more below 160 Hz, see `usual_length`, or less where this model makes
            initial errors grow beyond tenfold.
        span: the part of each recording to use, as fractions of its duration.
        threads: of the simulations; 0 for all cores.

    Raises:
        mjcf.MjcfError: the model cannot be treated (contacts, free joints, no names, joints that the text lacks).
        states.Undetermined: the sensors do not say where the joints are.
        RecordingError: no sensor ever changes, or no recording holds a window of that length.
    """
    mjcf.check_supported(physics.model, source.name)
    if length is not None and not (math.isfinite(length) and length > 0):
        raise ValueError(f"a window of {length} s is no window; give a positive number of seconds")
    noise = common_noise(recordings)
    document = Document(source)
    document.check_written_out(physics.model)
    structure = Structure(document, physics.model, mjcf.base_joints(physics.model))
    motions = tuple(states.estimate(r, physics, noise) for r in recordings)
    spread, late = uncertainty(physics, motions, noise), mjcf.latest_sensor(physics.model)
    lags = {extra.at: float(extra.data[0]) for extra in physics.stage("lag")}

    def windows(length: float) -> Problem:
        cuts = replace(_cut(recordings, noise, length, span, structure.warm), motions=motions, late=late, lags=lags)
        return Problem(cuts, cuts.begun(), spread, stepping, threads)

    if length is not None:
        return Prepared(windows(length), structure, motions, length)
    usual = usual_length(recordings, span)
    longest = windows(usual)
    length = steady_length(longest, structure, usual)
    return Prepared(longest if length == usual else windows(length), structure, motions, length)


def usual_length(recordings: Sequence[Recording], span: tuple[float, float]) -> float:
    """Length of a window, s, as far as recordings alone say: longer where they are sampled slowly.

    Args:
        recordings: to cut.
        span: the part of each that is used, as fractions of its duration.
    """
    samples = ESTIMATION.samples * max(recording.period for recording in recordings)
    room = (span[1] - span[0]) * sum(recording.duration for recording in recordings) / ESTIMATION.enough
    return max(ESTIMATION.window_length, min(samples, room, ESTIMATION.longest))


def common_noise(recordings: Sequence[Recording]) -> Array:
    """Noise of each sensor over several recordings, (ns,): the median of those in which it moves.

    It is infinite for a sensor that moves in none, which gives it no weight, and never less than what 24 bits
    resolve: simulated recordings without noise would be compared at the level of rounding.

    Raises:
        RecordingError: no sensor moves in any recording.
    """
    each = np.stack([recording.noise(r) for r in recordings])
    high = np.max([r.sensors.max(axis=0) for r in recordings], axis=0)
    low = np.min([r.sensors.min(axis=0) for r in recordings], axis=0)
    moving = [column[np.isfinite(column)] for column in each.T]
    if not any(len(column) for column in moving):
        raise RecordingError(
            f"{recordings[0].path or recordings[0].name}: no sensor changes in it, so there is no motion to predict"
        )
    middle = np.array([np.median(column) if len(column) else math.inf for column in moving])
    return np.maximum(middle, ESTIMATION.finest_reading * (high - low))


def uncertainty(physics: Physics, motions: Sequence[Motion], noise: Array) -> Array:
    """Standard deviation of estimated positions and velocities, (2 nb,), on the generous side."""
    position = position_noise(physics, noise)
    speed = np.concatenate([motion.velocity for motion in motions]).std(axis=0)
    return np.concatenate(
        [ESTIMATION.loose * position, ESTIMATION.rough_speed * speed + position / ESTIMATION.differenced]
    )


def position_noise(physics: Physics, noise: Array) -> Array:
    """Noise of the base joints' positions, (nb,), as one reading of all sensors gives them."""
    known = np.where(np.isfinite(noise), noise, noise[np.isfinite(noise)].max())
    return states.seen(physics).noise(known, within=ESTIMATION.window_length)


def steady_length(problem: Problem, structure: Structure, longest: float) -> float:
    """Length, s, within which initial errors stay below `ESTIMATION.growth` times their size in most windows.

    Args:
        problem: windows of the longest length.
        structure: the model as it is.
        longest: s.
    """
    windows = problem.windows
    beyond = growth(problem, structure, longest) > ESTIMATION.growth
    first = np.where(beyond.any(axis=1), np.argmax(beyond, axis=1), beyond.shape[1])
    reached = np.array([t[k] if k < len(t) else math.inf for t, k in zip(windows.times, first, strict=True)])
    limit = float(np.sort(reached)[int((1 - ESTIMATION.steady) * len(reached))])
    return min(longest, max(limit, ESTIMATION.fewest_samples * windows.period))


def growth(problem: Problem, structure: Structure, longest: float) -> Array:
    """How many times its first size an initial error has at each sample, (n, m).

    An initial error is one of the noise's size in every position, and in every velocity what moves a free mass by as
    much within the longest window; a free mass thus reaches 1.4, an unstable mode exp(rate time).
    """
    windows = problem.windows
    alive = np.isfinite(windows.noise)
    position = position_noise(structure.physics(structure.first), windows.noise)
    size = np.concatenate([position, position / longest])
    tries = problem.initial + np.concatenate([np.zeros((1, len(size))), np.diag(size)])[:, None]
    readings = predict(problem, structure, [structure.first] * len(tries), tries)[..., alive] / windows.noise[alive]
    moved = np.linalg.norm(readings[1:] - readings[0], axis=0)  # (n, m, sensors)
    grown = (moved / np.maximum(moved[:, :1], 1.0)).max(axis=2, initial=0.0)
    return np.where(windows.valid, np.where(np.isnan(grown), np.inf, grown), 0.0)  # NaN: a simulation that ended


def _cut(
    recordings: Sequence[Recording], noise: Array, length: float, span: tuple[float, float], after: float
) -> Windows:
    windows = cut(recordings, noise, length, span, after)
    if not len(windows):
        longest = max(recordings, key=lambda r: r.duration)
        unit = likely_time(longest.period)
        between = f" between gaps in time, {after:.2g} s after each," if len(longest.goes_on) > 1 else ""
        raise RecordingError(
            f"{longest.path or longest.name}: {longest.duration:.3g} s, sampled every {longest.period:.2g} s, hold no "
            f"window of {length:g} s{between} in the part from {span[0]:.0%} to {span[1]:.0%}: record "
            f"{'faster' if 3 * longest.period > length else 'longer'}, for a window has at least 4 samples"
            f"{f'; or is time in {unit}? Then say --unit time={unit}' if longest.period > CHECKS.slow else ''}"
        )
    return windows


def joined(values: Array, valid: NDArray[np.bool_]) -> Array:
    """Readings of windows (n, m) end to end, those that are there; NaN between windows, so that a line breaks there."""
    gap = np.full((len(values), 1), np.nan)
    kept = np.concatenate([valid, np.ones_like(gap, dtype=bool)], axis=1)
    return np.concatenate([values, gap], axis=1)[kept][:-1]
