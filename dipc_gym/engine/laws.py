"""What `<custom>` adds to joints, as code: laws written once for arrays, and the tables that they read."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from llvmlite import ir

from dipc_gym.engine.code import Code, Numbers, integer
from dipc_gym.engine.forces import Each
from dipc_gym.engine.layout import Head, Law
from dipc_gym.engine.values import INT, POINTER, REAL, Value, maximum, minimum, where
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


@functools.cache
def written(rule: Says, width: int = 0) -> bool:
    """Whether a law becomes code as it stands, for one simulation or for `width` side by side.

    One that a user registered may do anything.
    """
    code = Code(ir.Module(), "law", [POINTER, INT], tangents=not width, width=width)
    numbers, count = code.function.args
    now: Any = Moment
    try:
        names = ("time", "position", "drive", "weight", "value", "speed", "memory", "slides")
        of = now(**{name: code.value(0.0) for name in names}, inputs=(code.value(0.0), code.value(0.0)))
        code.value(rule(Table(code, Numbers(code, numbers, numbers), count), of))
    except Exception:  # whatever a law of somebody's does with numbers that are none yet
        return False
    return True


class _Laws:
    def __init__(
        self, code: Code, program: ir.Value, numbers: Numbers, rules: Sequence[Rule | None], moment: Any, rates: Numbers
    ) -> None:
        self.code, self.numbers, self.rules, self.moment, self.rates = code, numbers, rules, moment, rates
        first, count = code.whole(program, Head.LAW_AT), code.whole(program, Head.LAWS)
        self._each = Each(code, program, first, count, int(Law.SIZE))

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
