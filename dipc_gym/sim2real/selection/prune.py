"""Take out of a structure what later effects made idle."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from dipc_gym.sim2real.estimation.fit import Fit
from dipc_gym.sim2real.estimation.unexplained import places
from dipc_gym.sim2real.model.structure import Term
from dipc_gym.sim2real.selection import ranking
from dipc_gym.sim2real.selection.settings import SCORE

if TYPE_CHECKING:
    from dipc_gym.sim2real.selection.search import Search


def prune(search: Search, current: Fit) -> Fit:
    """Take out effects that do not earn their place any more; put plainer ones in the place of idle parameters."""
    for term in current.structure.terms:
        plain = term.effect.linear and not (term.effect.contains or term.effect.once or term.effect.free)
        if plain and ranking.foretold_loss(current, term, search.problem.counts) > SCORE.large:
            continue  # needed beyond doubt, without a refit
        remaining = current.structure.without(term.key)
        less = search.near(current, remaining) if remaining.terms else None
        plainer = [_swap(search, current, term, inner) for inner in term.effect.contains]
        for other in [fitted for fitted in (less, *plainer) if fitted is not None]:
            if other is less and term.effect.once:
                needed = search.stands_out(term, current, other)
            else:
                lost = search.compare(current, other)
                needed = not lost.alike and (other is not less or search.earns(current, other))
                needed = needed or (other is less and search.settles(current, other))
            if not needed:
                search.tell(f"{term.key} is more than is needed")
                return prune(search, other)
    return current


def _swap(search: Search, current: Fit, term: Term, effect: str) -> Fit | None:
    """Refit with another effect in the place of one; None where it cannot act."""
    other = next((e for e in search.effects if e.id == effect), None)
    remaining = current.structure.without(term.key)
    if other is None or any(t.key == f"{effect}@{term.at}" for t in remaining.terms):
        return None
    scene = search.look(current)
    if term.at not in places(other, current.structure.model, search.joints, scene.recordings[0]):
        return None
    values = current.structure.term_values(current.z, term)
    levels = [values[name] for name in term.effect.levels]
    evidence = scene.at(other.place, term.at, {term.at: float(np.mean(levels))} if levels else {})
    proposals = other.proposals(evidence)
    if not proposals:
        return None
    shaped, guess = proposals[0]
    return search.near(current, remaining.with_term(Term(shaped, term.at, dict(guess))))
