"""A law that a diagnosis found, as a table and as a C function: for a simulator or a controller of one's own."""

from __future__ import annotations

import csv
import io
import math
import re
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from string import Template
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

import dipc_gym
from dipc_gym.export.c import literal, named, plain
from dipc_gym.safety.naming import suggestion
from dipc_gym.safety.untrusted import Format, first_line, shown

__all__ = ["Law", "LawError", "read"]

Array = NDArray[np.float64]


class LawError(ValueError):
    """A diagnosis that holds no such law, or one that is none; the message says what is wrong and what to do."""


FORMAT = Format("diagnosis", "dipc-gym diagnose", "diagnose again", 50_000_000, LawError)
SCHEMAS = ("dipc-gym/diagnosis/2", "dipc-gym/diagnosis/3")
MOST = 4096  # levels of a table
RESERVED = frozenset(
    """auto break case char const continue default do double else enum extern float for goto if inline int long main
    register restrict return short signed sizeof static struct switch typedef union unsigned void volatile while
    abs acos asin assert atan bool catch class cos cosh delete div erf exp false floor fmod free friend gamma log malloc
    mutable namespace new operator pow printf private protected public rand remove round signal sin sinh sqrt system tan
    tanh template this throw time true try using virtual
    """.split()  # noqa: SIM905  # as a list it is forty lines
)
KEY, LABEL, SENTENCE = 200, 300, 1000  # characters of an effect's or a place's name, and of what speaks of such


@dataclass(frozen=True)
class Input:
    """What a law depends on.

    Attributes:
        name: `position`, or `velocity pole1` of a law that may depend on other joints.
        unit: SI.
        knots: where it has its values, increasing, (k,).
        data: from where to where data told these; None where that is from the first knot to the last.
    """

    name: str
    unit: str
    knots: Array
    data: tuple[float, float] | None = None

    @property
    def told(self) -> tuple[float, float]:
        """From where to where data told its values."""
        return self.data or (float(self.knots[0]), float(self.knots[-1]))


