"""What a diagnosis found: arrays and plain values, how diagnosis.json says it, and what the report draws."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from dipc_gym.recording import Recording

Array = NDArray[np.float64]
Status = Literal["chosen", "same model here", "not told apart", "ruled out", "screened out"]
Before = Literal["nominal", "recalibrated"]
Verdict = Literal[
    "consistent", "recalibrated", "explained", "modelled", "partly explained", "unexplained", "cannot tell"
]

SCHEMA = "dipc-gym/diagnosis/3"
MOST_TRACES, MOST_MAPS, MOST_RESIDUALS = 16, 8, 12  # that are drawn
MOST_SAMPLES = 30_000  # of each that are kept; of longer recordings whole windows, or every few samples


@dataclass(frozen=True)
class Located:
    """Where a mismatch sits.

    Attributes:
        at: joint.
        share: of the unexplained force, each joint's measured by what it transmits.
        where: region, in words.
        explained: share of the variance of its unexplained force that goes with one of velocity, position, load, time.
        of_late: share of it that goes with velocity by a factor of how fast the joint was of late.
    """

    at: str
    share: float
    where: str
    explained: float
    of_late: float = 0.0


@dataclass(frozen=True)
class Missing:
    """An effect that the model lacks.

    Attributes:
        effect: id, or `unknown`.
        at: place.
        sentence: in plain words.
        share: of the reachable improvement that is lost without it; of something unknown that is not modelled, of the
            mismatch that is left.
        parameters: name -> value, interval and unit.
        same_here: other names for the same model on this rig with this data.
        rivals: other effects that were tried in its place.
        law: of a law of any shape what it is of, its table, and where data support it; see
            `effects.shared.law.described`.
        where: what the force of something unknown goes with, in words; its sentence says it as well.
    """

    effect: str
    at: str
    sentence: str
    share: float
    parameters: dict[str, dict[str, Any]] = field(default_factory=dict)
    same_here: tuple[dict[str, str], ...] = ()
    rivals: tuple[dict[str, Any], ...] = ()
    law: dict[str, Any] | None = None
    where: str = ""

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
            **({} if self.law is None else {"law": self.law}),
        }


@dataclass(frozen=True)
class Errors:
    """Errors of the model as given, recalibrated and improved: of predictions in units of noise, of forces relative."""

    nominal: float
    recalibrated: float
    improved: float

    def relative(self) -> dict[str, float]:
        """Relative to the nominal model's."""
        scale = max(self.nominal, 1e-12)
        return {
            "nominal": 1.0,
            "recalibrated": significant(self.recalibrated / scale),
            "improved": significant(self.improved / scale),
        }

    def in_noise(self) -> dict[str, float]:
        """In units of noise."""
        return self.rounded(4)

    def rounded(self, digits: int) -> dict[str, float]:
        """As they are, with so many digits behind the point."""
        return {name: round(getattr(self, name), digits) for name in ("nominal", "recalibrated", "improved")}


# What people measure by, of the unit in which a file holds it.
SHOWN = {
    "m": (1e3, "mm"),
    "rad": (180 / math.pi, "degrees"),
    "m/s": (1e3, "mm/s"),
    "rad/s": (180 / math.pi, "degrees/s"),
}


def scaled(value: float, unit: str) -> tuple[float, str]:
    """A number and its unit as people measure it.

    Example:
        >>> scaled(0.002, "m"), scaled(3.0, "A")
        ((2.0, 'mm'), (3.0, 'A'))
    """
    factor, name = SHOWN.get(unit, (1.0, unit))
    return factor * value, name


