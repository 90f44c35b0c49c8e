"""Two effects at a time, where neither is worth much without the other."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from dipc_gym.sim2real.estimation.fit import Fit
from dipc_gym.sim2real.model.structure import Structure, names
from dipc_gym.sim2real.selection import choice, ranking, screen
from dipc_gym.sim2real.selection.fitter import Fitter
from dipc_gym.sim2real.selection.hypotheses import Screened
from dipc_gym.sim2real.selection.score import compare
from dipc_gym.sim2real.selection.screen import Tried
from dipc_gym.sim2real.selection.settings import SCORE, SEARCH
from dipc_gym.sim2real.selection.sketches import least


class Pair(NamedTuple):
    """Two hypotheses together.

    Attributes:
        gain: that screening foretells of both.
        base: the fit that they were laid over.
        structure: with both.
    """

    gain: float
    base: Fit
    structure: Structure


def promising(fitter: Fitter, screened: Sequence[Screened]) -> list[Pair]:
    """Two hypotheses at a time, by their predicted gains together on top of the bases of this round."""
    found: dict[frozenset[str], Pair] = {}
    for one in screened:
        for gain, structure in screen.pairs(fitter.problem, one.base, one.tried, fitter.subset):
            key = frozenset(names(structure.terms))
            if gain - one.handicap > max(SCORE.worth, found[key].gain if key in found else 0.0):
                found[key] = Pair(gain - one.handicap, one.base, structure)
    most = max((pair.gain for pair in found.values()), default=0.0)
    share = {key: max(least(fitter, term) for term in pair.structure.newest_two) for key, pair in found.items()}
    worth = [pair for key, pair in found.items() if pair.gain > share[key] * most]
    return sorted(worth, key=lambda pair: -pair.gain)[: SEARCH.finalists]


def sketched(fitter: Fitter, pairs: Sequence[Pair], current: Fit) -> list[tuple[Fit, Fit]]:
    """What each pair was laid over, and its sketch, of those that can be simulated and may be needed.

    An effect that takes fine steps is not tried beside a second one if it fell short of its predicted gain beside the
    first: a gap that is not there takes up a little of anything, and each try costs as much as ten others.
    """
    found: list[tuple[Fit, Fit]] = []
    short: set[str] = set()
    asked = sorted(pairs, key=lambda pair: len(pair.structure.slots))
    with fitter.sketched([(pair.base, pair.structure) for pair in asked]) as sketch_of:
        for k, (predicted_gain, base, structure) in enumerate(asked):
            slow = {term.key for term in structure.newest_two if fitter.slow(term)}
            if slow & short or ranking.idle(structure, [sketch for _, sketch in found]):
                continue
            sketch = sketch_of(k)
            if sketch is None:
                continue
            found.append((base, sketch))
            if ranking.brought(sketch, current.mse[fitter.subset]) < SEARCH.short * predicted_gain:
                short |= slow
    return found


def best(
    fitter: Fitter, sketched: Sequence[tuple[Fit, Fit]], current: Fit, begin: Fit
) -> tuple[Fit, list[Tried]] | None:
    """The simplest of the sketched pairs that predict best, if it is clearly better than `current`; and the hypotheses
    that it accepts.

    Args:
        fitter: fits them to all windows.
        sketched: what each pair was laid over, and its sketch.
        current: the present fit.
        begin: the fit without effects.
    """
    if not sketched:
        return None
    losses = ranking.losses([sketch.mse for _, sketch in sketched])
    first, blocks = sketched[int(np.argmin(losses))][1], fitter.problem.blocks[fitter.subset]
    gained = compare(first.mse, current.mse[fitter.subset], blocks).gain
    alike = [pair for pair in sketched if ranking.alike(compare(first.mse, pair[1].mse, blocks), gained)]
    first_of = sorted(alike, key=lambda pair: ranking.cost(pair[1]))[: SEARCH.pairs]
    with fitter.fitted([(base, sketch, current) for base, sketch in first_of]) as fit_of:
        for k, (_, sketch) in enumerate(first_of):
            fitted = fit_of(k)
            if fitted is None or not fitter.scorer.better(fitted, current):
                continue
            both = fitted.structure.newest_two
            if all(choice.tells(term, fitted, current, begin) for term in both):
                return fitted, [Tried(term, 0.0, sketch, fitted) for term in both]
    return None
