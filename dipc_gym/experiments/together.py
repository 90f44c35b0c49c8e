"""Many runs of one pair at once, in the vector environment: to the last bit those of one after the other."""

from __future__ import annotations

import copy
import math
import warnings
from collections.abc import Sequence

import numpy as np

from dipc_gym import compensators, controllers, estimators
from dipc_gym.experiments.cells import NOTED, Balancing
from dipc_gym.plant import Plant
from dipc_gym.runs import MotorFault
from dipc_gym.vector import DIPCFrictionVectorEnv


def fits(plant: Plant, other: Plant) -> bool:
    """Whether two plants can stand in one batch."""
    return plant.layout == other.layout


def held(balancing: Balancing, runs: Sequence[tuple[Plant, MotorFault | None]], seconds: float) -> list[float]:
    """For how long each of many rigs stands, s; all with the pair, the seed and the state of knowledge of a balancing.

    Args:
        balancing: what balances, and from where.
        runs: the rig of each run, and what its motor does to voltages; all have the layout of the balancing's plant.
        seconds: length of a run, s.
    """
    from dipc_gym.wrappers import VectorEstimateState, VectorFaultyMotor, VectorForceCommand

    n, period = len(runs), balancing.plant.control_period
    latest = max((plant for plant, _ in runs), key=lambda plant: plant.delay)
    with warnings.catch_warnings():
        for kind in NOTED:
            warnings.simplefilter("ignore", kind)
        inner = DIPCFrictionVectorEnv(
            n,
            plant=latest,
            model=balancing.model,
            exact_state=balancing.exact_state,
            autoreset_mode="Disabled",
            threads=1,
        )
        faults = [fault or MotorFault() for _, fault in runs]
        envs = VectorFaultyMotor(
            inner,
            noise=np.array([fault.noise for fault in faults]),
            response=np.array([fault.response for fault in faults]),
        )
        if balancing.estimating is not None:
            envs = VectorEstimateState(envs, estimators.load(balancing.estimating))  # type: ignore[assignment]
        envs = VectorForceCommand(envs, compensators.load(balancing.trained))  # type: ignore[assignment]
        observations, _ = envs.reset(seed=0)
        for i, (plant, _) in enumerate(runs):
            options = {"plant": plant, "reset_mask": np.arange(n) == i}
            observations, _ = envs.reset(seed=[balancing.seed] * n, options=options)
        brain = controllers.load(balancing.controller)
        brains = [copy.deepcopy(brain) for _ in range(n)]
        standing, lasted, force = np.ones(n, dtype=bool), np.zeros(n), np.zeros(n)
        for k in range(round(seconds / period)):
            for i in np.flatnonzero(standing).tolist():
                force[i] = brains[i].force(observations[i])
            observations, _, ended, _, _ = envs.step(np.where(standing, force, 0.0)[:, None])
            lasted[standing] = k + 1
            standing &= ~ended
            if not standing.any():
                break
            if ended.any():
                envs.reset(options={"reset_mask": ended})
        envs.close()
    short = math.nextafter(seconds, 0.0)  # of one that fell in the last period, alone as well
    return [seconds if up else min(count * period, short) for up, count in zip(standing, lasted.tolist(), strict=True)]
