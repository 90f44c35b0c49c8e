"""Do oblique cuts pay? LOLIMOT beside the same idea with cuts in any direction.

    OMP_NUM_THREADS=1 python benchmarks/oblique.py [--samples 3000]

LOLIMOT halves boxes along the axes. HILOMOT (O. Nelles, "Axes-oblique partitioning strategies for local model
networks", IEEE International Symposium on Intelligent Control, 2006) cuts a cell by a sigmoid whose direction and place
are optimised; the validity of a cell is the product of the sigmoids on the way to it. Errors are root mean squares on
as many fresh samples, by number of local models.
"""

import argparse
import time

import numpy as np

from benchmarks.lolimot import friedman, inverse_friction
from dipc_gym.compensators import hilomot
from dipc_gym.compensators.lolimot import LOLIMOT
from dipc_gym.runs import identify

SIZES = (5, 10, 20, 30)


def diagonal(samples, rng):
    """A ridge across two of three inputs, tanh(6 (x + y - 1)); noise 0.05: what oblique cuts are for."""
    X = rng.uniform(size=(samples, 3))
    return X, np.tanh(6 * (X[:, 0] + X[:, 1] - 1)) + 0.05 * rng.normal(size=samples)


def identification(samples, rng):
    """The paper's identification run on the simulated rig: voltage from force and two velocities."""
    data = identify(seed=int(rng.integers(1000))).samples
    part = np.flatnonzero(data.train)
    part = part[:: max(len(part) // samples, 1)]
    return data.inputs[part], data.voltage[part]


def halved(X, y, size):
    return LOLIMOT(max_models=size).fit(X, y)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--samples", type=int, default=3000)
    options = parser.parse_args()
    for problem in (inverse_friction, identification, friedman, diagonal):
        rng = np.random.default_rng(0)
        (X, y), (T, t) = problem(options.samples, rng), problem(options.samples, rng)
        print(f"\n{problem.__doc__.strip()}\n{'':22}{''.join(f'{n:>10}' for n in SIZES)}{'seconds':>10}")
        for name, make in (("LOLIMOT, local", halved), ("HILOMOT", hilomot.grow)):
            errors, start = [], time.perf_counter()
            for size in SIZES:
                model = make(X, y, size)
                errors.append(float(np.sqrt(np.mean((model.predict(T) - t) ** 2))))
            seconds = time.perf_counter() - start
            print(f"{name:22}{''.join(f'{e:10.4f}' for e in errors)}{seconds:10.2f}", flush=True)


if __name__ == "__main__":
    main()
