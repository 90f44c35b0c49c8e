"""Small rigs, and recordings of them, for the tests of the sim-to-real tool."""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from dipc_gym import mjcf, physics, recording
from dipc_gym.recording import Recorder, Recording
from dipc_gym.sim2real.effects.shared.base import Evidence
from dipc_gym.sim2real.estimation import segments, unexplained
from dipc_gym.sim2real.estimation.segments import Prepared
from dipc_gym.sim2real.simulation.batch import Stepping
from dipc_gym.trials import generate
from dipc_gym.trials.secret import Plan

Array = NDArray[np.float64]
RK4 = mujoco.mjtIntegrator.mjINT_RK4

CART = """<mujoco>
  <option timestep="0.001" integrator="implicitfast"/>
  <worldbody>
    <body name="cart">
      <inertial pos="0 0 0" mass="1.26" diaginertia="1e-3 1e-3 1e-3"/>
      <joint name="cart" type="slide" axis="1 0 0" damping="21.4"/>
    </body>
  </worldbody>
  <actuator>
    <dcmotor name="motor" joint="cart" gear="78.7" resistance="1.2" motorconst="0.06"/>
  </actuator>
  <sensor><jointpos name="cart" joint="cart"/></sensor>
</mujoco>"""
HANGING = """<mujoco>
  <option timestep="0.001" integrator="implicitfast"/>
  <worldbody>
    <body name="cart">
      <inertial pos="0 0 0" mass="0.5" diaginertia="1e-4 1e-4 1e-4"/>
      <joint name="cart" type="slide" axis="1 0 0" damping="21.4"/>
      <body name="pole1">
        <inertial pos="0 0 -0.2" mass="0.63" diaginertia="0.028 0.028 1e-4"/>
        <joint name="pole1" type="hinge" axis="0 1 0" damping="0.001"/>
        <body name="pole2" pos="0 0 -0.4">
          <inertial pos="0 0 -0.28" mass="0.125" diaginertia="0.0033 0.0033 1e-4"/>
          <joint name="pole2" type="hinge" axis="0 1 0" damping="0.0005"/>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <dcmotor name="motor" joint="cart" gear="78.7" resistance="1.2" motorconst="0.06" ctrlrange="-24 24"/>
  </actuator>
  <sensor>
    <jointpos name="cart" joint="cart"/>
    <jointpos name="pole1" joint="pole1"/>
    <jointpos name="pole2" joint="pole2"/>
  </sensor>
</mujoco>"""
TORQUE = """<mujoco>
  <compiler angle="radian"/>
  <option timestep="0.001" integrator="implicitfast"/>
  <worldbody>
    <body name="arm">
      <inertial pos="0 0 -0.2" mass="0.8" diaginertia="0.01 0.01 0.01"/>
      <joint name="shoulder" type="hinge" axis="0 1 0"/>
    </body>
  </worldbody>
  <actuator><motor name="drive" joint="shoulder" gear="2"/></actuator>
  <sensor><jointpos name="angle" joint="shoulder"/></sensor>
</mujoco>"""
RIGS = {"cart": CART, "hanging": HANGING, "torque": TORQUE}
# A command that moves each of them through a sensible range, and noise of its sensors, m or rad.
STRENGTH = {"cart": 4.0, "hanging": 3.0, "torque": 0.6}
NOISE = {"cart": (1e-5,), "hanging": (1e-5, 2e-4, 2e-4), "torque": (2e-4,)}


def sweep(strength: float) -> Callable[[float], float]:
    """Three tones and steps: reversals, rests, slow and fast."""

    def command(t: float) -> float:
        tones = np.sin(2 * np.pi * 0.7 * t) + 0.6 * np.sin(2 * np.pi * 1.9 * t + 1) + 0.3 * np.sin(2 * np.pi * 4.3 * t)
        return float(strength * (tones + 0.5 * np.sign(np.sin(2 * np.pi * 0.45 * t))))

    return command


