"""Functions in the making: memory, branches and loops of LLVM's code, with the numbers of `values` in them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from llvmlite import ir

from dipc_gym.engine.values import FUSED, INT, LANES, POINTER, REAL, VECTOR, VOID, Number, Value

Index = Any  # int, or an LLVM integer


class Code:
    """Writes one function.

    Args:
        module: of the function.
        name: of the function.
        arguments: types.
        returns: type.
        tangents: whether numbers carry derivatives.
        internal: whether only functions of the same module call it.
        width: 0, or how many simulations go side by side: every number is then a vector of theirs. Nothing may branch
            on such a number, and there are no tangents.
        exact: whether each operation is rounded by itself, as Python's are.
    """

    def __init__(
        self,
        module: ir.Module,
        name: str,
        arguments: Sequence[ir.Type],
        *,
        returns: ir.Type | None = None,
        tangents: bool = False,
        internal: bool = False,
        width: int = 0,
        exact: bool = False,
    ) -> None:
        self.module, self.tangents, self.width, self.exact = module, tangents, width, exact
        self.flags: tuple[str, ...] = () if exact else FUSED
        self.real = ir.VectorType(REAL, width) if width else REAL
        self.function = ir.Function(module, ir.FunctionType(returns or ir.VoidType(), arguments), name)
        if internal:
            self.function.linkage = "internal"
            self.function.attributes.add("alwaysinline" if width else "noinline")
        self._entry = self.function.append_basic_block("entry")
        self.at = ir.IRBuilder(self.function.append_basic_block("body"))
        self._scratch = ir.IRBuilder(self._entry)
        self._body = self.at.block

    def finish(self, result: ir.Value | None = None) -> ir.Function:
        """End the function."""
        if result is None:
            self.at.ret_void()
        else:
            self.at.ret(result)
        self._scratch.branch(self._body)
        return self.function

    # Memory

    def scratch(self, count: int, *, plain: bool = False) -> Numbers:
        """Memory for numbers of this call, without tangents if `plain`."""
        place = self._scratch.alloca(self.real, count)
        place.align = 64
        beside = None
        if self.tangents and not plain:
            beside = self._scratch.alloca(VECTOR, count)
            beside.align = 64
        return Numbers(self, place, beside)

    def counter(self, value: int = 0) -> Counter:
        """A whole number that changes."""
        counter = Counter(self, self._scratch.alloca(INT))
        counter.set(value)
        return counter

    def numbers(self, place: ir.Value, beside: ir.Value | None = None) -> Numbers:
        """Numbers in memory, and their tangents there."""
        return Numbers(self, place, beside if self.tangents else None)

    def whole(self, place: ir.Value, index: Index) -> ir.Value:
        """A whole number in memory."""
        return self.at.load(self._element(place, index, INT), typ=INT)

    def pointer(self, place: ir.Value, index: Index) -> ir.Value:
        """An address in memory."""
        return self.at.load(self._element(place, index, POINTER), typ=POINTER)

    def offset(self, place: ir.Value, index: Index, kind: ir.Type | None = None) -> ir.Value:
        """The address `index` elements further on, by default numbers."""
        return self._element(place, index, kind or self.real)

    def _element(self, place: ir.Value, index: Index, kind: ir.Type) -> ir.Value:
        return self.at.gep(place, [integer(index)], inbounds=True, source_etype=kind)

    # Numbers

    def value(self, number: Number) -> Value:
        """A number as a value."""
        return number if isinstance(number, Value) else Value(self, self.constant(float(number)))

    def constant(self, number: float) -> ir.Value:
        """A number that is known when the code is written."""
        return ir.Constant(self.real, [number] * self.width if self.width else number)

    def splat(self, number: ir.Value) -> ir.Value:
        """The same number in all lanes."""
        first = self.at.insert_element(ir.Constant(VECTOR, ir.Undefined), number, ir.Constant(ir.IntType(32), 0))
        zeros = ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES)
        return self.at.shuffle_vector(first, ir.Constant(VECTOR, ir.Undefined), zeros)

    def call(self, name: str, *numbers: ir.Value) -> ir.Value:
        """A function of real numbers from the C library."""
        function = self.module.globals.get(name)
        if function is None:
            function = ir.Function(self.module, ir.FunctionType(REAL, [REAL] * len(numbers)), name)
            function.attributes.add("nounwind")
        return self.at.call(function, numbers)

    def intrinsic(self, name: str, *numbers: ir.Value) -> ir.Value:
        """One of LLVM's own functions of real numbers."""
        if self.width:
            name = f"{name}.v{self.width}f64"
            function = self.module.globals.get(name)
            if function is None:
                function = ir.Function(self.module, ir.FunctionType(self.real, [self.real] * len(numbers)), name)
            return self.at.call(function, numbers)
        return self.at.call(self.module.declare_intrinsic(name, [REAL]), numbers)

    def external(self, name: str, arguments: Sequence[ir.Type]) -> ir.Function:
        """A function of this module or another."""
        function = self.module.globals.get(name)
        return function or ir.Function(self.module, ir.FunctionType(VOID, arguments), name)

    # Flow

    @contextmanager
    def count(self, to: Index, start: Index = 0) -> Iterator[ir.Value]:
        """Repeat with an index from `start` up to `to`, excluded."""
        ahead = self.at.block
        head, body, end = (self.function.append_basic_block(name) for name in ("head", "repeat", "after"))
        self.at.branch(head)
        self.at.position_at_end(head)
        index = self.at.phi(INT)
        index.add_incoming(integer(start), ahead)
        self.at.cbranch(self.at.icmp_signed("<", index, integer(to)), body, end)
        self.at.position_at_end(body)
        yield index
        index.add_incoming(self.at.add(index, ir.Constant(INT, 1)), self.at.block)
        self.at.branch(head)
        self.at.position_at_end(end)

    @contextmanager
    def repeat(self) -> Iterator[Callable[[ir.Value], None]]:
        """Repeat until the function that it gives is called with a true condition."""
        body, end = self.function.append_basic_block("again"), self.function.append_basic_block("done")
        self.at.branch(body)
        self.at.position_at_end(body)

        def stop(condition: ir.Value) -> None:
            on = self.function.append_basic_block("on")
            self.at.cbranch(condition, end, on)
            self.at.position_at_end(on)

        yield stop
        self.at.branch(body)
        self.at.position_at_end(end)

    @contextmanager
    def when(self, condition: ir.Value) -> Iterator[None]:
        """Only if a condition holds."""
        with self.at.if_then(condition):
            yield

    @contextmanager
    def either(self, condition: ir.Value) -> Iterator[tuple[Any, Any]]:
        """One of two branches: `with code.either(c) as (then, otherwise)`."""
        with self.at.if_else(condition) as branches:
            yield branches

    def all_of(self, *conditions: ir.Value) -> ir.Value:
        """Whether all conditions hold."""
        result = conditions[0]
        for condition in conditions[1:]:
            result = self.at.and_(result, condition)
        return result

    def any_of(self, *conditions: ir.Value) -> ir.Value:
        """Whether one of them holds."""
        result = conditions[0]
        for condition in conditions[1:]:
            result = self.at.or_(result, condition)
        return result

    def equal(self, index: ir.Value, other: Index) -> ir.Value:
        """Whether whole numbers are equal."""
        return self.at.icmp_signed("==", index, integer(other))

    def below(self, index: ir.Value, other: Index) -> ir.Value:
        """Whether a whole number is smaller than another."""
        return self.at.icmp_signed("<", index, integer(other))

    def sum(self, index: ir.Value, other: Index) -> ir.Value:
        """Sum of whole numbers."""
        return self.at.add(index, integer(other))

    def product(self, index: ir.Value, other: Index) -> ir.Value:
        """Product of whole numbers."""
        return self.at.mul(index, integer(other))


