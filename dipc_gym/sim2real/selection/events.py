"""Turn to windows in which something else happened, as soon as a search explains the others.

A push under friction shows only once friction is known. Until then its window is one of many that are far off, and may
be among those left aside.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dipc_gym.sim2real.estimation.fit import evaluate, fit
from dipc_gym.sim2real.selection import partitioning, ranking
from dipc_gym.sim2real.selection.progress import Progress
from dipc_gym.sim2real.selection.scorer import Scorer
from dipc_gym.sim2real.selection.settings import SEARCH


def attend(progress: Progress, scorer: Scorer) -> Progress:
    """A search on the windows that it is to go on with, chosen by what stands out beside its present fit.

    Args:
        progress: of the search.
        scorer: compares on its windows.
    """
    if ranking.mostly_at_noise(progress.current):
        progress = _around_outliers(progress, scorer)
    partition = progress.partition
    windows = partition.problem.windows.join(partition.comparison.windows)
    mse = scorer.over(partition).mse(progress.current)
    aside = partition.aside.pick(~partitioning.echoes(windows, mse, partition.aside.windows))  # some of them validate
    progress = replace(progress, partition=replace(partition, aside=aside)).keeping(
        ~partitioning.echoes(windows, mse, windows)
    )
    if not ranking.mostly_at_noise(progress.current):
        return progress
    partition = progress.partition
    new = np.setdiff1d(partitioning.outliers(progress.current.mse), partition.subset)
    return replace(progress, partition=replace(partition, subset=np.append(partition.subset, new)))


def _around_outliers(progress: Progress, scorer: Scorer) -> Progress:
    """With the windows around outliers to fit: they tell when something began and ended.

    Some of them are taken from those to compare on, others from those left aside.
    """
    current, partition = progress.current, progress.partition
    mse = scorer.comparison_mse(current)
    if len(partition.aside.windows):
        mse = np.append(mse, evaluate(partition.aside, current.structure, current.z))
    others, compared = partition.comparison.join(partition.aside), len(partition.comparison.windows)
    which = partitioning.eventful(partition.problem.windows, current.mse, others.windows, mse)
    taken = replace(partition, aside=partition.aside.pick(~which[compared:]))
    if which[:compared].any():
        taken = replace(taken, comparison=partition.comparison.pick(~which[:compared]))
    if not which.any():
        return progress
    progress = replace(progress, partition=taken).taking_in(others.pick(which))
    current = progress.current
    if not any(term.effect.free for term in current.structure.terms):
        return progress
    # An end of a table may need no more than to be fitted to the new windows, as whatever is tried beside it is. A
    # push, which is no longer asked for beside a table, must not bend the fit before it is tried.
    again = fit(progress.partition.problem, current.structure, current.z, current.initial, most=SEARCH.onward_steps)
    return replace(progress, path=(*progress.path[:-1], again))
