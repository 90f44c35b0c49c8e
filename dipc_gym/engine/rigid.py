"""Mechanics of a tree of hinges and slides: forces of a motion, and the mass matrix.

Each joint has a link, whose frame has its z axis along the joint: rotation about z, or translation along it. In these
frames a hinge needs one sine and one cosine, and where axes are parallel or square to each other most numbers of the
geometry are 0 or 1. Numbers may be floats, arrays, or `values.Value`, which writes code; zeros and ones among the
floats vanish there.

Forces by the recursive Newton-Euler algorithm, the mass matrix from composite bodies (Featherstone, Rigid Body Dynamics
Algorithms, 2008, chapters 5 and 6), with accelerations of points in the place of spatial ones.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from dipc_gym import mjcf

Array = NDArray[np.float64]
Number = Any
Vector = list[Number]

GEOMETRY = 12  # numbers of a link: rotation (9) and place (3) in its parent's frame
LINK = 27  # and the position that counts as not moved, mass, first (3) and second moments (6), and of what floats (4)
GRAVITY = 3  # numbers before those of the links

_EXACT = 1e-13  # what is nearer to 0, 1 or -1 than this, in units of its kind, is that
_UPRIGHT = np.eye(3)  # the axes of the ground
_UPPER = np.triu_indices(3)  # where a symmetric matrix says all that it says


@dataclass(frozen=True)
class Tree:
    """What of a model decides its code.

    Attributes:
        parents: link that carries each link, -1 for the ground.
        slides: whether each joint is a slide.
        fixed: numbers that are 0, 1 or -1 in the code itself, by index; the others are read when it runs.
    """

    parents: tuple[int, ...]
    slides: tuple[bool, ...]
    fixed: tuple[tuple[int, float], ...] = ()

    @property
    def count(self) -> int:
        """Numbers of the tree, fixed ones included."""
        return GRAVITY + LINK * len(self.parents)


def tree_of(model: mujoco.MjModel) -> tuple[Tree, Array]:
    """Links of a model of hinges and slides, and their numbers (count,), none fixed yet."""
    turned, own = _matrices(model.body_quat), _matrices(model.body_iquat)
    place = np.zeros((model.nbody, 3))
    for body in range(1, model.nbody):
        carrier = model.body_parentid[body]
        place[body] = place[carrier] + turned[carrier] @ model.body_pos[body]
        turned[body] = turned[carrier] @ turned[body]
    last = np.full(model.nbody, -1)  # link that carries each body
    parents: list[int] = []
    turns: list[Array] = []
    origins: list[Array] = []
    for body in range(1, model.nbody):
        last[body] = last[model.body_parentid[body]]
        first = int(model.body_jntadr[body])
        for joint in range(first, first + int(model.body_jntnum[body])):
            parent = int(last[body])
            carried = turns[parent] if parent >= 0 else _UPRIGHT
            turns.append(carried @ _turn_to(carried.T @ (turned[body] @ model.jnt_axis[joint])))
            origins.append(place[body] + turned[body] @ model.jnt_pos[joint])
            parents.append(parent)
            last[body] = joint
    numbers = np.zeros(GRAVITY + LINK * len(parents))
    numbers[:GRAVITY] = model.opt.gravity * (not model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_GRAVITY)
    links = numbers[GRAVITY:].reshape(-1, LINK)
    for i, parent in enumerate(parents):
        carried, beside = (turns[parent], origins[parent]) if parent >= 0 else (_UPRIGHT, np.zeros(3))
        links[i, :9] = _rounded(carried.T @ turns[i]).ravel()
        offset = carried.T @ (origins[i] - beside)
        links[i, 9:12] = np.where(np.abs(offset) < _EXACT * max(1e-6, np.abs(offset).max()), 0.0, offset)
        links[i, 12] = model.qpos0[model.jnt_qposadr[i]]
    for body in range(1, model.nbody):
        i = int(last[body])
        if i < 0 or (model.body_mass[body] == 0 and not model.body_inertia[body].any()):
            continue
        mass, centre = float(model.body_mass[body]), place[body] + turned[body] @ model.body_ipos[body]
        arm = turns[i].T @ (centre - origins[i])
        axes = turns[i].T @ turned[body] @ own[body]
        inertia = (axes * model.body_inertia[body]) @ axes.T
        inertia += mass * (arm @ arm * _UPRIGHT - arm[:, None] * arm)
        links[i, 13] += mass
        links[i, 14:17] += mass * arm
        links[i, 17:23] += inertia[_UPPER]
        links[i, 23] += float(model.body_gravcomp[body]) * mass
        links[i, 24:27] += float(model.body_gravcomp[body]) * mass * arm
    for link in links:
        for part in (slice(14, 17), slice(17, 23), slice(24, 27)):
            link[part][np.abs(link[part]) < _EXACT * np.abs(link[part]).max(initial=0.0)] = 0.0
    return Tree(tuple(parents), tuple(not mjcf.is_hinge(model, joint) for joint in range(model.njnt))), numbers


def _matrices(turns: Array) -> Array:
    """Rotations (n, 3, 3) of quaternions (n, 4)."""
    w, x, y, z = turns.T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), -1, 0)


def _rounded(numbers: Array) -> Array:
    nearest = np.rint(numbers)
    return np.where(np.abs(numbers - nearest) < _EXACT, nearest, numbers)


def _turn_to(axis: Array) -> Array:
    """A rotation that takes z to an axis; one of the cube's where it can be."""
    axis = _rounded(axis)
    x, y, z = axis
    if abs(z) == 1:
        return np.diag([1.0, z, z])
    if abs(x) == 1:
        return np.array([[0.0, 0.0, x], [x, 0.0, 0.0], [0.0, 1.0, 0.0]])
    if abs(y) == 1:
        return np.array([[0.0, 1.0, 0.0], [0.0, 0.0, y], [y, 0.0, 0.0]])
    across = np.array([-y, x, 0.0]) / np.hypot(x, y)
    return np.stack([np.cross(across, axis), across, axis], axis=1)