def integer(index: Index) -> ir.Value:
    """A Python integer as LLVM's; LLVM's as they are."""
    return index if isinstance(index, ir.Value) else ir.Constant(INT, int(index))


@dataclass(frozen=True)
class Counter:
    """A whole number in memory."""

    code: Code
    place: ir.Value

    def get(self) -> ir.Value:
        """Its value now."""
        return self.code.at.load(self.place, typ=INT)

    def set(self, value: Index) -> None:
        """Change it."""
        self.code.at.store(integer(value), self.place)


@dataclass(frozen=True)
class Numbers:
    """Numbers in memory, read and written by index."""

    code: Code
    place: ir.Value
    beside: ir.Value | None

    def __getitem__(self, index: Index) -> Value:
        at, tangent = self.code.at, None
        if self.beside is not None:
            tangent = at.load(self.code.offset(self.beside, index, VECTOR), align=8, typ=VECTOR)
        return Value(self.code, at.load(self.code.offset(self.place, index), align=8, typ=self.code.real), tangent)

    def __setitem__(self, index: Index, number: Number) -> None:
        at, value = self.code.at, self.code.value(number)
        at.store(value.primal, self.code.offset(self.place, index), align=8)
        if self.beside is not None:
            tangent = value.tangent if value.tangent is not None else ir.Constant(VECTOR, [0.0] * LANES)
            at.store(tangent, self.code.offset(self.beside, index, VECTOR), align=8)

    def plain(self, index: Index) -> Value:
        """A number without its tangent: a decision, or where a tangent is of no use."""
        return Value(self.code, self.code.at.load(self.code.offset(self.place, index), align=8, typ=self.code.real))

    def set_plain(self, index: Index, number: Number) -> None:
        """Change a number and leave its tangent."""
        self.code.at.store(self.code.value(number).primal, self.code.offset(self.place, index), align=8)

    def since(self, index: Index) -> Numbers:
        """The numbers from one on."""
        beside = None if self.beside is None else self.code.offset(self.beside, index, VECTOR)
        return Numbers(self.code, self.code.offset(self.place, index), beside)
