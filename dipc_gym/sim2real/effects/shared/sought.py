"""What explains the unexplained force at a joint: first guesses of physics that remembers, before any simulation.

What has a memory is followed along the recorded motion, which costs a thousandth of a fit in simulation. So its
parameters are fitted to the unexplained force before they are to motion.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from dipc_gym.sim2real.effects.shared.base import Evidence
from dipc_gym.sim2real.effects.shared.smoothing import smoothing

Array = NDArray[np.float64]

ROUNDS = 12  # of Gauss and Newton: the force is too rough for more
WITHIN = 1e-3  # of a bound, where a fit may begin


@dataclass(frozen=True)
class Explained:
    """What a pull explains of the force.

    Attributes:
        weight: with which it explains most; zero where it would have to pull the other way.
        rest: of the force, smoothed, (m,).
    """

    weight: float
    rest: Array

    @property
    def left(self) -> float:
        """Sum of squares of what it leaves."""
        return float(self.rest @ self.rest)

    @property
    def left_by_pulling(self) -> float:
        """The same; infinite where it would have to pull the other way."""
        return self.left if self.weight > 0 else np.inf


class Sought:
    """The unexplained force at a joint, smoothed, less what goes with its position and velocity.

    Args:
        evidence: of the joint.
        beside: what explains a part of it as well, in the place of these, (n,) each.
    """

    def __init__(self, evidence: Evidence, beside: Sequence[Array] = ()) -> None:
        self._mean = smoothing(evidence.time, evidence.width)
        plain = [np.ones(len(evidence.time)), *(beside or (evidence.velocity, evidence.position))]
        self._beside, _ = np.linalg.qr(self._mean @ np.stack(plain, axis=1))
        self.force = self._apart(evidence.force)

    def explained(self, pull: Array) -> Explained:
        """What a pull (n,) explains."""
        own = self._apart(pull)
        weight = max(float(own @ self.force), 0.0) / max(float(own @ own), 1e-300)
        return Explained(weight, self.force - weight * own)

    def nearest(
        self, pull: Callable[[Array], Array], begin: Sequence[float], low: Sequence[float], high: Sequence[float]
    ) -> Array:
        """Parameters, all of them positive, with which a pull explains most, near those that it begins with, (p,).

        Args:
            pull: of parameters, (n,).
            begin: parameters.
            low: smallest.
            high: largest.
        """

        def rest(x: Array) -> Array:
            return self.explained(pull(np.exp(x))).rest

        inside = np.clip(begin, np.multiply(low, 1 + WITHIN), np.multiply(high, 1 - WITHIN))
        found = least_squares(
            rest,
            np.log(inside),
            bounds=(np.log(low), np.log(high)),
            diff_step=np.full(len(inside), 1e-3),  # enough to show above what is rounded off
            max_nfev=ROUNDS,
        )
        return np.asarray(np.exp(found.x))

    def _apart(self, force: Array) -> Array:
        """A force (n,), smoothed, less what explains a part of it as well, (m,)."""
        smooth = self._mean @ force
        return np.asarray(smooth - self._beside @ (self._beside.T @ smooth))


def apart(left: Sequence[float], paces: Sequence[float], *, count: int, ratio: float = 1.0) -> list[int]:
    """Which first guesses leave least, the best first, where their paces differ by a factor: their places in the
    sequence.

    Args:
        left: what each leaves; one that leaves infinitely much is passed over.
        paces: a rate or a time of each.
        count: most of them.
        ratio: of any two paces, at least.
    """
    best: list[int] = []
    for k in sorted(range(len(left)), key=lambda k: left[k]):
        far = all(abs(np.log(paces[k] / paces[other])) > np.log(ratio) for other in best)
        if np.isfinite(left[k]) and far and len(best) < count:
            best.append(k)
    return best
