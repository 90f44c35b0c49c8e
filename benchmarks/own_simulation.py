"""The first thing that many try: hide something in a model, let MuJoCo simulate it, and diagnose what is left.

    python benchmarks/own_simulation.py [--only pendulum] [--noise 1e-4 1e-3 0]

Each rig is simulated as its file stands, with MuJoCo's own integrator at its own step, for 20 s, twice: the second
recording is held out. Commands are held for 10 ms and logged with the joints, to which noise is added. The whole
catalogue is asked. What was hidden, what was said, the error on the held-out recording in multiples of the noise, and
seconds; a row each.
"""

import argparse
import re
import time

import mujoco
import numpy as np

from dipc_gym import mjcf
from dipc_gym.recording import Recording
from dipc_gym.sim2real.diagnosis import diagnose

SECONDS, PERIOD, TONES = 20.0, 0.01, 5
LINK = '<geom type="capsule" size=".02" fromto="0 0 0 0 0 {end}" mass="{mass}"/>'
PENDULUM = f"""<mujoco><worldbody><body>
  <joint name="hinge" axis="0 1 0" damping="0.02"/>{LINK.format(end=-0.5, mass=0.5)}</body></worldbody>
  <actuator><motor name="motor" joint="hinge"/></actuator>
  <sensor><jointpos name="hinge" joint="hinge"/></sensor></mujoco>"""
CART = f"""<mujoco><option timestep="0.005" integrator="implicitfast"/><worldbody><body>
  <joint name="slider" type="slide" axis="1 0 0" damping="0.5"/><geom type="box" size=".1 .1 .05" mass="1"/>
  <body><joint name="hinge" axis="0 1 0" damping="0.005"/>{LINK.format(end=-0.6, mass=0.2)}</body></body></worldbody>
  <actuator><motor name="motor" joint="slider" gear="10"/></actuator>
  <sensor><jointpos name="slider" joint="slider"/><jointpos name="hinge" joint="hinge"/></sensor></mujoco>"""
ARM = f"""<mujoco><option integrator="implicitfast"/><worldbody><body>
  <joint name="shoulder" axis="0 1 0" damping="0.05"/>{LINK.format(end=-0.4, mass=1)}<body pos="0 0 -.4">
  <joint name="elbow" axis="0 1 0" damping="0.02"/>{LINK.format(end=-0.35, mass=0.5)}</body></body></worldbody>
  <actuator><motor name="up" joint="shoulder" gear="3"/><motor name="fore" joint="elbow"/></actuator>
  <sensor><jointpos name="shoulder" joint="shoulder"/><jointpos name="elbow" joint="elbow"/></sensor></mujoco>"""
# Name, model, and what is hidden at which joint.
RIGS = (
    ("pendulum", PENDULUM, {}),
    ("pendulum", PENDULUM, {"hinge": 'frictionloss="0.15"'}),
    ("cart", CART, {"slider": 'frictionloss="1"', "hinge": 'frictionloss="0.02"'}),
    ("arm", ARM, {"shoulder": 'frictionloss="0.3"', "elbow": 'frictionloss="0.1"'}),
    ("arm", ARM, {"shoulder": 'armature="0.05"', "elbow": 'armature="0.01"'}),
    ("arm", ARM, {"shoulder": 'armature="0.05" frictionloss="0.3"', "elbow": 'armature="0.01" frictionloss="0.1"'}),
)


def recorded(text, seed, noise):
    """What the joints of a model read that MuJoCo simulates."""
    model, rng = mujoco.MjModel.from_xml_string(text), np.random.default_rng(seed)
    data, times = mujoco.MjData(model), PERIOD * np.arange(round(SECONDS / PERIOD))
    size, rate, phase = (rng.uniform(*ends, (TONES, 1, model.nu)) for ends in ((0.2, 1), (0.1, 1.5), (0, 2 * np.pi)))
    commands = np.sum(size * np.sin(2 * np.pi * rate * times[:, None] + phase), axis=0) / 3
    readings = np.empty((len(times), model.nv))
    for k, command in enumerate(commands):
        readings[k], data.ctrl[:] = data.qpos, command
        mujoco.mj_step(model, data, round(PERIOD / model.opt.timestep))
    readings += noise * rng.standard_normal(readings.shape)
    names = [
        [each(k).name for k in range(count)] for each, count in ((model.actuator, model.nu), (model.joint, model.nv))
    ]
    return Recording(f"run {seed}", times, commands, readings, *map(tuple, names))


def row(text, hidden, noise):
    """What was said of one simulation."""
    true = text
    for joint, attributes in hidden.items():
        true = re.sub(f'<joint name="{joint}"', rf"\g<0> {attributes}", true, count=1)
    began = time.monotonic()
    found = diagnose(mjcf.from_text(text), [recorded(true, 1, noise)], [recorded(true, 2, noise)])
    said = ", ".join(
        f"{one.effect}@{one.at} " + " ".join(f"{value['value']:.3g}" for value in one.parameters.values())
        for one in found.missing
    )
    errors = found.held_out
    return [
        ", ".join(f"{joint}: {attributes.replace(chr(34), '')}" for joint, attributes in hidden.items()) or "nothing",
        f"{noise:g}",
        found.verdict,
        said or "-",
        f"{errors.nominal:.3g} to {errors.improved:.3g}",
        f"{time.monotonic() - began:.0f}",
    ]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", choices=sorted({name for name, *_ in RIGS}), help="rig to simulate (default all)")
    parser.add_argument("--noise", type=float, nargs="+", default=[1e-4], help="m or rad (default 1e-4)")
    asked = parser.parse_args()
    print("| rig | hidden | noise | verdict | said | held out, times the noise | seconds |")
    print("|---|---|---|---|---|---|---|")
    for noise in asked.noise:
        for name, text, hidden in RIGS:
            if asked.only in (None, name):
                print("| " + " | ".join([name, *row(text, hidden, noise)]) + " |", flush=True)


if __name__ == "__main__":
    main()
