"""How a program's parameters follow from those of a hypothesis, through MJCF's text and MuJoCo's compiler.

The slopes of that map are found by moving one number at a time, which writes and compiles a model for each. Mostly the
map is affine: a friction level, a damping, a mass or a knot of a table is a number of the program, or several are in
proportion to it. So as long as a program's parameters come to where the slopes foretold, the slopes are kept. Values of
a law's table move parameters of their own, whose slopes stay whatever masses do.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dipc_gym.engine import program
from dipc_gym.physics import Extra, Physics
from dipc_gym.sim2real.simulation.heat import heating_motors
from dipc_gym.sim2real.unseen.parts import loads, yielding

Array = NDArray[np.float64]

_FORETOLD = 1e-7  # share of what the values moved a parameter by, to which an affine map foretells it
_ROUNDING = 4 * np.finfo(float).eps  # share of itself, to which a parameter is known
_MOVED = 1e-12  # share of itself from which a value has moved


@dataclass(frozen=True)
class Slopes:
    """The map from values of a hypothesis to parameters of the program, near some values.

    Attributes:
        program: of the structure, right for all values that were tried.
        values: of the hypothesis, (p,).
        parameters: of the program there, then `maps_of` the model, (k,).
        by_value: their change per unit of each value, (p, k).
        apart: what the values differed by to tell it, (p,).
        tables: which law's table each value stands in, -1 for none, (p,).
    """

    program: program.Program
    values: Array
    parameters: Array
    by_value: Array
    apart: Array
    tables: NDArray[np.intp]

    def told(self, values: Array, parameters: Array) -> NDArray[np.bool_]:
        """For each value of the hypothesis, whether its slope holds at other values too, (p,).

        Args:
            values: the other values, (p,).
            parameters: of the program at these, (k,).

        Only a step in which every value moves tells: a product of two is affine along one of them. Values of a table
        multiply nothing.
        """
        moved, held = values - self.values, np.ones(len(values), dtype=bool)
        if not moved.any():
            return held
        rounding = _ROUNDING * (1 + np.sum(np.abs(moved / self.apart)))
        allowed = _FORETOLD * np.abs(moved) @ np.abs(self.by_value) + rounding * np.abs(parameters)
        astray = np.abs(self.parameters + moved @ self.by_value - parameters) > allowed
        if np.any(astray & ~self.by_value.any(axis=0)):
            return ~held
        still = np.abs(moved) <= _MOVED * np.abs(values)
        for table in np.unique(self.tables):
            mine = self.tables == table
            wrong = np.any(astray & self.by_value[mine].any(axis=0))
            held[mine] = not (wrong or (table < 0 and np.any(still[mine])))
        return held


def begins_alike(physics: Physics) -> bool:
    """Whether simulations begin at the same states whatever the values: no winding heats, nothing remembers longer."""
    model = physics.model
    return not (heating_motors(model) or yielding(model) or loads(model) or physics.remembering)


def maps_of(physics: Physics) -> Array:
    """Numbers of what changes commands and readings, which the engine does not see, (m,)."""
    return np.concatenate([np.zeros(0), *(extra.data for extra in physics.extras if _maps(extra))])


def with_maps(physics: Physics, numbers: Array) -> Physics:
    """The same model with other numbers (m,) of what changes commands and readings."""
    at, extras = 0, []
    for extra in physics.extras:
        if _maps(extra):
            extra, at = replace(extra, data=numbers[at : at + len(extra.data)]), at + len(extra.data)
        extras.append(extra)
    return replace(physics, extras=tuple(extras))


def _maps(extra: Extra) -> bool:
    return extra.stage in ("command", "sensor")
