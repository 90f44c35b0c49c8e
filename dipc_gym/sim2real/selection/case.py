"""What a search is given: a model, and recordings cut into windows to fit and to validate by.

Test data stand apart from the beginning (`verdict.withheld`): recordings end here where the test begins.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from dipc_gym import mjcf, physics
from dipc_gym.recording import Recording
from dipc_gym.sim2real.estimation import states
from dipc_gym.sim2real.estimation.problem import Problem
from dipc_gym.sim2real.estimation.segments import Prepared, prepare
from dipc_gym.sim2real.estimation.settings import ESTIMATION
from dipc_gym.sim2real.model.parameters import ModelParameter
from dipc_gym.sim2real.selection import partitioning
from dipc_gym.sim2real.selection.settings import WINDOWS
from dipc_gym.sim2real.simulation.batch import Stepping

Array = NDArray[np.float64]

IN_MOTION = "Record the rig in motion, over the range and speeds that it is used at, every joint sensed."


class CannotTell(Exception):
    """Recordings that cannot tell what a model lacks.

    Attributes:
        reason: why, in words.
        mend: what to do, as a sentence.
    """

    def __init__(self, reason: str, mend: str) -> None:
        super().__init__(reason)
        self.reason, self.mend = reason, mend


@dataclass(frozen=True)
class Given:
    """A model and recordings, before anything is worked out.

    Attributes:
        source: text of the model.
        physics: the same, loaded.
        recordings: to fit and to validate, times counted from zero.
        model_parameters: those that a refit may change.
        notes: on recordings and masses.
    """

    source: mjcf.Source
    physics: physics.Physics
    recordings: tuple[Recording, ...]
    model_parameters: tuple[ModelParameter, ...]
    notes: tuple[str, ...]


@dataclass(frozen=True)
class Case:
    """Windows, parted.

    Attributes:
        given: what they were cut from.
        prepared: windows to fit and to validate by.
        first: windows at the beginnings of recordings that begin at rest, before those.
        borders: times in each recording from which windows validate and are not fitted, s, (recordings,); infinite
            where all are needed to fit, and those that are compared on have to validate as well.
    """

    given: Given
    prepared: Prepared
    first: Problem
    borders: Array


def part(given: Given, *, threads: int) -> Case:
    """Cut recordings into windows to fit and to validate by.

    Raises:
        CannotTell: no sensor changes, sensors do not determine the joints, or no joint moves.
        RecordingError: the recordings hold no window.
    """
    if not any(np.ptp(r.sensors, axis=0).any() for r in given.recordings):
        raise CannotTell("no sensor changes in any of them", IN_MOTION)
    stepping = Stepping(min(WINDOWS.coarsest, *(r.period for r in given.recordings)), mujoco.mjtIntegrator.mjINT_RK4)
    try:
        whole = prepare(given.source, given.physics, given.recordings, stepping, threads=threads)
    except states.Undetermined as error:
        raise CannotTell(error.reason, error.mend) from None
    prepared = partitioning.known_past(whole)
    standstill = _standstill(prepared)
    if standstill:
        raise CannotTell(standstill, IN_MOTION)
    return Case(given, prepared, partitioning.from_rest(whole), _borders(given, prepared))


def _borders(given: Given, prepared: Prepared) -> Array:
    """Times from which windows validate; see `Case`.

    A recording that rests for a part is divided by its motion: windows that stand still are predicted by any model, and
    an end at rest would validate whatever was fitted.
    """
    borders = np.array([r.time[0] + WINDOWS.fit * r.duration for r in given.recordings])
    windows = prepared.problem.windows
    moves = partitioning.moves(prepared)
    for i in np.unique(windows.source[~moves]):
        moving = np.sort(windows.start[moves & (windows.source == i)])
        if len(moving):
            borders[i] = moving[int(WINDOWS.fit * len(moving))]
    scarce = np.sum(windows.start < borders[windows.source]) < WINDOWS.plenty
    return np.full(len(borders), np.inf) if scarce else borders


def _standstill(prepared: Prepared) -> str:
    """Why these recordings tell nothing, or an empty string."""
    positions = np.concatenate([m.position for m in prepared.motions])
    nb = positions.shape[1]
    noise = prepared.problem.spread[:nb] / ESTIMATION.loose
    still = positions.std(axis=0) < WINDOWS.still * noise
    if still.all():
        return (
            f"no joint moves by more than {WINDOWS.still:g} times the noise of its sensors, so nothing shows in these "
            "recordings that could be missing"
        )
    return ""
