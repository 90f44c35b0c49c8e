"""How long a whole diagnosis takes, and how that grows with joints, with recordings and with effects.

    python benchmarks/diagnosis.py [--joints 6] [--seconds 40] [--effects 0] [--threads 0]
    python benchmarks/diagnosis.py --growth growth.svg [--threads 0]

An arm of hinges about changing axes, with dry and viscous friction in every joint, is simulated here by MuJoCo in fine
steps; two recordings at 500 Hz of that, under a controller that follows tones, are diagnosed with a model without any
friction. The first form times one diagnosis. The second times one after the other with 1 to 7 joints (2 x 10 s), with
recordings of 2 x 5 to 2 x 80 s (two joints), and with the first 2 to all effects of the catalogue (two joints, 2 x
10 s), and plots them. Seconds are those of the processor, all threads and forks together, for the machine may be busy;
beside them stand those on the clock. Memory is the most that the process held, then the most that one of its forks did,
which shares nearly all of it.
"""

import argparse
import os
import resource
import sys
import time
from pathlib import Path

import mujoco
import numpy as np

from dipc_gym import mjcf
from dipc_gym.drawing import style
from dipc_gym.recording import Recording
from dipc_gym.sim2real.diagnosis import diagnose
from dipc_gym.sim2real.effects import catalogue

PERIOD, FINE, NOISE = 0.002, 5e-5, 5e-5  # s, s, rad; MuJoCo softens dry friction, the less the finer the step
AXES = ["1 0 0", "0 1 0", "0 1 0", "0 0 1", "0 1 0", "0 0 1", "0 1 0"]
COULOMB = (2.0, 1.6, 0.9, 0.2, 0.12, 0.05, 0.03)  # N m
VISCOUS = (1.0, 0.8, 0.5, 0.1, 0.06, 0.03, 0.02)  # N m s/rad
GAINS = (90.0, 80.0, 40.0, 8.0, 5.0, 2.0, 1.2)  # N m/rad
FIRST = ("friction.coulomb", "friction.viscous", "load.constant", "drag.quadratic")  # of the catalogue
SWEEPS = {
    "joints": [(joints, 10.0, 0) for joints in range(1, 8)],
    "seconds of each of two recordings": [(2, seconds, 0) for seconds in (5.0, 10.0, 20.0, 40.0, 80.0)],
    "effects": [(2, 10.0, effects) for effects in (2, 4, 8, 16, 0)],
}


def arm(joints, step, *, friction):
    """MJCF of the arm, with or without friction."""
    text = ""
    for k in reversed(range(joints)):
        rubs = f'frictionloss="{COULOMB[k]}" damping="{VISCOUS[k]}" solreffriction="{2 * step} 1"' if friction else ""
        text = f"""<body name="link{k}" pos="0 0 {0.25 * bool(k)}"><inertial pos="0.02 0 0.12" mass="{2.0 / (1 + k)}"
            diaginertia="{0.02 / (1 + k)} {0.02 / (1 + k)} {0.01 / (1 + k)}"/>
            <joint name="j{k}" axis="{AXES[k]}" {rubs}/>{text}</body>"""
    motors = "".join(f'<motor name="m{k}" joint="j{k}"/>' for k in range(joints))
    sensors = "".join(f'<jointpos name="q{k}" joint="j{k}"/>' for k in range(joints))
    return f"""<mujoco><option timestep="{step}" integrator="implicitfast" iterations="100" tolerance="1e-12"
        noslip_iterations="{30 * friction}"/><worldbody>{text}</worldbody><actuator>{motors}</actuator>
        <sensor>{sensors}</sensor></mujoco>"""


def record(joints, seconds, seed):
    """A recording of the arm with friction, which follows tones of its own for each joint."""
    model = mujoco.MjModel.from_xml_string(arm(joints, FINE, friction=True))
    rng, data, rows = np.random.default_rng(seed), mujoco.MjData(model), []
    rates, phases = rng.uniform(0.1, 0.9, (joints, 4)), rng.uniform(0, 6, (joints, 4))
    gains, damping = np.array(GAINS[:joints]), 0.1 * np.array(GAINS[:joints])
    for k in range(round(seconds / PERIOD)):
        wanted = 0.4 * np.sin(2 * np.pi * rates * PERIOD * k + phases).sum(axis=1)
        data.ctrl[:] = gains * (wanted - data.qpos) - damping * data.qvel
        rows.append((PERIOD * k, *data.ctrl, *(data.qpos + NOISE * rng.normal(size=joints))))
        mujoco.mj_step(model, data, round(PERIOD / FINE))
    table = np.array(rows)
    names = [tuple(f"{kind}{k}" for k in range(joints)) for kind in "mq"]
    return Recording(f"run {seed}", table[:, 0], table[:, 1 : 1 + joints], table[:, 1 + joints :], *names)


def measure(joints, seconds, effects, threads):
    """Seconds of the processor and on the clock that a diagnosis takes, and what it says."""
    runs = [record(joints, seconds, seed) for seed in (1, 2)]
    known = catalogue()
    ordered = [known[name] for name in FIRST] + [known[name] for name in sorted(known) if name not in FIRST]
    begin = spent(), time.perf_counter()
    model = mjcf.from_text(arm(joints, 1e-3, friction=False))
    found = diagnose(model, runs, effects=ordered[: effects or None], threads=threads)
    return spent() - begin[0], time.perf_counter() - begin[1], found


def spent():
    """Seconds of the processor so far, ended forks included."""
    return sum(os.times()[:4])


def tell(joints, seconds, effects, threads):
    """Measure one diagnosis and print it; seconds of the processor, and how many effects were asked for."""
    processor, clock, found = measure(joints, seconds, effects, threads)
    asked = effects or len(catalogue())
    unit = 1e6 if sys.platform == "darwin" else 1e3
    own, forks = (resource.getrusage(who).ru_maxrss / unit for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    print(
        f"{joints:6} {seconds:12g} {asked:8} {processor:12.1f} {clock:9.1f} {own:11.0f} {forks:8.0f}  {found.verdict}, "
        f"{len(found.missing)} of {2 * joints} missing effects named",
        flush=True,
    )
    return processor, asked


def growth(file, threads):
    """All sweeps, and their plot."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(1, len(SWEEPS), figsize=(style.WIDE, 2.4), sharey=True, layout="constrained")
    for axis, (name, sweep) in zip(axes, SWEEPS.items(), strict=True):
        points = []
        for case in sweep:
            processor, asked = tell(*case, threads)
            points.append(({"joints": case[0], "effects": asked}.get(name, case[1]), processor))
        axis.plot(*zip(*points, strict=True), "o-", color=style.BLUE)
        axis.set(xlabel=name, ylim=(0, None), xlim=(0, None))
        axis.grid(alpha=0.3)
    axes[0].set_ylabel("processor time / s")
    with file.open("wb") as out:
        style.write(figure, out, file.suffix[1:] or "png")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--joints", type=int, default=6, choices=range(1, 8))
    parser.add_argument("--seconds", type=float, default=40.0, help="of each of two recordings")
    parser.add_argument("--effects", type=int, default=0, help="of the catalogue; 0 for all")
    parser.add_argument("--threads", type=int, default=0, help="0 for all cores")
    parser.add_argument("--growth", type=Path, metavar="FILE", help="measure how it grows, and plot that")
    options = parser.parse_args()
    print("joints  seconds of 2  effects  processor s  clock s  memory MB, a fork's")
    if options.growth:
        growth(options.growth, options.threads)
    else:
        tell(options.joints, options.seconds, options.effects, options.threads)


if __name__ == "__main__":
    main()
