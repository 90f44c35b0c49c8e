"""The last choice: a fit in steps as fine as predictions ask for, and what predicts validation data best.

After these have judged it, laws are fitted to the ends of recordings as well; nothing is chosen after that.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dipc_gym.sim2real.estimation.fit import Fit
from dipc_gym.sim2real.estimation.problem import Problem
from dipc_gym.sim2real.estimation.shooting import common_error, rms
from dipc_gym.sim2real.estimation.steps import controlled
from dipc_gym.sim2real.model.structure import names
from dipc_gym.sim2real.result import Errors
from dipc_gym.sim2real.selection.baseline import Baseline
from dipc_gym.sim2real.selection.progress import Partition
from dipc_gym.sim2real.selection.search import Searched
from dipc_gym.sim2real.selection.settings import SCORE
from dipc_gym.sim2real.verdict import sentences, untouched
from dipc_gym.sim2real.verdict.conclude import Conclusion
from dipc_gym.sim2real.verdict.guarded import Guarded
from dipc_gym.sim2real.verdict.law_formulas import in_closed_form
from dipc_gym.sim2real.verdict.settings import VERDICT
from dipc_gym.sim2real.verdict.withheld import Test


@dataclass(frozen=True)
class Chosen:
    """What is judged, after the last choice.

    Attributes:
        search: that came to it, in the steps and over the windows that were fitted last.
        found: what it came to, fitted to all of them.
        three: the model as given, recalibrated, and improved, as they are judged.
        seen: windows that these were fitted to and chosen by.
        validation: errors of the three on validation data; None where they could not be worked out.
        problem: windows to test with, in the same steps.
    """

    search: Searched
    found: Conclusion
    three: tuple[Fit, Fit, Fit]
    seen: Partition
    validation: Errors | None
    problem: Problem

    @property
    def reaches_the_end(self) -> bool:
        """Whether what is reported was fitted to the ends of recordings as well, after these had judged it."""
        return self.found.fitted is not self.three[-1]


@dataclass(frozen=True)
class _Stage:
    """What a search came to, at one stage of the last choice.

    Attributes:
        search: that came to it.
        found: what it came to.
        problem: windows to test with, in the same steps.
    """

    search: Searched
    found: Conclusion
    problem: Problem


def choose(base: Baseline, test: Test, search: Searched, found: Conclusion, guarded: Guarded) -> Chosen:
    """Fit in steps as fine as predictions ask for, and choose by validation data what predicts best; nothing is chosen
    after that.
    """
    problem = replace(test.problem, stepping=base.partition.problem.stepping)
    elsewhere = untouched.pushed_elsewhere(search, found.fitted, problem.windows)
    if elsewhere.any() and not elsewhere.all():
        problem = problem.pick(~elsewhere)
        found = replace(found, notes=[*found.notes, sentences.pushed_elsewhere(int(elsewhere.sum()))])
    fine = _in_fine_steps(base, _Stage(search, found, problem), guarded)
    best, validation = _best(base, found.fitted, fine, guarded)
    last = _as_far_as_recorded(test, best, guarded)
    three = base.nominal, base.recalibrated, best.found.fitted
    return Chosen(last.search, last.found, three, best.search.partition, validation, last.problem)


def _in_fine_steps(base: Baseline, stage: _Stage, guarded: Guarded) -> _Stage:
    """The search compares in one step; what it came to is fitted, judged and reported with controlled errors."""
    if base.fine is not None:
        return stage
    coarse = stage.found.fitted
    search, final = guarded(
        "A fit in finer steps", lambda: stage.search.refined(coarse), lambda: (stage.search, coarse)
    )
    problem = guarded(
        "Finer steps for test data",
        lambda: controlled(stage.problem, final.structure, final.z),
        lambda: stage.problem,
    )
    return _Stage(search, replace(stage.found, fitted=final), problem)


def _best(base: Baseline, coarse: Fit, stage: _Stage, guarded: Guarded) -> tuple[_Stage, Errors | None]:
    """What predicts validation data best, fitted to these as well if laws are in it; and errors on them.

    Errors are of the model as given, recalibrated, and of this one before that; None where there are none.

    Args:
        base: what was known before the search.
        coarse: what the search came to in its own steps.
        stage: the same in fine ones.
        guarded: runs stages.
    """
    search, nominal, recalibrated = stage.search, base.nominal, base.recalibrated
    found = guarded(
        "Which model predicts best",
        lambda: best_on_validation(search, stage.found, search.progress.informed((coarse, recalibrated, nominal))),
        lambda: stage.found,
    )
    validating = search.partition.validation
    validation: Errors | None = guarded(
        "The error on validation data",
        lambda: Errors(*(untouched.error_on(validating, f) for f in (nominal, recalibrated, found.fitted))),
        lambda: None,
    )
    if validation is not None and _as_given(search, found, validation):
        as_given = Conclusion(search.progress.informed((nominal,))[0], notes=found.notes)
        return replace(stage, found=as_given), replace(validation, improved=validation.nominal)
    if not any(term.effect.free for term in found.fitted.structure.terms):
        return replace(stage, found=found), validation
    longer, whole = guarded("A fit to all windows", lambda: search.whole(found.fitted), lambda: (search, found.fitted))
    return _Stage(longer, _plainly(replace(found, fitted=whole), longer, guarded), stage.problem), validation


def _as_far_as_recorded(test: Test, stage: _Stage, guarded: Guarded) -> _Stage:
    """With laws fitted to the ends of recordings as well, after these have judged them."""
    judged = stage.found.fitted
    if not (test.ends and any(term.effect.free for term in judged.structure.terms)):
        return stage
    search, last = guarded(
        "A fit to the ends of the recordings",
        lambda: _to_the_end(stage.search, judged, stage.problem),
        lambda: (stage.search, judged),
    )
    found = stage.found if last is judged else _plainly(replace(stage.found, fitted=last), search, guarded)
    return _Stage(search, found, stage.problem)


def _plainly(found: Conclusion, search: Searched, guarded: Guarded) -> Conclusion:
    """With formulas in the place of tables where they predict as well."""
    tables = replace(found, formulas={})  # those of a fit before say nothing of this one
    seen = search.partition
    return guarded("Formulas of laws", lambda: in_closed_form(tables, seen.problem, seen.first), lambda: tables)


def _to_the_end(search: Searched, judged: Fit, end: Problem) -> tuple[Searched, Fit]:
    """A fit to the ends of recordings too, which judge the fit before: tables go as far as all that was recorded.

    The fit before where this one is no better there, or worse elsewhere.
    """
    after, last = search.to_the_end(judged, end)
    count = len(judged.mse)
    elsewhere = common_error(last.mse[:count]) <= VERDICT.worse * max(common_error(judged.mse), 1.0)
    there = rms(last.mse[count:]) <= untouched.error_on(end, judged)
    return (after, last) if elsewhere and there else (search, judged)


def _as_given(search: Searched, found: Conclusion, validation: Errors) -> bool:
    """Whether data that may choose speak for the model as it was given: it predicts to the noise, or what is left is
    small and shapeless, and other parameters do no better.
    """
    if found.fitted.structure.terms:
        return False
    elsewhere = search.scorer.comparison_error(search.progress.path[0]) <= VERDICT.elsewhere
    at_noise = elsewhere and validation.nominal <= SCORE.at_floor
    gained = validation.nominal - validation.improved > VERDICT.refitted * (validation.nominal - 1)
    refits = elsewhere and validation.improved <= SCORE.at_floor
    moved = np.abs(found.fitted.z) >= VERDICT.negligible
    return at_noise or ((refits or search.scorer.small) and not gained) or not moved.any()


def best_on_validation(search: Searched, found: Conclusion, others: Sequence[Fit]) -> Conclusion:
    """A conclusion, or the first of other fits that predict validation data no worse than any, with a note on that.

    Nobody is given a model that predicts worse than what they had. At the noise, all are as good.
    """
    validation = untouched.fair(search, found.fitted)
    errors = [untouched.error_on(validation, fitted) for fitted in (found.fitted, *others)]
    least = max(VERDICT.worse * min(errors), SCORE.at_floor)
    if not errors[0] > least:  # nor where nothing is known of it
        return found
    k = next(k for k, error in enumerate(errors) if error <= least)
    other = others[k - 1]
    if names(other.structure.terms) == names(found.fitted.structure.terms):
        return replace(found, fitted=other)
    note = sentences.refutation(found.fitted.structure.terms, errors[k], errors[0], "Refitted parameters")
    return Conclusion(other, notes=[*found.notes, note])
