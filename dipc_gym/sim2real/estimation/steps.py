"""Steps as fine as predictions ask for, window by window: what integration errs by stays below the noise."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dipc_gym.sim2real.estimation.problem import Problem, normalised_residual, predict
from dipc_gym.sim2real.estimation.settings import ESTIMATION
from dipc_gym.sim2real.model.structure import Structure

Array = NDArray[np.float64]


def controlled(problem: Problem, structure: Structure, z: Array) -> Problem:
    """Windows in steps that are halved where that still changes predictions, by more than a share of the noise.

    Free motion is told by the longest steps; where a joint turns round, or meets a stop, errors are larger, and fall
    more slowly. So each window is asked for itself.

    Args:
        problem: windows.
        structure: of the model.
        z: its mapped parameters, (p,).

    Returns:
        The same problem where no window needs finer steps.
    """
    if not len(problem.windows):
        return problem
    asked, more = np.arange(len(problem.windows)), np.zeros(len(problem.windows), dtype=np.intp)
    before = predict(problem, structure, [z], problem.initial[None])[0]
    for halvings in range(1, ESTIMATION.halvings + 1):
        part = problem.pick(asked)
        after = predict(part.halved_by(halvings), structure, [z], part.initial[None])[0]
        off = change(part, after, before) > ESTIMATION.integration
        asked, before = asked[off], after[off]
        more[asked] = halvings
        if not len(asked):
            break
    return problem.halved_by(more) if more.any() else problem


def change(problem: Problem, after: Array, before: Array) -> Array:
    """Root mean square of how far readings (n, m, ns) moved in each window, in units of noise, (n,)."""
    moved = normalised_residual(problem, before) - normalised_residual(problem, after)
    return np.sqrt(np.sum(moved**2, axis=(1, 2)) / problem.counts)
