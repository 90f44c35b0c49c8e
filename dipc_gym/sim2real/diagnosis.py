"""Diagnose a model against recordings: what was left out, where, and how much better it predicts with it."""

from __future__ import annotations

import contextlib
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
from dipc_gym.sim2real import evidence, judge, states
from dipc_gym.sim2real.document import Document
from dipc_gym.sim2real.effects import Effect, catalogue
from dipc_gym.sim2real.fit import Fit, Problem, evaluate, fit
from dipc_gym.sim2real.numbers import Number, own_numbers
from dipc_gym.sim2real.recording import Recording, RecordingError
from dipc_gym.sim2real.search import Search
from dipc_gym.sim2real.simulate import Stepping
from dipc_gym.sim2real.structure import Structure, Term
from dipc_gym.sim2real.windows import Prepared, prepare

Array = NDArray[np.float64]

TRAIN = 0.75  # of each recording is fitted where none is held out
WINDOWS = 72  # fitted and compared on, two thirds and one third; more say little more
COARSEST = 2e-3  # s; longest step of the analysis
NEGLIGIBLE = 2e-3  # a number that moves by less was right
STILL = 10.0  # times its noise: a joint that moves less tells nothing


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
                if not (mean > 0 and spread > 0):
                    raise ValueError(f"--prior {number.key}: mean and spread must be positive")
                number = replace(number, sigma=spread / mean, expected=mean)
            out.append(number)
        return out


@dataclass(frozen=True)
class Missing:
    """An effect that the model lacks.

    Attributes:
        effect: id, or `unknown`.
        at: place.
        sentence: in plain words.
        share: of the reachable improvement that is lost without it.
        parameters: name -> value, interval and unit.
        same_here: other names for the same model on this rig with this data.
        rivals: other effects that were tried in its place.
        needs_loader: whether stock MuJoCo leaves it out.
    """

    effect: str
    at: str
    sentence: str
    share: float
    parameters: dict[str, dict[str, Any]] = field(default_factory=dict)
    same_here: tuple[dict[str, str], ...] = ()
    rivals: tuple[dict[str, Any], ...] = ()
    needs_loader: bool = False

    def to_dict(self) -> dict[str, Any]:
        """As in diagnosis.json."""
        return {
            "effect": self.effect,
            "at": self.at,
            "sentence": self.sentence,
            "share": round(self.share, 4),
            "same_here": list(self.same_here),
            "parameters": self.parameters,
            "rivals": list(self.rivals),
        }


@dataclass(frozen=True)
class Errors:
    """Prediction errors on one set of windows, in units of noise."""

    nominal: float
    recalibrated: float
    improved: float

    def relative(self) -> dict[str, float]:
        """Relative to the nominal model's."""
        scale = max(self.nominal, 1e-12)
        return {
            "nominal": 1.0,
            "recalibrated": round(self.recalibrated / scale, 6),
            "improved": round(self.improved / scale, 6),
        }


@dataclass(frozen=True)
class Diagnosis:
    """What was found; `to_dict` is diagnosis.json, `improved` the text of improved.xml.

    Attributes:
        verdict: one of `report.VERDICTS`.
        sentence: what happened, for the rig's owner.
        located: where the unexplained force sits.
        missing: effects, the strongest first.
        recalibrated: own numbers that had to change.
        train: errors on the windows that were fitted.
        held_out: errors on windows that no choice has touched.
        next_experiment: what would settle what is left.
        improved: MJCF text of the improved model.
        notes: about recordings and step size.
        provenance: versions, inputs, seed.
        work: what the report draws; None where nothing could be fitted.
    """

    verdict: str
    sentence: str
    located: tuple[judge.Located, ...] = ()
    missing: tuple[Missing, ...] = ()
    recalibrated: tuple[dict[str, Any], ...] = ()
    train: Errors | None = None
    held_out: Errors | None = None
    next_experiment: str = ""
    improved: str = ""
    notes: tuple[str, ...] = ()
    provenance: dict[str, Any] = field(default_factory=dict)
    work: Work | None = field(default=None, repr=False)

    def to_dict(self) -> dict[str, Any]:
        """The contents of diagnosis.json."""
        fit: dict[str, Any] = {}
        if self.train is not None and self.held_out is not None:
            fit = {
                "train": self.train.relative(),
                "held_out": self.held_out.relative(),
                "noise_floor": round(1 / max(self.held_out.nominal, 1e-12), 6),
                "held_out_in_noise": {
                    "nominal": round(self.held_out.nominal, 4),
                    "recalibrated": round(self.held_out.recalibrated, 4),
                    "improved": round(self.held_out.improved, 4),
                },
            }
        return {
            "schema": "dipc-gym/diagnosis/1",
            "verdict": self.verdict,
            "sentence": self.sentence,
            "located": [
                {"at": x.at, "kind": "joint", "share": round(x.share, 4), "where": x.where} for x in self.located
            ],
            "missing": [x.to_dict() for x in self.missing],
            "recalibrated": list(self.recalibrated),
            "fit": fit,
            "next_experiment": self.next_experiment,
            "improved_model": "improved.xml",
            "needs_dipc_gym": [f"{x.effect}@{x.at}" for x in self.missing if x.needs_loader],
            "notes": list(self.notes),
            "provenance": self.provenance,
        }


