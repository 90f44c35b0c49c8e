"""Every estimator under every controller and compensator that can be exported: C in either precision, and ONNX."""

from __future__ import annotations

import dataclasses
import itertools
import subprocess
from pathlib import Path
from typing import Any

import loops
import numpy as np
import pytest
from loops import FLAGS, GCC, LIMIT, PERIOD, READINGS, SUPPLY, WORDS, needs_compiler
from rounding import bounded

from dipc_gym import compensators, controllers, estimators, policy
from dipc_gym.compensators import (
    HILOMOT,
    Compensator,
    Curve,
    DisturbanceObserver,
    Friedland,
    LaggedLLNF,
    MaxwellSlip,
    Observed,
    StaticGain,
    Stribeck,
)
from dipc_gym.dataflow import NoForm, Program
from dipc_gym.export import c, onnx
from dipc_gym.export.parts import Loop
from dipc_gym.plant import Plant

RUNS, PERIODS = 2, 120
COMPENSATORS: dict[str, Compensator] = {
    "none": StaticGain(4.0),
    "feedforward": loops.feedforward(),
    "mlp": loops.mlp(),
    "llnf": loops.llnf(),
    "curve": Curve((-1.0, -0.01, 0.01, 1.0), (-8.0, -8.0, 8.0, 8.0), (-4.0, 4.0), (-1.0, 1.0)),
    "hilomot": HILOMOT(((0.1, 0.02, 80.0, -40.0),), ((1.0,), (-1.0,)), ((1.8, 0.25, 1.0, 0.2), (-2.1, 0.24, 0.5, 0.1))),
    "stribeck": Stribeck(0.25, 2.0, 0.7, 0.3, 0.01, 0.012, 0.04),
    "lugre": loops.lugre(),
    "history": loops.history(),
    "history_adapted": compensators.AdaptedHistory(
        **{
            column.name: getattr(loops.history(), column.name)
            for column in dataclasses.fields(loops.history())
            if column.init and column.name not in ("ranges", "figures", "supply")
        }
    ),
    "maxwell_slip": MaxwellSlip(
        4.0, 24.0, 0.005, (2e-5, 1e-4, 4e-4), (2.0, 4.0, 2.0), (0.5, 1.0, 0.0), bump_velocity=0.02, per_velocity=1.0
    ),
    "friedland": Friedland(4.0, 24.0, 0.005, level=6.0, rate=3.0, sign_velocity=0.02, mass=1.26, viscous=40.0),
    "disturbance_observer": DisturbanceObserver(4.0, 24.0, 0.005, share=0.3, mass=1.26, viscous=40.0),
    "llnf_lagged": LaggedLLNF(
        *(4.0, 24.0, 0.005, (0.0, 5.0, 7.0)),
        centres=((5.0, 0.1, 0.1), (-5.0, -0.1, -0.1)),
        sigmas=((8.0, 0.2, 0.3), (6.0, 0.3, 0.2)),
        levels=(1.2, -1.3),
        slopes=((0.25, 8.0, 0.5), (0.24, 9.0, -0.5)),
    ),
    "observed": Observed(4.0),
}
NO_FORM = {"ideal", "llnf_adaptive"}
SEEING = {name: loops.seeing(name) for name in ("differences", "kalman", "disturbance", "ekf")}
BLIND = {"kalman_friction", "moving_horizon", "rigid_body"}


def pairs() -> list[tuple[str, str, str]]:
    """Names of all loops: LQR designs with every pair, policies with what they were trained with."""
    found = [
        (estimator, controller, compensator)
        for estimator, controller, compensator in itertools.product(SEEING, ("lqr", "lqr_cart"), COMPENSATORS)
        if compensator != "observed" or SEEING[estimator].observes_friction
    ]
    found += [("differences", "ppo-llnf", "llnf"), ("differences", "ppo-none", "none")]
    return [*found, ("disturbance", "ppo-observed", "observed")]


