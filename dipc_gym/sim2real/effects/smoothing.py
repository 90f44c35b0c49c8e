"""Smooth a force that was worked out from motion, and all that is to explain it, alike.

Differentiated twice, the noise of an encoder grows with the square of frequency: in a force as it comes it is many
times what is sought, and nearly gone where that is smoothed over a few hundredths of a second. Both sides of a
regression have to be: a command that shakes faster, as that of a rig that is balanced by noisy readings does, would
seem to do nothing beside a smooth force.

Tables over two inputs are told from samples as they come: they are asked last, for whatever is left, and of a rig whose
encoder is fine, smoothing hides what it does within a few hundredths of a second.
"""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from dipc_gym.sim2real.effects.settings import SMOOTHING

Array = NDArray[np.float64]


def smoothing(time: Array) -> sparse.csr_array:
    """Weights with which samples (n,) make up smoothed ones, fewer of them, (m, n).

    Args:
        time: s, (n,), beginning anew with each recording.

    Example:
        >>> time = np.arange(500) / 500
        >>> mean = smoothing(time)
        >>> mean.shape
        (100, 500)
        >>> bool(np.allclose(mean @ np.ones(500), 1.0))
        True
    """
    seams = np.append(np.flatnonzero(np.diff(time, prepend=np.inf) <= 0), len(time))
    parts = [_of_one(time[begin:end]) for begin, end in itertools.pairwise(seams.tolist())]
    return sparse.csr_array(sparse.block_diag(parts, format="csr"))


def _of_one(time: Array) -> sparse.csr_array:
    """The same of one recording."""
    n, step = len(time), float(np.median(np.diff(time))) if len(time) > 1 else np.inf
    every = max(round(SMOOTHING.every / step), 1)
    reach = round(SMOOTHING.reach * SMOOTHING.width / step)
    middle = np.arange(every // 2, n, every) if n > every // 2 else np.arange(min(n, 1))
    taken = middle[:, None] + np.arange(-reach, reach + 1)
    weights = np.where((taken >= 0) & (taken < n), 1.0, 0.0)
    taken = np.clip(taken, 0, n - 1)
    weights *= np.exp(-0.5 * ((time[taken] - time[middle][:, None]) / SMOOTHING.width) ** 2)
    weights /= weights.sum(axis=1, keepdims=True)
    rows = np.repeat(np.arange(len(middle)), taken.shape[1])
    return sparse.csr_array((weights.ravel(), (rows, taken.ravel())), shape=(len(middle), n))
