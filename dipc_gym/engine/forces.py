"""Forces of what is attached to joints, as code: springs, dampers, motors and tendons, and what `<custom>` adds.

The formulas are MuJoCo's, with its hidden states (currents, temperatures, bristles) as the differential equations that
it steps, not as the steps.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from llvmlite import ir

from dipc_gym.engine.code import Code, Numbers, integer
from dipc_gym.engine.layout import JOINTS, Element, Feature, Force, Head, Joint, Kind, Law, Spring
from dipc_gym.engine.values import INT, POINTER, REAL, Value, exp, maximum, minimum, sin, where
from dipc_gym.physics import Moment

Says = Callable[[Any, Moment], Any]


@dataclass(frozen=True)
class Rule:
    """What `<custom>` may add to a joint.

    Attributes:
        effect: its id.
        says: a force, or a level of dry friction.
        dry: which of both.
        memory: rate of what it remembers; None for nothing.
    """

    effect: str
    says: Says
    dry: bool
    memory: Says | None = None


class Attached:
    """What is attached to the joints of a program.

    Args:
        code: to write into.
        program: address of its whole numbers.
        numbers: its parameters.
        commands: present commands.
        states: positions, velocities and hidden states.
        shortest: time constant that the step can follow, s; what is faster follows with this one.
    """

    def __init__(
        self, code: Code, program: ir.Value, numbers: Numbers, commands: Numbers, states: Numbers, shortest: Value
    ) -> None:
        self.code, self.program, self.numbers = code, program, numbers
        self.commands, self.states, self.shortest = commands, states, shortest
        self.joints = code.whole(program, Head.JOINTS)
        self.hidden = code.at.mul(self.joints, ir.Constant(INT, 2))

    def on_joints(self, forces: Numbers) -> None:
        """Set forces (n,) to those of the joints' own springs and dampers."""
        code = self.code
        first = code.whole(self.program, Head.JOINT_NUMBERS)
        with code.count(self.joints) as k:
            own = self.numbers.since(code.sum(first, code.product(k, int(Joint.SIZE))))
            q, v = self.states[k], self.states[code.sum(self.joints, k)]
            forces[k] = -(_pull(own, Joint.STIFFNESS, q - own[Joint.REST]) + _drag(own, Joint.DAMPING, v))

    def by_elements(self, forces: Numbers, drives: Numbers, rates: Numbers, passive: Numbers | None = None) -> None:
        """Add the forces of actuators and tendons, contacts left out.

        Args:
            forces: on joints, (n,).
            drives: those of actuators alone, (n,).
            rates: of the states; those of hidden ones are set.
            passive: those of actuators that take no command, (n,), where somebody asks for them.
        """
        code = self.code
        with code.count(self.joints) as k:
            drives[k] = 0.0
            if passive is not None:
                passive[k] = 0.0
        with self.elements() as element:
            kind = code.whole(element, Element.KIND)
            own = self.numbers.since(code.whole(element, Element.NUMBERS))
            with code.when(code.below(kind, int(Kind.SPRING))):
                length, speed = self.reach(element, own.since(Force.SIZE))
                force = self._actuator(element, kind, own, length, speed, rates)
                self.push(element, own.since(Force.SIZE), force, drives)
                self.push(element, own.since(Force.SIZE), force, forces)
                if passive is not None:
                    with code.when(code.below(code.whole(element, Element.CONTROL), 0)):
                        self.push(element, own.since(Force.SIZE), force, passive)
            with code.when(code.equal(kind, int(Kind.SPRING))):
                length, speed = self.reach(element, own.since(Spring.SIZE))
                over, under = length - own[Spring.HIGHEST], length - own[Spring.LOWEST]
                out = where(over > 0, over, where(under < 0, under, code.value(0.0)))
                pull = _pull(own, Spring.STIFFNESS, out) + _drag(own, Spring.DAMPING, speed)
                self.push(element, own.since(Spring.SIZE), -pull, forces)
            with code.when(code.equal(kind, int(Kind.YIELDING))):
                self._yield(element, own, forces, rates)

    def _yield(self, element: ir.Value, own: Numbers, forces: Numbers, rates: Numbers) -> None:
        """A spring bends so far and no further: where it is unbent then goes along, and stays where it was left.

        What a step takes it too far is put right as fast as the step can follow.
        """
        code = self.code
        place = code.sum(self.hidden, code.whole(element, Element.STATE))
        length, speed = self.reach(element, own.since(Spring.SIZE))
        bend, most = length - self.states[place], own[Spring.YIELD]
        held = minimum(maximum(bend, -most), most)
        along = where(bend > 0, maximum(speed, 0.0), minimum(speed, 0.0))
        rates[place] = where(abs(bend) < most, code.value(0.0), along + (bend - held) / self.shortest)
        pull = _pull(own, Spring.STIFFNESS, held) + _drag(own, Spring.DAMPING, speed)
        self.push(element, own.since(Spring.SIZE), -pull, forces)

    def elements(self) -> Any:
        """Repeat for the address of each element."""
        code = self.code
        first, size = code.whole(self.program, Head.ELEMENT_AT), int(Element.SIZE)
        return _Each(code, self.program, first, code.whole(self.program, Head.ELEMENTS), size)

    def reach(self, element: ir.Value, coefficients: Numbers) -> tuple[Value, Value]:
        """Length and speed of an element."""
        code, total = self.code, self.code.scratch(2)
        total[0], total[1] = 0.0, 0.0
        with self._terms(element) as (k, joint):
            total[0] = total[0] + coefficients[k] * self.states[joint]
            total[1] = total[1] + coefficients[k] * self.states[code.sum(self.joints, joint)]
        return total[0], total[1]

    def push(self, element: ir.Value, coefficients: Numbers, force: Value, forces: Numbers) -> None:
        """Add the force of an element to those of the joints it acts on."""
        with self._terms(element) as (k, joint):
            forces[joint] = forces[joint] + coefficients[k] * force

    def _terms(self, element: ir.Value) -> Any:
        return _Terms(self.code, self.program, element)

    def _actuator(
        self, element: ir.Value, kind: ir.Value, own: Numbers, length: Value, speed: Value, rates: Numbers
    ) -> Value:
        """Force of an actuator; rates of its states are set."""
        code = self.code
        control, state = code.whole(element, Element.CONTROL), code.whole(element, Element.STATE)
        slots = code.scratch(2)  # what acts, and the force
        slots[0] = 0.0
        with code.when(code.at.icmp_signed(">=", control, ir.Constant(INT, 0))):
            command = self.commands[control]
            slots[0] = minimum(maximum(command, own[Force.LOWEST_COMMAND]), own[Force.HIGHEST_COMMAND])
        place = code.sum(self.hidden, state)
        with code.either(code.equal(kind, int(Kind.MOTOR))) as (motor, other):
            with motor:
                slots[1] = self._motor(element, own, slots[0], length, speed, place, rates)
            with other:
                with code.when(code.equal(kind, int(Kind.FILTERED))):
                    rates[place] = (slots[0] - self.states[place]) / maximum(own[Force.TIME], self.shortest)
                    slots[0] = self.states[place]
                with code.when(code.equal(kind, int(Kind.INTEGRATED))):
                    rates[place] = slots[0]
                    slots[0] = self.states[place]
                gain = own[Force.GAIN] + own[Force.GAIN + 1] * length + own[Force.GAIN + 2] * speed
                bias = own[Force.BIAS] + own[Force.BIAS + 1] * length + own[Force.BIAS + 2] * speed
                slots[1] = minimum(maximum(gain * slots[0] + bias, own[Force.LOWEST]), own[Force.HIGHEST])
        return slots[1]

    def _motor(
        self,
        element: ir.Value,
        own: Numbers,
        volts: Value,
        length: Value,
        speed: Value,
        place: ir.Value,
        rates: Numbers,
    ) -> Value:
        """Torque of a DC motor; its states are temperature, bristles' bend and current, those of them that it has."""
        code = self.code
        features = code.whole(element, Element.FEATURES)
        constant = own[Force.GAIN + 1]
        slots = code.scratch(3)  # resistance, current, torque
        at = code.counter()
        at.set(place)
        slots[0] = own[Force.GAIN]
        hot, bends = code.counter(-1), code.counter(-1)
        with code.when(_has(code, features, Feature.HEAT)):
            hot.set(at.get())
            warmer = self.states[at.get()] + own[Force.BIAS + 1] - own[Force.BIAS]
            slots[0] = own[Force.GAIN] * (1.0 + own[Force.GAIN + 2] * warmer)
            at.set(code.sum(at.get(), 1))
        with code.when(_has(code, features, Feature.BRISTLES)):
            bends.set(at.get())
            at.set(code.sum(at.get(), 1))
        slots[1] = (volts - constant * speed) / slots[0]
        with code.when(_has(code, features, Feature.WINDING)):
            current = self.states[at.get()]
            rates[at.get()] = (slots[1] - current) / maximum(own[Force.TIME], self.shortest)
            slots[1] = current
        slots[2] = minimum(maximum(constant * slots[1], own[Force.LOWEST]), own[Force.HIGHEST])
        with code.when(_has(code, features, Feature.HEAT)):
            power = slots[1] * slots[1] * slots[0]
            rates[hot.get()] = (power - self.states[hot.get()] / own[Force.HEAT]) / own[Force.HEAT + 1]
        with code.when(_has(code, features, Feature.COGS)):
            slots[2] = slots[2] + own[Force.COGS] * sin(own[Force.COGS + 1] * length + own[Force.COGS + 2])
        with code.when(_has(code, features, Feature.BRISTLES)):
            coulomb, static, stribeck, stiffness, damping = (own[Force.BRISTLES + k] for k in range(5))
            bend, ratio = self.states[bends.get()], speed / stribeck
            level = coulomb + (static - coulomb) * exp(-(ratio * ratio))
            fade = stiffness * abs(speed) / level
            settled = where(speed < 0, -level, level) / stiffness
            slow = fade * self.shortest < 1
            rate = where(slow, speed - fade * bend, (settled - bend) / self.shortest)
            rates[bends.get()] = rate
            slots[2] = slots[2] - (stiffness * bend + damping * rate)
        return slots[2]


