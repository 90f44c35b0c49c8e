"""A load that sits on a link: told from the motion of all joints, found by a diagnosis, written as a body."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from sim2real_rigs import RIGS, prepared

from dipc_gym import mjcf, physics
from dipc_gym.mjcf.edit import Document
from dipc_gym.recording import Recording
from dipc_gym.sim2real import diagnose
from dipc_gym.sim2real.effects import catalogue
from dipc_gym.sim2real.effects.shared.payloads import seat
from dipc_gym.sim2real.estimation import unexplained

# Two links in a plane, the second of which may carry something.
ARM = """<mujoco><option timestep="0.002" integrator="implicitfast"><flag contact="disable"/></option>
  <worldbody>
    <body name="upper" pos="0 0 1"><joint name="shoulder" axis="0 1 0" damping="0.3"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.4" size="0.03" mass="1.2"/>
      <body name="fore" pos="0 0 -0.4"><joint name="elbow" axis="0 1 0" damping="0.1"/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.35" size="0.025" mass="0.7"/>{load}
      </body></body></worldbody>
  <actuator><motor name="first" joint="shoulder"/><motor name="second" joint="elbow"/></actuator>
  <sensor><jointpos name="angle1" joint="shoulder"/><jointpos name="angle2" joint="elbow"/></sensor></mujoco>"""
# The last link turns about its own length, so that gravity pulls a load beside it to and fro.
WRIST = """<mujoco><option timestep="0.002" integrator="implicitfast"><flag contact="disable"/></option>
  <worldbody>
    <body name="fore" pos="0 0 1"><joint name="elbow" axis="0 1 0" damping="0.3"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.03" mass="1"/>
      <body name="hand" pos="0 0 -0.3"><joint name="wrist" axis="0 0 1" damping="0.02"/>
        <geom type="box" pos="0 0 -0.05" size="0.03 0.02 0.05" mass="0.4"/>{load}
      </body></body></worldbody>
  <actuator><motor name="first" joint="elbow"/><motor name="second" joint="wrist"/></actuator>
  <sensor><jointpos name="angle1" joint="elbow"/><jointpos name="angle2" joint="wrist"/></sensor></mujoco>"""
STRENGTH = {ARM: (4.0, 1.2), WRIST: (3.0, 0.05)}
NOISE = 1e-4  # rad


def ball(mass: float, place: tuple[float, float, float]) -> str:
    """What a link carries, as anybody would model it."""
    return (
        f'<body pos="{place[0]} {place[1]} {place[2]}"><geom type="sphere" size="0.02" mass="{mass}" '
        'contype="0" conaffinity="0"/></body>'
    )


def recorded(text: str, load: str, seed: int, seconds: float = 12.0) -> Recording:
    """What the arm does with a load, under sums of sines; simulated eight times as finely as it is sampled."""
    model = mujoco.MjModel.from_xml_string(text.format(load=load))
    model.opt.timestep, model.opt.integrator = 0.0005, mujoco.mjtIntegrator.mjINT_RK4
    data, rng = mujoco.MjData(model), np.random.default_rng(seed)
    rates, phases = np.exp(rng.uniform(-1.9, 0.5, (2, 5))), rng.uniform(0, 2 * np.pi, (2, 5))
    time = 0.004 * np.arange(round(seconds / 0.004))
    waves = np.sin(2 * np.pi * rates * time[:, None, None] + phases).sum(axis=2) / np.sqrt(5)
    commands = waves * STRENGTH[text] * np.minimum(time, 1.0)[:, None]
    readings = np.empty_like(commands)
    for k, command in enumerate(commands):
        readings[k], data.ctrl[:] = data.qpos, command
        mujoco.mj_step(model, data, 8)
    readings += NOISE * rng.normal(size=readings.shape)
    return Recording(f"seed {seed}", time, commands, readings, ("first", "second"), ("angle1", "angle2"))


def where_it_would_sit(text: str, load: str, body: str, joint: str) -> tuple[float, np.ndarray]:
    """A mass and its place that the motion of all joints asks for, before anything is simulated."""
    arm, run = physics.load(text.format(load="")), recorded(text, load, seed=3)
    ready = prepared(text.format(load=""), [run])
    evidence = unexplained.scene(arm, [run], ready.motions).at("joint", joint, {})
    found = seat(evidence, arm.model.body(body).id, [0, 1, 2] if text is WRIST else [0, 2], 0.5)
    return found[0]


@pytest.mark.parametrize(
    ("text", "body", "joint", "mass", "place"),
    [
        (ARM, "fore", "elbow", 0.1, (0.06, 0.0, -0.2)),
        (ARM, "fore", "elbow", 0.05, (0.0, 0.0, -0.35)),
        (WRIST, "hand", "wrist", 0.08, (0.05, 0.04, -0.1)),
    ],
)
def test_forces_tell_where_a_load_sits(
    text: str, body: str, joint: str, mass: float, place: tuple[float, float, float]
) -> None:
    told, where = where_it_would_sit(text, ball(mass, place), body, joint)
    assert told == pytest.approx(mass, rel=0.4)
    np.testing.assert_allclose(where, place, atol=0.03)


def test_forces_tell_no_load_where_all_is_known() -> None:
    arm, run = physics.load(ARM.format(load="")), recorded(ARM, "", seed=3)
    ready = prepared(ARM.format(load=""), [run])
    evidence = unexplained.scene(arm, [run], ready.motions).at("joint", "elbow", {})
    assert sum(mass for mass, _ in seat(evidence, arm.model.body("fore").id, [0, 2], 0.5)) < 1e-3


def test_a_load_is_asked_for_where_joints_feel_its_place() -> None:
    payload = catalogue()["load.payload"]
    arm, cart = mjcf.compile(ARM.format(load="")), physics.load(RIGS["hanging"]).model
    assert not payload.fits(arm, "shoulder")  # to one joint alone it is another mass and centre of mass
    assert payload.fits(arm, "elbow")
    assert not payload.fits(cart, "cart")  # what rides on a cart is mass of the cart
    assert payload.fits(cart, "pole2")


def test_it_has_no_place_along_an_axis_that_nothing_feels() -> None:
    arm, run = physics.load(ARM.format(load="")), recorded(ARM, ball(0.1, (0.06, 0.0, -0.2)), seed=3)
    ready = prepared(ARM.format(load=""), [run])
    scene = unexplained.scene(arm, [run], ready.motions)
    shaped, _ = catalogue()["load.payload"].proposals(scene.at("joint", "elbow", {}))[0]
    assert {p.name for p in shaped.parameters if p.fixed} == {"y"}


@pytest.mark.parametrize("joint", ["shoulder", "elbow"])
def test_it_is_written_as_a_body_of_that_mass_and_inertia(joint: str) -> None:
    document = Document(mjcf.from_text(ARM.format(load="")))
    values = {"mass": 0.3, "inertia": 2e-4, "x": 0.05, "y": 0.01, "z": -0.2}
    catalogue()["load.payload"].edit(document, joint, values)
    written = mujoco.MjModel.from_xml_string(document.text())
    inertial = '<inertial pos="0 0 0" mass="0.3" diaginertia="2e-4 2e-4 2e-4"/>'
    at = f'<joint name="{joint}"'
    by_hand = ARM.format(load="").replace(at, f'<body pos="0.05 0.01 -0.2">{inertial}</body>{at}')
    masses = []
    for model in (written, mujoco.MjModel.from_xml_string(by_hand)):
        data, full = mujoco.MjData(model), np.zeros((2, 2))
        data.qpos[:], data.qvel[:] = (0.4, -0.7), (1.0, -2.0)
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, full)
        masses.append((full, data.qfrc_bias.copy()))
    for one, other in zip(*masses, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9)


def test_a_diagnosis_finds_a_load_at_the_end_of_an_arm() -> None:
    runs = [recorded(ARM, ball(0.15, (0.0, 0.0, -0.34)), seed) for seed in (1, 2)]
    found = diagnose(mjcf.from_text(ARM.format(load="")), runs[:1], held_out=runs[1:])
    (load,) = found.missing
    assert (load.effect, load.at, found.verdict) == ("load.payload", "elbow", "explained"), found.sentence
    assert load.parameters["mass"]["value"] == pytest.approx(0.15, rel=0.05)
    assert load.parameters["z"]["value"] == pytest.approx(-0.34, abs=0.01)
    assert load.parameters["x"]["value"] == pytest.approx(0.0, abs=1e-3)
    assert found.held_out is not None
    assert found.held_out.improved < 1.2