@dataclass(frozen=True)
class SensorFit:
    """How far predictions of one sensor are off on held-out windows.

    Attributes:
        name: of the sensor.
        unit: SI; empty if unknown.
        noise: standard deviation of its own noise, in that unit; infinite if it never changes.
        motion: root mean square of how far it moves within a window, in that unit.
        errors: root mean square errors of all three models, in that unit.
    """

    name: str
    unit: str
    noise: float
    motion: float
    errors: Errors

    def to_dict(self) -> dict[str, Any]:
        """As in diagnosis.json."""
        three = {name: getattr(self.errors, name) for name in ("nominal", "recalibrated", "improved")}
        share = {name: round(value / self.motion, 6) if self.motion > 0 else None for name, value in three.items()}
        return {
            "unit": self.unit,
            "noise": self.noise if np.isfinite(self.noise) else None,
            "motion": self.motion,
            "error": three,
            "share_of_motion": share,
        }


@dataclass(frozen=True)
class FinerSteps:
    """How improved.xml would be simulated to come down to what fine steps predict.

    Attributes:
        timestep: s.
        integrator: as MJCF names it.
        error: on held-out data then, in units of noise.
    """

    timestep: float
    integrator: str
    error: float

    def to_dict(self) -> dict[str, Any]:
        """As in diagnosis.json."""
        return {"timestep": self.timestep, "integrator": self.integrator, "error": round(self.error, 4)}


@dataclass(frozen=True)
class AsWritten:
    """What improved.xml comes to as its owner will run it, simulated by MuJoCo at the file's own step.

    Attributes:
        timestep: of the file, s.
        integrator: of the file, as MJCF names it.
        held_out: errors in units of noise, of all three models in such steps, on windows that nothing was chosen by.
        validation: the same on those that the form was chosen by.
        fine: the error of what was found on held-out data, simulated likewise in fine steps, in units of noise.
        forms: elements in words, by key of each effect that is written otherwise than it was fitted.
        refitted: whether parameters make up for the step, and so hold at no other.
        exact: whether the file asks for that integrator in the place of its own, without which a model that lacks what
            was found would predict better at its step.
        finer: what brings the file down to what fine steps predict; None where its own steps do, or nothing tried.
        to_the_end: whether what is written was fitted to what is held out as well, after that had judged it.
    """

    timestep: float
    integrator: str
    held_out: Errors
    validation: Errors
    fine: float
    forms: Mapping[str, str] = field(default_factory=dict)
    refitted: bool = False
    exact: bool = False
    finer: FinerSteps | None = None
    to_the_end: bool = False

    def to_dict(self) -> dict[str, Any]:
        """As in diagnosis.json."""
        return {
            "timestep": self.timestep,
            "integrator": self.integrator,
            "held_out_in_noise": self.held_out.in_noise(),
            "validation_in_noise": self.validation.in_noise(),
            "fine_in_noise": round(self.fine, 4),
            "forms": dict(self.forms),
            "refitted": self.refitted,
            "exact": self.exact,
            "finer": None if self.finer is None else self.finer.to_dict(),
            "fitted_to_the_end": self.to_the_end,
        }


@dataclass(frozen=True)
class Trace:
    """A sensor on held-out data, predicted window by window; NaN where no window lies.

    Attributes:
        sensor: its name.
        unit: SI.
        recording: name of the file.
        time: s, rising, (n,).
        observed: readings, (n,).
        nominal: prediction of the model as given, (n,).
        recalibrated: with its parameters refitted, (n,); None if there is nothing to refit.
        improved: with what was missing, (n,); None if nothing is.
    """

    sensor: str
    unit: str
    recording: str
    time: Array
    observed: Array
    nominal: Array
    recalibrated: Array | None = None
    improved: Array | None = None

    def __post_init__(self) -> None:
        _same_length(self, "time", "observed", "nominal", "recalibrated", "improved")


@dataclass(frozen=True)
class Mismatch:
    """Force at one joint that a model does not explain: where it sits.

    Attributes:
        joint: its name.
        unit: of the force, `N` or `N m`.
        position_unit: `m` or `rad`; velocity is per second.
        time: s, (n,); may begin anew with each recording.
        position: of the joint, (n,).
        velocity: of the joint, (n,).
        before: unexplained force without what was missing, (n,).
        after: unexplained force with it, (n,); None if nothing is missing.
    """

    joint: str
    unit: str
    position_unit: str
    time: Array
    position: Array
    velocity: Array
    before: Array
    after: Array | None = None

    def __post_init__(self) -> None:
        _same_length(self, "time", "position", "velocity", "before", "after")


