"""Rank hypotheses by what each promises, at the cost of one simulation.

The response of a model to an effect at a first guess is laid over the residual, beside everything that is free already.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dipc_gym import mjcf
from dipc_gym.sim2real.effects.base import Effect
from dipc_gym.sim2real.fit import Fit, Problem, predict_with, residual
from dipc_gym.sim2real.structure import Term, carry

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Tried:
    """A hypothesis and what became of it.

    Attributes:
        term: the effect, its place, and numbers to begin at.
        promise: fall of the log error that screening foretold.
        sketch: the fit to a few windows, or None if it was not among the finalists.
        fitted: the full fit, or None if the sketch did not keep up.
        score: mean log square error of all windows; infinite if not fitted.
    """

    term: Term
    promise: float
    sketch: Fit | None = None
    fitted: Fit | None = None
    score: float = math.inf

    @property
    def key(self) -> str:
        """`effect@place`."""
        return self.term.key


def screen(problem: Problem, current: Fit, terms: Sequence[Term], few: NDArray[np.intp]) -> list[Tried]:
    """Rank hypotheses by what they promise; the best guess of each, the most promising first.

    Args:
        problem: windows to predict.
        current: fit that the hypotheses are laid over.
        terms: hypotheses, several guesses of one among them.
        few: windows that have to do for what must be simulated in finer steps.
    """
    guesses: dict[str, list[Term]] = {}
    for term in terms:
        guesses.setdefault(term.key, []).append(term)
    some, currently = problem.pick(few), current.pick(few)
    found = []
    for group in guesses.values():
        slow = min(group[0].effect.finest, current.structure.finest) < problem.stepping.timestep
        tried = _best(*((some, currently) if slow else (problem, current)), group)
        found += [tried] if tried else []
    return sorted(found, key=lambda tried: -tried.promise)


def _best(problem: Problem, current: Fit, group: Sequence[Term]) -> Tried | None:
    """The most promising guess of one effect at one place; None if none can be simulated."""
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
    all_readings = predict_with(problem, current.structure.with_term(possible[0]), variants, current.starts[None])
    tried = []
    for term, readings in zip(possible, all_readings, strict=True):
        promise, size = _promise(problem, current, term.effect, readings)
        tried.append(Tried(_scaled(term, size), promise))
    return max(tried, key=lambda one: one.promise)


def _promise(problem: Problem, current: Fit, effect: Effect, readings: Array) -> tuple[float, float]:
    """Fall of the mean log square error by adding an effect at its best size, and that size in guesses.

    Args:
        problem: windows to predict.
        current: fit without the effect.
        effect: what is added.
        readings: predicted with it at a first guess, (n, m, ns).
    """
    # What the effect adds to the prediction, in units of noise.
    change = current.raw - residual(problem, readings)
    n = len(current.mse)
    rows = np.concatenate([change.reshape(n, -1, 1), np.zeros((n, current.sensitivity.shape[2], 1))], axis=1)
    Q, _ = np.linalg.qr(current.sensitivity)
    rows = (rows - Q @ (np.swapaxes(Q, 1, 2) @ rows))[..., 0]
    counts = problem.counts
    # A promise is a fall of log errors, and so are these weights: windows at the noise are not given up for others.
    weight = 1.0 / (1.0 + current.mse) / counts
    columns = np.concatenate([rows[..., None], current.jacobian], axis=2)
    A = np.einsum("n,nmi,nmj->ij", weight, columns, columns)
    b = np.einsum("n,nmi,nm->i", weight, columns, current.left)
    prior = np.array([0.0, *(1 / slot.sigma**2 for slot in current.structure.slots)])
    A = A + np.diag(prior / counts.mean()) * len(counts) / n
    scale = np.maximum(np.sqrt(np.diag(A)), 1e-12)
    before = float(np.mean(np.log1p(current.mse)))
    # Beside everything that is free; alone only where the other numbers would have to go too far along a null space.
    for count in (len(b), 1):
        own = scale[:count]
        step = np.linalg.lstsq(A[:count, :count] / np.outer(own, own), b[:count] / own, rcond=1e-9)[0] / own
        size = float(np.clip(step[0], -100.0 if _signed(effect) else 0.0, 100.0))
        left = current.left - columns[..., :count] @ np.append(size, np.clip(step[1:], -1, 1))
        after = np.einsum("nm,nm->n", left, left) / counts
        promise = before - float(np.mean(np.log1p(after)))
        if size != 0.0 and promise > 0.0:
            return promise, size
    return 0.0, 1.0


def _scaled(term: Term, size: float) -> Term:
    """A guess made `size` times as strong, where the response is linear."""
    if abs(size) < 0.05 or not term.effect.linear:
        return term
    return replace(term, guess={**term.guess, **{name: size * term.guess[name] for name in term.effect.linear}})


def _signed(effect: Effect) -> bool:
    """Whether an effect may as well act the other way."""
    return bool(effect.linear) and all(p.low < 0 for p in effect.parameters if p.name in effect.linear)
