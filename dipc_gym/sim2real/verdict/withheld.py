"""What a diagnosis is given, parted before anything is looked at: data to fit and to validate by, and test data.

Test data reach the judgement alone. Noise, motion and windows of all other stages come from recordings that end where
the test begins, so the error on test data is that of a prediction. This room stands above those stages: none of them
can import what is withheld from it.
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

from dipc_gym import mjcf, physics
from dipc_gym.mjcf.edit import Document
from dipc_gym.recording import Recording, RecordingError
from dipc_gym.recording.checks import slowly
from dipc_gym.recording.clock import clocked
from dipc_gym.recording.degrees import IN_PYTHON, refuse_odd_units
from dipc_gym.recording.glitches import without_glitches
from dipc_gym.recording.parts import check_apart, going_on, until
from dipc_gym.sim2real.estimation import states
from dipc_gym.sim2real.estimation.problem import Problem
from dipc_gym.sim2real.estimation.segments import prepare
from dipc_gym.sim2real.model.parameters import Wishes, fixed_masses, in_full, model_parameters
from dipc_gym.sim2real.selection import partitioning
from dipc_gym.sim2real.selection.case import CannotTell, Case, Given
from dipc_gym.sim2real.selection.settings import WINDOWS
from dipc_gym.sim2real.simulation.compiled import left_to_mujoco
from dipc_gym.sim2real.simulation.motion import Motion


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

    @property
    def ends(self) -> bool:
        """Whether they are the ends of the recordings that are fitted, and none of their own."""
        return self.span[0] > 0


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
        problem = partitioning.known_past(kept).problem
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
    source, loaded = in_full(source, loaded)
    check_apart(recordings, held_out)
    refuse_odd_units([*recordings, *held_out], loaded.model, mend=IN_PYTHON)
    tested = without_glitches(clocked(held_out), loaded.model)
    # What is tested with says nothing of what is fitted, not even which of its samples are glitches, or its clock.
    whole = clocked(recordings, until=1.0 if tested else WINDOWS.test)
    fitted = without_glitches(whole if tested else [until(r, WINDOWS.test) for r in whole], loaded.model)
    if not tested:
        whole = [going_on(one, r) for one, r in zip(fitted, without_glitches(whole, loaded.model), strict=True)]
    withheld = Withheld(tuple(tested or whole), (0.0 if tested else WINDOWS.test, 1.0))
    noted = [*fitted, *tested] if tested else whole
    notes = [f"{r.name}: {note}" for r in noted for note in r.notes] + slowly(noted)
    parameters = model_parameters(document := Document(source), loaded.model)
    notes += fixed_masses(document, loaded.model, parameters) + left_to_mujoco(loaded)
    with contextlib.suppress(states.Undetermined):  # then nothing can be told, and that is said in time
        notes += states.integrated(loaded)
    return Given(source, loaded, tuple(fitted), tuple(wishes.apply(parameters)), tuple(notes)), withheld
