"""The engine beside MuJoCo's batch.

    python benchmarks/engine.py [--repeats 5]

The first table simulates windows of 0.25 s, sampled at 500 Hz, with steps of 1 ms by Runge-Kutta: 32 windows with 8
variants each, by `mujoco.batch.Batch.rollout` and by the engine, turn about, on one thread and on all; beside it what
derivatives in eight directions cost, in simulations. The second table says what a structure costs that was never
compiled before, in seconds of the processor: writing its code, compiling it, and taking it from the cache. Ratios are
medians over the repeats; the machine may be busy.
"""

import argparse
import os
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
from mujoco import batch

from dipc_gym import physics
from dipc_gym.engine import kernel, machine, program, run
from dipc_gym.engine.loop import write_loop

WINDOWS, VARIANTS, SAMPLES, PERIOD, STEP = 32, 8, 126, 0.002, 0.001


def chain(joints, *, cart):
    """A chain of links with dampers and motors; hinges about changing axes make an arm, a cart first a pendulum rig."""
    inside, axes = "", ["0 1 0"] * 8 if cart else ["0 0 1", "0 1 0", "0 1 0", "1 0 0", "0 1 0", "1 0 0", "0 0 1"]
    for i in reversed(range(joints)):
        kind, axis = ("slide", "1 0 0") if cart and i == 0 else ("hinge", axes[i])
        inside = f"""<body pos="0 0 {0.0 if i == 0 else -0.3}"><inertial pos="0 0 -0.15" mass="{1.0 / (i + 1)}"
            diaginertia="0.01 0.01 0.01"/><joint name="j{i}" type="{kind}" axis="{axis}" damping="0.5"/>
            {inside}</body>"""
    motors = "".join(f'<motor name="m{i}" joint="j{i}"/>' for i in range(1 if cart else joints))
    sensors = "".join(f'<jointpos name="s{i}" joint="j{i}"/>' for i in range(joints))
    return f"""<mujoco><option timestep="{STEP}" integrator="RK4">
        <flag contact="disable" constraint="disable"/></option>
        <worldbody>{inside}</worldbody><actuator>{motors}</actuator><sensor>{sensors}</sensor></mujoco>"""


def timed(work, clock=time.perf_counter):
    """Seconds that it takes."""
    begin = clock()
    work()
    return clock() - begin


def windows(text, threads, repeats):
    """Seconds of MuJoCo, of the engine, and of the engine with derivatives; the largest difference of readings."""
    source = physics.from_model(mujoco.MjModel.from_xml_string(text))
    model, n = source.model, source.model.nv
    rng = np.random.default_rng(0)
    initial = np.tile(0.2 * rng.normal(size=(1, WINDOWS, 2 * n)), (VARIANTS, 1, 1))
    commands = 0.5 * rng.normal(size=(SAMPLES, model.nu))
    sims = batch.Batch(model, VARIANTS * WINDOWS, threads)
    held = np.repeat(commands, round(PERIOD / STEP), axis=0)

    def mujocos():
        sims.time[:] = 0
        sims.qpos[:], sims.qvel[:] = initial.reshape(-1, 2 * n)[:, :n], initial.reshape(-1, 2 * n)[:, n:]
        return sims.rollout(len(held), np.broadcast_to(held, (sims.nsim, *held.shape)), record=("sensordata",))

    what, parameters = program.read([source])
    times = np.tile(PERIOD * np.arange(SAMPLES), (WINDOWS, n, 1))
    jobs = run.Jobs(
        np.repeat(parameters, VARIANTS, axis=0),
        initial,
        np.zeros(WINDOWS),
        np.zeros(WINDOWS, dtype=np.int64),
        np.full(WINDOWS, SAMPLES),
        run.Commands(PERIOD * np.arange(SAMPLES), commands[None]),
        np.zeros(VARIANTS, dtype=np.int64),
        times,
        times.max(axis=(1, 2)),
    )
    one = replace(jobs, parameters=parameters, initial=initial[:1], which=np.zeros(1, dtype=np.int64))
    directions = run.Directions(np.zeros((8, parameters.shape[1])), np.zeros((8, WINDOWS, 2 * n)))
    directions.initial[:, :, 0] = 1.0

    def ours():
        return run.run(what, jobs, STEP, threads=threads)[0]

    theirs = mujocos()["sensordata"][:, :: round(PERIOD / STEP)].reshape(VARIANTS, WINDOWS, SAMPLES, n)
    apart = np.abs(np.swapaxes(ours(), 2, 3) - theirs).max()
    run.differentiate(what, one, directions, STEP, threads=threads)
    seconds = [
        (timed(mujocos), timed(ours), timed(lambda: run.differentiate(what, one, directions, STEP, threads=threads)))
        for _ in range(repeats)
    ]
    return np.array(seconds), apart


def compilation(text):
    """Processor seconds to write and compile the loop, then the mechanics of a model, and to reload both."""
    what, _ = program.read([physics.from_model(mujoco.MjModel.from_xml_string(text))])
    rules = program.rules()
    texts = []

    def write_loops():
        texts[:] = [str(write_loop(rules, tangents=tangents)) for tangents in (False, True)]

    def write_mechanics():
        texts[2:] = [kernel.write_kernel.__wrapped__(what.tree)]

    def compiled(some):
        for one in some:
            machine._object(one, machine._key(one))

    with tempfile.TemporaryDirectory() as folder:
        machine.cache_folder = lambda: Path(folder) / "engine"
        machine._object.cache_clear()
        steps = [write_loops, lambda: compiled(texts[:2]), write_mechanics, lambda: compiled(texts[2:])]
        seconds = [timed(step, time.process_time) for step in steps]
        machine._object.cache_clear()
        linked = [lambda loop=loop: machine.load([loop, texts[2]], ["run"]) for loop in texts[:2]]
        return [*seconds, sum(timed(one, time.process_time) for one in linked)]


def main():
    """Both tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=5)
    repeats = parser.parse_args().repeats
    models = {
        "cart": chain(1, cart=True),
        "cart with two poles": chain(3, cart=True),
        "six-joint arm": chain(6, cart=False),
    }
    print("model                threads  MuJoCo us/step  engine us/step  faster   8 derivatives cost  apart")
    for name, text in models.items():
        for threads in sorted({1, os.cpu_count() or 1}):
            seconds, apart = windows(text, threads, repeats)
            steps = WINDOWS * VARIANTS * (SAMPLES - 1) * PERIOD / STEP
            theirs, ours, _ = np.median(seconds, axis=0)
            faster = np.median(seconds[:, 0] / seconds[:, 1])
            cost = np.median(VARIANTS * seconds[:, 2] / seconds[:, 1])
            print(
                f"{name:20} {threads:7} {1e6 * theirs / steps:15.2f} {1e6 * ours / steps:15.3f} {faster:7.1f}"
                f" {cost:20.1f}  {apart:.0e}"
            )
    print("\nmodel                loop, once: write  compile   mechanics: write  compile   from the cache, s")
    for name, text in models.items():
        loop_written, loop_compiled, written, compiled, again = compilation(text)
        print(f"{name:20} {loop_written:18.2f} {loop_compiled:8.2f} {written:18.2f} {compiled:8.2f} {again:16.3f}")


if __name__ == "__main__":
    main()
