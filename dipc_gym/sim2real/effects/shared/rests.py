"""What rests tell of the friction that holds a joint: forces that it withstood, and forces that it did not.

Where a command goes by steps, what drives a joint at rest goes by steps as well, and so does the moment at which it
breaks away: a little more or less friction changes nothing, until it is one step more or less. A fit in simulation has
no slope to follow there. But each rest bounds the law from below, by all that was withstood, and from above, by what
ended it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from dipc_gym.sim2real.effects.shared.base import Evidence

Array = NDArray[np.float64]

STILL = 0.02  # of the usual speed, below which a joint seems to rest
AROUND = 4  # samples before a rest and after it, at which a joint surely moves
SHORTEST = 3  # samples, that a rest lasts of which anything is told
FEWEST = 3  # rests that tell anything
SURE = 0.05  # of the level in motion, by which a force may well be wrong
PULL = 0.03  # weight of the middle between two forces, of which one was withstood and the other was not
LEAST = 1e-3  # of the largest parameter of a law, that each has to begin with


class Rests(NamedTuple):
    """Rests of a joint.

    Attributes:
        level: of friction in motion, N or N m.
        ages: for how long the joint had rested, s, at samples of all rests, (m,).
        held: the force that it withstood there, (m,).
        rested: how long those lasted that ended by breaking away, s, (n,).
        broke: the force that it did not withstand then, (n,).
        before: the force that it did withstand a sample before, (n,).
    """

    level: float
    ages: Array
    held: Array
    rested: Array
    broke: Array
    before: Array

    @property
    def tell(self) -> bool:
        """Whether there are enough of them to tell how friction grows."""
        return len(self.rested) >= FEWEST and self.level > 0

    @classmethod
    def of(cls, evidence: Evidence) -> Rests:
        """Those of all recordings."""
        ages, held, broken = [np.zeros(0)], [np.zeros(0)], list[tuple[float, float, float]]()
        level, driven = evidence.dry_level, evidence.driven
        for run in evidence.runs:
            time, force, velocity = evidence.time[run], driven[run], evidence.velocity[run]
            moves = _Moves(time, evidence.inertia * velocity, force, level)
            still = np.abs(velocity) < STILL * evidence.speed_scale
            turns = np.flatnonzero(np.diff(still.astype(int), prepend=0, append=0))
            for first, end in turns.reshape(-1, 2):
                if first < AROUND or end + AROUND >= len(run):
                    continue
                began, breaks = moves.until(first - AROUND), moves.since(end + AROUND)
                rests = np.arange(np.searchsorted(time, began), breaks)
                if len(rests) < SHORTEST:
                    continue
                surely = rests[AROUND:]
                ages.append(time[surely] - began)
                held.append(np.abs(force[surely]))
                way = np.sign(velocity[end + AROUND])
                before, broke = (max(float(way * force[k]), 0.0) for k in (breaks - 1, breaks))
                if broke > max(level, before):  # else it went on moving, more slowly than estimates tell from rest
                    broken.append((time[breaks] - began, broke, before))
        return cls(level, np.concatenate(ages), np.concatenate(held), *np.array(broken).reshape(-1, 3).T)

    def nearest(
        self, grown: Callable[[Array, Array], Array], begin: Array, *, even: float = 0.0
    ) -> tuple[Array, float]:
        """Parameters of a law of friction at rest with which it holds what was withstood and nothing that was not.

        Some rests are told wrongly, as where a joint crept on more slowly than estimates of motion tell; so what is
        wrong by much counts in proportion, and not squared.

        Args:
            grown: by how much friction grew, (n,), at ages (n,) with some parameters (k,).
            begin: parameters, none of which is to be negative, (k,).
            even: weight of a parameter that differs from the one before, where all are forces.

        Returns:
            The parameters, and how wrong they are.
        """
        middle, width = 0.5 * (self.broke + self.before), self.broke - self.before
        pull = PULL * np.minimum(1.0, np.median(width) / np.maximum(width, 1e-12))

        def wrong(now: Array) -> Array:
            ends, bounds = self.level + grown(self.rested, now), self.level + grown(self.ages, now)
            short, over = np.maximum(self.held - bounds, 0.0), np.maximum(ends - self.broke, 0.0)
            return np.concatenate([pull * (ends - middle), short, over, even * np.diff(now)]) / (SURE * self.level)

        size = np.maximum(begin, LEAST * (begin.max() or self.level))
        found = least_squares(wrong, size, bounds=(0.0, np.inf), loss="soft_l1", x_scale=size)
        return found.x, float(found.cost)


class _Moves(NamedTuple):
    """When a joint comes to rest and when it breaks away, told by its momentum.

    Estimates of motion are smooth: they know a moment before that a joint will break away, and a moment after that it
    came to rest. Momentum that is surely there tells by how long it took to gather, or will take to be spent.

    Attributes:
        time: s, (n,).
        momentum: kg m/s or kg m^2/s, (n,).
        force: that drives the joint beside dry friction, N or N m, (n,).
        level: of friction in motion.
    """

    time: Array
    momentum: Array
    force: Array
    level: float

    def until(self, moving: int) -> float:
        """The moment at which a joint rests that moves at a sample, s."""
        way, left = np.sign(self.momentum[moving]), abs(float(self.momentum[moving]))
        for k in range(moving, len(self.time) - 1):
            slows = self.level - way * self.force[k]
            step = self.time[k + 1] - self.time[k]
            if slows > 0 and left <= slows * step:
                return float(self.time[k] + left / slows)
            left -= slows * step
        return float(self.time[-1])

    def since(self, moving: int) -> int:
        """The sample from which on a joint moves that surely moves at another."""
        way, left = np.sign(self.momentum[moving]), abs(float(self.momentum[moving]))
        for k in range(moving - 1, 0, -1):
            pushes = way * self.force[k] - self.level
            gathered = pushes * (self.time[k + 1] - self.time[k])
            if pushes <= 0 or left < 0.5 * gathered:
                return k + 1
            left -= gathered
            if left <= 0:
                return k
        return 1
