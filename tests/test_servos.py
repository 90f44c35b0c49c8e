"""Servos: their gains are the model's parameters, and their torque may have a limit that the model does not know."""

from __future__ import annotations

import re

import mujoco
import numpy as np
import pytest
from sim2real_rigs import CART, RK4, prepared, record, sweep

from dipc_gym import mjcf, physics
from dipc_gym.mjcf.edit import Document
from dipc_gym.recording import Recording
from dipc_gym.sim2real import catalogue, diagnose
from dipc_gym.sim2real.estimation import unexplained
from dipc_gym.sim2real.simulation.batch import Stepping

LEG = """
<mujoco model="leg">
  <compiler angle="radian"/>
  <option timestep="0.001" integrator="RK4"/>
  <worldbody>
    <body name="thigh">
      <joint name="hip" axis="0 1 0" damping="0.1" armature="0.01"/>
      <inertial pos="0 0 -0.12" mass="1.2" diaginertia="0.008 0.008 0.0006"/>
      <body name="shank" pos="0 0 -0.25">
        <joint name="knee" axis="0 1 0" damping="0.1" armature="0.01"/>
        <inertial pos="0 0 -0.12" mass="0.5" diaginertia="0.003 0.003 0.0002"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position name="hip" joint="hip" kp="40" kv="1"{limit}/>
    <position name="knee" joint="knee" kp="40" kv="1"/>
  </actuator>
  <sensor><jointpos name="hip_angle" joint="hip"/><jointpos name="knee_angle" joint="knee"/></sensor>
</mujoco>
"""
GIVEN = LEG.format(limit="")


def wanted(seed: int, size: float) -> object:
    """Angles that jump every 0.6 s, and sway between."""
    steps = np.random.default_rng(seed).uniform(-size, size, 100)
    return lambda time: float(steps[int(time / 0.6)] + 0.3 * size * np.sin(5.0 * time))


def recorded(text: str, size: float) -> list[Recording]:
    """Two runs of a leg, the same angle asked of both joints."""
    rig = physics.load(mjcf.from_text(text))
    return [
        record(rig, wanted(seed, size), 10.0, noise=2e-4, step=1e-3, integrator=RK4, seed=seed)  # type: ignore[arg-type]
        for seed in (1, 2)
    ]


def test_gains_are_told_from_masses_and_dampings() -> None:
    true = GIVEN.replace('joint="hip" kp="40" kv="1"', 'joint="hip" kp="31" kv="1.4"')
    true = true.replace('joint="knee" kp="40" kv="1"', 'joint="knee" kp="52" kv="0.7"')
    said = diagnose(mjcf.from_text(GIVEN), recorded(true, 0.4), effects=[])
    assert said.verdict == "recalibrated"
    changed = {f"{one['at']} {one['parameter']}": one["value"] for one in said.recalibrated}
    assert changed.keys() == {"hip kp", "hip kv", "knee kp", "knee kv"}
    assert np.allclose([changed[key] for key in sorted(changed)], [31, 1.4, 52, 0.7], rtol=0.02)


def test_a_torque_limit_is_named() -> None:
    limited = LEG.format(limit=' forcerange="-6 6"')
    effects = [catalogue()[name] for name in ("motor.saturation:torque", "friction.coulomb", "timing.delay")]
    said = diagnose(mjcf.from_text(GIVEN), recorded(limited, 0.4), effects=effects)
    assert said.verdict == "explained"
    (missing,) = said.missing
    assert (missing.effect, missing.at) == ("motor.saturation", "hip")
    assert abs(missing.parameters["limit"]["value"] - 6.0) < 0.1
    assert "gives no more than 6 N m" in missing.sentence
    written = physics.load(mjcf.from_text(said.improved)).model
    assert np.allclose(written.actuator("hip").forcerange, [-6, 6], atol=0.1)


@pytest.mark.parametrize(
    ("given", "written"),
    [("0 0 0", (1.5, 0, 0)), ("0.4 0 5", (0.4, 0, 5)), ("3 2 5", (1.5, 2, 5)), ("0 7 5", (0.7, 7, 5))],
)
def test_a_motor_keeps_the_limits_that_it_has(given: str, written: tuple[float, ...]) -> None:
    """What is found is within them: 7 A are 0.7 N m."""
    motor = '<dcmotor name="m" joint="hip" resistance="1" motorconst="0.1" saturation="{}"/>'
    text = re.sub("<actuator>.*</actuator>", f"<actuator>{motor.format(given)}</actuator>", GIVEN, flags=re.DOTALL)
    document = Document(mjcf.from_text(text))
    catalogue()["motor.saturation:torque"].edit(document, "m", {"limit": 1.5})
    numbers = [float(number) for number in document.actuator("m").get("saturation", "").split()]
    assert numbers == pytest.approx(written)
    high = mujoco.MjModel.from_xml_string(document.text()).actuator_forcerange[0, 1]
    assert high == pytest.approx(written[0])


def test_a_torque_limit_is_looked_for_below_what_a_servo_gave() -> None:
    """One that holds an arm up gives what gravity asks of it, and no more."""
    held = record(physics.load(mjcf.from_text(GIVEN)), lambda t: 1.0 + 0.1 * np.sin(2 * t), 6.0, step=1e-3)
    cut = prepared(GIVEN, [held], stepping=Stepping(1e-3, RK4))
    seen = unexplained.scene(physics.load(mjcf.from_text(GIVEN)), [held], cut.motions)
    evidence = seen.at("actuator", "hip", {})
    model, data = cut.structure.model, mujoco.MjData(cut.structure.model)
    torque = []
    for q, v, u in zip(cut.motions[0].position, cut.motions[0].velocity, held.commands, strict=True):
        data.qpos[:], data.qvel[:], data.ctrl[:] = q, v, u
        mujoco.mj_forward(model, data)
        torque.append(abs(data.actuator_force[0]))
    limits = [guess["limit"] for guess in catalogue()["motor.saturation:torque"].guesses(evidence)]
    assert max(limits) < max(torque)
    assert max(limits) == pytest.approx(0.95 * np.quantile(torque, 0.999), rel=0.02)


def test_a_command_through_a_slow_cylinder_is_known_where_windows_begin() -> None:
    """Its pressure is in no column; it follows from the commands before."""
    drive = '<cylinder name="motor" joint="cart" timeconst="0.08" area="30" bias="0 0 0"/>'
    text = re.sub(r"<actuator>.*</actuator>", f"<actuator>{drive}</actuator>", CART, flags=re.DOTALL)
    rig = physics.load(mjcf.from_text(text))
    wave = sweep(0.4)
    found = diagnose(mjcf.from_text(text), [record(rig, wave, 8.0, noise=1e-5, integrator=RK4)])
    assert found.verdict == "consistent", found.sentence
    assert found.held_out.nominal < 1.1
