"""Rank hypotheses, and pairs of them, by their predicted gains, at the cost of one simulation a hypothesis.

The response of a model to an effect at a first guess is laid over the residual, beside everything that is free already.
Two effects may need each other: drag is worth nothing while a damping that was refitted without friction does its work,
and friction nothing without drag. Laid over the residual side by side, the two are seen without another simulation.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from dipc_gym import mjcf
from dipc_gym.sim2real.effects.shared.base import Effect
from dipc_gym.sim2real.estimation.fit import Fit, lowest
from dipc_gym.sim2real.estimation.newton import Quadratics
from dipc_gym.sim2real.estimation.problem import Problem, normalised_residual, predict_with
from dipc_gym.sim2real.estimation.shooting import mean_loss
from dipc_gym.sim2real.model.structure import Structure, Term, carry
from dipc_gym.sim2real.selection.settings import SEARCH

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Tried:
    """A hypothesis and what became of it.

    Attributes:
        term: the effect, its place, and parameters to begin at.
        predicted_gain: fall of the log error that screening foretold.
        sketch: the fit to a subset of the windows, or None if it was not among the finalists.
        fitted: the full fit, or None if the sketch did not keep up.
        score: mean log square error of all windows; infinite if not fitted.
        response: what the effect adds to the predictions of a subset of the windows at these parameters, less what
            their initial states could explain, in units of noise, (n, M); for the round in which it was screened.
    """

    term: Term
    predicted_gain: float
    sketch: Fit | None = None
    fitted: Fit | None = None
    score: float = math.inf
    response: Array = field(default_factory=lambda: np.zeros((0, 0)), repr=False)

    @property
    def in_full(self) -> Fit:
        """The full fit of one that has been fitted."""
        assert self.fitted is not None
        return self.fitted

    @property
    def key(self) -> str:
        """`effect@place`."""
        return self.term.key

    def result(self) -> Tried:
        """What is asked of it in later rounds."""
        sketch, fitted = self.sketch and self.sketch.result(), self.fitted and self.fitted.result()
        return replace(self, sketch=sketch, fitted=fitted, response=np.zeros((0, 0)))

    def pick(self, which: NDArray[np.intp], subset: NDArray[np.intp]) -> Tried:
        """What its fits say of some of the windows, and of some of the subset that was sketched on."""
        sketch = self.sketch and self.sketch.pick(subset[subset < len(self.sketch.mse)])
        return replace(self, sketch=sketch, fitted=self.fitted and self.fitted.pick(which))


class LaidOver:
    """A fit that hypotheses are laid over.

    Args:
        problem: windows to predict.
        current: the fit.
        subset: windows that have to do for what must be simulated in finer steps; responses are kept for them.
    """

    def __init__(self, problem: Problem, current: Fit, subset: NDArray[np.intp]) -> None:
        self.current, self.subset, self.step = current, subset, problem.stepping.timestep
        some, currently = problem.pick(subset), current.pick(subset)
        self.whole, self.some = _Fitted.of(problem, current), _Fitted.of(some, currently)
        self.luck = _luck(problem, current, some, currently)

    def tried(self, terms: Sequence[Term]) -> list[Tried]:
        """Hypotheses with their predicted gains: the best guess of each shape, and of each valley.

        Args:
            terms: several guesses of one hypothesis among them.
        """
        guesses: dict[tuple[object, ...], list[Term]] = {}
        for term in terms:  # a law of any shape has numbers of its own in each of its shapes
            valley = (term.guess[name] for name in term.effect.valleys)
            guesses.setdefault((term.key, id(term.effect) if term.effect.free else 0, *valley), []).append(term)
        found = []
        for group in guesses.values():
            slow = min(group[0].effect.finest, self.current.structure.finest) < self.step
            tried = _best(self.some if slow else self.whole, group)
            if tried is not None and slow:
                found.append(replace(tried, predicted_gain=max(tried.predicted_gain - self.luck, 0.0)))
            elif tried is not None:
                found.append(replace(tried, response=tried.response[self.subset]))
        return found


@dataclass(frozen=True)
class _Fitted:
    """Windows and a fit to them, with what every hypothesis that is laid over it asks for.

    Attributes:
        problem: the windows.
        current: the fit.
        moved: an orthonormal basis of what other initial states change in each window, (n, M, 2 nb).
    """

    problem: Problem
    current: Fit
    moved: Array

    @classmethod
    def of(cls, problem: Problem, current: Fit) -> _Fitted:
        """Windows and a fit to them."""
        return cls(problem, current, np.linalg.qr(current.sensitivity)[0])


def _best(fitted: _Fitted, group: Sequence[Term]) -> Tried | None:
    """The most promising guess of one effect at one place; None if none can be simulated."""
    problem, current = fitted.problem, fitted.current
    possible, variants = [], []
    for term in group:
        structure = current.structure.with_term(term)
        try:
            variants.append(structure.physics(carry(current.structure, current.z, structure)))
        except mjcf.MjcfError:
            continue
        possible.append(term)
    if not possible:
        return None
    with_it = current.structure.with_term(possible[0])
    # The initial states of the fit so far are those of a sensor in time; they and a late one's readings do not agree.
    all_readings = predict_with(problem, with_it, variants, current.initial[None], as_read=False)
    tried = []
    for term, readings in zip(possible, all_readings, strict=True):
        response = _response(fitted, readings)
        predicted_gain, size = _promise(problem, current, term.effect, response)
        scaled = _scaled(term, size)
        tried.append(Tried(scaled, predicted_gain, response=response if scaled is term else size * response))
    return max(tried, key=lambda one: one.predicted_gain)


def _response(fitted: _Fitted, readings: Array) -> Array:
    """What `readings` (n, m, ns) add to the predictions of a fit, less what the initial states could explain, (n,
    M).
    """
    change, Q = fitted.current.raw - normalised_residual(fitted.problem, readings), fitted.moved
    n = len(change)
    rows = np.concatenate([change.reshape(n, -1, 1), np.zeros((n, Q.shape[2], 1))], axis=1)
    return np.asarray((rows - Q @ (np.swapaxes(Q, 1, 2) @ rows))[..., 0])


def _promise(problem: Problem, current: Fit, effect: Effect, response: Array) -> tuple[float, float]:
    """Fall of the mean log square error by adding an effect at its best size, and that size in guesses."""
    overlay = _Overlay(problem, current, [response])
    # Beside everything that is free, or alone where the other parameters would have to go too far along a null space.
    found = [(0.0, 1.0)]
    for beside in (True, False):
        predicted_gain, (size,) = overlay.predicted_gain([0], [effect], beside=beside)
        if size != 0.0:
            found.append((predicted_gain, size))
    if effect.by_steps:  # half of a guess does not do half of what it does
        rows = current.left - response
        after = np.einsum("nm,nm->n", rows, rows) / problem.counts
        found.append((mean_loss(current.mse, 1.0) - mean_loss(after, 1.0), 1.0))
    return max(found, key=lambda each: each[0])


def pairs(
    problem: Problem, current: Fit, tried: Sequence[Tried], subset: NDArray[np.intp]
) -> list[tuple[float, Structure]]:
    """Structures with two of the hypotheses, and their predicted gains, the largest predicted gain first.

    Args:
        problem: windows to predict.
        current: fit that the hypotheses were laid over.
        tried: what screening made of them.
        subset: the windows for which their responses are known.
    """
    tried = _distinct(tried)
    if len(tried) < 2:
        return []
    some, currently = problem.pick(subset), current.pick(subset)
    overlay, luck = _Overlay(some, currently, [one.response for one in tried]), _luck(problem, current, some, currently)
    found = []
    for (i, one), (j, other) in itertools.combinations(enumerate(tried), 2):
        first, second = one.term, other.term
        if first.at == second.at and (excludes(first.effect, second.effect) or excludes(second.effect, first.effect)):
            continue
        predicted_gain, sizes = overlay.predicted_gain([i, j], [first.effect, second.effect], beside=True)
        if 0.0 in sizes:
            continue
        structure = current.structure
        for term, size in zip((first, second), sizes, strict=True):
            structure = structure.with_term(_scaled(term, size))
        found.append((predicted_gain - luck, structure))
    return sorted(found, key=lambda pair: -pair[0])


def together(
    problem: Problem, current: Fit, groups: Sequence[Sequence[Tried]], subset: NDArray[np.intp]
) -> list[float]:
    """Predicted gains of several hypotheses at once, each at its best size, for each group of them.

    Args:
        problem: windows to predict.
        current: fit that the hypotheses were laid over.
        groups: what screening made of them.
        subset: the windows for which their responses are known.
    """
    some, currently = problem.pick(subset), current.pick(subset)
    luck = _luck(problem, current, some, currently)

    def gain(tried: Sequence[Tried]) -> float:
        overlay = _Overlay(some, currently, [one.response for one in tried])
        return overlay.predicted_gain(range(len(tried)), [one.term.effect for one in tried], beside=True)[0] - luck

    return [gain(tried) for tried in groups]


def _distinct(tried: Sequence[Tried]) -> list[Tried]:
    """Of hypotheses that do one and the same to the predictions the plainest; in pairs they would only repeat it."""
    kept: list[tuple[Tried, Array]] = []
    for one in sorted(tried, key=lambda one: (len(one.term.effect.parameters), one.term.effect.needs_loader)):
        direction = one.response.ravel() / max(float(np.linalg.norm(one.response)), 1e-12)
        if all(abs(direction @ other) < SEARCH.twin for _, other in kept):
            kept.append((one, direction))
    return sorted((one for one, _ in kept), key=lambda one: -one.predicted_gain)


def _luck(problem: Problem, current: Fit, some: Problem, currently: Fit) -> float:
    """What a fit's parameters alone seem to gain on some of the windows beyond what they do on all: it is no
    effect's.

    On all windows a fit that has converged has nothing to gain, and less where a step along a null space is cut short.
    """
    overlays = _Overlay(problem, current, []), _Overlay(some, currently, [])
    everywhere, here = (overlay.predicted_gain([], [], beside=True)[0] for overlay in overlays)
    return max(here - max(everywhere, 0.0), 0.0)


class _Overlay:
    """Responses and a fit's own columns over what the fit leaves, as quadratics of each window."""

    def __init__(self, problem: Problem, current: Fit, responses: Sequence[Array]) -> None:
        columns = np.concatenate([*(response[:, :, None] for response in responses), current.jacobian], axis=2)
        flat = np.swapaxes(columns, 1, 2)
        self.own = list(range(len(responses), columns.shape[2]))
        low, high = (bound - current.z for bound in current.structure.bounds)
        self.low, self.high = np.maximum(low, -SEARCH.trusted), np.minimum(high, SEARCH.trusted)
        self.counts, self.mse = problem.counts, current.mse
        self.quadratics = Quadratics(flat @ columns, (flat @ current.left[..., None])[..., 0], current.quadratics.c)
        # A predicted gain is a fall of log errors, and so are these weights: windows at the noise are not given up
        # for others.
        weight = 1.0 / (1.0 + current.mse) / self.counts
        z = np.append(np.zeros(len(responses)), current.z)
        prior = current.structure.prior.after(len(responses))
        self.A, self.b = prior.in_fit(self.quadratics.A, self.quadratics.b, z, weight, self.counts)

    def predicted_gain(
        self, which: Sequence[int], effects: Sequence[Effect], *, beside: bool
    ) -> tuple[float, list[float]]:
        """Fall of the mean log square error by some of the effects at their best sizes, and these sizes in guesses.

        Args:
            which: of the responses.
            effects: whose responses these are.
            beside: whether the fit's parameters may move as well.
        """
        free = [*which, *(self.own if beside else [])]
        A, b = self.A[np.ix_(free, free)], self.b[free]
        count = len(which)
        least = [-SEARCH.largest if _signed(effect) else 0.0 for effect in effects]
        low, high = (
            np.append(least, self.low if beside else []),
            np.append([SEARCH.largest] * count, self.high if beside else []),
        )
        step = _within(A, b, low, high, count)
        q = self.quadratics
        picked = Quadratics(q.A[:, free][:, :, free], q.b[:, free], q.c)
        after = np.maximum(picked.after(step), 0.0) / self.counts
        return float(np.mean(np.log1p(self.mse) - np.log1p(after))), step[:count].tolist()