@dataclass(frozen=True)
class Law:
    """A table of one or two inputs, piecewise linear between its knots.

    Attributes:
        key: `effect@place`.
        kind: what its values are, in words.
        unit: of these.
        inputs: one or two.
        levels: (m,), or (m, n) with a row over the second input for each knot of the first.
        outside: beyond its knots it goes on as it ends, or parallel to its input.
        driven_up_to: speed of the joint from which a force along the motion fades, to nothing at twice of it; None for
            a law that is not limited so. Such a law takes the joint's speed as one more input.
        remembers: of an input that no sensor reads, how it comes about; None where there is none.

    Example:
        >>> spring = Law("load.position@cart", "force", "N", (Input("position", "m", np.array([-1.0, 1.0])),),
        ...              np.array([4.0, -4.0]))
        >>> spring([0.5, 3.0]).tolist()
        [-2.0, -4.0]
    """

    key: str
    kind: str
    unit: str
    inputs: tuple[Input, ...]
    levels: Array
    outside: Literal["constant", "parallel"] = "constant"
    driven_up_to: float | None = None
    remembers: str | None = None

    def __post_init__(self) -> None:
        shape = tuple(len(one.knots) for one in self.inputs)
        if not 1 <= len(shape) <= 2 or min(shape) < 2 or math.prod(shape) > MOST:
            raise LawError(
                f"{self.key}: a table of {' x '.join(map(str, shape))} levels; one or two inputs, at most {MOST}"
            )
        if self.levels.shape != shape:
            raise LawError(f"{self.key}: levels of shape {self.levels.shape} for knots of {shape}")
        for one in self.inputs:
            if not (np.isfinite(one.knots).all() and np.all(np.diff(one.knots) > 0)):
                raise LawError(f"{self.key}: the knots along {one.name} do not increase, or are not finite")
        if not np.isfinite(self.levels).all():
            raise LawError(f"{self.key}: a level is not a finite number")
        if self.outside not in ("constant", "parallel") or (self.outside == "parallel" and len(shape) > 1):
            raise LawError(
                f"{self.key}: outside is {shown(self.outside)}; it can be 'constant', or 'parallel' of one input"
            )
        if self.driven_up_to is not None and not 0 < self.driven_up_to < math.inf:
            raise LawError(f"{self.key}: driven_up_to is {self.driven_up_to}; it is a positive speed")

    def __call__(self, *inputs: ArrayLike, speed: ArrayLike | None = None) -> Array:
        """The law at its inputs, (n,) each.

        Args:
            inputs: as many as `inputs`, in their units.
            speed: of the joint, m/s or rad/s; needed where `driven_up_to` says so.

        Raises:
            TypeError: the wrong number of inputs, or no speed.
        """
        if len(inputs) != len(self.inputs) or (speed is None) != (self.driven_up_to is None):
            more = "" if self.driven_up_to is None else ", and speed="
            raise TypeError(f"{self.key} takes {', '.join(one.name for one in self.inputs)}{more}")
        given = np.broadcast_arrays(*(np.asarray(one, dtype=float) for one in inputs))
        below, share = zip(*(_place(one.knots, x) for one, x in zip(self.inputs, given, strict=True)), strict=True)
        if len(given) == 1:
            (k,), (s,) = below, share
            value = self.levels[k] + s * (self.levels[k + 1] - self.levels[k])
        else:
            (i, j), (s, t) = below, share
            one, other = (self.levels[r, j] + t * (self.levels[r, j + 1] - self.levels[r, j]) for r in (i, i + 1))
            value = one + s * (other - one)
        if self.outside == "parallel":
            value = value + (given[0] - np.clip(given[0], self.inputs[0].knots[0], self.inputs[0].knots[-1]))
        if self.driven_up_to is None:
            return np.asarray(value)
        v = np.asarray(speed, dtype=float)
        left = 1.0 - np.clip(np.abs(v) / self.driven_up_to - 1.0, 0.0, 1.0)
        return np.asarray(np.where(value * v > 0, value * left, value))

    def csv(self) -> str:
        """The table: a column for each input and one for the law, names with units in the first row."""
        out = io.StringIO()
        rows = csv.writer(out, lineterminator="\n")
        rows.writerow([*(_column(one.name, one.unit) for one in self.inputs), _column(self.kind, self.unit)])
        for place in np.ndindex(*self.levels.shape):
            at = [float(one.knots[k]) for one, k in zip(self.inputs, place, strict=True)]
            rows.writerow([*map(repr, at), repr(float(self.levels[place]))])
        return out.getvalue()

    def c(self, name: str) -> str:
        """A C99 header with one function, `NAME(inputs)`; a law that is `driven_up_to` takes the speed as the last.

        Args:
            name: of the function, and before all other names; small letters, digits and _.

        Raises:
            ValueError: the name is no C identifier.
            program.NoForm: a number is too large for single precision.
        """
        if not re.fullmatch(r"[a-z_][a-z0-9_]{0,40}", name):
            raise ValueError(f"{name!r} cannot name a C function: small letters, digits and _")
        if name in RESERVED:
            raise ValueError(
                f"{name!r} is a word of C or its library, and cannot name a function; name the file otherwise"
            )
        names = ["x", "y"][: len(self.inputs)]
        words = [
            f"{letter}: {plain(one.name)}, {plain(one.unit) or 'as commanded'}; data from {one.told[0]:g} to "
            f"{one.told[1]:g}."
            for letter, one in zip(names, self.inputs, strict=True)
        ]
        beyond = "stays as it ends" if self.outside == "constant" else "goes on in parallel with x"
        words.append(f"Between its knots it goes straight; beyond them it {beyond}.")
        if self.driven_up_to is not None:
            names.append("speed")
            words.append(f"speed: of the joint, SI; from {self.driven_up_to:g} on, a force along it fades.")
        if self.remembers is not None:
            words += textwrap.wrap(plain(self.remembers), 110)
        words.append(f"{' or '.join(names[: len(self.inputs)])} that is not a number gives what is not a number.")
        text = _HEADER.substitute(
            title=plain(f"{self.key}: {self.kind}{f', {self.unit}' if self.unit else ''}."),
            about="\n".join(f" * {line}" for line in words),
            version=dipc_gym.__version__,
            macro=name.upper(),
            name=name,
            parameters=", ".join(f"@_real {one}" for one in names),
            tables="\n".join(_tables(self)),
            body="\n".join(_body(self)),
        )
        return named(text, name)


