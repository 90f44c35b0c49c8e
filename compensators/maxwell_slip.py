"""Generalised Maxwell slip: springs in parallel that slip one after the other."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Self

import numpy as np
from scipy import optimize

from dipc_gym.compensators.base import Array, RigConstants, Samples, numbers
from dipc_gym.compensators.memory import FRESH, Remembering, Track, given, gone_on

if TYPE_CHECKING:
    from dipc_gym.dataflow import Program, Value

STRETCHES = np.geomspace(2e-5, 4e-3, 8)
"""Displacements at which the springs begin to slip, m: from the encoder's count to what no rail's creep exceeds."""
BUMP_VELOCITIES = np.geomspace(5e-3, 0.3, 13)  # m/s, widths of the Stribeck bump, of which least squares choose


@dataclass(frozen=True)
class MaxwellSlip(Remembering):
    """Eight springs, each slipping at its own displacement, at levels that fall with speed (`maxwell_slip`).

        friction = sum_i (levels_i + bumps_i exp(-(v / bump_velocity)^2)) s_i + per_velocity v,
        s_i(k) = clip(s_i(k-1) + displacement(k) / stretches_i, -1, 1).

    Where a spring slips depends on displacement alone, so the levels enter linearly: they are found by least squares
    without negative numbers, for each of 13 widths of the bump. Memory: the springs, and the last velocity.

    Attributes:
        stretches: (8,) displacements at which springs slip, m.
        levels: (8,) forces of slipping springs at speed, N.
        bumps: (8,) what low speed adds to them, N.
        bump_velocity: Velocity at which the bump has fallen to 1/e, m/s.
        per_velocity: Viscous friction beyond the linear model's, N s/m.

    Source:
        Al-Bender, Lampaert, Swevers, "The generalized Maxwell-slip model", IEEE Transactions on Automatic Control 50
        (2005) 1883-1887.
    """

    stretches: tuple[float, ...] = numbers("springs", positive=True)
    levels: tuple[float, ...] = numbers("springs")
    bumps: tuple[float, ...] = numbers("springs")
    bump_velocity: float = numbers(positive=True)
    per_velocity: float = numbers()

    @classmethod
    def fit(cls, samples: Samples, rig: RigConstants, *, seed: int = 0) -> Self:
        """Find the levels on the training part."""
        track = Track.of(samples, rig)
        springs, held = np.zeros((track.speed.shape[1], len(STRETCHES))), []
        for speed in track.speed:
            after = _stretch(springs, rig.period * speed, STRETCHES)
            held.append(0.5 * (springs + after))
            springs = after
        bent = np.array(held)  # (periods, stretches of the run, springs)
        best: tuple[float, Array, float] = (np.inf, np.zeros(0), 1.0)
        for width in BUMP_VELOCITIES.tolist():
            bump = np.exp(-((track.speed / width) ** 2))
            drag = track.speed[..., None]
            columns = np.concatenate([bent, bent * bump[..., None], drag, -drag], axis=2)
            table = np.stack([track.residual(columns[..., i]) for i in range(columns.shape[2])], axis=1)
            table += track.friction[track.counts][:, None]
            # The normal equations' factor has the same least squares and no more rows than columns.
            Q, R = np.linalg.qr(table)
            target = track.friction[track.counts]
            found, _ = optimize.nnls(R, Q.T @ target)
            error = float(np.sum((table @ found - target) ** 2))
            if error < best[0]:
                best = (error, found, width)
        _, found, width = best
        n = len(STRETCHES)
        return cls(
            *given(rig),
            tuple(STRETCHES.tolist()),
            tuple(found[:n].tolist()),
            tuple(found[n : 2 * n].tolist()),
            width,
            float(found[2 * n] - found[2 * n + 1]),
        )

    def begin(self, n: int) -> Array:
        """Slack springs of rigs whose motion is not known."""
        return np.tile([*[0.0] * len(self.stretches), FRESH], (n, 1))

    def respond(self, force: Array, velocity: Array, memory: Array) -> tuple[Array, Array]:
        """Stretch the springs by the past period's displacement, and foresee half of the coming one's."""
        stretches = np.array(self.stretches)
        before = gone_on(memory[:, -1], velocity)
        springs = _stretch(memory[:, :-1], 0.5 * self.period * (before + velocity), stretches)
        ahead = _stretch(springs, 0.5 * self.period * velocity, stretches)
        bump = np.exp(-((velocity / self.bump_velocity) ** 2))
        friction = self.per_velocity * velocity
        for i, (level, extra) in enumerate(zip(self.levels, self.bumps, strict=True)):
            friction = friction + (level + extra * bump) * ahead[:, i]
        volts = (force + friction) / self.newtons_per_volt
        return volts, np.concatenate([springs, velocity[:, None]], axis=1)

    def express(self, program: Program, force: Value, velocity: Value) -> Value:
        """Write it into a program that can be exported, on vectors with an entry for each spring."""
        springs = program.state("springs", np.zeros(len(self.stretches)))
        before, half = program.previous("velocity_before", velocity), 0.5 * self.period
        per_metre = program.constant(1.0 / np.array(self.stretches))
        now = (springs + half * (before + velocity) * per_metre).clip(-1.0, 1.0)
        ahead = (now + half * velocity * per_metre).clip(-1.0, 1.0)
        share = velocity * (1.0 / self.bump_velocity)
        bump = (-(share * share)).exp()
        held = (program.constant(self.levels) + bump * program.constant(self.bumps)) * ahead
        program.update(springs, now)
        return (force + self.per_velocity * velocity + held.total()) / self.newtons_per_volt


def _stretch(springs: Array, displacement: Array, stretches: Array) -> Array:
    return np.clip(springs + displacement[:, None] / stretches, -1.0, 1.0)
