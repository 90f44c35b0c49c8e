"""Laws as fine as predictions ask for: forces tell roughly where their knots lie, fits how many there are."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import NDArray

from dipc_gym import mjcf
from dipc_gym.sim2real.effects.shared.base import Effect, Values
from dipc_gym.sim2real.effects.shared.law import Law
from dipc_gym.sim2real.effects.shared.settings import LAWS
from dipc_gym.sim2real.effects.unknown_force import UnknownForce
from dipc_gym.sim2real.estimation.fit import Fit, fit
from dipc_gym.sim2real.model.structure import Structure, Term, carry
from dipc_gym.sim2real.selection import ranking
from dipc_gym.sim2real.selection.fitter import Fitter
from dipc_gym.sim2real.selection.partitioning import outliers
from dipc_gym.sim2real.selection.settings import SCORE, SEARCH
from dipc_gym.sim2real.selection.support import input_of, span
from dipc_gym.sim2real.simulation.windows import Windows

Array = NDArray[np.float64]


def refined(
    fitter: Fitter,
    current: Fit,
    key: str,
    tell: Callable[[str], None] = lambda line: None,
    enough: float = SCORE.at_noise,
) -> Fit:
    """A fit with one of its effects, if it has a free shape, made finer for as long as that predicts clearly better.

    It goes as far as its input does in the windows of the fit first: of the few fastest and farthest samples no force
    was asked, but a formula holds there, and a window that goes there tells.

    Args:
        fitter: fits.
        current: a fit.
        key: of the effect.
        tell: called with a line about each time that it is made finer.
        enough: error, from which on it is not made finer, in units of noise.
    """
    current = _farther(fitter, current, enough)
    for _ in range(SEARCH.halvings):
        finer = _finer(fitter, current, key, enough)
        if finer is None:
            break
        tell(f"{key} made finer: error {finer.error:.3g} x noise (was {current.error:.3g})")
        current = finer
    return current


def _farther(fitter: Fitter, current: Fit, enough: float) -> Fit:
    """A fit whose laws go as far as their inputs do in the windows of the fit, if that predicts better: so few go there
    that no mean over all of them need be clear.
    """
    if current.error <= enough:
        return current
    structure, begin = reaching(current, fitter.problem.windows)
    if structure is current.structure:
        return current
    try:
        farther = fit(fitter.problem, structure, begin, current.initial, tolerance=SEARCH.rough)
    except (mjcf.MjcfError, np.linalg.LinAlgError):
        return current
    return farther if fitter.scorer.compare(farther, current).gain > SCORE.hardly else current


def reaching(fitted: Fit, windows: Windows) -> tuple[Structure, Array]:
    """A fit's structure with laws that go as far as their inputs do in some windows, and parameters to begin at.

    A table ends where the data did that it was grown on; what is fitted last may go on from there, most of all in time.
    """
    structure, z = fitted.structure, fitted.z
    for term in fitted.structure.terms:
        if not isinstance(term.effect, Law | UnknownForce) or not (axes := term.effect.axes(term.at)):
            continue
        spans = [span(name, fitted, windows) for name in axes]
        longer = term.effect.reaching(structure.term_values(z, term), spans)
        if longer is not None:
            structure, z = instead(structure, z, term, *longer)
    return structure, z


def within_data(fitted: Fit) -> tuple[Structure, Array] | None:
    """A fit's structure with laws that end where data do, and parameters to begin at; None where all of them do.

    A value at the end of a table that hardly any reading depends on stays at its first guess, which may be anything.
    """
    structure, z = fitted.structure, fitted.z
    for term in fitted.structure.terms:
        if not isinstance(term.effect, Law):
            continue
        known = np.sqrt(np.diag(fitted.covariance(_own(fitted, term.key)))) < LAWS.untold
        shorter = term.effect.shortened(fitted.structure.term_values(fitted.z, term), known)
        if shorter is not None:
            structure, z = instead(structure, z, term, *shorter)
    return None if structure is fitted.structure else (structure, z)


def instead(structure: Structure, z: Array, term: Term, effect: Effect, guess: Values) -> tuple[Structure, Array]:
    """A structure with another shape of one effect, and mapped parameters; those of the shape begin anew."""
    others = structure.without(term.key)
    kept = carry(structure, z, others)
    reshaped = others.with_term(Term(effect, term.at, dict(guess)))
    return reshaped, carry(others, kept, reshaped)


def _finer(fitter: Fitter, current: Fit, key: str, enough: float) -> Fit | None:
    """A fit with one law made finer that predicts clearly better; None where there is none.

    If halves of a stretch gain nothing, quarters are tried: a narrow spot shows only when knots are as near.
    """
    tried: Fit | None = current
    for _ in range(SEARCH.ahead):
        if tried is None or current.error <= enough:
            return None
        effect = next(term.effect for term in tried.structure.terms if term.key == key)
        if not effect.free or (tried is not current and len(effect.parameters) > SEARCH.fine_law):
            return None
        tried = _with_more(fitter, tried, key)
        if tried is not None and _better(fitter, tried, current):
            return tried
    return None


def _with_more(fitter: Fitter, current: Fit, key: str) -> Fit | None:
    """The best fit with more parameters of one law; None where it has none."""
    term = next(term for term in current.structure.terms if term.key == key)
    values = current.structure.term_values(current.z, term)
    told = _told(current, key)
    if told is not None:
        told |= _passed(current, term, fitter.problem.windows)
    shapes = [instead(current.structure, current.z, term, *shape) for shape in term.effect.finer(values, told)]

    def reshaped(structure: Structure, begin: Array) -> Fit | None:
        try:
            return fit(fitter.problem, structure, begin, current.initial, tolerance=SEARCH.rough)
        except (mjcf.MjcfError, np.linalg.LinAlgError):
            return None

    tasks = [partial(reshaped, *shape) for shape in shapes]
    with fitter.side_by_side(tasks, [current]) as result:
        found = [one for one in map(result, range(len(tasks))) if one is not None]
    losses = ranking.losses([one.mse for one in found])
    return found[int(np.argmin(losses))] if found else None


def _told(fitted: Fit, key: str) -> NDArray[np.bool_] | None:
    """Which knots of a law data moved off where it went through the others, by twice the standard error of that, (p,).

    Only those can be that were put there last; None where none was, and of a law of two inputs.
    """
    own = _own(fitted, key)
    sigma = np.array([fitted.structure.slots[i].sigma for i in own])
    effect = next(term.effect for term in fitted.structure.terms if term.key == key)
    if not isinstance(effect, Law):
        return None
    new = sigma[: len(effect.knots)] < sigma.max()
    new[[0, -1]] = False  # elements of hysteresis are added on either side as well
    if not new.any():
        return None
    off = np.zeros((np.count_nonzero(new), len(own)))
    off[:, : len(new)] = effect.off(new)
    # Where masses and gears scale with a law, its size is known as badly as they are, but not where it bends.
    error = np.sqrt(np.einsum("ki,ij,kj->k", off, fitted.covariance(own), off))
    told = np.zeros(len(own), dtype=bool)
    told[: len(new)][new] = np.abs(off @ fitted.z[own]) > SCORE.alike * error
    return told


def _passed(fitted: Fit, term: Term, windows: Windows) -> NDArray[np.bool_]:
    """Which knots of a law are the nearest to where windows pass that stand out: what they lack may lie there, (p,).

    Args:
        fitted: to these windows.
        term: the law.
        windows: of the fit.
    """
    law, worst = term.effect, outliers(fitted.mse)
    passed = np.zeros(len(law.parameters), dtype=bool)
    if isinstance(law, Law) and len(worst):
        for axis in law.axes(term.at):
            seen = input_of(axis, fitted, windows)[worst][windows.valid[worst]]
            middles = 0.5 * (np.array(law.knots[1:]) + np.array(law.knots[:-1]))
            passed[np.unique(np.searchsorted(middles, seen))] = True
    return passed


def _own(fitted: Fit, key: str) -> list[int]:
    """Which parameters are those of one effect."""
    return [i for i, slot in enumerate(fitted.structure.slots) if slot.key.startswith(f"{key}.")]


def _better(fitter: Fitter, finer: Fit, current: Fit) -> bool:
    scorer = fitter.scorer
    clear = scorer.compare(finer, current).clear and scorer.confirmed(finer, current)
    return clear or scorer.follows(finer, current)
