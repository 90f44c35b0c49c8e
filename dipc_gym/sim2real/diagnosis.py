"""Diagnose a model against recordings: what was left out, where, and how much better it predicts with it."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from dipc_gym import mjcf
from dipc_gym.provenance import made_with
from dipc_gym.recording import Recording
from dipc_gym.sim2real.allocation import give_back_freed
from dipc_gym.sim2real.design import propose
from dipc_gym.sim2real.effects import Effect, catalogue
from dipc_gym.sim2real.estimation import unexplained
from dipc_gym.sim2real.estimation.fit import Fit, fit
from dipc_gym.sim2real.model.parameters import Wishes
from dipc_gym.sim2real.result import Design, Diagnosis, Located
from dipc_gym.sim2real.selection.baseline import Baseline, baseline
from dipc_gym.sim2real.selection.case import CannotTell, Case, Given, part
from dipc_gym.sim2real.selection.hypotheses import Question
from dipc_gym.sim2real.selection.progress import Journal, Progress
from dipc_gym.sim2real.selection.scorer import Scorer
from dipc_gym.sim2real.selection.search import Search, Searched
from dipc_gym.sim2real.selection.settings import SCORE
from dipc_gym.sim2real.selection.stop import Stop
from dipc_gym.sim2real.stages import StageEnd
from dipc_gym.sim2real.verdict import conventions, location, sentences, word
from dipc_gym.sim2real.verdict.conclude import Conclusion, conclude
from dipc_gym.sim2real.verdict.guarded import Guarded
from dipc_gym.sim2real.verdict.judgement import files_of, judgement
from dipc_gym.sim2real.verdict.settings import CONVENTIONS
from dipc_gym.sim2real.verdict.withheld import Withheld, gather


def diagnose(
    model: str | Path | mjcf.Source,
    recordings: Sequence[Recording],
    held_out: Sequence[Recording] = (),
    *,
    wishes: Wishes | None = None,
    effects: Sequence[Effect] | None = None,
    design: bool = False,
    seed: int = 0,
    threads: int = 0,
    tell: Callable[[str], None] = lambda line: None,
) -> Diagnosis:
    """Find what a model lacks.

    Args:
        model: MJCF file or scanned source.
        recordings: of the real thing, read with this model (`recording.read`).
        held_out: recordings to test with; without any, the last quarter of each recording is.
        wishes: what the owner knows.
        effects: the catalogue, or part of it.
        design: whether to work out the command that the next experiment should send.
        seed: of the phases of that command; of the diagnosis itself nothing is drawn at random.
        threads: of the simulations; 0 for all cores.
        tell: called with lines about progress.

    Raises:
        mjcf.MjcfError: the model cannot be treated.
        RecordingError: the recordings hold no window, what is held out is fitted as well, or angles look like degrees
            and no unit was told.
        ValueError: a wish names no parameter of the model, a design is asked for and there is no actuator, or the seed
            is below 0.
        TypeError: one of the effects is none, such as its name alone.

    Example:
        >>> from dipc_gym import recording
        >>> model = mjcf.compile("cart.xml")                                    # doctest: +SKIP
        >>> found = diagnose("cart.xml", [recording.read("run.csv", model)])    # doctest: +SKIP
        >>> print(found.sentence)                                               # doctest: +SKIP

    Note:
        With more than one thread, parts of the search run in forks of this process; start threads of your own, and
        CUDA, afterwards. From then on the C library maps large arrays of this process apart from its heap
        (`mallopt(3)`), so that they go back to the system when they are gone.
    """
    if seed < 0:
        raise ValueError(f"seed is {seed}; it must be a whole number from 0 on")
    asked = list(effects if effects is not None else catalogue().values())
    for one in asked:
        if not isinstance(one, Effect):  # whoever passes names would be told, minutes later, that nothing was found
            raise TypeError(f"effects holds {one!r}, which is no effect: take catalogue()[...] of each name")
    began = time.monotonic()
    source = model if isinstance(model, mjcf.Source) else mjcf.read(model)
    given, withheld = gather(source, recordings, held_out, wishes or Wishes())
    if design and not given.recordings[0].actuator_names:
        raise ValueError("the rig has no actuator that could be commanded")
    for note in given.notes:  # minutes before the end: whoever made a mistake would rather know at once
        tell(f"note: {note}")
    provenance = _provenance(source, given, withheld, seed)
    give_back_freed()
    # Thousands of small matrices: threads of BLAS would wait for each other, and for those that simulate.
    with threadpool_limits(1, "blas"):
        try:
            found = _found(given, withheld, asked, seed if design else None, threads, tell)
        except CannotTell as why:
            return _cannot_tell(why, given, provenance)
    return replace(found, provenance={**provenance, "seconds": round(time.monotonic() - began, 1)})


def _found(
    given: Given,
    withheld: Withheld,
    effects: Sequence[Effect],
    design: int | None,
    threads: int,
    tell: Callable[[str], None],
) -> Diagnosis:
    """What a model lacks, but for where that comes from.

    Args:
        given: model and recordings.
        withheld: what is tested with.
        effects: the catalogue, or part of it.
        design: seed of the command that the next experiment should send; None if it is not to be worked out.
        threads: of the simulations; 0 for all cores.
        tell: called with lines about progress.

    Raises:
        CannotTell: the recordings do not say.
    """
    guarded = Guarded(Stop(tell))
    case = part(given, threads=threads)
    test = withheld.test(case)
    tell(f"{len(case.prepared.problem.windows)} windows of {case.prepared.length:g} s")
    base = baseline(case)
    _check_conventions(case, base, tell)
    base, searched, located = _search(case, base, effects, guarded)
    searched, concluded = _conclude(searched, guarded)
    judged, concluded = judgement(case, base, test, searched, concluded, located, guarded)
    proposed: Design | None = None
    if design is not None:
        proposed = guarded("The next experiment", lambda: _design(case, base, concluded, design), lambda: None)
    first = [sentences.own_step(given.physics.model.opt.timestep, base.fine)] if base.fine is not None else []
    return replace(judged, notes=(*given.notes, *first, *judged.notes, *guarded.notes), design=proposed)


def _search(
    case: Case, base: Baseline, effects: Sequence[Effect], guarded: Guarded
) -> tuple[Baseline, Searched, Sequence[Located]]:
    """What a search comes to, also where Ctrl-C or an error ended it, and where the mismatch sits.

    Where what it finds shows that MuJoCo made the recordings, it goes on in the steps that MuJoCo took.
    """
    search, located = begin_search(case, base, effects, guarded.stop)
    guarded("Whether more is missing", search.run, lambda: base.recalibrated)
    found, so_far = search.simulated, (base, search.outcome, located)
    if found is None or guarded.stop.asked:
        return so_far
    guarded.stop.tell(f"note: {sentences.own_step(case.given.physics.model.opt.timestep, found.error)}")

    def in_its_steps() -> tuple[Baseline, Searched, Sequence[Located]]:
        own = baseline(case, found.error)
        again, where = begin_search(case, own, effects, guarded.stop)
        again.carry_over(found, search.progress.rounds)
        again.run()
        return own, again.outcome, where

    return guarded("What was found, in the steps of a simulation,", in_its_steps, lambda: so_far)


def _conclude(searched: Searched, guarded: Guarded) -> tuple[Searched, Conclusion]:
    """What is left of a search; after an error all that it found, unasked what could stand in for it."""
    return guarded(
        "What could stand in for the effects",
        lambda: conclude(searched),
        lambda: (searched, Conclusion(searched.progress.current)),
    )


def _design(case: Case, base: Baseline, concluded: Conclusion, seed: int) -> Design:
    """The command that tells the chosen structure from rivals that are still open; where nothing was chosen, the
    recalibrated one stands for it.
    """
    likeliest = concluded.fitted if len(concluded.fitted.z) else base.recalibrated
    open_ = [rival.fitted for rivals in concluded.rivals.values() for rival in rivals if not rival.ruled_out]
    prepared = case.prepared
    return propose(
        [(fitted.structure, fitted.z) for fitted in (likeliest, *open_)],
        prepared.problem,
        case.given.recordings,
        prepared.motions,
        seed=seed,
    )


def _check_conventions(case: Case, base: Baseline, tell: Callable[[str], None]) -> None:
    """Stop where recordings seem to count otherwise than the model.

    Raises:
        CannotTell: they do.
    """
    nominal, recalibrated, given = base.nominal, base.recalibrated, case.given
    if base.fine is not None:
        tell(f"note: {sentences.own_step(given.physics.model.opt.timestep, base.fine)}")
    said = f"as given, the model is off by {nominal.error:.3g} x noise; recalibrated, by {recalibrated.error:.3g}"
    tell(StageEnd(said, "baseline"))
    if recalibrated.error > SCORE.at_floor:
        others, off = conventions.differing(
            given.source,
            given.physics,
            given.recordings,
            case.prepared,
            [nominal, recalibrated],
            gross=recalibrated.error > CONVENTIONS.gross * base.partition.problem.motion,
        )
        if others:
            raise CannotTell(*sentences.conventions(others, nominal.error, off))


def begin_search(case: Case, base: Baseline, effects: Sequence[Effect], stop: Stop) -> tuple[Search, list[Located]]:
    """A search that has not begun, and where the mismatch sits."""
    given, partition, recalibrated = case.given, base.partition, base.recalibrated

    seen: list[tuple[Fit, unexplained.Scene]] = []

    def look(fitted: Fit, outliers: Sequence[float] = ()) -> unexplained.Scene:
        scene = next((scene for one, scene in seen if one is fitted), None)
        if scene is None:
            physics = fitted.structure.physics(fitted.z)
            scene = unexplained.scene(physics, given.recordings, case.prepared.motions)
            seen[:] = [*seen[-3:], (fitted, scene)]  # every round asks for those of the last few
        return replace(scene, outliers=tuple(outliers))

    question = Question(effects, case.prepared.structure.base, look)
    nominal = np.zeros(len(given.model_parameters))
    anchor = fit(partition.problem, recalibrated.structure, nominal, base.nominal.initial, most=0)
    scorer = Scorer(partition)
    worst = scorer.comparison_error(recalibrated)
    located = location.locate(look(recalibrated), question.joints)
    small = worst > SCORE.at_floor and word.negligible(worst, partition.problem.motion, located[0])
    if small:
        stop.tell("the mismatch is small beside the motion, without a pattern: only what explains all of it will count")
    journal = Journal(Progress(partition, (recalibrated,), anchor), stop.tell)
    return Search(question, replace(scorer, small=small), journal, stop, asks_whence=True), located


def _cannot_tell(why: CannotTell, given: Given, provenance: dict[str, Any]) -> Diagnosis:
    return Diagnosis(
        "cannot tell",
        f"These recordings cannot tell: {why.reason}.",
        next_experiment=why.mend,
        improved=given.source.text,
        files=files_of(given.source, given.source.text),
        notes=given.notes,
        provenance=provenance,
    )


def _provenance(source: mjcf.Source, given: Given, withheld: Withheld, seed: int) -> dict[str, Any]:
    inputs = {str(source.path.name if source.path else "model"): source.sha256}
    for recording in (*given.recordings, *withheld.recordings):
        label, digest = str(recording.path or recording.name), recording.sha256
        names = itertools.chain([label], (f"{label} ({k})" for k in itertools.count(2)))  # some in memory share one
        inputs[next(name for name in names if inputs.get(name, digest) == digest)] = digest
    step = given.physics.model.opt.timestep
    return made_with("mujoco", "numpy", "scipy", timestep=step, inputs=inputs, seed=seed)
