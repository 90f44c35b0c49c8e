"""Which of a model's own numbers had to change: as few as predict as well as all of them.

Numbers such as mass, damping and motor gain have a null space: many changes predict alike. The fewest are worth
reporting, and where others would do as well, so is that.
"""

from __future__ import annotations

import bisect
import functools
import heapq
import itertools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dipc_gym import mjcf
from dipc_gym.sim2real.estimation.fit import Fit, fit, weights
from dipc_gym.sim2real.selection.ranking import AT_FLOOR
from dipc_gym.sim2real.selection.score import compare
from dipc_gym.sim2real.selection.search import ROUGH, Search

Array = NDArray[np.float64]

OTHERS = 4  # choices of numbers that are tried in place of those that changed


def fewest_numbers(search: Search, fitted: Fit) -> Fit:
    """Put back to nominal every own number whose change was not needed, and refit the rest."""
    subsets, k = _Subsets(search, fitted), len(fitted.structure.numbers)
    order: list[int] = []
    while len(order) < k:
        order.append(min((i for i in range(k) if i not in order), key=lambda i: subsets.foretold([*order, i])[0]))

    # The quadratics choose the order only: along a null space the fit may have come too far for them to tell whether
    # nominal numbers would do.
    @functools.cache
    def with_first(count: int) -> Fit | None:
        return subsets.refitted(order[:count])

    def suffices(count: int) -> bool:
        return subsets.suffices(with_first(count))

    # Mostly none had to change, or few.
    low, high = 0, 0
    while high < k and not suffices(high):
        low, high = high + 1, max(2 * high, 1)
    fewest = bisect.bisect_left(range(k), True, lo=low, hi=min(high, k), key=suffices)
    return with_first(fewest) or fitted


def other_numbers(search: Search, fitted: Fit, fewest: Fit) -> list[Fit]:
    """Fits with as many own numbers changed as `fewest`, but others, that predict as well: which were wrong is open.

    Args:
        search: that has run.
        fitted: with all own numbers free.
        fewest: what `fewest_numbers` made of it; nothing is asked of one that leaves more than noise.
    """
    keys = [number.key for number in fitted.structure.numbers]
    chosen = {number.key for number in fewest.structure.numbers}
    if not 0 < len(chosen) < len(keys) or fewest.error > AT_FLOOR:
        return []
    # They are told and counted, not written to the model: a third of the windows says that as well.
    subsets = _Subsets(search, fitted, search.few)
    choices = (
        free for free in itertools.combinations(range(len(keys)), len(chosen)) if {keys[i] for i in free} != chosen
    )
    likely = heapq.nsmallest(OTHERS, choices, key=lambda free: subsets.foretold(free)[0])
    others = [subsets.refitted(free) for free in likely]
    return [other for other in others if other is not None and subsets.suffices(other)]


class _Subsets:
    """A fit with some of its own numbers put back to nominal: foretold by its quadratics, or refitted to some windows.

    Args:
        search: that has run.
        fitted: to all windows, with all own numbers free.
        which: windows to refit to; None for all.
    """

    def __init__(self, search: Search, fitted: Fit, which: NDArray[np.intp] | None = None) -> None:
        self.search, self.fitted, self.count = search, fitted, len(fitted.structure.numbers)
        self.windows = search.problem.counts
        self.some = np.arange(len(fitted.mse)) if which is None else which
        self.problem = search.problem.pick(self.some)
        w = weights(fitted.mse) / self.windows
        self.A, self.b = np.einsum("n,nij->ij", w, fitted.quadratics.A), w @ fitted.quadratics.b

    def foretold(self, free: Sequence[int]) -> tuple[float, Array]:
        """Mean loss with these numbers free, and all mapped numbers then, (p,)."""
        z, p = self.fitted.z, len(self.fitted.z)
        held = [i for i in range(self.count) if i not in free]
        open_ = [i for i in range(p) if i not in held]
        step = np.zeros(p)
        step[held] = -z[held]
        if open_:
            rhs = self.b[open_] - self.A[np.ix_(open_, held)] @ step[held]
            step[open_] = np.linalg.lstsq(self.A[np.ix_(open_, open_)], rhs, rcond=1e-10)[0]
        after = np.maximum(self.fitted.quadratics.after(step), 0)
        return float(np.mean(np.log1p(after / self.windows))), z + step

    def refitted(self, free: Sequence[int]) -> Fit | None:
        """A fit with these numbers free; None where it cannot be simulated."""
        free = sorted(free)
        numbers = tuple(self.fitted.structure.numbers[i] for i in free)
        z = self.foretold(free)[1][[*free, *range(self.count, len(self.fitted.z))]]
        try:
            structure = replace(self.fitted.structure, numbers=numbers)
            return fit(self.problem, structure, z, self.fitted.starts[self.some], most=20, tolerance=ROUGH)
        except (mjcf.MjcfError, np.linalg.LinAlgError):
            return None

    def suffices(self, sparse: Fit | None) -> bool:
        """Whether a refit predicts as well as the fit with all numbers free, on its windows and on the unseen ones."""
        if sparse is None:
            return False
        free = np.append(self.fitted.mse[self.some], self.search.unseen_mse(self.fitted))
        return compare(free, self.search.mse(sparse), self.problem.join(self.search.unseen).blocks).alike
