"""Vectors in a program that is being written, and the program: operations from inputs and a memory to outputs."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NoReturn

import numpy as np
from numpy.typing import ArrayLike, DTypeLike

from dipc_gym.dataflow.operations import Floats, Step, computing, cost, wide

Prepared = tuple[
    list[Floats],
    list[tuple[int, str]],
    list[tuple[int, str]],
    list[tuple[int, Callable[..., Floats], tuple[int, ...]]],
]


class NoForm(ValueError):
    """A part of a control loop that cannot be exported; the message says which, and what to do instead."""


@dataclass(frozen=True, eq=False)
class Value:
    """A vector in a program that is being written; plain operators write further operations.

    Operators take numbers too, and a value of size 1 goes with any other. A formula in plain operators and in NumPy's
    `exp` and `tanh` therefore writes itself when it is called with values.
    """

    program: Program = field(repr=False)
    place: int
    size: int

    def __add__(self, other: Value | float) -> Value:
        return self._two("add", self, other)

    def __radd__(self, other: float) -> Value:
        return self._two("add", other, self)

    def __sub__(self, other: Value | float) -> Value:
        return self._two("subtract", self, other)

    def __rsub__(self, other: float) -> Value:
        return self._two("subtract", other, self)

    def __mul__(self, other: Value | float) -> Value:
        return self._two("multiply", self, other)

    def __rmul__(self, other: float) -> Value:
        return self._two("multiply", other, self)

    def __truediv__(self, other: Value | float) -> Value:
        return self._two("divide", self, other)

    def __rtruediv__(self, other: float) -> Value:
        return self._two("divide", other, self)

    def __neg__(self) -> Value:
        return self * -1.0

    def __abs__(self) -> Value:
        return self.maximum(-self)

    def minimum(self, other: Value | float) -> Value:
        """The smaller one, entry by entry; `other` where one is not a number."""
        return self._two("minimum", self, other)

    def maximum(self, other: Value | float) -> Value:
        """The larger one, entry by entry; `other` where one is not a number."""
        return self._two("maximum", self, other)

    def clip(self, low: float, high: float) -> Value:
        """No less than `low` and no more than `high`; `low` for what is not a number."""
        return self.maximum(low).minimum(high)

    def below(self, other: Value | float) -> Value:
        """1 where it is less than `other`, 0 elsewhere and where one is not a number."""
        return self._two("less", self, other)

    def within(self, limit: float) -> Value:
        """1 where its size is less than `limit`, 0 elsewhere and for what is not a number."""
        return self._two("within", self, limit)

    def choose(self, yes: Value | float, no: Value | float) -> Value:
        """`yes` where this value is above one half, else `no`."""
        operands = (self, self.program.value(yes), self.program.value(no))
        return self.program.append("choose", operands, _common_size(operands))

    def exp(self) -> Value:
        """Exponential; NumPy's `exp` finds it by this name."""
        return self.program.append("exp", (self,), self.size)

    def tanh(self) -> Value:
        """Hyperbolic tangent; NumPy's `tanh` finds it by this name."""
        return self.program.append("tanh", (self,), self.size)

    def sigmoid(self) -> Value:
        """1 / (1 + exp(-x)), without overflow."""
        return self.program.append("sigmoid", (self,), self.size)

    def total(self) -> Value:
        """The sum of all entries, from first to last."""
        return self.program.append("total", (self,), 1)

    def least(self) -> Value:
        """The smallest entry."""
        return self.program.append("least", (self,), 1)

    def part(self, start: int, size: int = 1) -> Value:
        """Some entries.

        Raises:
            ValueError: there are no such entries.
        """
        if start < 0 or size < 1 or start + size > self.size:
            raise ValueError(f"entries {start} to {start + size} of a value of {self.size}")
        return self.program.append("part", (self,), size, start=start)

    def pick(self, places: Sequence[int]) -> Value:
        """Entries in any order, each as often as it is named.

        Raises:
            ValueError: there are no such entries.
        """
        if not places or min(places) < 0 or max(places) >= self.size:
            raise ValueError(f"entries {', '.join(map(str, places))} of a value of {self.size}")
        return self.program.append("pick", (self,), len(places), places=tuple(places))

    def times(self, other: Value, inner: int, *, half: bool = False) -> Value:
        """The product of two matrices, this value (m, inner) and the other (inner, n), each row after row.

        Args:
            other: the second matrix.
            inner: columns of the first, rows of the second.
            half: the product is symmetric: only its lower triangle, row after row, is computed.

        Raises:
            ValueError: the values have no such shapes, or half of a product that is not square is asked for.
        """
        rows, columns = (value.size // inner if inner > 0 else 0 for value in (self, other))
        if inner < 1 or (rows * inner, inner * columns) != (self.size, other.size) or (half and rows != columns):
            raise ValueError(f"values of {self.size} and {other.size} entries have no such product over {inner}")
        size = rows * (rows + 1) // 2 if half else rows * columns
        return self.program.append("product", (self, other), size, inner=inner, half=half)

    def affine(self, weights: ArrayLike, biases: ArrayLike = 0.0) -> Value:
        """`weights` (m, n) times this value (n,), plus `biases` (m,)."""
        table = np.atleast_2d(np.asarray(weights, dtype=np.float64))
        if table.shape[1] != self.size:
            raise ValueError(f"weights are {table.shape}, and the value has {self.size} entries")
        offsets = np.broadcast_to(np.asarray(biases, dtype=np.float64), len(table))
        return self.program.append("affine", (self,), len(table), weights=_finite(table), numbers=_finite(offsets))

    def __bool__(self) -> NoReturn:
        raise NoForm("its formula decides by if, <, min, max or sign; give it an `express` of its own")

    def __lt__(self, other: object) -> NoReturn:
        bool(self)
        raise AssertionError

    __gt__ = __le__ = __ge__ = __lt__

    def _two(self, operation: str, a: Value | float, b: Value | float) -> Value:
        operands = (self.program.value(a), self.program.value(b))
        return self.program.append(operation, operands, _common_size(operands))


class Program:
    """Operations from inputs and a memory to outputs and the next memory.

    Attributes:
        steps: in the order in which they are computed.
        updates: place of each state, and of the value that it has in the next period.
        outputs: name and place of each output.

    Example:
        >>> mean = Program()
        >>> x, last = mean.input("x"), mean.state("last", 0.0)
        >>> mean.update(last, x)
        >>> mean.output("mean", (x + last) / 2)
        >>> outputs, memory = mean.run({"x": [4.0]}, mean.memory())
        >>> outputs["mean"].tolist(), memory["last"].tolist()
        ([[2.0]], [[4.0]])
    """

    def __init__(self) -> None:
        self.steps: list[Step] = []
        self.updates: dict[int, int] = {}
        self.outputs: dict[str, int] = {}
        self._first: Value | None = None
        self._known: dict[tuple[np.dtype[Any], int], Prepared] = {}

    # ------------------------------------------------------------------------------------------------ writing

    def append(
        self, operation: str, operands: Sequence[Value], size: int, *, name: str = "", numbers: Floats | None = None,
        weights: Floats | None = None, start: int = 0, places: tuple[int, ...] = (), inner: int = 0, half: bool = False,
    ) -> Value:  # fmt: skip
        """Write an operation; methods of `Value` are the comfortable way."""
        if any(operand.program is not self for operand in operands):
            raise ValueError("a value of another program")
        none = np.zeros(0)
        self.steps.append(
            Step(
                operation,
                tuple(operand.place for operand in operands),
                size,
                name,
                none if numbers is None else numbers,
                np.zeros((0, 0)) if weights is None else weights,
                start,
                places,
                inner,
                half,
            )
        )
        return Value(self, len(self.steps) - 1, size)

    def input(self, name: str) -> Value:
        """A number that every call brings."""
        return self.append("input", (), 1, name=name)

    def constant(self, numbers: ArrayLike) -> Value:
        """A number or a vector that never changes."""
        vector = _finite(np.atleast_1d(np.asarray(numbers, dtype=np.float64)))
        return self.append("constant", (), len(vector), numbers=vector)

    def state(self, name: str, first: ArrayLike) -> Value:
        """A vector that is kept from one period to the next; `update` says how it goes on.

        Args:
            name: of its own; a number is appended to one that is taken.
            first: what it is after a reset.
        """
        taken = {step.name for step in self.steps if step.operation == "state"}
        own, count = name, 2
        while own in taken:
            own, count = f"{name}_{count}", count + 1
        vector = _finite(np.atleast_1d(np.asarray(first, dtype=np.float64)))
        return self.append("state", (), len(vector), name=own, numbers=vector)

    def update(self, state: Value, value: Value) -> None:
        """Say what a state is in the next period."""
        if self.steps[state.place].operation != "state" or state.size != value.size:
            raise ValueError(f"{self.steps[state.place].name!r} is no state of {value.size} entries")
        self.updates[state.place] = value.place

    def output(self, name: str, value: Value) -> None:
        """Name a result."""
        self.outputs[name] = value.place

    def comment(self, text: str) -> None:
        """A line for whoever reads the code."""
        self.append("comment", (), 0, name=text)

    def first(self) -> Value:
        """1 in the first period after a reset, else 0."""
        if self._first is None:
            started = self.state("started", 0.0)
            self.update(started, self.constant(1.0))
            self._first = started.below(0.5)
        return self._first

    def previous(self, name: str, value: Value) -> Value:
        """What a value was one period ago; after a reset, what it is now."""
        kept = self.state(name, np.zeros(value.size))
        self.update(kept, value)
        return self.first().choose(value, kept)

    def join(self, *values: Value) -> Value:
        """One vector of several; of one, itself."""
        if len(values) == 1:
            return values[0]
        return self.append("join", values, sum(value.size for value in values))

    def value(self, value: Value | float) -> Value:
        """The value itself, or a number as a constant."""
        return value if isinstance(value, Value) else self.constant(value)

    # ------------------------------------------------------------------------------------------------ reading

    @property
    def inputs(self) -> list[str]:
        """Names of the inputs, in order."""
        return [step.name for step in self.steps if step.operation == "input"]

    @property
    def states(self) -> dict[str, int]:
        """Name and place of each state, in order."""
        return {step.name: place for place, step in enumerate(self.steps) if step.operation == "state"}

    def memory(self, runs: int = 1, dtype: DTypeLike = np.float64) -> dict[str, Floats]:
        """The memory after a reset, of so many runs side by side: (size, runs) of each state."""
        return {
            name: np.repeat(self.steps[place].numbers[:, None], runs, axis=1).astype(dtype)
            for name, place in self.states.items()
        }

    def run(
        self, inputs: Mapping[str, ArrayLike], memory: Mapping[str, Floats], dtype: DTypeLike = np.float64
    ) -> tuple[dict[str, Floats], dict[str, Floats]]:
        """Compute one period of many runs side by side, with NumPy.

        Args:
            inputs: (runs,) of each input.
            memory: as `memory` or the call before gave it.
            dtype: precision; single precision is what C with `float` computes, operation by operation.

        Returns:
            (size, runs) of each output, and the next memory.
        """
        values, given, kept, work = self.prepared(np.dtype(dtype))
        values = values.copy()
        for place, name in given:
            values[place] = np.atleast_1d(np.asarray(inputs[name])).astype(dtype)[None]
        for place, name in kept:
            values[place] = memory[name]
        runs = max((values[place].shape[1] for place, _ in (*given, *kept)), default=1)
        with np.errstate(all="ignore"):  # what is not finite is dealt with by the program itself
            for place, compute, operands in work:
                values[place] = compute(*[values[operand] for operand in operands])
        outputs = {name: wide(values[place], runs) for name, place in self.outputs.items()}
        return outputs, {name: wide(values[self.updates.get(place, place)], runs) for place, name in kept}

    def prepared(self, dtype: np.dtype[Any]) -> Prepared:
        """What of a run is the same each time: constants by place, names of inputs and states, and what computes."""
        if (dtype, len(self.steps)) not in self._known:
            values: list[Floats] = [np.zeros((0, 1), dtype)] * len(self.steps)
            named: dict[str, list[tuple[int, str]]] = {"input": [], "state": []}
            work = []
            for place, step in enumerate(self.steps):
                if step.operation == "constant":
                    values[place] = step.numbers.astype(dtype)[:, None]
                elif step.operation in named:
                    named[step.operation].append((place, step.name))
                elif step.operation != "comment":
                    work.append((place, computing(step, dtype), step.operands))
            self._known[dtype, len(self.steps)] = (values, named["input"], named["state"], work)
        return self._known[dtype, len(self.steps)]

    def cost(self) -> Counter[str]:
        """Operations of one call at worst: additions, multiplications, divisions, exponentials, comparisons."""
        count: Counter[str] = Counter()
        for step in self.steps:
            count += cost(step, self.steps[step.operands[0]].size if step.operands else 0)
        return count


def _common_size(operands: Sequence[Value]) -> int:
    sizes = {operand.size for operand in operands} - {1}
    if len(sizes) > 1:
        raise ValueError(f"values of {' and '.join(str(size) for size in sorted(sizes))} entries do not go together")
    return sizes.pop() if sizes else 1


def _finite(numbers: Floats) -> Floats:
    if not np.isfinite(numbers).all():
        raise NoForm("one of its numbers is not finite")
    return numbers.copy()
