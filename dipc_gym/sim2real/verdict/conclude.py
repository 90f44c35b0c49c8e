"""What a search comes to: effects that validation data do not speak against, each beside what could stand in for it."""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from functools import partial

from dipc_gym.sim2real.effects.shared.settings import EFFECTS
from dipc_gym.sim2real.estimation.fit import Fit
from dipc_gym.sim2real.estimation.problem import Problem
from dipc_gym.sim2real.model.structure import Term, names
from dipc_gym.sim2real.selection import beside, ranking
from dipc_gym.sim2real.selection.prune import prune
from dipc_gym.sim2real.selection.score import Improvement
from dipc_gym.sim2real.selection.search import Searched
from dipc_gym.sim2real.selection.settings import SCORE, SEARCH
from dipc_gym.sim2real.verdict import sentences, sparse, stand_ins, untouched
from dipc_gym.sim2real.verdict.closed_form import Formula
from dipc_gym.sim2real.verdict.settings import VERDICT

_Asks = Callable[[Searched, Fit, Sequence[Term]], Generator[list[stand_ins.Rival], None, None]]  # of each in turn


@dataclass(frozen=True)
class Conclusion:
    """What is left of a search.

    Attributes:
        fitted: with the fewest model parameters changed.
        rivals: of each of its effects, by key; none from when Ctrl-C ended the comparison.
        notes: effects that validation data strike off, or that stay without a name, in words.
        unnamed: keys of effects that improve predictions, but not by enough to be believed.
        others: with other model parameters changed, as many, that predict as well.
        formulas: that the tables of laws hold, by key; see `law_formulas`.
    """

    fitted: Fit
    rivals: dict[str, list[stand_ins.Rival]] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    unnamed: frozenset[str] = frozenset()
    others: list[Fit] = field(default_factory=list)
    formulas: dict[str, Formula] = field(default_factory=dict)


def conclude(search: Searched) -> tuple[Searched, Conclusion]:
    """Judge the effects that a search accepted; rivals that predict clearly better, or need less, take their places.

    Rivals are compared again at the end, for a third effect, added later, may be needed to tell two apart. That ends as
    soon as validation data strike an effect off: the search would only add it again.

    Args:
        search: that has run.

    Returns:
        The search, carried on beside the rivals that took a place, and what is left of it.
    """
    for swaps in range(VERDICT.swaps + 1):
        judged = search.stop.unless_pressed(partial(_upheld, search), lambda: None)
        if judged is None:
            current = search.progress.current
            return search, Conclusion(current, _rivals(search, current, stand_ins.rivals))
        upheld, fewest, notes, nameless = judged
        rivals = _rivals(search, upheld, stand_ins.rivals)
        rival = _successor(search, upheld, [rival for group in rivals.values() for rival in group])
        if notes or nameless or rival is None or search.stop.asked or swaps == VERDICT.swaps:
            break
        search.tell(f"{rival.term.key} predicts {'better' if rival.better else 'as well with fewer parameters'}")
        search = search.carried_on(rival.fitted)
    if not search.stop.asked:
        as_it_was = upheld, fewest
        upheld, fewest = search.stop.unless_pressed(partial(_without_idle, search, *as_it_was), lambda: as_it_was)
        rivals = {key: rivals[key] for key in names(upheld.structure.terms)}
    more = _rivals(search, upheld, stand_ins.unseen)
    rivals = {key: [*found, *more[key]] for key, found in rivals.items()}
    unnamed = {
        term.key: sentences.no_name(term, nameless[term.key]) for term in upheld.structure.terms if term.key in nameless
    }
    notes = [*notes, *unnamed.values()]
    return search, Conclusion(fewest, rivals, notes, frozenset(unnamed), _others(search, upheld, fewest))


def _successor(search: Searched, upheld: Fit, rivals: list[stand_ins.Rival]) -> stand_ins.Rival | None:
    """The rival that takes a structure's place: one that predicts clearly better, or needs fewer parameters.

    Of several that predict better alike, the simplest. One that is the same model here with fewer parameters goes
    before a pair of effects that was accepted together, and so never compared with plainer ones.
    """
    if better := sorted(
        (r for r in rivals if r.better), key=lambda rival: search.scorer.comparison_error(rival.fitted)
    ):
        alike = [rival for rival in better if search.scorer.alike(better[0].fitted, rival.fitted, upheld)]
        return min(alike, key=lambda rival: ranking.cost(rival.fitted))
    same = [_alone(search, rival, upheld) for rival in rivals if rival.same]
    plainer = [rival for rival in same if len(rival.fitted.z) < len(upheld.z)]
    return min(plainer, key=lambda one: (len(one.fitted.z), search.scorer.comparison_error(one.fitted)), default=None)