@dataclass(frozen=True)
class Candidate:
    """A hypothesis and what became of it.

    Attributes:
        effect: id, with the form of the effect after a colon where it has several.
        at: place.
        words: the effect in plain words.
        status: what became of it.
        error: reached by its fit, in units of noise; of a sketch, as that of all windows would be; None if it was not
            fitted.
        improvement: mean fall of the log square error against the refitted model, beside what was in place when it was
            tried; on windows it was not fitted to, or on those of a sketch; None if not fitted.
        standard_error: of the improvement.
    """

    effect: str
    at: str
    words: str
    status: Status
    error: float | None = None
    improvement: float | None = None
    standard_error: float | None = None

    def __post_init__(self) -> None:
        if self.status not in get_args(Status):
            raise ValueError(f"status of {self.effect}: {self.status!r} is none of {', '.join(get_args(Status))}")


@dataclass(frozen=True)
class SensorResidual:
    """What prediction leaves of one sensor, in units of its noise.

    Attributes:
        sensor: its name.
        time: s, (n,).
        before: without what was missing, (n,).
        after: with it, (n,); None if nothing is missing.
        lags: s, (k,).
        before_autocorrelation: (k,).
        after_autocorrelation: (k,); None if nothing is missing.
        band: half width of the 95 % band of white noise.
        statement: whether this looks like noise, in one sentence.
    """

    sensor: str
    time: Array
    before: Array
    after: Array | None
    lags: Array
    before_autocorrelation: Array
    after_autocorrelation: Array | None
    band: float
    statement: str

    def __post_init__(self) -> None:
        _same_length(self, "time", "before", "after")
        _same_length(self, "lags", "before_autocorrelation", "after_autocorrelation")


@dataclass(frozen=True)
class Details:
    """What stands behind a diagnosis, as the report draws it; of traces, maps and residuals that are not drawn the
    names alone, without samples.

    Attributes:
        before: which model stands for "before" in maps and residuals.
        traces: test data, the most telling first.
        maps: where the mismatch sits, the joint with most of it first.
        candidates: hypotheses, the best first.
        residuals: per sensor.
        difference: unified difference of the MJCF, from the model to the improved one; empty if there is none.
    """

    before: Before = "recalibrated"
    traces: tuple[Trace, ...] = ()
    maps: tuple[Mismatch, ...] = ()
    candidates: tuple[Candidate, ...] = ()
    residuals: tuple[SensorResidual, ...] = ()
    difference: str = ""

    def __post_init__(self) -> None:
        if self.before not in get_args(Before):
            raise ValueError(f"before: {self.before!r} is none of {', '.join(get_args(Before))}")


@dataclass(frozen=True)
class Design:
    """What to do next.

    Attributes:
        sentence: what to command, where, how much and how long, and why.
        commands: time and actuators, without sensors; `recording.write` makes a file of it.
        difference: error in units of noise that the closest rival would be left with; NaN with no rival.
    """

    sentence: str
    commands: Recording
    difference: float = math.nan


@dataclass(frozen=True)
class Beyond:
    """Held-out windows in which laws are asked for what they were not fitted with: there they only stay as they end.

    Attributes:
        count: such windows.
        of: held-out windows.
        there: error of the improved model there, in units of noise.
        within: errors on all others, in units of noise.
        inputs: those of the laws that go beyond: `name`, and their ranges, `fitted` and `asked`, two numbers each.
    """

    count: int
    of: int
    there: float
    within: Errors
    inputs: tuple[Mapping[str, Any], ...]

    def to_dict(self) -> dict[str, Any]:
        """As in diagnosis.json."""
        return {
            "windows": self.count,
            "of": self.of,
            "improved_in_noise": round(self.there, 4),
            "elsewhere_in_noise": self.within.in_noise(),
            "inputs": [dict(one) for one in self.inputs],
        }


