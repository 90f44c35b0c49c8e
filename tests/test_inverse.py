"""The compensator that a model implies, and the curve that holds it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from dipc_gym import compensators
from dipc_gym.cli import main
from dipc_gym.compensators import CompensatorError, Curve, RigConstants, Samples
from dipc_gym.dataflow import Program
from dipc_gym.env import DoublePendulumEnv
from dipc_gym.identification.run import cart_model
from dipc_gym.plant import Friction, Plant
from dipc_gym.training import inverse

SOURCE = DoublePendulumEnv().source
FRICTIONLESS = Plant(friction=Friction(coulomb=0.0, static=0.0))


STIFF = SOURCE.text.replace('<joint name="cart"', '<joint name="cart" solreffriction="0.002 1"')
"""As a diagnosis writes dry friction; with MuJoCo's default it gives way below 6 mm/s."""


def law(text: str = SOURCE.text, plant: Plant | None = None) -> inverse.Law:
    return inverse.steady(cart_model(SOURCE.edited(text), Plant() if plant is None else plant))


def custom(name: str, data: str, text: str = SOURCE.text) -> str:
    entry = f'<custom><numeric name="dipc_gym:{name}" data="{data}"/></custom>'
    return text.replace("<worldbody>", f"{entry}\n  <worldbody>", 1)


# ------------------------------------------------------------------------------------------------- the law


def test_the_law_is_the_friction_of_the_model() -> None:
    """LuGre in steady motion: Coulomb plus Stribeck, whatever bristles do; drag and back-EMF are in the controller."""
    found = law()
    speed = np.abs(found.velocity)
    expected = np.sign(found.velocity) * (8 + 3 * np.exp(-((speed / 0.02) ** 2)))
    np.testing.assert_allclose(found.friction, expected, atol=0.06)  # bristles are integrated explicitly
    np.testing.assert_allclose(found.force, 4 * found.voltage, atol=1e-9)
    assert found.linear.viscous == pytest.approx(40.0)
    assert found.spread < 1e-6
    assert found.notes() == []


def test_a_tilt_is_a_load_that_stays_at_standstill() -> None:
    found = law(SOURCE.text.replace('gravity="0 0 -9.81"', 'gravity="1.5 0 -9.81"'))
    curve = found.curve(0.01)
    middle = curve.velocities.index(0.0)
    assert curve.friction[middle] == pytest.approx(-1.2599992 * 1.5, abs=0.05)
    far = np.array(curve.friction)[[0, -1]]
    np.testing.assert_allclose(far, np.array([-8.0, 8.0]) - 1.2599992 * 1.5, atol=0.05)


def test_a_law_of_free_shape_is_taken_as_its_mean_along_the_rail() -> None:
    found = law(custom("friction.position:cart", "-0.45 0.45 4 6 11", STIFF), FRICTIONLESS)
    at = np.interp([-0.27, 0.0, 0.27], [-0.45, 0.0, 0.45], [4.0, 6.0, 11.0])
    np.testing.assert_allclose(found.friction, np.sign(found.velocity) * at.mean(), rtol=0.01)
    assert found.spread == pytest.approx(np.ptp(at), rel=0.01)
    assert "differs by up to 4.2 N along the rail" in found.notes()[0]


def test_the_law_is_that_of_stock_mujoco_too() -> None:
    text = STIFF.replace('damping="20.8"', 'damping="20.8 3" frictionloss="6.5"')
    found = law(text, FRICTIONLESS)
    v = found.velocity
    expected = np.sign(v) * (6.5 + 3 * v**2) + 40 * v
    np.testing.assert_allclose(found.friction + found.linear.viscous * v, expected, atol=1e-6)


def test_a_dead_zone_is_jumped() -> None:
    found = law(custom("motor.deadzone:motor", "2.0"), FRICTIONLESS)
    arrives = np.sign(found.voltage) * np.maximum(np.abs(found.voltage) - 2.0, 0.0)
    np.testing.assert_allclose(found.force, 4 * arrives, atol=1e-9)
    curve = found.curve(0.01)
    for force in (-30.0, -3.0, 3.0, 30.0):
        assert curve.voltage(force, 0.0) == pytest.approx(force / 4 + 2 * np.sign(force), abs=0.02)
    assert curve.voltage(0.0, 0.0) == pytest.approx(0.0, abs=1e-9)


def test_what_no_compensator_can_see_is_said() -> None:
    plain = law(custom("motor.deadzone:motor", "0.0"), FRICTIONLESS)
    for effect, data in (("disturbance.periodic", "3.0 2.5 0.4"), ("disturbance.pulse", "3.0 0.05 10.0")):
        found = law(custom(f"{effect}:cart", data), FRICTIONLESS)
        assert found.notes() == [f"not in the compensator: {effect}"]
        np.testing.assert_array_equal(found.friction, plain.friction)


@given(st.floats(-60, 60), st.sampled_from([-1, 1]), st.floats(0.05, 0.9))
def test_the_model_after_its_compensator_is_the_identity(force: float, way: int, speed: float) -> None:
    curve, volts = IMPLIED, IMPLIED.volts(force, way * speed, way * speed)
    friction = way * (8 + 3 * np.exp(-((speed / 0.02) ** 2)))
    assert 4 * volts - friction == pytest.approx(force, abs=0.06)
    assert curve.voltage_batch(np.array([force]), np.array([way * speed]), curve.initial_state(1))[0] == volts


IMPLIED = law().curve(0.004)


