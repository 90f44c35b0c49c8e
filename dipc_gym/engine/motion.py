"""Rates of a program's states at one moment, as code: accelerations with joints that slide or stick, and hidden states.

A joint that slides feels dry friction as a force against its direction. One that sticks has no acceleration, and what
holds it is worked out beside: when that asks for more than friction gives, the joint lets go.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from llvmlite import ir

from dipc_gym.engine.code import Code, Index, Numbers, integer
from dipc_gym.engine.forces import Attached
from dipc_gym.engine.laws import Rule, laws
from dipc_gym.engine.layout import JOINTS, STATES, Head, Joint
from dipc_gym.engine.pushes import Pushes
from dipc_gym.engine.values import BIT, INT, LANES, POINTER, VECTOR, Number, Value, maximum, minimum, where
from dipc_gym.physics import Moment

FOLLOWED = 0.5  # time constant, in steps, that Runge-Kutta follows safely
# program, parameters (2), commands (2), directions, time (2), states (2), rates (2), holding (2), levels (2)
ARGUMENTS = [POINTER] * 16


def write_rates(module: ir.Module, rules: Sequence[Rule | None], *, tangents: bool, width: int = 0) -> ir.Function:
    """Write the function that sets rates, holding forces and levels of friction.

    Args:
        module: to write into.
        rules: what `<custom>` may add to joints; None in the place of one that no program of this module has.
        tangents: whether derivatives are worked out.
        width: 0, or how many simulations go side by side, without joints that stick and without stops; the forces of
            passive actuators then take the place of the holding forces.
    """
    code = Code(module, "rates", ARGUMENTS, tangents=tangents, internal=True, width=width)
    _Rates(code, rules).write()
    return code.finish()


class _Rates:
    def __init__(self, code: Code, rules: Sequence[Rule | None]) -> None:
        arguments = code.function.args
        self.code, self.rules = code, rules
        self.program = arguments[0]
        self.primal = code.external("primal", [POINTER] * 6)
        self.free, self.substitute = code.external("free", [POINTER] * 3), code.external("solve", [POINTER] * 2)
        if not code.width:
            self.bound = code.external("bound", [POINTER] * 4)
        if code.tangents:
            self.tangent = code.external("tangent", [POINTER] * 8)
            self.solve_tangents = code.external("solve_tangents", [POINTER] * 2)
        self.numbers = code.numbers(arguments[1], arguments[2])
        self.commands = code.numbers(arguments[3], arguments[4])
        self.directions = code.numbers(arguments[5])
        self.time = code.numbers(arguments[6], arguments[7])
        self.states = code.numbers(arguments[8], arguments[9])
        self.rates = code.numbers(arguments[10], arguments[11])
        self.holding = code.numbers(arguments[12], arguments[13])
        self.levels = code.numbers(arguments[14], arguments[15])
        self.n = code.whole(self.program, Head.JOINTS)
        self.speeds = self.states.since(self.n)
        self.accelerations = self.rates.since(self.n)
        self.forces, self.drives = code.scratch(JOINTS), code.scratch(JOINTS)
        self.passive = self.holding if code.width else code.scratch(JOINTS)
        self.bias = code.scratch(JOINTS)
        self.total = code.scratch(JOINTS)
        self.slope = code.scratch(JOINTS)
        self.matrix = code.scratch(JOINTS * JOINTS, plain=True)
        self.factor = code.scratch(JOINTS * JOINTS, plain=True)
        self.held, self.any_held = code.scratch(JOINTS, plain=True), code.counter()
        self.attached = Attached(code, self.program, self.numbers, self.commands, self.states, self.time[1].plain)

    def own(self, k: Index, what: Joint) -> Value:
        first = self.code.whole(self.program, Head.JOINT_NUMBERS)
        return self.numbers[self.code.sum(first, self.code.sum(self.code.product(k, int(Joint.SIZE)), int(what)))]

    def stuck(self, k: Index) -> ir.Value:
        code = self.code
        if code.width:
            return ir.Constant(BIT, 0)
        return code.all_of(self.directions[k].equals(0.0), self.levels.plain(k) > 0)

    def write(self) -> None:
        code, n = self.code, self.n
        with code.count(code.whole(self.program, Head.STATES)) as k:
            self.rates[k] = 0.0
        with code.count(n) as k:
            self.rates[k] = self.speeds[k]
        self.attached.on_joints(self.forces)
        self.attached.by_elements(self.forces, self.drives, self.rates, self.passive)
        with code.when(code.equal(code.whole(self.program, Head.BOUNDED), 1)), code.count(n) as k:
            driven = minimum(maximum(self.drives[k], self.own(k, Joint.WEAKEST)), self.own(k, Joint.STRONGEST))
            self.forces[k] = self.forces[k] + (driven - self.drives[k])
            self.drives[k] = driven
        joints = self.numbers.since(code.whole(self.program, Head.JOINT_NUMBERS))
        read = [self.states.place, self.speeds.place, self.numbers.place, joints.place]
        code.at.call(self.primal, [*read, self.matrix.place, self.bias.place])
        with code.count(n) as k:
            self.levels[k] = self.own(k, Joint.FRICTION)
        self._laws()
        with code.count(n) as k:
            if not code.width:
                slides = self.directions[k] * self.levels[k]
                self.forces[k] = self.forces[k] - where(self.stuck(k), code.value(0.0), code.value(slides))
            self.total[k] = self.forces[k]
        self.solve()
        if code.width:
            return
        stops, ties = (code.whole(self.program, head) for head in (Head.STOPS, Head.TIES))
        with code.when(code.below(integer(0), code.sum(stops, ties))):
            Pushes(self).write()
        self._hold()

    def _laws(self) -> None:
        code = self.code
        if not self.rules:
            return
        with code.when(code.below(ir.Constant(INT, 0), code.whole(self.program, Head.LAWS))):
            if code.tangents:
                with code.when(code.equal(code.whole(self.program, Head.WEIGHED), 1)):
                    still = code.scratch(JOINTS)
                    with code.count(self.n) as k:
                        still[k] = 0.0
                    self._kernel_tangent(still, self.bias.beside)

            def moment(joint: Index, inputs: Sequence[ir.Value], memory: ir.Value) -> Moment:
                values: Any = Moment  # made for arrays; values stand in for them
                return values(
                    speed=self.speeds[joint],
                    inputs=tuple(self._seen(one) for one in inputs),
                    time=self.time[0],
                    position=self.states[joint],
                    drive=self.drives[joint] - self.passive[joint],
                    weight=self.bias[joint],
                    value=code.value(0.0),
                    memory=self.states[code.at.select(code.below(memory, 0), integer(0), memory)],
                    slides=code.value(0.0) if code.width else abs(self.directions[joint]),
                )

            found = laws(code, self.program, self.numbers, self.rules, moment, self.rates)
            with found as (which, joint, says):
                for k, one in enumerate(self.rules):
                    if one is None:
                        continue
                    into = self.levels if one.dry else self.forces
                    with code.when(code.equal(which, k)):
                        into[joint] = says if one.dry else into[joint] + says

    def _seen(self, one: ir.Value) -> Value:
        """A state or a command that a law depends on."""
        code, found = self.code, self.code.scratch(1)
        with code.either(code.below(one, STATES)) as (state, command):
            with state:
                found[0] = self.states[one]
            with command:
                control = code.sum(one, -STATES)
                low = code.sum(code.whole(self.program, Head.RANGES), code.product(control, 2))
                least, most = self.numbers[low], self.numbers[code.sum(low, 1)]
                found[0] = minimum(maximum(self.commands[control], least), most)
        return found[0]

    def _kernel_tangent(self, accelerations: Numbers, out: ir.Value) -> None:
        states, speeds, numbers = self.states, self.speeds, self.numbers
        beside = [states.beside, speeds.beside, numbers.beside]
        arguments = [states.place, speeds.place, accelerations.place, numbers.place, *beside, out]
        self.code.at.call(self.tangent, arguments)

    def solve(self, *, factorised: bool = False) -> None:
        """Accelerations under `total`; with their tangents the change of the forces that they need, in `slope`.

        Rows of joints that stick are those of a unit matrix.
        """
        code, n, a, any_held = self.code, self.n, self.accelerations, self.any_held
        any_held.set(0)
        with code.count(n) as k:
            pull = self.total.plain(k) - self.bias.plain(k)
            stuck = self.stuck(k)
            a[k] = where(stuck, code.value(0.0), pull)
            if not code.width:
                self.held[k] = where(stuck, code.value(1.0), code.value(0.0))
                any_held.set(code.at.or_(any_held.get(), code.at.zext(stuck, INT)))
        if factorised:
            self.backwards(a)
        elif code.width:
            code.at.call(self.free, [self.matrix.place, a.place, self.factor.place])
        else:
            with code.either(code.equal(any_held.get(), 1)) as (some, none):
                with some:
                    code.at.call(self.bound, [self.matrix.place, self.held.place, a.place, self.factor.place])
                with none:
                    code.at.call(self.free, [self.matrix.place, a.place, self.factor.place])
        if not code.tangents:
            return
        self._kernel_tangent(a, self.slope.beside)
        with code.count(n) as k:
            self.slope.set_plain(k, 0.0)
            armature = self.own(k, Joint.ARMATURE) * a.plain(k)
            self.slope[k] = self.slope[k] + (armature - armature.plain)
            pull = self.total[k] - self.slope[k]
            a_tangent = where(self.stuck(k), code.value(0.0), pull)
            code.at.store(_tangent(a_tangent), code.offset(a.beside, k, VECTOR), align=8)
        code.at.call(self.solve_tangents, [self.factor.place, a.beside])

    def backwards(self, numbers: Numbers) -> None:
        """Solve with the factors, in place."""
        self.code.at.call(self.substitute, [self.factor.place, numbers.place])

    def _hold(self) -> None:
        """What friction has to give where joints stick."""
        code, n = self.code, self.n
        with code.count(n) as k:
            self.holding[k] = 0.0
            with code.when(self.stuck(k)):
                needed = code.scratch(1)
                needed[0] = self.bias.plain(k) - self.total[k] + self._slope(k)
                with code.count(n) as j:
                    first = code.at.select(code.below(j, k), k, j)
                    second = code.at.select(code.below(j, k), j, k)
                    entry = self.matrix[code.sum(code.product(first, n), second)]
                    needed[0] = needed[0] + entry * self.accelerations[j]
                self.holding[k] = needed[0]

    def _slope(self, k: Index) -> Number:
        return self.slope[k] if self.code.tangents else 0.0


def _tangent(value: Value) -> ir.Value:
    return value.tangent if value.tangent is not None else ir.Constant(VECTOR, [0.0] * LANES)
