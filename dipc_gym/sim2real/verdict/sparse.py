"""Which of a model's parameters had to change: as few as predict as well as all of them.

Parameters such as mass, damping and motor gain have a null space: many changes predict alike. The fewest are worth
reporting, and where others would do as well, so is that.
"""

from __future__ import annotations

import bisect
import functools
import heapq
import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from dipc_gym import mjcf
from dipc_gym.sim2real.estimation.fit import Fit, fit, holding
from dipc_gym.sim2real.estimation.settings import ESTIMATION
from dipc_gym.sim2real.selection.score import compare
from dipc_gym.sim2real.selection.search import Searched
from dipc_gym.sim2real.selection.settings import SCORE, SEARCH
from dipc_gym.sim2real.verdict.settings import VERDICT

Array = NDArray[np.float64]


def fewest_parameters(search: Searched, fitted: Fit) -> Fit:
    """Put back to nominal every model parameter whose change was not needed, and refit the rest.

    Parameters of which the owner knows that they are not nominal stay free.
    """
    reduced, known = _Reduced(search, fitted), len(_not_nominal(fitted))
    best: Fit | None = None
    # From nothing on, of a null space the one that does it all comes first; from all on, where all of it is right, what
    # only made up for others goes first.
    for order in (_from_none, _from_all):
        found = _first_of(reduced, order(reduced), known)
        if best is None or (found is not None and _freed(found) < _freed(best)):
            best = found
        if best is not None and _freed(best) <= known + 1:
            break
    return fitted if best is None else _without_needless(reduced, best)


def _freed(fitted: Fit) -> int:
    return len(fitted.structure.model_parameters)


def _from_none(reduced: _Reduced) -> list[int]:
    """Model parameters, those first that are foretold to bring most beside those before them."""
    order = _not_nominal(reduced.fitted)
    while len(order) < reduced.count:
        others = (i for i in range(reduced.count) if i not in order)
        order.append(min(others, key=lambda i: reduced.foretold([*order, i])[0]))
    return order


def _from_all(reduced: _Reduced) -> list[int]:
    """Model parameters, those last that are foretold to be missed least, one after another."""
    stay, kept, gone = _not_nominal(reduced.fitted), list(range(reduced.count)), list[int]()
    while len(kept) > len(stay):
        others = (i for i in kept if i not in stay)
        gone.append(min(others, key=lambda i: reduced.foretold([j for j in kept if j != i])[0]))
        kept.remove(gone[-1])
    return [*stay, *reversed(gone)]


def _first_of(reduced: _Reduced, order: Sequence[int], known: int) -> Fit | None:
    """A fit with as few of the first model parameters of an order as suffice, so many at least, or with all of them;
    None where that cannot be simulated.

    The quadratics choose the order only: along a null space the fit may have come too far for them to tell whether
    nominal parameters would do.
    """

    @functools.cache
    def with_first(count: int) -> Fit | None:
        return reduced.refitted(order[:count])

    def suffices(count: int) -> bool:
        return reduced.suffices(with_first(count))

    # Mostly none had to change, or few.
    low = high = known
    while high < reduced.count and not suffices(high):
        low, high = high + 1, max(2 * high, 1)
    most = min(high, reduced.count)
    return with_first(bisect.bisect_left(range(reduced.count), True, lo=low, hi=most, key=suffices))


def _without_needless(reduced: _Reduced, found: Fit) -> Fit:
    """A fit without the parameters that it does not need one by one: what is foretold from afar, where all are free,
    orders them only roughly, and some come in before those that matter.

    Args:
        reduced: what all parameters come to.
        found: with some of them free.
    """
    here, known = _Reduced(reduced.search, found), _not_nominal(found)
    foretold = [(here.without(i), i) for i in range(here.count) if i not in known]
    for loss, i in sorted(foretold):
        if loss - here.loss > SCORE.worth:
            break
        less = here.refitted([k for k in range(here.count) if k != i])
        if less is not None and reduced.suffices(less):
            return _without_needless(reduced, less)
    return found


