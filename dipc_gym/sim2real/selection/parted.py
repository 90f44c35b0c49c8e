"""Friction that depends on direction is Coulomb friction and a constant load in one: parted, either may be elaborated.

Where friction is larger at rest, or grows with load, and something pulls beside it, friction by direction comes first:
both of its parts at once gain most. As one it would stand in the way of what its first part is the beginning of.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from dipc_gym.sim2real.effects.shared.base import Effect
from dipc_gym.sim2real.estimation.fit import Fit
from dipc_gym.sim2real.model.structure import Structure, Term

ONE, LEVEL, FORCE = "friction.asymmetric", "friction.coulomb", "load.constant"


def parted(fitted: Fit, effects: Iterable[Effect]) -> tuple[Structure, set[str]]:
    """A structure with two effects in the place of each friction that depends on direction, and where that was.

    With the same parameters otherwise it predicts the same.

    Args:
        fitted: with such friction, or without.
        effects: those that are asked for; without both, nothing is parted.
    """
    known = {effect.id: effect for effect in effects}
    structure, terms, places = fitted.structure, list[Term](), set[str]()
    if not {LEVEL, FORCE} <= known.keys():
        return structure, places
    loaded = {term.at for term in structure.terms if term.effect.id == FORCE}
    for term in structure.terms:
        if term.effect.id != ONE or term.at in loaded:
            terms.append(term)
            continue
        forward, backward = (structure.term_values(fitted.z, term)[name] for name in ("forward", "backward"))
        terms.append(Term(known[LEVEL], term.at, {"level": (forward + backward) / 2}))
        terms.append(Term(known[FORCE], term.at, {"force": (backward - forward) / 2}))
        places.add(term.at)
    return replace(structure, terms=tuple(terms)) if places else structure, places


def joined(fitted: Fit, places: Iterable[str], effects: Iterable[Effect]) -> Structure:
    """A structure with friction that depends on direction as one effect again, where nothing elaborated its parts.

    Args:
        fitted: with these parts, or what elaborates them.
        places: where it was parted.
        effects: those that are asked for.
    """
    one = next((effect for effect in effects if effect.id == ONE), None)
    structure, terms = fitted.structure, list(fitted.structure.terms)
    for at in places:
        parts = {term.effect.id: term for term in terms if term.at == at and term.effect.id in (LEVEL, FORCE)}
        if one is None or len(parts) < 2:
            continue
        level = structure.term_values(fitted.z, parts[LEVEL])["level"]
        force = structure.term_values(fitted.z, parts[FORCE])["force"]
        if level <= abs(force):  # a load that no friction would bear
            continue
        terms[terms.index(parts[LEVEL])] = Term(one, at, {"forward": level - force, "backward": level + force})
        terms.remove(parts[FORCE])
    return structure if tuple(terms) == structure.terms else replace(structure, terms=tuple(terms))
