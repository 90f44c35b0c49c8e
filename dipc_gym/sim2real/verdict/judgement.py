"""What a finished search comes to on test data, which no choice has seen: errors, intervals, shares, the verdict.

Every stage may fail alone: what was found before it stands, and a note says what is lacking.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dipc_gym import mjcf
from dipc_gym.sim2real.estimation import unexplained
from dipc_gym.sim2real.estimation.fit import Fit
from dipc_gym.sim2real.model.structure import names
from dipc_gym.sim2real.result import Details, Diagnosis, Errors, Located, SensorFit
from dipc_gym.sim2real.selection.baseline import Baseline
from dipc_gym.sim2real.selection.case import Case, Test
from dipc_gym.sim2real.selection.search import Search
from dipc_gym.sim2real.selection.settings import SCORE
from dipc_gym.sim2real.verdict import findings, improve, judge, sentences
from dipc_gym.sim2real.verdict.conclude import Conclusion
from dipc_gym.sim2real.verdict.details import details, predictions, sensor_fits
from dipc_gym.sim2real.verdict.late import Late
from dipc_gym.sim2real.verdict.settings import VERDICT

Array = NDArray[np.float64]


def judgement(
    case: Case,
    base: Baseline,
    test: Test,
    search: Search,
    found: Conclusion,
    located: Sequence[Located],
    provenance: dict[str, Any],
    late: Late,
) -> tuple[Diagnosis, Conclusion]:
    """Judge what a search came to by test data.

    Args:
        case: data.
        base: what was known before the search.
        test: data that nothing was fitted to or chosen by.
        search: that has run.
        found: what it came to.
        located: where the mismatch sat before it.
        provenance: versions, inputs, seed.
        late: runs stages, and keeps what was found where one fails.

    Returns:
        The diagnosis, and what the search came to, as it was judged.
    """
    source, prepared, nominal, recalibrated = case.given.source, case.prepared, base.nominal, base.recalibrated
    joints, concluded = prepared.structure.base, found
    coarse, windows = found.fitted, replace(test.problem, stepping=base.partition.problem.stepping)
    if base.fine is None:
        # The search compares; what it came to is fitted, judged and reported at half the step.
        final = late("A fit at half the step", lambda: search.refine(coarse), lambda: coarse)
        windows = windows if final is coarse else replace(windows, finer=2)
        concluded = replace(found, fitted=final)
    best = found = late(
        "Which model predicts best",
        lambda: _best(search, concluded, search.journal.informed((coarse, recalibrated, nominal))),
        lambda: concluded,
    )
    validation = late(
        "The error on validation data",
        lambda: Errors(
            *(judge.error_on(search.partition.validation, f) for f in (nominal, recalibrated, found.fitted))
        ),
        lambda: None,
    )
    if any(term.effect.free for term in found.fitted.structure.terms):  # nothing chooses any more
        found = late("A fit to all windows", lambda: replace(best, fitted=search.fit_all(best.fitted)), lambda: best)
    if validation is not None and _as_given(search, found, validation):
        found = Conclusion(search.journal.informed((nominal,))[0], notes=found.notes)
        validation = replace(validation, improved=validation.nominal)
    notes, final = [*found.notes], found.fitted
    open_choice = late(
        "Whether other parameters would do",
        lambda: findings.choice_shift(final, found.others),
        lambda: np.full(len(final.z), np.inf),
    )
    three = (nominal, recalibrated, final)
    fitted = Errors(*(f.error for f in three))
    train = late(
        "The error on windows to compare on",
        lambda: Errors(*(search.scorer.comparison_error(f) for f in three)),
        lambda: fitted,
    )
    if train.recalibrated > SCORE.at_floor and not search.interrupted:
        notes += late(
            "Whether parameters further off would do",
            lambda: findings.beyond_limits(base.partition.problem, search.partition.validation, recalibrated),
            list[str],
        )
    errors = late(
        "The error on test data",
        lambda: Errors(*(judge.error_on(windows, f) for f in three)),
        lambda: fitted,
    )
    force = late(
        "The error of forces",
        lambda: _force_errors(three, joints, test),
        dict[str, Errors],
    )
    notes += sentences.disagreement(errors, force)
    wide = late(
        "The intervals of the parameters",
        lambda: (
            judge.intervals(final, search.partition.problem)
            + findings.step_shift(final, search.partition.problem)
            + open_choice
        ),
        lambda: np.full(len(final.z), np.inf),
    )
    changed = late("Which parameters changed", lambda: findings.changed_parameters(final, wide), list[dict[str, Any]])
    small = judge.negligible(errors.recalibrated, windows.motion, located[0])
    modelled = [term for term in final.structure.terms if term.effect.of_no_kind]
    named_terms = [term for term in final.structure.terms if term not in modelled and term.key not in found.unnamed]
    verdict = judge.verdict(
        (errors.nominal, errors.recalibrated, errors.improved),
        small,
        len(named_terms),
        len(changed),
        len(found.unnamed),
        len(modelled),
        train.recalibrated,
    )
    if errors.nominal <= SCORE.at_floor and verdict == "unexplained":
        notes.append(sentences.not_in_test(train.recalibrated, errors.nominal))
    missing = late(
        "How much each effect is worth",
        lambda: findings.missing_effects(search, found, windows, errors, verdict, wide),
        lambda: findings.named_alone(final),
    )
    if search.interrupted:
        notes.append("The search was interrupted: effects may be lacking, and not all rivals were compared.")
    notes += sentences.other_parameters(changed, [other.structure.model_parameters for other in found.others])
    if verdict in ("partly explained", "unexplained") and errors.improved > SCORE.at_floor:
        named = missing
        missing = late(
            "Where what is left acts",
            lambda: findings.with_unknown(named, errors, search, final, joints),
            lambda: named,
        )
    improved, written, step_note = late(
        "What the improved model costs at its own step",
        lambda: improve.improved_model(source, case.given.physics, search.partition, windows, three, errors),
        lambda: (final.structure.write(final.z).text(), None, ""),
    )
    notes += [step_note] if step_note else []
    predicted = late("Predictions of test data", lambda: predictions(windows, *three), dict[str, Array])
    sensors = late(
        "Errors in the units of the sensors",
        lambda: sensor_fits(windows.windows, case.given.physics.model, predicted),
        tuple[SensorFit, ...],
    )
    judged, text = found, improved
    behind: Details | None = late(
        "What the report draws",
        lambda: details(source, base, search, judged, windows, located, text, predicted),
        lambda: None,
    )
    diagnosis = Diagnosis(
        verdict,
        sentences.in_one_sentence(
            verdict, missing, changed, errors, others=bool(found.others), written=written, sensors=sensors
        ),
        tuple(located),
        tuple(missing),
        tuple(changed),
        train,
        errors,
        validation,
        written,
        sensors,
        force,
        sentences.next_experiment(verdict, missing, others=bool(changed and found.others)),
        improved,
        files_of(source, improved),
        tuple(notes),
        provenance,
        behind,
    )
    return diagnosis, found


def _as_given(search: Search, found: Conclusion, validation: Errors) -> bool:
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


def _best(search: Search, found: Conclusion, others: Sequence[Fit]) -> Conclusion:
    """A conclusion, or the first of other fits that predict validation data no worse than any, with a note on that.

    Nobody is given a model that predicts worse than what they had. At the noise, all are as good.
    """
    errors = [judge.error_on(search.partition.validation, fitted) for fitted in (found.fitted, *others)]
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
    return {name: source.files[name] for name in mjcf.from_text(text, source.folder).files}


def _force_errors(
    fits: Sequence[Fit],
    joints: Sequence[str],
    test: Test,
) -> dict[str, Errors]:
    """Errors of the inverse models at each joint."""
    tested = test.recordings, test.motions, test.span
    forces = [unexplained.force_errors(f.structure.physics(f.z), *tested) for f in fits]
    return {joint: Errors(*map(float, e)) for joint, e in zip(joints, np.stack(forces).T, strict=True)}
