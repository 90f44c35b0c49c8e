"""Is a friction compensator worth it to a learner? Learning curves with and without, over seeds.

    python -m benchmarks.learning [--seeds 5] [--compensators none llnf ideal] [--out runs/learning]
                                  [--jobs 2] [--backend ray]

PPO as `dipc-gym train-policy` has it, at its own budget of control periods, once for each seed and compensator; `none`
commands the voltage itself. Every training is tried eight times on the way, by ten runs of 80 s, and its best policy by
ten further runs that did not choose it. What is finished is not trained again when the benchmark is started again; a
training that was killed on the way is. Prints medians and quartiles over the seeds and draws the curves.
"""

import argparse
import sys
from pathlib import Path

import numpy as np

from dipc_gym.drawing import style
from dipc_gym.experiments import figures
from dipc_gym.policy import Policy
from dipc_gym.training import seeds
from dipc_gym.training.train import RECIPES, Training

ALPHA = 0.2
NAMES = {"none": "voltage", "ideal": "ideal (true friction known)"}


def trained(options):
    """Train what is not trained yet; by compensator and seed, the policy and its curve, one row for each trial."""
    wanted = [
        Training(compensator=compensator, seed=seed, recipe=RECIPES["ppo"])
        for seed in range(options.seeds)
        for compensator in options.compensators
    ]
    outcomes = seeds.run(wanted, options.out, jobs=options.jobs, backend=options.backend)
    if failed := [f"{outcome.cell.name}: {outcome.failure}" for outcome in outcomes if outcome.failure is not None]:
        sys.exit("\n".join(failed) + "\nthe same command tries these again")
    done = {}
    for training, outcome in zip(wanted, outcomes, strict=True):
        folder = options.out / outcome.cell.name
        curve = np.genfromtxt(folder / "curve.csv", delimiter=",", names=True)
        done[training.compensator, training.seed] = Policy.load(folder / "policy.json"), curve
    return done


def quartiles(values, form):
    low, middle, high = np.quantile(values, [0.25, 0.5, 0.75])
    return f"{middle:{form}} ({low:{form}} to {high:{form}})"


def draw(curves, stem):
    """Medians, and the band between the quartiles, of return and of the time that runs lasted."""

    def of_width(width):
        from matplotlib.figure import Figure

        narrow = width <= style.NARROW
        figure = Figure((width, 1.2 * width if narrow else 0.4 * width), layout="constrained")
        axes = figure.subplots(*((2, 1) if narrow else (1, 2)))
        for name, rows in curves.items():
            steps = np.mean([row["steps"] for row in rows], axis=0) / 1000
            look = style.of(name, tuple(curves)).line
            for axis, key in zip(axes, ("reward", "held"), strict=True):
                low, middle, high = np.quantile([row[key] for row in rows], [0.25, 0.5, 0.75], axis=0)
                axis.plot(steps, middle, label=NAMES.get(name, f"force through {name}"), **look)
                axis.fill_between(steps, low, high, color=look["color"], alpha=ALPHA, linewidth=0)
        axes[0].set(xlabel="control periods / 1000", ylabel="return of 80 s, share of the largest", ylim=(0, 1.02))
        axes[1].set(xlabel="control periods / 1000", ylabel="time until it falls / s", ylim=(0, 82))
        axes[0].legend(loc="lower right")
        return figure

    figures.write(of_width, stem)
    print(f"\n{stem}.png")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--compensators", nargs="+", default=["none", "llnf", "ideal"])
    parser.add_argument("--out", type=Path, default=Path("runs/learning"))
    parser.add_argument("--jobs", type=int, help="trainings at a time; without it 2, or the cluster's CPUs")
    parser.add_argument("--backend", choices=("local", "ray"), default="local")
    options = parser.parse_args()
    if options.seeds < 1:
        parser.error("--seeds must be above zero")
    done = trained(options)

    curves = {c: [done[c, s][1] for s in range(options.seeds)] for c in options.compensators}
    marks = curves[options.compensators[0]][0]["steps"]
    print("median (quartiles) over seeds of the time until it falls, s, after so many control periods\n")
    print(f"{'':14s}" + "".join(f"{mark / 1000:18,.0f}k" for mark in marks))
    for name, rows in curves.items():
        cells = [quartiles([row["held"][i] for row in rows], ".1f") for i in range(len(marks))]
        print(f"{name:14s}" + "".join(f"{cell:>19s}" for cell in cells))
    print("\nbest policy of each training, tried by ten runs of 80 s that did not choose it\n")
    print(f"{'':14s}{'all ten stood':>15s}{'return, share of the largest':>36s}{'least runs stood':>18s}")
    for name in options.compensators:
        tried = [done[name, s][0].evaluation for s in range(options.seeds)]
        whole = sum(one.standing == len(one.held) for one in tried)
        returns = quartiles([one.reward for one in tried], ".4f")
        print(f"{name:14s}{whole:9d} of {options.seeds:2d}{returns:>36s}{min(one.standing for one in tried):15d}/10")
    draw(curves, options.out / "learning")


if __name__ == "__main__":
    main()
