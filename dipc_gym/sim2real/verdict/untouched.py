"""How well windows are predicted that no fit has touched."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dipc_gym.recording import Recording
from dipc_gym.recording.parts import overlap
from dipc_gym.sim2real.estimation.fit import Fit, evaluate
from dipc_gym.sim2real.estimation.problem import Problem
from dipc_gym.sim2real.estimation.shooting import rms
from dipc_gym.sim2real.model.structure import Term
from dipc_gym.sim2real.selection.score import Improvement
from dipc_gym.sim2real.selection.scorer import compare_on
from dipc_gym.sim2real.selection.search import Searched
from dipc_gym.sim2real.selection.settings import SCORE
from dipc_gym.sim2real.selection.support import supported
from dipc_gym.sim2real.simulation.windows import Windows
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


def happened(search: Searched, fitted: Fit, term: Term) -> list[Recording]:
    """In which recordings that were fitted something happened once, by the windows that are predicted better with it.

    Args:
        search: that has run.
        fitted: with the effect, to the windows of the search.
        term: the effect.
    """
    windows = search.partition.problem.windows
    without = search.fitter.as_it_is(fitted, fitted.structure.without(term.key))
    gained = np.log1p(without.mse) - np.log1p(fitted.mse)
    each = np.bincount(windows.source, gained, len(windows.recordings))
    found = zip(windows.recordings, each, strict=True)
    least = min(VERDICT.happened * each.max(), each.max())  # where all lose by it, that is in the one that loses least
    return [recording for recording, gain in found if gain >= least]


def pushed_elsewhere(search: Searched, fitted: Fit, windows: Windows) -> NDArray[np.bool_]:
    """In which windows that nothing was fitted to a push of the model acts that happened in another recording, (n,):
    each has a clock of its own.
    """
    found = np.zeros(len(windows), dtype=bool)
    for term in fitted.structure.terms:
        if term.effect.once:
            begin, end = term.effect.happened(fitted.structure.term_values(fitted.z, term))
            there = happened(search, fitted, term)
            # What is tested with goes on where what is fitted ends.
            own = np.array([any(overlap(one, other) for other in there) for one in windows.recordings])
            during = (windows.start < end) & (windows.start + windows.times.max(axis=1) > begin)
            found |= during & ~own[windows.source]
    return found
