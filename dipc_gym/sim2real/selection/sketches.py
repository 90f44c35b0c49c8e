"""Which hypotheses are fitted to a subset of the windows, and which of those are worth a full fit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from operator import attrgetter

import numpy as np

from dipc_gym.sim2real.estimation.fit import Fit
from dipc_gym.sim2real.estimation.shooting import rms
from dipc_gym.sim2real.model.structure import Term
from dipc_gym.sim2real.selection import ranking
from dipc_gym.sim2real.selection.choice import before_unnamed
from dipc_gym.sim2real.selection.fitter import Fitter
from dipc_gym.sim2real.selection.ranking import Start
from dipc_gym.sim2real.selection.screen import Tried
from dipc_gym.sim2real.selection.settings import SCORE, SEARCH


def least(fitter: Fitter, term: Term) -> float:
    """Share of the largest predicted gain from which a hypothesis is sketched; more for what takes fine steps."""
    return SEARCH.keeps_up if fitter.slow(term) else SEARCH.foretold


def in_turn(
    fitter: Fitter, ranked: Sequence[Start], starts: Mapping[str, Sequence[Start]], current: Fit
) -> list[Start]:
    """Sketches of the most promising hypotheses; of what takes fine steps and gains less only if none of these comes
    to the noise, for a straight line through its first guess foretells little far from there.

    Args:
        fitter: fits them.
        ranked: hypotheses and what they were laid over, the largest predicted gain first.
        starts: the same on top of each base, by key.
        current: the present fit.
    """
    most = max(ranked[0].predicted_gain, SCORE.worth) if ranked else SCORE.worth
    worth = [(start, start.predicted_gain / most) for start in ranked if start.predicted_gain > SCORE.hardly]
    first = ranking.finalists(
        [start for start, share in worth if share > least(fitter, start.term)],
        SEARCH.finalists if current.error > SCORE.at_noise else SEARCH.finalists_at_noise,
    )
    # A law's shape is a guess from forces, right to a few per cent: where most windows are at the noise already, such
    # a guess gains nothing as it stands. Only its fit tells.
    # So it is with what changes by steps.
    laws = [s for s in ranked if (s.term.effect.free or s.term.effect.by_steps) and s not in first]
    # What has no kind takes some of anything, and must not keep a law of a kind from being asked.
    of_a_kind = [start for start in laws if not start.term.effect.of_no_kind][: SEARCH.shapes]
    of_no_kind = [start for start in laws if start.term.effect.of_no_kind][: SEARCH.shapeless]
    sketched = _sketches(fitter, [*first, *of_a_kind, *of_no_kind], starts, current)
    if at_noise(sketched):
        return sketched
    slow = [start for start, share in worth if fitter.slow(start.term) and SEARCH.in_turn < share <= SEARCH.keeps_up]
    return sketched + _sketches(fitter, slow, starts, current)


def at_noise(sketched: Sequence[Start]) -> bool:
    """Whether any of several sketches leaves no more than the noise."""
    return any(tried.sketch is not None and tried.sketch.error < SCORE.at_noise for tried, _ in sketched)


def _sketches(
    fitter: Fitter, first: Sequence[Start], starts: Mapping[str, Sequence[Start]], current: Fit
) -> list[Start]:
    """Sketches of several hypotheses, plain ones first: what elaborates one that leaves nothing needs none."""
    sketched: list[Start] = []
    asked = sorted(first, key=lambda start: len(start.term.effect.parameters))
    tries = [sorted(starts[one.key], key=attrgetter("predicted_gain"), reverse=True) for one, _ in asked]
    bases = [base for each in tries for _, base in each]
    with fitter.side_by_side([partial(_sketched, fitter, each, current) for each in tries], bases) as result:
        for k, (finalist, base) in enumerate(asked):
            structure = base.structure.with_term(finalist.term)
            if not ranking.idle(structure, [tried.sketch for tried, _ in sketched if tried.sketch]):
                sketched += result(k)
    return sketched


def _sketched(fitter: Fitter, tries: Sequence[Start], current: Fit) -> list[Start]:
    """The best sketch of one hypothesis, if any, from the largest predicted gain on.

    A fit that brings less than its predicted gain is stuck, unless it leaves nothing; then the next start is tried as
    well. So is the next shape of a law of no kind, for screening hardly tells which inputs are the right ones, and the
    next valley of what has several.
    """
    sketches: list[Start] = []
    before = current.mse[fitter.subset]
    for tried, base in tries:
        sketch = fitter.sketch(base, base.structure.with_term(tried.term))
        if sketch is None:
            continue
        sketches.append(Start(replace(tried, term=ranking.as_fitted(sketch), sketch=sketch.result()), base))
        foretold = max(tried.predicted_gain, SCORE.hardly)
        several = tried.term.effect.of_no_kind or tried.term.effect.valleys
        if ranking.complete(sketch) or (ranking.brought(sketch, before) > foretold and not several):
            break
    losses = ranking.losses([tried.sketch.mse for tried, _ in sketches if tried.sketch is not None])
    return [sketches[int(np.argmin(losses))]] if sketches else []


def keeping_up(fitter: Fitter, sketched: Sequence[Start], current: Fit) -> list[Start]:
    """Those whose sketches come near the best one, and the plainer ones that these elaborate.

    One that takes fine steps has to come nearer. Where the best is at the noise, those far from it need no more
    fitting, and no plainer one is added.
    """
    before = current.mse[fitter.subset]
    losses = ranking.losses([before, *(t.sketch.mse for t, _ in sketched if t.sketch is not None)])
    gains = {t.key: losses[0] - after for (t, _), after in zip(sketched, losses[1:], strict=True)}
    most = max(gains.values(), default=0.0)
    enough = max(SEARCH.keeps_up * most, SCORE.hardly)
    closely = max(enough, most - SCORE.large)
    if at_noise(sketched):
        return [start for start in sketched if gains[start.tried.key] > closely]
    close = [t for t, _ in sketched if gains[t.key] > (closely if fitter.slow(t.term) else enough)]
    error = rms(before)
    near = [*sorted(close, key=lambda t: -gains[t.key])[: SEARCH.fully], *_going_before(sketched, error)]
    wanted = {t.key for t in near} | {f"{inner}@{t.term.at}" for t in near for inner in t.term.effect.contains}
    return plain_first([start for start in sketched if start.tried.key in wanted], error)


def _going_before(sketched: Sequence[Start], error: float) -> list[Tried]:
    """Effects with names that would go before the laws of no kind that are asked beside them (`choice.before_unnamed`).

    Args:
        sketched: hypotheses with sketches, and what they were laid over.
        error: of the present fit on the same windows, in units of noise.
    """
    left = {tried.key: tried.sketch for tried, _ in sketched if tried.sketch is not None}
    of_no_kind = [left[t.key].mse for t, _ in sketched if t.term.effect.of_no_kind and t.key in left]
    if not of_no_kind:
        return []
    most = before_unnamed(error, min(of_no_kind, key=lambda mse: float(np.mean(mse))))
    named = [t for t, _ in sketched if not t.term.effect.of_no_kind and t.key in left and left[t.key].error < most]
    return sorted(named, key=lambda t: left[t.key].error)[: SEARCH.fully]


def plain_first(sketched: Sequence[Start], error: float) -> list[Start]:
    """Without those far from the noise that elaborate a plain one which would go before them (`choice.choose`).

    A law of any shape stays: how near the noise it comes shows only when it is as fine as it may be.

    Args:
        sketched: hypotheses with sketches, and what they were laid over.
        error: of the present fit on the same windows, in units of noise.
    """
    left = {tried.key: tried.sketch.error for tried, _ in sketched if tried.sketch is not None}

    def waits(tried: Tried) -> bool:
        own = left[tried.key]
        plain = min(
            (left.get(f"{inner}@{tried.term.at}", error) for inner in tried.term.effect.contains), default=error
        )
        most = error - plain > SEARCH.main_part * (error - own)
        waits = own > SEARCH.in_reach and most and own > SEARCH.far_better * plain
        return waits and not tried.term.effect.free

    return [start for start in sketched if not waits(start.tried)]
