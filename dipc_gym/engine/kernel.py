"""The mechanics of one tree as machine code: mass matrix and bias forces, and how they change."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import Any

from llvmlite import ir

from dipc_gym.engine.rigid import GEOMETRY, GRAVITY, LINK, Mechanics, Tree
from dipc_gym.engine.values import LANES, POINTER, REAL, Code, Numbers, Value, sin_cos, where


@functools.lru_cache(maxsize=256)
def write_kernel(tree: Tree) -> str:
    """The module of a tree.

    It has `primal(q, v, numbers, matrix, bias)`, which fills the mass matrix (n, n) up to its diagonal; `factorise` and
    `solve`, see `write_solver`, with `solve_tangents(factor, x)` for x (n, LANES); and `tangent(q, v, a, numbers, dq,
    dv, dnumbers, dforces)`, how the forces of a motion change; tangents are (.., LANES).
    """
    module = ir.Module("kernel")
    write_primal(module, tree)
    write_solver(module, tree)
    _solve_tangents(module, len(tree.parents))
    _tangent(module, tree)
    return str(module)


def write_primal(module: ir.Module, tree: Tree, *, width: int = 0) -> None:
    """Write `primal`, of one configuration or of `width` at once, for the same module."""
    code, count = Code(module, "primal", [POINTER] * 5, internal=bool(width), width=width), len(tree.parents)
    q, v, numbers, matrix, bias = (code.numbers(argument) for argument in code.function.args)
    mechanics = Mechanics(tree, _Fixed(tree, numbers), [q[i] for i in range(count)], sin_cos)
    for i, force in enumerate(mechanics.forces([v[i] for i in range(count)], [0.0] * count)):
        bias[i] = force
    for i, row in enumerate(mechanics.inertia()):
        for j in range(i + 1):
            matrix[i * count + j] = row[j]
    code.finish()


def write_solver(module: ir.Module, tree: Tree, *, width: int = 0) -> None:
    """Write `factorise(matrix, held, factor)` and `solve(factor, x)`, of one system or of `width` at once.

    The factors are L D L' of a matrix that is filled up to its diagonal, with 1 / D on the diagonal of L. Where `held`
    (n,) is not zero, rows and columns are those of a unit matrix; of several at once none is held.
    """
    count = len(tree.parents)
    code = Code(module, "factorise", [POINTER] * 3, internal=bool(width), width=width)
    matrix, held, factor = (code.numbers(argument) for argument in code.function.args)
    holds = [] if width else [held[i] > 0 for i in range(count)]
    unit = [code.value(0.0), code.value(1.0)]
    lower: list[list[Value]] = []
    for i in range(count):
        scaled: list[Value] = []
        row: list[Value] = []
        for j in range(i + 1):
            entry = matrix[i * count + j]
            if holds:
                entry = where(code.any_of(holds[i], holds[j]) if i != j else holds[i], unit[i == j], entry)
            for k in range(j):
                entry = entry - scaled[k] * (lower[j][k] if j < i else row[k])
            scaled.append(entry)
            row.append(entry * lower[j][j] if j < i else 1.0 / entry)
            factor[i * count + j] = row[j]
        lower.append(row)
    code.finish()
    code = Code(module, "solve", [POINTER] * 2, internal=bool(width), width=width)
    places = code.numbers(code.function.args[1])
    _substitute(code.numbers(code.function.args[0]).__getitem__, places, count)
    code.finish()


def _solve_tangents(module: ir.Module, count: int) -> None:
    code = Code(module, "solve_tangents", [POINTER] * 2, width=LANES)
    factor, places = code.function.args

    def entry(k: int) -> Value:
        return Value(code, code.splat(code.at.load(code.offset(factor, k, REAL), align=8, typ=REAL)))

    _substitute(entry, code.numbers(places), count)
    code.finish()


def _substitute(factor: Callable[[int], Value], places: Numbers, count: int) -> None:
    """Solve with factors, in place."""
    x = [places[i] for i in range(count)]
    for i in range(count):
        for j in range(i):
            x[i] = x[i] - factor(i * count + j) * x[j]
    for i in reversed(range(count)):
        x[i] = x[i] * factor(i * count + i)
        for j in range(i + 1, count):
            x[i] = x[i] - factor(j * count + i) * x[j]
        places[i] = x[i]


def _tangent(module: ir.Module, tree: Tree) -> None:
    code, count = Code(module, "tangent", [POINTER] * 8, tangents=True), len(tree.parents)
    q, v, a, numbers, dq, dv, dnumbers, out = code.function.args
    places, speeds = code.numbers(q, dq), code.numbers(v, dv)
    accelerations = [code.numbers(a).plain(i) for i in range(count)]
    mechanics = Mechanics(
        tree, _Fixed(tree, code.numbers(numbers, dnumbers)), [places[i] for i in range(count)], sin_cos
    )
    forces = mechanics.forces([speeds[i] for i in range(count)], accelerations)
    for i, force in enumerate(forces):
        tangent = force.tangent if isinstance(force, Value) and force.tangent is not None else None
        if tangent is None:
            tangent = code.splat(code.value(0.0).primal)
        code.at.store(tangent, code.offset(out, i, tangent.type), align=8)
    code.finish()


class _Fixed(Sequence[Any]):
    """Numbers of a tree: those that are fixed, and the others from memory.

    Those of the geometry carry no tangents: hypotheses seldom move joints, and the code would be half as long again.
    """

    def __init__(self, tree: Tree, numbers: Any) -> None:
        self.fixed, self.numbers, self.total = dict(tree.fixed), numbers, tree.count

    def __len__(self) -> int:
        return self.total

    def __getitem__(self, index: Any) -> Any:
        if index in self.fixed:
            return self.fixed[index]
        solid = index >= GRAVITY and (index - GRAVITY) % LINK < GEOMETRY
        return self.numbers.plain(index) if solid else self.numbers[index]
