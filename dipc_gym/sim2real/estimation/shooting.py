"""The linearised problem of multiple shooting: what the parameters and the initial state of each window change.

Every window has an initial state of its own, so a fit has many unknowns; they are eliminated window by window (variable
projection, Golub and Pereyra 1973), which leaves a small problem in the structure's parameters.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from dipc_gym import mjcf
from dipc_gym.physics import from_model
from dipc_gym.sim2real.estimation.problem import Problem, normalised_residual, predict, sensitivities
from dipc_gym.sim2real.estimation.settings import ESTIMATION
from dipc_gym.sim2real.estimation.states import seen
from dipc_gym.sim2real.model.structure import Structure

Array = NDArray[np.float64]


class _Hidden(NamedTuple):
    """Base joints (nb,), see `Shooting`."""

    joints: NDArray[np.bool_]


class Shooting:
    """A structure laid over windows.

    Args:
        problem: windows and estimated initial states.
        structure: of the model.
    """

    def __init__(self, problem: Problem, structure: Structure) -> None:
        self.problem, self.structure = problem, structure
        self.nb2 = problem.initial.shape[1]
        self.nudge = np.maximum(problem.spread, 1e-7)
        # A sensor with a bias or a lag tells a state only through the model.
        self.spread = problem.spread * np.where(np.tile(self._hidden(), 2), ESTIMATION.hidden, 1.0)

    def _hidden(self) -> NDArray[np.bool_]:
        """Base joints (nb,) whose places a sensor tells that says something else of them in this structure, or nothing:
        of a speed the place is integrated from a beginning that nobody read.
        """
        structure = self.structure
        known = structure.worked_out.get(_Hidden)
        if not isinstance(known, _Hidden):
            told, moved = seen(from_model(structure.model)), structure.moved_sensors
            joints = told.by_speed
            if moved:
                names = np.array(mjcf.scalar_sensors(structure.model))[told.sensors]
                through = np.abs(told.inverse(self.problem.windows.noise)[:, [one in moved for one in names.tolist()]])
                joints = joints | (through.max(axis=1, initial=0.0) > ESTIMATION.tells)
            known = structure.worked_out[_Hidden] = _Hidden(joints)
        return known.joints

    def residuals(self, Z: Sequence[Array], initial: Array) -> Array:
        """Of several sets of parameters or initial states (variants or 1, n, 2 nb), in units of noise, (variants, n,
        m, ns).
        """
        readings = predict(self.problem, self.structure, Z, initial)
        return np.stack([normalised_residual(self.problem, one) for one in readings])

    def rows(self, initial: Array, residual: Array) -> Array:
        """Residuals (n, m, ns) and how far initial states are from their estimates, (n, m ns + 2 nb)."""
        return np.concatenate(
            [residual.reshape(len(initial), -1), (self.problem.initial - initial) / self.spread], axis=1
        )

    def mse(self, rows: Array) -> Array:
        """Mean square of each window's rows, (n,)."""
        return np.einsum("nm,nm->n", rows, rows) / self.problem.counts

    def best_initial(
        self, z: Array, foretold: Array, tries: Sequence[Array], known: tuple[Array, Array] | None = None
    ) -> tuple[Array, Array]:
        """For each window the initial state of several that leaves least, and its residual (n, m, ns).

        The first is the one that derivatives ask for; the others are simulated only in windows where it leaves more
        than they foretold, or more than noise: where a joint sticks, derivatives do not see what another start brings.

        Args:
            z: mapped parameters, (p,).
            foretold: mean square that the first will leave of each window, (n,).
            tries: initial states, (n, 2 nb) each.
            known: initial states whose residual is known.
        """
        if np.median(foretold) > ESTIMATION.near:  # most windows ask for all of them, and one batch costs less than two
            all_of = np.stack(tries)
            begin, residual = self.least(all_of, self.residuals([z] * len(all_of), all_of))
        else:
            begin, residual = self._first_that_does(z, foretold, tries)
        if known is None:
            return begin, residual
        return self.least(np.stack([begin, known[0]]), np.stack([residual, known[1]]))

    def _first_that_does(self, z: Array, foretold: Array, tries: Sequence[Array]) -> tuple[Array, Array]:
        """`best_initial` where the first will do for most windows."""
        begin = tries[0]
        residual = self.residuals([z], begin[None])[0]
        mse = self.mse(self.rows(begin, residual))
        behind = np.flatnonzero((mse > ESTIMATION.near) | (np.log1p(mse) - np.log1p(foretold) > ESTIMATION.lag))
        if len(behind) and len(tries) > 1:
            some = Shooting(self.problem.pick(behind), self.structure)
            others = np.stack([each[behind] for each in tries[1:]])
            begin, residual = begin.copy(), residual.copy()
            begin[behind], residual[behind] = some.least(
                np.append(begin[None, behind], others, axis=0),
                np.append(residual[None, behind], some.residuals([z] * len(others), others), axis=0),
            )
        return begin, residual

    def least(self, tries: Array, residuals: Array) -> tuple[Array, Array]:
        """For each window the one of several initial states (tries, n, 2 nb) that leaves least, and its residual (n,
        m, ns).
        """
        mse = [self.mse(self.rows(start, residual)) for start, residual in zip(tries, residuals, strict=True)]
        best, each = np.argmin(mse, axis=0), np.arange(tries.shape[1])
        return tries[best, each], residuals[best, each]

    def corrected(
        self, z: Array, initial: Array, residual: Array, S: Array, others: Sequence[Array] = ()
    ) -> tuple[Array, Array]:
        """Initial states after a Gauss-Newton step where that is better, and their residual.

        Args:
            z: mapped parameters, (p,).
            initial: (n, 2 nb).
            residual: their residual, (n, m, ns).
            S: sensitivity to the initial states.
            others: initial states to try beside.
        """
        left, moves = project(S, self.rows(initial, residual)[..., None])
        ahead = self.nudge * moves[..., 0]
        # A rig at rest needs no other initial state than the one it has.
        new = [
            one
            for one in (initial + ahead, initial + ahead / ESTIMATION.shorter, *others)
            if not np.array_equal(one, initial)
        ]
        if not new:
            return initial, residual
        return self.best_initial(z, self.mse(left[..., 0]), new, known=(initial, residual))

    def settled(self, z: Array, initial: Array, *, parameters: bool) -> tuple[Array, Array, Array, Array]:
        """Corrected initial states, their residual, and `derivatives` there.

        Two other initial states are tried: the estimate, and the estimate with slow joints at rest, for a joint may
        stick. Where a straight line did not tell the initial state, a second one is drawn from there, for each window
        whatever the others do.
        """
        estimate, half = self.problem.initial, self.nb2 // 2
        still = estimate.copy()
        still[np.abs(still) < ESTIMATION.at_rest * self.problem.spread * (np.arange(self.nb2) >= half)] = 0.0
        residual, _, S = self.derivatives(z, initial, parameters=False)
        initial, residual = self.corrected(z, initial, residual, S, [still, estimate])
        _, columns, S = self.derivatives(z, initial, residual, parameters=parameters)
        behind = np.flatnonzero(self._behind(initial, residual, S))
        if len(behind):
            some = Shooting(self.problem.pick(behind), self.structure)
            begin, left = some.corrected(z, initial[behind], residual[behind], S[behind])
            initial, residual, columns, S = initial.copy(), residual.copy(), columns.copy(), S.copy()
            initial[behind] = begin
            residual[behind], columns[behind], S[behind] = some.derivatives(z, begin, left, parameters=parameters)
        return initial, residual, columns, S

    def left(self, initial: Array, residual: Array, S: Array) -> Array:
        """Rows (n, M) less what a further correction of the initial states would explain."""
        return project(S, self.rows(initial, residual)[..., None])[0][..., 0]

    def _behind(self, initial: Array, residual: Array, S: Array) -> NDArray[np.bool_]:
        """Which windows a further correction of their initial states would bring much nearer, (n,)."""
        left, mse = self.mse(self.left(initial, residual, S)), self.mse(self.rows(initial, residual))
        return np.asarray(np.log1p(mse) - np.log1p(left) > ESTIMATION.lag)

    def lags(self, initial: Array, residual: Array, S: Array) -> bool:
        """Whether a further correction of the initial states would explain much."""
        left, mse = self.mse(self.left(initial, residual, S)), self.mse(self.rows(initial, residual))
        scale = typical(left)
        return mean_loss(mse, scale) - mean_loss(left, scale) > ESTIMATION.lag

    def derivatives(
        self, z: Array, initial: Array, residual: Array | None = None, *, parameters: bool = True
    ) -> tuple[Array, Array, Array]:
        """How residuals change with the parameters and with the initial states; one batch, for a small one costs
        little less.

        Args:
            z: mapped parameters, (p,).
            initial: (n, 2 nb).
            residual: their residual, (n, m, ns), where it is known.
            parameters: whether changes with the parameters are asked for.

        Returns:
            The residual, (n, m, ns); the change of the scaled readings per unit of each mapped parameter, zeros for the
            prior appended, (n, M, p), or (n, M, 0); and their sensitivity to the initial states, per nudge so that
            columns are of order one, with the prior's rows, (n, M, 2 nb).
        """
        exact = self._exact(z, initial, residual, parameters=parameters)
        if exact is not None:
            return exact
        n, probes, steps = len(initial), *(self._probes(z) if parameters else ([], np.zeros(0)))
        Z = [*probes, *[z] * self.nb2]
        begin = np.stack([*[initial] * len(probes), *(initial + self.nudge * unit for unit in np.eye(self.nb2))])
        if residual is None:
            Z, begin = [*Z, z], np.append(begin, initial[None], axis=0)
        moved = self.residuals(Z, begin)
        residual = moved[-1] if residual is None else residual
        change = np.moveaxis((residual - moved[: len(probes) + self.nb2]).reshape(len(probes) + self.nb2, n, -1), 0, -1)
        prior = np.broadcast_to(np.diag(self.nudge / self.spread), (n, self.nb2, self.nb2))
        columns = np.concatenate([change[..., : len(probes)] / steps, np.zeros((n, self.nb2, len(probes)))], axis=1)
        return residual, columns, np.concatenate([change[..., len(probes) :], prior], axis=1)

    def _exact(
        self, z: Array, initial: Array, residual: Array | None, *, parameters: bool
    ) -> tuple[Array, Array, Array] | None:
        """`derivatives` by the engine; None where it does not simulate the model.

        Where MuJoCo simulates by a rule of its own, residuals are MuJoCo's, and only their slopes the engine's.
        """
        if any(term.effect.once for term in self.structure.terms):
            return None  # when a push begins and ends has no derivative in code that asks whether it acts
        n, (probes, steps) = len(initial), self._probes(z, ESTIMATION.touch) if parameters else ([], np.zeros(0))
        free = np.flatnonzero(np.isfinite(steps))
        if len(free) < len(steps):
            return None
        found = sensitivities(self.problem, self.structure, z, probes, initial)
        if found is None:
            return None
        readings, by_parameters, by_initial = found
        elsewhere = self.problem.stepping.integrator != mujoco.mjtIntegrator.mjINT_RK4
        if elsewhere and not np.isfinite(readings[self.problem.windows.valid]).all():
            return None
        if residual is None:
            residual = normalised_residual(self.problem, readings)
            if elsewhere:
                residual = self.residuals([z], initial[None])[0]
        told = self.problem.windows.valid[..., None] & np.isfinite(readings) & (np.abs(residual) < ESTIMATION.blown_up)
        slopes = np.concatenate([by_parameters, by_initial]) / self.problem.windows.noise
        # Slopes may come apart where the motion itself does not, and squares of them overflow.
        slopes = np.where(told & (np.abs(slopes) < ESTIMATION.blown_up**2), slopes, 0.0)
        change = np.moveaxis(slopes.reshape(len(slopes), n, -1), 0, -1)
        count = len(steps)
        prior = np.broadcast_to(np.diag(self.nudge / self.spread), (n, self.nb2, self.nb2))
        columns = np.concatenate([change[..., :count], np.zeros((n, self.nb2, count))], axis=1)
        return residual, columns, np.concatenate([change[..., count:] * self.nudge, prior], axis=1)

    def _probes(self, z: Array, size: float = ESTIMATION.probe) -> tuple[list[Array], Array]:
        """Parameters with one of them moved at a time, away from a bound, and by how much; infinite where it cannot."""
        steps = size * self.structure.sizes(z)
        probes = []
        for unit, step in zip(np.eye(len(z)), steps, strict=True):
            up = self.structure.clip(z + step * unit)
            probes.append(up if (up - z) @ unit > step / 2 else self.structure.clip(z - step * unit))
        moved = np.array([probe[i] - z[i] for i, probe in enumerate(probes)])
        return probes, np.where(np.abs(moved) < 1e-6 * size, np.inf, moved)

    def secant(self, columns: Array, S: Array, step: Array, moved: Array, change: Array) -> tuple[Array, Array]:
        """`columns` and `sensitivity`, corrected by what a step really changed (Broyden 1965), without a simulation.

        Args:
            columns: before the step, (n, M, p).
            S: before the step, (n, M, 2 nb).
            step: of the mapped parameters, (p,).
            moved: of the initial states, (n, 2 nb).
            change: of the residual with opposite sign, (n, m, ns).
        """
        both = np.concatenate([columns, S], axis=2)
        u = np.concatenate([np.broadcast_to(step, (len(moved), len(step))), moved / self.nudge], axis=1)
        rows = change[0].size
        wrong = change.reshape(len(u), -1) - np.einsum("nmk,nk->nm", both[:, :rows], u)
        both[:, :rows] += np.einsum("nm,nk->nmk", wrong, u / np.maximum(np.einsum("nk,nk->n", u, u), 1e-12)[:, None])
        return both[..., : len(step)], both[..., len(step) :]


