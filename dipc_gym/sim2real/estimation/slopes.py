"""How a program's parameters follow from those of a hypothesis, through MJCF's text and MuJoCo's compiler.

The slopes of that map are found by moving one number at a time, which writes and compiles a model for each. Mostly the
map is affine: a friction level, a damping, a mass or a knot of a table is a number of the program, or several are in
proportion to it. As long as a program's parameters come to where the slopes foretold, the slopes are kept. Values of a
law's table move parameters of their own, whose slopes stay whatever masses do. Where a bend between two of them turns,
another element of the program takes over; only the values beside it are asked anew.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dipc_gym.engine import program
from dipc_gym.physics import Extra, Physics
from dipc_gym.sim2real.estimation.settings import ESTIMATION
from dipc_gym.sim2real.model.structure import Structure

Array = NDArray[np.float64]


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
        alike: for each value whether simulations begin at the same states whatever it is, (p,).
    """

    program: program.Program
    values: Array
    parameters: Array
    by_value: Array
    apart: Array
    tables: NDArray[np.intp]
    alike: NDArray[np.bool_]

    def told(self, values: Array, parameters: Array) -> tuple[NDArray[np.bool_], bool]:
        """For each value of the hypothesis, whether its slope holds at other values too, (p,); and if that is sure.

        Args:
            values: the other values, (p,).
            parameters: of the program at these, (k,).

        It is the values that move a parameter which came out otherwise whose slopes are others. That is not sure: what
        no value moved before may be moved by any; nor is it where a number stays, for a product of two is affine along
        one of them. Values of a table multiply nothing.
        """
        moved = values - self.values
        if not moved.any():
            return self.alike, True
        astray = self._astray(moved, parameters - self.parameters, parameters)
        still = (np.abs(moved) <= ESTIMATION.moved * np.abs(values)) & (self.tables < 0)
        return self.alike & ~np.any(astray & (self.by_value != 0), axis=1), not (astray.any() or still.any())

    def hold(self, moved: Array, parameters: Array, change: Array) -> bool:
        """Whether slopes foretell how parameters (k,) change, (k,), where all values move a little, (p,)."""
        return not self._astray(moved, change, parameters).any()

    def _astray(self, moved: Array, change: Array, parameters: Array) -> NDArray[np.bool_]:
        """Which parameters changed by something else than slopes say, (k,)."""
        rounding = ESTIMATION.rounding * (1 + np.sum(np.abs(moved / np.where(self.apart, self.apart, 1.0))))
        allowed = ESTIMATION.foretold * np.abs(moved) @ np.abs(self.by_value) + rounding * np.abs(parameters)
        return np.asarray(np.abs(moved @ self.by_value - change) > allowed)


@dataclass(frozen=True)
class Near:
    """A hypothesis near some values.

    Attributes:
        structure: its structure.
        program: of that.
        z: mapped parameters, (p,).
        steps: of these that are small, (p,).
        parameters: of the program there, then `maps_of` the model, (k,).
    """

    structure: Structure
    program: program.Program
    z: Array
    steps: Array
    parameters: Array

    def moved(self, sizes: Array) -> tuple[Array, Array] | None:
        """What values (p,) and parameters (k,) change by in a step of so many small ones, (p,); None where that has
        another program.
        """
        there = self.z + sizes * self.steps
        model = self.structure.physics(there)
        parameters = program.parameters_of(self.program, model)
        if parameters is None:
            return None
        values = self.structure.all_values(there) - self.structure.all_values(self.z)
        return values, np.append(parameters, maps_of(model)) - self.parameters

    def confirms(self, slopes: Slopes, held: NDArray[np.bool_]) -> bool:
        """Whether slopes that are held (p,) foretell a step of all these values at once.

        It is of random sizes, so that none makes up for another.
        """
        if not held.any():
            return True
        moved = self.moved(np.where(held, _sizes(len(held)) * (1 - 2 * (np.arange(len(held)) % 2)), 0.0))
        return moved is not None and slopes.hold(moved[0], self.parameters, moved[1])

    def in_groups(self, alike: Callable[[Physics], bool]) -> tuple[Slopes | None, NDArray[np.bool_]]:
        """Slopes by values of tables, a few models for dozens of them, and which these are, (p,); None where they are
        few, or bend at these values.

        Values beside each other in a table may move the same parameter, others do not. Those of a group are moved at
        once, twice and by other sizes: by which share of itself a parameter moves less tells whose it is.

        Args:
            alike: whether simulations of a model begin at the same states as here.
        """
        tables, nothing = self.structure.tables >= 0, (None, np.zeros(len(self.z), dtype=bool))
        asked, told = np.flatnonzero(tables), np.zeros(len(self.z), dtype=bool)
        if len(asked) < ESTIMATION.grouped:
            return nothing
        by_value, apart = np.zeros((len(told), len(self.parameters))), np.zeros(len(told))
        for group in (asked[first :: ESTIMATION.groups] for first in range(ESTIMATION.groups)):
            unit = np.isin(np.arange(len(told)), group).astype(float)
            whole, part = self.moved(unit), self.moved(unit * _sizes(len(told)))
            if whole is None or part is None:
                return nothing
            # One of a law that remembers, as its time constant, may move where simulations begin; the others do not.
            told[group] = alike(self.structure.physics(self.z + unit * self.steps))
            touched = np.flatnonzero(whole[1])
            shares = part[0][group] / whole[0][group]
            mine = np.argmin(np.abs((part[1] / np.where(whole[1], whole[1], 1.0))[touched, None] - shares), axis=1)
            by_value[group[mine], touched] = whole[1][touched] / whole[0][group[mine]]
            apart[group] = whole[0][group]
        values = self.structure.all_values(self.z)
        found = Slopes(self.program, values, self.parameters, by_value, apart, self.structure.tables, told)
        return (found, told) if self.confirms(found, told) else nothing


def _sizes(count: int) -> Array:
    """Sizes of steps that no two values share, (count,)."""
    return np.random.default_rng(0).uniform(0.5, 1.0, count)


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
