"""Every file that a command reads: a valid one, what damages it, and what the command does with it.

A reader gets the folder that holds the file. It reads, and then uses what it read as the command would, for a number
that passes the reader and breaks what follows is no better than a traceback.
"""

from __future__ import annotations

import functools
import io
import json
import random
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from mutate import archive, markup, octets, tree

from dipc_gym import ENV_ID, compensators, controllers, intact, mjcf, physics, recording, sweep
from dipc_gym.compensators import LLNF, CompensatorError, FitFigures, InputRange
from dipc_gym.controllers import ControllerError
from dipc_gym.controllers.normalisation import Statistics
from dipc_gym.experiments import robustness, tables
from dipc_gym.experiments.cells import Balancing, CompensatorTraining
from dipc_gym.identification import Sweep, cart, cart_model
from dipc_gym.mjcf import MjcfError
from dipc_gym.mjcf.edit import Document
from dipc_gym.places import PlaceError
from dipc_gym.plant import Plant, PlantError
from dipc_gym.policy import Evaluation, Policy
from dipc_gym.recording.tables import RecordingError, write_table
from dipc_gym.sim2real.model.parameters import fixed_masses, model_parameters
from dipc_gym.sweep import SweepError
from dipc_gym.training import train
from dipc_gym.training.seeds import PolicyTraining, keep
from dipc_gym.training.train import Recipe, Training, TrainingError

Damage = Callable[[bytes, random.Random], bytes]
OBSERVATION = np.array([0.01, 0.02, -0.01, 0.1, -0.2, 0.3])
MODEL = """<mujoco model="axis"><option timestep="0.002"/><worldbody><body><joint name="axis" damping="0.1"/>
<geom type="capsule" size="0.02 0.2" mass="0.5" contype="0" conaffinity="0"/></body></worldbody>
<actuator><motor name="motor" joint="axis" ctrlrange="-5 5"/></actuator>
<sensor><jointpos name="axis" joint="axis"/></sensor></mujoco>"""
CUSTOM = """<custom><numeric name="dipc_gym:motor.deadzone:motor" data="0.4"/>
<numeric name="dipc_gym:friction.wave:cart" data="2 0.5 0.5 0.3"/>
<numeric name="dipc_gym:friction.position:cart" data="-0.4 0.4 1 2 3"/>
<numeric name="dipc_gym:timing.sensor_lag:pole1" data="0.002"/>
<numeric name="dipc_gym:sensor.gain:pole2" data="1.01"/>
<numeric name="dipc_gym:friction.load:pole1" data="0.001 0.01 0.01"/>
<numeric name="dipc_gym:disturbance.periodic:pole2" data="0.01 2 0.1"/></custom></mujoco>"""


@dataclass(frozen=True)
class Target:
    """A kind of file.

    Attributes:
        files: a valid set, by path within the case's folder.
        damage: by path, how that file is damaged; one of them in each case.
        read: does what the command does with the folder.
        errors: what it may raise.
    """

    files: Mapping[str, bytes]
    damage: Mapping[str, tuple[Damage, ...]]
    read: Callable[[Path], Any]
    errors: tuple[type[Exception], ...]


def _json(value: Any) -> bytes:
    return json.dumps(value, indent=1).encode()


def _finite(*values: Any) -> None:
    if not all(np.isfinite(value).all() for value in values):
        raise AssertionError("what was read gives numbers that are not finite")


# --- recordings ---------------------------------------------------------------------------------------------------


def _recording(suffix: str) -> Callable[[Path], Any]:
    def read(folder: Path) -> None:
        found = recording.read(folder / f"run{suffix}", _axis(), units={"axis": "rad"})
        _finite(found.time, found.commands, found.sensors, found.period)

    return read


@functools.cache
def _axis() -> Any:
    return mjcf.compile(MODEL)


@functools.cache
def _table(suffix: str) -> bytes:
    import tempfile

    t = 0.01 * np.arange(60)
    with tempfile.TemporaryDirectory() as place:
        path = Path(place) / f"run{suffix}"
        write_table(path, {"time": t, "motor": np.sin(9 * t).round(4), "axis": np.cos(7 * t).round(5)})
        return path.read_bytes()


# --- models and plants -------------------------------------------------------------------------------------------


def _model(folder: Path) -> None:
    source = mjcf.read(folder / "rig.xml")
    given = physics.load(source)
    mjcf.check_supported(given.model, source.name)
    parameters = model_parameters(document := Document(source), given.model)
    fixed_masses(document, given.model, parameters)
    env = gymnasium.make(ENV_ID, model=folder / "rig.xml")
    _drive(env)
    inner: Any = env.unwrapped
    cart(cart_model(inner.source, inner.plant))


