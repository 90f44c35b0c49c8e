"""Which windows are fitted, which are compared on, and which are left aside: by their past, their motion, outliers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dipc_gym.recording import RecordingError
from dipc_gym.sim2real.effects.shared.settings import EFFECTS
from dipc_gym.sim2real.estimation.fit import Fit, evaluate
from dipc_gym.sim2real.estimation.problem import Problem
from dipc_gym.sim2real.estimation.segments import Prepared
from dipc_gym.sim2real.estimation.settings import ESTIMATION
from dipc_gym.sim2real.estimation.shooting import typical
from dipc_gym.sim2real.selection.settings import WINDOWS
from dipc_gym.sim2real.simulation.windows import Windows

Array = NDArray[np.float64]


def known_past(prepared: Prepared) -> Prepared:
    """Without windows at the beginning of a recording, in which commands and swings from before it may still act.

    A swinging rotor asks for more time than a late command; a short recording is cut for the command alone.
    """
    return replace(prepared, problem=prepared.problem.pick(_past_is_known(prepared)))


def moves(prepared: Prepared) -> NDArray[np.bool_]:
    """Whether any sensor changes in a window by clearly more than its noise, (n,)."""
    size = np.sqrt(np.max(np.mean(prepared.problem.moved**2, axis=1), axis=1))
    return np.asarray(size > WINDOWS.still)


def from_rest(prepared: Prepared) -> Problem:
    """Of the windows that `known_past` leaves out those of recordings that begin at rest.

    What goes with the past shows there alone what it is near nothing.
    """
    problem, half = prepared.problem, prepared.problem.initial.shape[1] // 2
    slow = ESTIMATION.at_rest * problem.spread[half:]
    rests = np.array([bool((np.abs(motion.velocity[0]) < slow).all()) for motion in prepared.motions])
    told = _since(prepared) >= prepared.structure.activated  # what an activation was before, no rest says
    return problem.pick(~_past_is_known(prepared) & rests[problem.windows.source] & told)


def _past_is_known(prepared: Prepared) -> NDArray[np.bool_]:
    """Which windows begin late enough, (n,)."""
    since, activated = _since(prepared), prepared.structure.activated
    settled = since > max(EFFECTS.swing, activated)
    return settled if settled.sum() >= WINDOWS.plenty else since > max(WINDOWS.late, activated)


def _since(prepared: Prepared) -> Array:
    """Time from the first sample of its recording to each window, s, (n,)."""
    return prepared.problem.windows.start - prepared.problem.windows.began


def split(problem: Problem) -> tuple[Problem, Problem, Problem]:
    """Windows to fit, windows to compare on (every third one), spread evenly over the recordings, and the others."""
    count, length = len(problem.windows), problem.windows.times.max(initial=0.0)
    if count < WINDOWS.fewest:
        raise RecordingError(
            f"the recordings hold {count} windows of {length:.3g} s for fitting; at least {WINDOWS.fewest} are needed: "
            "record longer"
        )
    chosen = evenly(count, WINDOWS.most)
    others = np.setdiff1d(np.arange(count), chosen)
    compared = np.s_[1 :: WINDOWS.every]
    return problem.pick(np.delete(chosen, compared)), problem.pick(chosen[compared]), problem.pick(others)


def outliers(mse: Array, others: Array | None = None) -> NDArray[np.intp]:
    """Windows that are predicted far worse than most (of others, if given), by mean square errors, the worst first."""
    worst = np.argsort(-mse)[: WINDOWS.outliers]
    return worst[mse[worst] > ESTIMATION.far_out * typical(mse if others is None else others)]


def outliers_aside(aside: Problem, recalibrated: Fit) -> NDArray[np.intp]:
    """Windows, of those left aside, in which something happened that the others do not show: a push, a knock."""
    if not len(aside.windows):
        return np.zeros(0, dtype=np.intp)
    mse = evaluate(aside, recalibrated.structure, recalibrated.z)
    return outliers(mse, recalibrated.mse)


def eventful(windows: Windows, mse: Array, aside: Windows, aside_mse: Array) -> NDArray[np.bool_]:
    """Which windows of those left aside are outliers or beside one that is, (n,); those tell when it began and ended.

    Args:
        windows: that are fitted.
        mse: how well they are predicted.
        aside: windows left aside.
        aside_mse: how well these are predicted, (n,).
    """
    far = ESTIMATION.far_out * typical(mse)
    if not 0 < np.sum(mse > far) + np.sum(aside_mse > far) <= WINDOWS.outliers:
        return np.zeros(len(aside), dtype=bool)
    fitted, left = outliers(mse), outliers(aside_mse, mse)
    start = np.append(windows.start[fitted], aside.start[left])
    source = np.append(windows.source[fitted], aside.source[left])
    return np.asarray((_beside(aside, start) & (aside.source[:, None] == source)).any(axis=1))


def echoes(windows: Windows, mse: Array, others: Windows) -> NDArray[np.bool_]:
    """Which windows are those of another recording at the time of an outlier, (n,).

    Each recording has a clock of its own. An event happened in one of them alone, at a time that says nothing of the
    others; they would refute it.

    Args:
        windows: of all recordings, the outliers among them.
        mse: how well they are predicted, (m,); the outliers are told by it.
        others: windows that are asked for, (n,), these or others.
    """
    far = mse > ESTIMATION.far_out * typical(mse)
    if far.sum() > WINDOWS.outliers:  # no event
        return np.zeros(len(others), dtype=bool)
    elsewhere = others.source[:, None] != windows.source[far]
    itself = (others.start[:, None] == windows.start[far]) & ~elsewhere
    return np.asarray((_beside(others, windows.start[far]) & elsewhere).any(axis=1) & ~itself.any(axis=1))


def _beside(windows: Windows, start: Array) -> NDArray[np.bool_]:
    """Which windows are at, or next to, those that begin at `start` (k,) on whichever clock, (n, k)."""
    return np.asarray(np.abs(windows.start[:, None] - start) < windows.times.max(initial=0.0) + WINDOWS.apart)


def evenly(count: int, most: int) -> NDArray[np.intp]:
    """Numbers of at most so many out of a count, spread evenly from the first to the last.

    Example:
        >>> evenly(10, 4).tolist()
        [0, 3, 6, 9]
    """
    return np.unique(np.linspace(0, count - 1, min(most, count)).round().astype(np.intp))
