"""Limits of joints and tendons, and ties of joints, as code: MuJoCo's soft constraints.

A limit wants an acceleration by how deep it is in and how fast, and gets a share of it, its impedance, of which it has
the more the deeper it is (MuJoCo's documentation, "Solver parameters"). It never pulls; a tie, which holds two joints
in proportion, is deep in on either side, and does.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir

from dipc_gym.engine.code import Code, Numbers, integer
from dipc_gym.engine.forces import Attached, Each
from dipc_gym.engine.layout import JOINTS, Element, Head, Kind, Stop
from dipc_gym.engine.values import Value, maximum, minimum, where


class Stops:
    """Repeat for each stop: its index among directions, how deep the joints are in it, and how fast deeper."""

    def __init__(self, code: Code, program: ir.Value, numbers: Numbers, states: Numbers) -> None:
        self.code, self.numbers = code, numbers
        self.attached = Attached(code, program, numbers, numbers, states, code.value(0.0))
        self.number = code.counter()
        stops, elements = code.whole(program, Head.STOPS), code.whole(program, Head.ELEMENTS)
        count = code.at.select(code.below(integer(0), stops), elements, integer(0))
        self._each = Each(code, program, code.whole(program, Head.ELEMENT_AT), count, int(Element.SIZE))

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
    """How deep joints are in the nearer end of a limit's range, the way out (-1 or 1), and the speed along it."""
    code = attached.code
    length, speed = attached.reach(element, own.since(Stop.SIZE))
    over, under = length - own[Stop.HIGHEST], own[Stop.LOWEST] - length
    away = where(over > under, code.value(-1.0), code.value(1.0))
    return maximum(over, under), away, speed


def wanted(own: Numbers, depth: Value, outwards: Value) -> tuple[Value, Value]:
    """The acceleration outwards that a limit wants, and what its softness adds to the inverse inertia that it moves.

    Args:
        own: its parameters, see `layout.Stop`.
        depth: how deep it is in.
        outwards: speed.
    """
    share, middle = minimum(maximum(depth / own[Stop.WIDTH], 0.0), 1.0), own[Stop.MIDPOINT]
    rest = 1.0 - share
    bent = where(share > middle, 1.0 - rest * rest / (1.0 - middle), share * share / middle)
    grown = where(own[Stop.BENDS] > 0, bent, share)
    impedance = own[Stop.FIRST] + (own[Stop.LAST] - own[Stop.FIRST]) * grown
    acceleration = own[Stop.PULL] * impedance * depth - own[Stop.DRAG] * outwards
    return acceleration, (1.0 - impedance) / impedance * own[Stop.WEIGHT]
