"""What a diagnosis found, and how diagnosis.json says it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dipc_gym import mjcf
from dipc_gym.recording import Recording
from dipc_gym.sim2real.estimation.fit import Fit
from dipc_gym.sim2real.estimation.problem import Problem
from dipc_gym.sim2real.estimation.segments import Prepared
from dipc_gym.sim2real.model.structure import Structure
from dipc_gym.sim2real.selection.search import Search
from dipc_gym.sim2real.verdict import judge

Array = NDArray[np.float64]


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
        law: of a law of any shape what it is of, its table, and where data support it; see `effects.law.described`.
    """

    effect: str
    at: str
    sentence: str
    share: float
    parameters: dict[str, dict[str, Any]] = field(default_factory=dict)
    same_here: tuple[dict[str, str], ...] = ()
    rivals: tuple[dict[str, Any], ...] = ()
    needs_loader: bool = False
    law: dict[str, Any] | None = None

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
            "recalibrated": round(self.recalibrated / scale, 6),
            "improved": round(self.improved / scale, 6),
        }

    def in_noise(self) -> dict[str, float]:
        """In units of noise."""
        return {name: round(getattr(self, name), 4) for name in ("nominal", "recalibrated", "improved")}


@dataclass(frozen=True)
class AsWritten:
    """What improved.xml comes to as its owner will run it, simulated by MuJoCo at the file's own step.

    Attributes:
        timestep: of the file, s.
        integrator: of the file, as MJCF names it.
        held_out: errors in units of noise, of all three models in such steps, on windows that nothing was chosen by.
        validation: the same on those that the form was chosen by.
        forms: elements in words, by key of each effect that is written otherwise than it was fitted.
        refitted: whether parameters make up for the step, and so hold at no other.
        finer: a step that brings the file down to what fine steps predict, s, and its error on held-out data; None
            where its own does, or none of those tried.
    """

    timestep: float
    integrator: str
    held_out: Errors
    validation: Errors
    forms: Mapping[str, str] = field(default_factory=dict)
    refitted: bool = False
    finer: tuple[float, float] | None = None

    def to_dict(self) -> dict[str, Any]:
        """As in diagnosis.json."""
        return {
            "timestep": self.timestep,
            "integrator": self.integrator,
            "held_out_in_noise": self.held_out.in_noise(),
            "validation_in_noise": self.validation.in_noise(),
            "forms": dict(self.forms),
            "refitted": self.refitted,
            "finer": None if self.finer is None else {"timestep": self.finer[0], "error": round(self.finer[1], 4)},
        }


@dataclass(frozen=True)
class Diagnosis:
    """What was found; `to_dict` is diagnosis.json, `improved` the text of improved.xml.

    Attributes:
        verdict: one of `report.VERDICTS`.
        sentence: what happened, for the rig's owner.
        located: where the unexplained force sits.
        missing: effects, the strongest first.
        recalibrated: model parameters that had to change.
        train: errors on windows between the fitted ones.
        held_out: errors on windows that no fit has touched; they may strike effects off, and add none.
        validation: errors on windows that no fit has touched, and that chose among models.
        written: errors of the improved model's file at its own step; None where that is the model as given.
        force: error of the inverse model on the same data, of the force that each joint transmits.
        next_experiment: what would settle what is left.
        improved: MJCF text of the improved model.
        files: contents of the meshes, textures and sub-models that it asks for, by the names it gives them.
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
    validation: Errors | None = None
    written: AsWritten | None = None
    force: dict[str, Errors] = field(default_factory=dict)
    next_experiment: str = ""
    improved: str = ""
    files: Mapping[str, bytes] = field(default_factory=dict, repr=False)
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
                "held_out_in_noise": self.held_out.in_noise(),
                "held_out_force": {
                    at: {
                        "nominal": round(e.nominal, 5),
                        "recalibrated": round(e.recalibrated, 5),
                        "improved": round(e.improved, 5),
                    }
                    for at, e in self.force.items()
                    if np.isfinite(e.nominal)
                },
            }
            if self.validation is not None:
                fit["validation_in_noise"] = self.validation.in_noise()
            if self.written is not None:
                fit["as_written"] = self.written.to_dict()
        return {
            "schema": "dipc-gym/diagnosis/2",
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
        nominal: fit of the initial states alone.
        recalibrated: fit of the model parameters.
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
