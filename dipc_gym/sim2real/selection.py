"""Which windows of the recordings are fitted, which are compared on, and which are left aside."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dipc_gym.sim2real.fit import Fit, evaluate
from dipc_gym.sim2real.problem import Problem
from dipc_gym.sim2real.recording import Recording, RecordingError
from dipc_gym.sim2real.shooting import typical
from dipc_gym.sim2real.windows import Prepared

WINDOWS = 72  # fitted and compared on, two thirds and one third; more say little more
ODD = 6  # windows left aside that are fitted after all
FAR_OUT = 4.0  # times the usual square error, from which they are
PAST = 0.05  # s before a window whose commands must be known: they may act late


def from_zero(recordings: Sequence[Recording]) -> list[Recording]:
    """Recordings with their time counted from their first samples: what shakes or pushes the rig has no other clock."""
    return [
        r
        if r.time[0] == 0
        else replace(
            r,
            time=r.time - r.time[0],
            notes=(*r.notes, f"its clock begins at {r.time[0]:.10g} s; times are counted from there"),
        )
        for r in recordings
    ]


def known_past(prepared: Prepared) -> Prepared:
    """Without windows at the beginning of a recording: where there is a delay, commands before it matter."""
    w = prepared.problem.windows
    began = np.array([recording.time[0] for recording in w.recordings])
    return replace(prepared, problem=prepared.problem.pick(w.start - began[w.source] > PAST))


def split(problem: Problem) -> tuple[Problem, Problem, Problem]:
    """Windows to fit, windows to compare on (every third one), spread evenly over the recordings, and the others."""
    count, length = len(problem.windows), problem.windows.times.max(initial=0.0)
    if count < 9:
        raise RecordingError(
            f"the recordings hold {count} windows of {length:.3g} s for fitting; at least 9 are needed: record longer"
        )
    chosen = np.unique(np.linspace(0, count - 1, min(WINDOWS, count)).round().astype(np.intp))
    others = np.setdiff1d(np.arange(count), chosen)
    return problem.pick(np.delete(chosen, np.s_[1::3])), problem.pick(chosen[1::3]), problem.pick(others)


def odd(rest: Problem, recalibrated: Fit) -> Problem:
    """Windows, of those left aside, in which something happened that the others do not show: a push, a knock."""
    if not len(rest.windows):
        return rest
    mse, _ = evaluate(rest, recalibrated.structure, recalibrated.z)
    return rest.pick(np.argsort(-mse)[:ODD][np.sort(mse)[::-1][:ODD] > FAR_OUT * typical(recalibrated.mse)])


def without_echoes(problem: Problem, unseen: Problem, recalibrated: Fit) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Which windows to keep, of either kind: all but those of other recordings at the time of odd ones.

    Each recording has a clock of its own. What happened once happened in one of them, and an effect that has a time
    would be held against the others.

    Args:
        problem: windows that are fitted.
        unseen: windows that are compared on.
        recalibrated: fitted to `problem`; told apart by it.
    """
    mse = np.append(recalibrated.mse, evaluate(unseen, recalibrated.structure, recalibrated.z)[0])
    far = mse > FAR_OUT * typical(recalibrated.mse)
    windows = problem.windows.join(unseen.windows)
    close = np.abs(windows.start[:, None] - windows.start[far]) < windows.times.max() + PAST
    elsewhere = windows.source[:, None] != windows.source[far]
    keep = far | ~(close & elsewhere).any(axis=1)
    if far.sum() > ODD:  # no event
        keep[:] = True
    count = len(problem.windows)
    return np.flatnonzero(keep[:count]), np.flatnonzero(keep[count:])


def odd_times(problem: Problem, fitted: Fit) -> list[float]:
    """Times at which fitted windows begin that are far worse than most, the worst first."""
    worst = np.argsort(-fitted.mse)[:ODD]
    far = worst[fitted.mse[worst] > FAR_OUT * typical(fitted.mse)]
    return [float(start) for start in problem.windows.start[far]]
