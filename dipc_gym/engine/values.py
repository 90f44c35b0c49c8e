"""Numbers that write code: LLVM instructions by arithmetic on Python objects, with tangents beside.

A `Value` is a number that will exist when the code runs. Arithmetic on it appends instructions. With each number go,
where wanted, its derivatives in `LANES` directions, as one vector: forward differentiation by the rules of calculus,
one vector operation for all directions. Factors of zero and one vanish while the code is written, which is how the
structure of a model (joints along axes, bodies in a plane) makes its code short.

NumPy's functions work on values (NEP 13 and 18), so that a law written for arrays becomes code as it stands.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
from llvmlite import ir

from dipc_gym.engine import elementary

LANES = 8  # rigs to an instruction: eight doubles are what AVX-512 holds, and two of AVX2
REAL, INT, BIT = ir.DoubleType(), ir.IntType(64), ir.IntType(1)
POINTER = ir.PointerType()
VECTOR = ir.VectorType(REAL, LANES)
VOID = ir.VoidType()
FUSED = ("contract",)  # a product and a sum may become one rounding

Number = Any  # a Value, or a Python number


class Code(Protocol):
    """What a number asks of the function that it stands in, a `code.Code`.

    Attributes:
        at: where the next instruction goes.
        flags: of every sum and product.
        tangents: whether numbers carry derivatives.
        width: 0, or how many simulations go side by side.
        exact: whether each operation is rounded by itself.
    """

    at: ir.IRBuilder
    flags: tuple[str, ...]
    tangents: bool
    width: int
    exact: bool

    def value(self, number: Number) -> Value:
        """A number as a value."""

    def splat(self, number: ir.Value) -> ir.Value:
        """The same number in all lanes."""

    def call(self, name: str, *numbers: ir.Value) -> ir.Value:
        """A function of real numbers from the C library."""

    def intrinsic(self, name: str, *numbers: ir.Value) -> ir.Value:
        """One of LLVM's own functions of real numbers."""


class Value:
    """A number that will exist when the code runs, and its tangent."""

    __slots__ = ("code", "primal", "tangent")

    def __init__(self, code: Code, primal: ir.Value, tangent: ir.Value | None = None) -> None:
        self.code, self.primal = code, primal
        self.tangent = tangent if code.tangents else None

    @property
    def plain(self) -> Value:
        """The number without its tangent."""
        return Value(self.code, self.primal)

    def beside(self, primal: ir.Value) -> Value:
        """Another number of the same code, without a tangent."""
        return Value(self.code, primal)

    def _scaled(self, by: ir.Value) -> ir.Value | None:
        """The tangent times a number."""
        if self.tangent is None:
            return None
        return self.code.at.fmul(self.tangent, self.code.splat(by), flags=self.code.flags)

    def _chain(self, primal: ir.Value, slope: Callable[[], ir.Value]) -> Value:
        """A function's value with the tangent that its slope gives."""
        return Value(self.code, primal, None if self.tangent is None else self._scaled(slope()))

    def __add__(self, other: Number) -> Value:
        if not isinstance(other, Value):
            if other == 0:
                return self
            other = self.code.value(other)
        at = self.code.at
        return Value(
            self.code, at.fadd(self.primal, other.primal, flags=self.code.flags), _sum(at, self.tangent, other.tangent)
        )

    __radd__ = __add__

    def __neg__(self) -> Value:
        at = self.code.at
        return Value(self.code, at.fneg(self.primal), None if self.tangent is None else at.fneg(self.tangent))

    def __sub__(self, other: Number) -> Value:
        if not isinstance(other, Value):
            return self + -other
        at = self.code.at
        tangent = self.tangent
        if other.tangent is not None:
            tangent = (
                at.fneg(other.tangent) if tangent is None else at.fsub(tangent, other.tangent, flags=self.code.flags)
            )
        return Value(self.code, at.fsub(self.primal, other.primal, flags=self.code.flags), tangent)

    def __rsub__(self, other: Number) -> Value:
        return -self if other == 0 else self.code.value(other) - self

    def __mul__(self, other: Number) -> Number:
        if not isinstance(other, Value):
            if other == 0:
                return 0.0
            if other == 1:
                return self
            if other == -1:
                return -self
            other = self.code.value(other)
        at = self.code.at
        product = at.fmul(self.primal, other.primal, flags=self.code.flags)
        return Value(self.code, product, _sum(at, self._scaled(other.primal), other._scaled(self.primal)))

    __rmul__ = __mul__

    def __truediv__(self, other: Number) -> Value:
        if not isinstance(other, Value):
            if not self.code.exact:
                return self.code.value(self * (1.0 / other))
            other = self.code.value(other)
        at = self.code.at
        quotient = at.fdiv(self.primal, other.primal)
        if self.tangent is None and other.tangent is None:
            return Value(self.code, quotient)
        inverse = at.fdiv(ir.Constant(REAL, 1.0), other.primal)
        back = other._scaled(at.fneg(at.fmul(quotient, inverse)))
        return Value(self.code, quotient, _sum(at, self._scaled(inverse), back))

    def __rtruediv__(self, other: Number) -> Number:
        return 0.0 if other == 0 else self.code.value(other) / self

    def __floordiv__(self, other: Number) -> Number:
        return Value(self.code, self.code.intrinsic("llvm.floor", self.primal)) if other == 1 else NotImplemented

    def __pow__(self, power: int) -> Number:
        if power == 2:
            return self * self
        return NotImplemented

    def __abs__(self) -> Value:
        return where(self < 0, -self, self)

    def __lt__(self, other: Number) -> ir.Value:
        return self._compare("<", other)

    def __gt__(self, other: Number) -> ir.Value:
        return self._compare(">", other)

    def __le__(self, other: Number) -> ir.Value:
        return self._compare("<=", other)

    def __ge__(self, other: Number) -> ir.Value:
        return self._compare(">=", other)

    def equals(self, other: Number) -> ir.Value:
        """Whether the numbers are equal."""
        return self._compare("==", other)

    def __eq__(self, other: object) -> ir.Value:  # as arrays have it
        return self.equals(other)

    def __ne__(self, other: object) -> ir.Value:
        return self.code.at.not_(self.equals(other))

    __hash__ = object.__hash__

    def _compare(self, how: str, other: Number) -> ir.Value:
        return self.code.at.fcmp_ordered(how, self.primal, self.code.value(other).primal)

    def floor(self) -> ir.Value:
        """The whole number below."""
        return self.code.at.fptosi(self.code.intrinsic("llvm.floor", self.primal), INT)

    def ceil(self) -> ir.Value:
        """The whole number above."""
        return self.code.at.fptosi(self.code.intrinsic("llvm.ceil", self.primal), INT)

    def __array_ufunc__(self, function: np.ufunc, method: str, *inputs: Any, **options: Any) -> Any:
        law = _UFUNCS.get(function)
        if law is None or method != "__call__" or options:
            return NotImplemented
        inputs = tuple(x.item() if isinstance(x, np.ndarray | np.generic) else x for x in inputs)
        return law(*inputs)

    def __array_function__(self, function: Any, types: Any, inputs: Any, options: Any) -> Any:
        law = _FUNCTIONS.get(function)
        return NotImplemented if law is None or options else law(*inputs)


