"""Servos: their gains are the model's parameters, and their torque may have a limit that the model does not know."""

from __future__ import annotations

import numpy as np
from sim2real_rigs import RK4, record

from dipc_gym import mjcf, physics
from dipc_gym.recording import Recording
from dipc_gym.sim2real import catalogue, diagnose

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
