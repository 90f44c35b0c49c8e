"""Folders that `compare`, `train-policy` and `trial` go on in."""

from __future__ import annotations

import functools
import io
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from brains import estimator, llnf, own_policy
from mutate import archive, octets
from target import BOTH, Target, as_json

from dipc_gym import compensators, estimators, sweep
from dipc_gym.controllers import ControllerError
from dipc_gym.estimators import EstimatorError
from dipc_gym.experiments import robustness, score, tables
from dipc_gym.experiments.cells import Balancing, CompensatorTraining, FrictionLearning
from dipc_gym.identification import Sweep
from dipc_gym.plant import Plant
from dipc_gym.policy import Policy
from dipc_gym.safety import intact
from dipc_gym.safety.places import PlaceError
from dipc_gym.sweep import SweepError
from dipc_gym.training import checkpoint
from dipc_gym.training import folder as training_folder
from dipc_gym.training.rig import Rig
from dipc_gym.training.seeds import PolicyTraining, keep
from dipc_gym.training.task import SCHEMA
from dipc_gym.training.train import Recipe, Training, TrainingError

FIGURES = {
    **{"survived": True, "seconds": 40.0, "force_rms": 3.0, "voltage_rms": 2.0, "clipped_share": 0.0},
    **{"cart_m": 0.02, "pole1_deg": 0.5, "pole2_deg": 0.3},
}
RUN = {
    **FIGURES, "controller": "lqr", "compensator": "llnf", "trained_with": None, "seed": 0, "cost": 2e6,
    "cost_printed_q": 3e6, "test_mse": 0.2, "parameters": 20, "notes": [],
}  # fmt: skip


# --- comparisons ------------------------------------------------------------------------------------------------------


@functools.cache
def _training_cell() -> CompensatorTraining:
    return CompensatorTraining(
        compensator="llnf", plant=Plant(), model=None, recording=None, sweep=Sweep(), seed=0, files={}
    )


@functools.cache
def _learning_cell() -> FrictionLearning:
    return FrictionLearning(plant=Plant(), model=None, recording=None, sweep=Sweep(), seed=0, files={})


@functools.cache
def _balancing() -> Balancing:
    return Balancing(
        controller="lqr", compensator="llnf", trained=llnf(), plant=Plant(), model=None, seed=0, seconds=40.0,
        exact_state=False, files={},
    )  # fmt: skip


@functools.cache
def _endurance() -> Any:
    return robustness.plan([_balancing()], ["supply"])[0]


@functools.cache
def _scoring() -> Any:
    return score.plan([_balancing()], {"cart": 1.0, "pole1": 0.1, "pole2": 0.1})[0]


@functools.cache
def _cells() -> dict[str, bytes]:
    stood = [{"value": value, **FIGURES} for value in _endurance().values]
    scored = [{"what": "cart mass 0.75", "survived": True, "seconds": 10.0}]
    results = (
        *((_training_cell(), llnf()), (_learning_cell(), estimator()), (_balancing(), RUN)),
        *((_endurance(), stood), (_scoring(), scored)),
    )
    files = {}
    for cell, result in results:
        held = {"parameters": sweep.parameters(cell), "failure": None, "result": result}
        files[f"cells/{cell.name}.json"] = as_json(intact.signed(held))
    return files


def _comparison(folder: Path) -> None:
    pairs = [("lqr", "llnf")]
    for cell in (_training_cell(), _learning_cell(), _balancing(), _endurance(), _scoring()):
        for outcome in sweep.finished([cell], folder / "cells"):
            if cell is _training_cell():
                compensators.load(outcome.result)
            elif cell is _learning_cell():
                estimators.load({**outcome.result, "kind": "kalman"})
            elif cell is _balancing():
                held = tables.summarise({}, pairs, [outcome.result], [], True)
                json.dumps(held, allow_nan=False)
                tables.table(held)
            elif cell is _endurance():
                held = robustness.summarise([cell], [outcome], pairs)
                json.dumps(held, allow_nan=False)
                robustness.table(held)
            else:
                held = score.summarise([outcome], pairs)
                json.dumps(held, allow_nan=False)
                score.table(held)
    sweep.written(folder / "cells")


# --- trainings --------------------------------------------------------------------------------------------------------

TINY = Training(
    compensator="none", seed=5, recipe=Recipe(steps=1_000, num_envs=4, stage=250, rollout=125, batch_size=250, width=4)
)


def _policy_cells() -> dict[str, bytes]:
    cell = PolicyTraining.of(TINY)
    result = {"policy.json": own_policy().decode(), "curve.csv": "steps\n1\n", "training.json": "{}"}
    held = {"parameters": sweep.parameters(cell), "failure": None, "result": result}
    return {f"sweep/trainings/{cell.name}.json": as_json(intact.signed(held))}


def _policy_sweep(folder: Path) -> None:
    cell = PolicyTraining.of(TINY)
    for outcome in sweep.finished([cell], folder / "sweep" / "trainings"):
        keep(outcome, folder / "sweep")
        Policy.load(folder / "sweep" / cell.name / "policy.json")


def _resumed(folder: Path) -> None:
    training_folder.prepare(TINY, folder / "out", resume=True, overwrite=False)


