"""What could stand in the place of an effect, as far as windows can tell."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Generator, Iterator, Sequence
from dataclasses import dataclass
from functools import partial, reduce

import mujoco
import numpy as np
from numpy.typing import NDArray

from dipc_gym.sim2real.effects.shared.base import acts_on
from dipc_gym.sim2real.estimation.fit import Fit
from dipc_gym.sim2real.model.structure import Structure, Term, names
from dipc_gym.sim2real.selection.screen import Tried, excludes
from dipc_gym.sim2real.selection.search import Searched
from dipc_gym.sim2real.selection.settings import SCORE
from dipc_gym.sim2real.verdict.settings import VERDICT

Array = NDArray[np.float64]
_StandIn = tuple[list[Term], Structure, Tried | None]  # effects, the structure with them, what a round made of it
_Swapped = tuple[Fit | None, Array | None]  # a fit, and its mean square errors on the windows compared on


@dataclass(frozen=True)
class Rival:
    """Another effect in the place of one that was chosen.

    Attributes:
        term: what was tried instead.
        fitted: the structure with it; to a subset of the windows only, where that was enough to rule it out.
        same: whether it is the same model here: at the noise, and no window tells the two apart.
        ruled_out: whether it predicts clearly worse.
        better: whether it predicts clearly better.
    """

    term: Term
    fitted: Fit
    same: bool
    ruled_out: bool
    better: bool = False


def rivals(search: Searched, full: Fit, asked: Sequence[Term]) -> Generator[list[Rival], None, None]:
    """Try other effects in the place of one, of each that is asked for in turn.

    Those that came close in its round, those it is mistaken for, a single effect that stands for it and another one,
    and two that stand for it alone.
    """
    search.fitter.remember(full)
    provisional = search.scorer.comparison_error(full) > SCORE.at_floor
    tried = [list(_stand_ins(search, full, term, provisional=provisional)) for term in asked]
    tasks = [partial(_swapped, search, full, structure, before) for each in tried for _, structure, before in each]
    with search.fitter.side_by_side(tasks, [full]) as result:
        numbers = itertools.count()
        for term, each in zip(asked, tried, strict=True):
            search.tell(f"what could stand in for {term.key}?")
            yield _judged(search, full, each, [partial(result, next(numbers)) for _ in each])


def _judged(
    search: Searched, full: Fit, stand_ins: Sequence[_StandIn], fits: Sequence[Callable[[], _Swapped]]
) -> list[Rival]:
    """Rivals in the place of one effect, and what gives the fit of each."""
    error, found = search.scorer.comparison_error(full), list[Rival]()
    for (others, structure, before), swap in zip(stand_ins, fits, strict=True):
        known = before.fitted if before else search.fitter.remembered(structure)
        swapped, compared = swap() if known is None else (known, None)
        if swapped is None:
            continue
        if known is None and compared is None:
            if len(others) == 1:
                found.append(Rival(others[0], swapped, same=False, ruled_out=True))
            continue
        if compared is not None:
            search.scorer.know(swapped, compared)
        search.fitter.remember(swapped)
        difference = search.scorer.compare(full, swapped)
        reached = search.scorer.comparison_error(swapped)
        close = difference.alike and difference.gain < VERDICT.told_apart * SCORE.worth
        same = close and difference.gain < SCORE.worth and reached < max(SCORE.at_floor, VERDICT.same * error)
        better = len(others) == 1 and _better(search, swapped, full)
        if same or len(others) == 1:
            found += [Rival(other, swapped.result(), same, not close, better) for other in others]
    return found


def unseen(search: Searched, full: Fit, asked: Sequence[Term]) -> Generator[list[Rival], None, None]:
    """Effects that hold one in them, and more that no window tells, of each that is asked for in turn: they are the
    same model here.

    Asked at the noise, with what would matter elsewhere and without a fit, which would only make it vanish.
    """
    at_noise = search.scorer.comparison_error(full) <= SCORE.at_floor
    for term in asked:
        yield _wider(search, full, term) if at_noise else []


def _wider(search: Searched, full: Fit, term: Term) -> list[Rival]:
    """See `unseen`."""
    wider = [effect for effect in search.question.effects if term.effect.id in effect.contains]
    if not wider:
        return []
    scene, plain = search.question.look(full), full.structure.term_values(full.z, term)
    found: list[Rival] = []
    for effect in wider:
        values = effect.unseen(scene.at(effect.place, term.at, {}), plain)
        if values is None:
            continue
        more = Term(effect, term.at, values)
        fitted = search.fitter.as_it_is(full, full.structure.with_term(more))
        lost = search.scorer.compare(full, fitted)
        if lost.alike and lost.gain < SCORE.worth:
            found.append(Rival(more, fitted.result(), same=True, ruled_out=False))
    return found


def _swapped(search: Searched, full: Fit, structure: Structure, before: Tried | None) -> _Swapped:
    """A structure with a rival fitted to all windows, and its mean square errors on those compared on; a sketch, and
    nothing, where that was enough to rule it out.
    """
    fitter = search.fitter
    if (before.fitted if before else fitter.remembered(structure)) is not None:
        return None, None  # nobody will ask
    sketch = before.sketch if before else fitter.sketch(full, structure, rival=True)
    if sketch is None or fitter.behind(sketch, full):
        return sketch and sketch.result(), None
    swapped = fitter.full(full, sketch)
    return (None, None) if swapped is None else (swapped.result(), search.scorer.comparison_mse(swapped))


def _better(search: Searched, swapped: Fit, full: Fit) -> bool:
    """Whether a rival predicts clearly better; at the noise, with no more parameters, beyond chance is enough."""
    gained = search.scorer.compare(swapped, full)
    if gained.clear:
        return search.scorer.confirmed(swapped, full)
    closely = search.scorer.comparison_error(swapped) < SCORE.at_floor and len(swapped.z) <= len(full.z)
    return closely and gained.told and search.scorer.compare_on_others(swapped, full).gain > 0


def _stand_ins(search: Searched, full: Fit, term: Term, *, provisional: bool) -> Iterator[_StandIn]:
    """Effects to try in the place of one, the structure with them, and what its round made of it if it was tried.

    Where structure is left, names are provisional, and fewer rivals are tried.
    """
    everything = {t.key: t for round_ in search.progress.rounds for t in round_}
    own = next((r for r in search.progress.rounds if any(t.key == term.key and t.fitted for t in r)), [])
    present = {x.key for x in full.structure.terms}
    listed = set(term.effect.rivals)
    others = [
        t
        for t in own
        if t.key not in present
        and not t.term.effect.of_no_kind
        and term.effect.id not in t.term.effect.contains
        and (t.fitted is not None or (t.term.effect.id in listed and (t.sketch is not None or not provisional)))
        # What came close may act anywhere; what an effect is mistaken for acts at its joint.
        and (t.fitted is not None or not _apart(full.structure.model, term, t.term))
    ]
    others.sort(key=lambda t: (t.score, -t.predicted_gain))
    remaining = full.structure.without(term.key)
    fitting = (
        t for t in others if not any(t.term.at == x.at and excludes(x.effect, t.term.effect) for x in remaining.terms)
    )
    for other in itertools.islice(fitting, VERDICT.rivals_left if provisional else VERDICT.rivals):
        structure = remaining.with_term(other.term)
        same = other.sketch is not None and set(names(other.sketch.structure.terms)) == set(names(structure.terms))
        yield [other.term], structure, other if same else None
    for tried in everything.values():
        inside = [
            t for t in full.structure.terms if t.at == tried.term.at and t.effect.id in tried.term.effect.contains
        ]
        if len(inside) > 1 and term.key in {t.key for t in inside}:
            yield [tried.term], full.structure.with_term(tried.term), None
    parts = [everything.get(f"{inner}@{term.at}") for inner in term.effect.contains]
    if len(parts) > 1 and all(part is not None and part.key not in present for part in parts):
        terms = [part.term for part in parts if part is not None]
        yield terms, reduce(Structure.with_term, terms, remaining), None


def _apart(model: mujoco.MjModel, one: Term, other: Term) -> bool:
    """Whether two effects act at joints, or at motors of joints, that are not the same."""
    joints = [acts_on(model, term.effect, term.at) for term in (one, other)]
    return None not in joints and joints[0] != joints[1]
