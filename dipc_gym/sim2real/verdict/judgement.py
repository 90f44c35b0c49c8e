"""What a finished search comes to on test data, which no choice has seen: errors, intervals, shares, the verdict.

Every stage may fail alone: what was found before it stands, and a note says what is lacking.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dipc_gym import mjcf
from dipc_gym.recording.checks import sampled_slowly
from dipc_gym.sim2real.result import Details, Diagnosis, Located, Missing, SensorFit, Verdict
from dipc_gym.sim2real.selection.baseline import Baseline
from dipc_gym.sim2real.selection.case import Case
from dipc_gym.sim2real.selection.search import Searched
from dipc_gym.sim2real.selection.settings import SCORE
from dipc_gym.sim2real.verdict import findings, improve, last_choice, sentences, word
from dipc_gym.sim2real.verdict.conclude import Conclusion
from dipc_gym.sim2real.verdict.details import details, predictions, sensor_fits
from dipc_gym.sim2real.verdict.guarded import Guarded
from dipc_gym.sim2real.verdict.last_choice import Chosen
from dipc_gym.sim2real.verdict.measure import Measured, measure
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
    last = last_choice.choose(base, test, search, found, guarded)
    measured = measure(case, base, test, last, guarded)
    tested, sure = measured.tested, measured.sure
    named = _named(case, last, measured, located, guarded)
    source, final, notes = case.given.source, last.found.fitted, [*last.found.notes, *measured.notes, *named.notes]
    improved = guarded(
        "What the improved model costs at its own step",
        lambda: improve.improved_model(
            source, case.given.physics, last.seen, last.problem, last.three, last.found.fitted
        ),
        lambda: improve.Improved(
            final.structure.write(final.z).text(), needs_loader=improve.needs_loader(final.structure)
        ),
    )
    unheld = sentences.initial_states(improved.written, tested.test) if improved.written else ""
    predicted = guarded("Predictions of test data", lambda: predictions(last.problem, *last.three), dict[str, Array])
    sensors = guarded(
        "Errors in the units of the sensors",
        lambda: sensor_fits(last.problem.windows, case.given.physics.model, predicted),
        tuple[SensorFit, ...],
    )
    behind: Details | None = guarded(
        "What the report draws",
        lambda: details(source, base, last.search, last.found, last.problem, located, improved.text, predicted),
        lambda: None,
    )
    verdict, others = named.verdict, bool(last.found.others)
    sentence = guarded(
        "The sentence",
        lambda: sentences.in_one_sentence(
            verdict,
            named.missing,
            sure.changed,
            tested.test,
            others=others,
            written=improved.written,
            sensors=sensors,
            beyond=tested.beyond,
            later=tested.later,
            compared=tested.comparison,
        ),
        lambda: f"{verdict[0].upper()}{verdict[1:]}.",
    )
    diagnosis = Diagnosis(
        verdict=verdict,
        sentence=sentence,
        located=tuple(located),
        missing=tuple(named.missing),
        recalibrated=tuple(sure.changed),
        comparison=tested.comparison,
        held_out=tested.test,
        held_out_was_fitted=tested.was_fitted,
        validation=last.validation,
        beyond=tested.beyond,
        written=improved.written,
        sensors=sensors,
        force=tested.force,
        next_experiment=sentences.next_experiment(
            verdict,
            named.missing,
            others=bool(sure.changed and others),
            beyond=tested.beyond,
            slow=any(sampled_slowly(r) for r in (*case.given.recordings, *last.problem.windows.recordings)),
        ),
        improved=improved.text,
        needs_loader=improved.needs_loader,
        files=files_of(source, improved.text),
        notes=(*notes, *filter(None, (improved.note, unheld))),
        details=behind,
    )
    return diagnosis, last.found


@dataclass(frozen=True)
class _Named:
    """The verdict, what is missing, strongest first, and notes."""

    verdict: Verdict
    missing: list[Missing]
    notes: list[str]


def _named(case: Case, last: Chosen, measured: Measured, located: Sequence[Located], guarded: Guarded) -> _Named:
    search, found, final, tested, sure = last.search, last.found, last.found.fitted, measured.tested, measured.sure
    errors = tested.telling
    terms = [term for term in final.structure.named if term.key not in found.unnamed]
    verdict = word.verdict(
        errors,
        small=word.negligible(errors.recalibrated, last.problem.motion, located[0]),
        terms=len(terms),
        unnamed=len(found.unnamed),
        modelled=len(final.structure.unnamed),
        changed=len(sure.changed),
        elsewhere=tested.comparison.recalibrated,
    )
    notes = list[str]()
    if errors.nominal <= SCORE.at_floor and verdict in ("unexplained", "recalibrated"):
        notes.append(sentences.not_in_test(tested.comparison.recalibrated, errors.nominal))
    missing = guarded(
        "How much each effect is worth",
        lambda: findings.missing_effects(search, found, last.problem, last.three[0], sure.alone, sure.wide),
        lambda: findings.named_alone(final),
    )
    if search.stop.asked:
        notes.append("The search was interrupted: effects may be lacking, and not all rivals were compared.")
    notes += sentences.other_parameters(sure.changed, [other.structure.model_parameters for other in found.others])
    if verdict in ("partly explained", "unexplained") and errors.improved > SCORE.at_floor:
        alone = missing
        missing = guarded(
            "Where what is left acts",
            lambda: findings.with_unknown(alone, errors, search, final, case.prepared.structure.base),
            lambda: alone,
        )
    return _Named(verdict, missing, notes)


def files_of(source: mjcf.Source, text: str) -> dict[str, bytes]:
    """What a text made from this source asks for; what was included stands in the text itself."""
    return source.asked_by(text)
