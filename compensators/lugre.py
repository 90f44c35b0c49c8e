"""LuGre: friction as bristles that bend before they slip."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from scipy import optimize

from dipc_gym.compensators.base import Array, RigConstants, Samples, numbers
from dipc_gym.compensators.memory import FRESH, Remembering, Track, given, gone_on
from dipc_gym.plant import Friction

if TYPE_CHECKING:
    from dipc_gym.dataflow import Program, Value

STEP = 0.001
"""Longest step of the bristle's integration, s."""
STIFFEST, WEAKEST = 1e5, 1e-3  # N/m of the bristle, and N of friction, that a fit may come to


@dataclass(frozen=True)
class LuGre(Remembering):
    """A bristle is bent by the measured velocity, and its friction over the coming period is added (`lugre`).

        friction = stiffness z + damping dz/dt,  dz/dt = v - stiffness abs(v) z / g(v),
        g(v) = coulomb + (static - coulomb) exp(-(v / stribeck_velocity)^2).

    The bristle takes implicit steps of at most 1 ms, which hold at any stiffness. The five numbers are found by
    simulating it along the run and fitting the force that was lost there. Memory: the bristle and the last velocity.

    Attributes:
        stiffness: of the bristle, N/m.
        damping: of the bristle, N s/m.
        coulomb: Sliding friction, N.
        excess: Static friction above it, N.
        stribeck_velocity: m/s.

    Source:
        Canudas de Wit, Olsson, Astrom, Lischinsky, "A new model for control of systems with friction", IEEE
        Transactions on Automatic Control 40 (1995) 419-425.

    Example:
        >>> slow = LuGre(4.0, 24.0, 0.005, stiffness=2e4, damping=0.0, coulomb=8.0, excess=0.0, stribeck_velocity=0.02)
        >>> for _ in range(20):
        ...     volts = slow.voltage(force=0.0, velocity=0.1)
        >>> round(volts, 3)
        2.0
    """

    stiffness: float = numbers(positive=True)
    damping: float = numbers()
    coulomb: float = numbers(positive=True)
    excess: float = numbers()
    stribeck_velocity: float = numbers(positive=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.damping < 0 or self.excess < 0:
            raise ValueError(f"damping {self.damping} and excess {self.excess} must not be negative")

    @classmethod
    def fit(cls, samples: Samples, rig: RigConstants, *, seed: int = 0) -> Self:
        """Fit the five numbers to the training part by least squares over a simulation of the whole run."""
        track = Track.of(samples, rig)
        moving = np.abs(track.speed) > 0.25 * np.abs(track.speed).max()
        sliding = np.abs(track.friction[track.counts & moving])
        coulomb = max(float(np.median(sliding)) if len(sliding) else 0.0, WEAKEST)

        def model(numbers: Array) -> LuGre:
            stiffness, damping, level, excess, stribeck = np.exp(numbers).tolist()
            return cls(*given(rig), stiffness, damping, level, excess, stribeck)

        def residual(numbers: Array) -> Array:
            return track.residual(model(numbers).along(track))

        start = np.log([1e4, 30.0, coulomb, 0.3 * coulomb, 0.03])
        low = np.log([1e2, 1e-3, WEAKEST / 10, WEAKEST / 100, 1e-3])
        strong = max(1e3, 10.0 * coulomb)
        high = np.log([STIFFEST, strong, strong, strong, 1.0])
        found = optimize.least_squares(
            residual, start, bounds=(low, high), max_nfev=40, x_scale=0.5, diff_step=np.full(5, 1e-4)
        )
        return cls(*given(rig), *np.exp(found.x).tolist())

    @property
    def friction(self) -> Friction:
        """What was learned, as a plant has it; viscous drag is left to the linear model."""
        return Friction(
            coulomb=self.coulomb,
            static=self.coulomb + self.excess,
            stribeck_velocity=self.stribeck_velocity,
            bristle_stiffness=self.stiffness,
            bristle_damping=self.damping,
            viscous=0.0,
        )

    def begin(self, n: int) -> Array:
        """Unbent bristles of rigs whose motion is not known."""
        return np.tile([0.0, FRESH], (n, 1))

    def respond(self, force: Array, velocity: Array, memory: Array) -> tuple[Array, Array]:
        """Bend the bristle over the past period, then let it go on at this velocity over the coming one."""
        bent, _ = self.period_of(gone_on(memory[:, 1], velocity), velocity, memory[:, 0])
        _, friction = self.period_of(velocity, velocity, bent)
        return (force + friction) / self.newtons_per_volt, np.stack([bent, velocity], axis=1)

    def express(self, program: Program, force: Value, velocity: Value) -> Value:
        """Write it into a program that can be exported: the same formula, on values of the program."""
        bristle, before = program.state("bristle", 0.0), program.previous("velocity_before", velocity)
        bent, _ = self.period_of(before, velocity, bristle)
        _, friction = self.period_of(velocity, velocity, bent)
        program.update(bristle, bent)
        return (force + friction) / self.newtons_per_volt

    def period_of(self, before: Any, after: Any, bristle: Any) -> tuple[Any, Any]:
        """Bristle (n,) at the end of a period whose velocity goes from one value to another, and mean friction (n,)."""
        steps = max(1, math.ceil(self.period / STEP - 1e-9))
        h, total = self.period / steps, 0.0 * bristle
        for i in range(steps):
            v = before + (after - before) * ((i + 0.5) / steps)
            share = v / self.stribeck_velocity
            level = self.coulomb + self.excess * np.exp(-(share * share))
            bent = (bristle + h * v) / (1 + h * self.stiffness * np.abs(v) / level)
            total = total + (self.stiffness * bent + self.damping * (bent - bristle) / h)
            bristle = bent
        return bristle, total / steps

    def along(self, track: Track) -> Array:
        """Mean friction (periods, stretches) along a run, N."""
        bristle, friction = np.zeros(track.speed.shape[1]), np.empty_like(track.speed)
        for k, speed in enumerate(track.speed):
            # Half the change of velocity to either side of the mean: the displacement is then the measured one.
            half = 0.5 * (track.ends[k + 1] - track.ends[k])
            bristle, friction[k] = self.period_of(speed - half, speed + half, bristle)
        return friction
