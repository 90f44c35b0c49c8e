"""Whether a fit is better than another on the windows of a partition, and whether an effect earns its place."""

from __future__ import annotations

import math
import weakref
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from dipc_gym.sim2real.estimation.fit import Fit, begun, evaluate, simulated
from dipc_gym.sim2real.estimation.problem import Problem
from dipc_gym.sim2real.estimation.shooting import common_error, mean_loss, rms, typical
from dipc_gym.sim2real.estimation.unexplained import force_in_windows
from dipc_gym.sim2real.model.structure import Term
from dipc_gym.sim2real.selection import partitioning, ranking
from dipc_gym.sim2real.selection.progress import Partition
from dipc_gym.sim2real.selection.score import Improvement, compare
from dipc_gym.sim2real.selection.settings import SCORE, SEARCH
from dipc_gym.sim2real.simulation.windows import Windows
from dipc_gym.sim2real.unseen.parts import loads

Array = NDArray[np.float64]
_OfFits = weakref.WeakKeyDictionary[Fit, Array]


@dataclass(frozen=True)
class Scorer:
    """Compares fits.

    Attributes:
        partition: whose windows are fitted and compared on.
        small: whether the mismatch is so small and shapeless that only what explains all of it counts.
    """

    partition: Partition
    small: bool = False
    _known: _OfFits = field(default_factory=weakref.WeakKeyDictionary, repr=False)
    _unfitted: _OfFits = field(default_factory=weakref.WeakKeyDictionary, repr=False)
    _forces: _OfFits = field(default_factory=weakref.WeakKeyDictionary, repr=False)

    def over(self, partition: Partition) -> Scorer:
        """The same on other windows; what is known of those compared on stays, if they are the same."""
        if partition is self.partition:
            return self
        same = partition.comparison is self.partition.comparison
        return Scorer(partition, self.small, self._known if same else weakref.WeakKeyDictionary())

    def comparison_mse(self, fitted: Fit) -> Array:
        """Mean square error of each comparison window, in units of noise, (n,)."""
        return _once(self._known, fitted, lambda: evaluate(self.partition.comparison, fitted.structure, fitted.z))

    def know(self, fitted: Fit, mse: Array) -> None:
        """Note the mean square errors of the comparison windows that were worked out elsewhere, (n,)."""
        self._known[fitted] = mse

    def unfitted_mse(self, fitted: Fit) -> Array:
        """Mean square error of these and of the windows that validate, in units of noise, as they come out when
        simulated, (n,): where a law is steep, a straight line promises initial states that no simulation finds.
        """

        def work() -> Array:
            compared, validation = self.partition.comparison, self.partition.validation
            problem = compared if validation is compared else compared.join(validation)
            begin = begun(problem, fitted.structure, fitted.z)
            return simulated(problem, fitted.structure, fitted.z, begin)

        return _once(self._unfitted, fitted, work)

    def comparison_error(self, fitted: Fit) -> float:
        """Root mean square error on the comparison windows, in units of noise."""
        return rms(self.comparison_mse(fitted))

    def mse(self, fitted: Fit) -> Array:
        """Mean square errors of the fitted windows, then of the comparison windows."""
        return np.append(fitted.mse, self.comparison_mse(fitted))

    def compare(self, new: Fit, old: Fit) -> Improvement:
        """How much better `new` predicts than `old`, over fitted and comparison windows together.

        There are far fewer parameters than windows, so what fitting flatters is little; three times as many windows
        tell more. `compare_on_others` asks the comparison windows alone. Far from the noise the balance of forces
        counts too: a short recording of a large machine holds few windows, and other masses move it nearly as its
        friction does, but they do not balance its motors.
        """
        after, before = self.mse(new), self.mse(old)
        forces = (self._force(new), self._force(old)) if forces_count(new, old, after, before) else None
        return compare(after, before, self.partition.blocks, forces)

    def _by_motion(self, new: Fit, old: Fit) -> Improvement:
        """The same by motion alone."""
        return compare(self.mse(new), self.mse(old), self.partition.blocks)

    def compare_sketches(self, new: Fit, old: Fit) -> Improvement:
        """The same on the windows that are sketched on; either may be a full fit."""
        subset, problem = self.partition.subset, self.partition.problem
        after, before = (one.mse[subset] if len(one.mse) == len(problem.windows) else one.mse for one in (new, old))
        return compare_on(problem.pick(subset), new, old, after, before, problem.blocks[subset])

    def _force(self, fitted: Fit) -> Array:
        """Mean square of the force that a fit leaves unexplained in each window, fitted ones first, (n, nb)."""
        windows = self.partition.problem.windows, self.partition.comparison.windows
        return _once(self._forces, fitted, lambda: _force_left(fitted, windows[0].join(windows[1])))

    def compare_on_others(self, new: Fit, old: Fit) -> Improvement:
        """How much better `new` predicts the comparison windows, which neither was fitted to."""
        return compare(self.comparison_mse(new), self.comparison_mse(old), self.partition.comparison.blocks)

    def confirmed(self, new: Fit, old: Fit) -> bool:
        """Whether the comparison windows alone are better predicted too."""
        return self.compare_on_others(new, old).gain > SCORE.hardly

    def alike(self, best: Fit, other: Fit, current: Fit) -> bool:
        """Whether `other` predicts as well as `best`, by the standard error or within a fiftieth of the gain.

        Motion alone counts: of two that balance forces, the closer balance is no reason to prefer one.
        """
        return ranking.alike(self._by_motion(best, other), self._by_motion(best, current).gain)

    def better(self, fitted: Fit, current: Fit) -> bool:
        """Whether a fit with more effects is clearly better, by enough to earn their place."""
        clear = self._by_motion(fitted, current).clear or self.compare(fitted, current).clear
        return self.earns(fitted, current) and clear and self.confirmed(fitted, current)

    def stands_out(self, term: Term, fitted: Fit, current: Fit) -> bool:
        """Whether a fit with one more effect is clearly better.

        An event shows in a window or two, fitted or not; it is believed if all other windows are at the noise. So does
        when a joint breaks away, where it seldom rests.
        """
        if term.effect.once:
            fall = np.log1p(self.mse(current)) - np.log1p(self.mse(fitted))
            return ranking.mostly_at_noise(current) and float(np.sum(fall)) > SEARCH.once
        if term.effect.by_steps and self.follows(fitted, current):
            return True
        return self.settles(fitted, current) or self.better(fitted, current)

    def settles(self, fitted: Fit, current: Fit) -> bool:
        """Whether a fit leaves none of the few windows standing out that do where all others are at the noise."""
        return settled(self.mse(fitted), self.mse(current)) and ranking.mostly_at_noise(current)

    def follows(self, fitted: Fit, current: Fit) -> bool:
        """Whether a fit comes nearer to the few windows that stand out where all others are at the noise, and loses no
        other: where a rig seldom was, few windows tell of a law.
        """
        after, before = self.mse(fitted), self.mse(current)
        if not ranking.mostly_at_noise(current) or compare(after, before, self.partition.blocks).worst < -SCORE.large:
            return False
        return _lifts_outliers(after, before)

    def earns(self, fitted: Fit, current: Fit) -> bool:
        """Whether a fit comes down to the noise, or takes a good part of what is left."""
        return earned(self.mse(fitted), self.mse(current), small=self.small)


