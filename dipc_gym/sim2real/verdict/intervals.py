"""How sure each parameter is: intervals that need no model of what is left over."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from dipc_gym.sim2real.estimation.fit import Fit, weights
from dipc_gym.sim2real.estimation.problem import Problem
from dipc_gym.sim2real.selection.settings import SCORE
from dipc_gym.sim2real.verdict.settings import VERDICT

Array = NDArray[np.float64]


def by_blocks(fitted: Fit, problem: Problem) -> Array:
    """Half widths of 90 % intervals of the mapped parameters, (p,), from blocks of a second, whatever is left over.

    The delete-one jackknife over blocks: correlation within a block is allowed for, a wrong model is not. Where few
    blocks carry most of what is known of a parameter, it is wider than the sandwich estimator, which is then too narrow
    (MacKinnon and White 1985). On the windows' quadratics it costs no simulation. Infinite where there are too few
    blocks, or where no reading depends on a parameter.
    """
    return _jackknife(fitted, problem, problem.blocks)


def by_regimes(fitted: Fit, problem: Problem) -> Array:
    """The same from windows that begin at alike places, or speeds, instead of seconds; the widest of these.

    What a model leaves out acts here and not there, and parameters make up for it: without the fast windows they are
    others. No resampling of seconds shows that, for each second has some of both.
    """
    joints = problem.initial.shape[1] // 2
    wide = np.zeros(len(fitted.z))
    for feature in np.append(problem.initial[:, :joints], np.abs(problem.initial[:, joints:]), axis=1).T:
        regime = np.argsort(np.argsort(feature, kind="stable")) * VERDICT.regimes // len(feature)
        wide = np.maximum(wide, _jackknife(fitted, problem, regime))
    return wide


def _jackknife(fitted: Fit, problem: Problem, blocks: NDArray[np.intp]) -> Array:
    """Half widths of 90 % intervals, (p,), from fits that each leave out the windows of one block."""
    q, counts = fitted.quadratics, problem.counts
    if not len(fitted.z):
        return np.zeros(0)
    w = weights(fitted.mse) / counts
    _, block = np.unique(blocks, return_inverse=True)
    count, p = int(block.max()) + 1, len(fitted.z)
    if count < SCORE.fewest_blocks:
        return np.full(p, np.inf)
    curvature, slope = np.zeros((count, p, p)), np.zeros((count, p))
    np.add.at(curvature, block, w[:, None, None] * q.A)
    np.add.at(slope, block, w[:, None] * q.b)
    without = fitted.structure.prior.in_covariance(curvature.sum(axis=0) - curvature, w)
    inverse = np.linalg.pinv(without, hermitian=True)
    moved = np.einsum("bij,bj->bi", inverse, slope)
    half = stdtrit(count - 1, VERDICT.sure) * np.sqrt((count - 1) / count * np.sum(moved**2, axis=0))
    # Else doubling a parameter would change less than the noise of one reading.
    told = np.einsum("nii->i", q.A) > VERDICT.known
    return np.where(told, half, np.inf)
