"""Fit a structure to windows of recordings by multiple shooting.

What remains of each window after its initial state is eliminated is a quadratic in the structure's parameters;
screening and intervals work on these quadratics without simulating again.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

from dipc_gym.sim2real.estimation.newton import At, Newton, Quadratics
from dipc_gym.sim2real.estimation.problem import Problem, predict
from dipc_gym.sim2real.estimation.settings import ESTIMATION
from dipc_gym.sim2real.estimation.shooting import Shooting, rms, typical
from dipc_gym.sim2real.estimation.stepwise import searched
from dipc_gym.sim2real.model.structure import Structure

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Fit:
    """A fitted structure; what is known of one is known of that very one.

    Attributes:
        structure: what was fitted.
        z: its mapped parameters, (p,).
        initial: corrected initial states, (n, 2 nb).
        raw: residual in units of noise at these initial states, (n, m, ns).
        left: the same less what a further correction of the initial states would explain, prior rows appended, (n, M).
        mse: mean square of it in each window, (n,).
        sensitivity: of the readings to the initial states, in units of noise, (n, m ns + 2 nb, 2 nb).
        quadratics: local model of the squared errors.
        jacobian: change of `left` per unit of each mapped parameter, with opposite sign, (n, M, p).
        windows: to which it was fitted, `Problem.labels`, (n, 3).
        steps: accepted steps.
        converged: whether the last step changed next to nothing.
    """

    structure: Structure
    z: Array
    initial: Array
    raw: Array
    left: Array
    mse: Array
    sensitivity: Array
    quadratics: Quadratics
    jacobian: Array = field(repr=False)
    windows: Array = field(repr=False)
    steps: int = 0
    converged: bool = True

    @property
    def error(self) -> float:
        """Root of the mean square prediction error, in units of noise."""
        return rms(self.mse)

    def covariance(self, own: Sequence[int] | None = None) -> Array:
        """Covariance of the mapped parameters together, (p, p), or of some of them beside all others as they are.

        That of a weighted fit (Huber 1967): a window counts by its weight, and is as unsure as what is left of it says.
        What an unmodelled effect leaves goes on from window to window, and is more unsure than that.
        """
        A, prior, weight = self.quadratics.A, self.structure.prior, weights(self.mse)
        curvature = prior.in_covariance(np.einsum("n,nij->ij", weight, A), weight)
        spread = np.einsum("n,nij->ij", weight**2 * self.mse, A) + weight.mean() ** 2 * prior.precision
        if own is not None:
            curvature, spread = curvature[np.ix_(own, own)], spread[np.ix_(own, own)]
        inverse = np.linalg.pinv(curvature, hermitian=True)
        return np.asarray(inverse @ spread @ inverse)

    def of(self, problem: Problem) -> bool:
        """Whether it was fitted to these windows, in these steps."""
        return np.array_equal(self.windows, problem.labels)

    @property
    def whole(self) -> bool:
        """Whether it still has its residuals; see `result`."""
        return self.raw.shape[1] > 0

    def result(self) -> Fit:
        """What it came to, without residuals and Jacobians: of hundreds of hypotheses these fill the memory."""
        return replace(
            self,
            raw=self.raw[:, :0].copy(),
            left=self.left[:, :0].copy(),
            sensitivity=self.sensitivity[:, :0].copy(),
            jacobian=self.jacobian[:, :0].copy(),
        )

    def pick(self, which: NDArray[np.intp]) -> Fit:
        """What it says of some of the windows."""
        q = self.quadratics
        return replace(
            self,
            initial=self.initial[which],
            raw=self.raw[which],
            left=self.left[which],
            mse=self.mse[which],
            sensitivity=self.sensitivity[which],
            quadratics=Quadratics(q.A[which], q.b[which], q.c[which]),
            jacobian=self.jacobian[which],
            windows=self.windows[which],
        )

    def join(self, other: Fit) -> Fit:
        """What the same parameters say of these windows and of others."""
        q, o = self.quadratics, other.quadratics
        return replace(
            self,
            initial=np.append(self.initial, other.initial, 0),
            raw=np.append(self.raw, other.raw, 0),
            left=np.append(self.left, other.left, 0),
            mse=np.append(self.mse, other.mse),
            sensitivity=np.append(self.sensitivity, other.sensitivity, 0),
            quadratics=Quadratics(np.append(q.A, o.A, 0), np.append(q.b, o.b, 0), np.append(q.c, o.c)),
            jacobian=np.append(self.jacobian, other.jacobian, 0),
            windows=np.append(self.windows, other.windows, 0),
        )


def weights(mse: Array) -> Array:
    """Weight of each window: those that are far off count less, so that a few cannot decide a fit."""
    return 1.0 / (typical(mse) + mse)


def lowest(A: Array, b: Array, held: Mapping[int, float]) -> Array:
    """The step d (p,) at which d.A.d - 2 b.d is lowest where some of its elements are held.

    Where that is so along a line or more, the shortest one: A (p, p) need not be regular.

    Args:
        A: curvature.
        b: slope, (p,).
        held: elements by number.
    """
    step = np.zeros(len(b))
    gone, open_ = list(held), [i for i in range(len(b)) if i not in held]
    step[gone] = list(held.values())
    right = b[open_] - A[np.ix_(open_, gone)] @ step[gone]
    step[open_] = _shortest(A[np.ix_(open_, open_)], right)
    return step


def _shortest(A: Array, b: Array) -> Array:
    """The shortest x with A x = b as nearly as can be, A (p, p) symmetric and with no negative curvature.

    The screen asks for thousands. Where all of A is well known, which the traces of it and of its inverse can tell,
    Cholesky's factors do, in a tenth of the time of singular values.
    """
    factor, failed = lapack.dpotrf(A, lower=True)
    if not failed and len(b):
        inverse, failed = lapack.dpotri(factor, lower=True)
        # Its largest curvature is at most the trace, and its least at least one over that of the inverse.
        if not failed and np.trace(A) * np.trace(inverse) * ESTIMATION.singular < 1:
            found, _ = lapack.dpotrs(factor, b, lower=True)
            return np.asarray(found)
    return np.asarray(np.linalg.lstsq(A, b, rcond=ESTIMATION.singular)[0])


def holding(fitted: Fit, problem: Problem, held: Mapping[int, float]) -> Array:
    """Mapped parameters (p,) where some are held and the others are where the quadratics and their priors have them.

    Along a null space the priors alone say where that is, as they do in `fit`.

    Args:
        fitted: to these windows.
        problem: the windows.
        held: values by the number of the mapped parameter.
    """
    structure, z, q = fitted.structure, fitted.z, fitted.quadratics
    A, b = structure.prior.in_fit(q.A, q.b, z, weights(fitted.mse) / problem.counts, problem.counts)
    found = z + lowest(A, b, {i: value - z[i] for i, value in held.items()})
    open_ = [i for i in range(len(z)) if i not in held]
    found[open_] = structure.clip(found)[open_]
    return found


def fit(
    problem: Problem,
    structure: Structure,
    z: Array | None = None,
    initial: Array | None = None,
    *,
    most: int = ESTIMATION.steps,
    tolerance: float = ESTIMATION.tolerance,
    hopeless: float = np.inf,
) -> Fit:
    """Fit the parameters of a structure and the windows' initial states (Levenberg-Marquardt).

    Args:
        problem: windows and initial states.
        structure: its parameters are fitted; with none, the initial states alone are.
        z: mapped parameters to begin at, (p,).
        initial: initial states to begin at, (n, 2 nb).
        most: at most so many accepted steps.
        tolerance: stop when the objective falls by less than this share.
        hopeless: stop when after two steps the derivatives foretell no mean loss below this: those at the first guess
            mislead where a shape is far off.
    """
    shooting = Shooting(problem, structure)
    z = structure.clip(structure.first if z is None else z)
    damping, steps, converged, exact = ESTIMATION.damping, 0, False, True
    to_search = most > 0 and bool(structure.stepwise)
    # The initial states first: against wrong initial states, every column would be judged wrongly.
    at = At(z, *shooting.settled(z, problem.initial if initial is None else initial, parameters=True))
    while True:
        local = at.local(shooting)
        if steps >= most or not len(z) or converged:
            if to_search:
                to_search, found = False, searched(shooting, at.z, at.s, at.residual, at.S)
                if not np.array_equal(found, at.z):
                    converged, exact, most = False, True, steps + most
                    at = At(found, *shooting.settled(found, at.s, parameters=True))
                    continue
            break
        newton = Newton(shooting, at, local, damping)
        if steps > 1 and np.isfinite(hopeless) and newton.least_loss() > hopeless:
            break
        down = newton.downhill(tolerance)
        small = astray = True
        if down is None:
            damping = ESTIMATION.damping
        else:
            fell, moved = newton.now - down.objective, float(np.abs(down.z - at.z).max())
            small = fell < tolerance * max(newton.now, 1e-9) or moved < ESTIMATION.still
            astray = down.lagged or fell < ESTIMATION.trusted * down.foretold
            at = at.moved(shooting, down)
            damping, steps = max(down.damping / ESTIMATION.damped, ESTIMATION.least_damping), steps + 1
        converged = small and exact
        # Derivatives are carried along from step to step, and worked out anew where they did not foretell one.
        exact = not converged and (small or astray)
        if exact:
            _, columns, S = shooting.derivatives(at.z, at.s, at.residual)
            at = replace(at, columns=columns, S=S)
    return Fit(
        structure,
        at.z,
        at.s,
        at.residual,
        local.left,
        local.mse,
        at.S,
        local.quadratics,
        local.jacobian,
        problem.labels,
        steps,
        converged,
    )


def readings(problem: Problem, structure: Structure, z: Array) -> Array:
    """What is predicted (n, m, ns) of windows that took no part in a fit, from initial states that predict each best.

    A fit judges windows by what no initial state could explain, and does not need these; whoever draws or reports
    predictions does.
    """
    shooting = Shooting(problem, structure)
    s, residual, _, S = shooting.settled(z, problem.initial, parameters=False)
    for k in range(ESTIMATION.rounds):
        if k:
            _, _, S = shooting.derivatives(z, s, residual, parameters=False)
        s, residual = shooting.corrected(z, s, residual, S)
    return predict(problem, structure, [z], s[None])[0]


def evaluate(problem: Problem, structure: Structure, z: Array) -> Array:
    """Mean square error of windows that took no part in a fit, in units of noise, (n,).

    Only their initial states are corrected.

    Args:
        problem: the windows.
        structure: of the model.
        z: its mapped parameters, (p,).
    """
    shooting = Shooting(problem, structure)
    s, residual, _, S = shooting.settled(z, problem.initial, parameters=False)
    return shooting.mse(shooting.left(s, residual, S))


def begun(problem: Problem, structure: Structure, z: Array) -> tuple[Array, Array]:
    """Initial states (n, 2 nb) that predict windows best, and how readings change with them; see `Shooting.settled`."""
    s, _, _, S = Shooting(problem, structure).settled(z, problem.initial, parameters=False)
    return s, S


def simulated(problem: Problem, structure: Structure, z: Array, begin: tuple[Array, Array]) -> Array:
    """Mean square error of each window in units of noise, (n,), as it comes out when it is simulated.

    `evaluate` leaves out what a straight line says that yet other initial states would explain; where joints stick, no
    initial states do.

    Args:
        problem: windows.
        structure: of the model.
        z: its mapped parameters, (p,).
        begin: what `begun` says of the same windows, maybe in other steps.
    """
    shooting, (s, S) = Shooting(problem, structure), begin
    residual = shooting.residuals([z], s[None])[0]
    mse = np.sum(residual**2, axis=(1, 2)) / problem.counts
    for k in range(ESTIMATION.simulated):  # for as long as they bring something
        s, residual = shooting.corrected(z, s, residual, S, () if k else [problem.initial])
        before, mse = mse, np.sum(residual**2, axis=(1, 2)) / problem.counts
        if np.mean(before) < (1 + ESTIMATION.lag) * np.mean(mse):
            break
    return np.asarray(mse)
