"""Fit a structure to windows of recordings by multiple shooting.

What remains of each window after its start is eliminated is a quadratic in the structure's numbers; screening and
intervals work on these quadratics without simulating again.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from dipc_gym.sim2real.estimation.problem import Problem, predict
from dipc_gym.sim2real.estimation.shooting import Shooting, mean_loss, project, typical
from dipc_gym.sim2real.model.structure import Structure

Array = NDArray[np.float64]

TRIES = 5  # of a step, each more damped than the one before
NEAR = 2.0  # usual square error up to which a fit is near the noise
TRUSTED = 0.5  # share of the fall that derivatives foretold, from which they are good for another step


@dataclass(frozen=True)
class Quadratics:
    """Each window's squared error as a quadratic in the step of the numbers: c - 2 b.d + d.A.d.

    Attributes:
        A: (n, p, p).
        b: (n, p).
        c: (n,), at the present numbers.
    """

    A: Array
    b: Array
    c: Array

    def after(self, step: Array) -> Array:
        """Squared errors (n,) after a step (p,)."""
        return self.c - 2 * self.b @ step + np.einsum("i,nij,j->n", step, self.A, step)


@dataclass(frozen=True)
class Fit:
    """A fitted structure.

    Attributes:
        structure: what was fitted.
        z: its mapped numbers, (p,).
        starts: corrected start states, (n, 2 nb).
        raw: residual in units of noise at these starts, (n, m, ns).
        left: the same less what a further correction of the starts would explain, prior rows appended, (n, M).
        mse: mean square of it in each window, (n,).
        sensitivity: of the readings to the starts, in units of noise, (n, m ns + 2 nb, 2 nb).
        quadratics: local model of the squared errors.
        jacobian: change of `left` per unit of each mapped number, with opposite sign, (n, M, p).
        steps: accepted steps.
        converged: whether the last step changed next to nothing.
    """

    structure: Structure
    z: Array
    starts: Array
    raw: Array
    left: Array
    mse: Array
    sensitivity: Array
    quadratics: Quadratics
    jacobian: Array = field(repr=False)
    steps: int = 0
    converged: bool = True

    @property
    def error(self) -> float:
        """Root of the mean square prediction error, in units of noise."""
        return float(np.sqrt(np.mean(self.mse)))

    def pick(self, which: NDArray[np.intp]) -> Fit:
        """What it says of some of the windows."""
        q = self.quadratics
        return replace(
            self,
            starts=self.starts[which],
            raw=self.raw[which],
            left=self.left[which],
            mse=self.mse[which],
            sensitivity=self.sensitivity[which],
            quadratics=Quadratics(q.A[which], q.b[which], q.c[which]),
            jacobian=self.jacobian[which],
        )

    def join(self, other: Fit) -> Fit:
        """What the same numbers say of these windows and of others."""
        q, o = self.quadratics, other.quadratics
        return replace(
            self,
            starts=np.append(self.starts, other.starts, 0),
            raw=np.append(self.raw, other.raw, 0),
            left=np.append(self.left, other.left, 0),
            mse=np.append(self.mse, other.mse),
            sensitivity=np.append(self.sensitivity, other.sensitivity, 0),
            quadratics=Quadratics(np.append(q.A, o.A, 0), np.append(q.b, o.b, 0), np.append(q.c, o.c)),
            jacobian=np.append(self.jacobian, other.jacobian, 0),
        )


def weights(mse: Array) -> Array:
    """Weight of each window: those that are far off count less, so that a few cannot decide a fit."""
    return 1.0 / (typical(mse) + mse)


def fit(
    problem: Problem,
    structure: Structure,
    z: Array | None = None,
    starts: Array | None = None,
    *,
    most: int = 8,
    tolerance: float = 2e-3,
) -> Fit:
    """Fit the numbers of a structure and the windows' starts (Levenberg-Marquardt).

    Args:
        problem: windows and starts.
        structure: its numbers are fitted; with none, the starts alone are.
        z: mapped numbers to begin at, (p,).
        starts: start states to begin at, (n, 2 nb).
        most: at most so many accepted steps.
        tolerance: stop when the objective falls by less than this share.
    """
    shooting = Shooting(problem, structure)
    z = structure.clip(structure.first if z is None else z)
    prior = np.array([1 / slot.sigma**2 for slot in structure.slots]) / problem.counts.mean()
    centre = np.array([slot.centre for slot in structure.slots])
    logs = np.array([slot.log for slot in structure.slots], dtype=bool)
    damping, steps, converged, exact = 1e-3, 0, False, True

    def penalised(mse: Array, z: Array, scale: float) -> float:
        return mean_loss(mse, scale) + float(prior @ (z - centre) ** 2)

    # The starts first: against wrong starts, every column would be judged wrongly.
    s, rest, columns, S = shooting.settled(z, problem.starts if starts is None else starts, numbers=True)
    while True:
        both, moves = project(S, np.concatenate([shooting.rows(s, rest)[..., None], columns], axis=2))
        r, J = both[..., 0], both[..., 1:]
        quadratics = Quadratics(np.swapaxes(J, 1, 2) @ J, np.einsum("nmk,nm->nk", J, r), np.einsum("nm,nm->n", r, r))
        mse = shooting.mse(r)
        if steps >= most or not len(z) or converged:
            break
        scale = typical(mse)
        w = 1.0 / (scale + mse) / problem.counts
        H = np.einsum("n,nij->ij", w, quadratics.A) / len(w) + np.diag(prior)
        g = w @ quadratics.b / len(w) - prior * (z - centre)
        now, accepted = penalised(mse, z, scale), False
        for _ in range(TRIES):
            # No number may do more than double, or change by a factor of e.
            reach = np.maximum(1.0, np.abs(z) * ~logs)
            trial = _stepped(structure, z, H + damping * np.diag(np.diag(H) + 1e-12), g, reach)
            foretold = now - penalised(quadratics.after(trial - z) / problem.counts, trial, scale)
            ahead = shooting.nudge * (moves[..., 0] - moves[..., 1:] @ (trial - z))
            tries = np.stack([s + ahead, s + ahead / 3, s, problem.starts])
            moved, after = shooting.best_starts(tries, shooting.residuals([trial] * len(tries), tries))
            # What the starts can still explain does not speak against numbers: behind a gap, or where a joint sticks,
            # a straight line does not foretell where a window has to start.
            lagged = shooting.lags(moved, after, S)
            if lagged:
                moved, after = shooting.corrected(trial, moved, after, S)
            then = penalised(shooting.mse(shooting.left(moved, after, S)), trial, scale)
            if then < now:
                accepted = True
                break
            # Near the noise derivatives tell what a shorter step would gain: less still.
            if scale < NEAR and foretold < tolerance * now:
                break
            damping = max(damping * 8, 1e-3)
        small = astray = True
        if accepted:
            small = now - then < tolerance * max(now, 1e-9) or bool(np.abs(trial - z).max() < 1e-4)
            astray = lagged or now - then < TRUSTED * foretold
            columns, S = shooting.secant(columns, S, trial - z, moved - s, rest - after)
            z, s, rest = trial, moved, after
            damping, steps = max(damping / 8, 1e-7), steps + 1
        else:
            damping = 1e-3
        converged = small and exact
        # Derivatives are carried along from step to step, and worked out anew where they did not foretell one.
        exact = not converged and (small or astray)
        if exact:
            _, columns, S = shooting.derivatives(z, s, rest)
    return Fit(structure, z, s, rest, r, mse, S, quadratics, J, steps, converged)


def _stepped(structure: Structure, z: Array, curvature: Array, slope: Array, reach: Array) -> Array:
    """Mapped numbers after a Newton step of `reach` at most, (p,).

    Numbers that stand at a bound and would go beyond it stay; the others must not make up for where those cannot go.
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


