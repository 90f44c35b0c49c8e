"""How many resets swing up and stay up: all resets of a rig at once in the vector environment.

    python -m benchmarks.swing_up [--controller tvlqr] [--compensator observed] [--rigs 5] [--resets 15] [--seconds 60]

Rigs are those of `compare`: friction and encoder noise differ. On each, friction is identified anew, the compensator is
fitted to that run, and what sees the rig is the estimator `rigid_body`, or what `--estimator` says, `none` for the
environment's own observation. A policy is to get the compensator and the estimator that it was trained with. Plan and
policy are made for the paper's rig and not changed. A run counts if it ends with both poles within 0.35 rad of the goal
for so many seconds without a break; it may take ten seconds to get there.
"""

from __future__ import annotations

import argparse
import math
import warnings
from dataclasses import dataclass

import gymnasium
import numpy as np

from dipc_gym import SWING_UP_ID, controllers, runs
from dipc_gym.experiments.compare import Comparison
from dipc_gym.policy import Policy
from dipc_gym.wrappers import VectorEstimateState, VectorForceCommand

RISE = 10.0  # s


@dataclass(frozen=True)
class Tried:
    """What the resets of one rig came to.

    Attributes:
        count: resets.
        good: those that got there in time and stayed.
        rise: s until they were there for good, the median; NaN if none was.
        cart: m, largest distance from the middle in the second half, the median; NaN if none was good.
    """

    count: int
    good: int
    rise: float
    cart: float

    def __str__(self) -> str:
        there = f", there after {self.rise:.2f} s, cart within {1000 * self.cart:.0f} mm in the second half"
        return f"{self.good} of {self.count}{there if self.good else ''}"


def tried(
    controller: str,
    seed: int,
    compensator: str = "observed",
    estimator: str = "rigid_body",
    resets: int = 15,
    seconds: float = 60.0,
) -> Tried:
    """Identify a rig of `compare`, and let a plan or a policy take it from so many resets to its goal.

    Args:
        controller: what `controllers.load` takes.
        seed: of the rig, and of its resets.
        compensator: name of one, fitted to the identification run.
        estimator: name of one, or `none` for the environment's own observation.
        resets: how many, all at once.
        seconds: s that a run must stay.
    """
    brain = controllers.load(controller)
    if isinstance(brain, Policy):
        brain.require(compensator)
        brain.require_estimator(None if estimator == "none" else estimator)
    plant = Comparison(seeds=seed + 1).rig(seed)
    found = runs.identify(plant, seed=seed)
    envs = gymnasium.make_vec(
        SWING_UP_ID,
        resets,
        "vector_entry_point",
        plant=plant,
        autoreset_mode="SameStep",
        max_episode_steps=None,
        threads=1,
        start=brain.start or "down-down",
        goal=brain.goal or "up-up",
    )
    if estimator != "none":
        envs = VectorEstimateState(envs, found.fit_estimator(estimator, seed=seed))
    envs = VectorForceCommand(envs, found.fit(compensator, seed=seed))
    each = [controllers.load(controller) for _ in range(resets)]
    observations, _ = envs.reset(seed=1000 * seed)
    steps = round((seconds + RISE) / plant.control_period)
    away, ended = np.zeros(resets, dtype=int), np.zeros(resets, dtype=bool)
    cart = np.zeros(resets)
    for k in range(steps):
        if isinstance(brain, Policy):
            force = brain.command(observations) * (brain.newtons_per_volt if brain.commands == "voltage" else 1.0)
        else:
            force = np.array([one.force(seen) for one, seen in zip(each, observations, strict=True)])
        observations, _, over, _, infos = envs.step(force[:, None])
        away[~infos["at_goal"]] = k + 1
        ended |= over
        if 2 * k > steps:
            cart = np.maximum(cart, np.abs(envs.unwrapped.state[:, 0]))
    good = np.where(ended, 0.0, (steps - away) * plant.control_period) >= seconds
    if not good.any():
        return Tried(resets, 0, math.nan, math.nan)
    return Tried(
        resets, int(good.sum()), float(np.median(away[good]) * plant.control_period), float(np.median(cart[good]))
    )


def main() -> None:
    """Swing up and print."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--controller", default="tvlqr")
    options.add_argument("--compensator", default="observed")
    options.add_argument("--estimator", default="rigid_body")
    options.add_argument("--rigs", type=int, default=5)
    options.add_argument("--resets", type=int, default=15)
    options.add_argument("--seconds", type=float, default=60.0)
    given = options.parse_args()
    warnings.simplefilter("ignore")
    total = 0
    for seed in range(given.rigs):
        one = tried(given.controller, seed, given.compensator, given.estimator, given.resets, given.seconds)
        total += one.good
        print(f"rig {seed}: {one}", flush=True)
    print(f"{given.controller}: {total} of {given.rigs * given.resets} swung up and held for {given.seconds:g} s")


if __name__ == "__main__":
    main()
