"""What a diagnosis is given, parted before anything is fitted: data to fit, to validate choices by, and to test with.

Test data reach the judgement alone. Whatever chooses a structure, or strikes an effect off, does so by data to fit and
to validate; so the error on test data is that of a prediction.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from numpy.typing import NDArray

from dipc_gym import mjcf, physics
from dipc_gym.mjcf.edit import Document
from dipc_gym.recording import Recording, RecordingError
from dipc_gym.sim2real.estimation import states
from dipc_gym.sim2real.estimation.problem import Problem
from dipc_gym.sim2real.estimation.segments import Prepared, prepare
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
        held_out: to test with; none where the last part of each recording is.
        model_parameters: those that a refit may change.
        notes: on recordings and masses.
    """

    source: mjcf.Source
    physics: physics.Physics
    recordings: tuple[Recording, ...]
    held_out: tuple[Recording, ...]
    model_parameters: tuple[ModelParameter, ...]
    notes: tuple[str, ...]

    @property
    def tested(self) -> tuple[Recording, ...]:
        """The recordings that hold the test data."""
        return self.held_out or self.recordings

    @property
    def test_span(self) -> tuple[float, float]:
        """The part of these that is tested with, as fractions of their duration."""
        return (0.0, 1.0) if self.held_out else (WINDOWS.test, 1.0)

    @property
    def span(self) -> tuple[float, float]:
        """The part of each recording that is fitted and validated by."""
        return 0.0, 1.0 if self.held_out else WINDOWS.test


@dataclass(frozen=True)
class Case:
    """Windows, parted.

    Attributes:
        given: what they were cut from.
        prepared: windows to fit and to validate by.
        borders: times in each recording from which windows validate and are not fitted, s, (recordings,); infinite
            where all are needed to fit, and those that are compared on have to validate as well.
        test: windows for the judgement alone.
        test_motions: of the joints in the recordings that are tested with.
    """

    given: Given
    prepared: Prepared
    borders: Array
    test: Problem
    test_motions: tuple[Motion, ...]


def gather(
    source: mjcf.Source, recordings: Sequence[Recording], held_out: Sequence[Recording], wishes: Wishes
) -> Given:
    """Load and check what is given.

    Raises:
        mjcf.MjcfError: the model cannot be treated.
        RecordingError: what is held out is fitted as well.
        ValueError: a wish names no parameter of the model.
    """
    loaded = physics.load(source)
    mjcf.check_supported(loaded.model, source.name)
    data.check_apart(recordings, held_out)
    fitted, tested = data.from_zero(recordings), data.from_zero(held_out)
    notes = [f"{r.name}: {note}" for r in (*fitted, *tested) for note in r.notes]
    parameters = model_parameters(document := Document(source), loaded.model)
    notes += fixed_masses(document, loaded.model, parameters) + left_to_mujoco(loaded)
    return Given(source, loaded, tuple(fitted), tuple(tested), tuple(wishes.apply(parameters)), tuple(notes))


def part(given: Given, *, threads: int, tell: Callable[[str], None]) -> Case:
    """Cut recordings into windows to fit, to validate by and to test with.

    Raises:
        CannotTell: no sensor changes, sensors do not determine the joints, or no joint moves.
        RecordingError: the recordings hold no window.
    """
    if not any(np.ptp(r.sensors, axis=0).any() for r in given.recordings):
        raise CannotTell("no sensor changes in any of them", IN_MOTION)
    stepping = Stepping(min(WINDOWS.coarsest, *(r.period for r in given.recordings)), mujoco.mjtIntegrator.mjINT_RK4)
    model = given.source, given.physics
    try:
        whole = prepare(*model, given.recordings, stepping, span=given.span, threads=threads)
        prepared = data.known_past(whole)
        if given.held_out:
            kept = prepare(*model, given.held_out, stepping, length=whole.length, threads=threads)
        else:
            kept = replace(whole, problem=whole.over(given.test_span))
    except states.Undetermined as error:
        raise CannotTell(error.reason, error.mend) from None
    test = data.known_past(kept).problem
    if not len(test.windows):
        raise RecordingError(
            f"{', '.join(str(r.path or r.name) for r in given.tested)}: too short to judge by; no window of "
            f"{whole.length:.3g} s begins later than {WINDOWS.late:g} s after the start: record longer"
        )
    standstill = _standstill(prepared)
    if standstill:
        raise CannotTell(standstill, IN_MOTION)
    noise = prepared.problem.windows.noise
    test = replace(test, windows=replace(test.windows, noise=noise))
    tell(f"{len(prepared.problem.windows)} windows of {prepared.length:g} s")
    return Case(given, prepared, _borders(given, prepared), test, kept.motions)


def _borders(given: Given, prepared: Prepared) -> Array:
    """Times from which windows validate; see `Case`."""
    borders = np.array([r.time[0] + WINDOWS.fit * given.span[1] * r.duration for r in given.recordings])
    windows = prepared.problem.windows
    scarce = np.sum(windows.start < borders[windows.source]) < WINDOWS.plenty
    return np.full(len(borders), np.inf) if scarce else borders


def _standstill(prepared: Prepared) -> str:
    """Why these recordings tell nothing, or an empty string."""
    positions = np.concatenate([m.position for m in prepared.motions])
    nb = positions.shape[1]
    noise = prepared.problem.spread[:nb] / 5
    still = positions.std(axis=0) < WINDOWS.still * noise
    if still.all():
        return (
            f"no joint moves by more than {WINDOWS.still:g} times the noise of its sensors, so nothing shows in these "
            "recordings that could be missing"
        )
    return ""
