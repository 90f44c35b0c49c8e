"""One round of a search: all hypotheses are screened, the best sketched, the best of those fitted, one accepted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from operator import attrgetter

import numpy as np

from dipc_gym.sim2real.estimation.fit import Fit
from dipc_gym.sim2real.selection import choice, groups, pairs, ranking, sketches
from dipc_gym.sim2real.selection.fitter import Fitter
from dipc_gym.sim2real.selection.hypotheses import Phase, Question, screened, starts
from dipc_gym.sim2real.selection.progress import Journal
from dipc_gym.sim2real.selection.ranking import Start
from dipc_gym.sim2real.selection.resolution import refined
from dipc_gym.sim2real.selection.screen import Tried
from dipc_gym.sim2real.selection.settings import SCORE, SEARCH


def addition(question: Question, phase: Phase, fitter: Fitter, journal: Journal) -> Fit | None:
    """The best fit with more effects than the present one, if it is clearly better.

    Args:
        question: effects and places.
        phase: what kinds of law are asked for.
        fitter: fits to the windows of the search.
        journal: has the present fit, and gets a round with what was tried.
    """
    current = journal.progress.current
    laid = screened(question, phase, journal.progress)
    by_key = starts(laid)
    ranked = sorted(
        (max(tries, key=attrgetter("predicted_gain")) for tries in by_key.values()),
        key=attrgetter("predicted_gain"),
        reverse=True,
    )
    group = groups.sketched(fitter, laid[0], current) if len(question.joints) > 1 else None
    # What a machine lacks at all its joints shows at once; one joint after the other it takes as many rounds.
    if group is not None and group.error < SEARCH.in_reach < current.error:
        together = groups.fitted(fitter, group, current)
        if together is not None:
            journal.begin([tried for tried, _ in ranked])
            return _accepted(*together, fitter, current, journal)
    sketched = sketches.in_turn(fitter, ranked, by_key, current)
    journal.begin(ranking.updated([tried for tried, _ in ranked], [tried for tried, _ in sketched]))
    explained = sketches.at_noise(sketched)
    if group is not None and not explained and _ahead(fitter, group, sketched, current):
        together = groups.fitted(fitter, group, current)
        if together is not None:
            return _accepted(*together, fitter, current, journal)
    both = [] if explained or current.error < SCORE.at_floor else pairs.promising(fitter, laid)
    # Where two gain far more than any one does, and come down to the noise, one by one would lead astray.
    most = ranked[0].predicted_gain if ranked else 0.0
    early = [pair for pair in both if pair.gain > most + SCORE.large]
    tried_early = pairs.sketched(fitter, early, current)
    begin = journal.progress.path[0]
    found = pairs.best(fitter, [pair for pair in tried_early if pair[1].error < SCORE.at_floor], current, begin)
    if found is not None:
        return _accepted(*found, fitter, current, journal)
    done = choice.scored(fitter.scorer, _fitted(fitter, sketched, current, journal))
    journal.update(done)
    chosen = choice.choose(fitter.scorer, done, current, begin)
    if chosen is not None:
        return fitter.polish(chosen)
    tried_both = [*tried_early, *pairs.sketched(fitter, both[len(early) :], current)]
    found = pairs.best(fitter, tried_both, current, begin)
    # What a law of any shape leaves is its own bad fit as well, and two effects together take up some of anything.
    if found is None or (phase != Phase.FORMULAS and found[0].error > SEARCH.in_reach):
        return None
    return _accepted(*found, fitter, current, journal)


def _ahead(fitter: Fitter, group: Fit, sketched: Sequence[Start], current: Fit) -> bool:
    """Whether a sketch of several effects is clearly better than any of a single one."""
    singles = [one.sketch for one, _ in sketched if one.sketch]
    losses = ranking.losses([current.mse[fitter.subset], *(one.mse for one in singles)])
    best = [current, *singles][int(np.argmin(losses))]
    return fitter.scorer.compare_sketches(group, best).gain >= SCORE.large


def _fitted(fitter: Fitter, sketched: Sequence[Start], current: Fit, journal: Journal) -> list[Tried]:
    """Full fits of the hypotheses whose sketches keep up."""
    done: list[Tried] = []
    asked = sketches.keeping_up(fitter, sketched, current)
    tasks = [(base, tried.sketch, None if tried.term.effect.once else current) for tried, base in asked if tried.sketch]
    with fitter.fitted(tasks, _as_fine_as_asked) as fit_of:
        for k, (tried, _) in enumerate(asked):
            fitted = fit_of(k)
            if fitted is not None:
                done.append(replace(tried, term=ranking.as_fitted(fitted), fitted=fitted))
                journal.tell(f"{tried.key}: error {fitted.error:.3g} x noise (was {current.error:.3g})")
    return done


def _as_fine_as_asked(fitter: Fitter, fitted: Fit) -> Fit:
    """A fit whose newest law is as fine as its data ask for."""
    return refined(fitter, fitted, fitted.structure.newest.key)


def _accepted(fitted: Fit, tried: list[Tried], fitter: Fitter, current: Fit, journal: Journal) -> Fit:
    """Several hypotheses that were accepted together, fitted until nothing changes."""
    keys = " and ".join(one.key for one in tried)
    journal.tell(f"{keys}: error {fitted.error:.3g} x noise (was {current.error:.3g})")
    journal.together(tried)
    return fitter.polish(fitted)