@dataclass(frozen=True)
class Work:
    """Everything behind a diagnosis, for the report and for whoever wants to go on.

    Attributes:
        source: the nominal model.
        recordings: that were fitted.
        held: windows for judging.
        prepared: windows for fitting.
        nominal: fit of the starts alone.
        recalibrated: fit of the own numbers.
        final: fit of the chosen structure.
        search: with every hypothesis tried.
        replaced: rivals of each effect found, by its key.
    """

    source: mjcf.Source
    recordings: tuple[Recording, ...]
    held: Problem
    prepared: Prepared
    nominal: Fit
    recalibrated: Fit
    final: Fit
    search: Search
    replaced: dict[str, list[judge.Rival]]

    def contenders(self) -> list[tuple[Structure, Array]]:
        """The chosen structure, or the recalibrated one where nothing was chosen, and the rivals still open."""
        first = self.final if len(self.final.z) else self.recalibrated
        open_ = [r.fitted for rivals in self.replaced.values() for r in rivals if not r.ruled_out]
        return [(fitted.structure, fitted.z) for fitted in (first, *open_)]


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
        RecordingError: the recordings hold no window.
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
    mjcf.check_supported(given.model)
    notes = [note for r in (*recordings, *held_out) for note in (f"{r.name}: {n}" for n in r.notes)]
    provenance = _provenance(source, [*recordings, *held_out], given.model, seed)
    span = (0.0, 1.0) if held_out else (0.0, TRAIN)
    step = min(COARSEST, *(r.period for r in recordings))
    stepping = Stepping(step, mujoco.mjtIntegrator.mjINT_RK4)
    numbers = (wishes or Wishes()).apply(own_numbers(Document(source), given.model))
    try:
        prepared = prepare(source, given, recordings, stepping, span=span, threads=threads)
        judged, judged_span = (held_out, (0.0, 1.0)) if held_out else (recordings, (TRAIN, 1.0))
        held = prepare(
            source, given, judged, stepping, length=prepared.length, span=judged_span, threads=threads
        ).problem
    except states.Undetermined as error:
        return _cannot_tell(str(error), source, notes, provenance)
    quiet = _quiet(prepared)
    if quiet:
        return _cannot_tell(quiet, source, notes, provenance)
    held = replace(held, windows=replace(held.windows, noise=prepared.problem.windows.noise))
    problem, unseen = _split(prepared.problem)
    tell(f"{len(prepared.problem.windows)} windows of {prepared.length:g} s")

    nominal = fit(problem, prepared.structure)
    recalibrated = fit(problem, replace(prepared.structure, numbers=tuple(numbers)), starts=nominal.starts, most=20)
    tell(f"as given, the model is off by {nominal.error:.3g} x noise; recalibrated, by {recalibrated.error:.3g}")
    search = Search(
        problem,
        unseen,
        list(effects if effects is not None else catalogue().values()),
        prepared.structure.base,
        lambda f: evidence.scene(f.structure.physics(f.z), recordings, prepared.motions, span[1]),
        fit(problem, recalibrated.structure, np.zeros(len(numbers)), nominal.starts, most=0),
        tell,
    )
    best = search.run(recalibrated)
    worst = judge.unseen_error(search, recalibrated)
    if best.structure.terms and not judge.credible(worst, judge.unseen_error(search, best)):
        tell("no effect explains enough to be named")
        best = recalibrated
    final = judge.fewest_numbers(search, best)
    train = Errors(judge.unseen_error(search, nominal), worst, judge.unseen_error(search, final))
    errors = Errors(*(_error(held, f) for f in (nominal, recalibrated, final)))
    located = judge.locate(search.look(recalibrated), prepared.structure.base)
    spread = judge.intervals(final, problem)
    shift = _step_shift(final, problem)
    changed = _changed(final, spread)
    verdict = judge.verdict(
        (errors.nominal, errors.recalibrated, errors.improved), _motion(held), len(final.structure.terms), len(changed)
    )
    replaced = {}
    for term in final.structure.terms:
        tell(f"what could stand in for {term.key}?")
        replaced[term.key] = judge.rivals(search, final, term)
    missing = [
        _missing(search, final, term, worst, replaced[term.key], spread, shift, verdict)
        for term in final.structure.terms
    ]
    if verdict == "consistent":
        changed = []
    missing.sort(key=lambda m: -m.share)
    if verdict in ("partly explained", "unexplained"):
        missing = _with_unknown(missing, errors, search, final, prepared)
    improved = source.text
    if verdict != "consistent":
        improved, step_note = _improved(source, given, prepared, final, errors)
        notes += [step_note] if step_note else []
    provenance["seconds"] = round(time.monotonic() - began, 1)
    return Diagnosis(
        verdict,
        _sentence(verdict, missing, changed, errors),
        tuple(located),
        tuple(missing),
        tuple(changed),
        train,
        errors,
        _next(verdict, missing),
        improved,
        tuple(notes),
        provenance,
        Work(source, tuple(recordings), held, prepared, nominal, recalibrated, final, search, replaced),
    )


