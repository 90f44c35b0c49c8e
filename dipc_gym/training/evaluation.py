"""Trials of a policy: runs side by side, how long each lasts, and what the reward was."""

from __future__ import annotations

import warnings

import numpy as np

from dipc_gym.compensators import OutOfRangeWarning
from dipc_gym.policy import Evaluation, Policy
from dipc_gym.training.rig import Rig

WATCHED, REPORTED = 10_000, 20_000  # first seeds of the runs that choose the policy, and of those that judge it
RUNS, SECONDS = 10, 80.0  # of every trial
HELD, RISE = 60.0, 10.0  # of a swing-up: how long it is to stay up, and how long it may take, s


def evaluate(
    policy: Policy, rig: Rig, *, runs: int = RUNS, seconds: float = SECONDS, first_seed: int = REPORTED
) -> Evaluation:
    """Let a policy balance a rig, or swing it up, all runs side by side.

    A swing-up has ten seconds to reach its goal and 60 to stay there, whatever `seconds` says. What can no longer do so
    counts as ended, as what falls does.

    Args:
        policy: what commands.
        rig: what is balanced.
        runs: how many, with initial states of their own.
        seconds: length of a run, s.
        first_seed: of the first run, the others counting up.

    Raises:
        ControllerError: the policy was trained with another compensator.
    """
    policy.require(rig.name)
    envs = rig.many(runs, None)
    period = envs.unwrapped.plant.control_period
    swings = rig.plan is not None
    seconds = HELD if swings else seconds
    up = round(seconds / period)
    steps = up + round(RISE * swings / period)
    away = np.zeros(runs, dtype=int)  # until when it was last not at its goal, control periods
    standing, held, returns = np.ones(runs, dtype=bool), np.full(runs, steps), np.zeros(runs)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", OutOfRangeWarning)
        observations, _ = envs.reset(seed=first_seed)
        for k in range(steps):
            observations, rewards, fell, _, infos = envs.step(policy.command(observations)[:, None])
            returns[standing] += rewards[standing]
            held[standing & fell] = k + 1
            if swings:
                away[~infos["at_goal"]] = k + 1
                standing &= steps - away >= up
            standing &= ~fell
            if not standing.any():
                break
    envs.close()
    if swings:
        held = np.where(standing, up, 0)
    times = tuple(seconds if good else h * period for good, h in zip(standing, held.tolist(), strict=True))
    seeds = tuple(range(first_seed, first_seed + runs))
    return Evaluation(seconds, seeds, times, float(np.median(returns / steps)))
