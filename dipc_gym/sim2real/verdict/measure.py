"""What a finished search comes to in numbers: errors on test data and intervals of parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dipc_gym.sim2real.effects.shared.law import Law
from dipc_gym.sim2real.estimation import unexplained
from dipc_gym.sim2real.estimation.fit import Fit
from dipc_gym.sim2real.model.structure import carry
from dipc_gym.sim2real.result import Beyond, Errors
from dipc_gym.sim2real.selection import beginnings, beside
from dipc_gym.sim2real.selection.baseline import Baseline
from dipc_gym.sim2real.selection.case import Case
from dipc_gym.sim2real.selection.settings import SCORE
from dipc_gym.sim2real.verdict import findings, intervals, sentences, untouched
from dipc_gym.sim2real.verdict.beyond import beyond
from dipc_gym.sim2real.verdict.guarded import Guarded
from dipc_gym.sim2real.verdict.last_choice import Chosen
from dipc_gym.sim2real.verdict.withheld import Test

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Tested:
    """Errors of the model as given, recalibrated, and improved.

    Attributes:
        comparison: on the windows that were compared on.
        test: on test data.
        was_fitted: whether that could not be worked out, and is the error on fitted windows.
        beyond: of these, what goes beyond what laws were fitted with; None where nothing does.
        later: error there of the fit that goes to the end of time, where a law of time ends before; else None.
        force: of the inverse models there, at each joint.
    """

    comparison: Errors
    test: Errors
    was_fitted: bool
    beyond: Beyond | None
    later: float | None
    force: dict[str, Errors]

    @property
    def telling(self) -> Errors:
        """On the test data that say what is still missing: those in which laws have data.

        A law of time has none in what comes after, all of it; there a fit to that time tells whether more is missing.
        """
        telling = self.test if self.beyond is None else self.beyond.within
        return telling if self.later is None else replace(telling, improved=min(telling.improved, self.later))


@dataclass(frozen=True)
class Sure:
    """How sure parameters are.

    Attributes:
        wide: half widths of their intervals.
        alone: what has a name without laws of no kind, where that goes before them.
        changed: parameters of the model that had to change.
    """

    wide: findings.Wide
    alone: Fit | None
    changed: list[dict[str, Any]]


@dataclass(frozen=True)
class Measured:
    """Errors, how sure parameters are, and notes in sentences."""

    tested: Tested
    sure: Sure
    notes: list[str]


def measure(case: Case, base: Baseline, test: Test, last: Chosen, guarded: Guarded) -> Measured:
    """Measure what was chosen last; every stage may fail alone."""
    tested = _tested(case, test, last, guarded)
    sure = _sure(base, last, tested, guarded)
    return Measured(tested, sure, _notes(base, last, tested, guarded))


def _tested(case: Case, test: Test, last: Chosen, guarded: Guarded) -> Tested:
    search, three, final = last.search, last.three, last.found.fitted
    errors: Errors | None = guarded(
        "The error on test data",
        lambda: Errors(*(untouched.error_on(last.problem, f) for f in three)),
        lambda: None,
    )
    tested = Errors(*(f.error for f in three)) if errors is None else errors
    comparison = guarded(
        "The error on windows to compare on",
        lambda: Errors(*(search.scorer.comparison_error(f) for f in three)),
        lambda: tested,
    )
    outside: Beyond | None = guarded(
        "What goes beyond the fitted data",
        lambda: beyond(three, last.seen.problem, last.problem),
        lambda: None,
    )
    of_time = any(isinstance(one.effect, Law) and "time" in one.effect.axes(one.at) for one in final.structure.terms)
    later: float | None = None
    if of_time and last.reaches_the_end:
        later = guarded("What is left later", lambda: untouched.error_on(last.problem, final), lambda: None)
    force = guarded(
        "The error of forces", lambda: _force_errors(three, case.prepared.structure.base, test), dict[str, Errors]
    )
    return Tested(
        comparison=comparison,
        test=tested,
        was_fitted=errors is None,
        beyond=outside,
        later=later,
        force=force,
    )


def _sure(base: Baseline, last: Chosen, tested: Tested, guarded: Guarded) -> Sure:
    search, final = last.search, last.found.fitted

    def unsure() -> Array:
        return np.full(len(final.z), np.inf)

    open_choice = guarded(
        "Whether other parameters would do", lambda: findings.choice_shift(final, last.found.others), unsure
    )

    def half_widths() -> Array:
        problem = search.partition.problem
        # Recordings that only the model's own steps predict say what they say in these, whatever finer ones change.
        steps = findings.step_shift(final, problem) if base.fine is None else 0.0
        return intervals.by_blocks(final, problem) + steps + open_choice

    wide = of_names = guarded("The intervals of the parameters", half_widths, unsure)
    alone: Fit | None = guarded(
        "Names without laws", lambda: beside.names_alone(search.fitter, final, search.progress.path[0]), lambda: None
    )
    if final.structure.unnamed or max(tested.comparison.improved, tested.telling.improved) > SCORE.at_floor:
        of_names = guarded(
            "What is left adds to the intervals", lambda: findings.beside_unknown(search, final, alone, wide), unsure
        )
    changed = guarded(
        "Which parameters changed", lambda: findings.changed_parameters(final, of_names), list[dict[str, Any]]
    )
    return Sure(findings.Wide(wide, of_names), alone, changed)


def _notes(base: Baseline, last: Chosen, tested: Tested, guarded: Guarded) -> list[str]:
    search, notes = last.search, list[str]()
    if tested.comparison.recalibrated > SCORE.at_floor and not search.stop.asked:
        notes += guarded(
            "Whether parameters further off would do",
            lambda: findings.beyond_limits(base.partition.problem, search.partition.validation, base.recalibrated),
            list[str],
        )
    if last.found.fitted.structure.terms:
        notes += guarded("Which parameters are held", lambda: findings.held_at_limits(last.found.fitted), list[str])
    if tested.was_fitted:
        notes.append(sentences.NOT_HELD_OUT)
    if tested.beyond is not None:
        notes.append(sentences.goes_beyond(tested.beyond, fitted=last.reaches_the_end))
    begin = guarded(
        "How recordings begin", lambda: beginnings.left(search.partition.first, last.found.fitted), lambda: None
    )
    if begin is not None:
        notes.append(sentences.begins_otherwise(begin))
    return [*notes, *sentences.disagreement(tested.test, tested.force)]


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
