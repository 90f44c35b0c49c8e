"""Loops exported to C and ONNX: the same voltages as in Python, whatever the readings are."""

from __future__ import annotations

import dataclasses
import math
import subprocess
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any, Self

import numpy as np
import pytest
from loops import (
    DIFFERENCE,
    GCC,
    LIMIT,
    PERIOD,
    RUNS,
    STRICT,
    SUPPLY,
    WORDS,
    compiled,
    feedforward,
    history,
    in_c,
    in_numpy,
    in_python,
    llnf,
    lugre,
    mlp,
    needs_compiler,
    on_rigs,
    readings,
    seeing,
)

from dipc_gym import cli, compensators, controllers, estimators, policy
from dipc_gym.compensators import Compensator, Ideal, Observed, RigConstants, Samples, StaticGain
from dipc_gym.controllers import LQR, SB3Policy
from dipc_gym.dataflow import NoForm, Program, Value, operations
from dipc_gym.env import DoublePendulumEnv
from dipc_gym.export import bundle, c, onnx
from dipc_gym.export.parts import READINGS, Loop
from dipc_gym.plant import Plant

PAIRS = {
    "lqr, none": (LQR(), StaticGain(newtons_per_volt=4.0)),
    "lqr, feedforward": (LQR(), feedforward()),
    "lqr, mlp": (LQR(), mlp()),
    "lqr, llnf": (LQR(), llnf()),
    "policy of force, llnf": (policy.shipped("ppo-llnf"), llnf()),
    "policy of voltage": (policy.shipped("ppo-none"), StaticGain(newtons_per_volt=4.0)),
}


@needs_compiler
@pytest.mark.parametrize("pair", PAIRS)
def test_c_gives_the_voltages_of_python_on_a_hundred_thousand_readings(tmp_path: Path, pair: str) -> None:
    controller, compensator = PAIRS[pair]
    program = Loop(DIFFERENCE, controller, compensator, LIMIT, SUPPLY, PERIOD).program()
    rows = readings()
    expected = in_python(controller, compensator, rows)
    volts = in_c(compiled(tmp_path, program), rows)
    single = in_c(compiled(tmp_path, program, single=True), rows)
    for given in (volts, single):
        assert given.shape == rows.shape[:2]
        assert (np.abs(given) <= SUPPLY).all()  # also that there is no NaN among them
    like_a_rig = (np.abs(rows) < 0.05).all(axis=2)
    np.testing.assert_allclose(volts, expected, rtol=0, atol=1e-11)
    np.testing.assert_allclose(volts[like_a_rig], expected[like_a_rig], rtol=0, atol=1e-12)
    # Single precision rounds 2^29 times as coarsely; against NumPy in single precision, only exp and tanh differ.
    np.testing.assert_allclose(single, in_numpy(program, rows, np.float32), rtol=0, atol=1e-3)
    np.testing.assert_allclose(single[like_a_rig], expected[like_a_rig], rtol=0, atol=1e-3)
    moving = (np.abs(expected) < SUPPLY) & (expected != 0)
    assert moving.mean() > 0.5  # most are neither limited nor broken


@needs_compiler
def test_a_broken_reading_is_a_period_without_voltage_and_nothing_else(tmp_path: Path) -> None:
    """Time goes on meanwhile: the next reading is no jump, as it would be after one that had stood still."""
    binary = compiled(tmp_path, Loop(DIFFERENCE, LQR(), llnf(), LIMIT, SUPPLY, PERIOD).program())
    rows = 0.003 * np.sin(0.05 * np.arange(200)[:, None, None] * [1.0, 1.3, 1.7])
    clean = in_c(binary, rows)
    for broken in (np.nan, np.inf, -1e300, 1001.0):
        struck = rows.copy()
        struck[90:93, 0, 1] = broken
        volts = in_c(binary, struck)
        assert (volts[90:93] == 0.0).all()
        np.testing.assert_array_equal(volts[:90], clean[:90])
        assert np.abs(volts[93:] - clean[93:]).max() < 0.1 * np.ptp(clean)
        np.testing.assert_allclose(volts[140:], clean[140:], atol=1e-6)
        early = np.concatenate([struck[90:93], rows])
        np.testing.assert_array_equal(in_c(binary, early)[3:], clean)