def laws(
    code: Code,
    program: ir.Value,
    numbers: Numbers,
    rules: Sequence[Rule | None],
    moment: Callable[..., Moment],
    rates: Numbers,
) -> Any:
    """Repeat for what `<custom>` adds to joints: index of the rule, the joint, and what the rule says of this moment.

    Args:
        code: to write into.
        program: address of its whole numbers.
        numbers: its parameters.
        rules: in the order of their indices; None for one that does not occur.
        moment: what a rule may look at, by joint, by what else the law depends on, and by the state that it remembers.
        rates: of the states; those of what laws remember are set.
    """
    return _Laws(code, program, numbers, rules, moment, rates)


class Table:
    """Numbers of a rule as it reads them: `data[..., k]` and `data[..., k:]`."""

    def __init__(self, code: Code, numbers: Numbers, count: ir.Value) -> None:
        self.code, self.numbers, self.count = code, numbers, count

    def __getitem__(self, index: Any) -> Any:
        _, k = index
        if isinstance(k, slice):
            start = int(k.start or 0)
            return Table(self.code, self.numbers.since(start), self.code.sum(self.count, -start))
        return self.numbers[k]

    def at(self, share: Value) -> Value:
        """The table at a share of its length, straight lines between; beyond its ends it goes on as it ends."""
        code = self.code
        if code.width:
            return self._at_lanes(share)
        last = code.at.sitofp(code.sum(self.count, -1), share.primal.type)
        along = share * Value(code, last)
        inside = minimum(maximum(along, 0.0), Value(code, last))
        below = inside.floor()
        top = code.sum(self.count, -2)
        below = code.at.select(code.below(top, below), top, below)
        share = inside - Value(code, code.at.sitofp(below, along.primal.type))
        one, other = self.numbers[below], self.numbers[code.sum(below, 1)]
        return one + share * (other - one)

    def _at_lanes(self, share: Value) -> Value:
        """The same where each lane may lie between other knots: every stretch adds as much of its rise as is passed."""
        code = self.code
        last, total, passed = code.sum(self.count, -1), code.scratch(1), code.scratch(1)
        along = share * Value(code, code.splat(code.at.sitofp(last, REAL)))
        total[0], passed[0] = self.numbers[0], 0.0
        with code.count(self.count, 1) as k:
            part = minimum(maximum(along - passed[0], 0.0), 1.0)
            total[0] = total[0] + part * (self.numbers[k] - self.numbers[code.sum(k, -1)])
            passed[0] = passed[0] + 1.0
        return total[0]

    def across(self, rows: Value, columns: Value, x: Value, y: Value) -> Value:
        """A table with rows of columns, straight lines between: its knots along both, then its levels."""
        code = self.code
        m, n = self._whole(rows), self._whole(columns)
        if code.width:
            return self._across_lanes(m, n, x, y)
        low, high, up = self._between(self.numbers, m, x)
        left, right, along = self._between(self.numbers.since(m), n, y)
        levels, found = self.numbers.since(code.sum(m, n)), []
        for k in (low, high):
            row = code.product(k, n)
            one, other = (levels[code.sum(row, c)] for c in (left, right))
            found.append(one + along * (other - one))
        return found[0] + up * (found[1] - found[0])

    def _whole(self, number: Value) -> ir.Value:
        """A count, which is the same in all lanes."""
        code = self.code
        if not code.width:
            return number.floor()
        return code.at.fptosi(code.at.extract_element(number.primal, ir.Constant(ir.IntType(32), 0)), INT)

    def _across_lanes(self, m: ir.Value, n: ir.Value, x: Value, y: Value) -> Value:
        """The same where each lane may lie between other knots: every stretch adds as much of its rise as is passed."""
        code = self.code
        below, beside, levels = self.numbers, self.numbers.since(m), self.numbers.since(code.sum(m, n))
        total, row, before = (code.scratch(1) for _ in range(3))
        total[0], before[0] = 0.0, 0.0
        with code.count(m) as i:
            along = levels.since(code.product(i, n))
            row[0] = along[0]
            with code.count(n, 1) as j:
                k = code.sum(j, -1)
                share = minimum(maximum((y - beside[k]) / (beside[j] - beside[k]), 0.0), 1.0)
                row[0] = row[0] + share * (along[j] - along[k])
            first = code.equal(i, 0)
            k = code.at.select(first, integer(0), code.sum(i, -1))
            span = where(first, code.value(1.0), below[i] - below[k])
            share = minimum(maximum((x - below[k]) / span, 0.0), 1.0)
            total[0] = where(first, row[0], total[0] + share * (row[0] - before[0]))
            before[0] = row[0]
        return total[0]

    def _between(self, knots: Numbers, count: ir.Value, x: Value) -> tuple[ir.Value, ir.Value, Value]:
        """Entries below and above a number among knots, and how far between them it is."""
        code, below = self.code, self.code.counter()
        below.set(integer(0))
        last = code.sum(count, -1)
        with code.count(last, 1) as k, code.when(x >= knots[k]):
            below.set(code.sum(below.get(), 1))
        under, several = below.get(), code.below(integer(0), last)
        above = code.at.select(several, code.sum(under, 1), under)
        span = where(several, knots[above] - knots[under], code.value(1.0))
        return under, above, minimum(maximum((x - knots[under]) / span, 0.0), 1.0)


