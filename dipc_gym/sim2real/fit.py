"""Fit a structure to windows of recordings by multiple shooting.

Every window has a start state of its own, so a fit has many unknowns; they are eliminated window by window (variable
projection, Golub and Pereyra 1973), which leaves a small problem in the structure's numbers. What remains of each
window after the elimination is a quadratic in those numbers; screening and intervals work on these quadratics without
simulating again.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from dipc_gym.physics import Physics
from dipc_gym.sim2real.simulate import Stepping, Windows, simulate
from dipc_gym.sim2real.states import starts as early
from dipc_gym.sim2real.structure import Structure

Array = NDArray[np.float64]

_PROBE = 0.02  # finite difference of a mapped number; smaller ones drown in the kinks of dry friction
_FAR = 1e6  # times the noise; a simulation that blew up is no worse than this
_BLOCK = 1.0  # s; neighbouring windows closer than this count as one when errors are compared


@dataclass(frozen=True)
class Problem:
    """Windows to predict, and what is known of their starts.

    Attributes:
        windows: what to predict.
        starts: estimated positions and velocities at each window's start, (n, 2 nb).
        spread: standard deviation of the estimated starts, (2 nb,).
        stepping: of the simulation.
        threads: 0 for all cores.
        finer: how many times shorter the steps are than structures need, to see what the step costs.
    """

    windows: Windows
    starts: Array
    spread: Array
    stepping: Stepping
    threads: int = 0
    finer: int = 1

    def pick(self, which: NDArray[np.intp] | NDArray[np.bool_]) -> Problem:
        """Some of the windows."""
        return replace(self, windows=self.windows.pick(which), starts=self.starts[which])

    def join(self, other: Problem) -> Problem:
        """These windows and others of the same recordings."""
        return replace(self, windows=self.windows.join(other.windows), starts=np.append(self.starts, other.starts, 0))

    @property
    def counts(self) -> Array:
        """Readings in each window, (n,); sensors that never change say nothing and do not count."""
        return self.windows.valid.sum(axis=1) * float(np.isfinite(self.windows.noise).sum())

    @property
    def blocks(self) -> NDArray[np.intp]:
        """A number for each window; windows within a second of one recording share it."""
        second = np.floor(self.windows.start / _BLOCK).astype(np.intp)
        _, block = np.unique(np.stack([self.windows.source, second], axis=1), axis=0, return_inverse=True)
        return block.ravel()


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


def weights(mse: Array) -> Array:
    """Weight of each window: those that are far off count less, so that a few cannot decide a fit."""
    return 1.0 / (typical(mse) + mse)


def typical(mse: Array) -> float:
    """Mean square error that all but a fifth of the windows stay below, at least the noise.

    Errors are compared on this scale: below it they add up as squares do, above it as logarithms, so that a few
    windows in which something else happened decide nothing. Where no structure comes down to the noise, a median in
    its place would let a structure win on the quiet half of the windows that fails wherever the motion is fast.
    """
    return max(1.0, float(np.quantile(mse, 0.8)))


def predict(problem: Problem, structure: Structure, Z: Sequence[Array], starts: Array) -> Array:
    """Readings (variants, n, m, ns) of a structure under several sets of numbers."""
    made: dict[bytes, Physics] = {}
    variants = []
    for z in Z:
        key = z.tobytes()
        if key not in made:
            made[key] = structure.physics(z)
        variants.append(made[key])
    return predict_with(problem, structure, variants, starts)


def predict_with(problem: Problem, structure: Structure, variants: Sequence[Physics], starts: Array) -> Array:
    """Readings (variants, n, m, ns) of models that have this structure."""
    windows, warm = problem.windows, structure.warm
    return simulate(
        variants,
        windows,
        starts,
        _stepping(problem, structure),
        base=structure.base,
        warm=warm,
        warm_starts=early(windows.motions, windows.source, windows.start - warm) if warm else None,
        threads=problem.threads,
    )


def residual(problem: Problem, readings: Array) -> Array:
    """(observed - readings) / noise, zero where nothing was observed."""
    rest = (problem.windows.observed - readings) / problem.windows.noise
    rest = np.nan_to_num(np.clip(rest, -_FAR, _FAR), nan=_FAR)
    return np.where(problem.windows.valid[..., None], rest, 0.0)


class _Shooting:
    """The linearised problem around one set of numbers and starts."""

    def __init__(self, problem: Problem, structure: Structure) -> None:
        self.problem, self.structure = problem, structure
        self.nb2 = problem.starts.shape[1]
        self.nudge = np.maximum(problem.spread, 1e-7)
        # A sensor with a bias or a lag tells a state only through the model.
        self.spread = problem.spread * (1e3 if structure.moves_readings else 1.0)

    def best_starts(
        self, z: Array, tries: Sequence[Array], known: tuple[Array, Array] | None = None
    ) -> tuple[Array, Array, Array]:
        """For each window the start that leaves least, its residual, its mean square error.

        Args:
            z: mapped numbers, (p,).
            tries: starts, each (n, 2 nb).
            known: one more start and its residual.
        """
        problem = self.problem
        new = [start for start in tries if known is None or not np.array_equal(start, known[0])]
        left = [] if known is None else [known[1]]
        if new:  # a rig at rest needs no other start than the one it has
            left = [*_residuals(problem, predict(problem, self.structure, [z] * len(new), np.stack(new))), *left]
        starts, rests = np.stack(new if known is None else [*new, known[0]]), np.stack(left)
        far = np.sum(((problem.starts - starts) / self.spread) ** 2, axis=2)
        mse = (np.sum(rests**2, axis=(2, 3)) + far) / problem.counts
        best, each = np.argmin(mse, axis=0), np.arange(starts.shape[1])
        return starts[best, each], rests[best, each], mse[best, each]

    def sensitivity(self, z: Array, starts: Array, base: Array) -> Array:
        """Of the scaled readings to the starts, prior rows appended: (n, m ns + 2 nb, 2 nb)."""
        moved = np.stack([starts + self.nudge * unit for unit in np.eye(self.nb2)])
        readings = predict(self.problem, self.structure, [z] * self.nb2, moved)
        n = len(starts)
        rows = (base[None] - _residuals(self.problem, readings)).reshape(self.nb2, n, -1)
        S = np.moveaxis(rows, 0, -1)  # per nudge, so that columns are of order one
        prior = np.broadcast_to(np.diag(self.nudge / self.spread), (n, self.nb2, self.nb2))
        return np.concatenate([S, prior], axis=1)

    def columns(self, z: Array, starts: Array, base: Array) -> Array:
        """Change of the scaled readings per unit of each mapped number: (n, m ns, p)."""
        p = len(z)
        if not p:
            return np.zeros((len(starts), base[0].size, 0))
        logs = np.array([slot.log for slot in self.structure.slots], dtype=bool)
        steps = _PROBE * np.maximum(1.0, np.abs(z) * ~logs)
        Z = []
        for i in range(p):
            up = self.structure.clip(z + steps[i] * np.eye(p)[i])
            if abs(up[i] - z[i]) < steps[i] / 2:
                up = self.structure.clip(z - steps[i] * np.eye(p)[i])
            steps[i] = up[i] - z[i]
            Z.append(up)
        readings = predict(self.problem, self.structure, Z, starts[None])
        rows = (base[None] - _residuals(self.problem, readings)).reshape(p, len(starts), -1)
        steps[np.abs(steps) < 1e-12] = np.inf
        return np.moveaxis(rows / steps[:, None, None], 0, -1)


def _residuals(problem: Problem, readings: Array) -> Array:
    return np.stack([residual(problem, r) for r in readings])


def _project(S: Array, rows: Array) -> tuple[Array, Array]:
    """Remove from rows (n, M, k) what the starts can explain; also the start steps (n, 2 nb, k) that do so."""
    Q, R = np.linalg.qr(S)
    inside = np.swapaxes(Q, 1, 2) @ rows
    return rows - Q @ inside, np.linalg.solve(R, inside)


def _augment(rows: Array, prior: Array | None, nb2: int) -> Array:
    """Append the rows of the starts' prior to (n, M, k)."""
    n, _, k = rows.shape
    extra = np.zeros((n, nb2, k)) if prior is None else prior[..., None]
    return np.concatenate([rows, extra], axis=1)


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
    shooting = _Shooting(problem, structure)
    z = structure.clip(structure.first if z is None else z)
    s = problem.starts if starts is None else starts
    prior_z = np.array([1 / slot.sigma**2 for slot in structure.slots])
    centre = np.array([slot.centre for slot in structure.slots])
    counts = problem.counts
    logs = np.array([slot.log for slot in structure.slots], dtype=bool)
    damping, steps, converged = 1e-3, 0, False

    base = residual(problem, predict(problem, structure, [z], s[None])[0])
    S = shooting.sensitivity(z, s, base)
    # The starts first: against wrong starts, every column would be judged wrongly.
    base, s, S = _settle(problem, shooting, z, s, base, S)
    while True:
        J = shooting.columns(z, s, base)
        r = _augment(base.reshape(len(s), -1, 1), (problem.starts - s) / shooting.spread, shooting.nb2)
        both, moves = _project(S, np.concatenate([r, _augment(J, None, shooting.nb2)], axis=2))
        r1, J1 = both[..., 0], both[..., 1:]
        quadratics = Quadratics(
            np.swapaxes(J1, 1, 2) @ J1, np.einsum("nmk,nm->nk", J1, r1), np.einsum("nm,nm->n", r1, r1)
        )
        mse = quadratics.c / counts
        if steps >= most or not len(z) or converged:
            break
        scale = typical(mse)
        w = 1.0 / (scale + mse) / counts
        uncorrected = np.einsum("nmk,nmk->n", r, r) / counts
        now = _objective(uncorrected, scale) + prior_z @ (z - centre) ** 2 / counts.mean()
        H = np.einsum("n,nij->ij", w, quadratics.A) / len(w) + np.diag(prior_z / counts.mean())
        g = w @ quadratics.b / len(w) - prior_z * (z - centre) / counts.mean()
        accepted = False
        for _ in range(5):
            step = np.linalg.solve(H + damping * np.diag(np.diag(H) + 1e-12), g)
            # No number may do more than double, or change by a factor of e.
            reach = np.maximum(1.0, np.abs(z) * ~logs)
            step = np.clip(step, -reach, reach)
            trial = structure.clip(z + step)
            ahead = shooting.nudge * (moves[..., 0] - moves[..., 1:] @ (trial - z))
            moved, rest, trial_mse = shooting.best_starts(trial, [s + ahead, s + ahead / 3, problem.starts])
            then = _objective(trial_mse, scale) + prior_z @ (trial - centre) ** 2 / counts.mean()
            if then < now:
                accepted = True
                break
            damping = max(damping * 8, 1e-3)
        if not accepted:
            converged = True
            break
        converged = now - then < tolerance * max(now, 1e-9) or bool(np.abs(trial - z).max() < 1e-4)
        z, s, base = trial, moved, rest
        damping, steps = max(damping / 8, 1e-7), steps + 1
        if steps % 2 == 0 or converged:
            S = shooting.sensitivity(z, s, base)
    return Fit(structure, z, s, base, r1, mse, S, quadratics, J1, steps, converged)