@needs_compiler
def test_a_reading_that_is_wild_but_possible_is_soon_forgotten(tmp_path: Path) -> None:
    binary = compiled(tmp_path, Loop(DIFFERENCE, LQR(), llnf(), LIMIT, SUPPLY, PERIOD).program(), single=True)
    rows = 0.003 * np.sin(0.05 * np.arange(300)[:, None, None] * [1.0, 1.3, 1.7])
    struck = rows.copy()
    struck[100, 0, 1] = 999.0
    np.testing.assert_allclose(in_c(binary, struck)[200:], in_c(binary, rows)[200:], atol=1e-3)


class Overflowing:
    """An estimator whose memory leaves all bounds within a few periods."""

    def express(self, program: Program, readings: Value, voltage: Value, force: Value) -> Value:
        grown = program.state("grown", 1.0)
        program.update(grown, grown * 1e9)
        return program.join(readings, readings + grown - grown)


def test_a_memory_that_is_not_finite_is_reset() -> None:
    program = Loop(Overflowing(), LQR(), StaticGain(newtons_per_volt=4.0), LIMIT, SUPPLY, PERIOD).program()
    memory, grown = program.memory(), []
    for _ in range(12):
        outputs, memory = program.run({name: [0.001] for name in READINGS}, memory)
        grown.append(memory["grown"][0, 0])
        assert abs(outputs["voltage"][0, 0]) <= SUPPLY
    assert grown[:5] == pytest.approx([1e9, 1e18, 1e27, 1.0, 1e9])