def record(
    rig: physics.Physics,
    command: Callable[[float], float],
    seconds: float = 3.0,
    *,
    noise: Sequence[float] | float = 0.0,
    period: float = 0.002,
    step: float = 5e-4,
    integrator: mujoco.mjtIntegrator | None = None,
    start: Sequence[float] = (),
    jitter: float = 0.0,
    seed: int = 0,
) -> Recording:
    """Simulate a rig with MuJoCo's own step, and read its sensors.

    Args:
        rig: with what MJCF cannot say.
        command: of every actuator at a time.
        seconds: length.
        noise: standard deviation of each sensor.
        period: between samples, s.
        step: of the simulation, s.
        integrator: the model's own if None.
        start: positions.
        jitter: share of a period by which stamps vary.
        seed: of noise and stamps.
    """
    rng = np.random.default_rng(seed)
    model = copy.copy(rig.model)
    if integrator is not None:
        model.opt.integrator = integrator
    moved = physics.Physics(model, rig.extras)
    data = mujoco.MjData(model)
    data.qpos[: len(start)] = start
    names = mjcf.controls(model), mjcf.scalar_sensors(model)
    address, recorder = mjcf.sensor_addresses(model), Recorder(*names)
    mujoco.mj_forward(model, data)
    memory = moved.sensor_memory(data.sensordata.copy())
    stamp, last = 0.0, 0.0
    for k in range(round(seconds / period)):
        stamp = k * period * 1.0 if not jitter else stamp
        gap = period * (1 + jitter * rng.uniform(-1, 1))
        mujoco.mj_forward(model, data)
        read = moved.sense(data.sensordata, memory, data.time - last)[address]
        last = data.time
        volts = np.full(len(names[0]), command(data.time))
        recorder.append(data.time, volts, read + rng.normal(size=len(read)) * np.asarray(noise))
        count = max(1, round(gap / step))
        model.opt.timestep = gap / count
        full = np.zeros(model.nu)
        full[: len(volts)] = volts
        moved.step(data, full, count)
    return recorder.recording("simulated")


def prepared(
    text: str,
    recordings: Sequence[Recording],
    *,
    stepping: Stepping | None = None,
    length: float | None = 0.25,
    span: tuple[float, float] = (0.0, 1.0),
) -> Prepared:
    """Windows of recordings for a model."""
    source = mjcf.from_text(text)
    stepping = stepping or Stepping(0.001, RK4)
    return segments.prepare(source, physics.load(source), recordings, stepping, length=length, span=span)


def hidden_on_a_cart(folder: Path, effect: str) -> tuple[Prepared, Evidence]:
    """A cart of the trial of laws, whose simulator is written apart: its windows, and what is known at its joint."""
    (folder / "sealed").mkdir()
    generate.make_trial(folder, Plan(1, "single", "cart", effect, tuned=False, laws=True), 1)
    trial = folder / "trials" / "t001_cart"
    nominal = (trial / "nominal.xml").read_text()
    cart = physics.load(nominal)
    runs = [recording.read(trial / f"train_{k}.csv", cart.model) for k in (1, 2)]
    ready = prepared(nominal, runs)
    return ready, unexplained.scene(cart, runs, ready.motions).at("joint", "cart", {})


RAIL = """<mujoco><option timestep="0.002" integrator="implicitfast"/><worldbody><body name="cart">
  <inertial pos="0 0 0" mass="1.26" diaginertia="1e-3 1e-3 1e-3"/>
  <joint name="cart" type="slide" axis="1 0 0" damping="40" stiffness="8"/></body></worldbody>
  <actuator><motor name="motor" joint="cart" gear="4"/></actuator>
  <sensor><jointpos name="cart" joint="cart"/></sensor></mujoco>"""


class Hysteresis:
    """A wire rope under the cart (Bouc-Wen): a force with a memory, which no effect of those asked for has."""

    def __init__(self, size: float, reach: float) -> None:
        self.size, self.reach, self.z = size, reach, 0.0

    def force(self, x: float, v: float, h: float) -> float:
        self.z += h * (v - abs(v) * self.z * abs(self.z) / self.reach**2) if self.reach else 0.0
        return -self.size * self.z / self.reach


class StiffSpot:
    """Dry friction with one stiff spot two centimetres wide, on half a metre of rail."""

    def force(self, x: float, v: float, h: float) -> float:
        return -(2.0 + 6.0 * np.exp(-(((x - 0.05) / 0.01) ** 2))) * np.tanh(v / 1e-3)


def rail(law: Hysteresis | StiffSpot, seed: int, seconds: float = 24.0) -> Recording:
    """A cart with a law of its own, integrated here at 50 microseconds."""
    rng, h, hold = np.random.default_rng(seed), 5e-5, 40
    time = h * hold * np.arange(round(seconds / (h * hold)))
    rates, phases = rng.uniform(0.1, 1.2, 5), rng.uniform(0, 6, 5)
    volts = 3.0 * np.sum(np.sin(2 * np.pi * rates * time[:, None] + phases), axis=1)
    x = v = 0.0
    out = np.empty(len(time))
    for k, u in enumerate(volts):
        out[k] = x
        for _ in range(hold):
            v += h * (4.0 * u - 40.0 * v - 8.0 * x + law.force(x, v, h)) / 1.26
            x += h * v
    return Recording(
        f"rail {seed}", time, volts[:, None], (out + 1e-5 * rng.normal(size=len(out)))[:, None], ("motor",), ("cart",)
    )
