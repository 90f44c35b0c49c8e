"""Loads that may swing at a joint, and which of them pull most like the force that nothing explains: first guesses."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline

from dipc_gym.engine.swing import Spring, swing
from dipc_gym.sim2real.effects.shared.base import Evidence
from dipc_gym.sim2real.effects.shared.coupling import free_inertia
from dipc_gym.sim2real.effects.shared.sought import Sought, apart

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
        knots: stretches that divide its spring, the first 0, m or rad, (k + 1,).
        slopes: that draw it there, against the first, (k,); see `slope_of`.
    """

    rate: float
    ratio: float = DAMPED
    knots: tuple[float, ...] = (0.0,)
    slopes: tuple[float, ...] = ()

    @property
    def springs(self) -> list[Spring]:
        """What makes up its spring."""
        stiffness = self.rate**2
        if not self.slopes:
            return [Spring(0.0, stiffness)]
        return smooth(self.knots, [stiffness * one for one in self.slopes])

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
        for spring in springs:
            pull += spring.pull(away)
        return away, pull

    def like(self, numbers: Array) -> Load:
        """The same with another rate, damping ratio and slopes but the first, (2 + k - 1,)."""
        rate, ratio, *slopes = numbers.tolist()
        return Load(rate, ratio, self.knots, (*self.slopes[:1], *slopes))


def slope_of(knots: Sequence[float], slopes: Sequence[float]) -> BSpline:
    """The slope of a smooth spring over its stretch: parabolas end to end, between the slopes that they are drawn by.

    It begins and ends level, so that the spring is as stiff beyond either end, and rises wherever slopes are positive.

    Args:
        knots: stretches that divide it, the first 0, (k + 1,).
        slopes: that draw it from each to the next, (k,): it comes close to them, and goes through none.
    """
    first, last = knots[1] - knots[0], knots[-1] + knots[-1] - knots[-2]
    return BSpline([-first, -first, *knots, last, last], [slopes[0], *slopes, slopes[-1]], 2)


def smooth(knots: Sequence[float], slopes: Sequence[float]) -> list[Spring]:
    """The springs that together have such a slope, either way; see `slope_of`.

    Straight pieces would not do: what a load does after ten swings shows where its spring was off by a thousandth.
    Where the slope is made of parabolas, the pull is a sum of third powers, each from a knot on: MuJoCo's tendons have
    these.

    Example:
        >>> springs = smooth([0.0, 0.1, 0.2], [1.0, 3.0])
        >>> [round(float(sum(one.pull(np.array(x)) for one in springs)), 6) for x in (-0.1, 0.0, 0.2, 0.3)]
        [-0.133333, 0.0, 0.4, 0.7]
    """
    stretches = np.array(knots)
    bent = slope_of(knots, slopes).derivative(2)(0.5 * (stretches[1:] + stretches[:-1]))
    cubic = np.diff(bent / 6, prepend=0.0, append=0.0)
    return [Spring(float(slack), slopes[0] * (not k), float(cubic[k])) for k, slack in enumerate(knots)]


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
