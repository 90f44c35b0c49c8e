"""What is known before any effect is tried: how well the model predicts as given, and with its own numbers refitted."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dipc_gym.sim2real.estimation.fit import Fit, fit
from dipc_gym.sim2real.estimation.problem import Problem
from dipc_gym.sim2real.selection import data
from dipc_gym.sim2real.selection.case import Case
from dipc_gym.sim2real.selection.ranking import AT_FLOOR
from dipc_gym.sim2real.simulation.batch import Stepping


@dataclass(frozen=True)
class Baseline:
    """What is known before any effect is tried.

    Attributes:
        problem: windows to fit, those in which something odd happened among them.
        unseen: windows to compare on.
        rest: windows left aside, and those to validate by.
        test: windows for the judgement alone.
        nominal: the model as given, start states fitted.
        recalibrated: its own numbers fitted as well.
        fine: error of the model as given in fine steps, in units of noise, where it predicts to the noise in its own
            and all windows are therefore simulated in these; None elsewhere.
    """

    problem: Problem
    unseen: Problem
    rest: Problem
    test: Problem
    nominal: Fit
    recalibrated: Fit
    fine: float | None


def baseline(case: Case) -> Baseline:
    """Part the windows, and fit the model as given and recalibrated."""
    structure, own = case.prepared.structure, Stepping(case.given.physics.model.opt.timestep)
    whole, test = case.prepared.problem, case.test
    late = whole.windows.start >= case.borders[whole.windows.source]
    problem, unseen, rest = data.split(whole.pick(~late))
    rest = rest.join(whole.pick(late))
    nominal, fine = fit(problem, structure), None
    if _predicts_better(replace(problem, stepping=own), nominal):
        fine = nominal.error
        problem, unseen, rest, test = (replace(part, stepping=own) for part in (problem, unseen, rest, test))
        nominal = fit(problem, structure)
    free = replace(structure, numbers=case.given.numbers)
    recalibrated = fit(problem, free, starts=nominal.starts, most=20)
    odd = data.odd(rest, recalibrated)
    if len(odd):
        problem, rest = problem.join(rest.pick(odd)), rest.pick(np.delete(np.arange(len(rest.windows)), odd))
        nominal = fit(problem, structure)
        recalibrated = fit(problem, recalibrated.structure, recalibrated.z, nominal.starts)
    return Baseline(problem, unseen, rest, test, nominal, recalibrated, fine)


def _predicts_better(problem: Problem, fitted: Fit) -> bool:
    """Whether a structure comes down to the noise in the steps of `problem`, and in those it was fitted in does not.

    By every third window; where these do not show what the step costs, others show something else.
    """
    some = np.arange(0, len(problem.windows), 3)
    if fitted.pick(some).error <= AT_FLOOR:
        return False
    return fit(problem.pick(some), fitted.structure, fitted.z).error <= AT_FLOOR