def typical(mse: Array) -> float:
    """Mean square error that all but a fifth of the windows stay below, at least the noise.

    Errors are compared on this scale: below it they add up as squares do, above it as logarithms, so that a few
    windows in which something else happened decide nothing. Where no structure comes down to the noise, a median in
    its place would let a structure win on the slow half of the windows that fails wherever the motion is fast.
    """
    return max(1.0, float(np.quantile(mse, ESTIMATION.typical)))


def rms(mse: Array) -> float:
    """Root mean square error of windows, from their mean square errors (n,)."""
    return float(np.sqrt(np.mean(mse)))


def common_error(mse: Array) -> float:
    """Root mean square error of windows (n,) in which nothing else happened: a push not yet found counts little."""
    return rms(np.minimum(mse, ESTIMATION.far_out * typical(mse)))


def loss(mse: Array, scale: float) -> Array:
    """Log of the mean square error of windows, (n,), far above a scale, and a share of it below."""
    return np.log1p(mse / scale)


def mean_loss(mse: Array, scale: float) -> float:
    """Mean of the losses of windows with these mean square errors (n,)."""
    return float(np.mean(loss(mse, scale)))


def project(S: Array, rows: Array) -> tuple[Array, Array]:
    """Remove from rows (n, M, k) what the initial states can explain; also the steps of these (n, 2 nb, k) that do
    so.
    """
    Q, R = np.linalg.qr(S)
    inside = np.swapaxes(Q, 1, 2) @ rows
    return rows - Q @ inside, np.linalg.solve(R, inside)