def _drive(env: Any) -> None:
    observation, info = env.reset(seed=1)
    _finite(observation, env.action_space.high, [v for v in info.values()])
    for volts in (1.0, -1.0):
        observation, reward, *_, info = env.step(np.array([volts]))
        _finite(observation, reward, [v for v in info.values()])


def _plant(folder: Path) -> None:
    _drive(gymnasium.make(ENV_ID, plant=folder / "plant.json"))


PLANT = Plant().to_dict() | {"schema": "dipc-gym/plant/1", "masses": {"cart": {"uniform": [1.0, 2.0]}}}
PLANT["friction"]["coulomb"] = {"normal": [8.0, 0.5]}

# --- controllers and compensators ----------------------------------------------------------------------------------


def _policy(name: str) -> Callable[[Path], Any]:
    def read(folder: Path) -> None:
        brain = controllers.load(str(folder / name))
        with np.errstate(all="ignore"):
            _finite(brain.force(OBSERVATION))

    return read


@functools.cache
def _own_policy() -> bytes:
    rng = np.random.default_rng(1)
    layers = ((rng.standard_normal((4, 6)), np.zeros(4)), (rng.standard_normal((1, 4)), np.zeros(1)))
    tried = Evaluation(80.0, (1, 2), (80.0, 40.0), 0.9)
    return _json(Policy(layers=layers, commands="force", limit=40.0, compensator="llnf", evaluation=tried).to_dict())


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
    parameters = {"mean": held.mean.tolist(), "variance": held.variance.tolist(), "count": held.count}
    return _json({"schema": "dipc-gym/statistics/1", **parameters, "epsilon": held.epsilon, "clip": held.clip})


def _compensator(folder: Path) -> None:
    made = compensators.load(folder / "made.json")
    with np.errstate(all="ignore"):
        _finite(made.voltage(1.0, 0.01), made.voltage(-1.0, -0.01))


def _llnf() -> dict[str, Any]:
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


# --- folders that a run goes on in ---------------------------------------------------------------------------------


@functools.cache
def _training_cell() -> CompensatorTraining:
    return CompensatorTraining(
        compensator="llnf", plant=Plant(), model=None, recording=None, sweep=Sweep(), seed=0, files={}
    )


@functools.cache
def _balancing() -> Balancing:
    return Balancing(
        controller="lqr", compensator="llnf", trained=_llnf(), plant=Plant(), model=None, seed=0, seconds=40.0,
        exact_state=False, files={},
    )  # fmt: skip


@functools.cache
def _endurance() -> Any:
    return robustness.plan([_balancing()], ["supply"])[0]


FIGURES = {
    **{"survived": True, "seconds": 40.0, "force_rms": 3.0, "voltage_rms": 2.0, "clipped_share": 0.0},
    **{"cart_m": 0.02, "pole1_deg": 0.5, "pole2_deg": 0.3},
}
RUN = {
    **FIGURES, "controller": "lqr", "compensator": "llnf", "trained_with": None, "seed": 0, "cost": 2e6,
    "cost_printed_q": 3e6, "test_mse": 0.2, "parameters": 20, "notes": [],
}  # fmt: skip


@functools.cache
def _cells() -> dict[str, bytes]:
    stood = [{"value": value, **FIGURES} for value in _endurance().values]
    files = {}
    for cell, result in ((_training_cell(), _llnf()), (_balancing(), RUN), (_endurance(), stood)):
        held = {"parameters": sweep.parameters(cell), "failure": None, "result": result}
        files[f"cells/{cell.name}.json"] = _json(intact.signed(held))
    return files


def _comparison(folder: Path) -> None:
    pairs = [("lqr", "llnf")]
    for cell in (_training_cell(), _balancing(), _endurance()):
        for outcome in sweep.finished([cell], folder / "cells"):
            if cell is _training_cell():
                compensators.load(outcome.result)
            elif cell is _balancing():
                held = tables.summarise({}, pairs, [outcome.result], [], True)
                json.dumps(held, allow_nan=False)
                tables.table(held)
            else:
                held = robustness.summarise([cell], [outcome], pairs)
                json.dumps(held, allow_nan=False)
                robustness.table(held)
    sweep.written(folder / "cells")


TINY = Training(
    compensator="none", seed=5, recipe=Recipe(steps=1_000, rigs=4, stage=250, rollout=125, batch=250, width=4)
)


def _policy_cells() -> dict[str, bytes]:
    cell = PolicyTraining.of(TINY)
    result = {"policy.json": _own_policy().decode(), "curve.csv": "steps\n1\n", "training.json": "{}"}
    held = {"parameters": sweep.parameters(cell), "failure": None, "result": result}
    return {f"sweep/trainings/{cell.name}.json": _json(intact.signed(held))}


