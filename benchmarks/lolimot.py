"""Training time and errors of LOLIMOT beside its closest public rivals.

    OMP_NUM_THREADS=1 python benchmarks/lolimot.py [--samples 10000] [--repeats 5] [--public lolimot.py]

No package on PyPI trains LOLIMOT (looked for in November 2026: none by that name, and none found by what it does).
There is a class in Python, LolimotRegressor, in the file lolimot.py of the repository 4204015/Trajektorienplanung;
`--public` takes a copy of that file, any of its versions, and numexpr must be installed for it. The closest public
packages are linear-tree, a regression tree with linear models in its leaves, hard-edged, whose last
version, 0.3.5, runs with scikit-learn below 1.6 only; and anfis-toolbox, which tunes a neuro-fuzzy network with rules
on a grid: 3 fuzzy sets an input make 27 rules of 3 inputs, and 59,049 of 10, which it cannot hold. Where one cannot
run, or is not installed, the table says so. The other rivals are scikit-learn's: an MLP of the paper's size, its
default MLP, gradient boosted trees, a tree.

Times are the lowest of several runs, because the machine may be busy with other things, or of one that takes more than
10 s; all models train on the same samples and are tested on as many others. Errors are root mean squares, in the unit
of the output.
"""

import argparse
import contextlib
import importlib.util
import os
import sys
import time
import warnings
from pathlib import Path

import numpy as np
import sklearn.neighbors
from sklearn.datasets import make_friedman1
from sklearn.ensemble import HistGradientBoostingRegressor
from sklearn.linear_model import LinearRegression
from sklearn.neural_network import MLPRegressor
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler
from sklearn.tree import DecisionTreeRegressor

from dipc_gym.compensators.lolimot import LOLIMOT


def inverse_friction(samples, rng):
    """Voltage of a motor against Stribeck friction, from force and two velocities; noise 0.05 V."""
    velocity = rng.uniform(-1, 1, samples)
    previous = velocity - rng.uniform(-0.1, 0.1, samples)
    force = rng.uniform(-60, 60, samples)
    friction = (8 + 3 * np.exp(-((velocity / 0.1) ** 2))) * np.tanh(velocity / 0.03)
    X = np.column_stack([force, velocity, previous])
    return X, (force + friction) / 4 + 0.05 * rng.normal(size=samples)


def friedman(samples, rng):
    """Friedman's first function: 10 inputs, 5 of which matter; noise 0.5."""
    return make_friedman1(samples, noise=0.5, random_state=int(rng.integers(2**31)))


def linear_tree():
    from lineartree import LinearTreeRegressor

    return LinearTreeRegressor(LinearRegression(), max_depth=5, max_bins=25)


def public(file):
    """The class in a copy of its file, with as many models; its later versions import from where something once was."""
    if file is None:
        raise ImportError("say --public lolimot.py")
    sys.modules.setdefault("sklearn.neighbors.kde", sklearn.neighbors)
    found = importlib.util.spec_from_file_location("public_lolimot", file)
    module = importlib.util.module_from_spec(found)
    found.loader.exec_module(module)
    return module.LolimotRegressor(model_complexity=30, notebook=False)


class Anfis:
    """The regressor of anfis-toolbox with its own defaults, 20 epochs."""

    def fit(self, X, y):
        from anfis_toolbox import ANFISRegressor

        if 3 ** X.shape[1] > 1000:
            raise AttributeError(f"{3 ** X.shape[1]:,} rules")
        self.model = ANFISRegressor(epochs=20, random_state=0).fit(X, y)

    def predict(self, X):
        return np.ravel(self.model.predict(X))


def scaled(**options):
    return make_pipeline(StandardScaler(), MLPRegressor(random_state=0, **options))


REGRESSORS = {
    "LOLIMOT, 30 models, local": lambda: LOLIMOT(max_models=30),
    "LOLIMOT, 30 models, global": lambda: LOLIMOT(max_models=30, estimation="global"),
    "linear-tree, up to 32 leaves": linear_tree,
    "anfis-toolbox, 3 sets an input": Anfis,
    "scikit-learn tree, 150 leaves": lambda: DecisionTreeRegressor(max_leaf_nodes=150, random_state=0),
    "scikit-learn boosted trees": lambda: HistGradientBoostingRegressor(random_state=0),
    "scikit-learn MLP, 5 tanh, lbfgs": lambda: scaled(
        hidden_layer_sizes=(5,), activation="tanh", solver="lbfgs", max_iter=2000
    ),
    "scikit-learn MLP, default (100)": lambda: scaled(),
}


def measure(make, train, test, repeats):
    """Return the lowest training time in s and the RMS errors on both sets."""
    seconds = []
    for _ in range(repeats):
        model = make()
        start = time.perf_counter()
        with Path(os.devnull).open("w") as nothing, contextlib.redirect_stderr(nothing):  # of a progress bar
            model.fit(*train)
        seconds.append(time.perf_counter() - start)
        if seconds[-1] > 10:
            break
    errors = [float(np.sqrt(np.mean((model.predict(X) - y) ** 2))) for X, y in (train, test)]
    return min(seconds), *errors


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--samples", type=int, default=10_000, help="training samples (and as many for test)")
    parser.add_argument("--repeats", type=int, default=5, help="runs of which the fastest counts")
    parser.add_argument("--public", metavar="FILE", help="copy of lolimot.py of 4204015/Trajektorienplanung")
    options = parser.parse_args()
    regressors = {**REGRESSORS, "LolimotRegressor, 30 models": lambda: public(options.public)}
    warnings.simplefilter("ignore")  # an MLP that has not converged says so at length; its error shows it

    for problem in (inverse_friction, friedman):
        rng = np.random.default_rng(0)
        train, test = problem(options.samples, rng), problem(options.samples, rng)
        print(f"\n{problem.__doc__}\n{options.samples} samples, {train[0].shape[1]} inputs\n")
        print(f"{'':34}{'training s':>11}{'ratio':>8}{'train rms':>11}{'test rms':>10}")
        reference = None
        for name, make in regressors.items():
            try:
                seconds, train_error, test_error = measure(make, train, test, options.repeats)
            except (ImportError, AttributeError) as error:
                print(f"{name:34}not run: {error}")
                continue
            reference = reference or seconds
            ratio = seconds / reference
            print(f"{name:34}{seconds:11.4f}{ratio:8.1f}{train_error:11.4f}{test_error:10.4f}", flush=True)


if __name__ == "__main__":
    main()
