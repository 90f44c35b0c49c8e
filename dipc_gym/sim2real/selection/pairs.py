"""Two effects at a time, where neither is worth much without the other."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from dipc_gym.sim2real.estimation.fit import Fit
from dipc_gym.sim2real.model.structure import Structure, names
from dipc_gym.sim2real.selection import ranking, screen
from dipc_gym.sim2real.selection.score import compare
from dipc_gym.sim2real.selection.screen import Tried
from dipc_gym.sim2real.selection.settings import SCORE, SEARCH

if TYPE_CHECKING:
    from dipc_gym.sim2real.selection.search import Search


Pair = tuple[float, Fit, Structure]  # its predicted gain, what it was laid over, and the structure with both effects


def promising(search: Search) -> list[Pair]:
    """Two hypotheses at a time, by their predicted gains together on top of the bases of this round."""
    found: dict[frozenset[str], Pair] = {}
    for base, handicap, tried in search.screened:
        for predicted_gain, structure in screen.pairs(search.problem, base, tried, search.subset):
            key = frozenset(names(structure.terms))
            if predicted_gain - handicap > max(SCORE.worth, found[key][0] if key in found else 0.0):
                found[key] = predicted_gain - handicap, base, structure
    most = max((predicted_gain for predicted_gain, _, _ in found.values()), default=0.0)
    worth = [pair for pair in found.values() if pair[0] > max(map(search.least, pair[2].terms[-2:])) * most]
    return sorted(worth, key=lambda pair: -pair[0])[: SEARCH.finalists]


def sketched(search: Search, pairs: Sequence[Pair], current: Fit) -> list[tuple[Fit, Fit]]:
    """What each pair was laid over, and its sketch, of those that can be simulated and may be needed.

    What takes fine steps, and fell short of its predicted gain beside one effect, is not tried beside others: a gap
    that is not there takes up a little of anything, and each try of it the time of ten others.
    """
    found: list[tuple[Fit, Fit]] = []
    short: set[str] = set()
    for predicted_gain, base, structure in sorted(pairs, key=lambda pair: len(pair[2].slots)):
        slow = {term.key for term in structure.terms[-2:] if search.slow(term)}
        if slow & short or ranking.idle(structure, [sketch for _, sketch in found]):
            continue
        sketch = search.sketch(base, structure)
        if sketch is None:
            continue
        found.append((base, sketch))
        if ranking.brought(sketch, current.mse[search.subset]) < SEARCH.short * predicted_gain:
            short |= slow
    return found


def best(search: Search, sketched: Sequence[tuple[Fit, Fit]], current: Fit) -> Fit | None:
    """The simplest of the sketched pairs that predict best, if it is clearly better than `current`.

    Args:
        search: in progress.
        sketched: what each pair was laid over, and its sketch.
        current: the present fit.
    """
    if not sketched:
        return None
    losses = ranking.losses([sketch.mse for _, sketch in sketched])
    first, blocks = sketched[int(np.argmin(losses))][1], search.problem.blocks[search.subset]
    gained = compare(first.mse, current.mse[search.subset], blocks).gain
    alike = [pair for pair in sketched if ranking.alike(compare(first.mse, pair[1].mse, blocks), gained)]
    for base, sketch in sorted(alike, key=lambda pair: ranking.cost(pair[1]))[: SEARCH.pairs]:
        fitted = search.full(base, sketch, current)
        if fitted is None or not (search.earns(fitted, current) and search.compare(fitted, current).clear):
            continue
        if search.confirmed(fitted, current):
            pair = [Tried(term, 0.0, sketch, fitted) for term in fitted.structure.terms[-2:]]
            search.tell(f"{' and '.join(t.key for t in pair)}: error {fitted.error:.3g} x noise")
            search.rounds.append(ranking.updated(search.rounds[-1], pair))
            return search.polish(fitted)
    return None
