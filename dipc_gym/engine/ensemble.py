"""Simulations of one structure side by side, as code: a vector instruction does the same for all of them.

They have numbers and states of their own, and one rhythm: Runge-Kutta's fourth order with equal steps, commands held
over each. There are no events, so nothing may stick or meet a stop; forces of `<custom>` act. The structure stands in
the code, where LLVM unrolls the loops over it; a new structure compiles anew, new numbers do not.
"""

from __future__ import annotations

from collections.abc import Sequence

from llvmlite import ir

from dipc_gym.engine.code import Code, Numbers
from dipc_gym.engine.kernel import write_primal, write_solver
from dipc_gym.engine.laws import written
from dipc_gym.engine.layout import JOINTS, STATES, Head, Joint, Law
from dipc_gym.engine.motion import FOLLOWED, write_rates
from dipc_gym.engine.program import Array, Program, rules
from dipc_gym.engine.rigid import Tree
from dipc_gym.engine.uncovered import Uncovered
from dipc_gym.engine.values import INT, POINTER, Value, where

WIDTH = 8  # simulations side by side; processors with shorter vectors take them in parts


def require(program: Program, parameters: Array) -> None:
    """Refuse a program that needs events.

    Args:
        program: of the model.
        parameters: (k,).

    Raises:
        Uncovered: something in it sticks, meets a stop, or is a law that does more than arithmetic on many numbers.
    """
    codes, known = program.codes, rules()
    for rule in (known[k] for k in _laws(codes.tolist())):
        if rule.dry or not all(written(one, WIDTH) for one in (rule.says, rule.memory) if one):
            raise Uncovered(f"the law of {rule.effect} under <custom>")
    first = int(codes[Head.JOINT_NUMBERS])
    friction = parameters[first + Joint.FRICTION : first + int(codes[Head.JOINTS]) * Joint.SIZE : Joint.SIZE]
    for what, there in (
        ("a joint with frictionloss", bool(friction.any())),
        ("a limit", bool(codes[Head.STOPS])),
        ("an equality constraint", bool(codes[Head.TIES])),
    ):
        if there:
            raise Uncovered(what)


def _laws(codes: Sequence[int]) -> set[int]:
    """Which of the laws of `<custom>` a program has."""
    first, count, size = int(codes[Head.LAW_AT]), int(codes[Head.LAWS]), int(Law.SIZE)
    return {int(codes[first + k * size + Law.RULE]) for k in range(count)}


class Ensemble:
    """The rates of a program, written into a module, and what uses them.

    Args:
        module: to write into.
        tree: of the program.
        codes: whole numbers of the program.
    """

    def __init__(self, module: ir.Module, tree: Tree, codes: Sequence[int]) -> None:
        write_primal(module, tree, width=WIDTH)
        write_solver(module, tree, width=WIDTH)
        used = _laws(codes)
        laws = [rule if k in used else None for k, rule in enumerate(rules())]
        self.rates = write_rates(module, laws if used else [], tangents=False, width=WIDTH)
        kind = ir.ArrayType(INT, len(codes))
        self.program = ir.GlobalVariable(module, kind, "program")
        self.program.global_constant, self.program.linkage = True, "internal"
        self.program.initializer = ir.Constant(kind, list(codes))
        self.codes, self.nx = codes, codes[Head.STATES]
        self._probe(module)

    def _probe(self, module: ir.Module) -> None:
        """Write `probe(parameters, commands, time, states, shortest, rates, passive)`."""
        code = Code(module, "probe", [POINTER] * 7, width=WIDTH)
        parameters, commands, time, states, shortest, rates, passive = (code.numbers(a) for a in code.function.args)
        Stepper(self, code, parameters, commands).rates(time[0], states, shortest[0], rates, passive)
        code.finish()


class Stepper:
    """Writes steps of a few simulations into a function.

    Args:
        ensemble: of the same module.
        code: to write into.
        parameters: of the program.
        commands: that act; read at each step.
    """

    def __init__(self, ensemble: Ensemble, code: Code, parameters: Numbers, commands: Numbers) -> None:
        self.ensemble, self.code = ensemble, code
        self.parameters, self.commands = parameters, commands
        self.clock, self.levels = code.scratch(2), code.scratch(JOINTS)
        self.here, self.rate, self.total = (code.scratch(STATES) for _ in range(3))
        self.passive = code.scratch(JOINTS)

    def rates(self, time: Value, states: Numbers, shortest: Value, rates: Numbers, passive: Numbers) -> None:
        """Set rates of states at a time, and forces of actuators without a command on joints (n,)."""
        none = ir.Constant(POINTER, None)
        self.clock[0], self.clock[1] = time, shortest
        arguments = [self.ensemble.program, self.parameters.place, none, self.commands.place, none, none]
        for numbers in (self.clock, states, rates, passive, self.levels):
            arguments += [numbers.place, none]
        self.code.at.call(self.ensemble.rates, arguments)

    def step(self, time: Value, states: Numbers, length: Value, passive: Numbers) -> None:
        """Advance states in place, from a time on; `passive` gets what acted at the beginning."""
        code, n = self.code, self.ensemble.nx
        here, rate, total = self.here, self.rate, self.total
        now = code.scratch(1)
        now[0] = time
        for k in range(n):
            here[k], total[k] = states[k], 0.0
        with code.count(4) as stage:
            self.rates(now[0], here, length * FOLLOWED, rate, self.passive)
            with code.when(code.equal(stage, 0)), code.count(code.whole(self.ensemble.program, Head.JOINTS)) as k:
                passive[k] = self.passive[k]
            # The next stage is at a half, a half, and the end; weights 1, 2, 2, 1.
            share = where(code.equal(stage, 2), code.value(1.0), code.value(0.5)) * length
            outer = code.any_of(code.equal(stage, 0), code.equal(stage, 3))
            now[0] = time + share
            weight = where(outer, code.value(1 / 6), code.value(1 / 3)) * length
            for k in range(n):
                total[k] = total[k] + weight * rate[k]
                here[k] = states[k] + share * rate[k]
        for k in range(n):
            states[k] = states[k] + total[k]