def _within(A: Array, b: Array, low: Array, high: Array, count: int) -> Array:
    """The step d (p,) at which d.A.d - 2 b.d is lowest within bounds.

    What would leave them stays at them, one after the other, and the rest goes without it. First the fit's own
    parameters: friction that is at zero has nothing to give up that an effect could take over.

    Args:
        A: curvature, (p, p).
        b: slope, (p,).
        low: smallest step, (p,).
        high: largest, (p,).
        count: of the first elements, which are sizes of effects.
    """
    scale = np.maximum(np.sqrt(np.diag(A)), 1e-12)
    A, b, low, high = A / np.outer(scale, scale), b / scale, low * scale, high * scale
    held: dict[int, float] = {}
    while True:
        step = lowest(A, b, held)
        beyond = np.maximum(step - high, low - step)
        beyond[list(held)] = 0.0
        if not np.any(beyond > 0):
            return step / scale
        if np.any(beyond[count:] > 0):
            beyond[:count] = 0.0
        out = int(np.argmax(beyond))
        held[out] = float(np.clip(step[out], low[out], high[out]))


def excludes(present: Effect, other: Effect) -> bool:
    """Whether one effect settles already what another would at that place: itself from another guess, two laws of dry
    friction, two rotors.
    """
    if other.id in (present.id, *present.contains):
        return True
    return present.one_of == other.one_of != "" and present.id not in other.contains


def _scaled(term: Term, size: float) -> Term:
    """A guess made `size` times as strong, where the response is linear."""
    if abs(size) < SEARCH.scaled or not term.effect.linear:
        return term
    return replace(term, guess={**term.guess, **{name: size * term.guess[name] for name in term.effect.linear}})


def _signed(effect: Effect) -> bool:
    """Whether an effect may as well act the other way."""
    return bool(effect.linear) and all(p.low < 0 for p in effect.parameters if p.name in effect.linear)