def correct_starts(problem: Problem, fitted: Fit, rounds: int = 3) -> tuple[Array, Array]:
    """Start states that predict each window best, and what is predicted from them.

    A fit judges windows by what no start could explain, and does not need these; whoever draws or reports
    predictions does.

    Args:
        problem: windows and estimated starts.
        fitted: structure and numbers; its starts are where the search begins.
        rounds: Gauss-Newton steps; each keeps a window's better start.

    Returns:
        Starts (n, 2 nb) and readings (n, m, ns).
    """
    shooting = Shooting(problem, fitted.structure)
    s, rest, S = fitted.starts, fitted.raw, fitted.sensitivity
    for k in range(rounds):
        if k:
            _, _, S = shooting.derivatives(fitted.z, s, rest, numbers=False)
        s, rest = shooting.corrected(fitted.z, s, rest, S, [problem.starts])
    return s, predict(problem, fitted.structure, [fitted.z], s[None])[0]


def evaluate(problem: Problem, structure: Structure, z: Array, starts: Array | None = None) -> tuple[Array, Array]:
    """Predict windows that took no part in a fit; only their starts are corrected.

    Args:
        problem: the windows.
        structure: of the model.
        z: its mapped numbers, (p,).
        starts: start states to begin at, (n, 2 nb).

    Returns:
        Mean square error of each window in units of noise, (n,), and the corrected starts.
    """
    shooting = Shooting(problem, structure)
    s, rest, _, S = shooting.settled(z, problem.starts if starts is None else starts, numbers=False)
    return shooting.mse(shooting.left(s, rest, S)), s
