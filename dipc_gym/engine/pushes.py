"""What limits that are met and ties push with, as code: each is to get its share of the acceleration that it wants."""

from __future__ import annotations

from typing import Any, Protocol

from llvmlite import ir

from dipc_gym.engine.code import Code, Index, Numbers, integer
from dipc_gym.engine.forces import Attached
from dipc_gym.engine.layout import JOINTS, STOPS, Element, Kind, Stop
from dipc_gym.engine.limits import depth_of, wanted
from dipc_gym.engine.values import Value, maximum, where

SETTLED = 1e-13  # of the largest push: a change that is none
TURNS = 3000  # at most: pushes settle, but nobody says how fast


class Moving(Protocol):
    """The motion that they push on, a `motion._Rates`.

    Attributes:
        code: to write into.
        numbers: parameters of the program.
        directions: of joints, then of each limit whether it is met.
        attached: what is attached to joints.
        n: joints.
        accelerations: of joints.
        total: forces on them.
    """

    code: Code
    numbers: Numbers
    directions: Numbers
    attached: Attached
    n: ir.Value
    accelerations: Numbers
    total: Numbers

    def stuck(self, k: Index) -> ir.Value:
        """Whether a joint sticks."""

    def backwards(self, numbers: Numbers) -> None:
        """Turn forces on joints into the accelerations that they make."""

    def solve(self, *, factorised: bool) -> None:
        """Set accelerations to those under the total forces."""


class Pushes:
    """Limits that are met and ties; of each by its number.

    Args:
        motion: that they push on.

    Attributes:
        number: of the one in turn.
        wants: acceleration outwards.
        softness: what it adds to the inverse inertia that it moves.
        outwards: direction, -1 or 1.
        gives: inverse inertia in that direction.
        pushes: force.
        changed: largest change of a push in a turn.
        largest: push.
        answers: accelerations of joints under a unit of each push.
    """

    def __init__(self, motion: Moving) -> None:
        self.motion, self.code = motion, motion.code
        code = self.code
        self.number = code.counter()
        self.wants, self.softness, self.pushes = (code.scratch(STOPS) for _ in range(3))
        self.outwards, self.gives = code.scratch(STOPS, plain=True), code.scratch(STOPS, plain=True)
        self.changed, self.largest = code.scratch(1, plain=True), code.scratch(1, plain=True)
        self.answers = code.scratch(STOPS * JOINTS, plain=True)

    def write(self, stops: ir.Value, ties: ir.Value) -> None:
        """Push back where limits are met and where joints are tied, by as much as MuJoCo's soft constraints do.

        Each pushes on what the others leave, in turns (Gauss and Seidel), until that does not change. Once that is so,
        their tangents are found in as many turns, by how what they want and what they get would come apart.
        """
        motion, code, met = self.motion, self.code, self.code.counter()
        met.set(ties)
        with code.count(stops) as k, code.when(motion.directions[code.sum(k, JOINTS)] > 0):
            met.set(code.sum(met.get(), 1))
        with code.when(code.below(integer(0), met.get())):
            self._lean()
            turns = code.counter()
            with code.repeat() as stop:
                self.changed[0], self.largest[0] = 0.0, 0.0
                self._take_turns(tangents=False)
                turns.set(code.sum(turns.get(), 1))
                settled = self.changed[0] <= SETTLED * self.largest[0]
                stop(code.any_of(settled, code.equal(met.get(), 1), code.equal(turns.get(), TURNS)))
            with self._met() as (k, element, coefficients):
                push = self.outwards[k] * self.pushes[k].plain
                motion.attached.push(element, coefficients, push, motion.total)
            motion.solve(factorised=True)
            if code.tangents:
                with code.count(turns.get()):
                    self._take_turns(tangents=True)

    def _lean(self) -> None:
        """Note what limits that are met and ties want, and how joints answer a push of each; nothing pushes yet."""
        motion, code, n = self.motion, self.code, self.motion.n
        with self._met() as (k, element, coefficients):
            own = motion.numbers.since(code.whole(element, Element.NUMBERS))
            depth, away, speed = depth_of(motion.attached, element, own)
            self.outwards[k] = away
            self.pushes[k] = 0.0
            self.wants[k], self.softness[k] = wanted(own, depth, away * speed)
            answer = self._answer(k)
            with code.count(n) as i:
                answer[i] = 0.0
            with motion.attached.terms(element) as (term, joint):
                free = where(motion.stuck(joint), code.value(0.0), coefficients.plain(term))
                answer[joint] = answer[joint] + free
            motion.backwards(answer)
            self.gives[k] = 0.0
            with motion.attached.terms(element) as (term, joint):
                self.gives[k] = self.gives[k] + coefficients.plain(term) * answer[joint]

    def _take_turns(self, *, tangents: bool) -> None:
        """Let each push as the others leave it, and joints follow; with tangents once pushes have settled, so that what
        does not push then has none.
        """
        motion, code, n = self.motion, self.code, self.motion.n

        def of(numbers: Numbers, index: Index) -> Value:
            return numbers[index] if tangents else numbers[index].plain

        with self._met() as (k, element, coefficients):
            out, answer, before = self.outwards[k].plain, self._answer(k), of(self.pushes, k)
            present = code.scratch(1)
            present[0] = 0.0
            with motion.attached.terms(element) as (term, joint):
                present[0] = present[0] + of(coefficients, term) * of(motion.accelerations, joint)
            missing = of(self.wants, k) - out * of(present, 0) - of(self.softness, k) * before
            push = before + missing / (self.gives[k].plain + self.softness[k].plain)
            pulls = code.equal(code.whole(element, Element.KIND), int(Kind.TIE))
            if tangents:
                push = where(code.any_of(pulls, before > 0), push, before)
            else:
                push = where(pulls, push, maximum(push, 0.0))
                self.changed[0] = maximum(self.changed[0], abs(push - before))
                self.largest[0] = maximum(self.largest[0], abs(push))
            self.pushes[k] = push
            more = out * (push - before)
            with code.count(n) as i:
                motion.accelerations[i] = of(motion.accelerations, i) + answer[i] * more
            if tangents:
                motion.attached.push(element, coefficients, more, motion.total)

    def _met(self) -> Any:
        """Repeat for each limit that is met and each tie: its number, its element and its coefficients."""
        return _Met(self)

    def _answer(self, k: ir.Value) -> Numbers:
        return self.answers.since(self.code.product(k, JOINTS))


class _Met:
    """See `Pushes._met`."""

    def __init__(self, pushes: Pushes) -> None:
        self.pushes, self._each = pushes, pushes.motion.attached.elements()

    def __enter__(self) -> tuple[ir.Value, ir.Value, Numbers]:
        motion, code, number = self.pushes.motion, self.pushes.code, self.pushes.number
        number.set(0)
        element = self._each.__enter__()
        kind = code.whole(element, Element.KIND)
        tied = code.equal(kind, int(Kind.TIE))
        self._is_one = code.when(code.any_of(tied, code.equal(kind, int(Kind.STOP))))
        self._is_one.__enter__()
        k = number.get()
        number.set(code.sum(k, 1))
        self._is_met = code.when(code.any_of(tied, motion.directions[code.sum(k, JOINTS)] > 0))
        self._is_met.__enter__()
        own = motion.numbers.since(code.whole(element, Element.NUMBERS))
        return k, element, own.since(Stop.SIZE)

    def __exit__(self, *what: Any) -> Any:
        self._is_met.__exit__(*what)
        self._is_one.__exit__(*what)
        return self._each.__exit__(*what)
