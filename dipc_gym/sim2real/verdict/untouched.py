"""How well windows are predicted that no fit has touched."""

from __future__ import annotations

import numpy as np

from dipc_gym.sim2real.estimation.fit import Fit, evaluate
from dipc_gym.sim2real.estimation.problem import Problem
from dipc_gym.sim2real.estimation.shooting import rms
from dipc_gym.sim2real.selection.score import Improvement
from dipc_gym.sim2real.selection.scorer import compare_on
from dipc_gym.sim2real.selection.search import Searched
from dipc_gym.sim2real.selection.settings import SCORE
from dipc_gym.sim2real.selection.support import supported
from dipc_gym.sim2real.verdict.settings import VERDICT


def error_on(problem: Problem, fitted: Fit) -> float:
    """Root mean square error on windows that no fit has touched, in units of noise."""
    return rms(evaluate(problem, fitted.structure, fitted.z))


def fair(search: Searched, fitted: Fit) -> Problem:
    """The validation data that may speak against a fit: windows in which its laws are asked where they have data.

    Where there are none, those that were compared on.
    """
    validation = search.partition.validation
    there = supported(fitted, search.partition.problem, validation)
    return validation.pick(there) if there.any() else search.partition.comparison


def on(problem: Problem, new: Fit, old: Fit) -> Improvement:
    """How much better one fit predicts windows than another."""
    after, before = (evaluate(problem, one.structure, one.z) for one in (new, old))
    return compare_on(problem, new, old, after, before, problem.blocks)


def on_untouched(search: Searched, new: Fit, old: Fit) -> Improvement:
    """How much better one fit predicts than another on windows that no fit has touched, validation among them."""
    untouched, validation = search.partition.comparison, fair(search, new)
    after, before = search.scorer.comparison_mse(new), search.scorer.comparison_mse(old)
    if validation is not untouched:
        untouched = untouched.join(validation)
        after, before = (
            np.append(known, evaluate(validation, one.structure, one.z)) for known, one in ((after, new), (before, old))
        )
    return compare_on(untouched, new, old, after, before, untouched.blocks)


def refuted(without: float, error: float) -> bool:
    """Whether validation data speak against an effect: they are predicted clearly worse than without it."""
    return error > SCORE.at_floor and error > VERDICT.refuted * without