def read(path: str | Path, key: str | None = None) -> Law:
    """A law of a diagnosis.

    Args:
        path: of its `diagnosis.json`.
        key: which, as `friction.position@cart`; None where there is one.

    Raises:
        LawError: the file is no diagnosis, holds no such law, or one that is none.
    """
    found = FORMAT.read(path)
    if not isinstance(found, dict) or found.get("schema") not in SCHEMAS or not isinstance(found.get("missing"), list):
        raise LawError(
            f"{path}: not a diagnosis of schema {' or '.join(SCHEMAS)}; give the diagnosis.json that dipc-gym diagnose "
            "wrote"
        )
    laws = {}
    for i, one in enumerate(found["missing"]):
        if isinstance(one, dict) and isinstance(one.get("law"), dict):
            try:
                laws[f"{_words(one['effect'], KEY)}@{_words(one['at'], KEY)}"] = one["law"]
            except (KeyError, ValueError) as error:
                raise LawError(f"{path}: missing[{i}]: effect and at must name the law ({error})") from None
    if not laws:
        raise LawError(f"{path}: it holds no law; only effects whose shape is free have one")
    if key is None and len(laws) > 1:
        raise LawError(f"{path}: it holds {', '.join(laws)}; say --law which of them")
    if key is not None and key not in laws:
        raise LawError(f"{path}: no law {key!r}; there are {', '.join(laws)}{suggestion(key, list(laws))}")
    name = key or next(iter(laws))
    try:
        return _law(name, laws[name])
    except (ArithmeticError, KeyError, TypeError, ValueError, AttributeError) as error:
        said = f"{name}: not a law ({type(error).__name__}: {first_line(error)})"
        why = str(error) if isinstance(error, LawError) else said
        raise LawError(f"{path}: {why}") from None


def is_diagnosis(path: str | Path) -> bool:
    """Whether a file says that it is a diagnosis."""
    try:
        found = FORMAT.read(path)
    except LawError:
        return False
    return isinstance(found, dict) and str(found.get("schema")).startswith("dipc-gym/diagnosis/")


def _law(key: str, said: dict[str, Any]) -> Law:
    table = said["table"]
    inputs = tuple(
        Input(_words(one["name"]), _words(one["unit"]), np.array(one["knots"], dtype=float), (float(low), float(high)))
        for one, (low, high) in zip(table["inputs"], said["supported"][: len(table["inputs"])], strict=True)
    )
    limit = said.get("driven_up_to")
    return Law(
        key,
        _words(said["kind"]),
        _words(table["unit"]),
        inputs,
        np.array(table["levels"], dtype=float),
        said["outside"],
        None if limit is None else float(limit),
        None if said.get("remembers") is None else _words(said["remembers"], SENTENCE),
    )


def _words(value: Any, most: int = LABEL) -> str:
    """Text that can stand in a table's head and on a terminal.

    Raises:
        ValueError: it is none.
    """
    if not isinstance(value, str) or len(value) > most or not value.isprintable():
        raise ValueError(f"{shown(value)} is no text of at most {most} characters that can be printed")
    return value


def _place(knots: Array, x: Array) -> tuple[NDArray[np.intp], Array]:
    """Entries below, and how far from them to the next, 0 to 1; NaN of what is none."""
    k = np.clip(np.searchsorted(knots, x, side="right") - 1, 0, len(knots) - 2)
    return k, np.clip((x - knots[k]) / (knots[k + 1] - knots[k]), 0.0, 1.0)