class Stops:
    """Repeat for each stop: its index among directions, how deep the joints are in it, and how fast deeper."""

    def __init__(self, code: Code, program: ir.Value, numbers: Numbers, states: Numbers) -> None:
        self.code, self.numbers = code, numbers
        self.attached = Attached(code, program, numbers, numbers, states, code.value(0.0))
        self.number = code.counter()
        stops, elements = code.whole(program, Head.STOPS), code.whole(program, Head.ELEMENTS)
        count = code.at.select(code.below(integer(0), stops), elements, integer(0))
        self._each = _Each(code, program, code.whole(program, Head.ELEMENT_AT), count, int(Element.SIZE))

    def __enter__(self) -> tuple[ir.Value, Value, Value]:
        code = self.code
        self.number.set(JOINTS)
        element = self._each.__enter__()
        self._when = code.when(code.equal(code.whole(element, Element.KIND), int(Kind.STOP)))
        self._when.__enter__()
        own = self.numbers.since(code.whole(element, Element.NUMBERS))
        depth, away, speed = depth_of(self.attached, element, own)
        stop = self.number.get()
        self.number.set(code.sum(stop, 1))
        return stop, depth, -(away * speed)

    def __exit__(self, *what: Any) -> Any:
        self._when.__exit__(*what)
        return self._each.__exit__(*what)


