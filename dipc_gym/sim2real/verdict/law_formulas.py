"""Laws that say no more than a formula does: their tables then hold that formula, which is what is written back."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dipc_gym.sim2real.effects.friction_hysteresis import Hysteresis
from dipc_gym.sim2real.effects.shared.law import Law
from dipc_gym.sim2real.estimation.fit import Fit, evaluate, fit
from dipc_gym.sim2real.estimation.problem import Problem
from dipc_gym.sim2real.model.structure import Term
from dipc_gym.sim2real.selection.resolution import instead
from dipc_gym.sim2real.selection.score import compare
from dipc_gym.sim2real.selection.settings import SCORE
from dipc_gym.sim2real.verdict.closed_form import Formula, formulas
from dipc_gym.sim2real.verdict.conclude import Conclusion


def in_closed_form(found: Conclusion, problem: Problem, first: Problem) -> Conclusion:
    """What a search came to, with the values of formulas in the tables of laws wherever these predict as well.

    A formula has fewer parameters, so it is known better where few data are, and goes on where none are.

    Args:
        found: with laws as tables.
        problem: the windows that it was fitted to.
        first: those at the beginnings of recordings, which nothing is fitted to: other commands may act there still.
    """
    fitted, said = found.fitted, dict[str, Formula]()
    for term in fitted.structure.terms:
        effect = term.effect
        if isinstance(effect, Law) and not isinstance(effect, Hysteresis) and effect.knots:
            plainest = _plainest(fitted, problem, effect, term.key)
            if plainest is not None:
                said[term.key], fitted = plainest
                if effect.of_the_clock:
                    fitted = _from_the_start(fitted, problem, first, term, said[term.key])
                elif effect.of_the_past:
                    fitted = _until_it_settles(fitted, problem, term, said[term.key])
    return replace(found, fitted=fitted, formulas=said)


def _plainest(fitted: Fit, problem: Problem, effect: Law, key: str) -> tuple[Formula, Fit] | None:
    """The plainest formula that predicts all windows as well as the values of a law do, and the fit with its values in
    their place; None where there is none.
    """
    slots = fitted.structure.slots
    values_of = {f"{key}.{p.name}" for p in effect.parameters[: len(effect.knots)]}
    own = [i for i, slot in enumerate(slots) if slot.key in values_of]
    scale = np.array([slots[i].scale / effect.most for i in own])
    covariance = fitted.covariance()[np.ix_(own, own)] * np.outer(scale, scale)
    precision: NDArray[np.float64] = np.asarray(np.linalg.pinv(covariance, hermitian=True))
    places, values = effect.places, np.array([slots[i].value(fitted.z[i]) / effect.most for i in own])
    for formula in formulas(places, values, precision, len(problem.windows)):
        z = fitted.z.copy()
        z[own] = [slots[i].mapped(value) for i, value in zip(own, effect.most * formula(places), strict=True)]
        there = fit(problem, fitted.structure, z, fitted.initial, most=0)
        if _as_well(there, fitted, problem):
            return formula, there
    return None


def _as_well(one: Fit, other: Fit, problem: Problem) -> bool:
    """Whether a fit predicts all windows as well as another, and those of where a rig seldom was, whose loss hides in a
    mean.
    """
    lost = compare(one.mse, other.mse, problem.blocks).worst < -SCORE.large
    return not lost and compare(other.mse, one.mse, problem.blocks).alike


def _from_the_start(fitted: Fit, problem: Problem, first: Problem, term: Term, formula: Formula) -> Fit:
    """A fit whose law of time holds its formula from the start of recordings on, if their beginnings are predicted
    better so.
    """
    assert isinstance(term.effect, Law)
    there = _over(fitted, problem, term, formula, (0.0, term.effect.knots[-1]))
    if there is None or not len(first.windows):
        return fitted
    before, after = (float(np.mean(evaluate(first, one.structure, one.z))) for one in (fitted, there))
    return there if after < before else fitted


def _until_it_settles(fitted: Fit, problem: Problem, term: Term, formula: Formula) -> Fit:
    """A fit whose law of the past holds its formula up to where that changes no more, if there is such a place.

    No window tells how much there was of late, so that nobody sees when a recording goes beyond those of the fit.
    """
    if not math.isfinite(formula.settles):
        return fitted
    assert isinstance(term.effect, Law)
    there = _over(fitted, problem, term, formula, (term.effect.knots[0], term.effect.knot_at(formula.settles)))
    return there if there is not None and _as_well(there, fitted, problem) else fitted


def _over(fitted: Fit, problem: Problem, term: Term, formula: Formula, span: tuple[float, float]) -> Fit | None:
    """A fit whose law holds its formula from the first to the last of two knots; None where it goes as far."""
    assert isinstance(term.effect, Law)
    longer = term.effect.reaching(fitted.structure.term_values(fitted.z, term), [span])
    if longer is None:
        return None
    shaped, begin = longer
    assert isinstance(shaped, Law)
    told = (shaped.most * formula(shaped.places)).tolist()
    named = (p.name for p in shaped.parameters[: len(told)])  # a time constant comes after them
    values = {**begin, **dict(zip(named, told, strict=True))}
    return fit(problem, *instead(fitted.structure, fitted.z, term, shaped, values), fitted.initial, most=0)