def _column(name: str, unit: str) -> str:
    """Name and unit of a column, without what a spreadsheet would take for a formula."""
    words = f"{name}, {unit}" if unit else name
    return words if words[:1].isalnum() else f"'{words}"


def _tables(law: Law) -> list[str]:
    named = {letter: one.knots for letter, one in zip(("along", "across"), law.inputs, strict=False)}
    lines = []
    for name, numbers in {**named, "levels": law.levels.ravel()}.items():
        texts = [literal(x) for x in numbers.tolist()]
        rows = [f"        {', '.join(texts[i : i + 3])}," for i in range(0, len(texts), 3)]
        lines += [f"    static const @_real {name}[{len(texts)}] = {{", *rows, "    };"]
    return lines


def _body(law: Law) -> list[str]:
    sizes: Sequence[int] = law.levels.shape
    if len(sizes) == 1:
        lines = [
            f"    const int k = @_below(along, {sizes[0]}, x);",
            "    const @_real share = @_share(along, k, x);",
            "    @_real value = levels[k] + share * (levels[k + 1] - levels[k]);",
        ]
    else:
        lines = [
            f"    const int i = @_below(along, {sizes[0]}, x), j = @_below(across, {sizes[1]}, y);",
            "    const @_real up = @_share(along, i, x), share = @_share(across, j, y);",
            f"    const @_real *const row = levels + {sizes[1]} * i + j, *const next = row + {sizes[1]};",
            "    const @_real one = row[0] + share * (row[1] - row[0]);",
            "    const @_real other = next[0] + share * (next[1] - next[0]);",
            "    @_real value = one + up * (other - one);",
        ]
    if law.outside == "parallel":
        last = sizes[0] - 1
        lines += [
            "    if (x < along[0])",
            "        value += x - along[0];",
            f"    if (x > along[{last}])",
            f"        value += x - along[{last}];",
        ]
    if law.driven_up_to is not None:
        lines += [
            "    if (value * speed > @_C(0.0)) {",
            f"        @_real over = (speed < @_C(0.0) ? -speed : speed) / {literal(law.driven_up_to)} - @_C(1.0);",
            "        over = over < @_C(0.0) ? @_C(0.0) : over > @_C(1.0) ? @_C(1.0) : over;",
            "        value *= @_C(1.0) - over;",
            "    }",
        ]
    return [*lines, "    return value;"]


_HEADER = Template("""\
/* $title
 *
$about
 *
 * No heap and nothing of the C library. Numbers are double; with ${macro}_FLOAT defined before the header is included,
 * they are float. Not for -ffast-math, which takes the check for what is not a number away.
 *
 * Written by dipc-gym $version.
 */
#ifndef ${macro}_H
#define ${macro}_H

#ifdef __FAST_MATH__
#error "compile without -ffast-math: it takes away the check for what is not a number"
#endif
#ifdef ${macro}_FLOAT
typedef float @_real;
#define @_C(x) x##f
#else
typedef double @_real;
#define @_C(x) x
#endif

/* The last knot that is not above x and has one above it. */
static inline int @_below(const @_real *knots, int count, @_real x)
{
    int low = 0, high = count - 1;
    while (high - low > 1) {
        const int middle = low + (high - low) / 2;
        if (x < knots[middle])
            high = middle;
        else
            low = middle;
    }
    return low;
}

/* How far x is from a knot to the next, 0 to 1. */
static inline @_real @_share(const @_real *knots, int k, @_real x)
{
    const @_real share = (x - knots[k]) / (knots[k + 1] - knots[k]);
    return share < @_C(0.0) ? @_C(0.0) : share > @_C(1.0) ? @_C(1.0) : share;
}

static inline @_real $name($parameters)
{
$tables
$body
}

#endif
""")
