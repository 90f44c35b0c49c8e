"""The paper's compensator: a locally linear neuro-fuzzy network, trained by LOLIMOT."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Self

import numpy as np

from dipc_gym.compensators.base import (
    Compensator,
    RigConstants,
    Samples,
    Signal,
    elementwise,
    numbers,
)
from dipc_gym.compensators.lolimot import LOLIMOT

if TYPE_CHECKING:
    from dipc_gym.dataflow import Program, Value

MAX_MODELS = 20
"""One call of a network of this size still takes less than 10 microseconds."""


@dataclass(frozen=True)
class LLNF(Compensator):
    """Locally linear neuro-fuzzy inverse model (`llnf`) of Nejadfard et al. (2013).

    The voltage is a mean of local linear models, weighted with normalised Gaussian validities; the
    regressor `LOLIMOT` says how they are trained. A model has 4 linear numbers and 6 for centre and width,
    so the paper's network of 5 models has 50.

    Attributes:
        centres: (models, 3) centres of force (N), velocity and previous velocity (m/s).
        sigmas: (models, 3) standard deviations of the validities, in the same units.
        levels: (models,) voltages at the centres, V.
        slopes: (models, 3) slopes: V/N, V s/m, V s/m.

    Example:
        >>> LLNF(centres=((0.0, 0.0, 0.0),), sigmas=((20.0, 1.0, 1.0),), levels=(0.5,),
        ...      slopes=((0.25, 0.0, 0.0),)).voltage(force=8.0, velocity=0.1)
        2.5
    """

    centres: tuple[tuple[float, ...], ...] = numbers("models", 3)
    sigmas: tuple[tuple[float, ...], ...] = numbers("models", 3, positive=True)
    levels: tuple[float, ...] = numbers("models")
    slopes: tuple[tuple[float, ...], ...] = numbers("models", 3)
    _models: list[tuple[float, ...]] = field(default_factory=list, init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        super().__post_init__()
        for centre, sigma, level, slope in zip(self.centres, self.sigmas, self.levels, self.slopes, strict=True):
            inverse = tuple(math.sqrt(0.5) / width for width in sigma)
            self._models.append((*centre, *inverse, level, *slope))

    @classmethod
    def fit(cls, samples: Samples, rig: RigConstants, *, seed: int = 0) -> Self:
        """Grow the network on the training part until the error on the test part stops falling.

        As in the paper, the test part decides when to stop; so the test error flatters a little.
        """
        inputs, train = samples.inputs, samples.train
        model = LOLIMOT(max_models=MAX_MODELS, border_validity=0.7).fit(
            inputs[train], samples.voltage[train], test=(inputs[~train], samples.voltage[~train])
        )
        return cls(
            centres=_rows(model.centres_.tolist()),
            sigmas=_rows(model.sigmas_.tolist()),
            levels=tuple(model.levels_.tolist()),
            slopes=_rows(model.slopes_.tolist()),
        )

    def volts(self, force: Signal, velocity: Signal, previous_velocity: Signal) -> Signal:
        """Blend the local models; the nearest one keeps a validity of 1 however far away it is."""
        exponents = []
        outputs = []
        for f, v, p, per_f, per_v, per_p, level, slope_f, slope_v, slope_p in self._models:
            df, dv, dp = force - f, velocity - v, previous_velocity - p
            a, b, c = df * per_f, dv * per_v, dp * per_p
            exponents.append(a * a + b * b + c * c)
            outputs.append(level + slope_f * df + slope_v * dv + slope_p * dp)
        validities = elementwise(_relative_validity, exponents)
        total = validities[0]
        blend = validities[0] * outputs[0]
        for validity, output in zip(validities[1:], outputs[1:], strict=True):
            total = total + validity
            blend = blend + validity * output
        return blend / total

    def express(self, program: Program, force: Value, velocity: Value) -> Value:
        """The same blend as `volts`, on vectors with an entry for each local model."""
        previous = program.previous("previous_velocity", velocity)
        centres, inverses = np.array(self.centres), math.sqrt(0.5) / np.array(self.sigmas)
        slopes, squares, outputs = np.array(self.slopes), [], program.constant(self.levels)
        for i, signal in enumerate((force, velocity, previous)):
            distance = signal - program.constant(centres[:, i])
            scaled = distance * program.constant(inverses[:, i])
            squares.append(scaled * scaled)
            outputs = outputs + program.constant(slopes[:, i]) * distance
        exponents = squares[0] + squares[1] + squares[2]
        validities = (exponents.least() - exponents).exp()
        return (validities * outputs).total() / validities.total()


def _relative_validity(exponents: np.ndarray) -> np.ndarray:
    return np.exp(np.minimum.reduce(exponents) - exponents)


def _rows(table: list[list[float]]) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(row) for row in table)
