"""What limits that are met and ties push with, as code: each is to get its share of the acceleration that it wants."""

from __future__ import annotations

from typing import Protocol

from llvmlite import ir

from dipc_gym.engine.code import Code, Counter, Index, Numbers, integer
from dipc_gym.engine.forces import Attached
from dipc_gym.engine.layout import JOINTS, STOPS, Element, Kind, Stop
from dipc_gym.engine.limits import depth_of, wanted
from dipc_gym.engine.values import Value, maximum, sqrt, where

ROUNDING = 1e-12  # of the largest acceleration that is wanted and of the largest push: what may be wrong with a sign
TURNS = 1000  # at most, until it is known which limits push; two or three as a rule


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
    """Limits that are met and ties, one after the other.

    What each gets beyond what it wants is G f - b, by pushes f >= 0 of limits, of any sign of ties: 0 where it pushes,
    and not below where a limit does not. Gauss and Seidel's turns tell which do; the system of those is then solved.

    Args:
        motion: that they push on.

    Attributes:
        met: how many there are.
        rows: how far each goes outwards with each joint.
        answers: accelerations of joints under a unit of its push.
        wants: acceleration outwards.
        softness: what each adds to the inverse inertia that it moves.
        pulls: whether it is a tie.
        lacking: b, the acceleration outwards that is wanted beyond the one that is there.
        coupling: G, acceleration of each outwards under a unit push of each other, with its softness.
        factor: Cholesky's of that, of those that push.
        pushes: as turns have them.
        found: as the system has them.
        works: whether each pushes.
    """

    def __init__(self, motion: Moving) -> None:
        self.motion, self.code = motion, motion.code
        code = self.code
        self.met: Counter = code.counter()
        self.rows = code.scratch(STOPS * JOINTS)
        self.answers = code.scratch(STOPS * JOINTS, plain=True)
        self.wants, self.softness, self.found = (code.scratch(STOPS) for _ in range(3))
        self.pulls, self.lacking, self.pushes, self.works = (code.scratch(STOPS, plain=True) for _ in range(4))
        self.coupling, self.factor = (code.scratch(STOPS * STOPS, plain=True) for _ in range(2))

    def write(self) -> None:
        """Push back where limits are met and where joints are tied, by as much as MuJoCo's soft constraints do."""
        code, motion = self.code, self.motion
        self._lean()
        with code.when(code.below(integer(0), self.met.get())):
            self._couple()
            turns = code.counter()
            with code.repeat() as stop:
                self._take_turns()
                self._factorise()
                self._substitute(self.lacking)
                turns.set(code.sum(turns.get(), 1))
                stop(code.any_of(self._consistent(), code.equal(turns.get(), TURNS)))
            self._push(tangents=False)
            motion.solve(factorised=True)
            if code.tangents:
                # With pushes as they are, what each would get otherwise than it wants.
                short = code.scratch(STOPS)
                with code.count(self.met.get()) as i:
                    short[i] = (
                        self.wants[i] - self._of(i, motion.accelerations) - self.softness[i] * self.found[i].plain
                    )
                    short[i] = where(self.works[i] > 0, short[i], code.value(0.0))
                    short.set_plain(i, 0.0)
                self._substitute(short)
                self._push(tangents=True)

    def _lean(self) -> None:
        """Note what limits that are met and ties want, and how joints answer; nothing pushes yet."""
        code, motion, number = self.code, self.motion, self.code.counter()
        self.met.set(0)
        with motion.attached.elements() as element:
            kind = code.whole(element, Element.KIND)
            tied = code.equal(kind, int(Kind.TIE))
            with code.when(code.any_of(tied, code.equal(kind, int(Kind.STOP)))):
                touches = motion.directions[code.sum(number.get(), JOINTS)] > 0
                number.set(code.sum(number.get(), 1))
                with code.when(code.any_of(tied, touches)):
                    self._lean_one(element, tied)

    def _lean_one(self, element: ir.Value, tied: ir.Value) -> None:
        code, motion, i = self.code, self.motion, self.met.get()
        own = motion.numbers.since(code.whole(element, Element.NUMBERS))
        coefficients = own.since(Stop.SIZE)
        depth, away, speed = depth_of(motion.attached, element, own)
        self.wants[i], self.softness[i] = wanted(own, depth, away * speed)
        self.pulls[i] = where(tied, code.value(1.0), code.value(0.0))
        self.pushes[i] = 0.0
        row, answer = self._row(self.rows, i), self._row(self.answers, i)
        with code.count(motion.n) as k:
            row[k] = 0.0
        with motion.attached.terms(element) as (term, joint):
            row[joint] = row[joint] + away.plain * coefficients[term]
        with code.count(motion.n) as k:
            answer[k] = where(motion.stuck(k), code.value(0.0), row[k].plain)
        motion.backwards(answer)
        self.lacking[i] = self.wants[i].plain - self._of(i, motion.accelerations).plain
        self.met.set(code.sum(i, 1))

    def _couple(self) -> None:
        with self.code.count(self.met.get()) as i, self.code.count(self.met.get()) as j:
            own = where(self.code.equal(i, j), self.softness[i].plain, self.code.value(0.0))
            self.coupling[self._at(i, j)] = self._of(i, self._row(self.answers, j)).plain + own

    def _take_turns(self) -> None:
        """Let each push as the others leave it, and note which do."""
        code, left = self.code, self.code.scratch(1, plain=True)
        with code.count(self.met.get()) as i:
            left[0] = self.lacking[i]
            with code.count(self.met.get()) as j:
                left[0] = left[0] - self.coupling[self._at(i, j)] * self.pushes[j]
            push = self.pushes[i] + left[0] / self.coupling[self._at(i, i)]
            ties = self.pulls[i] > 0
            self.pushes[i] = where(ties, push, maximum(push, 0.0))
            self.works[i] = where(code.any_of(ties, self.pushes[i] > 0), code.value(1.0), code.value(0.0))

    def _factorise(self) -> None:
        """Cholesky's factor of the coupling of those that push; rows of others are those of a unit matrix."""
        code, left = self.code, self.code.scratch(1, plain=True)
        with code.count(self.met.get()) as j, code.count(self.met.get(), j) as i:
            both = code.all_of(self.works[i] > 0, self.works[j] > 0)
            alike = code.equal(i, j)
            alone = where(alike, code.value(1.0), code.value(0.0))
            left[0] = where(both, self.coupling[self._at(i, j)], alone)
            with code.count(j) as k:
                left[0] = left[0] - self.factor[self._at(i, k)] * self.factor[self._at(j, k)]
            with code.either(alike) as (diagonal, below):
                with diagonal:
                    self.factor[self._at(j, j)] = sqrt(left[0])
                with below:
                    self.factor[self._at(i, j)] = left[0] / self.factor[self._at(j, j)]

    def _substitute(self, right: Numbers) -> None:
        """Set `found` of those that push to what their system has for a right side, of others to nothing."""
        code, found, met = self.code, self.found, self.met.get()
        with code.count(met) as i:
            found[i] = where(self.works[i] > 0, right[i], code.value(0.0))
            with code.count(i) as k:
                found[i] = found[i] - self.factor[self._at(i, k)] * found[k]
            found[i] = found[i] / self.factor[self._at(i, i)]
        with code.count(met) as back:
            i = code.at.sub(code.at.sub(met, back), integer(1))
            with code.count(met, code.sum(i, 1)) as k:
                found[i] = found[i] - self.factor[self._at(k, i)] * found[k]
            found[i] = found[i] / self.factor[self._at(i, i)]

    def _consistent(self) -> ir.Value:
        """Whether no limit pulls, and none that does not push lacks anything."""
        code, left, worst = self.code, self.code.scratch(1, plain=True), self.code.scratch(3, plain=True)
        worst[0], worst[1], worst[2] = 0.0, 0.0, 0.0  # what is wrong with a sign, largest push, largest lack
        with code.count(self.met.get()) as i:
            worst[1] = maximum(worst[1], abs(self.found[i].plain))
            worst[2] = maximum(worst[2], abs(self.lacking[i]))
        with code.count(self.met.get()) as i:
            left[0] = self.lacking[i]
            with code.count(self.met.get()) as j:
                left[0] = left[0] - self.coupling[self._at(i, j)] * self.found[j].plain
            pulling = code.all_of(self.pulls[i].equals(0.0), self.found[i].plain < -ROUNDING * worst[1])
            lacking = code.all_of(self.works[i].equals(0.0), left[0] > ROUNDING * worst[2])
            with code.when(code.any_of(pulling, lacking)):
                worst[0] = 1.0
        return worst[0].equals(0.0)

    def _push(self, *, tangents: bool) -> None:
        """Add pushes to the forces on joints; with tangents, theirs alone, and what joints do under them."""
        code, motion = self.code, self.motion
        with code.count(self.met.get()) as i:
            row, answer = self._row(self.rows, i), self._row(self.answers, i)
            push = self.found[i] if tangents else self.found[i].plain
            with code.count(motion.n) as k:
                motion.total[k] = motion.total[k] + row[k] * push
                if tangents:
                    motion.accelerations[k] = motion.accelerations[k] + answer[k] * push

    def _of(self, i: ir.Value, accelerations: Numbers) -> Value:
        """Acceleration outwards where joints have these."""
        total, row = self.code.scratch(1), self._row(self.rows, i)
        total[0] = 0.0
        with self.code.count(self.motion.n) as k:
            total[0] = total[0] + row[k] * accelerations[k]
        return total[0]

    def _row(self, numbers: Numbers, i: ir.Value) -> Numbers:
        return numbers.since(self.code.product(i, JOINTS))

    def _at(self, i: ir.Value, j: ir.Value) -> ir.Value:
        return self.code.sum(self.code.product(i, STOPS), j)
