"""The paper's way: positions as read, rates by filtered differences."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from dipc_gym import kernels
from dipc_gym.estimators.base import Array, Command, Estimator

if TYPE_CHECKING:
    from dipc_gym.dataflow import Program, Value


@dataclass(frozen=True)
class FilteredDifference:
    """The rates that `DIPC-Friction-v0` observes: differences of readings through a first-order low-pass.

    Attributes:
        time_constant: of the low-pass, s; 0 is the bare difference.
        period: control period, s.

    Example:
        >>> from dipc_gym.dataflow import Program
        >>> program = Program()
        >>> readings = program.join(*(program.input(name) for name in ("cart", "pole1", "pole2")))
        >>> none = program.constant(0.0)
        >>> program.output("seen", FilteredDifference(0.0, 0.01).express(program, readings, none, none))
        >>> memory = program.memory()
        >>> for x in (0.0, 0.02):
        ...     seen, memory = program.run({"cart": [x], "pole1": [0.0], "pole2": [0.0]}, memory)
        >>> seen["seen"][3].item()
        2.0
    """

    time_constant: float
    period: float

    def express(self, program: Program, readings: Value, voltage: Value, force: Value) -> Value:
        """Readings and their filtered rates; zero in the first period."""
        keep, gain = kernels.velocity_gains(self.time_constant, self.period)
        last, rates = program.previous("last_readings", readings), program.state("rates", np.zeros(3))
        now = keep * rates + gain * (readings - last)
        program.update(rates, now)
        return program.join(readings, now)


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
        return FilteredDifference(self.rig.velocity_filter, self.rig.period).express(program, readings, voltage, force)
