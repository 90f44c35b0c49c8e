"""What an unexplained force depends on: a table over one or two inputs, as coarse as it may be.

Every input, and every pair of the better ones, first gets an even table by linear regression; blocks of time that did
not fit it say what it is worth. The table of the inputs that tell most is then grown knot by knot along either axis,
as LOLIMOT halves boxes (Nelles 1996), and pruned to the fewest knots that the other blocks ask for.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from dipc_gym.sim2real.effects.shared.settings import SURFACES, TABLES
from dipc_gym.sim2real.effects.shared.smoothing import smoothing
from dipc_gym.sim2real.effects.shared.tables import odd_blocks, spared

Array = NDArray[np.float64]
Sums = tuple[sparse.csr_array, Array, float]  # normal matrix, right-hand side, sum of squares


@dataclass(frozen=True)
class Surface:
    """A table over one or two inputs.

    Attributes:
        inputs: their names.
        knots: along each of them, increasing.
        levels: (m,) or (m, n).
    """

    inputs: tuple[str, ...]
    knots: tuple[Array, ...]
    levels: Array


def surfaces(inputs: Mapping[str, Array], force: Array, time: Array, width: float) -> list[Surface]:
    """The table that a force asks for, and those of other inputs that tell nearly as much; none where none tells
    anything.

    What tells most of a force that was worked out from motion need not be what it depends on: a drive that varies along
    the way and a drag that does look alike where a motor follows its command. A simulation tells.

    Args:
        inputs: what it may depend on, (n,) each.
        force: to be explained, (n,).
        time: s, (n,), beginning anew with each recording.
        width: s, to which both sides are smoothed.
    """
    mean = smoothing(time, width)
    late = odd_blocks(mean @ time)
    if late.all() or not late.any():
        return []
    halves = (~late, late)
    moving = {name: x for name, x in inputs.items() if np.ptp(x) > 0}
    worth: dict[tuple[str, ...], float] = {
        (name,): _Even([x], force, mean, halves, SURFACES.alone).worth for name, x in moving.items()
    }
    if not worth:
        return []
    better = sorted(worth, key=lambda one: -worth[one])
    pairs = {
        (*a, *b): _Even([moving[a[0]], moving[b[0]]], force, mean, halves, SURFACES.both).worth
        for a, b in itertools.combinations(better[: SURFACES.paired], 2)
    }
    two = max(pairs, key=lambda one: pairs[one], default=better[0])
    if pairs and pairs[two] > worth[better[0]] + SURFACES.tells * max(worth[better[0]], SURFACES.least):
        worth, better = pairs, sorted(pairs, key=lambda one: -pairs[one])
    least = max(SURFACES.least, SURFACES.nearly * worth[better[0]])
    found = []
    for chosen in (one for one in better[: SURFACES.rivals] if worth[one] >= least):
        even = _Even(
            [moving[name] for name in chosen],
            force,
            mean,
            halves,
            SURFACES.alone if len(chosen) == 1 else SURFACES.both,
        )
        found.append(Surface(chosen, *even.grown()))
    return found


class _Even:
    """Normal equations of a table on an even grid; tables with fewer knots are subspaces of it.

    Args:
        inputs: one or two, (n,) each.
        force: (n,).
        mean: weights with which samples make up smoothed ones, (m, n).
        halves: smoothed samples that fit a table, and those that tell what it is worth; then the other way round.
        bins: along each input.
    """

    def __init__(
        self,
        inputs: Sequence[Array],
        force: Array,
        mean: sparse.csr_array,
        halves: Sequence[NDArray[np.bool_]],
        bins: int,
    ) -> None:
        self.bins = bins
        self.edges = [np.linspace(*_span(x), bins + 1) for x in inputs]
        hats = _hats([(x - e[0]) / (e[-1] - e[0]) for x, e in zip(inputs, self.edges, strict=True)], bins + 1)
        hats, force = sparse.csr_array(mean @ hats), mean @ force
        self.sums: list[Sums] = []
        for part in halves:
            some, told = sparse.csr_array(hats[part]), force[part]
            self.sums.append((some.T @ some, some.T @ told, float(told @ told) or 1.0))

    @property
    def worth(self) -> float:
        """Share of the squares that a table of all knots, as stiff as it has to be, takes of the half not seen."""
        bends = _bending([self.bins + 1] * len(self.edges))
        taken = np.zeros(len(SURFACES.stiff))
        for (normal, right, _), told in (self.sums, self.sums[::-1]):
            size = float(normal.trace()) / len(right)
            for k, stiff in enumerate(SURFACES.stiff):
                penalty = size * (stiff * bends + SURFACES.timid * np.eye(len(bends)))
                levels = np.asarray(np.linalg.solve(normal.toarray() + penalty, right))
                taken[k] += _taken(levels, told) / 2
        return float(taken.max())

    def grown(self) -> tuple[tuple[Array, ...], Array]:
        """Knots along each input, and levels: the fewest knots that take nearly as much of the half not seen."""
        knots = [[0, self.bins] for _ in self.edges]
        path: list[tuple[list[list[int]], float]] = []
        while True:
            path.append((knots, self._confirmed(knots)))
            tries = [
                [*knots[:axis], sorted([*knots[axis], k]), *knots[axis + 1 :]]
                for axis in range(len(knots))
                for k in range(1, self.bins)
                if k not in knots[axis]
            ]
            tries = [one for one in tries if np.prod([len(axis) for axis in one]) <= SURFACES.most_levels]
            if not tries:
                break
            knots = max(tries, key=lambda one: _taken(self._levels(one, self.sums[:1])[1], self.sums[0]))
        enough = spared(1.0 - path[0][1], min(1.0 - worth for _, worth in path))
        chosen = next(one for one, worth in path if 1.0 - worth <= enough)
        levels, _ = self._levels(chosen, self.sums)
        told = self._weights(chosen) > SURFACES.untold * sum(float(one[0].trace()) for one in self.sums)
        levels = np.clip(levels, levels[told].min(), levels[told].max())
        return tuple(e[k] for e, k in zip(self.edges, chosen, strict=True)), levels.reshape([len(k) for k in chosen])

    def _confirmed(self, knots: Sequence[Sequence[int]]) -> float:
        """Share of the squares that a table with these knots takes of either half when the other fits it."""
        both = (self.sums, self.sums[::-1])
        return float(np.mean([_taken(self._levels(knots, [fitted])[1], told) for fitted, told in both]))

    def _levels(self, knots: Sequence[Sequence[int]], sums: Sequence[Sums]) -> tuple[Array, Array]:
        """Least-squares levels at the knots, and the table on the even grid."""
        coarse = self._on_the_grid(knots)
        normal = sum(coarse.T @ (one[0] @ coarse) for one in sums)
        right = coarse.T @ sum(one[1] for one in sums)
        shape = [len(k) for k in knots]
        size = float(np.trace(normal)) / len(right)
        levels = np.asarray(
            np.linalg.solve(
                normal + size * (SURFACES.smooth * _bending(shape) + SURFACES.timid * np.eye(len(right))), right
            )
        )
        return levels, np.asarray(coarse @ levels)

    def _weights(self, knots: Sequence[Sequence[int]]) -> Array:
        """Weight of all samples on each level of a table with these knots."""
        coarse = self._on_the_grid(knots)
        return np.asarray(sum(np.einsum("ij,ij->j", coarse, one[0] @ coarse) for one in self.sums))

    def _on_the_grid(self, knots: Sequence[Sequence[int]]) -> Array:
        """What each level of a table with these knots adds to each entry of the even grid."""
        coarse: Array = np.ones((1, 1))
        for k in knots:
            line = np.stack([np.interp(np.arange(self.bins + 1), k, unit) for unit in np.eye(len(k))], axis=1)
            coarse = np.asarray(np.kron(coarse, line))
        return coarse


def _span(x: Array) -> tuple[float, float]:
    low, high = (float(v) for v in np.quantile(x, [TABLES.covered, 1 - TABLES.covered]))
    return low, max(high, low + 1e-9 * max(1.0, abs(low)))


def _hats(shares: Sequence[Array], count: int) -> sparse.csr_array:
    """Weights of a table's entries at shares of its length along each input, (n, entries)."""
    n = len(shares[0])
    columns, weights = np.zeros((n, 1), dtype=np.intp), np.ones((n, 1))
    for share in shares:
        along = np.clip(share, 0.0, 1.0) * (count - 1)
        below = np.minimum(along.astype(np.intp), count - 2)
        two, parts = np.stack([below, below + 1], axis=1), np.stack([1 - (along - below), along - below], axis=1)
        columns = (columns[:, :, None] * count + two[:, None, :]).reshape(n, -1)
        weights = (weights[:, :, None] * parts[:, None, :]).reshape(n, -1)
    rows = np.repeat(np.arange(n), columns.shape[1])
    return sparse.csr_array((weights.ravel(), (rows, columns.ravel())), shape=(n, count ** len(shares)))


def _bending(counts: Sequence[int]) -> Array:
    """Penalty on the second differences of a table along each input."""
    out = np.zeros((int(np.prod(counts)),) * 2)
    for axis, count in enumerate(counts):
        second = np.diff(np.eye(count), 2, axis=0)
        whole: Array = np.ones((1, 1))
        for k, n in enumerate(counts):
            whole = np.asarray(np.kron(whole, second.T @ second if k == axis else np.eye(n)))
        out += whole
    return np.asarray(out)


def _taken(levels: Array, told: Sums) -> float:
    """Share of the squares of one half that a table on the even grid takes."""
    normal, right, total = told
    return float(2 * levels @ right - levels @ (normal @ levels)) / total
