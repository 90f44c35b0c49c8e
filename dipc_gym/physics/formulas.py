"""What each entry of `<custom>` does: small functions on arrays whose last axes are its numbers."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SOONEST = 4e-3  # s, in which a memory may fade: usual steps follow that
UNTOLD = 20.0  # times the speed up to which a joint rests: a velocity told from readings is no nearer to none


@dataclass(frozen=True)
class Moment:
    """What an effect may look at when it acts.

    Attributes:
        time: simulation time, s, (...).
        position: position of the joint it acts on, m or rad, (...); zeros for commands and sensors.
        drive: force of the motors on the joint, N or N m, (...); what actuators exert that nobody commands, loads and
            friction in an actuator's clothes, is not theirs.
        weight: force that gravity and the motion of other joints ask of it, MuJoCo's bias, N or N m, (...).
        value: the command or the reading to change, (...); zeros for forces and friction.
        speed: velocity of the joint it acts on, m/s or rad/s, (...); zeros for commands and sensors.
        inputs: what else a law depends on, in the order in which the file names them, (...) each.
        memory: what a law that remembers has come to, (...).
        slides: 1 where a joint is known to slide, however slowly, (...); 0 where its speed alone tells.
    """

    time: Array
    position: Array
    drive: Array
    weight: Array
    value: Array
    speed: Any = 0.0
    inputs: tuple[Any, ...] = ()
    memory: Any = 0.0
    slides: Any = 0.0


def moment(
    time: Array | float,
    position: Array | float = 0.0,
    drive: Array | float = 0.0,
    weight: Array | float = 0.0,
    value: Array | float = 0.0,
) -> Moment:
    """A moment of these numbers, or arrays of them."""
    numbers = [np.asarray(x) for x in (time, position, drive, weight, value)]
    return Moment(numbers[0], numbers[1], numbers[2], numbers[3], numbers[4])


def deadzone(data: Array, now: Moment) -> Array:
    """Command u becomes sign(u) max(|u| - width, 0); data: width."""
    return np.sign(now.value) * np.maximum(np.abs(now.value) - data[..., 0], 0.0)


def sensor_bias(data: Array, now: Moment) -> Array:
    """Reading plus a constant; data: bias."""
    return now.value + data[..., 0]


def sensor_gain(data: Array, now: Moment) -> Array:
    """Reading times a factor; data: gain."""
    return now.value * data[..., 0]


def sensor_eccentric(data: Array, now: Moment) -> Array:
    """Reading y + sine sin(a) + cosine cos(a), a = 2 pi y / wavelength; data: these three numbers."""
    angle = 2 * np.pi * now.value / data[..., 2]
    return np.asarray(now.value + data[..., 0] * np.sin(angle) + data[..., 1] * np.cos(angle))


def lag(data: Array, now: Moment) -> Array:
    """The reading that a lag settles at, the input itself (`Physics.sense` keeps time); data: time constant > 0."""
    return now.value + 0.0 * data[..., 0]


def friction_along(data: Array, now: Moment) -> Array:
    """Dry friction interpolated over position; data: first and last position, then levels at equal distances."""
    first, last = data[..., 0], data[..., 1]
    return np.maximum(_tabulated(data[..., 2:], (now.position - first) / (last - first)), 0.0)


def friction_over_time(data: Array, now: Moment) -> Array:
    """Dry friction interpolated over time; data: first and last time, then levels at equal distances."""
    first, last = data[..., 0], data[..., 1]
    return np.maximum(_tabulated(data[..., 2:], (now.time - first) / (last - first)), 0.0)


def _tabulated(table: Array, share: Array) -> Array:
    """A table (..., k) of equal distances at a share of its length; beyond its ends it goes on as it ends."""
    if not isinstance(table, np.ndarray):  # of the engine, which writes code for it
        return table.at(share)
    last = table.shape[-1] - 1
    along = np.clip(share * last, 0.0, last)
    # Not a number of a simulation that diverged; `along` hands it on.
    below = np.maximum(np.minimum(np.nan_to_num(along).astype(np.intp), last - 1), 0)
    at = _entry(table, below)
    return np.asarray(at + (along - below) * (_entry(table, below + 1) - at))


def _dense_share(x: Array, most: Array, near: Array) -> Array:
    """Share of a table that is dense near 0: half of its knots lie below about `near`, and the last at the most."""
    return x * (most + near) / (most * (x + near))


def table(data: Array, x: Array) -> Array:
    """A table, piecewise linear and constant outside; data (..., 2 k): its knots, increasing, then its values there."""
    knots, values = np.split(data, 2, axis=-1)
    below, above, share = _between(knots, x)
    at = _entry(values, below)
    return np.asarray(at + share * (_entry(values, above) - at))


def mapped(data: Array, now: Moment) -> Array:
    """A command or reading mapped by a table; data: at least two of them, increasing, then as many that they become.

    Outside the table it becomes as much more or less than the table's end as it is beyond it.
    """
    knots, _ = np.split(data, 2, axis=-1)
    inside = np.clip(now.value, knots[..., 0], knots[..., -1])
    return table(data, inside) + (now.value - inside)


def friction_wave(data: Array, now: Moment) -> Array:
    """Dry friction level + sine sin(a) + cosine cos(a), a = 2 pi q / wavelength; data: these four numbers."""
    angle = 2 * np.pi * now.position / data[..., 3]
    return np.maximum(data[..., 0] + data[..., 1] * np.sin(angle) + data[..., 2] * np.cos(angle), 0.0)


def friction_under_load(data: Array, now: Moment) -> Array:
    """Dry friction level + by_drive |drive| + by_weight |weight|; data: level, by_drive, by_weight."""
    return np.maximum(data[..., 0] + _under_load(data, now), 0.0)


def friction_under_load_at_rest(data: Array, now: Moment) -> Array:
    """Friction under load, and more of it at rest; data: level, by_drive, by_weight, excess, velocity.

    It is 1 + excess exp(-(v / velocity)^2) times that under load.
    """
    more = 1.0 + data[..., 3] * np.exp(-((now.speed / data[..., 4]) ** 2))
    return friction_under_load(data, now) * np.maximum(more, 0.0)


def friction_under_load_by_speed(data: Array, now: Moment) -> Array:
    """Dry friction level + (by_drive |drive| + by_weight |weight|) (1 + more); data: these, fastest, slow, then more.

    How much more lies at equal distances of s from 0 to 1, s = |v| (fastest + slow) / (fastest (|v| + slow)), so that
    half of the knots lie below about the slow speed. Faster than the fastest it stays as it is there.
    """
    fastest, slow, speed = data[..., 3], data[..., 4], np.abs(now.speed)
    more = _tabulated(data[..., 5:], _dense_share(speed, fastest, slow))
    return np.maximum(data[..., 0] + _under_load(data, now) * (1.0 + more), 0.0)


def _under_load(data: Array, now: Moment) -> Array:
    """What the load adds to dry friction, by_drive |drive| + by_weight |weight|: the second and third numbers."""
    return data[..., 1] * np.abs(now.drive) + data[..., 2] * np.abs(now.weight)


def periodic_force(data: Array, now: Moment) -> Array:
    """Amplitude sin(2 pi frequency t + phase); data: amplitude, frequency, phase."""
    return data[..., 0] * np.sin(2 * np.pi * data[..., 1] * now.time + data[..., 2])


def pulse_force(data: Array, now: Moment) -> Array:
    """A constant force from start on for a duration; data: force, start, duration."""
    over = now.time - data[..., 1] >= data[..., 2]
    return np.where(now.time >= data[..., 1], np.where(over, 0.0, data[..., 0]), 0.0)


def force_of(data: Array, now: Moment) -> Array:
    """A force interpolated over one or two inputs; data: speed, counts of both knots, knots of each, levels.

    Each knot of the first input has a row of levels over the second; without a second that has one knot, 0. Beyond its
    ends a table goes on as it ends. A force along the motion fades where the joint is faster than that speed, the
    largest in the data: it cannot drive it on for ever.
    """
    first, second = now.inputs
    force = _surface(data[..., 3:], data[..., 1], data[..., 2], first, second)
    fades = np.clip(np.abs(now.speed) / data[..., 0] - 1.0, 0.0, 1.0)
    return np.where(force * now.speed > 0, force * (1.0 - fades), force)


def creeping_force(data: Array, now: Moment) -> Array:
    """A spring that creeps; data: stiffness, furthest stretch, then how fast it gives way at equal stretches from 0.

    It pulls with its stiffness times its stretch, which it remembers.
    """
    return -data[..., 0] * now.memory


def creeping(data: Array, now: Moment) -> Array:
    """How fast a spring that creeps is stretched: as fast as its joint moves, less what it gives way.

    Beyond the furthest stretch it gives way in proportion.
    """
    share = np.abs(now.memory) / data[..., 1]
    gives = _tabulated(data[..., 2:], share) * np.maximum(share, 1.0)
    return now.speed - np.where(now.memory < 0, -gives, gives)


def hysteresis_force(data: Array, now: Moment) -> Array:
    """Friction with memory, the force that it remembers within a bound; data: bound, then stiffnesses at equal forces.

    The first is where all of the force goes along the motion, the last, which is 0, where all goes against it.
    """
    return -np.minimum(np.maximum(now.memory, -data[..., 0]), data[..., 0])


def bending(data: Array, now: Moment) -> Array:
    """How fast friction with memory grows: with the way, by a stiffness that depends on it alone (Duhem's operator)."""
    along = np.where(now.speed < 0, -now.memory, now.memory)
    return now.speed * _tabulated(data[..., 1:], 0.5 * (along / data[..., 0] + 1.0))


def friction_rested(data: Array, now: Moment) -> Array:
    """Dry friction level + rise (1 - exp(-rested / time)) (1 - |v| / slow); data: level, rise, time, slow.

    What rest adds is gone from the speed `slow` on, and forgotten within milliseconds of going on faster. Where a joint
    is known to have broken away it is gone at once.
    """
    added = data[..., 1] * (1.0 - np.exp(-now.memory / data[..., 2]))
    return np.maximum(data[..., 0] + added * _at_rest(data, now), 0.0)


def friction_rested_by_law(data: Array, now: Moment) -> Array:
    """Dry friction level + rise(rested) (1 - |v| / slow); data: level, longest, soon, slow, then the rises.

    They lie at equal distances of s from 0 to 1, s = rested (longest + soon) / (longest (rested + soon)), so that half
    of the knots lie below about the time `soon`. After the longest rest it stays as it is there.
    """
    longest, soon, rested = data[..., 1], data[..., 2], now.memory
    rise = _tabulated(data[..., 4:], _dense_share(rested, longest, soon))
    return np.maximum(data[..., 0] + rise * _at_rest(data, now), 0.0)


def _at_rest(data: Array, now: Moment) -> Array:
    """How much a joint rests, from 1 to 0 at the speed that is the fourth of the data."""
    return (1.0 - now.slides) * np.maximum(1.0 - np.abs(now.speed) / data[..., 3], 0.0)


def resting(data: Array, now: Moment) -> Array:
    """How fast the time at rest grows: as fast as time, and back to none where the joint moves; the fourth of the data
    is the speed up to which it rests.
    """
    moves = np.maximum(np.minimum(np.maximum(np.abs(now.speed) / data[..., 3] - 1.0, 0.0), 1.0), now.slides)
    return 1.0 - moves * (1.0 + now.memory / SOONEST)


def told_rests(data: Array, speed: Array) -> Array:
    """A speed as it was told from readings (n,), and none where it is as near to none as readings tell."""
    return np.where(np.abs(speed) < UNTOLD * data[3], 0.0, speed)


def force_of_recent(data: Array, now: Moment) -> Array:
    """A force over how large one input was of late, and over it itself; data: time constant, then as `force_of`."""
    return force_of(data[..., 1:], replace(now, inputs=(now.memory, now.inputs[0])))


def recent(data: Array, now: Moment) -> Array:
    """How fast that follows the size of the input: a mean over the past, which fades with the time constant."""
    return (np.abs(now.inputs[0]) - now.memory) / data[..., 0]


def sagging_force(data: Array, now: Moment) -> Array:
    """What a supply that sags takes off its drive, gain u min(per m, 1); data: gain, back, per, time constant.

    It remembers m, how large the current was of late, as the command that would drive it at rest.
    """
    return -data[..., 0] * now.inputs[0] * _lost(data[..., 2] * now.memory)


def sagging(data: Array, now: Moment) -> Array:
    """How fast that follows |u (1 - lost) - back v|: a mean over the past, which fades with the time constant.

    What has sagged draws less: of a motor that runs, whose back-EMF takes most of the command, far less.
    """
    return (_drawn(data, now, _lost(data[..., 2] * now.memory)) - now.memory) / data[..., 3]


def sagging_force_by_law(data: Array, now: Moment) -> Array:
    """What a supply takes off that sags by a table; data: gain, back, time constant, largest current, then see below.

    Then how much more is lost for each unit of current beyond the largest, and the shares that are lost under currents
    at equal distances from 0. It remembers the share that is lost, up to all of it.
    """
    return -data[..., 0] * now.inputs[0] * _lost(now.memory)


def sagging_by_law(data: Array, now: Moment) -> Array:
    """How fast that share follows what is lost in the end under the current that is drawn, as `sagging`."""
    most, drawn = data[..., 3], _drawn(data, now, _lost(now.memory))
    asked = _tabulated(data[..., 5:], drawn / most) + data[..., 4] * np.maximum(drawn - most, 0.0)
    return (asked - now.memory) / data[..., 2]


def _lost(share: Array) -> Array:
    """Share of a supply that is lost: no more than all."""
    return np.minimum(np.maximum(share, 0.0), 1.0)


def _drawn(data: Array, now: Moment, lost: Array) -> Array:
    """Size of the current, as the command that would drive it at rest."""
    return np.abs(now.inputs[0] * (1.0 - lost) - data[..., 1] * now.speed)


def _surface(data: Array, rows: Array, columns: Array, x: Array, y: Array) -> Array:
    """A table with rows of columns, straight lines between: its knots along both, then its levels.

    The counts are the same in all simulations of a batch.
    """
    if not isinstance(data, np.ndarray):  # of the engine, which writes code for it
        return data.across(rows, columns, x, y)
    m, n = int(np.ravel(rows)[0]), int(np.ravel(columns)[0])
    low, high, up = _between(data[..., :m], x)
    left, right, along = _between(data[..., m : m + n], y)
    levels = data[..., m + n :]
    corners = [_entry(levels, r * n + c) for r in (low, high) for c in (left, right)]
    one, other = (corners[k] + along * (corners[k + 1] - corners[k]) for k in (0, 2))
    return np.asarray(one + up * (other - one))


def _between(knots: Array, x: Array) -> tuple[NDArray[np.intp], NDArray[np.intp], Array]:
    """Entries below and above a number among knots (..., k), and how far between them it is, 0 to 1."""
    last = knots.shape[-1] - 1
    if knots.ndim == 1:  # of one simulation, with many samples
        below = np.asarray(np.searchsorted(knots[1:-1], x, side="right"))
    else:
        below = np.sum(np.asarray(x)[..., None] >= knots[..., 1:-1], axis=-1)
    above = np.minimum(below + 1, last)
    one, other = _entry(knots, below), _entry(knots, above)
    return below, above, np.clip((x - one) / np.where(last, other - one, 1.0), 0.0, 1.0)


def _entry(table: Array, k: NDArray[np.intp]) -> Array:
    """Entry k (...) of each table (..., n)."""
    if table.ndim == 1:
        return np.asarray(table[k])
    whole = np.broadcast_to(table, (*np.shape(k), table.shape[-1]))
    return np.asarray(np.take_along_axis(whole, np.asarray(k)[..., None], -1)[..., 0])
