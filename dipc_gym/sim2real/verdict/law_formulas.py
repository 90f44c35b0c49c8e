"""Laws that say no more than a formula does: their tables then hold that formula, which is what is written back."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dipc_gym.sim2real.effects.friction_hysteresis import Hysteresis
from dipc_gym.sim2real.effects.law import Law
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
    return replace(found, fitted=fitted, formulas=said)


def _plainest(fitted: Fit, problem: Problem, effect: Law, key: str) -> tuple[Formula, Fit] | None:
    """The plainest formula that predicts all windows as well as the values of a law do, and the fit with its values in
    their place; None where there is none.
    """
    slots = fitted.structure.slots
    values_of = {f"{key}.{p.name}" for p in effect.parameters[: len(effect.knots)]}
    own = [i for i, slot in enumerate(slots) if slot.key in values_of]
    scale = np.array([slots[i].scale / effect.most for i in own])
    covariance = np.linalg.pinv(fitted.curvature, hermitian=True)[np.ix_(own, own)] * np.outer(scale, scale)
    places, values = effect.places, np.array([slots[i].value(fitted.z[i]) / effect.most for i in own])
    for formula in formulas(places, values, np.linalg.pinv(covariance, hermitian=True), len(problem.windows)):
        z = fitted.z.copy()
        z[own] = [slots[i].mapped(value) for i, value in zip(own, effect.most * formula(places), strict=True)]
        there = fit(problem, fitted.structure, z, fitted.initial, most=0)
        # Few windows tell of where a rig seldom was; their loss hides in a mean.
        lost = compare(there.mse, fitted.mse, problem.blocks).worst < -SCORE.large
        if not lost and compare(fitted.mse, there.mse, problem.blocks).alike:
            return formula, there
    return None


def _from_the_start(fitted: Fit, problem: Problem, first: Problem, term: Term, formula: Formula) -> Fit:
    """A fit whose law of time holds its formula from the start of recordings on, if their beginnings are predicted
    better so.
    """
    effect = term.effect
    assert isinstance(effect, Law)
    longer = effect.reaching(fitted.structure.term_values(fitted.z, term), [(0.0, effect.knots[-1])])
    if longer is None or not len(first.windows):
        return fitted
    shaped, _ = longer
    assert isinstance(shaped, Law)
    values = {p.name: float(v) for p, v in zip(shaped.parameters, formula(shaped.places), strict=True)}
    there = fit(problem, *instead(fitted.structure, fitted.z, term, shaped, values), fitted.initial, most=0)
    before, after = (float(np.mean(evaluate(first, one.structure, one.z))) for one in (fitted, there))
    return there if after < before else fitted
