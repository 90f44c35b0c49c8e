"""Effects with names beside laws of no kind: a law of no kind can do what friction does, and is to do only the rest."""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import replace
from functools import partial

from dipc_gym.sim2real.effects.shared.settings import LAWS
from dipc_gym.sim2real.estimation.fit import Fit, fit
from dipc_gym.sim2real.model.structure import Term, carry, names
from dipc_gym.sim2real.selection import choice
from dipc_gym.sim2real.selection.fitter import Fitter
from dipc_gym.sim2real.selection.hypotheses import Question
from dipc_gym.sim2real.selection.prune import prune
from dipc_gym.sim2real.selection.settings import SEARCH


def names_alone(fitter: Fitter, current: Fit, begin: Fit) -> Fit | None:
    """The effects with names of a fit without its laws of no kind, refitted, where they go before these.

    Beside a law of the same motion no name is missed, also where it is right: taken out, the law does what it did.
    What a name is worth shows without the law; whether it goes before that is asked as in a round of the search, see
    `choice.before_unnamed`.

    Args:
        fitter: fits to the windows of the fit.
        current: the fit.
        begin: the fit without effects, maybe to other windows.

    Returns:
        None where the fit has no law of no kind, or no name, or where the names alone leave too much.
    """
    alone = fitter.without(current, *names(current.structure.unnamed))
    if alone is current or not alone.structure.terms:
        return None
    return alone if alone.error < choice.before_unnamed(begin.error, current.mse) else None


def least(question: Question, fitter: Fitter, current: Fit, begin: Fit, tell: Callable[[str], None]) -> Fit:
    """A fit whose laws of no kind do only what effects with names cannot do, where names go before these laws.

    Friction and a table over the same velocity share a force in any proportion, and how a search came to them says in
    which. So the names are fitted alone, and the laws to what they leave, see `rest`.

    Args:
        question: has the effects that may be plainer than one that is idle.
        fitter: fits to the windows of the fit.
        current: the fit.
        begin: the fit without effects, against which gains are counted.
        tell: called with a line if the fit is another one.
    """
    alone = names_alone(fitter, current, begin)
    if alone is None:
        return current
    return rest(question, fitter, alone, current, begin, tell) or current


def rest(
    question: Question, fitter: Fitter, named: Fit, law: Fit, begin: Fit, tell: Callable[[str], None]
) -> Fit | None:
    """Effects with names, less those that are idle, and laws of no kind for what these leave, held to nothing as
    tightly as predictions allow; None where that predicts worse than the laws did.

    Args:
        question: has the effects that may be plainer than one that is idle.
        fitter: fits to the windows of the fits.
        named: a fit with the names.
        law: a fit with the laws.
        begin: the fit without effects, against which gains are counted.
        tell: called with a line if there is one.
    """
    named = prune(question, fitter, named, tell)

    def held(hold: float) -> Fit | None:
        structure = named.structure
        for term in law.structure.unnamed:
            structure = structure.with_term(_from_nothing(term, hold))
        z = carry(named.structure, named.z, structure)
        fitted = fit(fitter.problem, structure, z, named.initial, most=SEARCH.anew_steps)
        return fitted if fitter.scorer.alike(law, fitted, begin) else None

    with fitter.side_by_side([partial(held, hold) for hold in SEARCH.held_to], [named, law]) as result:
        fitted = next((one for k in range(len(SEARCH.held_to)) if (one := result(k)) is not None), None)
    if fitted is None:
        return None
    tell(f"what has no name does only what is left beside names: error {fitted.error:.3g} x noise")
    return fitted


def _from_nothing(term: Term, hold: float) -> Term:
    """A law that is nothing, and held there with this standard deviation, in sizes of the law that it was."""
    law = copy.copy(term.effect)
    law.parameters = tuple(replace(p, sigma=hold / LAWS.step) if p.name in law.linear else p for p in law.parameters)
    return Term(law, term.at, {name: 0.0 if name in law.linear else value for name, value in term.guess.items()})
