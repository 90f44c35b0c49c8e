"""LLNF that goes on learning in the loop, by recursive least squares with forgetting, within bounds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from dipc_gym.compensators.base import Array, RigConstants, Samples, numbers
from dipc_gym.compensators.llnf import LLNF
from dipc_gym.compensators.memory import FRESH, Remembering, given, gone_on, just_reset, known_mass

FORGETTING = 0.995
"""Weight of a sample against the one after it: a memory of 200 periods, one second."""
DOUBT = 1.0
"""Largest covariance of a correction over the voltage's noise, so that a model long unused stays tame."""


@dataclass(frozen=True)
class AdaptiveLLNF(Remembering):
    """The `llnf` compensator with a level of each local model that adapts (`llnf_adaptive`).

    After each period the force that the cart got is worked out from its velocity, mass a + viscous v; the voltage that
    the network would have given for that force is compared with the one that was applied. Every local model corrects
    its level by recursive least squares for what the whole network missed, weighted with its validity. A sample counts
    for a second. Corrections stay within the largest friction of the identification run either way, so that leaving it
    on cannot do worse than friction wrongly compensated.

    It knows the cart's mass with the poles locked. Memory: corrections and their covariances, last two velocities, last
    voltage.

    Attributes:
        centres: (models, 3), as in `LLNF`.
        sigmas: (models, 3).
        levels: (models,) V.
        slopes: (models, 3).
        bound: Largest correction, V.
        mass: kg.
        viscous: N s/m.

    Source:
        Nelles, "Nonlinear System Identification" (2nd ed., 2020), chapter 17, local recursive least squares.
    """

    remembers_voltage: ClassVar[bool] = True

    centres: tuple[tuple[float, ...], ...] = numbers("models", 3)
    sigmas: tuple[tuple[float, ...], ...] = numbers("models", 3, positive=True)
    levels: tuple[float, ...] = numbers("models")
    slopes: tuple[tuple[float, ...], ...] = numbers("models", 3)
    bound: float = numbers()
    mass: float = numbers(positive=True)
    viscous: float = numbers()

    @classmethod
    def fit(cls, samples: Samples, rig: RigConstants, *, seed: int = 0) -> Self:
        """Train the network as `LLNF` does.

        Raises:
            ValueError: The rig's mass is not known.
        """
        mass = known_mass(rig, "llnf_adaptive")
        net = LLNF.fit(samples, rig, seed=seed)
        lost = np.abs(samples.voltage - samples.force / rig.newtons_per_volt)[samples.train]
        bound = min(float(np.quantile(lost, 0.99)), rig.supply_voltage)
        return cls(*given(rig), net.centres, net.sigmas, net.levels, net.slopes, bound, mass, rig.viscous)

    def begin(self, n: int) -> Array:
        """The network as trained."""
        models = len(self.levels)
        return np.tile([0.0] * models + [DOUBT] * models + [FRESH, FRESH, 0.0], (n, 1))

    def respond(self, force: Array, velocity: Array, memory: Array) -> tuple[Array, Array]:
        """Learn from the past period, then answer for the coming one."""
        models = len(self.levels)
        corrections, doubts = memory[:, :models], memory[:, models : 2 * models]
        before, earlier, volts = memory[:, 2 * models :].T
        fresh = just_reset(before)[:, None]  # of what these did, nothing is known that could be learned from
        before, earlier = gone_on(before, velocity), gone_on(earlier, velocity)
        got = self.mass * (velocity - before) / self.period + self.viscous * 0.5 * (velocity + before)
        validities, outputs = self._models(got, before, earlier)
        missed = volts - self._blend(validities, outputs + corrections)
        gain = doubts * validities / (FORGETTING + doubts * validities)
        learned = np.clip(corrections + gain * missed[:, None], -self.bound, self.bound)
        corrections = np.where(fresh, corrections, learned)
        doubts = np.where(fresh, doubts, np.minimum((doubts - gain * doubts) / FORGETTING, DOUBT))
        validities, outputs = self._models(force, velocity, before)
        volts = self._blend(validities, outputs + corrections)
        volts = np.clip(volts, -self.supply_voltage, self.supply_voltage)
        past = np.stack([velocity, before, volts], axis=1)
        return volts, np.concatenate([corrections, doubts, past], axis=1)

    def _models(self, force: Array, velocity: Array, previous: Array) -> tuple[Array, Array]:
        """Normalised validities (n, models), and voltages (n, models) of the local models."""
        exponents, outputs = np.empty((len(force), len(self.levels))), np.empty((len(force), len(self.levels)))
        rows = zip(self.centres, self.sigmas, self.levels, self.slopes, strict=True)
        for i, (centre, sigma, level, slope) in enumerate(rows):
            a, b, c = force - centre[0], velocity - centre[1], previous - centre[2]
            exponents[:, i] = 0.5 * ((a / sigma[0]) ** 2 + (b / sigma[1]) ** 2 + (c / sigma[2]) ** 2)
            outputs[:, i] = level + slope[0] * a + slope[1] * b + slope[2] * c
        validities = np.exp(exponents.min(axis=1, keepdims=True) - exponents)
        total = np.zeros(len(force))
        for column in validities.T:
            total = total + column
        return validities / total[:, None], outputs

    @staticmethod
    def _blend(validities: Array, outputs: Array) -> Array:
        total = np.zeros(len(outputs))
        for weight, output in zip(validities.T, outputs.T, strict=True):  # in this order for one rig and for many
            total = total + weight * output
        return total
