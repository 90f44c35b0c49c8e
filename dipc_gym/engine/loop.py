"""Windows through time, as code: any program, any mechanics, one function for all.

Runge-Kutta's fourth order between events. Commands are held between the moments at which they change, delays included,
and no step crosses such a moment; nor does one cross an event, see `events`.
"""

from __future__ import annotations

from collections.abc import Sequence

from llvmlite import ir

from dipc_gym.engine.code import Code, integer
from dipc_gym.engine.events import Events
from dipc_gym.engine.laws import Rule
from dipc_gym.engine.layout import JOINTS, STATES, STOPS, Head
from dipc_gym.engine.motion import ARGUMENTS, write_rates
from dipc_gym.engine.readings import Readings
from dipc_gym.engine.values import INT, POINTER, Value, where
from dipc_gym.engine.window import SOON, Window, both

EVENTS = 8  # looked for within one step; what is left over is a small error


def write_loop(rules: Sequence[Rule], *, tangents: bool) -> ir.Module:
    """The module with `run(addresses, first row, last row)`, and `probe`, the rates at one moment.

    Args:
        rules: what `<custom>` may add to joints.
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
    run = _Run(Window(code, addresses, rates, advance))
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
        code.at.call(rates, [*args[:6], *both(now), *both(here), *both(rate), *both(holding), *both(levels)])
        with code.count(n) as k:
            total[k] = total[k] + weight[0] * rate[k]
    with code.count(n) as k:
        end[k] = begin[k] + (h / 6) * total[k]


class _Run:
    """Writes how a row is simulated."""

    def __init__(self, window: Window) -> None:
        self.window, self.events, self.readings = window, Events(window), Readings(window)

    def row(self, row: ir.Value) -> None:
        """Simulate one row."""
        w = self.window
        code = w.code
        w.begin(row)
        with code.count(w.nx) as k:
            w.state[k] = w.initial[k]
        with code.count(JOINTS + STOPS) as k:
            w.signs[k] = 0.0
        with code.count(w.ns) as k:
            w.set(w.read, k, 0)
        with code.count(w.nu) as k:
            w.set(w.pointers, k, 0)
        w.time[0] = 0.0
        self.readings.at_start()
        with code.repeat() as stop:
            w.take_commands()
            end = w.next_change()
            length = end - w.time[0]
            count = (length.plain / w.longest - 1e-6).ceil()
            count = code.at.select(code.below(count, 1), integer(1), count)
            each = length / Value(code, code.at.sitofp(count, length.primal.type))
            step = code.scratch(1)
            step[0] = each
            alive = code.counter(1)
            with code.count(count), code.when(code.equal(alive.get(), 1)):
                w.left[0] = step[0]
                self._step()
                alive.set(code.at.select(w.fine(), integer(1), integer(0)))
            w.time[0] = end  # sums of steps gather rounding
            finished = w.until - w.time.plain(0) <= SOON
            stop(code.any_of(finished, code.equal(alive.get(), 0)))
        self.readings.leave()

    def _step(self) -> None:
        """Advance by `left`, event by event."""
        w = self.window
        code = w.code
        event, tries = code.counter(-1), code.counter(0)
        with code.repeat() as stop:
            self.events.directions()
            w.rates_at(w.state, w.slope, w.holding, w.levels)
            self.events.release()
            w.go(w.state, w.slope, w.left[0], w.ahead)
            w.part[0] = w.left[0]
            event.set(-1)
            with code.when(code.below(tries.get(), EVENTS)):
                self.events.find_reversal(event)
                self.events.find_release(event)
            self.readings.record()
            w.time[0] = w.time[0] + w.part[0]
            w.left[0] = w.left[0] - w.part[0]
            with code.count(w.nx) as k:
                w.state[k] = w.ahead[k]
            tries.set(code.sum(tries.get(), 1))
            stop(code.below(event.get(), 0))
            stop(code.any_of(w.left.plain(0) <= 0, code.at.not_(w.fine())))
