"""The parts of a control loop as programs: each writes its own formula, and the loop ties them together."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from dipc_gym.compensators import Compensator
from dipc_gym.controllers import Controller
from dipc_gym.dataflow import NoForm, Program, Value

Array = NDArray[np.float64]

LARGEST_READING = 1e3
"""Of an encoder that works, m or rad; beyond it, a reading counts as broken."""
LARGEST_NUMBER = 1e36
"""In the memory and of a voltage before it is limited; beyond it, single precision is at its end."""
READINGS = ("cart", "pole1", "pole2")
STATE = 6
"""Entries of an observation."""


class Estimator(Protocol):
    """What the export asks of an estimator.

    Controllers have `express(program, observation)`, which returns the force in N for an observation (6,);
    compensators have `express(program, force, velocity)`, which returns the voltage, and `friction` besides where they
    feed forward what an estimator observes. What a part remembers, it keeps in states of the program.
    """

    def express(self, program: Program, readings: Value, voltage: Value, force: Value) -> Value:
        """What is seen now: the observation (6,), and friction in N as a seventh entry where it is observed.

        Args:
            program: what is written.
            readings: (3,) of cart and absolute angles.
            voltage: of the last period, V; 0 in the first.
            force: that was wanted then, N.
        """


@dataclass(frozen=True)
class Loop:
    """Encoder readings in, motor voltage out: all that runs on the rig once a control period.

    A reading that is not a number, or larger than 1000 m or rad, makes this period's voltage 0, and the estimate goes
    on with what velocities foretold, as in Python; before the first good one, nothing changes. A memory that is no
    longer finite is reset. The force is limited as by `ForceCommand`, the voltage by
    the supply; a voltage that is not a number is 0.

    Attributes:
        estimator: makes the observation.
        controller: commands force.
        compensator: turns it into voltage.
        force_limit: largest force either way, N.
        supply: largest voltage either way, V.
        period: from one call to the next, s.

    Raises:
        NoForm: from `program`, if a part has no such form; the message says which.
    """

    estimator: Estimator
    controller: Controller
    compensator: Compensator
    force_limit: float
    supply: float
    period: float

    def program(self) -> Program:
        """The loop as a program with inputs `cart`, `pole1`, `pole2` (relative to the first) and output `voltage`.

        Raises:
            NoForm: a part cannot be written as a program.
        """
        program = Program()
        cart, pole1, pole2 = (program.input(name) for name in READINGS)
        usable = cart.within(LARGEST_READING) * pole1.within(LARGEST_READING) * pole2.within(LARGEST_READING)
        voltage, wanted = program.state("voltage", 0.0), program.state("force", 0.0)

        program.comment("estimator")
        before, begun = program.state("seen", np.zeros(STATE)), program.state("begun", 0.0)
        foretold = (before.part(0, 3) + self.period * before.part(3, 3)).clip(-LARGEST_READING, LARGEST_READING)
        readings = usable.choose(program.join(cart, pole1, pole1 + pole2), foretold)
        seen = _expressed("estimator", self.estimator, program, readings, voltage, wanted)
        observation = seen.part(0, STATE)
        known = usable.choose(1.0, begun)
        program.update(before, observation)
        program.update(begun, known)
        program.comment("controller")
        force = _expressed("controller", self.controller, program, observation)
        sound = usable * force.within(LARGEST_NUMBER)
        force = force.clip(-self.force_limit, self.force_limit)
        program.comment("compensator")
        observed = {}
        if self.compensator.observed_friction:
            if seen.size == STATE:
                raise NoForm(f"the compensator {self.compensator.name!r} feeds forward the friction that an estimator "
                             "observes, and this one observes none: export it with --estimator")  # fmt: skip
            observed["friction"] = seen.part(STATE)
        volts = _expressed("compensator", self.compensator, program, force, observation.part(3), **observed)

        program.comment("supply, and readings that cannot be")
        sound = sound * volts.within(LARGEST_NUMBER)
        limited = sound.choose(volts.clip(-self.supply, self.supply), 0.0)
        program.update(voltage, limited)
        program.update(wanted, sound.choose(force, 0.0))
        self._guard(program, known)
        program.output("voltage", limited)
        return program

    def _guard(self, program: Program, known: Value) -> None:
        """Keep the memory until a reading is good, and reset it where it is not finite."""
        values = {place: Value(program, place, step.size) for place, step in enumerate(program.steps)}
        ahead = [(values[state], values[value]) for state, value in program.updates.items()]
        moving = [value for _, value in ahead if program.steps[value.place].operation != "constant"]
        finite = program.join(*moving).within(LARGEST_NUMBER).least()
        for state, value in ahead:
            reset = program.constant(program.steps[state.place].numbers)
            program.update(state, known.choose(finite.choose(value, reset), state))


def _expressed(role: str, part: Any, program: Program, *arguments: Value, **known: Value) -> Value:
    """What a part writes into the program.

    Raises:
        NoForm: it cannot.
    """
    name = getattr(part, "name", "") or type(part).__name__
    express = getattr(part, "express", None)
    if express is None:
        raise NoForm(f"the {role} {name!r} ({type(part).__name__}) has no form that can be exported")
    try:
        value = express(program, *arguments, **known)
    except (NoForm, TypeError, AttributeError) as problem:  # the latter where NumPy finds no such function
        raise NoForm(f"the {role} {name!r} has no form that can be exported: {problem}") from None
    if not isinstance(value, Value):
        raise NoForm(f"the {role} {name!r} has no form that can be exported: its formula leaves the program")
    return value