@dataclass(frozen=True)
class Diagnosis:
    """What was found; `to_dict` is diagnosis.json, `improved` the text of improved.xml.

    Attributes:
        verdict: what was found, in a word or two.
        sentence: what happened, for the rig's owner.
        located: where the unexplained force sits.
        missing: effects, the strongest first.
        recalibrated: model parameters that had to change.
        comparison: errors on windows between the fitted ones.
        held_out: errors on windows that no fit has touched, and that chose nothing.
        held_out_was_fitted: whether these could not be worked out, and `held_out` is the error on fitted windows.
        validation: errors on windows that no fit has touched, and that chose among models.
        beyond: held-out windows that go beyond what laws were fitted with; None where none does.
        written: errors of the improved model's file at its own step; None where that is the model as given.
        sensors: errors of each sensor on the held-out windows, in its own unit.
        force: error of the inverse model on the same data, of the force that each joint transmits.
        next_experiment: what would settle what is left.
        improved: MJCF text of the improved model.
        needs_loader: effects that it holds under `<custom>`, which stock MuJoCo leaves out, as `effect@place`.
        files: contents of the meshes, textures and sub-models that it asks for, by the names it gives them.
        notes: about recordings and step size.
        provenance: versions, inputs, seed.
        details: what the report draws; None where nothing could be fitted.
        design: the command that the next experiment should send, where it was asked for and something can be told.
    """

    verdict: Verdict
    sentence: str
    located: tuple[Located, ...] = ()
    missing: tuple[Missing, ...] = ()
    recalibrated: tuple[dict[str, Any], ...] = ()
    comparison: Errors | None = None
    held_out: Errors | None = None
    held_out_was_fitted: bool = False
    validation: Errors | None = None
    beyond: Beyond | None = None
    written: AsWritten | None = None
    sensors: tuple[SensorFit, ...] = ()
    force: dict[str, Errors] = field(default_factory=dict)
    next_experiment: str = ""
    improved: str = ""
    needs_loader: tuple[str, ...] = ()
    files: Mapping[str, bytes] = field(default_factory=dict, repr=False)
    notes: tuple[str, ...] = ()
    provenance: dict[str, Any] = field(default_factory=dict)
    details: Details | None = field(default=None, repr=False)
    design: Design | None = field(default=None, repr=False)

    def to_dict(self) -> dict[str, Any]:
        """The contents of diagnosis.json."""
        fit: dict[str, Any] = {}
        if self.comparison is not None and self.held_out is not None:
            fit = {
                "comparison": self.comparison.relative(),
                "held_out": self.held_out.relative(),
                "held_out_was_fitted": self.held_out_was_fitted,
                "noise_floor": significant(1 / max(self.held_out.nominal, 1e-12)),
                "held_out_in_noise": self.held_out.in_noise(),
                "held_out_force": {
                    at: errors.rounded(5) for at, errors in self.force.items() if np.isfinite(errors.nominal)
                },
            }
            if self.sensors:
                fit["held_out_by_sensor"] = {one.name: one.to_dict() for one in self.sensors}
            if self.validation is not None:
                fit["validation_in_noise"] = self.validation.in_noise()
            if self.beyond is not None:
                fit["held_out_beyond"] = self.beyond.to_dict()
            if self.written is not None:
                fit["as_written"] = self.written.to_dict()
        return {
            "schema": SCHEMA,
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
            "needs_dipc_gym": list(self.needs_loader),
            "notes": list(self.notes),
            "provenance": self.provenance,
        }


def significant(value: float) -> float:
    """To six digits: a share of a model that is far off is small, and is divided by another one as small."""
    return float(f"{value:.6g}")


def _same_length(record: object, *names: str) -> None:
    values = [(name, getattr(record, name)) for name in names]
    lengths = {name: np.shape(value) for name, value in values if value is not None}
    if len(set(lengths.values())) > 1 or any(len(shape) != 1 for shape in lengths.values()):
        raise ValueError(f"{type(record).__name__}: fields must be vectors of one length, not {lengths}")
