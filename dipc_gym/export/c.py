"""A program as one C99 header, and as a C file that checks the header on known numbers."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from string import Template

import numpy as np

from dipc_gym.dataflow import ELEMENTWISE, REDUCTIONS, Floats, NoForm, Program, Step

DEEPEST = 5
"""Operations that may stand in one expression; more are hard to read."""
_SAID = "\0_"  # stands for `@_` in words, where no name of this text is meant
LARGEST = 1e37
"""Of a number in single precision; what is closer to zero than its inverse is zero."""

_FORMS = {
    "add": "({0} + {1})",
    "subtract": "({0} - {1})",
    "multiply": "({0} * {1})",
    "divide": "({0} / {1})",
    "minimum": "@_min({0}, {1})",
    "maximum": "@_max({0}, {1})",
    "less": "@_less({0}, {1})",
    "within": "@_within({0}, {1})",
    "choose": "@_choose({0}, {1}, {2})",
    "exp": "@_EXP({0})",
    "tanh": "@_tanh({0})",
    "sigmoid": "@_sigmoid({0})",
}

_HELPERS = {
    "min": "a < b ? a : b",
    "max": "a > b ? a : b",
    "less": "a < b ? @_C(1.0) : @_C(0.0)",
    "within": "a < b && -b < a ? @_C(1.0) : @_C(0.0)",
}

_USERS = {"min": {"minimum", "least"}, "max": {"maximum"}, "less": {"less"}, "within": {"within"}}

_TANH = """\
/* Without cancellation on either side of one half, and without overflow. */
static inline @_real @_tanh(@_real x)
{
    const @_real a = x < @_C(0.0) ? -x : x, s = x * x, t = @_EXP(@_C(-2.0) * a);
    if (a < @_C(0.5)) {
        const @_real tail = @_C(7.0) + s / (@_C(9.0) + s / (@_C(11.0) + s / @_C(13.0)));
        return x / (@_C(1.0) + s / (@_C(3.0) + s / (@_C(5.0) + s / tail)));
    }
    return (x < @_C(0.0) ? t - @_C(1.0) : @_C(1.0) - t) / (@_C(1.0) + t);
}
"""

_SIGMOID = """\
static inline @_real @_sigmoid(@_real x)
{
    const @_real e = @_EXP(x < @_C(0.0) ? x : -x);
    return (x < @_C(0.0) ? e : @_C(1.0)) / (@_C(1.0) + e);
}
"""

_CHOOSE = """\
static inline @_real @_choose(@_real test, @_real yes, @_real no)
{
    return test > @_C(0.5) ? yes : no;
}
"""

_HEADER = Template("""\
/* $title
 *
$about
 *
 * Worst case of one call: $cost.
 * State: $state numbers. Constants: $constants numbers. Locals: $locals numbers.
 * No heap, no recursion, no loop of unknown length; of the C library $library.
 *
 * Numbers are double; with $macro_FLOAT defined before the header is included, they are float.
 * Not for -ffast-math, which takes the checks of readings away.
 */
#ifndef $macro_H
#define $macro_H

#ifdef __FAST_MATH__
#error "compile without -ffast-math: it takes away the checks for readings that are not numbers"
#endif
$include
#ifdef $macro_FLOAT
typedef float $name_real;
#define $name_C(x) x##f
#define $name_EXP(x) expf(x)
#else
typedef double $name_real;
#define $name_C(x) x
#define $name_EXP(x) exp(x)
#endif

/* What the loop remembers. Reset it before the first call. */
typedef struct {
$members
} $name_state;

$helpers
static inline void $name_reset($name_state *state)
{
$reset
}

$described
static inline $name_real $name_step($name_state *state, $parameters)
{
$body
}

#endif
""")

_CHECK = Template("""\
/* Checks $header on $count control periods whose voltages Python computed in double precision.
 *
 *     cc -std=c99 $file -lm && ./a.out
 *     cc -std=c99 -D$macro_FLOAT $file -lm && ./a.out
 *
 * A line is: 1 to reset first, $inputs, $output.
 */