def other_parameters(search: Searched, fitted: Fit, fewest: Fit) -> list[Fit]:
    """Fits with as many model parameters changed as `fewest`, but others, that predict as well: which were wrong is
    open.

    Args:
        search: that has run.
        fitted: with all model parameters free.
        fewest: what `fewest_parameters` made of it; nothing is asked of one that leaves more than noise.
    """
    keys = [parameter.key for parameter in fitted.structure.model_parameters]
    chosen = {parameter.key for parameter in fewest.structure.model_parameters}
    if not 0 < len(chosen) < len(keys) or fewest.error > SCORE.at_floor:
        return []
    # They are told and counted, not written to the model: a third of the windows says that as well.
    reduced = _Reduced(search, fitted, search.partition.subset)
    known = set(_not_nominal(fitted))
    choices = (free for free in _exchanged([key in chosen for key in keys]) if known <= set(free))
    likely = heapq.nsmallest(VERDICT.others, choices, key=lambda free: reduced.foretold(free)[0])

    def other(free: Sequence[int]) -> Fit | None:
        refitted = reduced.refitted(free)
        return refitted.result() if refitted is not None and reduced.suffices(refitted) else None

    with search.fitter.side_by_side([partial(other, free) for free in likely], [fitted]) as result:
        found = [result(k) for k in range(len(likely))]
    return [one for one in found if one is not None]


def _exchanged(chosen: Sequence[bool]) -> Iterator[tuple[int, ...]]:
    """Choices of as many numbers as are chosen, but of others, from those on that share most with it.

    All there are, or if these are too many all in which so few are exchanged that they are not.
    """
    inside = [i for i, one in enumerate(chosen) if one]
    outside = [i for i, one in enumerate(chosen) if not one]
    count = 0
    for exchanged in range(1, min(len(inside), len(outside)) + 1):
        count += math.comb(len(inside), exchanged) * math.comb(len(outside), exchanged)
        if exchanged > 1 and count > VERDICT.choices:
            return
        for gone, new in itertools.product(
            itertools.combinations(inside, exchanged), itertools.combinations(outside, exchanged)
        ):
            yield tuple(sorted({*inside, *new} - {*gone}))


def _not_nominal(fitted: Fit) -> list[int]:
    """Numbers of the model parameters whose nominal value is out of reach of what the owner knows of them."""
    parameters = fitted.structure.model_parameters
    return [
        i
        for i, (parameter, slot) in enumerate(zip(parameters, fitted.structure.slots, strict=False))
        if not slot.low <= parameter.value <= slot.high
    ]


class _Reduced:
    """A fit with some of its parameters put back to nominal: foretold by its quadratics, or refitted to some windows.

    Args:
        search: that has run.
        fitted: to all windows, with all model parameters free.
        which: windows to refit to; None for all.
    """

    def __init__(self, search: Searched, fitted: Fit, which: NDArray[np.intp] | None = None) -> None:
        self.search, self.fitted, self.count = search, fitted, len(fitted.structure.model_parameters)
        self.some = np.arange(len(fitted.mse)) if which is None else which
        self.problem = search.partition.problem.pick(self.some)

    def foretold(self, free: Sequence[int]) -> tuple[float, Array]:
        """Mean loss with these parameters free, and all mapped parameters then, (p,)."""
        whole = self.search.partition.problem
        z = holding(self.fitted, whole, dict.fromkeys((i for i in range(self.count) if i not in free), 0.0))
        after = np.maximum(self.fitted.quadratics.after(z - self.fitted.z), 0)
        return float(np.mean(np.log1p(after / whole.counts))), z

    @property
    def loss(self) -> float:
        """Mean loss as it is."""
        return float(np.mean(np.log1p(self.fitted.mse)))

    def without(self, parameter: int) -> float:
        """Mean loss with one parameter nominal."""
        return self.foretold([i for i in range(self.count) if i != parameter])[0]

    def refitted(self, free: Sequence[int]) -> Fit | None:
        """A fit with these parameters free; None where it cannot be simulated."""
        free = sorted(free)
        parameters = tuple(self.fitted.structure.model_parameters[i] for i in free)
        z = self.foretold(free)[1][[*free, *range(self.count, len(self.fitted.z))]]
        try:
            structure = replace(self.fitted.structure, model_parameters=parameters)
            return fit(
                self.problem,
                structure,
                z,
                self.fitted.initial[self.some],
                most=ESTIMATION.from_afar,
                tolerance=SEARCH.rough,
            )
        except (mjcf.MjcfError, np.linalg.LinAlgError):
            return None

    def suffices(self, sparse: Fit | None) -> bool:
        """Whether a refit predicts as well as the fit with all parameters free, on its windows and on the comparison
        windows.
        """
        if sparse is None:
            return False
        scorer, comparison = self.search.scorer, self.search.partition.comparison
        free = np.append(self.fitted.mse[self.some], scorer.comparison_mse(self.fitted))
        return compare(free, scorer.mse(sparse), self.problem.join(comparison).blocks).alike
