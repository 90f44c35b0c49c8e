"""Friction that depends on direction is Coulomb friction and a constant load in one: parted, either may be elaborated.

Where friction is larger at rest, or grows with load, and something pulls beside it, friction by direction comes first:
both of its parts at once gain most. As one it would stand in the way of what its first part is the beginning of.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from dipc_gym.sim2real.effects.base import Effect
from dipc_gym.sim2real.estimation.fit import Fit, fit
from dipc_gym.sim2real.estimation.problem import Problem
from dipc_gym.sim2real.model.structure import Structure, Term, carry

ONE, LEVEL, FORCE = "friction.asymmetric", "friction.coulomb", "load.constant"


def parted(problem: Problem, fitted: Fit, effects: Iterable[Effect]) -> Fit:
    """A fit with two effects in the place of each friction that depends on direction; it predicts the same.

    Args:
        problem: windows that it was fitted to.
        fitted: to these.
        effects: those that are asked for; without both, nothing is parted.
    """
    known = {effect.id: effect for effect in effects}
    if not {LEVEL, FORCE} <= known.keys():
        return fitted
    structure, terms = fitted.structure, list[Term]()
    loaded = {term.at for term in structure.terms if term.effect.id == FORCE}
    for term in structure.terms:
        if term.effect.id != ONE or term.at in loaded:
            terms.append(term)
            continue
        forward, backward = (structure.term_values(fitted.z, term)[name] for name in ("forward", "backward"))
        terms.append(Term(known[LEVEL], term.at, {"level": (forward + backward) / 2}))
        terms.append(Term(known[FORCE], term.at, {"force": (backward - forward) / 2}))
    return _with(problem, fitted, terms)


def joined(problem: Problem, fitted: Fit, before: Structure, effects: Iterable[Effect]) -> Fit:
    """A fit with friction that depends on direction as one effect again, where nothing elaborated its parts.

    Args:
        problem: windows that it was fitted to.
        fitted: to these.
        before: a structure that has friction by direction where it was parted.
        effects: those that are asked for.
    """
    one = next((effect for effect in effects if effect.id == ONE), None)
    structure, terms = fitted.structure, list(fitted.structure.terms)
    for at in [term.at for term in before.terms if term.effect.id == ONE]:
        parts = {term.effect.id: term for term in terms if term.at == at and term.effect.id in (LEVEL, FORCE)}
        if one is None or len(parts) < 2:
            continue
        level = structure.term_values(fitted.z, parts[LEVEL])["level"]
        force = structure.term_values(fitted.z, parts[FORCE])["force"]
        if level <= abs(force):  # a load that no friction would bear
            continue
        terms[terms.index(parts[LEVEL])] = Term(one, at, {"forward": level - force, "backward": level + force})
        terms.remove(parts[FORCE])
    return _with(problem, fitted, terms)


def _with(problem: Problem, fitted: Fit, terms: list[Term]) -> Fit:
    structure = fitted.structure
    if tuple(terms) == structure.terms:
        return fitted
    other = replace(structure, terms=tuple(terms))
    return fit(problem, other, carry(structure, fitted.z, other), fitted.initial, most=0)
