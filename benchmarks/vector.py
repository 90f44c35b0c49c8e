"""Speed with many environments: ours, Gymnasium's way of having many, and MuJoCo's bare batch as the ceiling.

    python -m benchmarks.vector [--seconds 1.0] [--repeats 3] [--counts 1 16 256 4096] [--envpool VENV/bin/python]

EnvPool has a virtual environment of its own, with its own versions: `python -m venv VENV` and
`VENV/bin/pip install envpool gymnasium`. AsyncVectorEnv is one process for each environment, so it is left out above
`--most-processes`.

Every environment does 5 physics steps a control step, and is reset when an episode ends; that is timed too. Actions are
zero. The bare batch is MuJoCo stepping the same rig under a held voltage, with nothing observed, rewarded or reset, so
poles that have fallen go on swinging. `engine="compiled"` takes 5 steps of Runge-Kutta, four evaluations each. Rivals
take turns; the highest rate of several rounds counts. Steps a second of the processor's time, over all threads, hold on
a busy machine too.
"""

import argparse
import subprocess
import time
from pathlib import Path

import gymnasium
import numpy as np
from gymnasium.vector import AsyncVectorEnv
from mujoco import batch

import dipc_gym
from dipc_gym.env import DoublePendulumEnv

BATCH = "DIPC-Friction-v0, batch"


class Bare:
    """MuJoCo's batch, and nothing around it."""

    def __init__(self, count):
        self.unwrapped = self
        self.num_envs, self._sims = count, batch.Batch(DoublePendulumEnv().model, count)

    def reset(self, seed):
        self._sims.reset()

    def step(self, actions):
        self._sims.ctrl = actions
        self._sims.step(nstep=5)

    def close(self):
        pass


def steps_per_second(env, seconds):
    """By the clock, and of the processor's time where this process did all the work."""
    if isinstance(env, EnvPool):
        return env.rate(seconds), 0.0
    env.reset(seed=0)
    actions = np.zeros((env.num_envs, 1), np.float32)
    for _ in range(2):
        env.step(actions)
    start, busy, steps = time.perf_counter(), time.process_time(), 0
    while (spent := time.perf_counter() - start) < seconds:
        env.step(actions)
        steps += env.num_envs
    alone = not isinstance(env.unwrapped, AsyncVectorEnv)
    return steps / spent, steps / (time.process_time() - busy) if alone else 0.0


def sync(name, count):
    return gymnasium.make_vec(name, num_envs=count, vectorization_mode="sync")


def processes(name, count):
    return gymnasium.make_vec(name, num_envs=count, vectorization_mode="async")


class EnvPool:
    """EnvPool's InvertedDoublePendulum, measured by the Python that has it."""

    def __init__(self, python, count):
        self.python, self.num_envs = python, count

    def rate(self, seconds):
        script = Path(__file__).with_name("envpool_rate.py")
        command = [self.python, str(script), str(self.num_envs), str(seconds)]
        return float(subprocess.run(command, capture_output=True, text=True, check=True).stdout)

    def close(self):
        pass


def ours(count, **kwargs):
    return gymnasium.make_vec(dipc_gym.ENV_ID, num_envs=count, vectorization_mode="vector_entry_point", **kwargs)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=1.0, help="of each measurement")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--counts", type=int, nargs="+", default=[1, 16, 256, 4096])
    parser.add_argument("--most-processes", type=int, default=256, help="largest count for AsyncVectorEnv")
    parser.add_argument("--envpool", metavar="PYTHON", help="the Python of a virtual environment that has EnvPool")
    options = parser.parse_args()
    random = {
        "friction": {"coulomb": {"uniform": [5, 9]}, "static": {"uniform": [9, 14]}},
        "masses": {"cart": {"uniform": [0.5, 0.6]}},
    }
    late, noisy = {"delay": 0.003}, {"encoders": {"noise": 0.5}}
    pendulum = "InvertedDoublePendulum-v5"
    rivals = {
        f"{pendulum}, SyncVectorEnv": lambda n: sync(pendulum, n),
        f"{pendulum}, AsyncVectorEnv": lambda n: processes(pendulum, n) if n <= options.most_processes else None,
        f"{pendulum}, EnvPool": lambda n: EnvPool(options.envpool, n) if options.envpool else None,
        "DIPC-Friction-v0, SyncVectorEnv": lambda n: sync(dipc_gym.ENV_ID, n),
        BATCH: ours,
        "the same, plants drawn at reset": lambda n: ours(n, plant=random),
        "engine 'compiled'": lambda n: ours(n, engine="compiled"),
        "compiled, one thread": lambda n: ours(n, engine="compiled", threads=1),
        "compiled, plants drawn at reset": lambda n: ours(n, engine="compiled", plant=random),
        "compiled, commands late by 3 ms": lambda n: ours(n, engine="compiled", plant=late),
        "compiled, noise on the encoders": lambda n: ours(n, engine="compiled", plant=noisy),
        "MuJoCo's bare batch": Bare,
    }
    names = list(rivals)
    columns = f"{'steps/s':>10s} {'of Gymnasium':>13s} {'of batch':>9s} {'of bare batch':>14s} {'a core second':>14s}"
    print(f"{'environments':>12s}  {'':42s} {columns}")
    for count in options.counts:
        found = {name: env for name, make in rivals.items() if (env := make(count)) is not None}
        rates = dict.fromkeys(found, (0.0, 0.0))
        for _ in range(options.repeats):
            for name, env in found.items():
                rates[name] = tuple(map(max, rates[name], steps_per_second(env, options.seconds)))
        for name, (rate, core) in rates.items():
            first, batched, bare = (rates[rival][0] for rival in (names[0], BATCH, names[-1]))
            of = f"{rate / first:13.1f} {rate / batched:9.1f} {rate / bare:14.0%} {core:14,.0f}"
            print(f"{count:12d}  {name:42s} {rate:10,.0f} {of}", flush=True)
            found[name].close()


if __name__ == "__main__":
    main()
