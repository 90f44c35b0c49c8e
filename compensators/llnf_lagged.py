"""LLNF with lagged inputs, the lags chosen by LOLIMOT."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Self

import numpy as np

from dipc_gym.compensators.base import Array, RigConstants, Samples, numbers
from dipc_gym.compensators.lolimot import LOLIMOT
from dipc_gym.compensators.memory import FRESH, Remembering, given, gone_on

if TYPE_CHECKING:
    from dipc_gym.dataflow import Program, Value

LAGS = 4
"""Velocities v(k) to v(k-4) and forces F(k) to F(k-4) can be inputs."""
SMALLEST_GAIN = 0.01
"""Share by which an input must lower the error on the test part to be taken."""
MODELS = 12  # at most; each has more slopes than one of llnf


@dataclass(frozen=True)
class LaggedLLNF(Remembering):
    """Locally linear neuro-fuzzy inverse model that remembers four periods (`llnf_lagged`).

    Inputs are chosen one at a time from forces and velocities now and up to four periods ago, F(k) and v(k) first: the
    one with which LOLIMOT's error on the test part falls most, as long as it falls by a hundredth. The test part thus
    decides on inputs and size, and its error flatters. Memory: the last four forces and velocities.

    Attributes:
        inputs: which are used: 0 to 4 are F(k) to F(k-4), 5 to 9 are v(k) to v(k-4).
        centres: (models, inputs).
        sigmas: (models, inputs).
        levels: (models,) V.
        slopes: (models, inputs).
    """

    inputs: tuple[float, ...] = numbers("inputs")
    centres: tuple[tuple[float, ...], ...] = numbers("models", "inputs")
    sigmas: tuple[tuple[float, ...], ...] = numbers("models", "inputs", positive=True)
    levels: tuple[float, ...] = numbers("models")
    slopes: tuple[tuple[float, ...], ...] = numbers("models", "inputs")

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(set(self.inputs)) < len(self.inputs) or not set(self.inputs) <= set(range(2 * (LAGS + 1))):
            raise ValueError(f"inputs are {self.inputs}; they must be different whole numbers from 0 to {2 * LAGS + 1}")

    @classmethod
    def fit(cls, samples: Samples, rig: RigConstants, *, seed: int = 0) -> Self:
        """Choose inputs and grow the network."""
        table = np.hstack([_lagged(samples.force), _lagged(samples.velocity)])
        train, volts = samples.train, samples.voltage

        def grown(inputs: list[int]) -> tuple[float, LOLIMOT]:
            test = table[~train][:, inputs]
            model = LOLIMOT(max_models=MODELS, border_validity=0.7).fit(
                table[train][:, inputs], volts[train], test=(test, volts[~train])
            )
            return float(np.mean((model.predict(test) - volts[~train]) ** 2)), model

        inputs = [0, LAGS + 1]
        error, model = grown(inputs)
        while len(inputs) < table.shape[1]:
            others = [i for i in range(table.shape[1]) if i not in inputs]
            (less, better), chosen = min(((grown([*inputs, i]), i) for i in others), key=lambda found: found[0][0])
            if not less < (1 - SMALLEST_GAIN) * error:
                break
            inputs, error, model = [*inputs, chosen], less, better
        return cls(
            *given(rig),
            tuple(float(i) for i in inputs),
            _rows(model.centres_),
            _rows(model.sigmas_),
            tuple(model.levels_.tolist()),
            _rows(model.slopes_),
        )

    def begin(self, n: int) -> Array:
        """Rigs whose past is not known."""
        return np.full((n, 2 * LAGS), FRESH)

    def respond(self, force: Array, velocity: Array, memory: Array) -> tuple[Array, Array]:
        """Blend the local models; the nearest keeps a validity of 1 however far away it is."""
        past = gone_on(memory, np.repeat(np.stack([force, velocity], axis=1), LAGS, axis=1))
        forces = np.concatenate([force[:, None], past[:, :LAGS]], axis=1)
        velocities = np.concatenate([velocity[:, None], past[:, LAGS:]], axis=1)
        table = np.concatenate([forces, velocities], axis=1)
        columns = [table[:, int(i)] for i in self.inputs]
        exponents, outputs = [], []
        for centre, sigma, level, slope in zip(self.centres, self.sigmas, self.levels, self.slopes, strict=True):
            exponent, output = np.zeros(len(force)), np.full(len(force), level)
            for x, c, s, g in zip(columns, centre, sigma, slope, strict=True):
                away = x - c
                share = away / s
                exponent = exponent + 0.5 * share * share
                output = output + g * away
            exponents.append(exponent)
            outputs.append(output)
        least = np.minimum.reduce(exponents)
        total, blend = np.zeros(len(force)), np.zeros(len(force))
        for exponent, output in zip(exponents, outputs, strict=True):
            validity = np.exp(least - exponent)
            total = total + validity
            blend = blend + validity * output
        return blend / total, np.concatenate([forces[:, :LAGS], velocities[:, :LAGS]], axis=1)

    def express(self, program: Program, force: Value, velocity: Value) -> Value:
        """The same blend, on vectors with an entry for each local model."""
        signals = []
        for name, now in (("past_forces", force), ("past_velocities", velocity)):
            kept = program.state(name, np.zeros(LAGS))
            past = program.first().choose(program.join(*[now] * LAGS), kept)
            signals.append(program.join(now, past))
            program.update(kept, signals[-1].part(0, LAGS))
        table = program.join(*signals)
        exponents, outputs = program.constant(np.zeros(len(self.levels))), program.constant(self.levels)
        inverses = math.sqrt(0.5) / np.array(self.sigmas)
        for i, (centre, inverse, slope) in enumerate(
            zip(np.array(self.centres).T, inverses.T, np.array(self.slopes).T, strict=True)
        ):
            distance = table.part(int(self.inputs[i])) - program.constant(centre)
            scaled = distance * program.constant(inverse)
            exponents, outputs = exponents + scaled * scaled, outputs + program.constant(slope) * distance
        validities = (exponents.least() - exponents).exp()
        return (validities * outputs).total() / validities.total()


def _lagged(values: Array) -> Array:
    """(n, LAGS + 1) of a signal now and up to LAGS samples ago; before its start it was what it was there."""
    index = np.arange(len(values))[:, None] - np.arange(LAGS + 1)
    return np.asarray(values[np.maximum(index, 0)])


def _rows(table: Array) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(row) for row in table.tolist())
