"""Loads that may swing at a joint, and which of them pull most like the force that nothing explains: first guesses."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from dipc_gym.engine.swing import swing
from dipc_gym.sim2real.effects.base import Evidence
from dipc_gym.sim2real.effects.coupling import free_inertia
from dipc_gym.sim2real.effects.sought import Sought, apart

Array = NDArray[np.float64]

RATES = 2 * np.pi * np.geomspace(0.4, 20.0, 40)  # rad/s, tried one by one
DAMPED = 0.05  # damping ratio that is tried
LIGHTEST, HEAVIEST = 0.01, 0.7  # of a first guess, as a share of what the joint moves
FLATTEST, STEEPEST = 0.01, 30.0  # stretch of a spring, against the first: nearly none, and a stop
LEAST, MOST = (0.5 * RATES[0], 1e-3), (2 * RATES[-1], 3.0)  # rad/s of small swings, and damping ratio
SAME = 0.01  # of a rate, within which two loads are one


@dataclass(frozen=True)
class Load:
    """A load of 1 kg, or 1 kg m^2, that might swing there.

    Attributes:
        rate: of small swings, rad/s.
        ratio: of its damping.
        knots: stretches between which its spring is straight, the first 0, m or rad, (k + 1,).
        slopes: of these, against the first, (k,). Beyond the last knot it pulls as it does there.
    """

    rate: float
    ratio: float = DAMPED
    knots: tuple[float, ...] = (0.0,)
    slopes: tuple[float, ...] = ()

    @property
    def springs(self) -> list[tuple[float, float]]:
        """Slack, m or rad, and stiffness, 1/s^2, of springs that make up its own."""
        bends = np.diff(self.slopes, append=0.0).tolist() if self.slopes else []
        others = zip(self.knots[1:], bends, strict=True)
        return [(0.0, self.rate**2), *((slack, self.rate**2 * bend) for slack, bend in others)]

    def swung(self, evidence: Evidence) -> tuple[Array, Array]:
        """Where it is against what carries it, m or rad, and its pull against one that is carried along, N, (n,)."""
        springs, drag = self.springs, 2 * self.ratio * self.rate
        away, pull = np.zeros(len(evidence.time)), np.zeros(len(evidence.time))
        for run in evidence.runs:
            if len(run) < 3:
                continue
            q, v, t = evidence.position[run], evidence.velocity[run], evidence.time[run]
            away[run], faster = swing(springs, drag, q, v, t)
            pull[run] = np.gradient(v, t) + drag * faster
        for slack, stiffness in springs:
            pull += stiffness * np.sign(away) * np.maximum(np.abs(away) - slack, 0.0)
        return away, pull

    def like(self, numbers: Array) -> Load:
        """The same with another rate, damping ratio and slopes but the first, (2 + k - 1,)."""
        rate, ratio, *slopes = numbers.tolist()
        return Load(rate, ratio, self.knots, (*self.slopes[:1], *slopes))


def most_alike(
    evidence: Evidence, loads: Iterable[Load], *, count: int = 1, ratio: float = 1.0
) -> list[tuple[Load, float]]:
    """Loads that pull most like the unexplained force, and their masses, kg or kg m^2.

    Args:
        evidence: of the joint.
        loads: that are tried; what comes of the best is fitted.
        count: most that are fitted.
        ratio: of their rates, by which they differ at least. What two of them come to may be the same, and counts once.
    """
    sought, found, tried = Sought(evidence), list[tuple[Load, float]](), list(loads)
    pulls = [sought.explained(load.swung(evidence)[1]) for load in tried]
    inertia = free_inertia(evidence.model, evidence.at)
    for k in apart([one.left_by_pulling for one in pulls], [load.rate for load in tried], count=count, ratio=ratio):
        load = tried[k]
        bent = load.slopes[1:]
        low, high = [*LEAST, *[FLATTEST] * len(bent)], [*MOST, *[STEEPEST] * len(bent)]
        near = load.like(sought.nearest(partial(_pull, load, evidence), [load.rate, load.ratio, *bent], low, high))
        mass = sought.explained(near.swung(evidence)[1]).weight
        if not any(np.isclose(near.rate, other.rate, rtol=SAME) for other, _ in found):
            found.append((near, float(np.clip(mass, LIGHTEST * inertia, HEAVIEST * inertia))))
    return found


def _pull(load: Load, evidence: Evidence, numbers: Array) -> Array:
    """Pull of a load like this one, see `Load.like`, (n,)."""
    return load.like(numbers).swung(evidence)[1]