def _split(problem: Problem) -> tuple[Problem, Problem]:
    """Windows to fit and windows to compare on, every third one, spread evenly over the recordings."""
    count = len(problem.windows)
    if count < 9:
        raise RecordingError(
            f"the recordings hold {count} windows of {problem.windows.times.max():.3g} s for fitting; at least 9 are "
            "needed: record longer"
        )
    chosen = np.unique(np.linspace(0, count - 1, min(WINDOWS, count)).round().astype(np.intp))
    return problem.pick(np.delete(chosen, np.s_[1::3])), problem.pick(chosen[1::3])


def _error(problem: Problem, fitted: Fit) -> float:
    mse, _ = evaluate(problem, fitted.structure, fitted.z)
    return float(np.sqrt(np.mean(mse)))


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


def _cannot_tell(reason: str, source: mjcf.Source, notes: Sequence[str], provenance: dict[str, Any]) -> Diagnosis:
    return Diagnosis(
        "cannot tell",
        f"These recordings cannot tell: {reason}.",
        next_experiment="Record the rig in motion, over the range and speeds that it is used at, every joint sensed.",
        improved=source.text,
        notes=tuple(notes),
        provenance=provenance,
    )


def _provenance(
    source: mjcf.Source, recordings: Sequence[Recording], model: mujoco.MjModel, seed: int
) -> dict[str, Any]:
    from importlib.metadata import version

    inputs = {str(source.path.name if source.path else "model"): source.sha256}
    inputs |= {r.path.name if r.path else r.name: r.sha256 for r in recordings}
    packages = ("dipc-gym", "mujoco", "numpy", "scipy")
    return {
        "versions": {name: version(name) for name in packages},
        "timestep": model.opt.timestep,
        "inputs": inputs,
        "seed": seed,
    }


