"""What a control loop computes once a period, as a short list of vector operations with a memory.

Every part of a loop (estimator, controller, compensator) writes its own formula into a `Program`, once. From there it
is run in NumPy, written as C, or written as an ONNX graph, with the same operations in the same order.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NoReturn

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

Floats = NDArray[np.floating[Any]]

UNARY = ("exp", "tanh", "sigmoid")
BINARY = ("add", "subtract", "multiply", "divide", "minimum", "maximum", "less", "within")
ELEMENTWISE = (*UNARY, *BINARY, "choose")
REDUCTIONS = ("total", "least")


class NoForm(ValueError):
    """A part of a control loop that cannot be exported; the message says which, and what to do instead."""


@dataclass(frozen=True, eq=False)
class Step:
    """One operation.

    Attributes:
        operation: one of `ELEMENTWISE` or `REDUCTIONS`, or `input`, `state`, `constant`, `affine`, `join`, `part`, or
            `comment`.
        operands: places of the values that it works on.
        size: of the result, a vector.
        name: of an input, a state or a comment.
        numbers: (size,) of a constant, or what a state is at first.
        weights: (size, inputs) of an affine map.
        start: of a part.
    """

    operation: str
    operands: tuple[int, ...]
    size: int
    name: str = ""
    numbers: Floats = field(default_factory=lambda: np.zeros(0))
    weights: Floats = field(default_factory=lambda: np.zeros((0, 0)))
    start: int = 0


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

    # ------------------------------------------------------------------------------------------------ writing

    def append(
        self, operation: str, operands: Sequence[Value], size: int, *, name: str = "", numbers: Floats | None = None,
        weights: Floats | None = None, start: int = 0,
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
        """One vector of several."""
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
        values: list[Floats] = []
        with np.errstate(all="ignore"):  # what is not finite is dealt with by the program itself
            for step in self.steps:
                if step.operation == "input":
                    values.append(np.atleast_1d(np.asarray(inputs[step.name])).astype(dtype)[None])
                elif step.operation == "state":
                    values.append(memory[step.name])
                else:
                    values.append(_computed(step, [values[place] for place in step.operands], dtype))
        runs = max((value.shape[1] for value in values), default=1)
        outputs = {name: _wide(values[place], runs) for name, place in self.outputs.items()}
        kept = {name: _wide(values[self.updates.get(place, place)], runs) for name, place in self.states.items()}
        return outputs, kept

    def cost(self) -> Counter[str]:
        """Operations of one call at worst: additions, multiplications, divisions, exponentials, comparisons."""
        count: Counter[str] = Counter()
        for step in self.steps:
            for kind, times in _COSTS.get(step.operation, {}).items():
                entries = self.steps[step.operands[0]].size if step.operation in REDUCTIONS else step.size
                count[kind] += times * entries
            if step.operation == "affine":
                count["multiplications"] += step.weights.size
                count["additions"] += step.weights.size
        return count


# What each operation costs a microcontroller, for one number.
_COSTS = {
    "add": {"additions": 1},
    "subtract": {"additions": 1},
    "multiply": {"multiplications": 1},
    "divide": {"divisions": 1},
    "minimum": {"comparisons": 1},
    "maximum": {"comparisons": 1},
    "less": {"comparisons": 1},
    "within": {"comparisons": 2},
    "choose": {"comparisons": 1},
    "exp": {"exponentials": 1},
    "tanh": {"multiplications": 2, "additions": 6, "divisions": 7, "exponentials": 1, "comparisons": 2},
    "sigmoid": {"additions": 1, "divisions": 1, "exponentials": 1, "comparisons": 1, "multiplications": 1},
    "total": {"additions": 1},
    "least": {"comparisons": 1},
}


def _computed(step: Step, operands: list[Floats], dtype: DTypeLike) -> Floats:
    match step.operation, operands:
        case "comment", _:
            return np.zeros((0, 1), dtype)
        case "constant", _:
            return step.numbers.astype(dtype)[:, None]
        case "add", (a, b):
            return a + b
        case "subtract", (a, b):
            return a - b
        case "multiply", (a, b):
            return a * b
        case "divide", (a, b):
            return a / b
        case "minimum", (a, b):
            return np.where(a < b, a, b)
        case "maximum", (a, b):
            return np.where(a > b, a, b)
        case "less", (a, b):
            return (a < b).astype(dtype)
        case "within", (a, limit):
            return ((a < limit) & (-limit < a)).astype(dtype)
        case "choose", (test, yes, no):
            return np.where(test > 0.5, yes, no)
        case "exp", (a,):
            return np.exp(a)
        case "tanh", (a,):
            return np.tanh(a)
        case "sigmoid", (a,):
            e = np.exp(-np.abs(a))
            return np.where(a < 0, e, 1) / (1 + e)
        case "total", (a,):
            return np.add.accumulate(a)[-1:]  # in order, as C adds; np.sum adds in pairs
        case "least", (a,):
            smallest = a[0]
            for row in a[1:]:
                smallest = np.where(row < smallest, row, smallest)
            return smallest[None]
        case "part", (a,):
            return a[step.start : step.start + step.size]
        case "join", parts:
            runs = max(part.shape[1] for part in parts)
            return np.concatenate([_wide(part, runs) for part in parts])
        case "affine", (a,):
            weights = step.weights.astype(dtype)
            result = np.repeat(step.numbers.astype(dtype)[:, None], a.shape[1], axis=1)
            for column, entry in zip(weights.T, a, strict=True):
                result = result + column[:, None] * entry
            return result
    raise ValueError(f"no operation {step.operation!r}")


def _wide(value: Floats, runs: int) -> Floats:
    return np.broadcast_to(value, (len(value), runs))


def _common_size(operands: Sequence[Value]) -> int:
    sizes = {operand.size for operand in operands} - {1}
    if len(sizes) > 1:
        raise ValueError(f"values of {' and '.join(str(size) for size in sorted(sizes))} entries do not go together")
    return sizes.pop() if sizes else 1


def _finite(numbers: Floats) -> Floats:
    if not np.isfinite(numbers).all():
        raise NoForm("one of its numbers is not finite")
    return numbers.copy()
