"""Make the two recordings of this folder: the arm of arm.xml, with physics that arm.xml does not have.

The shaft has dry friction. The simulation steps at 0.05 ms, a twentieth of the model's step, and the encoder has 8,192
counts a turn. Run it: python examples/diagnose/record.py --out FOLDER
"""

from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
import tyro

from dipc_gym import recording
from dipc_gym.recording import Recorder, Recording

MODEL = Path(__file__).with_name("arm.xml")
FRICTION = 0.15  # N m
PERIOD = 0.004  # s between samples
STEP = 5e-5  # s
COUNT = 2 * np.pi / 8192  # rad


@dataclass
class Arguments:
    out: Path
    """folder for run_1.csv and run_2.csv"""
    seconds: float = 8.0
    """length of each"""


def run(name: str, seed: int, seconds: float) -> Recording:
    """One recording: three tones and a square wave, with random phases."""
    rng = np.random.default_rng(seed)
    real = mujoco.MjSpec.from_file(str(MODEL))
    real.option.timestep = STEP
    real.joint("shoulder").frictionloss = FRICTION
    real.joint("shoulder").solref_friction = [2 * STEP, 1.0]
    real.option.noslip_iterations = 3
    model = real.compile()
    data, recorder = mujoco.MjData(model), Recorder(["motor"], ["angle"])

    time = PERIOD * np.arange(round(seconds / PERIOD))
    phases = rng.uniform(0.0, 2 * np.pi, 4)
    tones = [np.sin(2 * np.pi * f * time + p) for f, p in zip((0.4, 1.1, 2.3), phases[:3], strict=True)]
    square = np.sign(np.sin(2 * np.pi * 0.7 * time + phases[3]))
    volts = np.round(1.8 * tones[0] + 1.4 * tones[1] + tones[2] + 1.2 * square, 3)  # as a 16-bit converter would
    for now, command in zip(time, volts, strict=True):
        angle = data.qpos[0] + rng.normal(scale=COUNT / 4)
        recorder.append(now, [command], [COUNT * np.round(angle / COUNT)])
        data.ctrl[0] = command
        mujoco.mj_step(model, data, round(PERIOD / STEP))
    return recorder.recording(name)


if __name__ == "__main__":
    arguments = tyro.cli(Arguments)
    arguments.out.mkdir(parents=True, exist_ok=True)
    for seed in (1, 2):
        made = run(f"run_{seed}", seed, arguments.seconds)
        print(recording.write(made, arguments.out / f"run_{seed}.csv", overwrite=True))
