"""Do oblique cuts pay? LOLIMOT beside the same idea with cuts in any direction.

    OMP_NUM_THREADS=1 python benchmarks/oblique.py [--samples 3000]

LOLIMOT halves boxes along the axes. HILOMOT (O. Nelles, "Axes-oblique partitioning strategies for local model
networks", IEEE International Symposium on Intelligent Control, 2006) cuts a cell by a sigmoid whose direction and place
are optimised; the validity of a cell is the product of the sigmoids on the way to it. This is that, as short as it goes, to
measure what LOLIMOT would win by it. Errors are root mean squares on as many fresh samples, by number of local models.
"""

import argparse
import time

import numpy as np
from scipy.optimize import minimize

from benchmarks.lolimot import friedman, inverse_friction
from dipc_gym.compensators.lolimot import LOLIMOT
from dipc_gym.runs import identify

SIZES = (5, 10, 20, 30)
STEEPNESS = 20.0  # of a first cut, in units of the cell's spread along it, squared
ITERATIONS = 12


class Oblique:
    """Hierarchy of sigmoid cuts with a linear model in each cell, each estimated by weighted least squares."""

    def __init__(self, max_models):
        self.max_models = max_models

    def fit(self, X, y):
        self.low, self.span = X.min(axis=0), np.ptp(X, axis=0)
        Z = self._scaled(X)
        self.cuts, self.cells, self.theta = [], [()], [self._line(Z, y, np.ones(len(y)))]
        validity = [np.ones(len(y))]
        while len(self.cells) < self.max_models:
            outputs = np.array([Z @ line for line in self.theta])
            error = (y - np.sum(np.array(validity) * outputs, axis=0)) ** 2
            worst = int(np.argmax(np.array(validity) @ error))
            rest = sum(v * o for k, (v, o) in enumerate(zip(validity, outputs, strict=True)) if k != worst)

            def halves(cut, mother=validity[worst]):
                share = 1 / (1 + np.exp(-np.clip(Z @ cut, -60, 60)))
                return mother * share, mother * (1 - share)

            def loss(cut, halves=halves, rest=rest):
                parts = halves(cut)
                return np.mean((y - rest - sum(v * (Z @ self._line(Z, y, v)) for v in parts)) ** 2)

            mass = validity[worst] / validity[worst].sum()
            centre = mass @ Z[:, 1:]
            spread = np.sqrt(mass @ (Z[:, 1:] - centre) ** 2) + 1e-9
            starts = []
            for axis in range(X.shape[1]):
                cut = np.zeros(X.shape[1] + 1)
                cut[1 + axis] = np.sqrt(STEEPNESS) / spread[axis]
                cut[0] = -cut[1 + axis] * centre[axis]
                starts.append(cut)
            best = min(starts, key=loss)
            best = minimize(loss, best, method="L-BFGS-B", options={"maxiter": ITERATIONS}).x
            one, other = halves(best)
            path = self.cells[worst]
            self.cuts.append(best)
            self.cells[worst] = (*path, (len(self.cuts) - 1, True))
            self.cells.append((*path, (len(self.cuts) - 1, False)))
            validity[worst] = one
            validity.append(other)
            self.theta[worst] = self._line(Z, y, one)
            self.theta.append(self._line(Z, y, other))
        return self

    def predict(self, X):
        Z = self._scaled(X)
        shares = [1 / (1 + np.exp(-np.clip(Z @ cut, -60, 60))) for cut in self.cuts]
        total = np.zeros(len(X))
        for path, line in zip(self.cells, self.theta, strict=True):
            validity = np.ones(len(X))
            for cut, upper in path:
                validity = validity * (shares[cut] if upper else 1 - shares[cut])
            total += validity * (Z @ line)
        return total

    def _scaled(self, X):
        return np.column_stack([np.ones(len(X)), (X - self.low) / self.span])

    @staticmethod
    def _line(Z, y, validity):
        normal = (Z.T * validity) @ Z + 1e-3 * np.eye(Z.shape[1])
        return np.linalg.solve(normal, (Z.T * validity) @ y)


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


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--samples", type=int, default=3000)
    options = parser.parse_args()
    for problem in (inverse_friction, identification, friedman, diagonal):
        rng = np.random.default_rng(0)
        (X, y), (T, t) = problem(options.samples, rng), problem(options.samples, rng)
        print(f"\n{problem.__doc__.strip()}\n{'':22}{''.join(f'{n:>10}' for n in SIZES)}{'seconds':>10}")
        for name, make in (("LOLIMOT, local", LOLIMOT), ("oblique", Oblique)):
            errors, start = [], time.perf_counter()
            for size in SIZES:
                model = make(max_models=size).fit(X, y)
                errors.append(float(np.sqrt(np.mean((model.predict(T) - t) ** 2))))
            seconds = time.perf_counter() - start
            print(f"{name:22}{''.join(f'{e:10.4f}' for e in errors)}{seconds:10.2f}", flush=True)


if __name__ == "__main__":
    main()
