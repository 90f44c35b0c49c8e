"""The paper's way: positions as read, rates by filtered differences."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from dipc_gym import kernels
from dipc_gym.estimators.base import Array, Command, Estimator

if TYPE_CHECKING:
    from dipc_gym.export.program import Program, Value


@dataclass(frozen=True)
class Differences(Estimator):
    """Filtered differences (`differences`), the environment's own observation; it looks at no command.

    v(k) = a v(k-1) + (1 - a) (p(k) - p(k-1)) / T with a = exp(-T / velocity_filter).
    """

    def begin(self, observations: Array) -> Array:
        """What is observed at first."""
        return observations.copy()

    def advance(self, state: Array, readings: Array, command: Command) -> Array:
        """Difference and filter."""
        keep, gain = kernels.velocity_gains(self.rig.velocity_filter, self.rig.period)
        rates = kernels.velocity(readings, state[:, :3], state[:, 3:], keep, gain)
        return np.hstack([readings, rates])

    def observation(self, state: Array) -> Array:
        """Readings and their filtered differences."""
        return state.copy()

    def express(self, program: Program, readings: Value, voltage: Value, force: Value) -> Value:
        """The same, written into a program that can be exported."""
        from dipc_gym.export.parts import FilteredDifference

        return FilteredDifference(self.rig.velocity_filter, self.rig.period).express(program, readings, voltage, force)
