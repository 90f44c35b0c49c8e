"""Events of a window, as code: joints that turn round, stick or let go, and tendons that meet their stops.

Where a joint would turn round or a tendon comes to a stop, the step ends at that moment, which Newton's method finds;
the last of its iterations is differentiated, so that derivatives know how the moment moves (the jump, or saltation, of
sensitivities at events). Where what holds a joint grows beyond its friction, likewise.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir

from dipc_gym.engine.code import integer
from dipc_gym.engine.layout import JOINTS
from dipc_gym.engine.values import Value, sign, where
from dipc_gym.engine.window import Window

NEWTON = 4  # iterations for the moment of an event
SLIGHT = 1e-12  # depth in a stop from which it surely touches, m or rad


class Events:
    """Writes what happens within the steps of a window."""

    def __init__(self, window: Window) -> None:
        self.window = window

    def directions(self) -> None:
        """Give moving joints without a direction the one of their motion; say which stops touch."""
        w = self.window
        code = w.code
        with code.count(w.nv) as k:
            v, s = w.speed(w.state, k).plain, w.signs[k]
            w.signs[k] = where(code.any_of(s.equals(0.0), s * v < 0), sign(v), s)
        with w.stops(w.state) as (stop, depth, _):
            touches = w.signs[stop]
            deep = where(depth.plain > SLIGHT, code.value(1.0), touches)
            w.signs[stop] = where(depth.plain < -SLIGHT, code.value(0.0), deep)

    def release(self) -> None:
        """Let joints go that need more than friction gives."""
        w = self.window
        code = w.code
        again = code.counter(1)
        with code.count(w.nv), code.when(code.equal(again.get(), 1)):
            again.set(0)
            with code.count(w.nv) as k:
                needed, stuck = w.holding[k].plain, w.stuck(k, w.levels)
                with code.when(code.all_of(stuck, abs(needed) > w.levels[k].plain)):
                    w.signs[k] = -sign(needed)
                    again.set(1)
            with code.when(code.equal(again.get(), 1)):
                w.rates_at(w.state, w.slope, w.holding, w.levels)

    def find_reversal(self, event: Any) -> None:
        """If a joint turns round or a stop is met, go to that moment instead."""
        w = self.window
        code = w.code
        first = code.scratch(1, plain=True)
        first[0] = 2.0
        with code.count(w.nv) as k:
            begin, end, s = w.speed(w.state, k).plain, w.speed(w.ahead, k).plain, w.signs[k]
            dry = w.levels.plain(k) > 0
            with code.when(code.all_of(dry, s * end < 0)):
                # The parabola through both speeds with the slope of the beginning.
                slope = w.slope[code.sum(w.nv, k)].plain * w.left.plain(0)
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
        with w.stops(w.ahead) as (stop, depth, rate):
            end = depth.plain
            with code.when(code.all_of(w.signs[stop].equals(0.0), end > 0)):
                at = 1.0 - end / (rate.plain * w.left.plain(0))
                at = where(code.all_of(at > 0, at <= 1), at, code.value(0.5))
                with code.when(at < first[0]):
                    first[0] = at
                    event.set(stop)
        found = event.get()
        with code.when(code.all_of(code.below(integer(-1), found), code.below(found, JOINTS))):
            self._reach(first[0], lambda: self._turning(found))
            w.ahead[code.sum(w.nv, found)] = 0.0
            w.signs[found] = 0.0
        with code.when(code.below(integer(JOINTS - 1), found)):
            self._reach(first[0], lambda: self._touching(found))
            w.signs[found] = 1.0

    def _turning(self, joint: ir.Value) -> tuple[Value, Value]:
        """Speed of a joint where the step has come to, and how fast it changes."""
        w = self.window
        return w.speed(w.ahead, joint), w.speed(w.rate, joint).plain

    def _touching(self, wanted: ir.Value) -> tuple[Value, Value]:
        """Depth in a stop where the step has come to, and how fast it changes."""
        w = self.window
        code = w.code
        out = code.scratch(2)
        with w.stops(w.ahead) as (stop, depth, rate), code.when(code.equal(stop, wanted)):
            out[0], out[1] = depth, rate
        return out[0], out[1].plain

    def _reach(self, share: Value, measure: Any) -> None:
        """Go to the moment at which a measure, as a number and its rate, is zero; `part` is the time that takes."""
        w = self.window
        code = w.code
        whole = code.scratch(1, plain=True)
        whole[0] = w.left.plain(0)
        gone = code.scratch(1, plain=True)
        gone[0] = share * whole[0]
        done = code.counter(0)
        with code.count(NEWTON) as k, code.when(code.equal(done.get(), 0)):
            w.go(w.state, w.slope, gone[0], w.ahead)
            now = w.time[0]
            w.time[0] = now + gone[0]
            w.rates_at(w.ahead, w.rate, w.after, w.after_levels)
            w.time[0] = now
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
        with code.count(w.nx) as k:
            w.ahead[k] = w.ahead[k] + late * w.rate[k].plain
        w.part[0] = gone[0] + late

    def find_release(self, event: Any) -> None:
        """If what holds a joint outgrows its friction, go to that moment instead."""
        w = self.window
        code = w.code
        any_stuck = code.counter(0)
        with code.count(w.nv) as k, code.when(w.stuck(k, w.levels)):
            any_stuck.set(1)
        with code.when(code.all_of(code.below(event.get(), 0), code.equal(any_stuck.get(), 1))):
            now = w.time[0]
            w.time[0] = now + w.left[0]
            w.rates_at(w.ahead, w.rate, w.after, w.after_levels)
            w.time[0] = now
            first = code.scratch(1)
            first[0] = 1.0
            with code.count(w.nv) as k:
                over = abs(w.after[k]) - w.after_levels[k]
                under = w.levels[k] - abs(w.holding[k])
                with code.when(code.all_of(w.stuck(k, w.levels), over > 0, under >= 0)):
                    share = under / (under + over)
                    with code.when(share < first[0].plain):
                        first[0] = share
                        event.set(k)
            with code.when(code.at.icmp_signed(">=", event.get(), integer(0))):
                w.part[0] = first[0] * w.left[0]
                step = code.scratch(1)
                step[0] = w.part[0]
                w.go(w.state, w.slope, step[0], w.ahead)
                w.part[0] = step[0]
                joint = event.get()
                w.signs[joint] = -sign(w.after[joint].plain)
