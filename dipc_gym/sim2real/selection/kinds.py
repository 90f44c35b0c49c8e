"""The kind of a law that was modelled without one, or a plainer law of no kind: what it depends on may tell."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial

from dipc_gym.sim2real.effects.shared.base import Effect, joint_at, joint_of
from dipc_gym.sim2real.effects.unknown_product import UnknownProduct
from dipc_gym.sim2real.estimation.fit import Fit
from dipc_gym.sim2real.model.structure import Structure, Term
from dipc_gym.sim2real.selection import ranking
from dipc_gym.sim2real.selection.fitter import Fitter
from dipc_gym.sim2real.selection.hypotheses import Phase, Question, hypotheses
from dipc_gym.sim2real.selection.resolution import refined
from dipc_gym.sim2real.selection.screen import LaidOver, Tried
from dipc_gym.sim2real.selection.settings import SCORE, SEARCH

Asked = Callable[[Question, Fitter, Fit, Term], Iterable[tuple[Term, ...]]]


def named(question: Question, fitter: Fitter, current: Fit, begin: Fit, tell: Callable[[str], None]) -> Fit:
    """A fit with effects that have names, or laws of a kind, in the place of laws of no kind, where they predict as
    well.

    A force that depends on a joint's own velocity alone is friction over speed, or drag, and one that depends on the
    command to its own motor alone is the curve of that drive. A search may come to the first by a law of no kind, since
    an effect that was asked for alone may end in a poor fit; with all the rest in place it does not. One that depends
    on two quantities may be a law of either, once an effect that was found later does the rest, or the sum of two laws.
    Of one quantity it may hold an effect with a name as well: over velocity, friction and a constant load. Or it is a
    product, and something else: a table of both holds both, in as many values as it has cells, and knows nothing of a
    cell in which no data were.

    Args:
        question: effects and places.
        fitter: fits to the windows of the search.
        current: what the search came to.
        begin: the fit without effects, against which what laws gain is counted.
        tell: called with a line about each law that got a name.
    """
    if fitter.stays(current, begin):
        return current
    for term in current.structure.unnamed:
        fewer = fitter.without(current, term.key)
        for asked in _in_its_place(question, fitter, fewer, term):
            fitted = _as_good(fitter, current, begin, list(asked), tell, term.key)
            if fitted is not None:
                return named(question, fitter, fitter.polish(fitted), begin, tell)
    fitter.let_stay(current, begin)
    return current


def shaped(question: Question, fitter: Fitter, current: Fit, tell: Callable[[str], None]) -> Fit:
    """A fit with a law of any shape in the place of formulas that it holds, where these leave more than noise and it
    does not.

    Formulas that come near the noise end a search, and may yet be no more than likenesses: Stribeck friction and square
    drag together are nearly any friction over speed.

    Args:
        question: effects and places.
        fitter: fits to the windows of the search.
        current: what the search came to with formulas.
        tell: called with a line if a law takes their place.
    """
    if current.error < SCORE.at_noise:
        return current
    laws = [effect for effect in question.effects if effect.free and not effect.of_no_kind]
    terms = current.structure.terms
    held = {law: sorted({term.at for term in terms if term.effect.id in law.contains}) for law in laws}
    asked = [term for law in laws for at in held[law] for term in _shapes(question, fitter, law, at, current)]
    with fitter.sketched([(current, current.structure.with_term(term)) for term in asked]) as sketch_of:
        sketches = [(sketch, term.key) for k, term in enumerate(asked) if (sketch := sketch_of(k)) is not None]
    for sketch, key in sorted(sketches, key=lambda one: one[0].error):
        fitted = fitter.full(current, sketch)
        fitted = fitted and refined(fitter, fitted, key)
        # Any law takes up some of whatever else is missing; one that is there leaves nothing.
        if fitted is not None and fitted.error < SCORE.at_noise and fitter.scorer.better(fitted, current):
            tell(f"{key} in the place of what it holds: error {fitted.error:.3g} x noise (was {current.error:.3g})")
            return fitter.polish(fitted)
    return current


def _as_good(
    fitter: Fitter, current: Fit, begin: Fit, asked: Sequence[tuple[Term, ...]], tell: Callable[[str], None], key: str
) -> Fit | None:
    """The first fit with some of the effects that are asked for, in the place of a law of no kind, that predicts as
    well; None where none does.
    """
    with fitter.side_by_side(
        [partial(_instead, fitter, current, begin, key, shapes) for shapes in asked], [current]
    ) as result:
        for k, shapes in enumerate(asked):
            fitted = result(k)
            if fitted is not None:
                said = " and ".join(shaped.key for shaped in shapes)
                tell(f"{key} is {said}: error {fitted.error:.3g} x noise (was {current.error:.3g})")
                return fitted
    return None


def _instead(fitter: Fitter, current: Fit, begin: Fit, key: str, shapes: Sequence[Term]) -> Fit | None:
    """A fit with some effects in the place of a law of no kind, as fine as is asked for, if it predicts as well."""
    structure = functools.reduce(Structure.with_term, shapes, current.structure.without(key))
    sketch = fitter.sketch(current, structure)
    if sketch is None or (fitter.behind(sketch, current) and not _may_be_finer(sketch, shapes, begin)):
        return None
    fitted = fitter.full(current, sketch)
    if fitted is not None and _lacks_more_than_knots(fitted, current):
        return None
    for shaped in shapes:
        fitted = fitted and refined(fitter, fitted, shaped.key)
    return fitted if fitted and fitter.scorer.alike(current, fitted, begin) else None


def _may_be_finer(sketch: Fit, shapes: Sequence[Term], begin: Fit) -> bool:
    """Whether a sketch leaves so little of the mismatch that its laws, begun as forces tell, may lack knots alone."""
    free = any(shaped.effect.free for shaped in shapes)
    return free and sketch.error < max(SEARCH.in_reach, SEARCH.earns * begin.error)


def _lacks_more_than_knots(fitted: Fit, current: Fit) -> bool:
    """Whether effects leave more, far from the noise, than laws that are lines between knots twice as far apart as they
    should be: making them finer would take long, and come to nothing.
    """
    return current.error > SEARCH.in_reach and fitted.error > SEARCH.coarser * current.error


def _formulas(question: Question, fitter: Fitter, fewer: Fit, term: Term) -> list[tuple[Term]]:
    """The few effects with names that act where a law of no kind does and promise most without it."""
    model = fewer.structure.model
    known = [effect for effect in question.effects if not (effect.free or effect.once or effect.of_the_clock)]
    laid_over = LaidOver(fitter.problem, fewer, fitter.subset)
    found = list[Tried]()
    for guesses in hypotheses(replace(question, effects=known), Phase.FORMULAS, fewer, question.look(fewer)):
        here = [one for one in guesses() if joint_at(model, one.effect, one.at) == term.at and not fitter.slow(one)]
        found += laid_over.tried(here)
    best = {one.key: one for one in sorted(found, key=lambda one: one.predicted_gain)}  # of several starts
    promising = [one for one in best.values() if one.predicted_gain > SCORE.worth]
    return [(one.term,) for one in sorted(promising, key=lambda one: -one.predicted_gain)[: SEARCH.names]]


def _in_its_place(question: Question, fitter: Fitter, fewer: Fit, term: Term) -> Iterator[Iterable[tuple[Term, ...]]]:
    """What may stand in the place of a law of no kind, the plainest first; each is worked out once it is asked for."""
    laws = list(_laws(question, fitter, fewer, term))
    yield [*_formulas(question, fitter, fewer, term), *laws]
    # And an effect with a name beside a law of a kind: a force over velocity is friction, and a load as well.
    alone = [shapes[0] for shapes in laws if len(shapes) == 1]
    yield itertools.chain.from_iterable(_beside(question, fitter, fewer, term, law, _formulas) for law in alone)
    yield _products(question, fitter, fewer, term)


def _kinds_alone(question: Question, fitter: Fitter, fewer: Fit, term: Term) -> Iterator[tuple[Term, ...]]:
    """Effects with names, and laws of a kind."""
    yield from _formulas(question, fitter, fewer, term)
    yield from _laws(question, fitter, fewer, term)


def _beside(
    question: Question, fitter: Fitter, fewer: Fit, term: Term, law: Term, others: Asked
) -> Iterator[tuple[Term, ...]]:
    """A law, as it is fitted alone, and each single one of others that are asked for beside it."""
    sketch = fitter.sketch(fewer, fewer.structure.with_term(law))
    fitted = sketch and fitter.full(fewer, sketch)
    if fitted is not None:
        law = ranking.as_fitted(fitted)
        yield from ((law, *other) for other in others(question, fitter, fitted, term) if len(other) == 1)


def _laws(question: Question, fitter: Fitter, fewer: Fit, term: Term) -> Iterator[tuple[Term, ...]]:
    """Laws of the kinds that a law of no kind may have by its inputs, one alone or two together."""
    for kinds in _kinds(question, fewer.structure, term):
        yield from itertools.product(*(_shapes(question, fitter, *kind, fewer) for kind in kinds))


def _products(question: Question, fitter: Fitter, fewer: Fit, term: Term) -> Iterator[tuple[Term, ...]]:
    """Products of the two inputs of a table, alone and beside an effect with a name or a law of a kind."""
    if isinstance(term.effect, UnknownProduct) or len(term.effect.inputs(term.at)) < 2:
        return
    for effect in question.effects:
        if not isinstance(effect, UnknownProduct):
            continue
        for product in _shapes(question, fitter, effect, term.at, fewer):
            if set(product.effect.inputs(term.at)) != set(term.effect.inputs(term.at)):
                continue
            yield (product,)
            yield from _beside(question, fitter, fewer, term, product, _kinds_alone)


def _kinds(question: Question, structure: Structure, term: Term) -> Iterator[tuple[tuple[Effect, str], ...]]:
    """The kinds that a law of no kind may have by its inputs, and their places: one of them, then two together."""
    each: list[list[tuple[Effect, str]]] = []
    for said in term.effect.inputs(term.at):
        of, _, name = said.partition(" ")
        own = joint_of(structure.model, name) if of == "command" else name
        wanted = f"speed {name}" if of == "velocity" else said  # friction is the same either way
        laws = [effect for effect in question.effects if effect.free and not effect.of_no_kind]
        each.append([(law, name) for law in laws if own == term.at and law.inputs(name) == (wanted,)])
    yield from ((one,) for one in itertools.chain(*each))
    if len(each) > 1:
        yield from itertools.product(*each)


def _shapes(question: Question, fitter: Fitter, effect: Effect, at: str, fewer: Fit) -> list[Term]:
    """A law of a kind at one place, in the shapes that the evidence asks for."""
    scene = replace(question.look(fewer), fitted=(fitter.problem.windows, fewer))
    asked = hypotheses(replace(question, effects=[effect]), Phase.SHAPES, fewer, scene)
    return [term for guesses in asked for term in guesses() if term.at == at]
