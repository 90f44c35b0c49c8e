"""Turn to windows in which something else happened, as soon as a search explains the others.

A push under friction shows only once friction is known. Until then its window is one of many that are far off, and may
be among those left aside.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dipc_gym.sim2real.estimation.fit import Fit, evaluate, fit
from dipc_gym.sim2real.selection import data
from dipc_gym.sim2real.selection.settings import SCORE

if TYPE_CHECKING:
    from dipc_gym.sim2real.estimation.problem import Problem
    from dipc_gym.sim2real.selection.search import Search


def quiet(fitted: Fit) -> bool:
    """Whether most windows are at the noise, so that one in which something happened stands out."""
    return float(np.median(fitted.mse)) < SCORE.quiet


def attend(search: Search) -> Fit:
    """The present fit of a search, once its windows are chosen by what stands out beside that."""
    current = search.path[-1]
    if quiet(current):
        # When something began and ended is told by the windows around it, those to compare on among them.
        mse = search.comparison_mse(current)
        if len(search.aside.windows):
            mse = np.append(mse, evaluate(search.aside, current.structure, current.z)[0])
        others, compared = search.comparison.join(search.aside), len(search.comparison.windows)
        which = data.eventful(search.problem.windows, current.mse, others.windows, mse)
        search.aside = search.aside.pick(~which[compared:])
        if which[:compared].any():
            search.compare_on(search.comparison.pick(~which[:compared]))
        _take_in(search, others.pick(which))
    windows = search.problem.windows.join(search.comparison.windows)
    _leave_aside(search, data.without_echoes(windows, search.mse(search.path[-1])))
    current = search.path[-1]
    if quiet(current):
        search.subset = np.append(search.subset, np.setdiff1d(data.outliers(current.mse), search.subset))
    return current


def _take_in(search: Search, new: Problem) -> None:
    """Fit some more windows; what is known already learns what it says of them."""
    if not len(new.windows):
        return

    def informed(fitted: Fit) -> Fit:
        return fitted.join(fit(new, fitted.structure, fitted.z, most=0))

    path = [informed(fitted) for fitted in search.path]
    anchor = search.anchor and informed(search.anchor)
    rounds = [
        [replace(tried, fitted=tried.fitted and informed(tried.fitted)) for tried in hypotheses]
        for hypotheses in search.rounds
    ]
    # Together, for Ctrl-C may come while fits are informed.
    search.problem, search.path, search.anchor, search.rounds = search.problem.join(new), path, anchor, rounds


def _leave_aside(search: Search, keep: NDArray[np.bool_]) -> None:
    """Go on with some of the windows, of the fitted and then of the comparison windows."""
    if keep.all():
        return
    count = len(search.problem.windows)
    which, subset = np.flatnonzero(keep[:count]), np.flatnonzero(keep[search.subset])
    search.problem = search.problem.pick(which)
    search.compare_on(search.comparison.pick(keep[count:]))
    search.path = [fitted.pick(which) for fitted in search.path]
    search.anchor = search.anchor and search.anchor.pick(which)
    search.rounds = [[tried.pick(which, subset) for tried in hypotheses] for hypotheses in search.rounds]
    search.subset = np.searchsorted(which, search.subset[subset])
