"""Friction as a free curve over velocity, and the motor as another: what a model says, or least squares."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Self

import numpy as np

from dipc_gym.compensators.base import Array, Compensator, RigConstants, Samples, Signal, elementwise, numbers

if TYPE_CHECKING:
    from dipc_gym.dataflow import Program, Value

KNOTS = 12
"""Each way from standstill, evenly spaced in the logarithm; with the one at zero, 25."""
SLOWEST = 2e-3
"""First knot, m/s."""
ROUGHNESS = np.geomspace(1e-6, 1e2, 9)
BEYOND = 1e30


@dataclass(frozen=True)
class Curve(Compensator):
    """Add a friction that any curve may give (`curve`), and undo any motor.

        volts = commands(F + friction(v)),

    both by straight lines between knots, which go on beyond the last ones. `dipc-gym compensator` takes the curves from
    a model; `fit` finds the first by least squares, with a penalty on its bends whose weight the test part chooses,
    and takes the motor as linear.

    Attributes:
        velocities: (knots,) of the friction curve, m/s, increasing.
        friction: (knots,) force against the motion beyond the viscous friction in the controller's model, N.
        forces: (points,) of the motor on the blocked cart, N, increasing.
        commands: (points,) voltages that give them, V.

    Raises:
        ValueError: Velocities or forces do not increase, or are fewer than two.

    Example:
        >>> curve = Curve((-1.0, -0.01, 0.01, 1.0), (-8.0, -8.0, 8.0, 8.0), (-4.0, 4.0), (-1.0, 1.0))
        >>> curve.voltage(force=10.0, velocity=0.3), curve.voltage(force=0.0, velocity=0.005)
        (4.5, 1.0)
    """

    velocities: tuple[float, ...] = numbers("knots")
    friction: tuple[float, ...] = numbers("knots")
    forces: tuple[float, ...] = numbers("points")
    commands: tuple[float, ...] = numbers("points")

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("velocities", "forces"):
            knots = getattr(self, name)
            if len(knots) < 2 or not np.all(np.diff(knots) > 0):
                raise ValueError(f"{name} must be two or more increasing numbers")

    @classmethod
    def fit(cls, samples: Samples, rig: RigConstants, *, seed: int = 0) -> Self:
        """Find the friction curve by least squares on the training part; the test part chooses its roughness."""
        fastest = max(float(np.abs(samples.velocity[samples.train]).max()), 2 * SLOWEST)
        way = np.geomspace(SLOWEST, fastest, KNOTS)
        knots = np.concatenate([-way[::-1], [0.0], way])
        hats = np.column_stack([_interpolated(samples.velocity, knots, row) for row in np.eye(len(knots))])
        columns = np.column_stack([samples.force, hats])
        bends = np.diff(np.eye(len(knots)), n=2, axis=0)
        bends = np.column_stack([np.zeros(len(bends)), bends])
        train, volts = samples.train, samples.voltage
        weights = np.sqrt(float(np.sum(train)) * ROUGHNESS)

        def solve(weight: float) -> tuple[float, Array]:
            table = np.vstack([columns[train], weight * bends])
            found = np.linalg.lstsq(table, np.concatenate([volts[train], np.zeros(len(bends))]))[0]
            return float(np.mean((volts[~train] - columns[~train] @ found) ** 2)), found

        _, found = min((solve(weight) for weight in weights.tolist()), key=lambda pair: pair[0])
        per_newton = float(found[0]) if found[0] > 0 else 1 / rig.newtons_per_volt
        friction = tuple((found[1:] / per_newton).tolist())
        return cls(tuple(knots.tolist()), friction, (-1.0, 1.0), (-per_newton, per_newton))

    def volts(self, force: Signal, velocity: Signal, previous_velocity: Signal) -> Signal:
        """Look up friction, then the command."""
        velocities, friction = np.array(self.velocities), np.array(self.friction)
        forces, commands = np.array(self.forces), np.array(self.commands)
        (against,) = elementwise(lambda v: _interpolated(v, velocities, friction), [velocity])
        (volts,) = elementwise(lambda f: _interpolated(f, forces, commands), [force + against])
        return volts

    def express(self, program: Program, force: Value, velocity: Value) -> Value:
        """The same curves, each as a sum of ramps between its knots."""
        against = _ramps(program, velocity, np.array(self.velocities), np.array(self.friction))
        return _ramps(program, force + against, np.array(self.forces), np.array(self.commands))


def _interpolated(x: Array, knots: Array, values: Array) -> Array:
    """Straight lines between knots, and on beyond them."""
    i = np.clip(np.searchsorted(knots, x) - 1, 0, len(knots) - 2)
    return values[i] + (values[i + 1] - values[i]) / (knots[i + 1] - knots[i]) * (x - knots[i])


def _ramps(program: Program, x: Value, knots: Array, values: Array) -> Value:
    widths, slopes = np.diff(knots), np.diff(values) / np.diff(knots)
    low, high = np.zeros(len(widths)), widths.copy()
    low[0], high[-1] = -BEYOND, BEYOND
    along = (x - program.constant(knots[:-1])).maximum(program.constant(low)).minimum(program.constant(high))
    return float(values[0]) + (program.constant(slopes) * along).total()
