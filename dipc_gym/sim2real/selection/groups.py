"""The same effects at every joint, taken together: a machine with friction in all its joints is the usual case.

One joint's friction takes a sixth of what a six-joint arm leaves, and shows only once the others are there. So kinds
are laid over all joints at once; members that the others make idle go before anything is accepted.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dipc_gym.sim2real.estimation.fit import Fit, fit
from dipc_gym.sim2real.model.structure import Structure, Term, carry
from dipc_gym.sim2real.selection import ranking, screen
from dipc_gym.sim2real.selection.fitter import Fitter
from dipc_gym.sim2real.selection.hypotheses import Screened
from dipc_gym.sim2real.selection.screen import Tried, excludes
from dipc_gym.sim2real.selection.settings import SCORE, SEARCH


def sketched(fitter: Fitter, screened: Screened, current: Fit) -> Fit | None:
    """The best sketch with one or two kinds of effect at several joints; None where there are no two such.

    Two kinds are tried together whatever either gains alone: other masses and gears may do nearly as well as one kind,
    and still it may be what another kind lacks. Sketched are those whose predicted gains are largest.

    Args:
        fitter: fits it.
        screened: hypotheses on top of the present fit.
        current: the present fit.
    """
    by_key = {tried.key: tried for tried in screened.tried}
    kinds, best = _kinds(fitter, screened.tried), list[Fit]()
    alone = max((tried.predicted_gain for tried in screened.tried), default=0.0)
    for _ in range(SEARCH.kinds):
        begun = best[0].structure if best else current.structure
        wider = [_with(begun, kind) for kind in kinds]
        wider = [one for one in wider if len(one.terms) > len(begun.terms) and len(_added(one, current)) > 1]
        members = [[by_key[term.key] for term in _added(one, current)] for one in wider]
        gains = screen.together(fitter.problem, current, members, fitter.subset) if wider else []
        first = sorted(zip(gains, wider, strict=True), key=lambda each: -each[0])[: SEARCH.kinds]
        asked = [structure for gain, structure in first if gain > SEARCH.keeps_up * alone]
        with fitter.sketched([(current, structure) for structure in asked]) as sketch_of:
            best += [sketch for sketch in map(sketch_of, range(len(asked))) if sketch is not None]
        losses = ranking.losses([one.mse for one in best])
        best = [best[int(np.argmin(losses))]] if best else []
    return best[0] if best else None


def fitted(fitter: Fitter, sketch: Fit, current: Fit) -> tuple[Fit, list[Tried]] | None:
    """The fit that a sketch comes to without idle members, and the hypotheses in it, if it is clearly better.

    None as well where one member is all that is needed, which the search of single effects knows more about.

    Args:
        fitter: fits it.
        sketch: see `sketched`.
        current: the present fit.
    """
    sketch = _needed(fitter, sketch, current)
    if len(_added(sketch.structure, current)) < 2:
        return None
    whole = fitter.full(current, sketch, current)
    if whole is None or not fitter.scorer.better(whole, current):
        return None
    return whole, [Tried(term, 0.0, sketch, whole) for term in _added(whole.structure, current)]


def _added(structure: Structure, current: Fit) -> list[Term]:
    there = {term.key for term in current.structure.terms}
    return [term for term in structure.terms if term.key not in there]


def _kinds(fitter: Fitter, hypotheses: Sequence[Tried]) -> list[list[Tried]]:
    """Plain effects that may act at several joints, each with its hypotheses."""
    by_id: dict[str, list[Tried]] = {}
    for tried in hypotheses:
        effect = tried.term.effect
        usual = effect.place == "joint" and effect.linear and not (effect.of_the_clock or effect.free)
        usual = usual and not effect.contains
        if usual and not fitter.slow(tried.term):
            by_id.setdefault(effect.id, []).append(tried)
    return [group for group in by_id.values() if len(group) > 1]


def _with(structure: Structure, hypotheses: Sequence[Tried]) -> Structure:
    """A structure and all hypotheses that do not exclude each other."""
    for tried in hypotheses:
        here = [term.effect for term in structure.terms if term.at == tried.term.at]
        if not any(excludes(one, tried.term.effect) for one in here):
            structure = structure.with_term(tried.term)
    return structure


def _needed(fitter: Fitter, sketch: Fit, current: Fit) -> Fit:
    """A sketch without members that its quadratics say are not missed, one after another, refitted."""
    counts, structure, idle = fitter.problem.counts[fitter.subset], sketch.structure, list[Term]()
    asked = _added(structure, current)
    while asked:
        losses = [ranking.foretold_loss(sketch, [*idle, term], counts) for term in asked]
        if not min(losses) < SCORE.worth:
            break
        idle.append(asked.pop(int(np.argmin(losses))))
    if not idle:
        return sketch
    for term in idle:
        structure = structure.without(term.key)
    begin = carry(sketch.structure, sketch.z, structure)
    less = fit(fitter.problem.pick(fitter.subset), structure, begin, sketch.initial, most=SEARCH.sketch_steps)
    # Quadratics of so many that make up for each other may foretell badly; then pruning asks one after another.
    with_all, without = ranking.losses([sketch.mse, less.mse])
    return less if without - with_all < SCORE.worth else sketch
