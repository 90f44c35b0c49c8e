"""What is known before any effect is tried: how well the model predicts as given, and with its parameters refitted."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dipc_gym.sim2real.estimation.fit import Fit, fit
from dipc_gym.sim2real.estimation.problem import Problem
from dipc_gym.sim2real.estimation.settings import ESTIMATION
from dipc_gym.sim2real.selection import partitioning, ranking
from dipc_gym.sim2real.selection.case import Case
from dipc_gym.sim2real.selection.progress import Partition
from dipc_gym.sim2real.selection.settings import SCORE, WINDOWS
from dipc_gym.sim2real.simulation.batch import Stepping


@dataclass(frozen=True)
class Baseline:
    """What is known before any effect is tried.

    Attributes:
        partition: which windows serve for what; outlier windows are among those that are fitted.
        nominal: the model as given, initial states fitted.
        recalibrated: its parameters fitted as well.
        fine: error of the model as given in fine steps, in units of noise, where it predicts to the noise in its own
            and all windows are therefore simulated in these; None elsewhere.
    """

    partition: Partition
    nominal: Fit
    recalibrated: Fit
    fine: float | None


def baseline(case: Case) -> Baseline:
    """Part the windows, and fit the model as given and recalibrated."""
    structure, own = case.prepared.structure, Stepping(case.given.physics.model.opt.timestep)
    whole = case.prepared.problem
    late = whole.windows.start >= case.borders[whole.windows.source]
    problem, comparison, aside = partitioning.split(whole.pick(~late))
    aside, first = aside.join(whole.pick(late)), case.first
    nominal, fine = fit(problem, structure), None
    if _predicts_better(replace(problem, stepping=own), nominal):
        fine = nominal.error
        parts = problem, comparison, aside, first
        problem, comparison, aside, first = (replace(part, stepping=own) for part in parts)
        nominal = fit(problem, structure)
    free = replace(structure, model_parameters=case.given.model_parameters)
    recalibrated = fit(problem, free, initial=nominal.initial, most=ESTIMATION.from_afar)
    outliers = partitioning.outliers_aside(aside, recalibrated)
    if len(outliers):
        problem, others = problem.join(aside.pick(outliers)), np.delete(np.arange(len(aside.windows)), outliers)
        aside = aside.pick(others)
        nominal = fit(problem, structure)
        recalibrated = fit(problem, recalibrated.structure, recalibrated.z, nominal.initial)
    partition = Partition(problem, comparison, aside, first, case.borders, ranking.subset(recalibrated.mse))
    return Baseline(partition, nominal, recalibrated, fine)


def _predicts_better(problem: Problem, fitted: Fit) -> bool:
    """Whether a structure comes down to the noise in the steps of `problem`, and in those it was fitted in does not.

    By every third window; where these do not show what the step costs, others show something else.
    """
    some = np.arange(0, len(problem.windows), WINDOWS.every)
    if fitted.pick(some).error <= SCORE.at_floor:
        return False
    return fit(problem.pick(some), fitted.structure, fitted.z).error <= SCORE.at_floor
