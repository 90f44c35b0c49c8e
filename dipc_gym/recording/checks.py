"""What the channels of a recording look like: their noise, and what their owner should know."""

from __future__ import annotations

import itertools
import math
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from dipc_gym.mjcf import is_hinge
from dipc_gym.recording.columns import COMMAND, SENSOR, called
from dipc_gym.recording.degrees import turns
from dipc_gym.recording.settings import CHECKS, DEGREES, NOISE
from dipc_gym.recording.tables import RecordingError
from dipc_gym.recording.units import commanded_by, likely_time, of_command

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from dipc_gym.recording.record import Recording

RATES = {
    mujoco.mjtSensor.mjSENS_JOINTVEL: mujoco.mjtSensor.mjSENS_JOINTPOS,
    mujoco.mjtSensor.mjSENS_TENDONVEL: mujoco.mjtSensor.mjSENS_TENDONPOS,
    mujoco.mjtSensor.mjSENS_ACTUATORVEL: mujoco.mjtSensor.mjSENS_ACTUATORPOS,
}
IRREGULAR = "sampling is irregular"  # how a note on it begins
# What a column that should be in this unit is most likely in, in words and for --unit.
INSTEAD = {"rad": ("degrees", "deg"), "m": ("millimetres", "mm")}


def noise(recording: Recording) -> NDArray[np.float64]:
    """Standard deviation of each sensor's own noise, white noise and quantisation together.

    Motion is removed by divided differences of order 3 to 7, scaled so that white noise keeps its size; they are
    exact for irregular stamps. The order that leaves least is used, and the median over short blocks keeps impacts
    and stick-slip out. Never less than the quantisation step over sqrt(12).

    Args:
        recording: at least 10 samples, taken several times faster than the motion.

    Returns:
        (ns,) in the sensors' units; `inf` for a sensor that never changes, of which nothing is known.

    Raises:
        RecordingError: fewer than 10 samples.
    """
    if len(recording) < NOISE.fewest:
        raise RecordingError(f"{recording.name}: {len(recording)} samples are too few to tell noise from motion")
    weights = _differences(recording.time)
    return np.array([_noise(weights, values) for values in recording.sensors.T])


def _noise(weights: Sequence[NDArray[np.float64]], values: NDArray[np.float64]) -> float:
    if np.ptp(values) == 0:
        return math.inf
    left = [_white(each, values) for each in weights]
    # Not the least itself, which chance makes too small, but the first that is as good.
    white = next(estimate for estimate in left if estimate <= NOISE.as_good * min(left))
    return max(white, quantum(values) / math.sqrt(12))


