"""Loads that may swing at a joint, and how much of the unexplained force each would pull with: first guesses.

A load is followed along the motion that was recorded, which costs a thousandth of a fit in simulation. So its rate, its
damping and its spring are fitted to the unexplained force before they are to motion.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from scipy.optimize import least_squares

from dipc_gym.engine.swing import swing
from dipc_gym.sim2real.effects.base import Evidence
from dipc_gym.sim2real.effects.coupling import free_inertia

Array = NDArray[np.float64]

RATES = 2 * np.pi * np.geomspace(0.4, 20.0, 40)  # rad/s, tried one by one
DAMPED = 0.05  # damping ratio that is tried
LIGHTEST, HEAVIEST = 0.01, 0.7  # of a first guess, as a share of what the joint moves
FLATTEST, STEEPEST = 0.01, 30.0  # stretch of a spring, against the first: nearly none, and a stop
LEAST, MOST = (0.5 * RATES[0], 1e-3), (2 * RATES[-1], 3.0)  # rad/s of small swings, and damping ratio
ROUNDS = 12  # of Gauss and Newton to the unexplained force, which is too rough for more
SAME = 0.01  # of a rate, within which two loads are one
SMOOTH = 0.02  # s: the noise of encoders grows with the square of frequency in a force, above what a load swings with
BLOCK = 0.01  # s, averaged first: half of that needs no more samples


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
        bends = np.diff(self.slopes, append=0.0) if self.slopes else ()
        return [
            (0.0, self.rate**2),
            *((d, self.rate**2 * float(b)) for d, b in zip(self.knots[1:], bends, strict=True)),
        ]

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


@dataclass(frozen=True)
class Pulled:
    """What a load explains of the unexplained force.

    Attributes:
        load: the load.
        mass: with which it explains most, kg or kg m^2; below zero where it pulls the other way.
        rest: of the force, smoothed, (m,).
    """

    load: Load
    mass: float
    rest: Array

    @property
    def left(self) -> float:
        """Sum of squares of what it leaves; infinite where it pulls the other way."""
        return float(self.rest @ self.rest) if self.mass > 0 else np.inf

    def weighing(self, evidence: Evidence) -> float:
        """Its mass, or what is nearest to that of what the joint moves."""
        inertia = free_inertia(evidence.model, evidence.at)
        return float(np.clip(self.mass, LIGHTEST * inertia, HEAVIEST * inertia))


class Sought:
    """The unexplained force at a joint, smoothed, less what goes with position and velocity; and loads that explain it.

    Args:
        evidence: of the joint.
    """

    def __init__(self, evidence: Evidence) -> None:
        self.evidence = evidence
        beside = [np.ones(len(evidence.time)), evidence.velocity, evidence.position]
        self._beside, _ = np.linalg.qr(np.stack([self._smooth(one) for one in beside], axis=1))
        self.force = self._apart(evidence.force)

    def pulled(self, load: Load) -> Pulled:
        """What a load explains."""
        pull = self._apart(load.swung(self.evidence)[1])
        mass = float(pull @ self.force / max(float(pull @ pull), 1e-300))
        return Pulled(load, mass, self.force - mass * pull)

    def nearest(self, load: Load) -> Pulled:
        """Of loads like this one, that which pulls most like the force."""

        def of(x: Array) -> Load:
            rate, ratio, *slopes = np.exp(x).tolist()
            return replace(load, rate=rate, ratio=ratio, slopes=(*load.slopes[:1], *slopes))

        def rest(x: Array) -> Array:
            return self.pulled(of(x)).rest

        bent = load.slopes[1:]
        low, high = ([*LEAST, *[FLATTEST] * len(bent)], [*MOST, *[STEEPEST] * len(bent)])
        begin = np.clip([load.rate, load.ratio, *bent], np.multiply(low, 1.001), np.multiply(high, 0.999))
        steps = np.full(len(begin), 1e-3)  # enough to show above what is rounded off
        bounds = (np.log(low), np.log(high))
        found = least_squares(rest, np.log(begin), bounds=bounds, diff_step=steps, max_nfev=ROUNDS)
        return self.pulled(of(found.x))

    def best(self, loads: Iterable[Load], count: int = 1, ratio: float = 1.0) -> list[Pulled]:
        """Those that explain most and pull the right way, their rates apart by a factor; each the nearest like it.

        What two of them come to may be the same, and counts once.
        """
        best: list[Pulled] = []
        for one in sorted(map(self.pulled, loads), key=lambda one: one.left):
            far = all(abs(np.log(one.load.rate / other.load.rate)) > np.log(ratio) for other in best)
            if one.mass > 0 and far and len(best) < count:
                best.append(one)
        found: list[Pulled] = []
        for one in (self.nearest(one.load) for one in best):
            if not any(np.isclose(one.load.rate, other.load.rate, rtol=SAME) for other in found):
                found.append(one)
        return found

    def _apart(self, force: Array) -> Array:
        """A force (n,), smoothed, less what goes with position and velocity, (m,)."""
        smooth = self._smooth(force)
        return np.asarray(smooth - self._beside @ (self._beside.T @ smooth))

    def _smooth(self, column: Array) -> Array:
        """Means of blocks of samples, smoothed, run by run, (m,)."""
        found = []
        for run in self.evidence.runs:
            step = float(np.median(np.diff(self.evidence.time[run]))) if len(run) > 1 else np.inf
            block = max(round(BLOCK / step), 1)
            means = column[run[: len(run) // block * block]].reshape(-1, block).mean(axis=1)
            found.append(gaussian_filter1d(means, SMOOTH / (block * step)) if len(means) else means)
        return np.concatenate(found)
