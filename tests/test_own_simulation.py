"""What most try first: a model with MuJoCo's defaults, one thing changed in a copy of it, and the copy simulated."""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np
import pytest

from dipc_gym import mjcf
from dipc_gym.recording import Recording
from dipc_gym.sim2real import diagnose

PENDULUM = """
<mujoco model="swing">
  <worldbody>
    <body name="rod" pos="0 0 1">
      <joint name="pivot" axis="0 1 0" damping="0.02"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.35" size="0.015" mass="0.3" contype="0" conaffinity="0"/>
      <geom type="sphere" pos="0 0 -0.35" size="0.04" mass="0.5" contype="0" conaffinity="0"/>
    </body>
  </worldbody>
  <actuator><motor name="torque" joint="pivot"/></actuator>
  <sensor><jointpos name="angle" joint="pivot"/></sensor>
</mujoco>
"""
FILTERED = PENDULUM.replace(
    '<motor name="torque" joint="pivot"/>', '<general name="torque" joint="pivot" dyntype="filter" dynprm="0.03"/>'
)


def simulated(
    text: str, seed: int, pushed: Callable[[float], float] | None = None, scale: float = 1.0, loud: float = 1.0
) -> Recording:
    """Ten seconds of `mj_step` at the model's own step, read at every second of them."""
    model = mujoco.MjModel.from_xml_string(text)
    data, rng = mujoco.MjData(model), np.random.default_rng(seed)
    rates, phases = rng.uniform(0.2, 3.0, 6), rng.uniform(0.0, 2 * np.pi, 6)
    time, read = 2 * model.opt.timestep * np.arange(2500), np.zeros(2500)
    waves = np.sin(2 * np.pi * np.outer(time, rates) + phases).sum(axis=1) / 3
    commands = loud * 1.2 * np.clip(waves, -1.0, 1.0)
    for k, command in enumerate(commands):
        data.ctrl[:] = command
        mujoco.mj_forward(model, data)
        read[k] = data.sensordata[0]
        for _ in range(2):
            if pushed:
                data.qfrc_applied[0] = pushed(float(data.qvel[0]))
            mujoco.mj_step(model, data)
    sensed = scale * read + rng.normal(0, 1e-4, len(read))
    return Recording(f"run_{seed}", time, commands[:, None], sensed[:, None], ("torque",), ("angle",))


@pytest.mark.parametrize(
    ("change", "expected", "name", "value"),
    [
        ({"text": PENDULUM}, None, "", 0.0),
        (
            {"text": PENDULUM.replace("<worldbody>", '<option gravity="0.5 0 -9.8"/><worldbody>', 1)},
            "load.tilt",
            "about_y",
            -np.arctan2(0.5, 9.8),
        ),
        ({"text": PENDULUM, "pushed": lambda v: -0.01 * v * abs(v)}, "drag.quadratic", "coefficient", 0.01),
        ({"text": PENDULUM, "scale": 1.05, "loud": 1.8}, "sensor.gain", "gain", 1.05),
        ({"text": FILTERED}, "motor.inductance", "time_constant", -0.002 / np.log(1 - 0.002 / 0.03)),  # in steps
    ],
    ids=["nothing", "tilt", "drag", "scale", "filter"],
)
def test_what_one_changes_in_a_copy_is_found(
    change: dict[str, object], expected: str | None, name: str, value: float
) -> None:
    """Euler's half step of 2 ms is many times the noise, and a load that swings, a sensor that lags or a drive that
    gives way is nearly that.
    """
    found = diagnose(
        mjcf.from_text(PENDULUM),
        [simulated(seed=1, **change)],  # type: ignore[arg-type]
        [simulated(seed=2, **change)],  # type: ignore[arg-type]
    )
    assert [one.effect for one in found.missing] == ([expected] if expected else []), found.sentence
    assert found.verdict == ("explained" if expected else "consistent")
    assert found.held_out is not None
    assert found.held_out.improved < 1.2
    if expected:
        assert found.missing[0].parameters[name]["value"] == pytest.approx(value, rel=0.02), found.missing[0].parameters
