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
import warnings

import gymnasium
import numpy as np

from dipc_gym import SWING_UP_ID, controllers, runs
from dipc_gym.experiments.compare import Comparison
from dipc_gym.policy import Policy
from dipc_gym.wrappers import VectorEstimateState, VectorForceCommand

RISE = 10.0  # s


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
    brain = controllers.load(given.controller)
    if isinstance(brain, Policy):
        brain.require(given.compensator)
        brain.require_estimator(None if given.estimator == "none" else given.estimator)
    task = {"start": brain.start or "down-down", "goal": brain.goal or "up-up"}
    comparison, total = Comparison(seeds=given.rigs), 0
    for seed in range(given.rigs):
        plant = comparison.rig(seed)
        found = runs.identify(plant, seed=seed)
        envs = gymnasium.make_vec(
            SWING_UP_ID,
            given.resets,
            "vector_entry_point",
            plant=plant,
            autoreset_mode="SameStep",
            max_episode_steps=None,
            threads=1,
            **task,
        )
        if given.estimator != "none":
            envs = VectorEstimateState(envs, found.fit_estimator(given.estimator, seed=seed))
        envs = VectorForceCommand(envs, found.fit(given.compensator, seed=seed))
        each = [controllers.load(given.controller) for _ in range(given.resets)]
        observations, _ = envs.reset(seed=1000 * seed)
        steps = round((given.seconds + RISE) / plant.control_period)
        away, ended = np.zeros(given.resets, dtype=int), np.zeros(given.resets, dtype=bool)
        cart = np.zeros(given.resets)
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
        held = np.where(ended, 0.0, (steps - away) * plant.control_period)
        good = held >= given.seconds
        total += int(good.sum())
        late = f", cart within {1000 * np.median(cart[good]):.0f} mm in the second half" if good.any() else ""
        rise = f", up after {np.median(away[good]) * plant.control_period:.2f} s" if good.any() else ""
        print(f"rig {seed}: {good.sum()} of {given.resets}{rise}{late}", flush=True)
    print(f"{given.controller}: {total} of {given.rigs * given.resets} swung up and held for {given.seconds:g} s")


if __name__ == "__main__":
    main()
