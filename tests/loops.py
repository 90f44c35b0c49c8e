"""Control loops that are exported in the tests: their parts, readings for them, and their voltages in Python and C."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dipc_gym import estimators, kernels
from dipc_gym.compensators import LLNF, MLP, Compensator, Feedforward, History, LuGre
from dipc_gym.controllers import LQR, lqr
from dipc_gym.dataflow import Program
from dipc_gym.env import DoublePendulumEnv
from dipc_gym.estimators import RigModel
from dipc_gym.estimators.differences import FilteredDifference
from dipc_gym.export import c
from dipc_gym.export.parts import READINGS
from dipc_gym.plant import Friction, Plant
from dipc_gym.vector import DIPCFrictionVectorEnv
from dipc_gym.wrappers import VectorEstimateState, VectorForceCommand

GCC = shutil.which("gcc") or shutil.which("cc")
STRICT = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic")
FLAGS = (*STRICT, "-Wshadow", "-Wconversion", "-Wdouble-promotion", "-O1")
needs_compiler = pytest.mark.skipif(GCC is None, reason="no C compiler")

LIMIT, SUPPLY, PERIOD, FILTER = 96.0, 24.0, 0.005, 0.01
DIFFERENCE = FilteredDifference(FILTER, PERIOD)
WORDS = {"title": "test", "about": ["test"], "output": "the voltage, V"}


def llnf(models: int = 12) -> LLNF:
    rng = np.random.default_rng(1)
    place = rng.uniform([-25, -0.6, -0.6], [25, 0.6, 0.6], (models, 3))
    width = rng.uniform([5, 0.05, 0.05], [20, 0.4, 0.4], (models, 3))
    slope = rng.normal([0.25, 20.0, -15.0], [0.02, 5.0, 5.0], (models, 3))
    return LLNF(_rows(place), _rows(width), tuple(rng.normal(0, 3, models).tolist()), _rows(slope))


def mlp() -> MLP:
    rng = np.random.default_rng(2)
    weights = rng.normal([0.05, 10.0, -8.0], [0.02, 5.0, 5.0], (5, 3))
    return MLP(_rows(weights), tuple(rng.normal(size=5).tolist()), tuple(rng.normal(0, 6, 5).tolist()))


def _rows(table: np.ndarray) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(row) for row in table.tolist())


def feedforward() -> Feedforward:
    return Feedforward(per_newton=0.27, coulomb=2.4, per_velocity=-1.1, offset=0.02, sign_velocity=0.013)


def seeing(name: str, delay: float = 0.0) -> estimators.Estimator:
    env = DoublePendulumEnv()
    rig = RigModel.of(*lqr.linear_model(env.model), env.plant, 4.0, delay)
    return estimators.kind(name)(rig, Friction(viscous=0.0))


def lugre() -> LuGre:
    return LuGre(4.0, SUPPLY, PERIOD, 2e4, 60.0, 8.0, 3.0, 0.02)


def history() -> History:
    rng = np.random.default_rng(3)
    inward = rng.normal(0, [0.03, 2.0, 0.3], (24, 3))
    direct, outs = (0.25, 10.0, 0.0), rng.normal(0, 0.5, 8)
    return History(4.0, SUPPLY, PERIOD, _rows(inward), _rows(rng.normal(0, 0.3, (24, 9))), tuple(outs.tolist()), direct)


RUNS, PERIODS = 100, 1000


def readings() -> np.ndarray:
    """(periods, runs, 3) readings of every size: as of a rig, far beyond it, and none at all."""
    rng = np.random.default_rng(0)
    size = 10.0 ** np.where(rng.random(RUNS) < 0.7, rng.uniform(-6, -2, RUNS), rng.uniform(-2, 3.1, RUNS))[:, None]
    rows = size * np.sin(np.cumsum(rng.normal(0, 0.2, (PERIODS, RUNS, 3)), axis=0))
    odd = np.array([np.nan, np.inf, -np.inf, 1e308, -1e308, 1e30, 1e3, -1e3, 999.0, 5e-324, 1e-40, 0.0, -0.0])
    struck = rng.random(rows.shape) < 0.005
    rows[struck] = rng.choice(odd, struck.sum())
    return rows


def in_python(controller: Any, compensator: Compensator, rows: np.ndarray) -> np.ndarray:
    """Voltages of the parts as they run in the environment, and what `Loop` says of broken readings."""
    keep, gain = kernels.velocity_gains(FILTER, PERIOD)
    last, rates, memory = np.full((RUNS, 3), np.nan), np.zeros((RUNS, 3)), compensator.initial_state(RUNS)
    volts, begun, before = np.zeros(rows.shape[:2]), np.zeros(RUNS, dtype=bool), np.zeros((RUNS, 6))
    for k, row in enumerate(rows):
        usable = (np.abs(row) < 1000).all(axis=1)
        now = np.where(usable[:, None], row, 0.0)
        now[:, 2] += now[:, 1]
        now = np.where(usable[:, None], now, np.clip(before[:, :3] + PERIOD * before[:, 3:], -1000, 1000))
        begun |= usable
        moved = kernels.velocity(now, np.where(np.isnan(last), now, last), rates, keep, gain)
        seen = np.column_stack([now, moved])
        force = np.array([controller.force(one) for one in seen]) if k % 50 == 0 else forces(controller, seen)
        asked, ahead = compensator.voltage_batch(np.clip(force, -LIMIT, LIMIT), moved[:, 0], memory)
        volts[k] = np.where(usable, np.clip(asked, -SUPPLY, SUPPLY), 0.0)
        last, rates, before = (
            np.where(begun[:, None], new, old) for new, old in ((now, last), (moved, rates), (seen, before))
        )
        memory = np.where(begun, ahead, memory)
    return volts


def forces(controller: Any, seen: np.ndarray) -> np.ndarray:
    if isinstance(controller, LQR):
        return -seen @ controller.gain
    return controller.command(seen) * (controller.newtons_per_volt if controller.commands == "voltage" else 1.0)


def compiled(folder: Path, program: Program, *, single: bool = False, inputs: tuple[str, ...] = READINGS) -> Path:
    """A program that reads rows (reset, inputs) of doubles from its input and writes outputs."""
    words = c.Header("loop", inputs=dict.fromkeys(inputs, "a number"), **WORDS)
    (folder / "loop.h").write_text(c.header(program, words))
    row = ", ".join(f"(loop_real)row[{i + 1}]" for i in range(len(inputs)))
    (folder / "main.c").write_text(
        '#include <stdio.h>\n#include "loop.h"\n'
        "int main(void)\n{\n"
        f"    loop_state state; double row[{len(inputs) + 1}], out;\n"
        "    loop_reset(&state);\n"
        "    while (fread(row, sizeof row, 1, stdin) == 1) {\n"
        "        if (row[0] > 0.5) loop_reset(&state);\n"
        f"        out = (double)loop_step(&state, {row});\n"
        "        fwrite(&out, sizeof out, 1, stdout);\n"
        "    }\n    return 0;\n}\n"
    )
    name = folder / ("single" if single else "double")
    define = ["-DLOOP_FLOAT"] if single else []
    subprocess.run([str(GCC), *FLAGS, *define, "main.c", "-o", str(name), "-lm"], cwd=folder, check=True)
    return name


def in_c(binary: Path, rows: np.ndarray) -> np.ndarray:
    """Voltages (periods, runs) of the compiled loop, which is reset before each run."""
    resets = np.zeros(rows.shape[:2])
    resets[0] = 1
    table = np.concatenate([resets[..., None], rows], axis=2).swapaxes(0, 1)
    out = subprocess.run([str(binary)], input=table.tobytes(), capture_output=True, check=True).stdout
    return np.frombuffer(out).reshape(rows.shape[1], -1).T


def in_numpy(program: Program, rows: np.ndarray, dtype: Any) -> np.ndarray:
    memory, volts = program.memory(rows.shape[1], dtype), []
    with np.errstate(over="ignore"):
        for row in rows:
            given = {name: row[:, i].astype(dtype) for i, name in enumerate(READINGS)}
            outputs, memory = program.run(given, memory, dtype)
            volts.append(outputs["voltage"][0])
    return np.array(volts, dtype=np.float64)


def on_rigs(
    estimator: estimators.Estimator,
    brain: Any,
    compensator: Compensator,
    plant: Plant,
    runs: int = RUNS,
    periods: int = PERIODS,
) -> Any:
    """Readings (periods, runs, 3) of rigs that the parts balance, as they run in the vector environment, and volts."""
    envs: Any = DIPCFrictionVectorEnv(runs, plant=plant, threads=1)
    inner, envs = envs, VectorForceCommand(VectorEstimateState(envs, estimator), compensator, force_limit=LIMIT)
    seen, _ = envs.reset(seed=0)
    rows, volts, stood = np.zeros((periods, runs, 3)), np.zeros((periods, runs)), np.ones(runs, dtype=bool)
    for k in range(periods):
        rows[k] = inner.encoders
        seen, _, ended, _, infos = envs.step(forces(brain, seen)[:, None])
        volts[k], stood = infos["voltage"], stood & ~ended
    envs.close()
    return rows[:, stood], volts[:, stood]
