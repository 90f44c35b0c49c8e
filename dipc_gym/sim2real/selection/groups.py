"""The same effects at every joint, taken together: a machine with friction in all its joints is the usual case.

One joint's friction takes a sixth of what a six-joint arm leaves, and shows only once the others are there. So kinds
are laid over all joints at once; members that the others make idle go before anything is accepted.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from dipc_gym.sim2real.estimation.fit import Fit, fit
from dipc_gym.sim2real.model.structure import Structure, carry
from dipc_gym.sim2real.selection import ranking
from dipc_gym.sim2real.selection.screen import Tried, excludes
from dipc_gym.sim2real.selection.settings import SCORE, SEARCH

if TYPE_CHECKING:
    from dipc_gym.sim2real.selection.search import Search


def best(search: Search, ranked: Sequence[tuple[Tried, Fit]], sketched: Sequence[Fit], current: Fit) -> Fit | None:
    """A fit with one or two kinds of effect at several joints, if it is clearly better than any single effect.

    Args:
        search: in progress.
        ranked: hypotheses and what they were laid over, the largest predicted gain first.
        sketched: sketches of single effects.
        current: the present fit.
    """
    kinds = _kinds(search, ranked)
    sets = [[one] for one in kinds] + [[a, b] for i, a in enumerate(kinds) for b in kinds[i + 1 :]]
    found: list[Fit] = []
    for chosen in sets:
        structure = _with(current.structure, [tried for kind in chosen for tried in kind])
        if len(structure.terms) < len(current.structure.terms) + 2:
            continue
        sketch = search.sketch(current, structure)
        if sketch is not None:
            found.append(sketch)
    if not found:
        return None
    losses = ranking.losses([one.mse for one in found] + [current.mse[search.subset]] + [one.mse for one in sketched])
    together, alone = losses[: len(found)], min(losses[len(found) :])
    if alone - min(together) < SCORE.large:
        return None
    sketch = _needed(search, found[int(np.argmin(together))], current)
    fitted = search.full(current, sketch, current)
    if fitted is None or not (search.earns(fitted, current) and search.compare(fitted, current).clear):
        return None
    if not search.confirmed(fitted, current):
        return None
    added = [term.key for term in fitted.structure.terms if term.key not in {t.key for t in current.structure.terms}]
    search.tell(f"{', '.join(added)}: error {fitted.error:.3g} x noise (was {current.error:.3g})")
    tried = [Tried(t, 0.0, sketch, fitted) for t in fitted.structure.terms if t.key in added]
    search.rounds.append(ranking.updated(search.rounds[-1], tried))
    return search.polish(fitted)


def _kinds(search: Search, ranked: Sequence[tuple[Tried, Fit]]) -> list[list[Tried]]:
    """Effects that may act at several joints, each with its hypotheses, the most promising kinds first."""
    by_id: dict[str, list[Tried]] = {}
    for tried, _ in ranked:
        effect = tried.term.effect
        usual = effect.place == "joint" and effect.linear and not (effect.of_the_clock or effect.free)
        if usual and not search.slow(tried.term):
            by_id.setdefault(effect.id, []).append(tried)
    several = [group for group in by_id.values() if len(group) > 1]
    return sorted(several, key=lambda group: -sum(max(tried.predicted_gain, 0.0) for tried in group))[: SEARCH.kinds]


def _with(structure: Structure, hypotheses: Sequence[Tried]) -> Structure:
    """A structure and all hypotheses that do not exclude each other."""
    for tried in hypotheses:
        here = [term.effect for term in structure.terms if term.at == tried.term.at]
        if not any(excludes(one, tried.term.effect) or one.id == tried.term.effect.id for one in here):
            structure = structure.with_term(tried.term)
    return structure


def _needed(search: Search, sketch: Fit, current: Fit) -> Fit:
    """A sketch without members that its quadratics say the others make idle, refitted."""
    structure, kept = sketch.structure, {term.key for term in current.structure.terms}
    added = [term for term in structure.terms if term.key not in kept]
    idle = [
        term
        for term in added
        if ranking.foretold_loss(sketch, term, search.problem.counts[search.subset]) < SCORE.worth
    ]
    if not idle:
        return sketch
    for term in idle:
        structure = structure.without(term.key)
    begin = carry(sketch.structure, sketch.z, structure)
    return fit(search.problem.pick(search.subset), structure, begin, sketch.initial, most=5)
