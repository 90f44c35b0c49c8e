"""Forces of what is attached to joints, as code: springs, dampers, motors and tendons.

The formulas are MuJoCo's, with its hidden states (currents, temperatures, bristles) as the differential equations that
it steps, not as the steps.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir

from dipc_gym.engine.code import Code, Numbers
from dipc_gym.engine.layout import Element, Feature, Force, Head, Joint, Kind, Ramp, Spring
from dipc_gym.engine.values import INT, Value, exp, maximum, minimum, sin, where


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

    def by_elements(self, forces: Numbers, drives: Numbers, rates: Numbers, passive: Numbers) -> None:
        """Add the forces of actuators and tendons, contacts left out.

        Args:
            forces: on joints, (n,).
            drives: those of actuators alone, (n,).
            rates: of the states; those of hidden ones are set.
            passive: those of actuators that nobody commands, (n,).
        """
        code = self.code
        with code.count(self.joints) as k:
            drives[k], passive[k] = 0.0, 0.0
        with self.elements() as element:
            kind = code.whole(element, Element.KIND)
            own = self.numbers.since(code.whole(element, Element.NUMBERS))
            with code.when(code.below(kind, int(Kind.SPRING))):
                length, speed = self.reach(element, own.since(Force.SIZE))
                force = self._actuator(element, kind, own, length, speed, rates)
                self.push(element, own.since(Force.SIZE), force, drives)
                self.push(element, own.since(Force.SIZE), force, forces)
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
            with code.when(code.equal(kind, int(Kind.RAMPS))):
                force = self._ramps(element, own)
                for into in (drives, forces, passive):
                    self.push(element, own, force, into)

    def _ramps(self, element: ir.Value, own: Numbers) -> Value:
        """Sum of forces that rise along a stretch: a law over position or speed has one for each of its stretches."""
        code, total = self.code, self.code.scratch(1)
        length, speed = self.reach(element, own)
        ramps = own.since(1)
        total[0] = 0.0
        with code.count(code.whole(element, Element.FEATURES)) as k:
            ramp = ramps.since(code.product(k, int(Ramp.SIZE)))
            rises = ramp[Ramp.BIAS] + ramp[Ramp.BIAS + 1] * length + ramp[Ramp.BIAS + 2] * speed
            total[0] = total[0] + minimum(maximum(rises, ramp[Ramp.LOWEST]), ramp[Ramp.HIGHEST])
        return total[0]

    def _yield(self, element: ir.Value, own: Numbers, forces: Numbers, rates: Numbers) -> None:
        """A spring bends so far and no further: where it is unbent then goes along, and stays where it was left.

        It follows as fast as the step can, so that it is bent a little too far for as long as it is dragged, which no
        force shows; a rate that jumped where it yields would chatter there.
        """
        code = self.code
        place = code.sum(self.hidden, code.whole(element, Element.STATE))
        length, speed = self.reach(element, own.since(Spring.SIZE))
        bend, most = length - self.states[place], own[Spring.YIELD]
        held = minimum(maximum(bend, -most), most)
        rates[place] = (bend - held) / self.shortest
        pull = _pull(own, Spring.STIFFNESS, held) + _drag(own, Spring.DAMPING, speed)
        self.push(element, own.since(Spring.SIZE), -pull, forces)

    def elements(self) -> Any:
        """Repeat for the address of each element."""
        code = self.code
        first, size = code.whole(self.program, Head.ELEMENT_AT), int(Element.SIZE)
        return Each(code, self.program, first, code.whole(self.program, Head.ELEMENTS), size)

    def reach(self, element: ir.Value, coefficients: Numbers) -> tuple[Value, Value]:
        """Length and speed of an element."""
        code, total = self.code, self.code.scratch(2)
        total[0], total[1] = 0.0, 0.0
        with self.terms(element) as (k, joint):
            total[0] = total[0] + coefficients[k] * self.states[joint]
            total[1] = total[1] + coefficients[k] * self.states[code.sum(self.joints, joint)]
        return total[0], total[1]

    def push(self, element: ir.Value, coefficients: Numbers, force: Value, forces: Numbers) -> None:
        """Add the force of an element to those of the joints it acts on."""
        with self.terms(element) as (k, joint):
            forces[joint] = forces[joint] + coefficients[k] * force

    def terms(self, element: ir.Value) -> Any:
        """Repeat for each joint that an element acts on: the number of its coefficient, and the joint."""
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
            bend = self.states[bends.get()]
            falls = stribeck > 0  # MuJoCo's compiler puts 0 where a file gives no Stribeck speed
            ratio = speed / where(falls, stribeck, code.value(1.0))
            level = coulomb + where(falls, (static - coulomb) * exp(-(ratio * ratio)), code.value(0.0))
            fade = stiffness * abs(speed) / level
            settled = where(speed < 0, -level, level) / stiffness
            slow = fade * self.shortest < 1
            rate = where(slow, speed - fade * bend, (settled - bend) / self.shortest)
            rates[bends.get()] = rate
            slots[2] = slots[2] - (stiffness * bend + damping * rate)
        return slots[2]


class Each:
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


def _has(code: Code, features: ir.Value, feature: Feature) -> ir.Value:
    return code.at.icmp_signed("!=", code.at.and_(features, ir.Constant(INT, int(feature))), ir.Constant(INT, 0))


def _pull(own: Numbers, first: int, x: Value) -> Value:
    """Of a spring: a x + b x^2 + c x^3."""
    return x * (own[first] + x * (own[first + 1] + x * own[first + 2]))


def _drag(own: Numbers, first: int, v: Value) -> Value:
    """Of a damper: a v + b v |v| + c v^3."""
    return v * (own[first] + abs(v) * (own[first + 1] + abs(v) * own[first + 2]))