def _once(known: _OfFits, fitted: Fit, work: Callable[[], Array]) -> Array:
    """What is known of a fit, worked out where it is not."""
    if fitted not in known:
        known[fitted] = work()
    return known[fitted]


def _force_left(fitted: Fit, windows: Windows) -> Array:
    """Mean square of the force that a fit leaves unexplained in each window and at each joint, (n, nb)."""
    return force_in_windows(fitted.structure.physics(fitted.z), windows)


def told_by_motion(fitted: Fit) -> bool:
    """Whether forces tell more than motion does, and motion says all of them: several joints, nothing hidden or late.

    Of a single joint, motion and force say the same, and the force is told more roughly.
    """
    return (
        len(fitted.structure.base) > 1
        and fitted.structure.warm == 0
        and not loads(fitted.structure.physics(fitted.z).model)
    )


def forces_count(new: Fit, old: Fit, after: Array, before: Array) -> bool:
    """Whether two fits leave so much of most windows, mean squares (n,) each, that what forces tell counts as well."""
    far = min(typical(after), typical(before)) > SEARCH.in_reach**2
    return far and told_by_motion(new) and told_by_motion(old)


def compare_on(
    problem: Problem, new: Fit, old: Fit, after: Array, before: Array, blocks: NDArray[np.intp]
) -> Improvement:
    """How much better a fit predicts these windows than another, from mean square errors (n,) that are known."""
    forces = None
    if forces_count(new, old, after, before):
        forces = (_force_left(new, problem.windows), _force_left(old, problem.windows))
    return compare(after, before, blocks, forces)


