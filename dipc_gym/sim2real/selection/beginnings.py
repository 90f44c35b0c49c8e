"""How recordings begin, from rest: what goes with the past may show there alone."""

from __future__ import annotations

import numpy as np

from dipc_gym.sim2real.estimation.fit import Fit, evaluate
from dipc_gym.sim2real.estimation.problem import Problem
from dipc_gym.sim2real.estimation.settings import ESTIMATION
from dipc_gym.sim2real.estimation.shooting import common_error, rms, typical
from dipc_gym.sim2real.selection.settings import SEARCH
from dipc_gym.sim2real.unseen.parts import loads


def foretold(fitted: Fit) -> bool:
    """Whether a model foretells from rest what follows, with no command or swing of before.

    A load that hangs may swing though the joint that carries it rests.
    """
    model = fitted.structure.physics(fitted.z).model
    late = np.any(model.actuator_delay > 0) or np.any(model.sensor_delay > 0)
    return not (fitted.structure.warm or late or loads(model))


def have_a_law(fitted: Fit) -> bool:
    """Whether a law that goes with the past is part of a model."""
    return any(term.effect.of_the_past for term in fitted.structure.terms)


def left(first: Problem, fitted: Fit) -> float | None:
    """The error where recordings begin, in units of noise, if little is left but that, and no law of the past is there
    yet; None otherwise.

    Args:
        first: windows at the beginnings of recordings that begin at rest.
        fitted: to other windows.
    """
    known = common_error(fitted.mse) < SEARCH.in_reach and foretold(fitted)
    if not known or have_a_law(fitted) or not len(first.windows):
        return None
    mse = evaluate(first, fitted.structure, fitted.z)
    return rms(mse) if mse.max() > ESTIMATION.far_out * typical(fitted.mse) else None
