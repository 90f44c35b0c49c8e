"""What is known before any effect is tried: how well the model predicts as given, and with its parameters refitted."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dipc_gym.sim2real.estimation.fit import Fit, fit
from dipc_gym.sim2real.estimation.settings import ESTIMATION
from dipc_gym.sim2real.selection import partitioning, ranking, simulated
from dipc_gym.sim2real.selection.case import Case
from dipc_gym.sim2real.selection.progress import Partition


@dataclass(frozen=True)
class Baseline:
    """What is known before any effect is tried.

    Attributes:
        partition: which windows serve for what; outlier windows are among those that are fitted.
        nominal: the model as given, initial states fitted.
        recalibrated: its parameters fitted as well.
        fine: error in fine steps, in units of noise, of a structure that predicts to the noise in the model's own, and
            clearly better: all windows are therefore simulated in these. None elsewhere.
    """

    partition: Partition
    nominal: Fit
    recalibrated: Fit
    fine: float | None


def baseline(case: Case, fine: float | None = None) -> Baseline:
    """Part the windows, and fit the model as given and recalibrated.

    Args:
        case: windows and model.
        fine: see `Baseline`, where a search found that; the model itself is asked else.
    """
    structure = case.prepared.structure
    whole = case.prepared.problem
    late = whole.windows.start >= case.borders[whole.windows.source]
    problem, comparison, aside = partitioning.split(whole.pick(~late))
    aside, first = aside.join(whole.pick(late)), case.first
    if fine is not None:
        problem, comparison, aside, first = (
            simulated.in_own_steps(p, structure) for p in (problem, comparison, aside, first)
        )
        structure = simulated.as_simulated(structure)
    nominal = fit(problem, structure)
    if simulated.look_simulated(problem, nominal):
        return baseline(case, nominal.error)
    free = replace(structure, model_parameters=case.given.model_parameters)
    recalibrated = fit(problem, free, initial=nominal.initial, most=ESTIMATION.from_afar)
    if simulated.look_simulated(problem, recalibrated):
        return baseline(case, recalibrated.error)
    outliers = partitioning.outliers_aside(aside, recalibrated)
    if len(outliers):
        problem, others = problem.join(aside.pick(outliers)), np.delete(np.arange(len(aside.windows)), outliers)
        aside = aside.pick(others)
        nominal = fit(problem, structure)
        recalibrated = fit(problem, recalibrated.structure, recalibrated.z, nominal.initial)
    partition = Partition(problem, comparison, aside, first, case.borders, ranking.subset(recalibrated.mse))
    return Baseline(partition, nominal, recalibrated, fine)