def _alone(search: Searched, rival: stand_ins.Rival, upheld: Fit) -> stand_ins.Rival:
    """A rival that is the same model, without what is idle beside it.

    For example, a constant force on one pole and a bias of the other's sensor can be what one biased sensor is alone.
    """
    terms = rival.fitted.structure.terms
    if len(terms) < 2 or search.stop.asked:
        return rival
    fitted = search.stop.unless_pressed(
        lambda: prune(search.question, search.fitter, rival.fitted, search.tell), lambda: rival.fitted
    )
    return replace(rival, fitted=fitted) if search.scorer.compare(upheld, fitted).alike else rival


def _upheld(search: Searched) -> tuple[Fit, Fit, list[str], dict[str, float]]:
    """The last accepted fit that validation data do not speak against, also with the fewest model parameters changed;
    notes on what they strike off, and effects that stay without a name, with what they gain.

    The best of dozens of effects always takes up some structure that no catalogue has, and this need not be there in
    other data. Validation data may strike an effect off; they never add one.
    """
    path, notes = search.progress.path, list[str]()
    upheld = path[-1]
    validation = untouched.fair(search, upheld)
    fewest, error = _with_fewest_parameters(search, upheld, validation)
    for before in reversed(path[:-1]):
        if error <= SCORE.at_floor:
            break
        simpler, without = _with_fewest_parameters(search, before, validation)
        if not untouched.refuted(without, error):
            break
        kept = names(simpler.structure.terms)
        added = [term for term in fewest.structure.terms if term.key not in kept]
        notes.append(sentences.refutation(added or fewest.structure.terms, without, error))
        upheld, fewest, error = before, simpler, without
    if error <= SCORE.at_floor:
        return upheld, fewest, notes, {}
    named, why, nameless = _believable(search, upheld, error, validation)
    if named is not upheld:
        fewest, _ = _with_fewest_parameters(search, named, validation)
    return named, fewest, notes + why, nameless


def _without_idle(search: Searched, upheld: Fit, fewest: Fit) -> tuple[Fit, Fit]:
    """`without_idle`, and the same with the fewest model parameters changed."""
    busy = without_idle(search, upheld)
    if busy is upheld:
        return upheld, fewest
    return busy, _with_fewest_parameters(search, busy, untouched.fair(search, busy))[0]


def without_idle(search: Searched, upheld: Fit) -> Fit:
    """A fit without effects that windows which no fit has touched are predicted as well without, at the noise.

    They came in with a few windows that anything brings down: where a joint sticks, or a gap closes, what happens next
    hangs by a thread. What happened once shows in no other window and stays; where more than noise is left,
    `_believable` decides.
    """
    while len(upheld.structure.terms) > 1 and search.scorer.comparison_error(upheld) <= SCORE.at_floor:
        asked = [term for term in upheld.structure.named if not term.effect.once]
        lost = {key: gained.gain for key, gained in _gains(search, upheld, asked, SEARCH.hopeless).items()}
        least = min(lost, key=lambda key: lost[key], default="")
        if not least or lost[least] >= SCORE.worth:
            break
        search.tell(f"{least} predicts nothing that is not predicted without it")
        upheld = search.fitter.without(upheld, least)
    return upheld