def _policy_sweep(folder: Path) -> None:
    cell = PolicyTraining.of(TINY)
    for outcome in sweep.finished([cell], folder / "sweep" / "trainings"):
        keep(outcome, folder / "sweep")
        Policy.load(folder / "sweep" / cell.name / "policy.json")


def _resumed(folder: Path) -> None:
    train._folder(TINY, folder / "out", resume=True, overwrite=False)


@functools.cache
def _learner() -> Any:
    from dipc_gym.training.learner import Learner

    return Learner(TINY, train.Rig(None, "none", 24.0, 4.0), None)


@functools.cache
def _checkpoint() -> bytes:
    import torch

    out = io.BytesIO()
    look = {"steps": 1_000, "seconds": 1.0, "standing": 0, "held": 0.5, "reward": 0.1}
    torch.save({"schema": train.SCHEMA, "looks": [look], "learner": _learner().state()}, out)
    return out.getvalue()


def _restore(folder: Path) -> None:
    train.restore(_learner(), folder / "checkpoint.pt")


# --- trials --------------------------------------------------------------------------------------------------------


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
    diagnosis = _json(said)
    note = {
        "trial": "t001_cart", "tool": "t", "seconds": 5.0, "failure": None, "timed_out": False,
        "sensor_errors": {"cart": 1.9e-5}, "sensor_errors_own_step": {"cart": 2e-5},
    }  # fmt: skip
    contest = {name: {"error": 2.0, "seconds": 3.0} for name in ("sysid", "network")}
    identity = {"schema": "dipc-gym/trial/1", "seed": 1, "full": False, "plans": 1}
    return {
        **{f"trials/t001_cart/{name}": text for name, text in given.items()},
        "sealed/t001_cart.json": _json(intact.signed(answer | {"files": records.digests(given)})),
        "results/t001_cart/attempt.json": _json(intact.signed(note | {"files": {}})),
        "results/t001_cart/diagnosis.json": diagnosis,
        "results/t001_cart/rivals.json": _json(intact.signed(contest)),
        "generator.json": _json(intact.signed(identity)),
    }


def _trial(folder: Path) -> None:
    """What `trial` does when started again, up to the work itself."""
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
        json.dumps(publish._finite(scores), allow_nan=False)
        publish.markdown(scores, seed=1)
    if made and rivals._done(folder, plan.name) and not open_ones:
        row = rivals._row(folder, plan.name)
        rivals.markdown([row] if row else [], seed=1)


BOTH: tuple[Damage, ...] = (octets, tree)
TARGETS: dict[str, Callable[[], Target]] = {
    "recording.csv": lambda: Target(
        {"run.csv": _table(".csv")}, {"run.csv": (octets,)}, _recording(".csv"), (RecordingError,)
    ),
    "recording.parquet": lambda: Target(
        {"run.parquet": _table(".parquet")}, {"run.parquet": (octets,)}, _recording(".parquet"), (RecordingError,)
    ),
    "recording.npz": lambda: Target(
        {"run.npz": _table(".npz")}, {"run.npz": (archive,)}, _recording(".npz"), (RecordingError,)
    ),
    "model": lambda: Target(
        _rig(), {"rig.xml": (markup, markup, octets), "part.xml": (markup, octets)}, _model, (MjcfError, PlantError)
    ),
    "plant": lambda: Target(
        {"plant.json": _json(PLANT)}, {"plant.json": (tree, tree, octets)}, _plant, (PlantError, MjcfError)
    ),
    "policy.json": lambda: Target({"p.json": _own_policy()}, {"p.json": BOTH}, _policy("p.json"), (ControllerError,)),
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
        {"made.json": _json(_llnf())}, {"made.json": BOTH}, _compensator, (CompensatorError,)
    ),
    "comparison": lambda: Target(_cells(), dict.fromkeys(_cells(), BOTH), _comparison, (SweepError,)),
    "policy sweep": lambda: Target(
        _policy_cells(), dict.fromkeys(_policy_cells(), BOTH), _policy_sweep, (SweepError, ControllerError, PlaceError)
    ),
    "training.json": lambda: Target(
        {"out/training.json": _json(TINY.to_dict() | {"files": {}})},
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
"""Made when asked for, since some need torch."""


def _rig() -> dict[str, bytes]:
    from importlib import resources

    text = resources.files("dipc_gym").joinpath("rig.xml").read_text()
    text = text.replace("</mujoco>", '<include file="part.xml"/>' + CUSTOM)
    part = '<mujocoinclude><statistic extent="2"/><visual><global azimuth="90"/></visual></mujocoinclude>'
    return {"rig.xml": text.encode(), "part.xml": part.encode()}
