"""Sine, cosine and exponential of many numbers at once, which the C library has for one number only.

Sine and cosine of a single number are written likewise: both together, in line, take a third of two calls.

The argument is brought near zero, where a Taylor series reaches the last bit but one. Every operation is one that
IEEE 754 defines, so a number's result does not depend on its neighbours.
"""

from __future__ import annotations

import math
from typing import Any, Protocol, Self, TypeVar

from llvmlite import ir

# Adding it leaves no bits behind the point; the whole number is then in the last bits.
_ROUNDING = 1.5 * 2.0**52
_EXPONENT = 52  # place of a number's exponent among its bits

# ln 2 and pi/2 in parts, the first ones short enough for exact products with whole numbers of 20 bits.
_LN2 = (float.fromhex("0x1.62e42fee00000p-1"), float.fromhex("0x1.a39ef35793c76p-33"))
_QUARTER = (
    float.fromhex("0x1.921fb54400000p+0"),
    float.fromhex("0x1.0b4611a600000p-34"),
    float.fromhex("0x1.3198a2e037073p-69"),
)
LEAST, MOST = -708.0, 709.0  # exponents whose power of e a number holds


class Value(Protocol):
    """What is asked of a number that writes code, such as `values.Value`."""

    code: Any
    primal: ir.Value

    def beside(self, primal: ir.Value) -> Self:
        """Another number of the same code."""

    def __add__(self, other: Any) -> Self:
        """The sum."""

    def __sub__(self, other: Any) -> Self:
        """The difference."""

    def __mul__(self, other: Any) -> Self:
        """The product."""


Number = TypeVar("Number", bound=Value)


def exp(x: Number) -> Number:
    """Exponential of numbers from `LEAST` to `MOST`, whose powers of e a number holds."""
    code = x.code
    shifted, whole = _rounded(x * (1 / math.log(2)))
    remainder = x - whole * _LN2[0] - whole * _LN2[1]
    series = _horner(remainder, [1 / math.factorial(k) for k in range(14)])
    power = code.at.shl(_bits(shifted), _constant(code, _EXPONENT))
    one = code.at.bitcast(code.constant(1.0), _whole(code))
    return x.beside(code.at.bitcast(code.at.add(power, one), code.real)) * series


def sin_cos(x: Number) -> tuple[Number, Number]:
    """Sine and cosine, of angles up to a million."""
    code, at = x.code, x.code.at
    shifted, whole = _rounded(x * (2 / math.pi))
    remainder = x
    for part in _QUARTER:
        remainder = remainder - whole * part
    square = remainder * remainder
    s = remainder * _horner(square, [(-1) ** k / math.factorial(2 * k + 1) for k in range(9)])
    c = _horner(square, [(-1) ** k / math.factorial(2 * k) for k in range(9)])
    quarters = _bits(shifted)
    one, two = _constant(code, 1), _constant(code, 2)
    odd = at.icmp_unsigned("==", at.and_(quarters, one), one)

    def signed(number: Number, by: Any) -> Number:
        flip = at.shl(at.and_(by, two), _constant(code, 62))
        return x.beside(at.bitcast(at.xor(at.bitcast(number.primal, _whole(code)), flip), code.real))

    sine = x.beside(at.select(odd, c.primal, s.primal))
    cosine = x.beside(at.select(odd, s.primal, c.primal))
    return signed(sine, quarters), signed(cosine, at.add(quarters, one))


def _rounded(x: Number) -> tuple[Number, Number]:
    """A number whose last bits are the nearest whole number, and that whole number."""
    shifted = x + _ROUNDING
    return shifted, shifted - _ROUNDING


def _horner(x: Number, coefficients: list[float]) -> Number:
    total: Number = x.code.value(coefficients[-1])
    for coefficient in reversed(coefficients[:-1]):
        total = total * x + coefficient
    return total


def _whole(code: Any) -> ir.Type:
    return ir.VectorType(ir.IntType(64), code.width) if code.width else ir.IntType(64)


def _constant(code: Any, number: int) -> ir.Value:
    return ir.Constant(_whole(code), [number] * code.width if code.width else number)


def _bits(number: Value) -> ir.Value:
    return number.code.at.bitcast(number.primal, _whole(number.code))
