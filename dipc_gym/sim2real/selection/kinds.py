"""The kind of a law that was modelled without one: what it depends on may tell."""

from __future__ import annotations

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
    a kind, asked for alone, may end in a poor fit; with all the rest in place it does not.

    Args:
        question: effects and places.
        fitter: fits to the windows of the search.
        current: what the search came to.
        begin: the fit without effects, against which what laws gain is counted.
        tell: called with a line about each law that got a name.
    """
    for term in current.structure.terms:
        for effect, at in _kinds(question, current.structure, term):
            fewer = fitter.without(current, term.key)
            for shaped in _shapes(question, effect, at, fewer):
                fitted = fitter.near(current, fewer.structure.with_term(shaped))
                fitted = fitted and refined(fitter, fitted, shaped.key)
                if fitted and fitter.scorer.alike(current, fitted, begin):
                    tell(f"{term.key} is {shaped.key}: error {fitted.error:.3g} x noise (was {current.error:.3g})")
                    return named(question, fitter, fitter.polish(fitted), begin, tell)
    return current


def _kinds(question: Question, structure: Structure, term: Term) -> Iterator[tuple[Effect, str]]:
    """The kind that a law of no kind has by its one input, and its place."""
    inputs = term.effect.inputs(term.at)
    if not term.effect.of_no_kind or len(inputs) != 1:
        return
    of, _, name = inputs[0].partition(" ")
    own = joint_of(structure.model, name) if of == "command" else name
    wanted = f"speed {name}" if of == "velocity" else inputs[0]  # friction is the same either way
    for effect in question.effects:
        if own == term.at and effect.free and not effect.of_no_kind and effect.inputs(name) == (wanted,):
            yield effect, name


def _shapes(question: Question, effect: Effect, at: str, fewer: Fit) -> list[Term]:
    """A law of a kind at one place, in the shapes that the evidence asks for."""
    asked = hypotheses(replace(question, effects=[effect]), Phase.SHAPES, fewer, question.look(fewer))
    return [term for term in asked if term.at == at]