def _changed(final: Fit, spread: Array) -> list[dict[str, Any]]:
    """Own numbers that had to change, as diagnosis.json lists them."""
    out = []
    for i, number in enumerate(final.structure.numbers):
        if abs(final.z[i]) < NEGLIGIBLE:
            continue
        value = final.structure.slots[i].value(final.z[i])
        wide = judge.QUANTILE * spread[i]
        out.append(
            {
                "parameter": number.parameter,
                "at": number.at,
                "was": number.value,
                "value": value,
                "low": value * math.exp(-wide),
                "high": value * math.exp(wide),
                "unit": number.unit,
            }
        )
    return out


def _step_shift(final: Fit, problem: Problem) -> Array:
    """How far each mapped number moves when the step is halved, (p,), by one Newton step."""
    if not len(final.z):
        return np.zeros(0)
    finer = replace(problem, stepping=replace(problem.stepping, timestep=problem.stepping.timestep / 2))
    again = fit(finer, final.structure, final.z, final.starts, most=1)
    return np.abs(again.z - final.z)


def _missing(
    search: Search,
    final: Fit,
    term: Term,
    worst: float,
    replaced: Sequence[judge.Rival],
    spread: Array,
    shift: Array,
    verdict: str,
) -> Missing:
    units = place_units(final.structure, term)
    values = final.structure.term_values(final.z, term)
    parameters: dict[str, dict[str, Any]] = {}
    for i, slot in enumerate(final.structure.slots):
        prefix = f"{term.key}."
        if not slot.key.startswith(prefix):
            continue
        name = slot.key.removeprefix(prefix)
        entry: dict[str, Any] = {"value": slot.value(final.z[i]), "unit": units[name]}
        # With structure left, an interval would tell how sure a wrong model is of its number.
        if verdict == "explained":
            wide = judge.QUANTILE * spread[i] + shift[i]
            low, high = slot.value(final.z[i] - wide), slot.value(final.z[i] + wide)
            entry |= {"low": min(low, high), "high": max(low, high), "level": 0.9}
        parameters[name] = entry
    return Missing(
        term.effect.id,
        term.at,
        term.effect.sentence(term.at, values, units),
        judge.share(search, final, term.key, worst),
        parameters,
        tuple({"effect": r.term.effect.id, "at": r.term.at} for r in replaced if r.same),
        tuple(
            {"effect": r.term.effect.id, "at": r.term.at, "error_in_noise": round(r.error, 4), "ruled_out": r.ruled_out}
            for r in replaced
        ),
        term.effect.needs_loader,
    )


def place_units(structure: Structure, term: Term) -> dict[str, str]:
    """Unit of each parameter of an effect, in terms of its joint's kind."""
    from dipc_gym.sim2real.effects.base import joint_of

    model = structure.model
    joint = term.at if term.effect.place == "joint" else ""
    if term.effect.place == "actuator":
        joint = joint_of(model, term.at) or ""
    hinge = bool(joint) and model.jnt_type[model.joint(joint).id] == mujoco.mjtJoint.mjJNT_HINGE
    units = {}
    for p in term.effect.parameters:
        unit = p.unit
        if hinge and term.effect.id != "motor.cogging":
            unit = {"N": "N m", "m": "rad", "N/m": "N m/rad", "kg": "kg m^2", "m/s": "rad/s"}.get(unit, unit)
            unit = {"N s/m": "N m s/rad", "N s^2/m^2": "N m s^2/rad^2"}.get(unit, unit)
        units[p.name] = {"command": "V" if term.effect.place == "actuator" else "", "reading": ""}.get(unit, unit)
    return units


def _with_unknown(
    missing: list[Missing], errors: Errors, search: Search, final: Fit, prepared: Prepared
) -> list[Missing]:
    """Add what no effect of the catalogue explains; first, if what was found merely stands in for it."""
    left = max(errors.improved - 1, 0.0) / max(errors.recalibrated - 1, 1e-9)
    place = judge.locate(search.look(final), prepared.structure.base)[0]
    unknown = Missing(
        "unknown",
        place.at,
        f"Something acts at {place.at} that no effect in the catalogue accounts for; it {_verb(place.where)}.",
        float(np.clip(left, 0, 1)),
    )
    return [unknown, *missing] if not missing or left > judge.STANDS_IN else [*missing, unknown]


