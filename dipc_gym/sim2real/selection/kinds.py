"""The kind of a law that was modelled without one: what it depends on may tell."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable, Iterator
from dataclasses import replace

from dipc_gym.sim2real.effects.base import Effect, joint_of
from dipc_gym.sim2real.estimation.fit import Fit
from dipc_gym.sim2real.model.structure import Structure, Term
from dipc_gym.sim2real.selection.fitter import Fitter
from dipc_gym.sim2real.selection.hypotheses import Phase, Question, hypotheses
from dipc_gym.sim2real.selection.resolution import refined


def named(question: Question, fitter: Fitter, current: Fit, begin: Fit, tell: Callable[[str], None]) -> Fit:
    """A fit with laws of a kind in the place of those of no kind, where they predict as well.

    A force that depends on a joint's own velocity alone is friction over speed, and one that depends on the command to
    its own motor alone is the curve of that drive. A search may come to the first by a law of no kind, since a law of
    a kind, asked for alone, may end in a poor fit; with all the rest in place it does not. One that depends on two
    quantities may be a law of either, once an effect that was found later does the rest, or the sum of two laws.

    Args:
        question: effects and places.
        fitter: fits to the windows of the search.
        current: what the search came to.
        begin: the fit without effects, against which what laws gain is counted.
        tell: called with a line about each law that got a name.
    """
    for term in current.structure.terms:
        if not term.effect.of_no_kind:
            continue
        fewer: Fit | None = None
        for kinds in _kinds(question, current.structure, term):
            fewer = fewer or fitter.without(current, term.key)
            for shapes in itertools.product(*(_shapes(question, *kind, fewer) for kind in kinds)):
                fitted = fitter.near(current, functools.reduce(Structure.with_term, shapes, fewer.structure))
                for shaped in shapes:
                    fitted = fitted and refined(fitter, fitted, shaped.key)
                if fitted and fitter.scorer.alike(current, fitted, begin):
                    said = " and ".join(shaped.key for shaped in shapes)
                    tell(f"{term.key} is {said}: error {fitted.error:.3g} x noise (was {current.error:.3g})")
                    return named(question, fitter, fitter.polish(fitted), begin, tell)
    return current


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


def _shapes(question: Question, effect: Effect, at: str, fewer: Fit) -> list[Term]:
    """A law of a kind at one place, in the shapes that the evidence asks for."""
    asked = hypotheses(replace(question, effects=[effect]), Phase.SHAPES, fewer, question.look(fewer))
    return [term for guesses in asked for term in guesses() if term.at == at]