@needs_compiler
def test_hyperbolic_tangent_and_sigmoid_are_exact_to_rounding(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    x = rng.choice([-1, 1], 20_000) * 10.0 ** rng.uniform(-12, 3, 20_000)
    rows = np.concatenate([x, [0.0, 0.5, -0.5, np.nextafter(0.5, 0), 1e308, -1e308, np.inf, -np.inf]])[:, None, None]
    for name, expected in (("tanh", np.tanh(rows)), ("sigmoid", 1 / (1 + np.exp(np.minimum(-rows, 700.0))))):
        program = Program()
        program.update(program.state("unused", 0.0), value := program.input("x"))
        program.output("y", getattr(value, name)())
        values = in_c(compiled(tmp_path, program, inputs=("x",)), rows)
        np.testing.assert_allclose(values, expected[..., 0], rtol=1e-15, atol=1e-300)


@needs_compiler
def test_vectors_of_every_kind_go_through_c(tmp_path: Path) -> None:
    """A formula that no part has: every operation, sizes of one and more, a state that is a vector."""
    program = Program()
    a, b = program.input("a"), program.input("b")
    kept = program.state("kept", [1.0, -2.0, 0.5])
    mixed = program.join(a, b, a * b).affine(np.arange(12).reshape(4, 3) / 7, [0.1, 0.2, 0.3, 0.4])
    chosen = (mixed.part(1, 3) - kept).below(0.2).choose(kept * 2, mixed.part(0, 3) / 3)
    program.update(kept, chosen.clip(-5.0, 5.0))
    square, single = mixed.pick([0, 1, 1, 3]), program.join(a).affine([[0.3]], 0.1).pick([0, 0])
    whole = square.times(program.join(mixed.part(2), kept, single), 2)  # (2, 2) times (2, 3)
    halves = whole.times(whole.pick([0, 3, 1, 4, 2, 5]), 3, half=True)  # and that times itself, turned over
    dot, outer = kept.times(chosen, 3), square.part(0, 2).times(single, 1)
    result = halves.total() + whole.part(1) * dot - outer.least() * a.times(b, 1)
    result = result + abs(chosen).total() + mixed.least() * (-kept.part(2)).exp() + program.previous("a", a)
    program.output("y", result + (1 - a) / (2 + abs(b)) - program.first())
    rows = np.random.default_rng(4).normal(size=(300, 7, 2))
    memory, expected = program.memory(7), []
    for row in rows:
        outputs, memory = program.run({"a": row[:, 0], "b": row[:, 1]}, memory)
        expected.append(outputs["y"][0])
    values = in_c(compiled(tmp_path, program, inputs=("a", "b")), rows)
    np.testing.assert_allclose(values, expected, rtol=1e-13, atol=1e-13)


def test_products_are_those_of_matrices_and_are_counted() -> None:
    rng = np.random.default_rng(5)
    first, second = rng.normal(size=(4, 3)), rng.normal(size=(3, 5))
    program = Program()
    a, b = program.constant(first.ravel()), program.constant(second.ravel())
    turned = a.pick([3 * i + j for j in range(3) for i in range(4)])
    program.output("whole", a.times(b, 3))
    program.output("half", a.times(turned, 3, half=True))
    outputs, _ = program.run({}, {})
    np.testing.assert_allclose(outputs["whole"].reshape(4, 5), first @ second, rtol=0, atol=1e-14)
    np.testing.assert_allclose(outputs["half"][:, 0], (first @ first.T)[np.tril_indices(4)], rtol=0, atol=1e-14)
    assert program.cost() == {"multiplications": 3 * (20 + 10), "additions": 2 * (20 + 10)}
    for wrong in (lambda: a.times(b, 2), lambda: a.times(b, 0), lambda: a.times(b, 3, half=True), lambda: a.pick([12])):
        with pytest.raises(ValueError, match="entries"):
            wrong()


@needs_compiler
def test_fast_math_is_refused_by_the_header(tmp_path: Path) -> None:
    compiled(tmp_path, Loop(DIFFERENCE, LQR(), feedforward(), LIMIT, SUPPLY, PERIOD).program())
    done = subprocess.run(
        [str(GCC), "-std=c99", "-ffast-math", "main.c", "-lm"], cwd=tmp_path, capture_output=True, text=True
    )
    assert done.returncode != 0
    assert "compile without -ffast-math" in done.stderr


# ------------------------------------------------------------------------------------------------ parts


@dataclass(frozen=True)
class TwoWay(Compensator):
    """As in examples/own_compensator.py: it has a formula and knows nothing of exports."""

    name = "two_way"
    forward: float = 2.0

    @classmethod
    def fit(cls, samples: Samples, rig: RigConstants, *, seed: int = 0) -> Self:
        return cls()

    def volts(self, force: Any, velocity: Any, previous_velocity: Any) -> Any:
        (sign,) = compensators.elementwise(np.tanh, [velocity / 0.005])
        return 0.25 * force + self.forward * (1 + sign) / 2 - (velocity - previous_velocity)


class Deciding(TwoWay):
    def volts(self, force: Any, velocity: Any, previous_velocity: Any) -> Any:
        return force if velocity > 0 else -force


class Rooted(TwoWay):
    def volts(self, force: Any, velocity: Any, previous_velocity: Any) -> Any:
        return compensators.elementwise(np.sqrt, [force])[0]


class Remembering(TwoWay):
    def voltage(self, force: float, velocity: float) -> float:
        return force


def test_a_formula_of_ones_own_writes_itself() -> None:
    rows = readings()[:200]
    program = Loop(DIFFERENCE, LQR(), TwoWay(), LIMIT, SUPPLY, PERIOD).program()
    np.testing.assert_allclose(in_numpy(program, rows, np.float64), in_python(LQR(), TwoWay(), rows), atol=1e-11)


def test_dither_goes_on_from_period_to_period() -> None:
    """Where readings say that the rig is at rest upright, the wave alone is left."""
    program = Loop(DIFFERENCE, controllers.balancing("dither"), StaticGain(4.0), LIMIT, SUPPLY, PERIOD).program()
    shaking = controllers.balancing("dither")
    expected = [shaking.force(np.zeros(6)) / 4.0 for _ in range(30)]
    np.testing.assert_array_equal(in_numpy(program, np.zeros((30, 1, 3)), np.float64)[:, 0], expected)


@pytest.mark.parametrize(
    ("estimator", "controller", "compensator", "says"),
    [
        (DIFFERENCE, LQR(), Ideal(newtons_per_volt=4.0), "the compensator 'ideal' .* overrides `voltage`"),
        (DIFFERENCE, LQR(), Remembering(), "the compensator 'two_way' .* needs an `express` of its own"),
        (DIFFERENCE, LQR(), Deciding(), "the compensator 'two_way' .* decides by if"),
        (DIFFERENCE, LQR(), Rooted(), "the compensator 'two_way' .* has no .* sqrt"),
        (DIFFERENCE, LQR(np.full(6, np.nan)), TwoWay(), "the controller 'lqr' .* not finite"),
        (
            DIFFERENCE,
            SB3Policy("mine", (), np.tanh, False, -1.0, 1.0),
            TwoWay(),
            r"the controller 'mine' \(SB3Policy\)",
        ),
        (object(), LQR(), TwoWay(), r"the estimator 'object' \(object\) has no form"),
    ],
)
def test_a_part_without_a_form_is_named(estimator: Any, controller: Any, compensator: Any, says: str) -> None:
    with pytest.raises(NoForm, match=says):
        Loop(estimator, controller, compensator, LIMIT, SUPPLY, PERIOD).program()


def test_a_number_beyond_single_precision_is_refused() -> None:
    program = Loop(DIFFERENCE, LQR(), StaticGain(newtons_per_volt=1e40), LIMIT, SUPPLY, PERIOD).program()
    with pytest.raises(NoForm, match="too large for single precision"):
        c.header(program, c.Header("x", inputs=dict.fromkeys(READINGS, ""), **WORDS))


@pytest.mark.parametrize("models", [1, 7])
def test_the_cost_of_an_llnf_is_counted(models: int) -> None:
    """By hand: 3 differences, 2 sums of squares, 3 of outputs, 1 exponent, and two totals for each local model."""
    costs = [
        Loop(DIFFERENCE, LQR(), part, LIMIT, SUPPLY, PERIOD).program().cost()
        for part in (llnf(models), llnf(2 * models))
    ]
    more = costs[1] - costs[0]
    expected = {"additions": 11, "multiplications": 10, "exponentials": 1, "comparisons": 1}
    assert more == {kind: count * models for kind, count in expected.items()}
    assert costs[0]["exponentials"] == models


@pytest.mark.parametrize(
    ("estimator", "says"),
    [
        ("disturbance", "89 additions and 91 multiplications"),
        ("ekf", "1,427 additions, 1,572 multiplications, 16 divisions and 6 exponentials"),
    ],
)
def test_the_costs_on_the_page_are_those_of_the_pairs(estimator: str, says: str) -> None:
    program = Loop(seeing(estimator), controllers.balancing("lqr_cart"), Observed(4.0), LIMIT, SUPPLY, PERIOD).program()
    assert says in (Path(__file__).parents[1] / "docs" / "rig.md").read_text()
    counts = [part.split() for part in says.replace(" and ", ", ").split(", ")]
    assert all(program.cost()[kind] == int(count.replace(",", "")) for count, kind in counts)


def test_values_that_do_not_belong_together_are_refused() -> None:
    one, other = Program(), Program()
    with pytest.raises(ValueError, match="2 and 3 entries do not go together"):
        one.constant([1.0, 2.0]) + one.constant([1.0, 2.0, 3.0])
    with pytest.raises(ValueError, match="another program"):
        one.constant(1.0) + other.constant(1.0)
    with pytest.raises(ValueError, match="entries 1 to 3 of a value of 2"):
        one.constant([1.0, 2.0]).part(1, 2)
    with pytest.raises(ValueError, match="weights are"):
        one.constant([1.0, 2.0]).affine(np.eye(3))
    with pytest.raises(ValueError, match="no state of 1"):
        one.update(one.state("s", [1.0, 2.0]), one.constant(1.0))


# ------------------------------------------------------------------------------------------------ what else sees


LATE = 0.0075
MOST = 709.0  # whose exponential is a number yet
OBSERVING = str(resources.files("dipc_gym") / "policies" / "ppo-observed.json")
SEEN = {
    "kalman, lugre": ("kalman", "lqr", lugre, 0.0),
    "disturbance, observed": ("disturbance", "lqr_cart", lambda: Observed(4.0), 0.0),
    "kalman of a late rig, history": ("kalman", "lqr", history, LATE),
    "disturbance of a late rig, observed": ("disturbance", "lqr", lambda: Observed(4.0), LATE),
    "differences, lugre": ("differences", "lqr", lugre, 0.0),
    "ekf, observed": ("ekf", "lqr_cart", lambda: Observed(4.0), 0.0),
    "ekf, lugre": ("ekf", "lqr", lugre, 0.0),
    "disturbance, observed, a policy that sees through it": ("disturbance", OBSERVING, lambda: Observed(4.0), 0.0),
}


@pytest.fixture
def exponentials_of_c(monkeypatch: pytest.MonkeyPatch) -> None:
    """NumPy's own differ in their last bit from processor to processor; those of Python are the C library's."""
    exp = np.vectorize(lambda x: math.exp(x) if x < MOST else math.inf, otypes=[np.float64])
    monkeypatch.setitem(operations._COMPUTED, "exp", exp)
    monkeypatch.setitem(operations._COMPUTED, "tanh", np.vectorize(math.tanh, otypes=[np.float64]))


@needs_compiler
@pytest.mark.usefixtures("exponentials_of_c")
@pytest.mark.parametrize("name", SEEN)
def test_c_gives_the_voltages_of_python_where_a_filter_sees(tmp_path: Path, name: str) -> None:
    kind, controller, make, delay = SEEN[name]
    estimator, brain, compensator = seeing(kind, delay), controllers.balancing(controller), make()
    program = Loop(estimator, brain, compensator, LIMIT, SUPPLY, PERIOD).program()
    rows, expected = on_rigs(estimator, brain, compensator, Plant(delay=delay))
    assert rows.shape[1] > 0.9 * RUNS
    volts = in_c(compiled(tmp_path, program), rows)
    # Friction is what the voltage does not explain, so the memory adds up voltages, and with them their rounding.
    np.testing.assert_allclose(volts, expected, rtol=0, atol=1e-8)
    wild = readings()
    for single, dtype in ((False, np.float64), (True, np.float32)):
        given = in_c(compiled(tmp_path, program, single=single), wild)
        assert (np.abs(given) <= SUPPLY).all()  # also that there is no NaN among them
        if not single:
            np.testing.assert_allclose(given, in_numpy(program, wild, dtype), rtol=0, atol=1e-9)


@pytest.mark.parametrize("name", SEEN)
def test_single_precision_balances_as_well(name: str) -> None:
    """What rounding gathers in the memory, the rig's own motion takes away: only in the closed loop can one see it."""
    kind, controller, make, delay = SEEN[name]
    program = Loop(seeing(kind, delay), controllers.balancing(controller), make(), LIMIT, SUPPLY, PERIOD).program()
    strayed = {}
    for dtype in (np.float64, np.float32):
        env, memory, cart = DoublePendulumEnv(plant=Plant(delay=delay)), program.memory(dtype=dtype), []
        env.reset(seed=0)
        for _ in range(2000):
            given = {name: np.array([x], dtype) for name, x in zip(READINGS, env.encoders, strict=True)}
            outputs, memory = program.run(given, memory, dtype)
            ended = env.step(outputs["voltage"][0].astype(np.float64))[2]
            assert not ended
            cart.append(env.state[0])
        strayed[dtype] = np.sqrt(np.mean(np.square(cart[400:])))
    assert strayed[np.float32] == pytest.approx(strayed[np.float64], rel=0.5)


@needs_compiler
def test_an_estimator_goes_along_from_its_file(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    compensators.save(Observed(4.0), "observed.json")
    arguments = ["export", "observed.json", "--estimator", "sees.json", "--controller", "lqr_cart", "--to", "c"]
    for name in ("ekf", "disturbance"):
        estimators.save(seeing(name), "sees.json")
        assert cli.main([*arguments, "--out", f"{name}.h"]) == 0
        assert f"Estimator: {name} of sees.json" in Path(f"{name}.h").read_text()
        for define in ([], [f"-D{name.upper()}_FLOAT"]):
            subprocess.run([str(GCC), *STRICT, *define, f"{name}_test.c", "-o", "check", "-lm"], check=True)
            assert subprocess.run(["./check"], capture_output=True).returncode == 0
    capsys.readouterr()
    assert cli.main(["export", "observed.json", "--to", "c", "--out", "blind.h"]) == 2
    assert "feeds forward the friction that an estimator observes" in capsys.readouterr().err
    Path("slow.json").write_text('{"control_period": 0.01}')
    assert cli.main([*arguments, "--plant", "slow.json", "--out", "slow.h"]) == 2
    assert "is for a control period of 5 ms, and the plant's is 10 ms" in capsys.readouterr().err
    for name, says in (
        ("rigid_body", "the estimator 'rigid_body' has no form that can be exported: it needs sine and cosine"),
        ("moving_horizon", "the estimator 'moving_horizon' (MovingHorizon) has no form"),
    ):
        estimators.save(seeing(name), "other.json")
        arguments[3] = "other.json"
        assert cli.main([*arguments, "--out", "other.h"]) == 2
        assert says in capsys.readouterr().err
    assert not any(Path(name).exists() for name in ("blind.h", "slow.h", "other.h"))


# ------------------------------------------------------------------------------------------------ ONNX


@pytest.mark.parametrize("pair", ["lqr, feedforward", "lqr, llnf", "policy of force, llnf"])
def test_onnx_runtime_gives_the_same_voltages(pair: str) -> None:
    onnxruntime = pytest.importorskip("onnxruntime")
    pytest.importorskip("onnx")
    program = Loop(DIFFERENCE, *PAIRS[pair], LIMIT, SUPPLY, PERIOD).program()
    session = onnxruntime.InferenceSession(onnx.graph(program, about="test"))
    kept = session.get_modelmeta().custom_metadata_map["first_state"]
    rows = readings()[:400, :4]
    expected = in_numpy(program, rows, np.float64)
    for run in range(rows.shape[1]):
        state = np.array(kept.split(), dtype=np.float64)
        for k, row in enumerate(rows[:, run]):
            given = {name: row[i : i + 1] for i, name in enumerate(READINGS)}
            (volts,), state = session.run(["voltage", "next_state"], {**given, "state": state})
            assert volts == pytest.approx(expected[k, run], abs=1e-11)


def test_every_operation_goes_through_onnx() -> None:
    onnxruntime = pytest.importorskip("onnxruntime")
    pytest.importorskip("onnx")
    program = Program()
    x = program.input("x")
    kept = program.state("kept", [0.5, -0.5])
    program.update(kept, program.join(x, x.sigmoid()))
    y = abs(x).exp() - x.tanh().maximum(kept).minimum(0.3).total() / 3 + (x - kept).least() * x.below(0.1)
    turned = program.join(kept, x).times(kept.pick([1, 0, 1]), 1).pick([8, 0, 4, 2])  # 4 of the 9 entries
    y = y + turned.times(turned.pick([0, 2, 1, 3]), 2, half=True).total()
    program.output("y", (x.within(0.7)).choose(y, -y).part(0))
    session = onnxruntime.InferenceSession(onnx.graph(program, about="test"))
    state, memory = onnx.first_state(program), program.memory()
    for x_now in np.linspace(-2, 2, 41):
        given = np.array([x_now])
        (y_now,), state = session.run(["y", "next_state"], {"x": given, "state": state})
        outputs, memory = program.run({"x": given}, memory)
        assert y_now == pytest.approx(outputs["y"][0, 0], abs=1e-14)
        np.testing.assert_allclose(state, memory["kept"][:, 0], atol=1e-15)


def test_without_onnx_it_says_how_to_install_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "onnx", None)
    with pytest.raises(ImportError, match=r"pip install '\.\[onnx\]'"):
        onnx.graph(Program(), about="")


# ------------------------------------------------------------------------------------------------ command line


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    compensators.save(llnf(), "llnf.json")
    compensators.save(feedforward(), "feedforward.json")
    compensators.save(Ideal(newtons_per_volt=4.0), "ideal.json")
    policy.shipped("ppo-llnf").save("force.json")
    policy.shipped("ppo-none").save("voltage.json")
    Path("broken.json").write_text('{"schema": "dipc-gym/compensator/1"')
    Path("odd.json").write_text("[1, 2]")
    return tmp_path


@needs_compiler
@pytest.mark.parametrize(
    "arguments",
    [
        ["llnf.json"],
        ["llnf.json", "--controller", "force.json"],
        ["force.json", "--compensator", "llnf.json", "--force-limit", "50"],
        ["voltage.json"],
    ],
)
def test_the_check_beside_the_header_passes(
    folder: Path, arguments: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["export", *arguments, "--to", "c", "--out", "My rig.h"]) == 0
    assert "my_rig_step" in capsys.readouterr().out
    for define in ([], ["-DMY_RIG_FLOAT"]):
        subprocess.run([str(GCC), *STRICT, *define, "My rig_test.c", "-o", "check", "-lm"], check=True)
        done = subprocess.run(["./check"], capture_output=True, text=True)
        assert done.returncode == 0, done.stdout
        assert "400 periods" in done.stdout


@needs_compiler
def test_the_loop_in_the_documentation_compiles(folder: Path) -> None:
    page = (Path(__file__).parents[1] / "docs" / "rig.md").read_text()
    code = page.split("```c\n")[1].split("```")[0]
    assert cli.main(["export", "llnf.json", "--to", "c", "--out", "rig.h"]) == 0
    Path("main.c").write_text(code)
    subprocess.run([str(GCC), *STRICT, "-c", "main.c"], check=True)


@needs_compiler
def test_the_check_fails_where_the_header_is_wrong(folder: Path) -> None:
    assert cli.main(["export", "feedforward.json", "--to", "c", "--out", "rig.h"]) == 0
    header = Path("rig.h").read_text()
    Path("rig.h").write_text(header.replace("rig_C(2.4)", "rig_C(2.4001)"))
    subprocess.run([str(GCC), "-std=c99", "rig_test.c", "-o", "check", "-lm"], check=True)
    assert subprocess.run(["./check"], capture_output=True).returncode == 1


def test_test_vectors_swing_and_say_nothing_where_a_reading_is_broken() -> None:
    program = Loop(DIFFERENCE, LQR(), llnf(), LIMIT, SUPPLY, PERIOD).program()
    table = bundle.vectors(program, Plant())
    broken = (np.abs(table[:, 1:4]) > 1000).any(axis=1)
    assert broken.sum() == 3
    assert (table[broken, 4] == 0).all()
    assert np.std(table[:, 4]) > 3
    assert np.mean(np.abs(table[:, 4]) < SUPPLY) > 0.5


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["llnf.json", "--to", "c", "--out", "rig.txt"], "--to c writes .h files"),
        (["llnf.json", "--to", "onnx", "--out", "rig.h"], "--to onnx writes .onnx files"),
        (["none.json", "--to", "c", "--out", "rig.h"], "none.json"),
        (["broken.json", "--to", "c", "--out", "rig.h"], "broken.json: not JSON"),
        (["odd.json", "--to", "c", "--out", "rig.h"], "odd.json: top level"),
        (["ideal.json", "--to", "c", "--out", "rig.h"], "the compensator 'ideal' has no form"),
        (["llnf.json", "--to", "c", "--out", "rig.h", "--controller", "pid"], "there is no controller 'pid'"),
        (["llnf.json", "--to", "c", "--out", "rig.h", "--compensator", "llnf.json"], "leave out --compensator"),
        (["llnf.json", "--to", "c", "--out", "rig.h", "--force-limit", "nan"], "give a positive number"),
        (["force.json", "--to", "c", "--out", "rig.h"], "say --compensator FILE.json"),
        (["force.json", "--to", "c", "--out", "rig.h", "--compensator", "feedforward.json"], "was trained with"),
        (["force.json", "--to", "c", "--out", "rig.h", "--controller", "lqr"], "leave out --controller"),
        (["feedforward.json", "--to", "c", "--out", "rig.h", "--controller", "force.json"], "was trained with"),
        (["voltage.json", "--to", "c", "--out", "rig.h", "--compensator", "llnf.json"], "commands voltage"),
        (["llnf.json", "--to", "c", "--out", "no/rig.h"], "there is no folder"),
    ],
)
def test_bad_input_is_one_line_and_leaves_no_file(
    folder: Path, arguments: list[str], says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    before = sorted(folder.iterdir())
    assert cli.main(["export", *arguments]) == 2
    said = capsys.readouterr().err
    assert says in said
    assert said.count("\n") == 1
    assert sorted(folder.iterdir()) == before


def test_the_supply_of_a_loop_is_no_larger_than_its_compensators(folder: Path) -> None:
    """Fitted on a rig of 6 V, exported for one of 24 V: what it answers beyond its own is no answer of it."""
    compensators.save(dataclasses.replace(feedforward(), supply=6.0), "weak.json")
    found = bundle.bundle("weak.json", DoublePendulumEnv().plant)
    assert found.loop.supply == 6.0
    strong = bundle.bundle("llnf.json", found.plant).loop
    assert found.loop.force_limit == pytest.approx(strong.force_limit * 6.0 / strong.supply)
    assert any("6 V." in line for line in found.about)


def test_what_a_loop_remembers_of_voltages_is_what_a_weaker_amplifier_lets_through(folder: Path) -> None:
    """An observer that went by what it asked for would book what the supply withheld as friction, and push harder."""
    observer = compensators.DisturbanceObserver(4.0, 24.0, 0.005, 0.5, 1.3, 20.0)
    compensators.save(dataclasses.replace(observer, supply=24.0), "observer.json")
    weak = dataclasses.replace(DoublePendulumEnv().plant, supply=6.0)
    loop = bundle.bundle("observer.json", weak).loop
    assert loop.supply == 6.0
    program = loop.program()
    memory = program.memory()
    for cart in (0.0, 0.1, 0.2):
        _, memory = program.run({"cart": [cart], "pole1": [0.1], "pole2": [0.1]}, memory)
        remembered = np.concatenate([np.ravel(one) for name, one in memory.items() if "applied" in name])
        assert len(remembered)
        assert np.abs(remembered).max() <= 6.0


def test_a_compensator_of_another_control_period_is_refused(folder: Path) -> None:
    compensators.save(compensators.LuGre(4.0, 24.0, 0.02, 2e4, 60.0, 8.0, 3.0, 0.02), "slow.json")
    with pytest.raises(ValueError, match="after 20 ms, and the control period is 5 ms"):
        bundle.bundle("slow.json", DoublePendulumEnv().plant)


def test_files_that_exist_are_kept(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    Path("rig_test.c").write_text("mine")
    assert cli.main(["export", "llnf.json", "--to", "c", "--out", "rig.h"]) == 2
    assert "rig_test.c exists" in capsys.readouterr().err
    assert not Path("rig.h").exists()
    assert Path("rig_test.c").read_text() == "mine"
