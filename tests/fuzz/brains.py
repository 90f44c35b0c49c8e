"""Controllers, compensators and estimators: what `compare`, `record`, `render`, `train-policy` and `export` read."""

from __future__ import annotations

import functools
import io
import json
import warnings
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from mutate import archive
from target import BOTH, Target, as_json, finite

from dipc_gym import compensators, controllers, estimators, runs
from dipc_gym.compensators import LLNF, CompensatorError, FitFigures, InputRange
from dipc_gym.controllers import ControllerError
from dipc_gym.controllers.normalisation import Statistics
from dipc_gym.dataflow import NoForm
from dipc_gym.estimators.files import EstimatorError
from dipc_gym.export import bundle
from dipc_gym.identification import Sweep
from dipc_gym.plant import Plant
from dipc_gym.policy import Evaluation, Policy

OBSERVATION = np.array([0.01, 0.02, -0.01, 0.1, -0.2, 0.3])


def _policy(name: str) -> Callable[[Path], Any]:
    def read(folder: Path) -> None:
        brain = controllers.load(str(folder / name))
        with np.errstate(all="ignore"):
            finite(brain.force(OBSERVATION))

    return read


@functools.cache
def own_policy() -> bytes:
    """A policy of two small layers."""
    rng = np.random.default_rng(1)
    layers = ((rng.standard_normal((4, 6)), np.zeros(4)), (rng.standard_normal((1, 4)), np.zeros(1)))
    tried = Evaluation(80.0, (1, 2), (80.0, 40.0), 0.9)
    return as_json(Policy(layers=layers, commands="force", limit=40.0, compensator="llnf", evaluation=tried).to_dict())


@functools.cache
def _sb3_policy() -> bytes:
    import torch

    rng = torch.Generator().manual_seed(1)
    tensors = {
        "mlp_extractor.policy_net.0.weight": torch.randn((4, 6), generator=rng),
        "mlp_extractor.policy_net.0.bias": torch.zeros(4),
        "action_net.weight": torch.randn((1, 4), generator=rng),
        "action_net.bias": torch.zeros(1),
    }
    weights, out = io.BytesIO(), io.BytesIO()
    torch.save(tensors, weights)
    data = {"policy_kwargs": {}, "use_sde": False, "action_space": {"low": "[-60.]", "high": "[60.]"}}
    with zipfile.ZipFile(out, "w") as file:
        file.writestr("data", json.dumps(data))
        file.writestr("policy.pth", weights.getvalue())
    return out.getvalue()


def _statistics() -> bytes:
    held = Statistics(np.full(6, 0.1), np.full(6, 0.04), 1000.0)
    numbers = {"mean": held.mean.tolist(), "variance": held.variance.tolist(), "count": held.count}
    return as_json({"schema": "dipc-gym/statistics/1", **numbers, "epsilon": held.epsilon, "clip": held.clip})


def _compensator(folder: Path) -> None:
    made = compensators.load(folder / "made.json")
    with np.errstate(all="ignore"):
        finite(made.voltage(1.0, 0.01), made.voltage(-1.0, -0.01))


def llnf() -> dict[str, Any]:
    """A compensator of two neurons."""
    ranges = tuple(InputRange(low, high) for low, high in ((-50.0, 50.0), (-1.0, 1.0), (-1.0, 1.0)))
    made = LLNF(
        centres=((-20.0, 0.0, 0.0), (20.0, 0.0, 0.0)),
        sigmas=((20.0, 1.0, 1.0), (20.0, 1.0, 1.0)),
        levels=(-6.0, 6.0),
        slopes=((0.25, 1.0, 0.5), (0.25, 1.0, -0.5)),
        ranges=ranges,
        figures=FitFigures(0.1, 0.2, 50, 50),
    )
    return made.to_dict()


def _exported(folder: Path) -> None:
    """What `export` writes of a policy and a compensator."""
    made = {"controller": None, "compensator": str(folder / "made.json"), "force_limit": None}
    found = bundle.bundle(folder / "p.json", Plant(), **made)
    with np.errstate(all="ignore"):
        bundle.write_c(found, folder / "rig.h")


@functools.cache
def estimator() -> dict[str, Any]:
    """One that has learned friction from a short run."""
    return runs.identify(sweep=Sweep(duration=8.0)).fit_estimator("ekf").to_dict()


def _estimator(folder: Path) -> None:
    made = estimators.load(folder / "made.json")
    made = estimators.load(made.to_dict() | {"kind": "moving_horizon"}) if made.name == "kalman" else made
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        course = runs.balance(controllers.load("lqr"), compensators.load(llnf()), seconds=0.05, seed=0, estimator=made)
    finite(course.force, course.voltage)


TARGETS: dict[str, Callable[[], Target]] = {
    "policy.json": lambda: Target({"p.json": own_policy()}, {"p.json": BOTH}, _policy("p.json"), (ControllerError,)),
    "policy.zip": lambda: Target(
        {"p.zip": _sb3_policy(), "p.statistics.json": _statistics()},
        {"p.zip": (archive,)},
        _policy("p.zip"),
        (ControllerError,),
    ),
    "statistics": lambda: Target(
        {"p.zip": _sb3_policy(), "p.statistics.json": _statistics()},
        {"p.statistics.json": BOTH},
        _policy("p.zip"),
        (ControllerError,),
    ),
    "compensator": lambda: Target(
        {"made.json": as_json(llnf())}, {"made.json": BOTH}, _compensator, (CompensatorError,)
    ),
    "estimator": lambda: Target(
        {"made.json": as_json(estimator())}, {"made.json": BOTH}, _estimator, (EstimatorError,)
    ),
    "policy to export": lambda: Target(
        {"p.json": own_policy(), "made.json": as_json(llnf())},
        {"p.json": BOTH, "made.json": BOTH},
        _exported,
        (ControllerError, CompensatorError, NoForm),
    ),
}
