"""What a finished search comes to on test data, which no choice has seen: errors, intervals, shares, the verdict.

Every stage may fail alone: what was found before it stands, and a note says what is lacking.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dipc_gym import mjcf
from dipc_gym.recording.checks import sampled_slowly
from dipc_gym.sim2real.effects.law import Law
from dipc_gym.sim2real.estimation import unexplained
from dipc_gym.sim2real.estimation.fit import Fit
from dipc_gym.sim2real.estimation.problem import Problem
from dipc_gym.sim2real.estimation.shooting import common_error, rms
from dipc_gym.sim2real.estimation.steps import controlled
from dipc_gym.sim2real.model.structure import carry, names
from dipc_gym.sim2real.result import Beyond, Details, Diagnosis, Errors, Located, Missing, SensorFit, Verdict
from dipc_gym.sim2real.selection import beginnings, beside
from dipc_gym.sim2real.selection.baseline import Baseline
from dipc_gym.sim2real.selection.case import Case
from dipc_gym.sim2real.selection.progress import Partition
from dipc_gym.sim2real.selection.search import Searched
from dipc_gym.sim2real.selection.settings import SCORE
from dipc_gym.sim2real.verdict import findings, improve, intervals, judge, sentences, untouched
from dipc_gym.sim2real.verdict.beyond import beyond
from dipc_gym.sim2real.verdict.conclude import Conclusion
from dipc_gym.sim2real.verdict.details import details, predictions, sensor_fits
from dipc_gym.sim2real.verdict.guarded import Guarded
from dipc_gym.sim2real.verdict.law_formulas import in_closed_form
from dipc_gym.sim2real.verdict.settings import VERDICT
from dipc_gym.sim2real.verdict.withheld import Test

Array = NDArray[np.float64]


def judgement(
    case: Case,
    base: Baseline,
    test: Test,
    search: Searched,
    found: Conclusion,
    located: Sequence[Located],
    guarded: Guarded,
) -> tuple[Diagnosis, Conclusion]:
    """Judge what a search came to by test data.

    Args:
        case: data.
        base: what was known before the search.
        test: data that nothing was fitted to or chosen by.
        search: that has run.
        found: what it came to.
        located: where the mismatch sat before it.
        guarded: runs stages, and keeps what was found where one fails.

    Returns:
        The diagnosis, and what the search came to, as it was judged.
    """
    last = _chosen(base, test, search, found, guarded)
    measured = _measured(case, base, test, last, guarded)
    named = _named(case, last, measured, located, guarded)
    source, final, notes = case.given.source, last.found.fitted, [*last.found.notes, *measured.notes, *named.notes]
    improved, written, step_note = guarded(
        "What the improved model costs at its own step",
        lambda: improve.improved_model(
            source, case.given.physics, last.seen, last.problem, last.three, last.found.fitted
        ),
        lambda: (final.structure.write(final.z).text(), None, ""),
    )
    unheld = sentences.initial_states(written, measured.test) if written and measured.test else ""
    predicted = guarded("Predictions of test data", lambda: predictions(last.problem, *last.three), dict[str, Array])
    sensors = guarded(
        "Errors in the units of the sensors",
        lambda: sensor_fits(last.problem.windows, case.given.physics.model, predicted),
        tuple[SensorFit, ...],
    )
    behind: Details | None = guarded(
        "What the report draws",
        lambda: details(source, base, last.search, last.found, last.problem, located, improved, predicted),
        lambda: None,
    )
    verdict, others = named.verdict, bool(last.found.others)
    diagnosis = Diagnosis(
        verdict=verdict,
        sentence=sentences.in_one_sentence(
            verdict,
            named.missing,
            measured.changed,
            measured.test,
            others=others,
            written=written,
            sensors=sensors,
            beyond=measured.beyond,
            later=measured.later,
            compared=measured.comparison,
        ),
        located=tuple(located),
        missing=tuple(named.missing),
        recalibrated=tuple(measured.changed),
        comparison=measured.comparison,
        held_out=measured.test,
        held_out_was_fitted=measured.test_was_fitted,
        validation=last.validation,
        beyond=measured.beyond,
        written=written,
        sensors=sensors,
        force=measured.force,
        next_experiment=sentences.next_experiment(
            verdict,
            named.missing,
            others=bool(measured.changed and others),
            beyond=measured.beyond,
            slow=any(sampled_slowly(r) for r in (*case.given.recordings, *last.problem.windows.recordings)),
        ),
        improved=improved,
        files=files_of(source, improved),
        notes=(*notes, *filter(None, (step_note, unheld))),
        details=behind,
    )
    return diagnosis, last.found


@dataclass(frozen=True)
class _Chosen:
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


def _chosen(base: Baseline, test: Test, search: Searched, found: Conclusion, guarded: Guarded) -> _Chosen:
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
    return _Chosen(last.search, last.found, three, best.search.partition, validation, last.problem)


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


@dataclass(frozen=True)
class _Measured:
    """Errors, and how sure parameters are.

    Attributes:
        comparison: errors on the windows that were compared on.
        test: on test data.
        test_was_fitted: whether that could not be worked out, and is the error on fitted windows.
        beyond: of these, what goes beyond what laws were fitted with; None where nothing does.
        later: error there of the fit that goes to the end of time, where a law of time ends before; else None.
        force: of the inverse models there, at each joint.
        wide: of the intervals of the parameters.
        alone: what has a name without laws of no kind, where that goes before them.
        changed: parameters of the model that had to change.
        notes: in sentences.
    """

    comparison: Errors
    test: Errors
    test_was_fitted: bool
    beyond: Beyond | None
    later: float | None
    force: dict[str, Errors]
    wide: findings.Wide
    alone: Fit | None
    changed: list[dict[str, Any]]
    notes: list[str] = field(default_factory=list)

    @property
    def telling(self) -> Errors:
        """On the test data that say what is still missing."""
        return _telling(self.test, self.beyond, self.later)


def _telling(test: Errors, outside: Beyond | None, later: float | None) -> Errors:
    """Errors on the test data that say what is still missing: those in which laws have data.

    A law of time has none in what comes after, all of it; there a fit to that time tells whether more is missing.
    """
    telling = test if outside is None else outside.within
    return telling if later is None else replace(telling, improved=min(telling.improved, later))


def _measured(case: Case, base: Baseline, test: Test, last: _Chosen, guarded: Guarded) -> _Measured:
    search, found, three, final = last.search, last.found, last.three, last.found.fitted
    open_choice = guarded(
        "Whether other parameters would do",
        lambda: findings.choice_shift(final, found.others),
        lambda: np.full(len(final.z), np.inf),
    )
    fitted = Errors(*(f.error for f in three))
    comparison = guarded(
        "The error on windows to compare on",
        lambda: Errors(*(search.scorer.comparison_error(f) for f in three)),
        lambda: fitted,
    )
    notes = list[str]()
    if comparison.recalibrated > SCORE.at_floor and not search.stop.asked:
        notes += guarded(
            "Whether parameters further off would do",
            lambda: findings.beyond_limits(base.partition.problem, search.partition.validation, base.recalibrated),
            list[str],
        )
    errors = guarded(
        "The error on test data",
        lambda: Errors(*(untouched.error_on(last.problem, f) for f in three)),
        lambda: None,
    )
    was_fitted = errors is None
    if errors is None:
        errors = fitted
        notes.append(sentences.NOT_HELD_OUT)
    outside: Beyond | None = guarded(
        "What goes beyond the fitted data",
        lambda: beyond(three, last.seen.problem, last.problem),
        lambda: None,
    )
    if outside is not None:
        notes.append(sentences.goes_beyond(outside, fitted=last.reaches_the_end))
    of_time = any(isinstance(one.effect, Law) and "time" in one.effect.axes(one.at) for one in final.structure.terms)
    later: float | None = None
    if of_time and last.reaches_the_end:
        later = guarded("What is left later", lambda: untouched.error_on(last.problem, final), lambda: None)
    begin = guarded("How recordings begin", lambda: beginnings.left(search.partition.first, final), lambda: None)
    if begin is not None:
        notes.append(sentences.begins_otherwise(begin))
    force = guarded(
        "The error of forces", lambda: _force_errors(three, case.prepared.structure.base, test), dict[str, Errors]
    )
    notes += sentences.disagreement(errors, force)

    def half_widths() -> NDArray[np.float64]:
        problem = search.partition.problem
        # Recordings that only the model's own steps predict say what they say in these, whatever finer ones change.
        steps = findings.step_shift(final, problem) if base.fine is None else 0.0
        return intervals.by_blocks(final, problem) + steps + open_choice

    wide = guarded(
        "The intervals of the parameters",
        half_widths,
        lambda: np.full(len(final.z), np.inf),
    )
    alone: Fit | None = guarded(
        "Names without laws", lambda: beside.names_alone(search.fitter, final, search.progress.path[0]), lambda: None
    )
    left = max(comparison.improved, _telling(errors, outside, later).improved)
    if final.structure.unnamed or left > SCORE.at_floor:
        of_names = guarded(
            "What is left adds to the intervals",
            lambda: findings.beside_unknown(search, final, alone, wide),
            lambda: np.full(len(final.z), np.inf),
        )
    else:
        of_names = wide
    changed = guarded(
        "Which parameters changed", lambda: findings.changed_parameters(final, of_names), list[dict[str, Any]]
    )
    return _Measured(
        comparison=comparison,
        test=errors,
        test_was_fitted=was_fitted,
        beyond=outside,
        later=later,
        force=force,
        wide=findings.Wide(wide, of_names),
        alone=alone,
        changed=changed,
        notes=notes,
    )


@dataclass(frozen=True)
class _Named:
    """The verdict, what is missing, strongest first, and notes."""

    verdict: Verdict
    missing: list[Missing]
    notes: list[str]


def _named(case: Case, last: _Chosen, measured: _Measured, located: Sequence[Located], guarded: Guarded) -> _Named:
    search, found, final, errors = last.search, last.found, last.found.fitted, measured.telling
    terms = [term for term in final.structure.named if term.key not in found.unnamed]
    verdict = judge.verdict(
        errors,
        small=judge.negligible(errors.recalibrated, last.problem.motion, located[0]),
        terms=len(terms),
        unnamed=len(found.unnamed),
        modelled=len(final.structure.unnamed),
        changed=len(measured.changed),
        elsewhere=measured.comparison.recalibrated,
    )
    notes = list[str]()
    if errors.nominal <= SCORE.at_floor and verdict == "unexplained":
        notes.append(sentences.not_in_test(measured.comparison.recalibrated, errors.nominal))
    missing = guarded(
        "How much each effect is worth",
        lambda: findings.missing_effects(search, found, last.problem, last.three[0], measured.alone, measured.wide),
        lambda: findings.named_alone(final),
    )
    if search.stop.asked:
        notes.append("The search was interrupted: effects may be lacking, and not all rivals were compared.")
    notes += sentences.other_parameters(measured.changed, [other.structure.model_parameters for other in found.others])
    if verdict in ("partly explained", "unexplained") and errors.improved > SCORE.at_floor:
        alone = missing
        missing = guarded(
            "Where what is left acts",
            lambda: findings.with_unknown(alone, errors, search, final, case.prepared.structure.base),
            lambda: alone,
        )
    return _Named(verdict, missing, notes)


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


def files_of(source: mjcf.Source, text: str) -> dict[str, bytes]:
    """What a text made from this source asks for; what was included stands in the text itself."""
    return source.asked_by(text)


def _force_errors(
    fits: Sequence[Fit],
    joints: Sequence[str],
    test: Test,
) -> dict[str, Errors]:
    """Errors of the inverse models at each joint, without what happened once: not then, or in another recording."""
    tested, forces = (test.recordings, test.motions, test.span), list[Array]()
    for one in fits:
        lasting = one.structure
        for term in one.structure.terms:
            lasting = lasting.without(term.key) if term.effect.once else lasting
        forces.append(unexplained.force_errors(lasting.physics(carry(one.structure, one.z, lasting)), *tested))
    return {joint: Errors(*map(float, e)) for joint, e in zip(joints, np.stack(forces).T, strict=True)}
