"""Which hypotheses a search goes on with: by predicted gain, by what they leave, and by what they cost."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dipc_gym.sim2real.estimation.fit import Fit, lowest
from dipc_gym.sim2real.estimation.shooting import mean_loss, typical
from dipc_gym.sim2real.model.structure import Structure, Term
from dipc_gym.sim2real.selection.partitioning import outliers
from dipc_gym.sim2real.selection.score import Improvement
from dipc_gym.sim2real.selection.screen import Tried
from dipc_gym.sim2real.selection.settings import SCORE, SEARCH, WINDOWS

Array = NDArray[np.float64]


class Start(NamedTuple):
    """A hypothesis, and the fit that it was laid over."""

    tried: Tried
    base: Fit

    @property
    def term(self) -> Term:
        """The effect, with its guess."""
        return self.tried.term

    @property
    def predicted_gain(self) -> float:
        """What screening foretold of it."""
        return self.tried.predicted_gain


def mostly_at_noise(fitted: Fit) -> bool:
    """Whether most windows are at the noise, so that one in which something happened stands out."""
    return float(np.median(fitted.mse)) < SCORE.usual


def alike(difference: Improvement, gained: float) -> bool:
    """Whether a fit predicts as well as the best: by the standard error, or within a fiftieth of its gain."""
    return difference.alike and difference.gain < SCORE.share * gained + SCORE.worth


def updated(tried: Sequence[Tried], news: Sequence[Tried]) -> list[Tried]:
    """What became of hypotheses: the newest of each, the news first."""
    known = {one.key for one in news}
    return [*news, *(one for one in tried if one.key not in known)]


def brought(sketch: Fit, before: Array) -> float:
    """By how much a sketch lowers the log error of its windows from mean square errors `before`, (n,).

    On the scale of the noise, as predicted gains are.
    """
    return mean_loss(before, 1.0) - mean_loss(sketch.mse, 1.0)


def complete(sketch: Fit) -> bool:
    """Whether a sketch leaves nothing, in no window."""
    return sketch.error < SCORE.at_noise and not len(outliers(sketch.mse))


def losses(errors: Sequence[Array]) -> list[float]:
    """Mean loss of each of several fits' mean square errors (n,), on the scale of the best of them."""
    usual = min(map(typical, errors), default=1.0)
    return [mean_loss(mse, usual) for mse in errors]


def foretold_loss(fitted: Fit, terms: Sequence[Term], counts: Array) -> float:
    """Rise of what fits lower, error and priors' penalty, without effects that grow from nothing, by quadratics.

    Args:
        fitted: with the effects.
        terms: the effects; their parameters are set to zero, all others may make up for it as far as their priors let
            them: without these masses, gears and friction of an arm scale together, and nothing is ever missed.
        counts: readings in each window, (n,).
    """
    slots, z, q = fitted.structure.slots, fitted.z, fitted.quadratics
    keys = tuple(f"{term.key}." for term in terms)
    gone = [i for i, slot in enumerate(slots) if slot.key.startswith(keys) and slot.may_vanish]
    weight = 1.0 / (1.0 + fitted.mse) / counts
    prior = fitted.structure.prior
    A, b = prior.in_fit(q.A, q.b, z, weight, counts)
    step = lowest(A, b, {i: slots[i].mapped(0.0) - z[i] for i in gone})
    after = np.maximum(q.after(step), 0.0) / counts
    penalty = prior.penalty(z + step, counts) - prior.penalty(z, counts)
    return float(np.mean(np.log1p(after) - np.log1p(fitted.mse)) + penalty)


def finalists(ranked: Sequence[Start], count: int) -> list[Start]:
    """The most promising hypotheses, and the plainer ones that these elaborate."""
    first = ranked[:count]
    plain = {f"{inner}@{tried.term.at}" for tried, _ in first for inner in tried.term.effect.contains}
    return [*first, *(start for start in ranked[count:] if start.tried.key in plain)]


def idle(structure: Structure, sketches: Sequence[Fit]) -> bool:
    """Whether a structure elaborates one of several that leave nothing to it."""
    return any(sketch.error < SCORE.at_noise and structure.elaborates(sketch.structure) for sketch in sketches)


def subset(mse: Array) -> NDArray[np.intp]:
    """A third of the windows, those with the largest errors (n,) among them."""
    count = len(mse)
    if count <= SEARCH.subset:
        return np.arange(count)
    return np.unique(
        np.append(
            np.linspace(0, count - 1, max(count // WINDOWS.every, SEARCH.subset)).round(),
            np.argsort(-mse)[: SEARCH.worst],
        )
    ).astype(np.intp)


def cost(fitted: Fit) -> tuple[int, int, int, int]:
    """What the simpler of two structures has less of: parameters, effects, and effects that stock MuJoCo lacks.

    Among names for one and the same model, an effect at a joint goes before one at a motor or a sensor.
    """
    effects = [term.effect for term in fitted.structure.terms]
    loaders, elsewhere = sum(e.needs_loader for e in effects), sum(e.place != "joint" for e in effects)
    return len(fitted.z), len(effects), loaders, elsewhere


def as_fitted(fitted: Fit) -> Term:
    """The newest effect of a structure with its fitted parameters for guesses."""
    term = fitted.structure.newest
    return replace(term, guess=fitted.structure.term_values(fitted.z, term))
