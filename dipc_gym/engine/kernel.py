"""The mechanics of one tree as machine code: mass matrix and bias forces, and how they change."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import Any

from llvmlite import ir

from dipc_gym.engine.code import Code, Numbers
from dipc_gym.engine.layout import Joint
from dipc_gym.engine.rigid import GEOMETRY, GRAVITY, LINK, Mechanics, Tree
from dipc_gym.engine.values import LANES, POINTER, REAL, Value, sin_cos, where


@functools.lru_cache(maxsize=256)
def write_kernel(tree: Tree) -> str:
    """The module of a tree.

    It has `primal(q, v, numbers, joints, matrix, bias)`, which fills the mass matrix (n, n) up to its diagonal, what
    `joints` says of armatures included; `free`, `bound` and `solve`, see `write_solver`, with `solve_tangents(factor,
    x)` for x (n, LANES); and `tangent(q, v, a, numbers, dq, dv, dnumbers, dforces)`, how the forces of a motion change;
    tangents are (.., LANES).
    """
    module = ir.Module("kernel")
    write_primal(module, tree)
    write_solver(module, tree)
    _solve_tangents(module, len(tree.parents))
    _tangent(module, tree)
    return str(module)


def write_primal(module: ir.Module, tree: Tree, *, width: int = 0) -> None:
    """Write `primal`, of one configuration or of `width` at once, for the same module."""
    code, count = Code(module, "primal", [POINTER] * 6, internal=bool(width), width=width), len(tree.parents)
    q, v, numbers, joints, matrix, bias = (code.numbers(argument) for argument in code.function.args)
    mechanics = Mechanics(tree, _Fixed(tree, numbers), [q[i] for i in range(count)], sin_cos)
    for i, force in enumerate(mechanics.forces([v[i] for i in range(count)], [0.0] * count)):
        bias[i] = force
    for i, row in enumerate(mechanics.inertia()):
        for j in range(i + 1):
            matrix[i * count + j] = row[j] + joints[i * Joint.SIZE + Joint.ARMATURE] if i == j else row[j]
    code.finish()


def write_solver(module: ir.Module, tree: Tree, *, width: int = 0) -> None:
    """Write `free(matrix, x, factor)`, which factorises and solves for x (n,) in place, and `solve(factor, x)`; of one
    system also `bound(matrix, held, x, factor)`, for which rows and columns with `held` (n,) above zero are those of a
    unit matrix.

    The factors are L D L' of a matrix that is filled up to its diagonal, with 1 / D in the place of D. Blocks of D have
    two rows: what follows waits for each division, so the fewer the better.
    """
    count = len(tree.parents)
    for name in ("free",) if width else ("free", "bound"):
        code = Code(module, name, [POINTER] * (3 + (name == "bound")), internal=bool(width), width=width)
        matrix, *held, x, factor = (code.numbers(argument) for argument in code.function.args)
        found = _factorised(_entries(matrix, held[0] if held else None, count), count)
        _substitute(found, x, count)
        for (row, column), number in found.items():
            factor[row * count + column] = number
        code.finish()
    code = Code(module, "solve", [POINTER] * 2, internal=bool(width), width=width)
    factor, x = (code.numbers(argument) for argument in code.function.args)
    _substitute({at: factor[at[0] * count + at[1]] for at in _lower(count)}, x, count)
    code.finish()


def _solve_tangents(module: ir.Module, count: int) -> None:
    code = Code(module, "solve_tangents", [POINTER] * 2, width=LANES)
    factor, x = code.function.args
    scalars = {
        at: code.at.load(code.offset(factor, at[0] * count + at[1], REAL), align=8, typ=REAL) for at in _lower(count)
    }
    _substitute({at: Value(code, code.splat(one)) for at, one in scalars.items()}, code.numbers(x), count)
    code.finish()


def _lower(count: int) -> list[tuple[int, int]]:
    return [(i, j) for i in range(count) for j in range(i + 1)]


def _entries(matrix: Numbers, held: Numbers | None, count: int) -> dict[tuple[int, int], Value]:
    """Entries of a matrix up to its diagonal, some rows and columns those of a unit matrix."""
    entries = {(i, j): matrix[i * count + j] for i, j in _lower(count)}
    if held is None:
        return entries
    code, holds = matrix.code, [held[i] > 0 for i in range(count)]
    return {
        (i, j): where(holds[i] if i == j else code.any_of(holds[i], holds[j]), float(i == j), entry)
        for (i, j), entry in entries.items()
    }


def _blocks(count: int) -> list[range]:
    return [range(i, min(i + 2, count)) for i in range(0, count, 2)]


def _factorised(entries: dict[tuple[int, int], Value], count: int) -> dict[tuple[int, int], Value]:
    """L, and in its diagonal blocks the inverse of D; up to the diagonal."""
    blocks, scaled = _blocks(count), dict(entries)  # L D, as far as it is known
    out: dict[tuple[int, int], Value] = {}
    for b, rows in enumerate(blocks):
        for columns in blocks[:b]:
            for i in rows:
                for j in columns:
                    for k in range(columns.start):
                        scaled[i, j] = scaled[i, j] - scaled[i, k] * out[j, k]
                for j in columns:
                    terms = [scaled[i, k] * out[max(j, k), min(j, k)] for k in columns]
                    out[i, j] = sum(terms[1:], terms[0])
        for i in rows:
            for j in range(rows.start, i + 1):
                for k in range(rows.start):
                    scaled[i, j] = scaled[i, j] - scaled[i, k] * out[j, k]
        i, j = rows[0], rows[-1]
        if i == j:
            out[i, i] = 1.0 / scaled[i, i]
            continue
        one, both, other = scaled[i, i], scaled[j, i], scaled[j, j]
        inverse = 1.0 / (one * other - both * both)
        out[i, i], out[j, i], out[j, j] = other * inverse, -both * inverse, one * inverse
    return out


def _substitute(factor: dict[tuple[int, int], Value], places: Numbers, count: int) -> None:
    """Solve with factors, in place."""
    x, blocks = [places[i] for i in range(count)], _blocks(count)
    for rows in blocks:
        for i in rows:
            for j in range(rows.start):
                x[i] = x[i] - factor[i, j] * x[j]
    for rows in reversed(blocks):
        terms = [[factor[max(i, j), min(i, j)] * x[j] for j in rows] for i in rows]
        for i, row in zip(rows, terms, strict=True):
            x[i] = sum(row[1:], row[0])
            for j in range(rows.stop, count):
                x[i] = x[i] - factor[j, i] * x[j]
    for i in range(count):
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