def _verb(where: str) -> str:
    return where if where.startswith(("goes", "grows", "changes")) else f"is {where}"


def _sentence(verdict: str, missing: Sequence[Missing], changed: Sequence[dict[str, Any]], errors: Errors) -> str:
    fall = f"On held-out data the error falls from {errors.nominal:.3g} to {errors.improved:.3g} times the noise"
    known = " ".join(m.sentence for m in missing if m.effect != "unknown")
    rest = ""
    if errors.improved > judge.AT_FLOOR:
        rest = " What is left is not noise, but small beside the motion, and no known effect accounts for it."
    if verdict == "consistent":
        return f"Nothing is missing: the model predicts held-out data to {errors.nominal:.3g} times the noise.{rest}"
    if verdict == "recalibrated":
        names = ", ".join(f"{c['parameter']} of {c['at']}" for c in changed)
        return f"No physics is missing; wrong numbers were: {names}. {fall}.{rest}"
    if verdict == "explained":
        return f"The model lacks this: {known} {fall}; what is left looks like noise."
    if verdict == "partly explained":
        return f"{known} That helps, but structure is left that no known effect accounts for. {fall}."
    return f"{missing[0].sentence if missing else ''} {fall}.".strip()


def _next(verdict: str, missing: Sequence[Missing]) -> str:
    """What to record to settle what is left."""
    open_ = [(m, s) for m in missing for s in m.same_here]
    if open_:
        m, s = open_[0]
        return (
            f"On this rig with this data {m.effect} at {m.at} and {s['effect']} at {s['at']} are one model. To tell "
            "them apart, record what moves one and not the other: other speeds, other positions, another load, or a "
            "second sensor."
        )
    doubt = [(m, r) for m in missing for r in m.rivals if not r["ruled_out"]]
    if doubt:
        m, r = doubt[0]
        return (
            f"{r['effect']} at {r['at']} predicts nearly as well as {m.effect} at {m.at}. Record slow reversals and "
            "fast steps over the whole range for a minute."
        )
    if verdict in ("partly explained", "unexplained"):
        return (
            "Repeat one short command many times over several minutes, at rest in between: what changes from one time "
            "to the next depends on time or temperature, what does not depends on the state."
        )
    return "Nothing is open. Record again when the rig is changed."


def _improved(
    source: mjcf.Source,
    given: physics.Physics,
    prepared: Prepared,
    final: Fit,
    errors: Errors,
) -> tuple[str, str]:
    """Text of the improved model with its numbers refitted at the file's own step, and what that step costs."""
    structure = final.structure
    if not structure.numbers and not structure.terms:
        return source.text, ""
    own = Stepping(given.model.opt.timestep, None)
    coarse = replace(prepared.problem, stepping=own)
    count = len(coarse.windows)
    some = coarse.pick(np.unique(np.linspace(0, count - 1, min(36, count)).round().astype(np.intp)))
    z = final.z
    before, _ = evaluate(some, structure, z)
    with contextlib.suppress(mjcf.MjcfError, np.linalg.LinAlgError):
        again = fit(some, structure, z, most=4)
        after, _ = evaluate(some, structure, again.z)
        if np.mean(after) < np.mean(before):
            z, before = again.z, after
    error = float(np.sqrt(np.mean(before)))
    note = ""
    if error > 1.2 * max(errors.improved, 1.0):
        note = (
            f"At the model's own step of {1e3 * own.timestep:g} ms and with its integrator the improved model predicts "
            f"to {error:.3g} times the noise, with a converged step to {errors.improved:.3g}: a shorter step is worth "
            "more than any further physics."
        )
    document = structure.write(z)
    lines = [t.effect.sentence(t.at, structure.term_values(z, t), place_units(structure, t)) for t in structure.terms]
    loaders = [t.key for t in structure.terms if t.effect.needs_loader]
    if structure.numbers:
        lines.append("Refitted: " + ", ".join(n.key for n in structure.numbers) + ".")
    if loaders:
        lines.append(f"Stock MuJoCo leaves out {', '.join(loaders)}; dipc_gym.physics.load applies what <custom> says.")
    document.comment("Changed by dipc-gym diagnose.", *lines)
    return document.text(), note
