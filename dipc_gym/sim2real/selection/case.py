"""What a diagnosis is given, parted before anything is looked at: data to fit, to validate by, and to test with.

Test data stand apart from the beginning, and reach the judgement alone. Noise, motion and windows of all other stages
come from recordings that end where the test begins, so the error on test data is that of a prediction.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import mujoco
import numpy as np
from numpy.typing import NDArray

from dipc_gym import mjcf, physics
from dipc_gym.mjcf.edit import Document
from dipc_gym.recording import Recording, RecordingError
from dipc_gym.recording.degrees import IN_PYTHON, refuse_degrees
from dipc_gym.sim2real.estimation import states
from dipc_gym.sim2real.estimation.problem import Problem
from dipc_gym.sim2real.estimation.segments import Prepared, prepare
from dipc_gym.sim2real.estimation.settings import ESTIMATION
from dipc_gym.sim2real.model.parameters import ModelParameter, Wishes, fixed_masses, model_parameters
from dipc_gym.sim2real.selection import data
from dipc_gym.sim2real.selection.settings import WINDOWS
from dipc_gym.sim2real.simulation.batch import Stepping
from dipc_gym.sim2real.simulation.compiled import left_to_mujoco
from dipc_gym.sim2real.simulation.motion import Motion

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
        borders: times in each recording from which windows validate and are not fitted, s, (recordings,); infinite
            where all are needed to fit, and those that are compared on have to validate as well.
    """

    given: Given
    prepared: Prepared
    borders: Array


@dataclass(frozen=True)
class Test:
    """Windows that nothing is fitted to or chosen by.

    Attributes:
        problem: the windows.
        recordings: that hold them.
        motions: of the joints in these.
        span: the part of each recording that is tested with, as fractions of its duration.
    """

    __test__: ClassVar[bool] = False  # no test of pytest's

    problem: Problem
    recordings: tuple[Recording, ...]
    motions: tuple[Motion, ...]
    span: tuple[float, float]


@dataclass(frozen=True)
class Withheld:
    """What is tested with: recordings of their own, or the last part of each that is fitted.

    Attributes:
        recordings: whole, for how a window begins depends on all that was before it.
        span: see `Test`.
    """

    recordings: tuple[Recording, ...]
    span: tuple[float, float]

    def test(self, case: Case) -> Test:
        """Windows as long as those that are fitted, weighed by the same noise.

        Raises:
            CannotTell: the sensors do not say where the joints are.
            RecordingError: the recordings hold no window.
        """
        given, fitted = case.given, case.prepared
        stepping, threads = fitted.problem.stepping, fitted.problem.threads
        try:
            kept = prepare(
                given.source,
                given.physics,
                self.recordings,
                stepping,
                length=fitted.length,
                span=self.span,
                threads=threads,
            )
        except states.Undetermined as error:
            raise CannotTell(error.reason, error.mend) from None
        problem = data.known_past(kept).problem
        if not len(problem.windows):
            raise RecordingError(
                f"{', '.join(str(r.path or r.name) for r in self.recordings)}: too short to judge by; no window of "
                f"{fitted.length:.3g} s begins later than {WINDOWS.late:g} s after the start: record longer"
            )
        noise = fitted.problem.windows.noise
        return Test(
            replace(problem, windows=replace(problem.windows, noise=noise)), self.recordings, kept.motions, self.span
        )


def gather(
    source: mjcf.Source, recordings: Sequence[Recording], held_out: Sequence[Recording], wishes: Wishes
) -> tuple[Given, Withheld]:
    """Load and check what is given, and part what is tested with from all the rest.

    Raises:
        mjcf.MjcfError: the model cannot be treated.
        RecordingError: what is held out is fitted as well, or angles look like degrees and no unit was told.
        ValueError: a wish names no parameter of the model.
    """
    loaded = physics.load(source)
    mjcf.check_supported(loaded.model, source.name)
    data.check_apart(recordings, held_out)
    refuse_degrees([*recordings, *held_out], loaded.model, mend=IN_PYTHON)
    whole, tested = data.from_zero(recordings), data.from_zero(held_out)
    notes = [f"{r.name}: {note}" for r in (*whole, *tested) for note in r.notes] + data.slowly([*whole, *tested])
    fitted = whole if tested else [data.until(r, WINDOWS.test) for r in whole]
    withheld = Withheld(tuple(tested or whole), (0.0 if tested else WINDOWS.test, 1.0))
    parameters = model_parameters(document := Document(source), loaded.model)
    notes += fixed_masses(document, loaded.model, parameters) + left_to_mujoco(loaded)
    return Given(source, loaded, tuple(fitted), tuple(wishes.apply(parameters)), tuple(notes)), withheld


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
        prepared = data.known_past(prepare(given.source, given.physics, given.recordings, stepping, threads=threads))
    except states.Undetermined as error:
        raise CannotTell(error.reason, error.mend) from None
    standstill = _standstill(prepared)
    if standstill:
        raise CannotTell(standstill, IN_MOTION)
    return Case(given, prepared, _borders(given, prepared))


def _borders(given: Given, prepared: Prepared) -> Array:
    """Times from which windows validate; see `Case`."""
    borders = np.array([r.time[0] + WINDOWS.fit * r.duration for r in given.recordings])
    windows = prepared.problem.windows
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
