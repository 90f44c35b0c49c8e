"""Where a fit stands, what is known around it, and the damped Newton step from there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dipc_gym.sim2real.estimation.settings import ESTIMATION
from dipc_gym.sim2real.estimation.shooting import Shooting, mean_loss, project, typical
from dipc_gym.sim2real.model.structure import Structure

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Quadratics:
    """Each window's squared error as a quadratic in the step of the parameters: c - 2 b.d + d.A.d.

    Attributes:
        A: (n, p, p).
        b: (n, p).
        c: (n,), at the present parameters.
    """

    A: Array
    b: Array
    c: Array

    def after(self, step: Array) -> Array:
        """Squared errors (n,) after a step (p,)."""
        return self.c - 2 * self.b @ step + np.einsum("i,nij,j->n", step, self.A, step)


@dataclass(frozen=True)
class Down:
    """A step that lowers the objective.

    Attributes:
        z: mapped parameters after it, (p,).
        s: initial states after it, (n, 2 nb).
        residual: after it, (n, m, ns).
        objective: mean loss and priors' penalty after it.
        foretold: by how much derivatives said that it would fall.
        lagged: whether a straight line did not foretell the initial states that windows need.
        damping: with which it was found.
    """

    z: Array
    s: Array
    residual: Array
    objective: float
    foretold: float
    lagged: bool
    damping: float


@dataclass(frozen=True)
class At:
    """Where a fit stands.

    Attributes:
        z: mapped parameters, (p,).
        s: initial states, (n, 2 nb).
        residual: (n, m, ns).
        columns: its derivatives by the parameters, (n, M, p).
        S: those by the initial states, (n, M, 2 nb).
    """

    z: Array
    s: Array
    residual: Array
    columns: Array
    S: Array

    def local(self, shooting: Shooting) -> Local:
        """What is known around it."""
        rows = shooting.rows(self.s, self.residual)[..., None]
        both, moves = project(self.S, np.concatenate([rows, self.columns], axis=2))
        r, J = both[..., 0], both[..., 1:]
        quadratics = Quadratics(np.swapaxes(J, 1, 2) @ J, np.einsum("nmk,nm->nk", J, r), np.einsum("nm,nm->n", r, r))
        return Local(r, J, moves, quadratics, shooting.mse(r))

    def moved(self, shooting: Shooting, down: Down) -> At:
        """After a step, with derivatives carried along."""
        columns, S = shooting.secant(
            self.columns, self.S, down.z - self.z, down.s - self.s, self.residual - down.residual
        )
        return At(down.z, down.s, down.residual, columns, S)


@dataclass(frozen=True)
class Local:
    """What is known around where a fit stands, initial states eliminated; see `Fit`.

    Attributes:
        left: (n, M).
        jacobian: (n, M, p).
        moves: of the initial states that take up the rest, with nothing changed and with each parameter, (n, 2 nb, 1 +
            p).
        quadratics: of the squared errors.
        mse: (n,).
    """

    left: Array
    jacobian: Array
    moves: Array
    quadratics: Quadratics
    mse: Array


class Newton:
    """Damped Newton steps from where a fit stands.

    Args:
        shooting: simulates.
        at: where it stands.
        local: what is known there.
        damping: with which to begin.

    Attributes:
        now: the objective there, mean loss and priors' penalty.
    """

    def __init__(self, shooting: Shooting, at: At, local: Local, damping: float) -> None:
        self.shooting, self.at, self.local, self.damping = shooting, at, local, damping
        self.problem, self.structure = shooting.problem, shooting.structure
        self.scale, self.prior = typical(local.mse), shooting.structure.prior
        counts, q = self.problem.counts, local.quadratics
        w = 1.0 / (self.scale + local.mse) / counts
        self.curvature, self.slope = (each / len(w) for each in self.prior.in_fit(q.A, q.b, at.z, w, counts))
        self.now = self._objective(local.mse, at.z)

    def _objective(self, mse: Array, z: Array) -> float:
        return mean_loss(mse, self.scale) + self.prior.penalty(z, self.problem.counts)

    def _stepped(self, reach: Array) -> Array:
        damped = self.curvature + self.damping * np.diag(np.diag(self.curvature) + 1e-12)
        return _stepped(self.structure, self.at.z, damped, self.slope, reach)

    def _told(self, z: Array) -> Array:
        """Mean squares (n,) that derivatives foretell."""
        return np.asarray(np.maximum(self.local.quadratics.after(z - self.at.z), 0.0) / self.problem.counts)

    def least_loss(self) -> float:
        """The mean loss that derivatives foretell, however far the step goes."""
        return mean_loss(self._told(self._stepped(np.full(len(self.at.z), np.inf))), 1.0)

    def downhill(self, tolerance: float) -> Down | None:
        """A step that lowers the objective, shorter and shorter ones tried; None if none does.

        Args:
            tolerance: share of the objective by which one must lower it.
        """
        shooting, at, moves = self.shooting, self.at, self.local.moves
        # No parameter may do more than double, or change by a factor of e.
        reach = ESTIMATION.reach * self.structure.sizes(at.z)
        for _ in range(ESTIMATION.tries):
            trial = self._stepped(reach)
            told = self._told(trial)
            foretold = self.now - self._objective(told, trial)
            ahead = shooting.nudge * (moves[..., 0] - moves[..., 1:] @ (trial - at.z))
            tries = at.s + ahead, at.s + ahead / ESTIMATION.shorter, at.s, self.problem.initial
            moved, after = shooting.best_initial(trial, told, tries)
            # What the initial states can still explain does not speak against parameters: behind a gap, or where a
            # joint sticks, a straight line does not foretell the initial state that a window needs.
            lagged = shooting.lags(moved, after, at.S)
            if lagged:
                moved, after = shooting.corrected(trial, moved, after, at.S)
            then = self._objective(shooting.mse(shooting.left(moved, after, at.S)), trial)
            if then < self.now:
                return Down(trial, moved, after, then, foretold, lagged, self.damping)
            # Near the noise derivatives tell what a shorter step would gain: less still.
            if self.scale < ESTIMATION.near and foretold < tolerance * self.now:
                break
            self.damping = max(self.damping * ESTIMATION.damped, ESTIMATION.damping)
        return None


def _stepped(structure: Structure, z: Array, curvature: Array, slope: Array, reach: Array) -> Array:
    """Mapped parameters after a Newton step of `reach` at most, (p,).

    Parameters that stand at a bound and would go beyond it stay; the others must not make up for where those cannot go.
    """
    free = np.ones(len(z), dtype=bool)
    while True:
        step = np.zeros(len(z))
        step[free] = np.linalg.solve(curvature[np.ix_(free, free)], slope[free])
        trial = structure.clip(z + np.clip(step, -reach, reach))
        held = free & (step != 0) & (np.abs(trial - z) < 1e-9 * np.abs(step))
        if not held.any():
            return trial
        free &= ~held