def _believable(
    search: Searched, upheld: Fit, error: float, validation: Problem
) -> tuple[Fit, list[str], dict[str, float]]:
    """A fit without effects of the clock that only stand in for what is left beside them, notes on these, and which of
    its effects stay without a name, with what they gain.

    An effect that is told from other causes by when it acts alone (a push, a motor that heats) stays only where next to
    nothing is left: no other recording of the rig shares it. All other effects are named if windows that no fit has
    touched are better predicted with them than without, all else refitted, by more than the standard error; beside laws
    of no kind, which can do the same, also if they are without these, see `beside.names_alone`. How much is left beside
    them does not matter; that they are no chance, the search has told by all windows. A law of no kind goes where
    validation data are divided over it.
    """
    recalibrated = untouched.error_on(validation, search.progress.path[0])
    notes = list[str]()
    for term in upheld.structure.terms:
        if term.effect.leaves < EFFECTS.leaves and error - 1 > term.effect.leaves * (recalibrated - 1):
            notes.append(sentences.not_alone(term, error))
            upheld = search.fitter.without(upheld, term.key)
    for term in upheld.structure.unnamed:
        without = search.fitter.without(upheld, term.key)
        predicted = untouched.on(validation, upheld, without)
        if divided_over(predicted):
            notes.append(sentences.divided(term, predicted.gain))
            upheld = without
    left = untouched.error_on(validation, upheld)
    if upheld.structure.terms and left > recalibrated:
        # Without an event that it was fitted beside, an effect may do harm.
        notes.append(sentences.refutation(upheld.structure.terms, recalibrated, left))
        return search.progress.path[0], notes, {}
    named = upheld.structure.named
    gained = _gains(search, upheld, named)
    missed = [term for term in named if not _believed(gained[term.key])]
    alone = beside.names_alone(search.fitter, upheld, search.progress.path[0]) if missed else None
    if alone is not None:
        missed = [term for term in missed if not _believed(_gained(search, alone, term))]
    return upheld, notes, {term.key: gained[term.key].gain for term in missed}


def _gains(search: Searched, fitted: Fit, terms: Sequence[Term], hopeless: float = math.inf) -> dict[str, Improvement]:
    """`_gained` of several effects, by key."""
    tasks = [partial(_gained, search, fitted, term, hopeless) for term in terms]
    with search.fitter.side_by_side(tasks, [fitted]) as result:
        return {term.key: result(k) for k, term in enumerate(terms)}


def _gained(search: Searched, fitted: Fit, term: Term, hopeless: float = math.inf) -> Improvement:
    """How much better windows that no fit has touched are predicted with an effect than without, all else refitted.

    Args:
        search: has the windows.
        fitted: with the effect.
        term: the effect.
        hopeless: mean log square error, by which a fit that stays behind is not carried on.
    """
    return untouched.on_untouched(search, fitted, search.fitter.without(fitted, term.key, hopeless=hopeless))


def divided_over(gained: Improvement) -> bool:
    """Whether validation data do not clearly speak for a law of no kind, and some of them speak against it.

    It has no physics that would make it hold elsewhere, so it must predict there. One that acts in few windows gains
    little, unevenly, and loses nowhere.
    """
    return gained.gain < gained.error and gained.worst < -VERDICT.named


def _believed(gained: Improvement) -> bool:
    """Whether an effect improves predictions by enough, and evenly enough, to be named."""
    return gained.gain >= max(VERDICT.named, gained.error)


def _with_fewest_parameters(search: Searched, fitted: Fit, validation: Problem) -> tuple[Fit, float]:
    """A fit with the fewest model parameters changed, as long as validation data do not speak for the others; its
    error.

    A parameter that shows in few windows only may not be missed in the others.
    """
    fewest = sparse.fewest_parameters(search, fitted)
    error = untouched.error_on(validation, fewest)
    if error <= SCORE.at_floor:
        return fewest, error
    with_all = untouched.error_on(validation, fitted)
    return (fitted, with_all) if untouched.refuted(with_all, error) else (fewest, error)


def _others(search: Searched, upheld: Fit, fewest: Fit) -> list[Fit]:
    """With other model parameters changed; none if Ctrl-C ended the comparison."""
    if search.stop.asked:
        return []
    return search.stop.unless_pressed(lambda: sparse.other_parameters(search, upheld, fewest), list[Fit])


def _rivals(search: Searched, full: Fit, of: _Asks) -> dict[str, list[stand_ins.Rival]]:
    """What could stand in the place of each effect; nothing from when Ctrl-C ended that."""
    found: dict[str, list[stand_ins.Rival]] = {term.key: [] for term in full.structure.terms}
    asked = [term for term in full.structure.terms if not term.effect.of_no_kind]
    with closing(of(search, full, asked)) as each:
        for term in asked:
            if search.stop.asked:
                break
            found[term.key] = search.stop.unless_pressed(partial(next, each), list[stand_ins.Rival])
    return found