def _sum(at: ir.IRBuilder, one: ir.Value | None, other: ir.Value | None) -> ir.Value | None:
    if one is None or other is None:
        return other if one is None else one
    return at.fadd(one, other, flags=FUSED)


def where(condition: ir.Value, one: Number, other: Number) -> Value:
    """One number or the other."""
    value = one if isinstance(one, Value) else other
    code = value.code
    one, other = code.value(one), code.value(other)
    tangent = None
    if one.tangent is not None or other.tangent is not None:
        none = ir.Constant(VECTOR, [0.0] * LANES)
        tangent = code.at.select(condition, one.tangent or none, other.tangent or none)
    return Value(code, code.at.select(condition, one.primal, other.primal), tangent)


def sin(x: Value) -> Value:
    """Sine."""
    return sin_cos(x)[0]


def cos(x: Value) -> Value:
    """Cosine."""
    return sin_cos(x)[1]


def sin_cos(x: Value) -> tuple[Value, Value]:
    """Sine and cosine, each of which is the other's slope."""
    s, c = (one.primal for one in elementary.sin_cos(x.plain))
    return x._chain(s, lambda: c), x._chain(c, lambda: x.code.at.fneg(s))


def exp(x: Value) -> Value:
    """Exponential."""
    if x.code.width:
        return elementary.exp(minimum(maximum(x, elementary.LEAST), elementary.MOST))
    primal = x.code.call("exp", x.primal)
    return x._chain(primal, lambda: primal)


def tanh(x: Value) -> Value:
    """Hyperbolic tangent."""
    y = x.code.call("tanh", x.primal)
    return x._chain(y, lambda: (1.0 - Value(x.code, y) * Value(x.code, y)).primal)


def sqrt(x: Value) -> Value:
    """Square root."""
    y = x.code.intrinsic("llvm.sqrt", x.primal)
    return x._chain(y, lambda: x.code.at.fdiv(ir.Constant(REAL, 0.5), y))


def sign(x: Value) -> Value:
    """-1, 0 or 1."""
    return where(x > 0, x.code.value(1.0), where(x < 0, x.code.value(-1.0), x.code.value(0.0)))


def maximum(x: Number, y: Number) -> Value:
    """The larger one; NaN if the first is."""
    code = x.code if isinstance(x, Value) else y.code
    return where(code.value(x) < y, y, x)


def minimum(x: Number, y: Number) -> Value:
    """The smaller one; NaN if the first is."""
    code = x.code if isinstance(x, Value) else y.code
    return where(code.value(x) > y, y, x)


_UFUNCS: dict[Any, Callable[..., Any]] = {
    np.add: lambda x, y: x + y,
    np.subtract: lambda x, y: x - y,
    np.multiply: lambda x, y: x * y,
    np.divide: lambda x, y: x / y,
    np.negative: lambda x: -x,
    np.absolute: abs,
    np.sign: sign,
    np.sin: sin,
    np.cos: cos,
    np.exp: exp,
    np.tanh: tanh,
    np.sqrt: sqrt,
    np.square: lambda x: x * x,
    np.maximum: maximum,
    np.minimum: minimum,
    np.equal: lambda x, y: x == y,
    np.not_equal: lambda x, y: x != y,
}
_FUNCTIONS: dict[Any, Callable[..., Any]] = {
    np.where: where,
    np.clip: lambda x, low, high: minimum(maximum(x, low), high),
}
