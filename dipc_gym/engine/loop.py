"""Windows through time, as code: any program, any mechanics, one function for all.

Runge-Kutta's fourth order between events. Commands are held between the moments at which they change, delays included,
and no step crosses such a moment. Where a joint would turn round or a tendon comes to a stop, the step ends at that
moment, which Newton's method finds; the last of its iterations is differentiated, so that derivatives know how the
moment moves (the jump, or saltation, of sensitivities at events). Where what holds a joint grows beyond its friction,
likewise.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from llvmlite import ir

from dipc_gym.engine.forces import Rule, Stops
from dipc_gym.engine.layout import CONTROLS, JOINTS, SENSORS, STATES, STOPS, At, Head, Joint, Row, Sensor
from dipc_gym.engine.motion import ARGUMENTS, write_rates
from dipc_gym.engine.values import INT, POINTER, VECTOR, Code, Index, Numbers, Value, exp, integer, sign, where

EVENTS = 8  # looked for within one step; what is left over is a small error
NEWTON = 4  # iterations for the moment of an event
SOON = 1e-9  # s; changes of commands nearer than this are one
FOLLOWED = 0.5  # time constant, in steps, that Runge-Kutta follows safely
SLIGHT = 1e-12  # depth in a stop from which it surely touches, m or rad
FAR = 1e12  # speeds beyond are of a simulation that diverged


def write_loop(rules: Sequence[tuple[Rule, bool]], *, tangents: bool) -> ir.Module:
    """The module with `run(addresses, first row, last row)`, and `probe`, the rates at one moment.

    Args:
        rules: what `<custom>` may add to joints, and whether each is a level of dry friction.
        tangents: whether derivatives are carried along.
    """
    module = ir.Module("loop")
    rates = write_rates(module, rules, tangents=tangents)
    code = Code(module, "advance", ARGUMENTS, tangents=tangents, internal=True)
    _write_advance(code, rates)
    advance = code.finish()
    code = Code(module, "probe", ARGUMENTS, tangents=tangents)
    code.at.call(rates, code.function.args)
    code.finish()
    code = Code(module, "run", [POINTER, INT, INT], tangents=tangents)
    addresses, first, last = code.function.args
    run = _Run(code, addresses, rates, advance)
    with code.count(last, first) as row:
        run.row(row)
    code.finish()
    return module


def _write_advance(code: Code, rates: ir.Function) -> None:
    """States after a step of the fourth order, from the states and their rates at its beginning.

    Arguments are those of `rates` with the states at the beginning, the step in the place of the holding forces, and
    the states at the end in the place of the levels.
    """
    args = list(code.function.args)
    n = code.whole(args[0], Head.STATES)
    begin, slope = code.numbers(args[8], args[9]), code.numbers(args[10], args[11])
    step, end = code.numbers(args[12], args[13]), code.numbers(args[14], args[15])
    here, rate = code.scratch(STATES), code.scratch(STATES)
    now, total = code.scratch(2), code.scratch(STATES)
    holding, levels = code.scratch(JOINTS), code.scratch(JOINTS)
    clock = code.numbers(args[6], args[7])
    h, time, now[1] = step[0], clock[0], clock[1]
    with code.count(n) as k:
        total[k] = slope[k]
        rate[k] = slope[k]
    # At a half, a half, and the end; weights 1, 2, 2, 1.
    share, weight = code.scratch(1, plain=True), code.scratch(1, plain=True)
    with code.count(3) as stage:
        last = code.equal(stage, 2)
        share[0] = where(last, code.value(1.0), code.value(0.5))
        weight[0] = where(last, code.value(1.0), code.value(2.0))
        now[0] = time + h * share[0]
        with code.count(n) as k:
            here[k] = begin[k] + (h * share[0]) * rate[k]
        code.at.call(rates, [*args[:6], *_both(now), *_both(here), *_both(rate), *_both(holding), *_both(levels)])
        with code.count(n) as k:
            total[k] = total[k] + weight[0] * rate[k]
    with code.count(n) as k:
        end[k] = begin[k] + (h / 6) * total[k]


def _both(numbers: Numbers) -> list[ir.Value]:
    return [numbers.place, numbers.beside if numbers.beside is not None else ir.Constant(POINTER, None)]


class _Run:
    """Writes what happens to one row: one window with one variant and up to LANES directions."""

    def __init__(self, code: Code, addresses: ir.Value, rates: ir.Function, advance: ir.Function) -> None:
        self.code, self.rates, self.advance = code, rates, advance
        at: dict[At, Any] = {k: code.pointer(addresses, int(k)) for k in At if k != At.SIZE}
        self.address, self.program = at, at[At.PROGRAM]
        self.nv, self.nx = code.whole(self.program, Head.JOINTS), code.whole(self.program, Head.STATES)
        self.nu, self.ns = code.whole(self.program, Head.CONTROLS), code.whole(self.program, Head.SENSORS)
        self.samples = code.whole(self.program, Head.SAMPLES)
        self.commands, self.signs = code.scratch(CONTROLS), code.scratch(JOINTS + STOPS, plain=True)
        self.time, self.clock = code.scratch(1), code.scratch(2)
        self.state, self.slope = code.scratch(STATES), code.scratch(STATES)
        self.ahead, self.rate = code.scratch(STATES), code.scratch(STATES)
        self.other = code.scratch(STATES)
        self.holding, self.levels = code.scratch(JOINTS), code.scratch(JOINTS)
        self.after, self.after_levels = code.scratch(JOINTS), code.scratch(JOINTS)
        self.left, self.part = code.scratch(1), code.scratch(1)
        self.pointers = code._scratch.alloca(INT, CONTROLS)
        self.read = code._scratch.alloca(INT, SENSORS)

    # Addresses of this row

    def _begin(self, row: ir.Value) -> None:
        code, at = self.code, self.address
        self.number = row
        entry = code.offset(at[At.ROWS], code.product(row, int(Row.SIZE)), INT)
        window = code.whole(entry, Row.WINDOW)
        count = code.whole(self.program, Head.PARAMETERS)
        parameters = code.offset(at[At.PARAMETERS], code.product(code.whole(entry, Row.PARAMETERS), count))
        directions = code.product(code.whole(entry, Row.DIRECTIONS), count)
        beside = code.offset(at[At.PARAMETER_TANGENTS], directions, VECTOR)
        self.numbers = code.numbers(parameters, beside)
        sample = code.product(code.whole(entry, Row.COMMANDS), self.nu)
        self.table = code.numbers(
            code.offset(at[At.COMMANDS], sample), code.offset(at[At.COMMAND_TANGENTS], sample, VECTOR)
        )
        self.stamps = code.numbers(code.offset(at[At.STAMPS], code.whole(entry, Row.STAMPS)))
        self.stamp_count = code.whole(entry, Row.COUNT)
        rows = code.product(row, self.nx)
        self.initial = code.numbers(
            code.offset(at[At.INITIAL], rows), code.offset(at[At.INITIAL_TANGENTS], rows, VECTOR)
        )
        self.ends = code.numbers(code.offset(at[At.ENDS], rows), code.offset(at[At.END_TANGENTS], rows, VECTOR))
        each = code.product(self.ns, self.samples)
        self.times = code.numbers(code.offset(at[At.TIMES], code.product(window, each)))
        out = code.product(row, each)
        self.readings = code.numbers(
            code.offset(at[At.READINGS], out), code.offset(at[At.READING_TANGENTS], out, VECTOR)
        )
        self.longest = code.numbers(at[At.STEP])[0]
        self.until = code.numbers(at[At.UNTIL])[window]
        self.zero = code.numbers(at[At.CLOCK])[window]  # window's start on the clock of recordings
        self.first_delay = code.whole(self.program, Head.DELAYS)

    def row(self, row: ir.Value) -> None:
        """Simulate one row."""
        code = self.code
        self._begin(row)
        with code.count(self.nx) as k:
            self.state[k] = self.initial[k]
        with code.count(JOINTS + STOPS) as k:
            self.signs[k] = 0.0
        with code.count(self.ns) as k:
            self._set(self.read, k, 0)
        with code.count(self.nu) as k:
            self._set(self.pointers, k, 0)
        self.time[0] = 0.0
        self._read_at_start()
        with code.repeat() as stop:
            self._take_commands()
            end = self._next_change()
            length = end - self.time[0]
            count = (length.plain / self.longest - 1e-6).ceil()
            count = code.at.select(code.below(count, 1), integer(1), count)
            each = length / Value(code, code.at.sitofp(count, length.primal.type))
            step = code.scratch(1)
            step[0] = each
            alive = code.counter(1)
            with code.count(count), code.when(code.equal(alive.get(), 1)):
                self.left[0] = step[0]
                self._step()
                alive.set(code.at.select(self._fine(), integer(1), integer(0)))
            self.time[0] = end  # sums of steps gather rounding
            finished = self.until - self.time.plain(0) <= SOON
            stop(code.any_of(finished, code.equal(alive.get(), 0)))
        self._leave()

    def _set(self, place: ir.Value, k: Index, value: Index) -> None:
        self.code.at.store(integer(value), self.code.offset(place, k, INT))

    # Commands

    def _change(self, k: Index, sample: ir.Value) -> Value:
        """When a sample of a command begins to act, s after the window's start."""
        code = self.code
        return (self.stamps[sample] - self.zero) + self.numbers[code.sum(self.first_delay, k)]

    def _take_commands(self) -> None:
        """Move to the samples that act now."""
        code = self.code
        with code.count(self.nu) as k:
            with code.repeat() as stop:
                ahead = code.sum(code.whole(self.pointers, k), 1)
                there = code.below(ahead, self.stamp_count)
                stop(code.at.not_(there))
                stop(self._change(k, ahead) - self.time.plain(0) > SOON)
                self._set(self.pointers, k, ahead)
            place = code.sum(code.product(code.whole(self.pointers, k), self.nu), k)
            self.commands[k] = self.table[place]

    def _next_change(self) -> Value:
        code, next_one = self.code, self.code.scratch(1)
        next_one[0] = self.until
        with code.count(self.nu) as k:
            ahead = code.sum(code.whole(self.pointers, k), 1)
            with code.when(code.below(ahead, self.stamp_count)):
                change = self._change(k, ahead)
                with code.when(next_one.plain(0) - change > 0):
                    next_one[0] = change
        return next_one[0]

    # Steps

    def _call(self, function: ir.Function, states: Numbers, *rest: Numbers) -> None:
        fixed = [self.program, *_both(self.numbers), *_both(self.commands)]
        fixed.append(self.signs.place)
        arguments = [*fixed, *_both(self.clock), *_both(states)]
        for numbers in rest:
            arguments += _both(numbers)
        self.code.at.call(function, arguments)

    def _rates(self, states: Numbers, rates: Numbers, holding: Numbers, levels: Numbers) -> None:
        self._set_clock()
        self._call(self.rates, states, rates, holding, levels)

    def _go(self, states: Numbers, rates: Numbers, step: Value, end: Numbers) -> None:
        self._set_clock()
        self.part[0] = step
        self._call(self.advance, states, rates, self.part, end)

    def _set_clock(self) -> None:
        self.clock[1] = self.longest * FOLLOWED
        self.clock[0] = self.time[0] + (self.zero - self.numbers[self.code.whole(self.program, Head.LATE)])

    def _speed(self, states: Numbers, k: Index) -> Value:
        return states[self.code.sum(self.nv, k)]

    def _step(self) -> None:
        """Advance by `left`, event by event."""
        code = self.code
        event, tries = code.counter(-1), code.counter(0)
        with code.repeat() as stop:
            self._directions()
            self._rates(self.state, self.slope, self.holding, self.levels)
            self._release()
            self._go(self.state, self.slope, self.left[0], self.ahead)
            self.part[0] = self.left[0]
            event.set(-1)
            with code.when(code.below(tries.get(), EVENTS)):
                self._find_reversal(event)
                self._find_release(event)
            self._record()
            self.time[0] = self.time[0] + self.part[0]
            self.left[0] = self.left[0] - self.part[0]
            with code.count(self.nx) as k:
                self.state[k] = self.ahead[k]
            tries.set(code.sum(tries.get(), 1))
            stop(code.below(event.get(), 0))
            stop(code.any_of(self.left.plain(0) <= 0, code.at.not_(self._fine())))

    def _directions(self) -> None:
        """Give moving joints without a direction the one of their motion; say which stops touch."""
        code = self.code
        with code.count(self.nv) as k:
            v, s = self._speed(self.state, k).plain, self.signs[k]
            self.signs[k] = where(code.any_of(s.equals(0.0), s * v < 0), sign(v), s)
        with self._stops(self.state) as (stop, depth, _):
            touches = self.signs[stop]
            deep = where(depth.plain > SLIGHT, code.value(1.0), touches)
            self.signs[stop] = where(depth.plain < -SLIGHT, code.value(0.0), deep)

    def _stops(self, states: Numbers) -> Any:
        return Stops(self.code, self.program, self.numbers, states)

    def _release(self) -> None:
        """Let joints go that need more than friction gives."""
        code = self.code
        again = code.counter(1)
        with code.count(self.nv), code.when(code.equal(again.get(), 1)):
            again.set(0)
            with code.count(self.nv) as k:
                needed, stuck = self.holding[k].plain, self._stuck(k, self.levels)
                with code.when(code.all_of(stuck, abs(needed) > self.levels[k].plain)):
                    self.signs[k] = -sign(needed)
                    again.set(1)
            with code.when(code.equal(again.get(), 1)):
                self._rates(self.state, self.slope, self.holding, self.levels)

    def _stuck(self, k: Index, levels: Numbers) -> ir.Value:
        return self.code.all_of(self.signs[k].equals(0.0), levels.plain(k) > 0)

    def _find_reversal(self, event: Any) -> None:
        """If a joint turns round or a stop is met, go to that moment instead."""
        code = self.code
        first = code.scratch(1, plain=True)
        first[0] = 2.0
        with code.count(self.nv) as k:
            begin, end, s = self._speed(self.state, k).plain, self._speed(self.ahead, k).plain, self.signs[k]
            dry = self.levels.plain(k) > 0
            with code.when(code.all_of(dry, s * end < 0)):
                # The parabola through both speeds with the slope of the beginning.
                slope = self.slope[code.sum(self.nv, k)].plain * self.left.plain(0)
                bend = end - begin - slope
                inside = slope * slope - 4 * (bend * begin)
                root = Value(code, code.intrinsic("llvm.sqrt", where(inside > 0, inside, code.value(0.0)).primal))
                steep = slope + where(slope < 0, -root, root)
                one, two = -2 * begin / steep, -steep / (2 * bend)
                straight = begin / (begin - end)
                at = where(code.all_of(two > 0, two <= 1), two, straight)
                at = where(code.all_of(one > 0, one <= 1), one, at)
                with code.when(at < first[0]):
                    first[0] = at
                    event.set(k)
        with self._stops(self.ahead) as (stop, depth, rate):
            end = depth.plain
            with code.when(code.all_of(self.signs[stop].equals(0.0), end > 0)):
                at = 1.0 - end / (rate.plain * self.left.plain(0))
                at = where(code.all_of(at > 0, at <= 1), at, code.value(0.5))
                with code.when(at < first[0]):
                    first[0] = at
                    event.set(stop)
        found = event.get()
        with code.when(code.all_of(code.below(integer(-1), found), code.below(found, JOINTS))):
            self._reach(first[0], lambda: self._turning(found))
            self.ahead[code.sum(self.nv, found)] = 0.0
            self.signs[found] = 0.0
        with code.when(code.below(integer(JOINTS - 1), found)):
            self._reach(first[0], lambda: self._touching(found))
            self.signs[found] = 1.0

    def _turning(self, joint: ir.Value) -> tuple[Value, Value]:
        """Speed of a joint where the step has come to, and how fast it changes."""
        return self._speed(self.ahead, joint), self.rate[self.code.sum(self.nv, joint)].plain

    def _touching(self, wanted: ir.Value) -> tuple[Value, Value]:
        """Depth in a stop where the step has come to, and how fast it changes."""
        code = self.code
        out = code.scratch(2)
        with self._stops(self.ahead) as (stop, depth, rate), code.when(code.equal(stop, wanted)):
            out[0], out[1] = depth, rate
        return out[0], out[1].plain

    def _reach(self, share: Value, measure: Any) -> None:
        """Go to the moment at which a measure, as a number and its rate, is zero; `part` is the time that takes."""
        code = self.code
        whole = code.scratch(1, plain=True)
        whole[0] = self.left.plain(0)
        gone = code.scratch(1, plain=True)
        gone[0] = share * whole[0]
        done = code.counter(0)
        with code.count(NEWTON) as k, code.when(code.equal(done.get(), 0)):
            self._go(self.state, self.slope, gone[0], self.ahead)
            now = self.time[0]
            self.time[0] = now + gone[0]
            self._rates(self.ahead, self.rate, self.after, self.after_levels)
            self.time[0] = now
            value, rate = measure()
            step = -value.plain / rate
            target = gone[0] + step
            inside = code.all_of(target >= 0, target <= whole[0])
            near = abs(step) < 1e-13 + 1e-9 * whole[0]
            good = code.any_of(near, code.equal(k, NEWTON - 1))
            with code.either(code.any_of(good, code.at.not_(inside))) as (then, otherwise):
                with then:
                    done.set(1)
                with otherwise:
                    gone[0] = target
        # To first order from here: the numbers hardly move, and tangents learn how the moment does.
        value, rate = measure()
        late = -value / rate
        usable = code.all_of(abs(late.plain) < 1e-3 * whole[0], abs(rate) > 0)
        late = where(usable, late, code.value(0.0))
        with code.count(self.nx) as k:
            self.ahead[k] = self.ahead[k] + late * self.rate[k].plain
        self.part[0] = gone[0] + late

    def _find_release(self, event: Any) -> None:
        """If what holds a joint outgrows its friction, go to that moment instead."""
        code = self.code
        any_stuck = code.counter(0)
        with code.count(self.nv) as k, code.when(self._stuck(k, self.levels)):
            any_stuck.set(1)
        with code.when(code.all_of(code.below(event.get(), 0), code.equal(any_stuck.get(), 1))):
            now = self.time[0]
            self.time[0] = now + self.left[0]
            self._rates(self.ahead, self.rate, self.after, self.after_levels)
            self.time[0] = now
            first = code.scratch(1)
            first[0] = 1.0
            with code.count(self.nv) as k:
                over = abs(self.after[k]) - self.after_levels[k]
                under = self.levels[k] - abs(self.holding[k])
                with code.when(code.all_of(self._stuck(k, self.levels), over > 0, under >= 0)):
                    share = under / (under + over)
                    with code.when(share < first[0].plain):
                        first[0] = share
                        event.set(k)
            with code.when(code.at.icmp_signed(">=", event.get(), integer(0))):
                self.part[0] = first[0] * self.left[0]
                step = code.scratch(1)
                step[0] = self.part[0]
                self._go(self.state, self.slope, step[0], self.ahead)
                self.part[0] = step[0]
                joint = event.get()
                self.signs[joint] = -sign(self.after[joint].plain)

    # Readings

    def _sensor(self, k: Index) -> ir.Value:
        code = self.code
        first = code.whole(self.program, Head.SENSOR_AT)
        return code.offset(self.program, code.sum(first, code.product(k, int(Sensor.SIZE))), INT)

    def _read_at_start(self) -> None:
        """Samples at the beginning itself."""
        code = self.code
        with code.count(self.ns) as k:
            sensor = self._sensor(k)
            lag, place = code.whole(sensor, Sensor.LAG), code.product(k, self.samples)
            some = code.below(integer(0), self.samples)
            with code.when(code.all_of(some, self._time(sensor, place) <= SOON)):
                reading = self.state[code.whole(sensor, Sensor.STATE)] * self.numbers[code.whole(sensor, Sensor.FACTOR)]
                self.readings[place] = reading
                with code.when(code.at.icmp_signed(">=", lag, integer(0))):
                    self.readings[place] = self.state[lag]
                self._set(self.read, k, 1)

    def _time(self, sensor: ir.Value, place: ir.Value) -> Value:
        """When a sample is read, s after the window's start."""
        return self.times[place] + self.numbers[self.code.whole(sensor, Sensor.AHEAD)]

    def _record(self) -> None:
        """Readings within the part of the step that is taken, and what lagging sensors say at its end."""
        code = self.code
        now, part = self.time[0], self.part[0]
        until = now + part
        with code.count(self.ns) as k:
            sensor = self._sensor(k)
            lag, index = code.whole(sensor, Sensor.LAG), code.whole(sensor, Sensor.STATE)
            factor = self.numbers[code.whole(sensor, Sensor.FACTOR)]
            before, after = self.state[index] * factor, self.ahead[index] * factor
            with code.repeat() as stop:
                sample = code.whole(self.read, k)
                stop(code.at.not_(code.below(sample, self.samples)))
                place = code.sum(code.product(k, self.samples), sample)
                stop(self._time(sensor, place) - until > SOON)
                gone = self._time(sensor, place) - now
                out = code.scratch(1)
                out[0] = self._between(index, gone, part) * factor
                with code.when(code.at.icmp_signed(">=", lag, integer(0))):
                    tau = self.numbers[code.whole(sensor, Sensor.TIME)]
                    out[0] = _follow(before, self.state[lag], out[0], gone, tau)
                self.readings[place] = out[0]
                self._set(self.read, k, code.sum(sample, 1))
            with code.when(code.at.icmp_signed(">=", lag, integer(0))):
                tau = self.numbers[code.whole(sensor, Sensor.TIME)]
                self.ahead[lag] = _follow(before, self.state[lag], after, part, tau)

    def _between(self, index: ir.Value, gone: Value, part: Value) -> Value:
        """A state within a step: a cubic through both ends for positions, a parabola for speeds."""
        code = self.code
        out = code.scratch(1)
        begin, end = self.state[index], self.ahead[index]
        s = gone / part
        left = 1.0 - s
        with code.either(code.below(index, self.nv)) as (position, speed):
            with position:
                early, late = self.state[code.sum(index, self.nv)], self.ahead[code.sum(index, self.nv)]
                bow = left * (begin * (1 + 2 * s) + s * part * early) * left
                out[0] = bow + s * s * (end * (3 - 2 * s) - left * part * late)
            with speed:
                slope = self.slope[index] * part
                out[0] = begin + s * (slope + s * (end - begin - slope))
        return out[0]

    # Ends

    def _fine(self) -> ir.Value:
        """Whether the simulation has not diverged, and no joint has left its range."""
        code, total = self.code, self.code.scratch(1, plain=True)
        total[0] = 0.0
        with code.count(self.nx) as k:
            total[0] = total[0] + abs(self.state[k].plain)
        first = code.whole(self.program, Head.JOINT_NUMBERS)
        with code.count(self.nv) as k:
            own, q = self.numbers.since(code.sum(first, code.product(k, int(Joint.SIZE)))), self.state.plain(k)
            outside = code.any_of(q < own.plain(Joint.LOWEST), q > own.plain(Joint.HIGHEST))
            with code.when(outside):
                total[0] = FAR
                self._set(self.address[At.LEFT], self.number, 1)
        return total[0] < FAR

    def _leave(self) -> None:
        """Keep the last states; what was not reached is not a number."""
        code = self.code
        with code.count(self.nx) as k:
            self.ends[k] = self.state[k]
        with code.count(self.ns) as k, code.count(self.samples, code.whole(self.read, k)) as sample:
            self.readings[code.sum(code.product(k, self.samples), sample)] = float("nan")


def _follow(before: Value, followed: Value, after: Value, duration: Value, tau: Value) -> Value:
    """A first-order lag over a time in which its input goes straight from `before` to `after`."""
    short = duration > 0
    safe = where(short, duration, 1.0)
    decay = exp(-(safe / tau))
    slope = (after - before) / safe
    later = decay * followed + (after - tau * slope) - decay * (before - tau * slope)
    return where(short, later, followed)