@dataclasses.dataclass(frozen=True, eq=False)
class Made:
    """A loop, the readings of rigs that its parts balance in Python, and the voltages that they give."""

    name: str
    program: Program
    rows: np.ndarray
    volts: np.ndarray


@pytest.fixture(scope="module")
def made() -> list[Made]:
    found = []
    for estimator, controller, compensator in pairs():
        named = controller.startswith("ppo")
        brain: Any = policy.shipped(controller) if named else controllers.balancing(controller)
        seeing, hand = SEEING[estimator], COMPENSATORS[compensator]
        rows, volts = loops.on_rigs(seeing, brain, hand, Plant(), RUNS, PERIODS)
        assert rows.shape[1] > 0, "no rig stood"
        program = Loop(seeing, brain, hand, LIMIT, SUPPLY, PERIOD).program()
        found.append(Made(f"{estimator}, {controller}, {compensator}", program, rows[:, :1], volts[:, :1]))
    return found


def test_whatever_has_no_form_is_known() -> None:
    """A part that gains a form has to be tried here."""
    assert set(COMPENSATORS) | NO_FORM == set(compensators.names())
    assert set(SEEING) | BLIND == set(estimators.names())
    for name in BLIND:
        with pytest.raises(NoForm):
            Loop(loops.seeing(name), controllers.balancing("lqr"), StaticGain(4.0), LIMIT, SUPPLY, PERIOD).program()


def one_program(folder: Path, made: list[Made], *, single: bool) -> Path:
    """All headers in one program. It reads a memory and three readings; it writes the voltage and the next memory."""
    cases = []
    for i, loop in enumerate(made):
        words = c.Header(f"p{i}", inputs=dict.fromkeys(READINGS, "a number"), **WORDS)
        (folder / f"p{i}.h").write_text(c.header(loop.program, words))
        size = sum(len(numbers) for numbers in loop.program.memory().values())
        cases.append(f"    if (which == {i}) RUN(p{i}, {size})")
    define = "".join(f"#define P{i}_FLOAT\n" for i in range(len(made))) if single else ""
    includes = "".join(f'#include "p{i}.h"\n' for i in range(len(made)))
    (folder / "main.c").write_text(
        f"{define}#include <stdio.h>\n#include <stdlib.h>\n{includes}"
        "#define RUN(p, size) { p##_state state; double row[size + 3], out[size + 1]; int i; \\\n"
        "    p##_real *memory = (p##_real *)(void *)&state; \\\n"
        "    while (fread(row, sizeof row, 1, stdin) == 1) { \\\n"
        "        for (i = 0; i < size; i++) memory[i] = (p##_real)row[i]; \\\n"
        "        out[0] = (double)p##_step(&state, (p##_real)row[size], (p##_real)row[size + 1], "
        "(p##_real)row[size + 2]); \\\n"
        "        for (i = 0; i < size; i++) out[i + 1] = (double)memory[i]; \\\n"
        "        fwrite(out, sizeof out, 1, stdout); } }\n"
        "int main(int count, char **arguments)\n{\n"
        "    const int which = count > 1 ? atoi(arguments[1]) : -1;\n" + "\n".join(cases) + "\n    return 0;\n}\n"
    )
    name = folder / ("single" if single else "double")
    subprocess.run([str(GCC), *FLAGS, "main.c", "-o", str(name), "-lm"], cwd=folder, check=True)
    return name


def flat(memory: dict[str, np.ndarray]) -> np.ndarray:
    """(runs, numbers) of a memory, in the order of the struct."""
    return np.concatenate([memory[name] for name in memory]).T


def steps(loop: Made) -> tuple[np.ndarray, dict[str, np.ndarray], dict[str, np.ndarray]]:
    """What a program gets in each period as Python runs it: as rows for C, and as inputs and memories side by side."""
    memory, kept = loop.program.memory(), []
    for row in loop.rows:
        kept.append(memory)
        _, memory = loop.program.run({name: row[:, k] for k, name in enumerate(READINGS)}, memory)
    memories = {name: np.concatenate([each[name] for each in kept], axis=1) for name in kept[0]}
    inputs = {name: loop.rows[:, 0, k] for k, name in enumerate(READINGS)}
    return np.concatenate([flat(memories), loop.rows[:, 0]], axis=1), inputs, memories


