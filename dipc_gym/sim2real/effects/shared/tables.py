"""Laws of any shape, as tables: where knots have to lie, and a table as elements of MJCF.

A table is piecewise linear between its knots and constant outside. A map is written as one of closer knots along a
curve: a command that is held asks for it at one point, where a line between values of a bent one is off by more than
motion over all of them shows.

Knots are proposed from the unexplained force, where a table costs one linear regression; its values are then fitted in
simulation, like every other parameter. The growth is LOLIMOT's idea (Nelles 1996) in one dimension: the knot that
removes most of what is left comes next.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline

from dipc_gym.mjcf.edit import Document
from dipc_gym.sim2real.effects.shared.base import passive_ramp
from dipc_gym.sim2real.effects.shared.settings import TABLES
from dipc_gym.sim2real.effects.shared.smoothing import smoothing

Array = NDArray[np.float64]


def grow(
    x: Array, force: Array, carrier: Array, beside: Sequence[Array], time: Array, width: float
) -> tuple[Array, Array]:
    """Knots and values of the table g in force = carrier g(x) + what goes with the regressors beside it.

    Knots are added one at a time; how many of them stay is decided by blocks of time that did not choose them.

    Args:
        x: input of the table, (n,).
        force: to be explained, (n,).
        carrier: what the table is multiplied by, (n,).
        beside: regressors with free weights, (n,) each.
        time: s, (n,).
        width: s, to which both sides are smoothed.

    Returns:
        Knots (k,), increasing, and the table's values there, (k,); k is at least 2.
    """
    low, high = (float(v) for v in np.quantile(x, [TABLES.covered, 1 - TABLES.covered]))
    high = max(high, low + 1e-9 * max(1.0, abs(low)))
    edges = np.linspace(low, high, TABLES.bins + 1)
    mean = smoothing(time, width)
    confirming = odd_blocks(mean @ time)
    if confirming.all() or not confirming.any():
        confirming = np.arange(len(confirming)) % 2 == 1
    columns, force = mean @ np.column_stack([hats(edges, x) * carrier[:, None], *beside]), mean @ force
    parts = [Nested.of(columns[part], force[part]) for part in (~confirming, confirming)]
    counts = np.append(0, np.cumsum(np.histogram(x, edges)[0]))
    knots = grown(parts[0], parts[1], counts)
    return edges[knots], Nested.of(columns, force).weights(knots)[: len(knots)]


def grown(fitted: Nested, confirming: Nested, counts: NDArray[np.intp]) -> list[int]:
    """Knots, as places on a fine grid, that samples ask for and others confirm.

    Args:
        fitted: samples that choose where the next knot lies.
        confirming: samples that tell how many stay.
        counts: samples below each place of the grid, (bins + 1,).
    """
    bins = len(counts) - 1
    tables = [[0, bins]]
    while len(tables[-1]) < TABLES.most_knots:
        tries = [sorted([*tables[-1], k]) for k in range(1, bins) if _room(k, tables[-1], counts)]
        if not tries:
            break
        tables.append(min(tries, key=lambda knots: fitted.left(knots, fitted.weights(knots))))
    # A narrow spot takes three knots, of which the first alone gains nothing: tables are grown first, then compared.
    left = [confirming.left(knots, fitted.weights(knots)) for knots in tables]
    enough = spared(left[0], min(left))
    return next(knots for knots, after in zip(tables, left, strict=True) if after <= enough)


def smooth(edges: Array, x: Array, force: Array, carrier: Array, beside: Sequence[Array]) -> Array:
    """Values at even knots of a table as `grow` asks for, where it bends as little as the force lets it.

    Samples are taken one by one: it is for what shows in moments, where a recording begins.

    Args:
        edges: knots, (k,).
        x: see `grow`, as all that follows.
        force: likewise.
        carrier: likewise.
        beside: likewise.
    """
    columns = np.column_stack([hats(edges, x) * carrier[:, None], *beside])
    normal, count = columns.T @ columns, len(edges)
    size = float(np.trace(normal[:count, :count])) / count
    second = np.diff(np.eye(count, len(normal)), 2, axis=0)
    stiff = TABLES.stiff * second.T @ second + TABLES.ridge * np.eye(len(normal))
    return np.asarray(np.linalg.solve(normal + size * stiff, columns.T @ force)[:count])


def bending(x: Array) -> Array:
    """By how much each value of a table lies off the line between its neighbours, as weights of its values, (k - 2, k).

    Args:
        x: knots, (k,).
    """
    rows = np.zeros((len(x) - 2, len(x)))
    for k in range(1, len(x) - 1):
        share = (x[k] - x[k - 1]) / (x[k + 1] - x[k - 1])
        rows[k - 1, k - 1 : k + 2] = share - 1.0, 1.0, -share
    return rows


def curve(knots: Array, values: Array, at: Array) -> Array:
    """A smooth law at places within its knots, (m,) or (m, ...): cubics with the slopes of parabolas through three
    values, so that it is affine in these and goes straight where they do.

    Args:
        knots: increasing, (k,).
        values: there, (k,) or (k, ...).
        at: places, (m,).
    """
    return np.asarray(CubicHermiteSpline(knots, values, np.gradient(values, knots, axis=0))(at))


def between(knots: Array, lines: int = TABLES.between) -> Array:
    """Knots, and places evenly between each two of them, so close that so many lines follow a curve there."""
    steps = np.arange(lines * (len(knots) - 1) + 1) / lines
    return np.interp(steps, np.arange(len(knots)), knots)


def odd_blocks(time: Array) -> NDArray[np.bool_]:
    """Which samples lie in every second block of time, (n,): what one half of the blocks chose, the other confirms."""
    return np.asarray(np.floor(time / TABLES.block).astype(np.intp) % 2 == 1)


def spared(before: float, least: float) -> float:
    """Sum of squares that a shape may leave of what did not choose it, where a richer one leaves the least.

    A share of what the shape takes, so that noise adds no knots; but where it takes nearly all, no more than a share
    of what is left in the end, or a large law would stay coarse.
    """
    return least + min(TABLES.spare * max(before - least, 0.0), TABLES.near * least)


def _room(k: int, chosen: Sequence[int], counts: NDArray[np.intp]) -> bool:
    """Whether there are samples enough on either side of a new knot."""
    last = len(counts) - 1
    below, above = max(c for c in chosen if c < k or c == 0), min(c for c in chosen if c > k or c == last)
    return k not in chosen and min(counts[k] - counts[below], counts[above] - counts[k]) >= TABLES.fewest


@dataclass(frozen=True)
class Nested:
    """Normal equations of a table at all edges and of the regressors beside it; tables of fewer knots are subspaces.

    Attributes:
        normal: of the table's values, then of the weights of the regressors beside it, (k, k).
        right: right-hand side, (k,).
        total: sum of squares to be explained.
    """

    normal: Array
    right: Array
    total: float

    @classmethod
    def of(cls, columns: Array, force: Array) -> Nested:
        """Those of columns (n, k) and what they are to explain, (n,)."""
        return cls(columns.T @ columns, columns.T @ force, float(force @ force))

    @property
    def size(self) -> float:
        """Of the normal equations, on average."""
        return max(float(np.trace(self.normal)), 1e-300) / len(self.normal)

    def _both(self, knots: Sequence[int]) -> Array:
        """The values at all edges of a table with these knots, and the other regressors as they are."""
        function = _between_knots(knots)
        others = len(self.right) - len(function)
        out = np.zeros((len(self.right), function.shape[1] + others))
        out[: len(function), : function.shape[1]] = function
        out[len(function) :, function.shape[1] :] = np.eye(others)
        return out

    def weights(self, knots: Sequence[int]) -> Array:
        """Least-squares values of the function, then weights of the other regressors; a trace of ridge for empty bins.

        The ridge is one of the size that columns have on average.
        """
        both = self._both(knots)
        normal = both.T @ self.normal @ both
        return np.asarray(np.linalg.solve(normal + TABLES.ridge * self.size * np.eye(len(normal)), both.T @ self.right))

    def left(self, knots: Sequence[int], weights: Array) -> float:
        """Sum of squares that these weights leave."""
        fine = self._both(knots) @ weights
        return float(self.total - 2 * fine @ self.right + fine @ self.normal @ fine)


def hats(edges: Array, x: Array) -> Array:
    """Of each sample, its share of the values at the two edges that it lies between, (n, edges)."""
    bins = len(edges) - 1
    along = np.clip((x - edges[0]) / (edges[-1] - edges[0]) * bins, 0.0, bins - 1e-9)
    below, rows = along.astype(np.intp), np.arange(len(x))
    out = np.zeros((len(x), len(edges)))
    out[rows, below] = 1 - (along - below)
    out[rows, below + 1] = along - below
    return out


def _between_knots(knots: Sequence[int]) -> Array:
    """Values at all edges of a table for each of its values at knots, (edges, knots)."""
    edges = np.arange(knots[-1] + 1)
    return np.stack([np.interp(edges, knots, unit) for unit in np.eye(len(knots))], axis=1)


def force_of_position(
    document: Document, name: str, joint: str, knots: Sequence[float], values: Sequence[float]
) -> None:
    """A force on a joint that is a table of its position: a ramp for each stretch between two knots."""
    offset = float(values[0])
    for k in range(len(knots) - 1):
        rise, stretch = values[k + 1] - values[k], knots[k + 1] - knots[k]
        # Each ramp runs from 0 to its rise; the first one carries the value that holds before its stretch.
        start = offset if k == 0 else 0.0
        slope = rise / stretch
        constant = start - slope * knots[k]
        low, high = sorted((start, start + rise))
        passive_ramp(document, f"{name}_{k + 1}", joint, (constant, slope, 0.0), (low, high))


def odd_force_of_speed(
    document: Document, name: str, joint: str, knots: Sequence[float], excess: Sequence[float]
) -> None:
    """A force against motion that is a table of speed: -sign(v) times the table, zero at rest.

    Args:
        document: to edit.
        name: of the elements, numbered.
        joint: that it acts on.
        knots: speeds, the first of them 0.
        excess: what the table says there, the first 0.
    """
    slopes = np.append(np.diff(excess) / np.diff(knots), 0.0)
    for k, bend in enumerate(-np.diff(slopes)):
        limit = abs(float(bend)) * float(knots[k + 1])
        passive_ramp(document, f"{name}_{k + 1}", joint, (0.0, 0.0, -float(bend)), (-limit, limit))
