"""Speed of the environment beside Gymnasium's own, cost of compensation, and start-up time.

    OMP_NUM_THREADS=1 python benchmarks/environment.py [--steps 20000] [--repeats 5]

Both environments come from `gymnasium.make` with default settings and do 5 physics steps a control step; both get a
voltage or force of zero and are reset whenever an episode ends, which is timed too. Rivals take turns, so that what
else the machine does hits them alike; the highest rate of several rounds counts.
"""

import argparse
import subprocess
import sys
import time
import warnings

import gymnasium
import numpy as np

import dipc_gym
from dipc_gym import compensators
from dipc_gym.compensators import OutOfRangeWarning
from dipc_gym.controllers.lqr import PRINTED_GAIN
from dipc_gym.runs import identify
from dipc_gym.wrappers import EstimateState, ForceCommand


def free_steps_per_second(env, steps):
    action = np.zeros(env.action_space.shape, np.float32)
    env.reset(seed=0)
    start = time.perf_counter()
    for _ in range(steps):
        _, _, terminated, truncated, _ = env.step(action)
        if terminated or truncated:
            env.reset()
    return steps / (time.perf_counter() - start)


def balancing_steps_per_second(env, steps, per_newton):
    observation, _ = env.reset(seed=0)
    start = time.perf_counter()
    for _ in range(steps):
        observation, _, terminated, truncated, _ = env.step(np.array([-per_newton * (PRINTED_GAIN @ observation)]))
        if terminated or truncated:
            observation, _ = env.reset()
    return steps / (time.perf_counter() - start)


def best(measure, candidates, repeats):
    """The highest of several measurements for each candidate, taken in turns."""
    rates = {name: 0.0 for name in candidates}
    for _ in range(repeats):
        for name, candidate in candidates.items():
            rates[name] = max(rates[name], measure(candidate))
    return rates


def compensated(run, name):
    """An environment that commands force; the disturbance observer is in it where a compensator feeds its estimate."""
    env, compensator = gymnasium.make(dipc_gym.ENV_ID), run.fit(name)
    if compensator.observed_friction:
        env = EstimateState(env, run.fit_estimator("disturbance"))
    return ForceCommand(env, compensator)


def start_up(repeats):
    command = [sys.executable, "-m", "dipc_gym", "--help"]
    subprocess.run(command, capture_output=True, check=True)
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        subprocess.run(command, capture_output=True, check=True)
        times.append(time.perf_counter() - start)
    return min(times)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=int, default=20_000)
    parser.add_argument("--repeats", type=int, default=5)
    options = parser.parse_args()

    theirs, ours = "InvertedDoublePendulum-v5", dipc_gym.ENV_ID
    rates = best(
        lambda env: free_steps_per_second(env, options.steps),
        {name: gymnasium.make(name) for name in (theirs, ours)},
        options.repeats,
    )
    print(f"{'environment':32s} {'steps/s':>10s} {'ratio':>7s}")
    for name, rate in rates.items():
        print(f"{name:32s} {rate:10,.0f} {rate / rates[theirs]:7.2f}")

    warnings.simplefilter("ignore", OutOfRangeWarning)
    run = identify()
    closed = {"voltage = force / gain, no wrapper": (gymnasium.make(ours), 0.25)}
    for name in compensators.names():
        closed[f"ForceCommand, {name}"] = (compensated(run, name), 1.0)
    rates = best(lambda pair: balancing_steps_per_second(pair[0], options.steps, pair[1]), closed, options.repeats)
    bare = rates[next(iter(closed))]
    print(f"\n{'closed loop under the LQR':36s} {'us/step':>8s} {'of it compensation':>20s}")
    for name, rate in rates.items():
        print(f"{name:36s} {1e6 / rate:8.1f} {1 - rate / bare:19.0%}")

    print(f"\ndipc-gym --help: {start_up(options.repeats):.2f} s")


if __name__ == "__main__":
    main()
