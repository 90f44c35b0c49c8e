"""Turn to windows in which something else happened, as soon as a search explains the others.

A push under friction shows only once friction is known. Until then its window is one of many that are far off, and may
be among those left aside.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dipc_gym.sim2real import selection
from dipc_gym.sim2real.comparison import QUIET
from dipc_gym.sim2real.fit import Fit, evaluate, fit

if TYPE_CHECKING:
    from dipc_gym.sim2real.problem import Problem
    from dipc_gym.sim2real.search import Search


def quiet(fitted: Fit) -> bool:
    """Whether most windows are at the noise, so that one in which something happened stands out."""
    return float(np.median(fitted.mse)) < QUIET


def attend(search: Search) -> Fit:
    """The present fit of a search, once its windows are chosen by what stands out beside that."""
    current = search.path[-1]
    if quiet(current) and not len(selection.odd_windows(current.mse)):
        # What only windows to compare on show, nothing could be fitted to; half of them stay.
        shown = selection.odd_windows(search.unseen_mse(current), current.mse)[::2]
        new, others = search.unseen.pick(shown), np.delete(np.arange(len(search.unseen.windows)), shown)
        search.compare_on(search.unseen.pick(others))
        _take_in(search, new)
        current = search.path[-1]
    if quiet(current) and len(search.rest.windows):
        mse, _ = evaluate(search.rest, current.structure, current.z)
        which = selection.eventful(search.problem.windows, current.mse, search.rest.windows, mse)
        new, search.rest = search.rest.pick(which), search.rest.pick(~which)
        _take_in(search, new)
    windows = search.problem.windows.join(search.unseen.windows)
    _leave_aside(search, selection.without_echoes(windows, search.mse(search.path[-1])))
    current = search.path[-1]
    if quiet(current):
        search.few = np.append(search.few, np.setdiff1d(selection.odd_windows(current.mse), search.few))
    return current


def _take_in(search: Search, new: Problem) -> None:
    """Fit some more windows; what is known already learns what it says of them."""
    if not len(new.windows):
        return

    def informed(fitted: Fit) -> Fit:
        return fitted.join(fit(new, fitted.structure, fitted.z, most=0))

    search.problem = search.problem.join(new)
    search.path = [informed(fitted) for fitted in search.path]
    search.anchor = search.anchor and informed(search.anchor)
    search.rounds = [
        [replace(tried, fitted=tried.fitted and informed(tried.fitted)) for tried in hypotheses]
        for hypotheses in search.rounds
    ]


def _leave_aside(search: Search, keep: NDArray[np.bool_]) -> None:
    """Go on with some of the windows, of the fitted and then of the unseen ones."""
    if keep.all():
        return
    count = len(search.problem.windows)
    which, few = np.flatnonzero(keep[:count]), np.flatnonzero(keep[search.few])
    search.problem = search.problem.pick(which)
    search.compare_on(search.unseen.pick(keep[count:]))
    search.path = [fitted.pick(which) for fitted in search.path]
    search.anchor = search.anchor and search.anchor.pick(which)
    search.rounds = [[tried.pick(which, few) for tried in hypotheses] for hypotheses in search.rounds]
    search.few = np.searchsorted(which, search.few[few])
