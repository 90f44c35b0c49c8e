"""Readings of a window's sensors, as code: between the ends of a step, with lags, each at its own time."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from llvmlite import ir

from dipc_gym.engine.code import Index, integer
from dipc_gym.engine.layout import Head, Sensor
from dipc_gym.engine.values import INT, Value, exp, where
from dipc_gym.engine.window import SOON, Window


class Readings:
    """Writes what the sensors of a window read."""

    def __init__(self, window: Window) -> None:
        self.window = window

    def _sensor(self, k: Index) -> ir.Value:
        w = self.window
        code = w.code
        first = code.whole(w.program, Head.SENSOR_AT)
        return code.offset(w.program, code.sum(first, code.product(k, int(Sensor.SIZE))), INT)

    def _sum(self, sensor: ir.Value, of: Callable[[ir.Value], Value]) -> Value:
        """What a sensor reads where its states are what `of` says of each."""
        w = self.window
        code = w.code
        first, weights = (code.whole(sensor, at) for at in (Sensor.TERM_AT, Sensor.NUMBERS))
        out = code.scratch(1)
        out[0] = 0.0
        with code.count(code.whole(sensor, Sensor.TERMS)) as term:
            out[0] = out[0] + of(code.whole(w.program, code.sum(first, term))) * w.numbers[code.sum(weights, term)]
        return out[0]

    def at_start(self) -> None:
        """Samples at the beginning itself."""
        w = self.window
        code = w.code
        with code.count(w.ns) as k:
            sensor = self._sensor(k)
            lag, place = code.whole(sensor, Sensor.LAG), code.product(k, w.samples)
            some = code.below(integer(0), w.samples)
            with code.when(code.all_of(some, self._time(sensor, place) <= SOON)):
                w.readings[place] = self._sum(sensor, w.state.__getitem__)
                with code.when(code.at.icmp_signed(">=", lag, integer(0))):
                    w.readings[place] = w.state[lag]
                w.set(w.read, k, 1)

    def _time(self, sensor: ir.Value, place: ir.Value) -> Value:
        """When a sample is read, s after the window's start."""
        w = self.window
        return w.times[place] + w.numbers[w.code.whole(sensor, Sensor.AHEAD)]

    def record(self) -> None:
        """Readings within the part of the step that is taken, and what lagging sensors say at its end."""
        w = self.window
        code = w.code
        now, part = w.time[0], w.part[0]
        until = now + part
        with code.count(w.ns) as k:
            sensor = self._sensor(k)
            lag = code.whole(sensor, Sensor.LAG)
            with code.repeat() as stop:
                sample = code.whole(w.read, k)
                stop(code.at.not_(code.below(sample, w.samples)))
                place = code.sum(code.product(k, w.samples), sample)
                stop(self._time(sensor, place) - until > SOON)
                gone = self._time(sensor, place) - now
                out = code.scratch(1)
                out[0] = self._sum(sensor, partial(self._between, gone, part))
                with code.when(code.at.icmp_signed(">=", lag, integer(0))):
                    tau = w.numbers[code.whole(sensor, Sensor.TIME)]
                    before = self._sum(sensor, w.state.__getitem__)
                    out[0] = _follow(before, w.state[lag], out[0], gone, tau)
                w.readings[place] = out[0]
                w.set(w.read, k, code.sum(sample, 1))
            with code.when(code.at.icmp_signed(">=", lag, integer(0))):
                tau = w.numbers[code.whole(sensor, Sensor.TIME)]
                before, after = self._sum(sensor, w.state.__getitem__), self._sum(sensor, w.ahead.__getitem__)
                w.ahead[lag] = _follow(before, w.state[lag], after, part, tau)

    def _between(self, gone: Value, part: Value, index: ir.Value) -> Value:
        """A state within a step: a cubic through both ends for positions, a parabola for speeds."""
        w = self.window
        code = w.code
        out = code.scratch(1)
        begin, end = w.state[index], w.ahead[index]
        s = gone / part
        left = 1.0 - s
        with code.either(code.below(index, w.nv)) as (position, speed):
            with position:
                early, late = w.state[code.sum(index, w.nv)], w.ahead[code.sum(index, w.nv)]
                bow = left * (begin * (1 + 2 * s) + s * part * early) * left
                out[0] = bow + s * s * (end * (3 - 2 * s) - left * part * late)
            with speed:
                slope = w.slope[index] * part
                out[0] = begin + s * (slope + s * (end - begin - slope))
        return out[0]

    def leave(self) -> None:
        """Keep the last states; what was not reached is not a number."""
        w = self.window
        code = w.code
        with code.count(w.nx) as k:
            w.ends[k] = w.state[k]
        with code.count(w.ns) as k, code.count(w.samples, code.whole(w.read, k)) as sample:
            w.readings[code.sum(code.product(k, w.samples), sample)] = float("nan")


def _follow(before: Value, followed: Value, after: Value, duration: Value, tau: Value) -> Value:
    """A first-order lag over a time in which its input goes straight from `before` to `after`."""
    short = duration > 0
    safe = where(short, duration, 1.0)
    decay = exp(-(safe / tau))
    slope = (after - before) / safe
    later = decay * followed + (after - tau * slope) - decay * (before - tau * slope)
    return where(short, later, followed)
