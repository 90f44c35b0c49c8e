"""Diagnose a model against recordings: what was left out, where, and how much better it predicts with it."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from dipc_gym import mjcf, physics
from dipc_gym.sim2real import conventions, evidence, findings, improve, judge, selection, sentences, states
from dipc_gym.sim2real.compiled import left_to_mujoco
from dipc_gym.sim2real.conclusion import conclude
from dipc_gym.sim2real.document import Document
from dipc_gym.sim2real.effects import Effect, catalogue
from dipc_gym.sim2real.fit import Fit, fit
from dipc_gym.sim2real.numbers import Number, fixed_masses, own_numbers
from dipc_gym.sim2real.problem import Problem
from dipc_gym.sim2real.recording import Recording, RecordingError
from dipc_gym.sim2real.result import Diagnosis, Errors, Work
from dipc_gym.sim2real.search import Search
from dipc_gym.sim2real.simulate import Stepping
from dipc_gym.sim2real.windows import Prepared, prepare

Array = NDArray[np.float64]

TRAIN = 0.75  # of each recording is fitted where none is held out
COARSEST = 2e-3  # s; longest step of the analysis
STILL = 10.0  # times its noise: a joint that moves less tells nothing
IN_MOTION = "Record the rig in motion, over the range and speeds that it is used at, every joint sensed."


@dataclass(frozen=True)
class Wishes:
    """What the owner of a rig knows.

    Attributes:
        fix: own numbers that are right, as `cart.mass`.
        prior: own numbers with mean and standard deviation.
    """

    fix: tuple[str, ...] = ()
    prior: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    def apply(self, numbers: Sequence[Number]) -> list[Number]:
        """The numbers that are free, with their priors.

        Raises:
            ValueError: a name that is no number of the model.
        """
        known = [n.key for n in numbers]
        for key in (*self.fix, *self.prior):
            if key not in known:
                raise ValueError(f"--fix or --prior {key!r}: the model's numbers are {', '.join(known)}")
        out = []
        for number in numbers:
            if number.key in self.fix:
                continue
            if number.key in self.prior:
                mean, spread = self.prior[number.key]
                if not (0 < mean < math.inf and 0 < spread < math.inf):
                    raise ValueError(f"--prior {number.key}: mean and spread must be positive and finite")
                # Of the log-normal distribution with this mean and spread, whose reach stays finite.
                number = replace(number, sigma=math.sqrt(math.log1p((spread / mean) ** 2)), expected=mean)
            out.append(number)
        return out


def diagnose(
    model: str | Path | mjcf.Source,
    recordings: Sequence[Recording],
    held_out: Sequence[Recording] = (),
    *,
    wishes: Wishes | None = None,
    effects: Sequence[Effect] | None = None,
    seed: int = 0,
    threads: int = 0,
    tell: Callable[[str], None] = lambda line: None,
) -> Diagnosis:
    """Find what a model lacks.

    Args:
        model: MJCF file or scanned source.
        recordings: of the real thing, read with this model (`recording.read`).
        held_out: recordings for judging only; without any, the last quarter of each recording is held out.
        wishes: what the owner knows.
        effects: the catalogue, or part of it.
        seed: kept in the provenance; nothing here is drawn at random.
        threads: of the simulations; 0 for all cores.
        tell: called with lines about progress.

    Raises:
        mjcf.MjcfError: the model cannot be treated.
        RecordingError: the recordings hold no window, or what is held out is fitted as well.
        ValueError: a wish names no number of the model.

    Example:
        >>> from dipc_gym.sim2real import recording
        >>> model = mjcf.compile("cart.xml")                                    # doctest: +SKIP
        >>> found = diagnose("cart.xml", [recording.read("run.csv", model)])    # doctest: +SKIP
        >>> print(found.sentence)                                               # doctest: +SKIP
    """
    began = time.monotonic()
    source = model if isinstance(model, mjcf.Source) else mjcf.read(model)
    given = physics.load(source)
    mjcf.check_supported(given.model, source.name)
    selection.check_apart(recordings, held_out)
    recordings, held_out = selection.from_zero(recordings), selection.from_zero(held_out)
    notes = [note for r in (*recordings, *held_out) for note in (f"{r.name}: {n}" for n in r.notes)]
    for note in notes:  # whoever gave degrees for radians would rather know at once
        tell(f"note: {note}")
    provenance = _provenance(source, [*recordings, *held_out], given.model, seed)
    span = (0.0, 1.0) if held_out else (0.0, TRAIN)
    step = min(COARSEST, *(r.period for r in recordings))
    stepping = Stepping(step, mujoco.mjtIntegrator.mjINT_RK4)
    numbers = own_numbers(document := Document(source), given.model)
    notes += fixed_masses(document, given.model, numbers) + left_to_mujoco(given)
    numbers = (wishes or Wishes()).apply(numbers)
    if not any(np.ptp(r.sensors, axis=0).any() for r in recordings):
        return _cannot_tell("no sensor changes in any of them", IN_MOTION, source, notes, provenance)
    try:
        prepared = selection.known_past(prepare(source, given, recordings, stepping, span=span, threads=threads))
        judged, judged_span = (held_out, (0.0, 1.0)) if held_out else (recordings, (TRAIN, 1.0))
        kept = selection.known_past(
            prepare(source, given, judged, stepping, length=prepared.length, span=judged_span, threads=threads)
        )
        if not len(kept.problem.windows):
            raise RecordingError(
                f"{', '.join(str(r.path or r.name) for r in judged)}: too short to judge by; no window of "
                f"{prepared.length:.3g} s begins later than {selection.LATE:g} s after the start: record longer"
            )
    except states.Undetermined as error:
        return _cannot_tell(error.reason, error.mend, source, notes, provenance)
    quiet = _quiet(prepared)
    if quiet:
        return _cannot_tell(quiet, IN_MOTION, source, notes, provenance)
    held = replace(kept.problem, windows=replace(kept.problem.windows, noise=prepared.problem.windows.noise))
    tell(f"{len(prepared.problem.windows)} windows of {prepared.length:g} s")
    base = _baseline(prepared, held, Stepping(given.model.opt.timestep), numbers)
    if base.own_step:
        notes.append(base.own_step)
        tell(f"note: {base.own_step}")
    nominal, recalibrated = base.nominal, base.recalibrated
    tell(f"as given, the model is off by {nominal.error:.3g} x noise; recalibrated, by {recalibrated.error:.3g}")
    if recalibrated.error > conventions.GROSS * _motion(base.problem):
        others, off = conventions.differing(source, given, recordings, prepared, [nominal, recalibrated], span)
        if others:
            return _cannot_tell(*sentences.conventions(others, nominal.error, off), source, notes, provenance)
    search = Search(
        base.problem,
        base.unseen,
        base.rest,
        base.held,
        list(effects if effects is not None else catalogue().values()),
        prepared.structure.base,
        lambda f, odd=(): evidence.scene(f.structure.physics(f.z), recordings, prepared.motions, span[1], odd),
        anchor=fit(base.problem, recalibrated.structure, np.zeros(len(numbers)), nominal.starts, most=0),
        tell=tell,
    )
    worst = judge.unseen_error(search, recalibrated)
    located = judge.locate(search.look(recalibrated), prepared.structure.base)
    motion = _motion(base.held)
    search.small = worst > judge.AT_FLOOR and judge.negligible(worst, motion, located[0])
    if search.small:
        tell("the mismatch is small beside the motion, and without a pattern: only what explains all of it will count")
    search.run(recalibrated)
    found = conclude(search)

    open_choice = findings.choice_shift(found.fitted, found.others)
    final, held = found.fitted, base.held
    if not base.own_step:
        # The search compares; what it came to is fitted, judged and reported at half the step.
        final, held = search.refine(final), replace(held, finer=2)
    found = replace(found, fitted=final)
    notes += found.notes
    if worst > judge.AT_FLOOR and not search.interrupted:
        notes += findings.beyond_limits(base.problem, held, recalibrated)
    three = (nominal, recalibrated, final)
    train = Errors(*(judge.unseen_error(search, f) for f in three))
    errors = Errors(*(judge.held_out_error(held, f) for f in three))
    forces = [evidence.force_errors(f.structure.physics(f.z), judged, kept.motions, judged_span) for f in three]
    force = {
        joint: Errors(*map(float, e)) for joint, e in zip(prepared.structure.base, np.stack(forces).T, strict=True)
    }
    notes += sentences.disagreement(errors, force)
    wide = judge.intervals(final, search.problem) + findings.step_shift(final, search.problem) + open_choice
    changed = findings.changed_numbers(final, wide)
    small = judge.negligible(errors.recalibrated, motion, located[0])
    verdict = judge.verdict(
        (errors.nominal, errors.recalibrated, errors.improved), small, len(final.structure.terms), len(changed)
    )
    missing = findings.missing_effects(search, found, errors, verdict, wide)
    if search.interrupted:
        notes.append("The search was interrupted: effects may be lacking, and not all rivals were compared.")
    if verdict == "consistent":
        changed = []
    notes += sentences.other_numbers(changed, [other.structure.numbers for other in found.others])
    if verdict in ("partly explained", "unexplained"):
        missing = findings.with_unknown(missing, errors, search, final, prepared.structure.base)
    improved = source.text
    if verdict != "consistent":
        improved, step_note = improve.improved_model(source, given, prepared, final, errors)
        notes += [step_note] if step_note else []
    provenance["seconds"] = round(time.monotonic() - began, 1)
    return Diagnosis(
        verdict,
        sentences.in_one_sentence(verdict, missing, changed, errors, others=bool(found.others)),
        tuple(located),
        tuple(missing),
        tuple(changed),
        train,
        errors,
        force,
        sentences.next_experiment(verdict, missing, others=bool(changed and found.others)),
        improved,
        _files(source, improved),
        tuple(notes),
        provenance,
        Work(source, tuple(recordings), held, prepared, nominal, recalibrated, final, search, found.rivals),
    )


@dataclass(frozen=True)
class _Baseline:
    """What is known before any effect is tried.

    Attributes:
        problem: windows to fit, those in which something odd happened among them.
        unseen: windows to compare on.
        rest: windows left aside.
        held: windows to judge by.
        nominal: the model as given, start states fitted.
        recalibrated: its own numbers fitted as well.
        own_step: why all windows are simulated in the model's own step, in words; empty where they are not.
    """

    problem: Problem
    unseen: Problem
    rest: Problem
    held: Problem
    nominal: Fit
    recalibrated: Fit
    own_step: str


def _baseline(prepared: Prepared, held: Problem, own: Stepping, numbers: Sequence[Number]) -> _Baseline:
    """Part the windows, and fit the model as given and recalibrated; `own` is how the model itself steps."""
    problem, unseen, rest = selection.split(prepared.problem)
    nominal = fit(problem, prepared.structure)
    own_step = ""
    if _predicts_better(replace(problem, stepping=own), nominal):
        own_step = sentences.own_step(own.timestep, nominal.error)
        problem, unseen, rest, held = (replace(part, stepping=own) for part in (problem, unseen, rest, held))
        nominal = fit(problem, prepared.structure)
    recalibrated = fit(problem, replace(prepared.structure, numbers=tuple(numbers)), starts=nominal.starts, most=20)
    odd = selection.odd(rest, recalibrated)
    if len(odd):
        problem, rest = problem.join(rest.pick(odd)), rest.pick(np.delete(np.arange(len(rest.windows)), odd))
        nominal = fit(problem, prepared.structure)
        recalibrated = fit(problem, recalibrated.structure, recalibrated.z, nominal.starts)
    return _Baseline(problem, unseen, rest, held, nominal, recalibrated, own_step)


def _predicts_better(problem: Problem, fitted: Fit) -> bool:
    """Whether a structure comes down to the noise in the steps of `problem`, and in those it was fitted in does not.

    By every third window; where these do not show what the step costs, others show something else.
    """
    some = np.arange(0, len(problem.windows), 3)
    if fitted.pick(some).error <= judge.AT_FLOOR:
        return False
    return fit(problem.pick(some), fitted.structure, fitted.z).error <= judge.AT_FLOOR


def _motion(problem: Problem) -> float:
    """Root mean square of how far readings move within a window, in units of noise."""
    w = problem.windows
    moved = (w.observed - w.observed[:, :1]) / w.noise
    return float(np.sqrt(np.sum(np.where(w.valid[..., None], moved, 0.0) ** 2) / problem.counts.sum()))


def _quiet(prepared: Prepared) -> str:
    """Why these recordings tell nothing, or an empty string."""
    positions = np.concatenate([m.position for m in prepared.motions])
    nb = positions.shape[1]
    noise = prepared.problem.spread[:nb] / 5
    still = positions.std(axis=0) < STILL * noise
    if still.all():
        return (
            f"no joint moves by more than {STILL:g} times the noise of its sensors, so nothing shows in these "
            "recordings that could be missing"
        )
    return ""


def _cannot_tell(
    reason: str, mend: str, source: mjcf.Source, notes: Sequence[str], provenance: dict[str, Any]
) -> Diagnosis:
    return Diagnosis(
        "cannot tell",
        f"These recordings cannot tell: {reason}.",
        next_experiment=mend,
        improved=source.text,
        files=_files(source, source.text),
        notes=tuple(notes),
        provenance=provenance,
    )


def _files(source: mjcf.Source, text: str) -> dict[str, bytes]:
    """What a text made from this source asks for; what was included stands in the text itself."""
    return {name: source.files[name] for name in mjcf.from_text(text, source.folder).files}


def _provenance(
    source: mjcf.Source, recordings: Sequence[Recording], model: mujoco.MjModel, seed: int
) -> dict[str, Any]:
    from importlib.metadata import version

    inputs = {str(source.path.name if source.path else "model"): source.sha256}
    inputs |= {str(r.path or r.name): r.sha256 for r in recordings}
    packages = ("dipc-gym", "mujoco", "numpy", "scipy")
    return {
        "versions": {name: version(name) for name in packages},
        "timestep": model.opt.timestep,
        "inputs": inputs,
        "seed": seed,
    }
