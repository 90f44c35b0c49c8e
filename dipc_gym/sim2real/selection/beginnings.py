"""How recordings begin, from rest: what goes with the past may show there alone."""

from __future__ import annotations

import numpy as np

from dipc_gym.sim2real.estimation.fit import Fit, evaluate
from dipc_gym.sim2real.estimation.problem import Problem
from dipc_gym.sim2real.estimation.settings import ESTIMATION
from dipc_gym.sim2real.estimation.shooting import common_error, typical
from dipc_gym.sim2real.selection.settings import SEARCH


def foretold(fitted: Fit) -> bool:
    """Whether a model foretells from rest what follows, with no command or swing of before."""
    model = fitted.structure.physics(fitted.z).model
    return not (fitted.structure.warm or np.any(model.actuator_delay > 0) or np.any(model.sensor_delay > 0))


def have_a_law(fitted: Fit) -> bool:
    """Whether a law that goes with the past is part of a model."""
    return any(term.effect.of_the_past for term in fitted.structure.terms)


def stand_out(first: Problem, fitted: Fit) -> bool:
    """Whether little is left but how recordings begin, and no law of the past is there yet.

    Args:
        first: windows at the beginnings of recordings that begin at rest.
        fitted: to other windows.
    """
    known = common_error(fitted.mse) < SEARCH.in_reach and foretold(fitted)
    if not known or have_a_law(fitted) or not len(first.windows):
        return False
    mse, _ = evaluate(first, fitted.structure, fitted.z)
    return bool(mse.max() > ESTIMATION.far_out * typical(fitted.mse))