@needs_compiler
def test_c_is_python_step_by_step_in_either_precision(tmp_path: Path, made: list[Made]) -> None:
    """From the memory that Python has in a period, C gives voltage and memory as exactly as rounding lets it.

    In double precision that is to 1e-9 after all periods, too. In single precision, the bound is worked out beside
    every period; see `rounding`.
    """
    double, single = (one_program(tmp_path, made, single=single) for single in (False, True))
    bounds = []
    for i, loop in enumerate(made):
        table, inputs, memories = steps(loop)
        outputs, ahead = bounded(loop.program, inputs, memories)
        results = [outputs["voltage"], *ahead.values()]
        expected, bound = (np.concatenate([result[k] for result in results]).T for k in (0, 1))
        found = {}
        for binary in (double, single):
            done = subprocess.run([str(binary), str(i)], input=table.tobytes(), capture_output=True, check=True)
            found[binary] = np.frombuffer(done.stdout).reshape(expected.shape)
        np.testing.assert_allclose(found[double][:, 0], loop.volts[:, 0], rtol=0, atol=1e-9, err_msg=loop.name)
        np.testing.assert_allclose(found[double], expected, rtol=1e-12, atol=1e-12, err_msg=loop.name)
        sure = np.isfinite(bound)
        assert sure[:, 0].mean() > 0.9, loop.name  # rounding turns few comparisons
        missed = np.abs(found[single] - expected)
        assert (missed <= bound)[sure].all(), f"{loop.name}: {(missed / bound)[sure].max():.3g} times the bound"
        bounds.append(np.median(bound[:, 0][sure[:, 0]]))
    assert max(bounds) < 0.05  # V; a bound that allowed everything would show nothing
    assert np.median(bounds) < 0.01


@needs_compiler
def test_the_bound_of_rounding_notices_a_number_that_is_off_by_a_ten_thousandth(tmp_path: Path) -> None:
    right, wrong = (
        Loop(SEEING["kalman"], controllers.balancing("lqr"), StaticGain(gain), LIMIT, SUPPLY, PERIOD).program()
        for gain in (4.0, 4.0004)
    )
    rows, volts = loops.on_rigs(SEEING["kalman"], controllers.balancing("lqr"), StaticGain(4.0), Plant(), 1, 50)
    binary = one_program(tmp_path, [Made("wrong", wrong, rows, volts)], single=True)
    table, inputs, memories = steps(Made("right", right, rows, volts))
    value, off = bounded(right, inputs, memories)[0]["voltage"]
    done = subprocess.run([str(binary), "0"], input=table.tobytes(), capture_output=True, check=True)
    given = np.frombuffer(done.stdout).reshape(len(table), -1)[:, 0]
    assert np.mean(np.abs(given - value[0]) > off[0]) > 0.2


def test_onnx_runtime_gives_the_voltages_of_python(made: list[Made]) -> None:
    onnxruntime = pytest.importorskip("onnxruntime")
    pytest.importorskip("onnx")
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    for loop in made:
        session = onnxruntime.InferenceSession(onnx.graph(loop.program, about="test"), options)
        state = np.array(session.get_modelmeta().custom_metadata_map["first_state"].split(), dtype=np.float64)
        volts = []
        for row in loop.rows[:80, 0]:
            given = {name: row[k : k + 1] for k, name in enumerate(READINGS)}
            (now,), state = session.run(["voltage", "next_state"], {**given, "state": state})
            volts.append(now)
        np.testing.assert_allclose(np.ravel(volts), loop.volts[:80, 0], rtol=0, atol=1e-9, err_msg=loop.name)
