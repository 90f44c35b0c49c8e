"""Which of several fitted hypotheses is accepted: the simplest of those that predict best, if it is clearly better."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dipc_gym.sim2real.effects.shared.base import joint_at
from dipc_gym.sim2real.estimation.fit import Fit
from dipc_gym.sim2real.estimation.shooting import common_error, rms
from dipc_gym.sim2real.model.structure import Term
from dipc_gym.sim2real.selection import ranking
from dipc_gym.sim2real.selection.scorer import Scorer, near
from dipc_gym.sim2real.selection.screen import Tried
from dipc_gym.sim2real.selection.settings import SCORE, SEARCH


def scored(scorer: Scorer, done: Sequence[Tried]) -> list[Tried]:
    """Fitted hypotheses with their scores, the best first."""
    losses = ranking.losses([scorer.mse(tried.in_full) for tried in done])
    found = [replace(tried, score=after) for tried, after in zip(done, losses, strict=True)]
    return sorted(found, key=lambda tried: tried.score)


def choose(scorer: Scorer, done: Sequence[Tried], current: Fit, begin: Fit) -> Fit | None:
    """The simplest of the hypotheses that predict best, if it is clearly better than `current`.

    Args:
        scorer: compares fits.
        done: fitted hypotheses, the best first.
        current: the present fit.
        begin: the fit without effects.
    """
    clear = [
        t for t in done if scorer.stands_out(t.term, t.in_full, current) and tells(t.term, t.in_full, current, begin)
    ]
    if not clear:
        return None
    # What breaks away may seem pushed; a push is named where nothing else tells.
    if any(t.term.effect.by_steps for t in clear):
        clear = [t for t in clear if not t.term.effect.once]
    return _core(_named(_simplest(scorer, clear, current), clear, current), clear, current).in_full


def tells(term: Term, fitted: Fit, current: Fit, begin: Fit) -> bool:
    """Whether an effect brings most of what is left, if a law of any shape acts on its joint.

    A law of no kind leaves what its table cannot hold, and so does any law near the noise, or where little is left
    beside what effects brought. Every effect that depends on the same quantities takes up some of that; near the noise,
    where it may be half, one that is there takes nearly all.

    Args:
        term: the effect.
        fitted: a fit with it, and maybe with others.
        current: the fit without.
        begin: the fit without effects.
    """
    close = near(begin, current)
    model = current.structure.model
    laws = [t for t in current.structure.terms if t.effect.of_no_kind or (t.effect.free and close)]
    guarded = {joint_at(model, t.effect, t.at) for t in laws}
    if term.effect.of_no_kind or joint_at(model, term.effect, term.at) not in guarded - {None}:
        return True
    most = SEARCH.far_better if current.error < SEARCH.in_reach else SEARCH.main_part
    return fitted.error - 1 < most * (current.error - 1)


def _named(chosen: Tried, clear: Sequence[Tried], current: Fit) -> Tried:
    """An effect with a name in the place of a law of no kind, see `before_unnamed`."""
    if not chosen.term.effect.of_no_kind:
        return chosen
    most = before_unnamed(current.error, chosen.in_full.mse)
    names = [t for t in clear if not t.term.effect.of_no_kind and t.in_full.error < most]
    return min(names, key=lambda t: t.score, default=chosen)


def before_unnamed(before: float, mse: NDArray[np.float64]) -> float:
    """Error, times the noise, below which an effect with a name goes before a law of no kind.

    A law of no kind predicts a little better than any effect with a name, also where the name is right. But a name that
    brings less than half of that only picks up a part of something unknown; and so does one that leaves several times
    the noise where a law of no kind leaves none: it follows the law for as far as the data go together.

    Args:
        before: error without either.
        mse: what the law of no kind leaves, mean square of each window, (n,).
    """
    most = before - SEARCH.main_part * (before - rms(mse))
    return min(most, SEARCH.in_reach) if common_error(mse) < SCORE.at_floor else most


def of_ends(scorer: Scorer, paths: Sequence[tuple[Fit, ...]]) -> tuple[Fit, ...]:
    """Of several paths the one whose end predicts windows best that it was not fitted to, those that validate among
    them: a law may go astray where no other window is, and what leaves far more than another is out.

    One with names alone goes before one with laws of no kind, see `goes_before`.

    Args:
        scorer: compares fits.
        paths: the fits of each, the first without effects.
    """
    compared = [scorer.unfitted_mse(path[-1]) for path in paths]
    losses, left = ranking.losses(compared), [rms(mse) for mse in compared]
    close = [k for k, error in enumerate(left) if error <= min(left) / SEARCH.far_better]
    best = min(close, key=lambda k: losses[k])
    named = [
        k
        for k in close
        if not paths[k][-1].structure.unnamed and goes_before(scorer, paths[k][-1], paths[best][-1], paths[0][0])
    ]
    return paths[min(named, key=lambda k: losses[k], default=best)]


def goes_before(scorer: Scorer, names: Fit, law: Fit, begin: Fit) -> bool:
    """Whether a fit with names alone goes before one with laws of no kind, by windows that neither was fitted to.

    At the end of a search no other name is left to be asked beside these, so they have to bring half of what the laws
    do as log errors count it as well, see `before_unnamed`.

    Args:
        scorer: compares fits.
        names: the one with names.
        law: the one with laws.
        begin: the fit without effects.
    """
    before, least = rms(scorer.unfitted_mse(begin)), scorer.unfitted_mse(law)
    half = before ** (1 - SEARCH.main_part) * rms(least) ** SEARCH.main_part
    return rms(scorer.unfitted_mse(names)) < min(before_unnamed(before, least), half)


def leaves_far_less(scorer: Scorer, one: Fit, other: Fit) -> bool:
    """Whether a fit predicts windows that neither was fitted to better than another, by `SCORE.large` at least; or the
    other goes astray in few of them, see `of_ends`.
    """
    after, before = ranking.losses([scorer.unfitted_mse(fitted) for fitted in (one, other)])
    return before - after > SCORE.large or leaves_a_part(scorer, one, other)


def leaves_a_part(scorer: Scorer, one: Fit, other: Fit) -> bool:
    """Whether a fit leaves so little of what another does, of windows that neither was fitted to, that it is no
    elaboration of that, by `SEARCH.far_better`.
    """
    after, before = (rms(scorer.unfitted_mse(fitted)) for fitted in (one, other))
    return after < SEARCH.far_better * before


def _simplest(scorer: Scorer, done: Sequence[Tried], current: Fit) -> Tried:
    """The simplest of the fitted hypotheses, sorted by score, that predict as well as the first.

    None does that leaves windows standing out in which a joint breaks away.
    """
    best = done[0].in_full
    alike = [t for t in done if scorer.alike(best, t.in_full, current)]
    if done[0].term.effect.by_steps:
        alike = [t for t in alike if not scorer.settles(best, t.in_full)]
    return min(alike, key=lambda t: (*ranking.cost(t.in_full), t.score))


def _core(chosen: Tried, clear: Sequence[Tried], current: Fit) -> Tried:
    """The plainer effect that a chosen one elaborates, where it alone brings most of the improvement.

    Friction that varies with position takes up some of what a second effect, still missing, leaves. What it adds to
    plain friction is asked again when all others are in place.
    """
    if common_error(chosen.in_full.mse) < SCORE.at_floor:
        return chosen
    most = current.error - SEARCH.main_part * (current.error - chosen.in_full.error)
    plain = [
        t
        for t in clear
        if t.term.effect.id in chosen.term.effect.contains
        and t.term.at == chosen.term.at
        and t.in_full.error < most
        and chosen.in_full.error > SEARCH.far_better * t.in_full.error
    ]
    return _core(min(plain, key=lambda t: t.score), clear, current) if plain else chosen
