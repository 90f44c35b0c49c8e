"""The mechanics of one tree as machine code: mass matrix and bias forces, and how they change."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import Any

from llvmlite import ir

from dipc_gym.engine.rigid import GEOMETRY, GRAVITY, LINK, Mechanics, Tree
from dipc_gym.engine.values import POINTER, Code, Value, sin_cos


@functools.lru_cache(maxsize=256)
def write_kernel(tree: Tree) -> str:
    """The module of a tree.

    It has `primal(q, v, numbers, matrix, bias)`, which fills the mass matrix (n, n) up to its diagonal, and
    `tangent(q, v, a, numbers, dq, dv, dnumbers, dforces)`, how the forces of a motion change; tangents are (.., LANES).
    """
    module = ir.Module("kernel")
    write_primal(module, tree)
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