def earned(after: Array, before: Array, *, small: bool) -> bool:
    """Whether mean square errors (n,) come down to the noise, or lose a good part of what they were above it.

    Real recordings hold structure that no catalogue has, and the best of dozens of effects always takes up a little of
    it. A part is counted of the mean square, or of most windows by logarithms, if that mean does not rise: where a
    rig comes to rest two windows may make up the whole of it, whatever a law does to all others.

    Args:
        after: with an effect.
        before: without it.
        small: whether the mismatch is so small and shapeless that only what explains all of it counts.

    Example:
        >>> earned(np.full(9, 7.0**2), np.full(9, 10.0**2), small=False)
        True
        >>> earned(np.array([3.0] * 9 + [99.0]) ** 2, np.array([9.0] * 9 + [99.0]) ** 2, small=False)
        True
        >>> earned(np.array([3.0] * 9 + [150.0]) ** 2, np.array([9.0] * 9 + [99.0]) ** 2, small=False)
        False
        >>> earned(np.array([9.0] * 9 + [98.0]) ** 2, np.array([9.0] * 9 + [99.0]) ** 2, small=False)
        False
    """
    if common_error(after) < SCORE.at_floor:
        return True
    then, now, usual = rms(before), rms(after), min(typical(before), typical(after))
    fell = mean_loss(before, usual) - mean_loss(after, usual)
    by_squares, by_logs = then - now > SEARCH.earns * (then - 1), fell > -2 * math.log(1 - SEARCH.earns)
    return not small and (by_squares or (by_logs and now <= then))


def settled(after: Array, before: Array) -> bool:
    """Whether none of the outliers among mean square errors (n,) is left, but for what laws may leave of one.

    No mean over windows shows an effect that acts in few of them. It is told from a push by leaving no outlier. A hard
    stop throws a joint back thousands of times the noise from where it would be, and is no spring and damper to a
    thousandth.

    Example:
        >>> before = np.array([1.0] * 9 + [3000.0**2, 2000.0**2])
        >>> settled(np.array([1.0] * 9 + [10.0**2, 1.0]), before)
        True
        >>> settled(np.array([1.0] * 9 + [1.0, 2000.0**2]), before)
        False
    """
    left = partitioning.outliers(after, before)
    taken = before[left] - after[left]
    return _lifts_outliers(after, before) and bool(np.all(after[left] < SEARCH.laws**2 * taken))


def _lifts_outliers(after: Array, before: Array) -> bool:
    """Whether the outliers among mean square errors (n,) fell, all together, by what makes an event stand out."""
    outliers = partitioning.outliers(before)
    return float(np.sum(np.log1p(before[outliers]) - np.log1p(after[outliers]))) > SEARCH.once


def enough(begin: Fit, current: Fit) -> bool:
    """Whether what is left near the noise is little enough, beside what effects took away, for their laws to leave it.

    No law is exact to the last percent: a contact is not a spring and a damper, a bristle not a bristle. But that shows
    in most windows, and not in a few that stand out.
    """
    even = not len(partitioning.outliers(current.mse))
    return current.error < SCORE.at_floor and even and left_by_laws(begin, current)


def near(begin: Fit, current: Fit) -> bool:
    """Whether a fit may yet come down to the noise, or leaves little beside what effects took away."""
    return current.error < SEARCH.in_reach or left_by_laws(begin, current)


def left_by_laws(begin: Fit, current: Fit) -> bool:
    """Whether so little is left, beside what effects took away, that their laws may leave it."""
    brought = math.sqrt(max(begin.error**2 - current.error**2, 0.0))
    left = math.sqrt(max(current.error**2 - 1.0, 0.0))
    return bool(current.structure.terms) and left < SEARCH.laws * brought
