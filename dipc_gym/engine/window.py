"""One window under way, as code: where its numbers stand, its commands, and what its states do.

What happens in it is in `events`, what its sensors read in `readings`; `loop` takes it through time.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir

from dipc_gym.engine.code import Code, Index, Numbers, integer
from dipc_gym.engine.layout import CONTROLS, JOINTS, SENSORS, STATES, STOPS, At, Head, Joint, Row
from dipc_gym.engine.limits import Stops
from dipc_gym.engine.motion import FOLLOWED
from dipc_gym.engine.values import INT, POINTER, VECTOR, Value

SOON = 1e-9  # s; changes of commands nearer than this are one
FAR = 1e12  # speeds beyond are of a simulation that diverged


def both(numbers: Numbers) -> list[ir.Value]:
    """Addresses of numbers and of their tangents, as arguments of a call."""
    return [numbers.place, numbers.beside if numbers.beside is not None else ir.Constant(POINTER, None)]


class Window:
    """Writes what concerns one row: one window with one variant and up to LANES directions.

    Args:
        code: to write into.
        addresses: of the arrays that a run is given.
        rates: function that `motion.write_rates` wrote.
        advance: function that makes a step of them.

    Attributes:
        state: at the beginning of a step; `slope` its rates, `holding` and `levels` what goes with these.
        ahead: states at its end, or where an event ends it; `rate`, `after` and `after_levels` go with these.
        signs: direction of each joint, 0 while it sticks; then of each stop whether it touches.
        time: s after the window's start.
        left: of the step, s; `part` of it is taken.
        pointers: sample of each command that acts.
        read: samples that each sensor has been read at.
    """

    def __init__(self, code: Code, addresses: ir.Value, rates: ir.Function, advance: ir.Function) -> None:
        self.code, self._rates, self._advance = code, rates, advance
        at: dict[At, Any] = {k: code.pointer(addresses, int(k)) for k in At if k != At.SIZE}
        self.address, self.program = at, at[At.PROGRAM]
        self.nv, self.nx = code.whole(self.program, Head.JOINTS), code.whole(self.program, Head.STATES)
        self.nu, self.ns = code.whole(self.program, Head.CONTROLS), code.whole(self.program, Head.SENSORS)
        self.samples = code.whole(self.program, Head.SAMPLES)
        self.commands, self.signs = code.scratch(CONTROLS), code.scratch(JOINTS + STOPS, plain=True)
        self.time, self.clock = code.scratch(1), code.scratch(2)
        self.state, self.slope = code.scratch(STATES), code.scratch(STATES)
        self.ahead, self.rate = code.scratch(STATES), code.scratch(STATES)
        self.holding, self.levels = code.scratch(JOINTS), code.scratch(JOINTS)
        self.after, self.after_levels = code.scratch(JOINTS), code.scratch(JOINTS)
        self.left, self.part = code.scratch(1), code.scratch(1)
        self.pointers = code._scratch.alloca(INT, CONTROLS)
        self.read = code._scratch.alloca(INT, SENSORS)

    # Addresses of this row

    def begin(self, row: ir.Value) -> None:
        """Take the addresses of a row."""
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

    def set(self, place: ir.Value, k: Index, value: Index) -> None:
        """Change a whole number in memory."""
        self.code.at.store(integer(value), self.code.offset(place, k, INT))

    # Commands

    def _change(self, k: Index, sample: ir.Value) -> Value:
        """When a sample of a command begins to act, s after the window's start."""
        code = self.code
        return (self.stamps[sample] - self.zero) + self.numbers[code.sum(self.first_delay, k)]

    def take_commands(self) -> None:
        """Move to the samples that act now."""
        code = self.code
        with code.count(self.nu) as k:
            with code.repeat() as stop:
                ahead = code.sum(code.whole(self.pointers, k), 1)
                there = code.below(ahead, self.stamp_count)
                stop(code.at.not_(there))
                stop(self._change(k, ahead) - self.time.plain(0) > SOON)
                self.set(self.pointers, k, ahead)
            place = code.sum(code.product(code.whole(self.pointers, k), self.nu), k)
            self.commands[k] = self.table[place]

    def next_change(self) -> Value:
        """When a command changes next, or the window ends, s after its start."""
        code, next_one = self.code, self.code.scratch(1)
        next_one[0] = self.until
        with code.count(self.nu) as k:
            ahead = code.sum(code.whole(self.pointers, k), 1)
            with code.when(code.below(ahead, self.stamp_count)):
                change = self._change(k, ahead)
                with code.when(next_one.plain(0) - change > 0):
                    next_one[0] = change
        return next_one[0]

    # States

    def _call(self, function: ir.Function, states: Numbers, *more: Numbers) -> None:
        fixed = [self.program, *both(self.numbers), *both(self.commands)]
        fixed.append(self.signs.place)
        arguments = [*fixed, *both(self.clock), *both(states)]
        for numbers in more:
            arguments += both(numbers)
        self.code.at.call(function, arguments)

    def rates_at(self, states: Numbers, rates: Numbers, holding: Numbers, levels: Numbers) -> None:
        """Set rates of states, what holds joints that stick, and levels of dry friction."""
        self._set_clock()
        self._call(self._rates, states, rates, holding, levels)

    def go(self, states: Numbers, rates: Numbers, step: Value, end: Numbers) -> None:
        """Set states at the end of a step from those at its beginning and their rates."""
        self._set_clock()
        self.part[0] = step
        self._call(self._advance, states, rates, self.part, end)

    def _set_clock(self) -> None:
        self.clock[1] = self.longest * FOLLOWED
        self.clock[0] = self.time[0] + (self.zero - self.numbers[self.code.whole(self.program, Head.LATE)])

    def speed(self, states: Numbers, k: Index) -> Value:
        """Speed of a joint among states; among rates its acceleration."""
        return states[self.code.sum(self.nv, k)]

    def stops(self, states: Numbers) -> Any:
        """Repeat for each stop; see `limits.Stops`."""
        return Stops(self.code, self.program, self.numbers, states)

    def stuck(self, k: Index, levels: Numbers) -> ir.Value:
        """Whether a joint sticks: it has no direction, and friction."""
        return self.code.all_of(self.signs[k].equals(0.0), levels.plain(k) > 0)

    def fine(self) -> ir.Value:
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
                self.set(self.address[At.LEFT], self.number, 1)
        return total[0] < FAR