def _settle(
    problem: Problem, shooting: _Shooting, z: Array, s: Array, base: Array, S: Array
) -> tuple[Array, Array, Array]:
    """Correct the starts alone, twice; a joint that sticks may as well start at rest."""
    still = problem.starts.copy()
    still[np.abs(still) < 2 * problem.spread * (np.arange(shooting.nb2) >= shooting.nb2 // 2)] = 0.0
    for _ in range(2):
        r = _augment(base.reshape(len(s), -1, 1), (problem.starts - s) / shooting.spread, shooting.nb2)
        ahead = shooting.nudge * _project(S, r)[1][..., 0]
        s, base, _ = shooting.best_starts(z, [s + ahead, s + ahead / 3, still, problem.starts], (s, base))
        S = shooting.sensitivity(z, s, base)
    return base, s, S


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
    shooting, structure = _Shooting(problem, fitted.structure), fitted.structure
    s, rest, S = fitted.starts, fitted.raw, fitted.sensitivity
    each = np.arange(len(s))
    readings = np.zeros((0,))
    for k in range(rounds):
        if k:
            S = shooting.sensitivity(fitted.z, s, rest)
        r = _augment(rest.reshape(len(s), -1, 1), (problem.starts - s) / shooting.spread, shooting.nb2)
        ahead = shooting.nudge * _project(S, r)[1][..., 0]
        tries = np.stack([s, s + ahead, s + ahead / 3, problem.starts])
        readings = predict(problem, structure, [fitted.z] * len(tries), tries)
        rests = _residuals(problem, readings)
        far = np.sum(((problem.starts - tries) / shooting.spread) ** 2, axis=2)
        best = np.argmin(np.sum(rests**2, axis=(2, 3)) + far, axis=0)
        s, rest, readings = tries[best, each], rests[best, each], readings[best, each]
    return s, readings


def _objective(mse: Array, scale: float) -> float:
    return float(np.mean(np.log1p(mse / scale)))


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
    shooting = _Shooting(problem, structure)
    s = problem.starts if starts is None else starts
    base = residual(problem, predict(problem, structure, [z], s[None])[0])
    S = shooting.sensitivity(z, s, base)
    base, s, S = _settle(problem, shooting, z, s, base, S)
    rows = _augment(base.reshape(len(s), -1, 1), (problem.starts - s) / shooting.spread, shooting.nb2)
    left, _ = _project(S, rows)
    return np.einsum("nmk,nmk->n", left, left) / problem.counts, s


def _stepping(problem: Problem, structure: Structure) -> Stepping:
    """As fine as the structure needs; a model that is to be simulated as it is keeps its own step."""
    given = problem.stepping
    finest = math.inf if given.integrator is None else min(structure.finest, structure.own_finest)
    return replace(given, timestep=min(given.timestep, finest) / problem.finer)