@functools.cache
def _learner() -> Any:
    from dipc_gym.training.learner import Learner

    linear = np.zeros((6, 6)), np.zeros(6)  # of these nothing is asked where nobody imitates
    return Learner(TINY, Rig(None, "none", 24.0, 4.0, None, None, None, None, linear), None)


@functools.cache
def _checkpoint() -> bytes:
    import torch

    out = io.BytesIO()
    look = {"steps": 1_000, "seconds": 1.0, "standing": 0, "held": 0.5, "reward": 0.1}
    torch.save({"schema": SCHEMA, "looks": [look], "learner": _learner().state()}, out)
    return out.getvalue()


def _restore(folder: Path) -> None:
    looks = checkpoint.restore(_learner(), folder / "checkpoint.pt")
    max((past.rank for past in looks), default=(-1, 0.0))
    _learner().keep_average()
    _learner().policy()


# --- trials -----------------------------------------------------------------------------------------------------------


def _trial_files() -> dict[str, bytes]:
    from dipc_gym.trials import records

    effect = {"effect": "friction.coulomb", "at": "cart", "also_at": [], "kind": ""}
    given = {name: name.encode() for name in ("nominal.xml", "train_1.csv", "train_2.csv", "test.csv")}
    answer = {
        "schema": "dipc-gym/trial/1", "trial": "t001_cart", "seed": [1, 1], "rig": "cart", "kind": "single",
        "tuned": False, "known_friction": False, "missing": [effect], "includes": [],
        "parameters": {"friction.coulomb@cart": {"level": {"value": 3.0, "unit": "N"}}}, "equivalents": {},
        "recalibrated_suffices": False, "share_of_signal": 10.0, "share_of_each": {}, "equivalent_sets": {},
        "moved_from_nominal": 10.0, "signal": 100.0,
        "drive": {"gear": 2.0, "rotor": 0.1, "kt": 3.0, "resistance": 1.5}, "held_out_predictable": True,
        "test_error": {"nominal": 12.0, "recalibrated": 10.0, "truth": 1.0}, "noise": {"cart": 1e-5},
    }  # fmt: skip
    said = {
        "verdict": "explained", "recalibrated": [],
        "missing": [{**effect, "same_here": [], "parameters": {"level": {"value": 3.0, "low": 2.9, "high": 3.1}}}],
    }  # fmt: skip
    diagnosis = as_json(said)
    note = {
        "trial": "t001_cart", "tool": "t", "seconds": 5.0, "failure": None, "timed_out": False,
        "sensor_errors": {"cart": 1.9e-5}, "sensor_errors_own_step": {"cart": 2e-5},
    }  # fmt: skip
    contest = {name: {"error": 2.0, "seconds": 3.0} for name in ("sysid", "network", "sparse")}
    identity = {"schema": "dipc-gym/trial/1", "seed": 1, "full": False, "plans": 1}
    return {
        **{f"trials/t001_cart/{name}": text for name, text in given.items()},
        "sealed/t001_cart.json": as_json(intact.signed(answer | {"files": records.digests(given)})),
        "results/t001_cart/attempt.json": as_json(intact.signed(note | {"files": {}})),
        "results/t001_cart/diagnosis.json": diagnosis,
        "results/t001_cart/rivals.json": as_json(intact.signed(contest)),
        "generator.json": as_json(intact.signed(identity)),
    }


def _trial(folder: Path) -> None:
    """What `trial` does when started again, up to the work itself."""
    from dipc_gym.safety.files import finite
    from dipc_gym.trials import generate, publish, rivals, run, score
    from dipc_gym.trials.secret import Plan

    plan = Plan(1, "single", "cart", "friction.coulomb", False)
    run.tool = lambda: "t"  # type: ignore[attr-defined]
    open_ones = not run._done(folder, plan.name)
    made = generate._made(folder, plan, 1)
    generate.same_trials(
        folder / "generator.json", {"schema": "dipc-gym/trial/1", "seed": 1, "full": False, "plans": 1}
    )
    if made and not open_ones:
        scores = score.score(folder, [plan.name])
        json.dumps(finite(scores), allow_nan=False)
        publish.markdown(scores, seed=1)
    if made and rivals._done(folder, plan.name) and not open_ones:
        row = rivals._row(folder, plan.name)
        rivals.markdown([row] if row else [], seed=1)


TARGETS: dict[str, Callable[[], Target]] = {
    "comparison": lambda: Target(_cells(), dict.fromkeys(_cells(), BOTH), _comparison, (SweepError, EstimatorError)),
    "policy sweep": lambda: Target(
        _policy_cells(), dict.fromkeys(_policy_cells(), BOTH), _policy_sweep, (SweepError, ControllerError, PlaceError)
    ),
    "training.json": lambda: Target(
        {"out/training.json": as_json(TINY.to_dict() | {"files": {}})},
        {"out/training.json": BOTH},
        _resumed,
        (TrainingError,),
    ),
    "checkpoint": lambda: Target(
        {"checkpoint.pt": _checkpoint()}, {"checkpoint.pt": (archive,)}, _restore, (TrainingError,)
    ),
    "trial": lambda: Target(
        _trial_files(),
        {name: BOTH for name in _trial_files() if name.endswith(".json")} | {"trials/t001_cart/test.csv": (octets,)},
        _trial,
        (ValueError,),
    ),
}
