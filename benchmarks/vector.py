"""Speed with many environments: ours, Gymnasium's way of having many, and MuJoCo's bare batch as the ceiling.

    python benchmarks/vector.py [--seconds 1.0] [--repeats 3] [--counts 1 16 256 4096]

Every environment does 5 physics steps a control step, and is reset when an episode ends; that is timed too. Actions are
zero. The bare batch is MuJoCo stepping the same rig under a held voltage, with nothing observed, rewarded or reset, so
poles that have fallen go on swinging. Rivals take turns; the highest rate of several rounds counts.
"""

import argparse
import time

import gymnasium
import numpy as np
from mujoco import batch

import dipc_gym
from dipc_gym.env import DoublePendulumEnv


class Bare:
    """MuJoCo's batch, and nothing around it."""

    def __init__(self, count):
        self.num_envs, self._sims = count, batch.Batch(DoublePendulumEnv().model, count)

    def reset(self, seed):
        self._sims.reset()

    def step(self, actions):
        self._sims.ctrl = actions
        self._sims.step(nstep=5)


def steps_per_second(env, seconds):
    env.reset(seed=0)
    actions = np.zeros((env.num_envs, 1), np.float32)
    for _ in range(2):
        env.step(actions)
    start, steps = time.perf_counter(), 0
    while (spent := time.perf_counter() - start) < seconds:
        env.step(actions)
        steps += env.num_envs
    return steps / spent


def sync(name, count):
    return gymnasium.make_vec(name, num_envs=count, vectorization_mode="sync")


def ours(count, **kwargs):
    return gymnasium.make_vec(dipc_gym.ENV_ID, num_envs=count, vectorization_mode="vector_entry_point", **kwargs)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=1.0, help="of each measurement")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--counts", type=int, nargs="+", default=[1, 16, 256, 4096])
    options = parser.parse_args()
    random = {
        "friction": {"coulomb": {"uniform": [5, 9]}, "static": {"uniform": [9, 14]}},
        "masses": {"cart": {"uniform": [0.5, 0.6]}},
    }
    rivals = {
        "InvertedDoublePendulum-v5, SyncVectorEnv": lambda n: sync("InvertedDoublePendulum-v5", n),
        "DIPC-Friction-v0, SyncVectorEnv": lambda n: sync(dipc_gym.ENV_ID, n),
        "DIPC-Friction-v0, batch": ours,
        "the same, plants drawn at reset": lambda n: ours(n, plant=random),
        "MuJoCo's bare batch": Bare,
    }
    names = list(rivals)
    print(f"{'environments':>12s}  {'':42s} {'steps/s':>10s} {'of Gymnasium':>13s} {'of bare batch':>14s}")
    for count in options.counts:
        rates = dict.fromkeys(names, 0.0)
        built = {name: make(count) for name, make in rivals.items()}
        for _ in range(options.repeats):
            for name, env in built.items():
                rates[name] = max(rates[name], steps_per_second(env, options.seconds))
        for name in names:
            rate = rates[name]
            print(
                f"{count:12d}  {name:42s} {rate:10,.0f} {rate / rates[names[0]]:13.1f} {rate / rates[names[-1]]:14.0%}"
            )


if __name__ == "__main__":
    main()
