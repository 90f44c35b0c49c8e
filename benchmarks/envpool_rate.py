"""Steps a second of EnvPool's InvertedDoublePendulum; `benchmarks/vector.py` has the Python that has EnvPool run it.

VENV/bin/python benchmarks/envpool_rate.py COUNT SECONDS
"""

import sys
import time

import envpool
import numpy as np


def main(count, seconds):
    env = envpool.make("InvertedDoublePendulum-v5", env_type="gymnasium", num_envs=count, seed=0)
    env.reset()
    actions = np.zeros((count, 1))
    for _ in range(2):
        env.step(actions)
    start, steps = time.perf_counter(), 0
    while (spent := time.perf_counter() - start) < seconds:
        env.step(actions)
        steps += count
    print(steps / spent)


if __name__ == "__main__":
    main(int(sys.argv[1]), float(sys.argv[2]))