def depth_of(attached: Attached, element: ir.Value, own: Numbers) -> tuple[Value, Value, Value]:
    """How deep joints are in the nearer end of a tendon's range, the way out (-1 or 1), and the tendon's speed."""
    code = attached.code
    length, speed = attached.reach(element, own.since(Spring.SIZE))
    over, under = length - own[Spring.HIGHEST], own[Spring.LOWEST] - length
    away = where(over > under, code.value(-1.0), code.value(1.0))
    return maximum(over, under), away, speed


@functools.cache
def written(rule: Says, width: int = 0) -> bool:
    """Whether a law becomes code as it stands, for one simulation or for `width` side by side.

    One that a user registered may do anything.
    """
    code = Code(ir.Module(), "law", [POINTER, INT], tangents=not width, width=width)
    numbers, count = code.function.args
    now: Any = Moment
    try:
        names = ("time", "position", "drive", "weight", "value", "speed", "memory")
        of = now(**{name: code.value(0.0) for name in names}, inputs=(code.value(0.0), code.value(0.0)))
        code.value(rule(Table(code, Numbers(code, numbers, numbers), count), of))
    except Exception:  # whatever a law of somebody's does with numbers that are none yet
        return False
    return True


class _Each:
    """Addresses of entries of equal size, one after the other."""

    def __init__(self, code: Code, program: ir.Value, first: ir.Value, count: ir.Value, size: int) -> None:
        self.code, self.program, self.first, self.size = code, program, first, size
        self._loop = code.count(count)

    def __enter__(self) -> ir.Value:
        k = self._loop.__enter__()
        return self.code.offset(self.program, self.code.sum(self.first, self.code.product(k, self.size)), INT)

    def __exit__(self, *what: Any) -> Any:
        return self._loop.__exit__(*what)