def fix(tree: Tree, numbers: Array) -> Tree:
    """The tree with numbers (variants, count) fixed that are 0 in all variants, or 1 or -1 in a rotation."""
    columns = numbers[:, GRAVITY : tree.count]
    first, part = columns[0], np.arange(columns.shape[1]) % LINK
    of_rotation = (columns == first).all(axis=0) & np.isin(first, (0.0, 1.0, -1.0))
    settled = np.where(part < 9, of_rotation, (part != 13) & ~columns.any(axis=0))
    fixed = [(GRAVITY + int(k), float(first[k]) + 0.0) for k in np.flatnonzero(settled)]
    return Tree(tree.parents, tree.slides, tuple(fixed))


class Mechanics:
    """A tree at a configuration.

    Args:
        tree: its links.
        numbers: of the tree, by index.
        positions: of the joints, by index.
        sin_cos: of an angle.
    """

    def __init__(
        self,
        tree: Tree,
        numbers: Sequence[Number],
        positions: Sequence[Number],
        sin_cos: Callable[[Number], tuple[Number, Number]],
    ) -> None:
        self.tree = tree
        self.gravity = [numbers[k] for k in range(GRAVITY)]
        self.links = [[numbers[GRAVITY + LINK * i + k] for k in range(LINK)] for i in range(len(tree.parents))]
        self.turns: list[list[Vector]] = []  # rows of the rotation from each link's frame to its parent's
        self.places: list[Vector] = []
        for link, slide, q in zip(self.links, tree.slides, positions, strict=True):
            turn, place = [link[0:3], link[3:6], link[6:9]], link[9:12]
            moved = q - link[12]
            if slide:
                place = [p + row[2] * moved for p, row in zip(place, turn, strict=True)]
            else:
                s, c = sin_cos(moved)
                turn = [[row[0] * c + row[1] * s, row[1] * c - row[0] * s, row[2]] for row in turn]
            self.turns.append(turn)
            self.places.append(place)

    def forces(self, velocities: Sequence[Number], accelerations: Sequence[Number]) -> Vector:
        """Generalised forces that a motion needs, gravity included, (n,)."""
        tree, count = self.tree, len(self.tree.parents)
        spins: list[Vector] = []
        swings: list[Vector] = []
        points: list[Vector] = []
        pulls: list[Vector] = []
        downs: list[Vector] = []
        floats = any(_there(link[23]) for link in self.links)
        for i, parent in enumerate(tree.parents):
            turn, place, v, a = self.turns[i], self.places[i], velocities[i], accelerations[i]
            if parent < 0:
                spin, swing, point = [0.0] * 3, [0.0] * 3, [-g for g in self.gravity]
                down = self.gravity
            else:
                spin, swing, point, down = spins[parent], swings[parent], points[parent], downs[parent]
                point = _add(_add(point, _cross(swing, place)), _cross(spin, _cross(spin, place)))
                spin, swing = _back(turn, spin), _back(turn, swing)
            point = _back(turn, point)
            downs.append(_back(turn, down) if floats else down)
            if tree.slides[i]:
                point = _add(point, [2 * spin[1] * v, -2 * spin[0] * v, a])
            else:
                swing = _add(swing, [spin[1] * v, -(spin[0] * v), a])
                spin = [spin[0], spin[1], spin[2] + v]
            spins.append(spin)
            swings.append(swing)
            points.append(point)
        moments: list[Vector] = []
        for i in range(count):
            link, spin, swing = self.links[i], spins[i], swings[i]
            mass, first, second = link[13], link[14:17], _symmetric(link[17:23])
            point = points[i]
            pull = _add(_add([mass * p for p in point], _cross(swing, first)), _cross(spin, _cross(spin, first)))
            moment = _add(_apply(second, swing), _cross(spin, _apply(second, spin)))
            moment = _add(moment, _cross(first, point))
            if _there(link[23]):  # what floats is carried by forces from outside
                pull = _add(pull, [link[23] * g for g in downs[i]])
                moment = _add(moment, _cross(link[24:27], downs[i]))
            pulls.append(pull)
            moments.append(moment)
        out: Vector = [0.0] * count
        for i in reversed(range(count)):
            out[i] = pulls[i][2] if tree.slides[i] else moments[i][2]
            parent = tree.parents[i]
            if parent >= 0:
                pull = _apply(self.turns[i], pulls[i])
                pulls[parent] = _add(pulls[parent], pull)
                moments[parent] = _add(
                    moments[parent], _add(_apply(self.turns[i], moments[i]), _cross(self.places[i], pull))
                )
        return out

    def inertia(self) -> list[Vector]:
        """Rows of the mass matrix, (n, n), filled up to the diagonal."""
        tree, count = self.tree, len(self.tree.parents)
        masses = [link[13] for link in self.links]
        firsts = [link[14:17] for link in self.links]
        seconds = [_symmetric(link[17:23]) for link in self.links]
        out: list[Vector] = [[0.0] * count for _ in range(count)]
        for i in reversed(range(count)):
            mass, first, second = masses[i], firsts[i], seconds[i]
            if tree.slides[i]:
                pull, moment = [0.0, 0.0, mass], [first[1], -first[0], 0.0]
                out[i][i] = mass
            else:
                pull, moment = [-first[1], first[0], 0.0], [second[0][2], second[1][2], second[2][2]]
                out[i][i] = second[2][2]
            child, parent = i, tree.parents[i]
            while parent >= 0:
                pull = _apply(self.turns[child], pull)
                moment = _add(_apply(self.turns[child], moment), _cross(self.places[child], pull))
                out[i][parent] = pull[2] if tree.slides[parent] else moment[2]
                child, parent = parent, tree.parents[parent]
            parent = tree.parents[i]
            if parent >= 0:
                turn, place = self.turns[i], self.places[i]
                arm = _apply(turn, first)
                masses[parent] = masses[parent] + mass
                # About the parent's origin: that about its own, moved along `place`.
                turned = _turned(turn, second)
                dot = place[0] * arm[0] + place[1] * arm[1] + place[2] * arm[2]
                square = place[0] * place[0] + place[1] * place[1] + place[2] * place[2]
                whole = 2 * dot + mass * square
                for a in range(3):
                    for b in range(a, 3):
                        moved = turned[a][b] - (place[a] * arm[b] + arm[a] * place[b]) - mass * (place[a] * place[b])
                        if a == b:
                            moved = moved + whole
                        seconds[parent][a][b] = seconds[parent][b][a] = seconds[parent][a][b] + moved
                firsts[parent] = _add(firsts[parent], _add(arm, [mass * p for p in place]))
        return out


def _there(number: Number) -> bool:
    return not (isinstance(number, float) and number == 0)


def _add(a: Vector, b: Vector) -> Vector:
    return [x + y for x, y in zip(a, b, strict=True)]


def _cross(a: Vector, b: Vector) -> Vector:
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def _apply(rows: list[Vector], x: Vector) -> Vector:
    return [row[0] * x[0] + row[1] * x[1] + row[2] * x[2] for row in rows]


def _back(rows: list[Vector], x: Vector) -> Vector:
    return [rows[0][k] * x[0] + rows[1][k] * x[1] + rows[2][k] * x[2] for k in range(3)]


def _symmetric(x: Vector) -> list[Vector]:
    return [[x[0], x[1], x[2]], [x[1], x[3], x[4]], [x[2], x[4], x[5]]]


def _turned(turn: list[Vector], second: list[Vector]) -> list[Vector]:
    """Second moments in the parent's directions."""
    half = [_apply(second, row) for row in turn]
    out: list[Vector] = [[0.0] * 3 for _ in range(3)]
    for a in range(3):
        for b in range(a, 3):
            out[a][b] = out[b][a] = turn[a][0] * half[b][0] + turn[a][1] * half[b][1] + turn[a][2] * half[b][2]
    return out
