"""How a program's parameters follow from those of a hypothesis, through MJCF's text and MuJoCo's compiler.

The slopes of that map are found by moving one number at a time, which writes and compiles a model for each. Mostly the
map is affine: a friction level, a damping, a mass or a knot of a table is a number of the program, or several are in
proportion to it. So as long as a program's parameters come to where the slopes foretold, the slopes are kept.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dipc_gym.engine import program
from dipc_gym.physics import Physics
from dipc_gym.sim2real.simulation.heat import heating_motors

Array = NDArray[np.float64]

_FORETOLD = 1e-7  # share of what the numbers moved a parameter by, to which an affine map foretells it
_ROUNDING = 4 * np.finfo(float).eps  # share of itself, to which a parameter is known
_MOVED = 1e-12  # share of itself from which a number has moved


@dataclass(frozen=True)
class Slopes:
    """The map near some numbers.

    Attributes:
        program: of the structure, right for all numbers that were tried.
        values: numbers of the hypothesis, (p,).
        parameters: of the program there, (k,).
        by_value: their change per unit of each number, (p, k).
        apart: what the numbers differed by to tell it, (p,).
    """

    program: program.Program
    values: Array
    parameters: Array
    by_value: Array
    apart: Array

    def hold(self, values: Array, parameters: Array) -> bool:
        """Whether the map is affine as far as other numbers (p,), at which the program's parameters (k,) are these.

        Only a step in which every number moves tells: a product of two is affine along one of them.
        """
        moved = values - self.values
        if not moved.any():
            return True
        if np.any(np.abs(moved) <= _MOVED * np.abs(values)):
            return False
        rounding = _ROUNDING * (1 + np.sum(np.abs(moved / self.apart)))
        allowed = _FORETOLD * np.abs(moved) @ np.abs(self.by_value) + rounding * np.abs(parameters)
        return bool(np.all(np.abs(self.parameters + moved @ self.by_value - parameters) <= allowed))


def in_parameters_alone(physics: Physics) -> bool:
    """Whether all that numbers of a hypothesis change are parameters of the program: no command, reading or start."""
    return not (physics.stage("command") or physics.stage("sensor") or heating_motors(physics.model))