class _Terms:
    def __init__(self, code: Code, program: ir.Value, element: ir.Value) -> None:
        self.code, self.program = code, program
        self.first = code.whole(element, Element.TERM_AT)
        self._loop = code.count(code.whole(element, Element.TERMS))

    def __enter__(self) -> tuple[ir.Value, ir.Value]:
        k = self._loop.__enter__()
        return k, self.code.whole(self.program, self.code.sum(self.first, k))

    def __exit__(self, *what: Any) -> Any:
        return self._loop.__exit__(*what)


class _Laws:
    def __init__(
        self, code: Code, program: ir.Value, numbers: Numbers, rules: Sequence[Rule | None], moment: Any, rates: Numbers
    ) -> None:
        self.code, self.numbers, self.rules, self.moment, self.rates = code, numbers, rules, moment, rates
        first, count = code.whole(program, Head.LAW_AT), code.whole(program, Head.LAWS)
        self._each = _Each(code, program, first, count, int(Law.SIZE))

    def __enter__(self) -> tuple[ir.Value, ir.Value, Value]:
        code, law = self.code, self._each.__enter__()
        which, joint = code.whole(law, Law.RULE), code.whole(law, Law.JOINT)
        own = self.numbers.since(code.whole(law, Law.NUMBERS))
        table, said = Table(code, own, code.whole(law, Law.COUNT)), code.scratch(1)
        said[0] = 0.0
        state = code.whole(law, Law.STATE)
        now = self.moment(joint, [code.whole(law, part) for part in (Law.FIRST, Law.SECOND)], state)
        for k, rule in enumerate(self.rules):
            if rule is not None:
                with code.when(code.equal(which, k)):
                    said[0] = rule.says(table, now)
                    if rule.memory is not None:
                        self.rates[state] = rule.memory(table, now)
        return which, joint, said[0]

    def __exit__(self, *what: Any) -> Any:
        return self._each.__exit__(*what)


def _has(code: Code, features: ir.Value, feature: Feature) -> ir.Value:
    return code.at.icmp_signed("!=", code.at.and_(features, ir.Constant(INT, int(feature))), ir.Constant(INT, 0))


def _pull(own: Numbers, first: int, x: Value) -> Value:
    """Of a spring: a x + b x^2 + c x^3."""
    return x * (own[first] + x * (own[first + 1] + x * own[first + 2]))


def _drag(own: Numbers, first: int, v: Value) -> Value:
    """Of a damper: a v + b v |v| + c v^3."""
    return v * (own[first] + abs(v) * (own[first + 1] + abs(v) * own[first + 2]))