@pytest.mark.parametrize(
    ("force", "says"),
    [(np.zeros(5), "does not rise"), (np.array([0.0, 1.0, 0.5, 2.0, 3.0]), "does not rise")],
)
def test_a_motor_that_cannot_be_turned_round_is_refused(force: np.ndarray, says: str) -> None:
    with pytest.raises(ValueError, match=says):
        inverse._turned(force, np.arange(5.0))


# ----------------------------------------------------------------------------------------------- the curve


def friction_run(seed: int = 0) -> Samples:
    rng = np.random.default_rng(seed)
    time = 0.005 * np.arange(6000)
    v = 0.5 * np.sin(time * (1 + 0.3 * time))
    volts = 12 * np.sin(time * (1 + 0.3 * time) + 0.7) + rng.normal(size=6000)
    force = 4 * volts - (8 + 3 * np.exp(-((v / 0.1) ** 2))) * np.tanh(v / 0.02) - 2.0
    return Samples(force, v, v, volts, time % 2 < 1)


def test_least_squares_find_a_friction_of_any_shape() -> None:
    rig = RigConstants(newtons_per_volt=4.0, viscous=40.0, supply_voltage=24.0)
    curve = compensators.fit("curve", friction_run(), rig)
    assert isinstance(curve, Curve)
    assert curve.commands[1] == pytest.approx(0.25, rel=0.01)
    v = np.concatenate([-np.geomspace(0.02, 0.45, 9), np.geomspace(0.02, 0.45, 9)])
    expected = (8 + 3 * np.exp(-((v / 0.1) ** 2))) * np.tanh(v / 0.02) + 2.0
    np.testing.assert_allclose(np.interp(v, curve.velocities, curve.friction), expected, atol=0.35)
    assert curve.figures is not None
    plain = compensators.fit("feedforward", friction_run(), rig).figures
    assert plain is not None
    assert curve.figures.test_mse < 0.3 * plain.test_mse  # which knows no Stribeck friction


@given(
    st.lists(st.floats(-100, 100), min_size=2, max_size=9, unique=True),
    st.integers(0, 1000),
    st.floats(-300, 300),
    st.floats(-3, 3),
)
def test_ramps_and_lines_are_one_curve(knots: list[float], seed: int, force: float, velocity: float) -> None:
    """The form that is exported and the one that runs here, within and beyond the knots."""
    rng = np.random.default_rng(seed)
    velocities = np.cumsum(rng.uniform(0.1, 1.0, len(knots))) - 2
    forces = np.arange(len(knots)) * 30.0 - 60
    parts = velocities, rng.normal(0, 8, len(knots)), forces, np.sort(rng.normal(0, 12, len(knots)))
    curve = Curve(*(tuple(part.tolist()) for part in parts))
    program = Program()
    program.output("volts", curve.express(program, program.input("force"), program.input("velocity")))
    outputs, _ = program.run({"force": [force], "velocity": [velocity]}, program.memory())
    assert outputs["volts"][0, 0] == pytest.approx(curve.voltage(force, velocity), abs=1e-9)


@pytest.mark.parametrize("field", ["velocities", "forces"])
def test_knots_that_do_not_increase_are_refused(field: str, tmp_path: Path) -> None:
    compensators.save(IMPLIED, path := tmp_path / "curve.json")
    assert compensators.load(path) == IMPLIED
    data = json.loads(path.read_text())
    data["parameters"][field][1] = data["parameters"][field][0]
    path.write_text(json.dumps(data))
    with pytest.raises(CompensatorError, match=rf"curve\.json: parameters: {field} must be two or more increasing"):
        compensators.load(path)


# -------------------------------------------------------------------------------------------- command line


def test_a_model_gives_its_compensator(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "improved.xml").write_text(custom("motor.deadzone:motor", "0.8"))
    out = tmp_path / "mine.json"
    assert main(["compensator", str(tmp_path / "improved.xml"), "--out", str(out)]) == 0
    said = capsys.readouterr().out
    assert "mine.json: curve" in said
    assert "friction 10.9 N at 0.003 m/s, 8 N at 1 m/s" in said
    made = compensators.load(out)
    assert made.voltage(20.0, 0.5) == pytest.approx((20 + 8) / 4 + 0.8, abs=0.03)
    assert made.figures is not None
    assert made.figures.test_mse < 2.0  # of voltages of 5.7 V rms; without friction compensation it is 5.2


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["none.xml", "--out", "new.json"], "none.xml"),
        (["plain.xml", "--out", "new.json"], "plain.xml: no actuator 'motor'"),
        (["plain.xml", "--out", "plain.xml"], "exists"),
        (["plain.xml", "--out", "no/new.json"], "there is no folder"),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(
    arguments: list[str], says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("plain.xml").write_text("<mujoco><worldbody><body><joint/><geom size='1'/></body></worldbody></mujoco>")
    assert main(["compensator", *arguments]) == 2
    said = capsys.readouterr().err
    assert says in said
    assert said.count("\n") == 1


@given(arrays(float, 60, elements=st.floats(0.0, 0.02)))
def test_a_motor_that_rises_has_an_inverse_that_rises(rises: np.ndarray) -> None:
    """Shallow stretches lie beside each other, and each is crossed within some force; the table goes one way."""
    assume(rises.max() > 1e-3)
    force = np.concatenate([[0.0], np.cumsum(rises)])
    forces, volts = inverse._turned(force - force[30], np.linspace(-24.0, 24.0, 61))
    assert (np.diff(forces) > 0).all()
    assert (np.diff(volts) >= 0).all()
