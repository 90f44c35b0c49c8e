"""Take out of a structure what later effects made idle."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial

import numpy as np

from dipc_gym.sim2real.effects.shared.base import acts_on, joint_at
from dipc_gym.sim2real.estimation.fit import Fit
from dipc_gym.sim2real.estimation.unexplained import places
from dipc_gym.sim2real.model.structure import Structure, Term, carry
from dipc_gym.sim2real.selection import ranking
from dipc_gym.sim2real.selection.fitter import Fitter
from dipc_gym.sim2real.selection.hypotheses import Question
from dipc_gym.sim2real.selection.resolution import refined
from dipc_gym.sim2real.selection.score import Improvement
from dipc_gym.sim2real.selection.scorer import Scorer
from dipc_gym.sim2real.selection.settings import SCORE, SEARCH


def prune(question: Question, fitter: Fitter, current: Fit, tell: Callable[[str], None]) -> Fit:
    """Take out effects that do not earn their place any more; put plainer ones in the place of idle parameters.

    Args:
        question: has the effects that may be plainer.
        fitter: refits.
        current: the fit to prune.
        tell: called with a line about each effect that goes.
    """
    asked = [term for term in current.structure.terms if _doubtful(fitter, current, term)]
    asked.sort(key=lambda term: not term.effect.of_no_kind)  # beside one, laws of a kind look idle
    tasks = [partial(_idle, question, fitter, current, term) for term in asked]
    with fitter.side_by_side(tasks, [current]) as result:
        found = ((term, result(k)) for k, term in enumerate(asked))
        term, idle = next(((term, one) for term, one in found if one is not None), (None, None))
    if term is None or idle is None:
        return current
    tell(f"{term.key} is more than is needed")
    return prune(question, fitter, fitter.whole(idle), tell)


def _doubtful(fitter: Fitter, current: Fit, term: Term) -> bool:
    """Whether an effect may be idle, as far as can be told without a refit."""
    plain = term.effect.linear and not (term.effect.contains or term.effect.once or term.effect.free)
    return not (plain and ranking.foretold_loss(current, [term], fitter.problem.counts) > SCORE.large)


def _beside_unnamed(current: Fit, term: Term) -> bool:
    """Whether an effect with a name acts where a law of no kind does, which takes over whatever depends on the same: it
    was asked beside the name, not in its place.
    """
    joint = joint_at(current.structure.model, term.effect, term.at)
    return not term.effect.of_no_kind and joint in [law.at for law in current.structure.unnamed]


def _idle(question: Question, fitter: Fitter, current: Fit, term: Term) -> Fit | None:
    """A fit without an effect, or with a plainer one in its place, that does not miss it."""
    less = next(_as_good(question, fitter, current, term), None)
    return less and less.result()


def _as_good(question: Question, fitter: Fitter, current: Fit, term: Term) -> Iterator[Fit]:
    """Fits without an effect, or with a plainer one in its place, that do not miss it."""
    remaining, beside = current.structure.without(term.key), _beside_unnamed(current, term)
    if beside:
        nothing = fitter.as_it_is(current, remaining)  # in its place, from the law neither
        if not term.effect.once and fitter.scorer.compare(current, nothing).gain < SCORE.told_apart:
            yield nothing
    else:
        yield from _without(fitter, current, term, remaining)
        yield from _finer_without(fitter, current, term)
    # A plainer one would stand beside the law, not for it; a law of a kind may be nothing else.
    plain = (*term.effect.contains, *term.effect.at_its_joint) if term.effect.free or not beside else ()
    for inner in plain:
        plainer = _swap(question, fitter, current, term, inner)
        if plainer is None or fitter.scorer.settles(current, plainer):
            continue
        if _alike(fitter.scorer.compare(current, plainer)):
            yield plainer


def _without(fitter: Fitter, current: Fit, term: Term, remaining: Structure) -> Iterator[Fit]:
    """A fit without an effect, all else refitted, if it is not missed."""
    alike = remaining.simulated_as(current.structure)
    # What it is missed for may be the finer steps, or the time before a window, that it was simulated with.
    same = (alike.finest, alike.warm) == (remaining.finest, remaining.warm)
    for structure in [remaining] if same else [remaining, alike]:
        less = fitter.near(current, structure) if structure.terms else None
        if less is None:
            break
        if not _missed(fitter.scorer, term, current, less):
            yield less
            break


def _finer_without(fitter: Fitter, current: Fit, term: Term) -> Iterator[Fit]:
    """A fit without a law of no kind, those of a kind beside it made finer, if it is not missed: what a coarse law
    leaves may be all that the other models.
    """
    laws = [other.key for other in current.structure.terms if other.effect.free and not other.effect.of_no_kind]
    if not (term.effect.of_no_kind and laws):
        return
    less = fitter.without(current, term.key)
    for key in laws if less.error < SEARCH.in_reach else []:
        less = refined(fitter, less, key, enough=current.error)
    if not fitter.scorer.compare(current, less).matters:
        yield less


def _missed(scorer: Scorer, term: Term, current: Fit, less: Fit) -> bool:
    """Whether a fit predicts clearly worse without an effect."""
    if term.effect.once:
        return scorer.stands_out(term, current, less)
    lost = scorer.compare(current, less)
    # Of a kind that acts at several joints each one takes little of what all of them leave.
    if sum(other.effect.id == term.effect.id for other in current.structure.terms) > 1:
        return lost.matters
    return (not _alike(lost) and scorer.earns(current, less)) or scorer.settles(current, less)


def _alike(lost: Improvement) -> bool:
    """Whether a plainer fit predicts as well: of few windows, a large loss that is as uneven as what the search has
    accepted as a gain is none that chance brings about.
    """
    return lost.alike and not lost.clear


def _swap(question: Question, fitter: Fitter, current: Fit, term: Term, effect: str) -> Fit | None:
    """Refit with another effect in the place of one; None where it cannot act."""
    other = next((e for e in question.effects if e.id == effect), None)
    remaining, model = current.structure.without(term.key), current.structure.model
    at = acts_on(model, term.effect, term.at) if effect in term.effect.at_its_joint else term.at
    if other is None or any(t.key == f"{effect}@{at}" for t in remaining.terms):
        return None
    # What it does has to be seen again, for another to take it up; friction is told by its level.
    seen = replace(current, structure=remaining, z=carry(current.structure, current.z, remaining))
    scene = question.look(current if term.effect.levels else seen)
    if at is None or at not in places(other, model, question.joints, scene.recordings[0]):
        return None
    values = current.structure.term_values(current.z, term)
    levels = [values[name] for name in term.effect.levels]
    evidence = scene.at(other.place, at, {at: float(np.mean(levels))} if levels else {})
    proposals = other.proposals(evidence)
    if not proposals:
        return None
    shaped, guess = proposals[0]
    return fitter.near(current, remaining.with_term(Term(shaped, at, dict(guess))))