#include <stdio.h>
#include "$header"

static const double vectors[$count][$columns] = {
$rows
};

int main(void)
{
    $name_state state;
    double largest = 0.0;
    int i;
    $name_reset(&state);
    for (i = 0; i < $count; i++) {
        const double *row = vectors[i];
        double error;
        if (row[0] > 0.5)
            $name_reset(&state);
        error = (double)$name_step(&state, $arguments) - row[$last];
        error = error < 0.0 ? -error : error;
        if (!(error <= largest))
            largest = error;
    }
    printf("$count periods, largest difference %g\\n", largest);
    return !(largest <= (sizeof($name_real) == sizeof(float) ? $single : $double));
}
""")


@dataclass(frozen=True)
class Header:
    """Names and words for the C text.

    Attributes:
        name: prefix of all its names, a C identifier.
        title: first line of its comment.
        about: further lines.
        inputs: meaning and unit of each input.
        output: the same of the result.

    Raises:
        ValueError: the name is no C identifier.
    """

    name: str
    title: str
    about: Sequence[str]
    inputs: Mapping[str, str]
    output: str

    def __post_init__(self) -> None:
        if not re.fullmatch(r"[a-z_][a-z0-9_]{0,40}", self.name):
            raise ValueError(f"{self.name!r} cannot stand before the names of a C header: small letters, digits and _")


def header(program: Program, words: Header) -> str:
    """The header's text: `NAME_state`, `NAME_reset` and `NAME_step`.

    Args:
        program: with one output of size 1.
        words: names and comments.

    Raises:
        NoForm: a number is too large for single precision.
    """
    writer = _Writer(program)
    body = writer.body()
    name, used = words.name, {step.operation for step in program.steps}
    needs_exp = used & {"exp", "tanh", "sigmoid"}
    helpers = [
        f"static inline @_real @_{short}(@_real a, @_real b)\n{{\n    return {text};\n}}\n"
        for short, text in _HELPERS.items()
        if used & _USERS[short]
    ]
    helpers += [text for key, text in (("choose", _CHOOSE), ("tanh", _TANH), ("sigmoid", _SIGMOID)) if key in used]
    states = [program.steps[place] for place in program.states.values()]
    reset = []
    for state in states:
        reset += [f"    state->{_at(state, k)} = {literal(x)};" for k, x in enumerate(state.numbers.tolist())]
    cost = program.cost()
    order = ("additions", "multiplications", "divisions", "comparisons", "exponentials")
    constants = sum(s.numbers.size + s.weights.size for s in program.steps if s.operation in ("constant", "affine"))
    text = _HEADER.substitute(
        title=plain(words.title),
        about="\n".join(f" * {plain(line)}".rstrip() for line in words.about),
        cost=", ".join(f"{cost[k]} {k if cost[k] > 1 else k[:-1]}" for k in order if cost[k]),
        state=sum(state.size for state in states),
        constants=constants,
        locals=writer.locals,
        library="exp, or expf, only" if needs_exp else "nothing",
        macro=name.upper(),
        macro_H=f"{name.upper()}_H",
        macro_FLOAT=f"{name.upper()}_FLOAT",
        include="\n#include <math.h>\n" if needs_exp else "",
        name=name,
        name_real="@_real",
        name_C="@_C",
        name_EXP="@_EXP",
        name_state="@_state",
        name_reset="@_reset",
        name_step="@_step",
        members="\n".join(f"    @_real {s.name}{f'[{s.size}]' if s.size > 1 else ''};" for s in states),
        helpers="\n".join(helpers),
        reset="\n".join(reset),
        described=_described(program, words),
        parameters=", ".join(f"@_real {key}" for key in program.inputs),
        body=body,
    )
    return named(text, name)


def check(
    program: Program, words: Header, *, header_name: str, file_name: str, vectors: Floats, tolerance: float
) -> str:
    """A C program that runs the header on test vectors and returns 0 if it agrees.

    Args:
        program: of the header.
        words: of the header.
        header_name: file of the header.
        file_name: of this program.
        vectors: (periods, 2 + inputs): whether to reset first, the inputs, the output.
        tolerance: largest difference in double precision. Single precision has 2^29 times as large a rounding. A loop
            that adds up its own voltages gathers rounding: twice what NumPy gathers in single precision is let pass,
            and its 2^29th part in double.
    """
    gathered = 2 * _gathered(program, vectors)
    rows = ",\n".join(f"    {{{', '.join(repr(x) for x in row)}}}" for row in vectors.tolist())
    name, inputs = words.name, program.inputs
    text = _CHECK.substitute(
        header=header_name,
        file=file_name,
        count=len(vectors),
        columns=vectors.shape[1],
        inputs=", ".join(inputs),
        output=next(iter(program.outputs)),
        macro_FLOAT=f"{name.upper()}_FLOAT",
        rows=rows,
        name_state="@_state",
        name_reset="@_reset",
        name_step="@_step",
        name_real="@_real",
        arguments=", ".join(f"(@_real)row[{i}]" for i in range(1, len(inputs) + 1)),
        last=len(inputs) + 1,
        single=repr(max(tolerance * 2.0**29, gathered)),
        double=repr(max(tolerance, gathered / 2.0**29)),
    )
    return named(text, name)


def _gathered(program: Program, vectors: Floats) -> float:
    """Largest difference of the output in single precision, operation by operation, on test vectors."""
    largest, memory = 0.0, program.memory(dtype=np.float32)
    for row in vectors:
        if row[0] > 0.5:
            memory = program.memory(dtype=np.float32)
        with np.errstate(over="ignore"):
            given = {name: row[i : i + 1].astype(np.float32) for i, name in enumerate(program.inputs, 1)}
        outputs, memory = program.run(given, memory, np.float32)
        largest = max(largest, float(abs(next(iter(outputs.values()))[0, 0] - row[-1])))
    return largest


def literal(number: float) -> str:
    """A number as C reads it, in either precision.

    Raises:
        NoForm: it is too large for single precision.
    """
    if abs(number) > LARGEST:
        raise NoForm(f"the number {number:g} is too large for single precision")
    return f"@_C({0.0 if abs(number) < 1 / LARGEST else number!r})"


class _Writer:
    """Writes the body of the step function."""

    def __init__(self, program: Program) -> None:
        self.program, self.steps = program, program.steps
        self.uses: dict[int, list[int]] = {place: [] for place in range(len(self.steps))}
        for place, step in enumerate(self.steps):
            for operand in step.operands:
                self.uses[operand].append(place)
        self.kept = {*program.updates.values(), *program.outputs.values()}
        self.locals = 0
        self.inlined = self._inlined()

    def _inlined(self) -> set[int]:
        """Values that stand inside the one expression that uses them, so that they take no memory."""
        found: set[int] = set()
        depth = [0] * len(self.steps)
        for place, step in enumerate(self.steps):
            depth[place] = 1 + sum(depth[operand] for operand in step.operands if operand in found)
            if step.operation not in ELEMENTWISE or place in self.kept or len(self.uses[place]) != 1:
                continue
            user = self.steps[self.uses[place][0]]
            span = self.steps[user.operands[0]].size if user.operation in REDUCTIONS else user.size
            if user.operation in (*ELEMENTWISE, *REDUCTIONS) and span == step.size and depth[place] < DEEPEST:
                found.add(place)
        return found

    def body(self) -> str:
        needed = self._needed()
        lines: list[str] = []
        for place, step in enumerate(self.steps):
            if step.operation == "comment":
                lines += ["", f"    /* {plain(step.name)} */"]
            elif place in needed and place not in self.inlined:
                lines += self._statement(place, step)
        lines += ["", "    /* What is remembered */"]
        for state, value in self.program.updates.items():
            step = self.steps[state]
            target, source = f"state->{step.name}", self._entry(value, "i")
            lines += self._loop(step.size, f"{target}{'[i]' if step.size > 1 else ''} = {source};")
        (result,) = self.program.outputs.values()
        return "\n".join([*lines, f"    return {self._entry(result, 'i')};"]).lstrip("\n")

    def _needed(self) -> set[int]:
        found, ahead = set(), list(self.kept)
        while ahead:
            place = ahead.pop()
            if place not in found:
                found.add(place)
                ahead += self.steps[place].operands
        return found

    def _statement(self, place: int, step: Step) -> list[str]:
        name = f"v{place}"
        match step.operation:
            case "input" | "state":
                return []
            case "constant":
                return [] if step.size == 1 else _table(f"c{place}", step.numbers)
            case "total" | "least":
                operand = step.operands[0]
                self.locals += 1
                each = self._entry(operand, "i")
                each = f"{name} += {_bare(each)};" if step.operation == "total" else f"{name} = @_min({each}, {name});"
                first = self._entry(operand, "0")
                size = self.steps[operand].size
                return [f"    @_real {name} = {_bare(first)};", *self._loop(size, each, first=1)]
            case "affine":
                self.locals += step.size
                return self._affine(place, step)
            case "join":
                self.locals += step.size
                lines, start = [f"    @_real {name}[{step.size}];"], 0
                for operand in step.operands:
                    size = self.steps[operand].size
                    target = f"{name}[{start} + i]" if size > 1 else f"{name}[{start}]"
                    lines += self._loop(size, f"{target} = {self._entry(operand, 'i')};")
                    start += size
                return lines
            case "part":
                return []
            case "pick":
                return _places(f"p{place}", step.places) if self.steps[step.operands[0]].size > 1 else []
            case "product":
                self.locals += step.size
                return self._product(place, step)
        self.locals += step.size
        if step.size == 1:
            return [f"    const @_real {name} = {_bare(self._expression(place, 'i'))};"]
        return [
            f"    @_real {name}[{step.size}];",
            *self._loop(step.size, f"{name}[i] = {_bare(self._expression(place, 'i'))};"),
        ]

    def _affine(self, place: int, step: Step) -> list[str]:
        rows, columns = step.weights.shape
        (operand,) = step.operands
        lines = _table(f"w{place}", step.weights.ravel())
        if rows == 1:
            lines += [f"    @_real v{place} = {literal(step.numbers.tolist()[0])};"]
            index = "i" if columns > 1 else "0"
            return lines + self._loop(columns, f"v{place} += w{place}[{index}] * {self._entry(operand, 'i')};")
        lines += _table(f"b{place}", step.numbers)
        inner = f"for (j = 0; j < {columns}; j++)"
        product = f"v{place}[i] += w{place}[{columns} * i + j] * {self._entry(operand, 'j')};"
        return [
            *lines,
            f"    @_real v{place}[{rows}];",
            "    {",
            "        int i, j;",
            f"        for (i = 0; i < {rows}; i++) {{",
            f"            v{place}[i] = b{place}[i];",
            f"            {inner}",
            f"                {product}",
            "        }",
            "    }",
        ]

    def _product(self, place: int, step: Step) -> list[str]:
        a, b = step.operands
        rows, columns = (self.steps[operand].size // step.inner for operand in (a, b))
        first = f"{self._entry(a, f'{step.inner} * i')} * {self._entry(b, 'j')}"
        further = f"{self._entry(a, f'{step.inner} * i + k')} * {self._entry(b, f'{columns} * k + j')}"
        name = f"v{place}[{'i * (i + 1) / 2' if step.half else f'{columns} * i'} + j]" if step.size > 1 else f"v{place}"
        return [
            f"    @_real v{place}{f'[{step.size}]' if step.size > 1 else ''};",
            "    {",
            f"        int i, j{', k' if step.inner > 1 else ''};",
            f"        for (i = 0; i < {rows}; i++)",
            f"            for (j = 0; j {'<= i' if step.half else f'< {columns}'}; j++) {{",
            f"                @_real sum = {first};",
            *(
                [f"                for (k = 1; k < {step.inner}; k++)", f"                    sum += {further};"]
                if step.inner > 1
                else []
            ),
            f"                {name} = sum;",
            "            }",
            "    }",
        ]

    def _loop(self, size: int, statement: str, first: int = 0) -> list[str]:
        if size <= first:
            return []
        if size == 1:
            return [f"    {statement}"]
        return [f"    {{ int i; for (i = {first}; i < {size}; i++) {statement} }}"]

    def _entry(self, place: int, index: str) -> str:
        """One entry of a value, as an expression."""
        step = self.steps[place]
        at = f"[{index}]" if step.size > 1 else ""
        match step.operation:
            case "input":
                return step.name
            case "state":
                return f"state->{step.name}{at}"
            case "constant":
                return f"c{place}{at}" if step.size > 1 else literal(step.numbers.tolist()[0])
            case "part":
                whole = self.steps[step.operands[0]].size
                index = f"{step.start} + {index}" if step.size > 1 else str(step.start)
                return self._entry(step.operands[0], index if whole > 1 else "0")
            case "pick":
                chosen = f"p{place}[{index}]" if step.size > 1 else str(step.places[0])
                return self._entry(step.operands[0], chosen)
        return self._expression(place, index) if place in self.inlined else f"v{place}{at}"

    def _expression(self, place: int, index: str) -> str:
        step = self.steps[place]
        form = _FORMS[step.operation]
        entries = [self._entry(operand, index) for operand in step.operands]
        return form.format(*(map(_bare, entries) if form.startswith("@") else entries))


def _table(name: str, numbers: Floats) -> list[str]:
    """A constant array, three numbers a line."""
    texts = [literal(x) for x in np.asarray(numbers).tolist()]
    lines = [f"        {', '.join(texts[i : i + 3])}," for i in range(0, len(texts), 3)]
    return [f"    static const @_real {name}[{len(texts)}] = {{", *lines, "    };"]


def _places(name: str, places: Sequence[int]) -> list[str]:
    """A constant array of indices, sixteen a line."""
    if len(places) == 1:
        return []
    kind = "unsigned char" if max(places) < 256 else "unsigned short"
    lines = [f"        {', '.join(map(str, places[i : i + 16]))}," for i in range(0, len(places), 16)]
    return [f"    static const {kind} {name}[{len(places)}] = {{", *lines, "    };"]


def _bare(expression: str) -> str:
    """Without the outer pair of brackets, if it is one pair."""
    if not expression.startswith("("):
        return expression
    level = 0
    for k, letter in enumerate(expression):
        level += (letter == "(") - (letter == ")")
        if level == 0:
            return expression[1:-1] if k == len(expression) - 1 else expression
    return expression


def _at(state: Step, k: int) -> str:
    return f"{state.name}[{k}]" if state.size > 1 else state.name


def _described(program: Program, words: Header) -> str:
    lines = [f" * {name}: {plain(words.inputs[name])}" for name in program.inputs]
    return "\n".join(["/* One control period.", *lines, f" * Returns {plain(words.output)} */"])


def plain(text: str) -> str:
    """Words that cannot end a comment, in ASCII on one line."""
    ascii_text = text.encode("ascii", "replace").decode().replace("?", ".").replace("\\", "/")
    apart = re.sub(r"\*(?=/)|/(?=\*)", r"\g<0> ", ascii_text)
    return " ".join(apart.split()).replace("@_", _SAID)


def named(text: str, name: str) -> str:
    """C text with a name before all of its own names, `@_`."""
    return text.replace("@_", f"{name}_").replace(_SAID, "@_")