def _differences(time: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """Weights of divided differences of each order that leave white noise its size, (n - order, order + 1)."""
    return [_difference(time, order) for order in NOISE.orders]


def _difference(time: NDArray[np.float64], order: int) -> NDArray[np.float64]:
    stamps = np.lib.stride_tricks.sliding_window_view(time, order + 1)
    span, weights = stamps[:, -1] - stamps[:, 0], np.ones(stamps.shape)
    for one, other in itertools.permutations(range(order + 1), 2):  # all at once, a long recording fills the memory
        weights[:, one] *= span / (stamps[:, one] - stamps[:, other])
    return np.asarray(weights / np.linalg.norm(weights, axis=1, keepdims=True))


def _white(weights: NDArray[np.float64], values: NDArray[np.float64]) -> float:
    """Standard deviation of white noise in a signal that is otherwise a polynomial of lower order nearly everywhere."""
    order = weights.shape[1] - 1
    differences = np.einsum("ij,ij->i", weights, np.lib.stride_tricks.sliding_window_view(values, order + 1))
    parts = np.array_split(differences, max(1, len(differences) // NOISE.block))
    typical = float(np.median([np.mean(part**2) for part in parts]))
    # Neighbouring differences are correlated, so a block has fewer degrees of freedom than samples, and the median
    # of chi squared lies below its mean (Wilson and Hilferty 1931).
    freedom = len(differences) / len(parts) * math.comb(2 * order, order) ** 2 / math.comb(4 * order, 2 * order)
    return math.sqrt(typical / (1 - 2 / (9 * freedom)) ** 3)


def quantum(values: NDArray[np.float64]) -> float:
    """Step of a quantised signal; 0 where its values are on no lattice.

    The smallest change between neighbouring samples, if nearly all changes are multiples of it and the values come
    back to the same levels (which those of a noisy signal at constant speed do not).
    """
    steps = np.abs(np.diff(values))
    steps = steps[steps > NOISE.rounding * np.finfo(float).eps * np.max(np.abs(values), initial=0.0)]
    if not len(steps):
        return 0.0
    smallest = float(np.min(steps))
    multiples = steps[steps < NOISE.near * smallest] / smallest
    step = smallest * float(np.median(multiples / np.round(multiples)))
    levels = len(np.unique(values))
    whole = np.abs(multiples - np.round(multiples)) < NOISE.off
    if np.mean(whole) < NOISE.nearly_all or levels > np.ptp(values) / step + 2:
        return 0.0
    return step


def counted_on(angle: NDArray[np.float64]) -> NDArray[np.float64]:
    """An angle (n,) in rad that starts again after every turn, counted on over the turns; any other as it is.

    One that stays within a turn, jumps by nearly all of it, and moves little between samples otherwise, but for a
    glitch or a gap now and then. What often turns by more than a quarter between two samples is left alone: it may have
    gone either way.

    Example:
        >>> counted_on(np.array([2.9, 3.1, -3.0, -2.8])).round(2).tolist()
        [2.9, 3.1, 3.28, 3.48]
    """
    if np.ptp(angle) > 1.001 * 2 * math.pi or np.max(np.abs(np.diff(angle)), initial=0.0) < math.pi:
        return angle
    on = np.unwrap(angle)
    return on if np.mean(np.abs(np.diff(on)) >= CHECKS.steady) < CHECKS.rarely else angle


def notes(recording: Recording, model: mujoco.MjModel) -> tuple[str, ...]:
    """Sentences about what is odd but usable in a recording: sampling, dead or clipped channels, units, rates, limits.

    None of this stops an analysis, since each can be right: a locked joint does not move, and a motor axis may turn
    a hundred times. But whoever recorded it should know.
    """
    found = []
    if recording.ignored:
        found.append(f"columns {list(recording.ignored)} are not in the model and are ignored")
    found += _sampling(recording.time)
    for kind, names, table in (
        ("command", recording.actuator_names, recording.commands),
        ("sensor", recording.sensor_names, recording.sensors),
    ):
        for name, values in zip(names, table.T, strict=True):
            found += _dead_or_clipped(f"{kind} {name!r}", values)
    for name, values in zip(recording.sensor_names, recording.sensors.T, strict=True):
        found += _repeated(f"sensor {name!r}", values, recording.period)
        odd = [] if name in recording.told else _odd_unit(recording, name, values, model)
        # Degrees are foretold by no model in radians: where accelerations agree with it, a pole goes round.
        found += odd if odd and not _goes_round(recording, model, name) else []
    found += [*_odd_commands(recording, model), *_odd_rates(recording, model), *_beyond_limits(recording, model)]
    return (*found, *_at_limits(recording, model))


def _sampling(time: NDArray[np.float64]) -> list[str]:
    steps = np.diff(time)
    middle, longest = float(np.median(steps)), int(np.argmax(steps))
    found = []
    if middle > CHECKS.slow:
        unit = likely_time(middle)
        found.append(f"samples are {middle:g} s apart; if time is in {unit}, say --unit time={unit}")
    if steps[longest] > CHECKS.gap * middle:
        found.append(
            f"{np.sum(steps > CHECKS.gap * middle)} gaps in time, the longest {steps[longest]:.3g} s after "
            f"{time[longest] - time[0]:.6g} s of recording where {middle:.3g} s are usual: samples are missing there"
        )
    low, high = np.quantile(steps, [0.05, 0.95])
    if high - low > CHECKS.spread * middle:
        found.append(
            f"{IRREGULAR}: {low:.3g} to {high:.3g} s apart, median {middle:.3g} s (5 to 95 %); "
            "commands are averaged over the steps of the simulation"
        )
    return found


def _dead_or_clipped(label: str, values: NDArray[np.float64]) -> list[str]:
    if np.ptp(values) == 0:
        return [f"{label} is constant ({values[0]:g} throughout): locked, unused, or not connected?"]
    if np.mean((values == values.min()) | (values == values.max())) > CHECKS.switched:
        return []
    return [
        f"{label} sits at its {which} value, {extreme:g}, for {share:.0%} of the time and gets there at full speed: "
        "clipped, or against a stop?"
        for which, extreme in (("lowest", values.min()), ("highest", values.max()))
        if (share := clipped_share(values, float(extreme))) >= CHECKS.clipped
    ]


def _repeated(label: str, values: NDArray[np.float64], period: float) -> list[str]:
    """Whether a channel is read less often than it is written: rows between repeat it, or lie on a line."""
    steps = np.diff(values)
    count = quantum(values)
    # At rest a reading repeats as well; where it moves, each row is another.
    rows = _regularly(np.diff(np.flatnonzero(np.abs(steps) > CHECKS.steps * count), prepend=-1))
    if rows > 1 and float(np.mean(steps == 0)) * rows / (rows - 1) > CHECKS.regular:
        return [
            f"{label} changes only every {rows} rows: it was read at {1 / (rows * period):.4g} Hz and is late in "
            f"between, which no physics accounts for; log each row when it is read, or keep one row of {rows}"
        ]
    bends = np.flatnonzero(np.abs(np.diff(steps)) > CHECKS.straight * np.max(np.abs(steps), initial=0.0))
    rows = _regularly(np.diff(bends))
    if rows > 2:
        return [
            f"{label} lies on straight lines over {rows} rows each: it seems to be interpolated from "
            f"{1 / (rows * period):.4g} Hz, and what happened in between is made up; give the rows that were read"
        ]
    return []


def _regularly(apart: NDArray[np.intp]) -> int:
    """How many rows apart (n,) something is nearly always, or a multiple of them; 1 where that is not to be told."""
    if len(apart) < CHECKS.refreshed:
        return 1
    rows = int(np.argmax(np.bincount(apart)))
    return rows if np.mean(apart % rows == 0) > CHECKS.regular else 1


def clipped_share(values: NDArray[np.float64], extreme: float) -> float:
    """Share of the samples that lie on a plateau at `extreme` which the signal entered or left with a kink.

    A signal that comes to rest slows down before, so its last change is small; a clipped one is cut off while it
    moves. Commands that move in steps have plateaus everywhere, and none of theirs counts.
    """
    starts = np.flatnonzero(np.concatenate([[True], np.diff(values) != 0]))
    lengths = np.diff(np.append(starts, len(values)))
    levels = values[starts]
    changes = np.abs(np.diff(levels))
    if len(levels) < 4:
        return 0.0
    abrupt = max(CHECKS.steps * quantum(values), CHECKS.kink * float(np.max(changes)))
    plateau = (levels == extreme) & (lengths >= max(CHECKS.plateau, CHECKS.plateau * np.median(lengths)))
    before = np.concatenate([[0.0, 0.0], changes[:-1]])  # the last change but one before each level
    after = np.concatenate([changes[1:], [0.0, 0.0]])
    kinked = plateau & (np.maximum(before, after) > abrupt)
    return float(lengths[kinked].sum() / len(values))


def _odd_unit(recording: Recording, name: str, values: NDArray[np.float64], model: mujoco.MjModel) -> list[str]:
    """Whether a joint position is far beyond what its joint can do, or what one expects of it."""
    sensor = model.sensor(name).id
    if model.sensor_type[sensor] != mujoco.mjtSensor.mjSENS_JOINTPOS:
        return []
    joint = int(model.sensor_objid[sensor])
    hinge = is_hinge(model, joint)
    peak = float(np.max(np.abs(values)))
    usual = CHECKS.far_hinge if hinge else CHECKS.far_slide
    if model.jnt_limited[joint]:
        usual = DEGREES.beyond * float(np.max(np.abs(model.jnt_range[joint])))
    if peak <= usual:
        return []
    unit = "rad" if hinge else "m"
    (word, short), key = INSTEAD[unit], called(SENSOR, name, recording.actuator_names)
    return [f"sensor {name!r} reaches {peak:.4g} {unit}; if these are {word}, say --unit {key}={short}"]


def _odd_commands(recording: Recording, model: mujoco.MjModel) -> list[str]:
    """Angles and ways that are sent to servos, where they are far beyond what their joints can do."""
    found: list[str] = []
    for name, values in zip(recording.actuator_names, recording.commands.T, strict=True):
        unit, joint = of_command(model, name), int(model.actuator_trnid[commanded_by(model, name), 0])
        if COMMAND + name in recording.told or unit not in INSTEAD or not model.jnt_limited[joint]:
            continue
        peak, reach = float(np.max(np.abs(values))), float(np.max(np.abs(model.jnt_range[joint])))
        if peak > CHECKS.far_command * reach:
            word, short = INSTEAD[unit]
            key = called(COMMAND, name, recording.sensor_names)
            found.append(
                f"command {name!r} asks for {peak:.4g} {unit} of a joint that goes no further than {reach:.4g}; if "
                f"these are {word}, say --unit {key}={short}"
            )
    return found


def _goes_round(recording: Recording, model: mujoco.MjModel, name: str) -> bool:
    """Whether a hinge without limits goes beyond what is usual, as the model says that it must."""
    joint = int(model.sensor(name).objid[0])
    return is_hinge(model, joint) and not model.jnt_limited[joint] and turns(recording, model, [name])


def _odd_rates(recording: Recording, model: mujoco.MjModel) -> list[str]:
    """Velocities that are not the rates of the positions beside them: columns interchanged, signs, units."""
    found: list[str] = []
    kinds = [(int(model.sensor(name).type[0]), int(model.sensor(name).objid[0])) for name in recording.sensor_names]
    for (r, (kind, of)), p in itertools.product(enumerate(kinds), range(len(kinds))):
        if kinds[p] != (RATES.get(mujoco.mjtSensor(kind)), of):
            continue
        place, rate = recording.sensors[:, p], recording.sensors[:, r]
        if np.ptp(rate) == 0 or np.std(place) < CHECKS.moves * _noise(_differences(recording.time), place):
            continue
        found += _odd_rate(recording.time, (recording.sensor_names[p], place), (recording.sensor_names[r], rate))
    return found


def _odd_rate(
    time: NDArray[np.float64], place: tuple[str, NDArray[np.float64]], rate: tuple[str, NDArray[np.float64]]
) -> list[str]:
    """What is wrong with the rate of a position, both with their names."""
    low, high = CHECKS.times
    times, alike = _way(time, place[1], rate[1])
    if alike > CHECKS.like and low < times < high:
        return []
    backwards, alike_backwards = _way(time, rate[1], place[1])
    if alike_backwards > CHECKS.like and low < backwards < high:
        return [f"sensor {place[0]!r} is the rate of sensor {rate[0]!r}: interchanged? Say which is which with --map"]
    if alike < CHECKS.like:
        return [f"sensor {rate[0]!r} is not the rate of sensor {place[0]!r}: another joint's, or not calibrated?"]
    cause = "its sign is reversed" if -high < times < -low else "check its unit (--unit) and sign"
    return [f"sensor {rate[0]!r}, integrated, goes {times:.3g} times the way of sensor {place[0]!r}: {cause}"]


def _way(time: NDArray[np.float64], place: NDArray[np.float64], rate: NDArray[np.float64]) -> tuple[float, float]:
    """How many times the way of `place` a rate goes, and which share of its way that is; biases are taken out."""
    from scipy.integrate import cumulative_trapezoid  # these take a second to import, and few recordings need them
    from scipy.signal import detrend

    gone, there = detrend(cumulative_trapezoid(rate, time, initial=0)), detrend(place)
    both = float(gone @ there)
    return both / float(there @ there), both**2 / float(there @ there) / float(gone @ gone)


def _beyond_limits(recording: Recording, model: mujoco.MjModel) -> list[str]:
    """Commands that MuJoCo would clamp."""
    found = []
    for k, name in enumerate(recording.actuator_names):
        low, high = model.actuator_ctrlrange[k]
        share = float(np.mean((recording.commands[:, k] < low) | (recording.commands[:, k] > high)))
        if model.actuator_ctrllimited[k] and share:
            found.append(
                f"command {name!r} leaves its ctrlrange {low:g} to {high:g} in {share:.2%} of the samples, where the "
                "simulation clamps it; check its unit and the model"
            )
    return found


def _at_limits(recording: Recording, model: mujoco.MjModel) -> list[str]:
    """Joints that meet a limit of the model: a motion after an impact depends on less than readings tell."""
    found = []
    for name, values in zip(recording.sensor_names, recording.sensors.T, strict=True):
        kind, joint = int(model.sensor(name).type[0]), int(model.sensor(name).objid[0])
        if kind != mujoco.mjtSensor.mjSENS_JOINTPOS or not model.jnt_limited[joint]:
            continue
        low, high = model.jnt_range[joint]
        # As a share of the range, and from well within: at rest against a stop, noise goes to and fro.
        beyond = np.maximum(low - values, values - high) / (high - low)
        before = np.lib.stride_tricks.sliding_window_view(beyond, CHECKS.arrives)[:-1]
        arrives = (beyond[CHECKS.arrives :] > CHECKS.past) & (before[:, -1] <= CHECKS.past)
        times = int(np.sum(arrives & (before.min(axis=1) < -CHECKS.within)))
        if times and not _odd_unit(recording, name, values, model):
            found.append(
                f"sensor {name!r} goes beyond the limits of its joint, {low:.4g} to {high:.4g}, {times} times; what "
                "follows an impact depends on less than readings tell, and may pass for a push: record within them"
            )
    return found


def sampled_slowly(recording: Recording) -> bool:
    """Whether it has fewer samples a second than commands need that change at any time."""
    return recording.period * CHECKS.few * CHECKS.rate > 1


def slowly(recordings: Sequence[Recording]) -> list[str]:
    """Notes on recordings that are sampled slowly."""
    return [
        f"{r.name}: sampled at {1 / r.period:.3g} Hz; a command that changed between two rows is not in the file, and "
        f"looks like physics that the model lacks; record at {CHECKS.rate:g} Hz or more"
        for r in recordings
        if sampled_slowly(r)
    ]
