"""Smooth a force that was worked out from motion, and all that is to explain it, alike.

Differentiated twice, the noise of an encoder grows with the square of frequency: in a force as it comes it is many
times what is sought, and nearly gone where that is smoothed over a few hundredths of a second. Both sides of a
regression have to be: a command that shakes faster, as that of a rig that is balanced by noisy readings does, would
seem to do nothing beside a smooth force.

How wide to smooth follows from the encoders: one of micrometres hides a force of newtons for a hundredth of a second,
one of nanometres for a thousandth, and what is smoothed away is lost.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from dipc_gym.sim2real.effects.shared.base import runs_of
from dipc_gym.sim2real.effects.shared.settings import SMOOTHING

Array = NDArray[np.float64]


def width_for(force: float, noise: float, period: float) -> float:
    """How wide to smooth a force, s, so that little of what is left of it is noise.

    Of white noise with standard deviation s on readings at intervals T, a bell curve of width w leaves the second
    derivative a variance of 3 s^2 T / (8 sqrt(pi) w^5): the integral of its squared frequency response, f^4 and a bell
    curve again.

    Args:
        force: root mean square of what is sought, N or N m.
        noise: of the readings times the inertia that they are to tell the force of, kg m or kg m^2 rad.
        period: s, of the recording.

    Example:
        >>> round(width_for(3.0, 5e-5, 0.002), 4)  # a cart of kilograms, to a few hundredths of a millimetre
        0.0164
        >>> width_for(0.0, 1.0, 0.002)
        0.02
    """
    variance = 3 * noise**2 * period / (8 * np.sqrt(np.pi))
    allowed = (SMOOTHING.noisy * force) ** 2
    width = (variance / allowed) ** 0.2 if allowed > 0 else SMOOTHING.widest
    return float(np.clip(width, SMOOTHING.narrowest * period, SMOOTHING.widest))


def smoothing(time: Array, width: float) -> sparse.csr_array:
    """Weights with which samples (n,) make up smoothed ones, fewer of them, (m, n).

    Args:
        time: s, (n,), beginning anew with each recording.
        width: s, standard deviation of the bell curve that they are weighted by.

    Example:
        >>> time = np.arange(500) / 500
        >>> mean = smoothing(time, 0.02)
        >>> mean.shape
        (100, 500)
        >>> bool(np.allclose(mean @ np.ones(500), 1.0))
        True
    """
    parts = [_of_one(time[run], width) for run in runs_of(time)]
    return sparse.csr_array(sparse.block_diag(parts, format="csr"))


def _of_one(time: Array, width: float) -> sparse.csr_array:
    """The same of one recording."""
    n, step = len(time), float(np.median(np.diff(time))) if len(time) > 1 else np.inf
    every = max(round(SMOOTHING.every * width / step), 1)
    reach = round(SMOOTHING.reach * width / step)
    middle = np.arange(every // 2, n, every) if n > every // 2 else np.arange(min(n, 1))
    taken = middle[:, None] + np.arange(-reach, reach + 1)
    weights = np.where((taken >= 0) & (taken < n), 1.0, 0.0)
    taken = np.clip(taken, 0, n - 1)
    weights *= np.exp(-0.5 * ((time[taken] - time[middle][:, None]) / width) ** 2)
    weights /= weights.sum(axis=1, keepdims=True)
    rows = np.repeat(np.arange(len(middle)), taken.shape[1])
    return sparse.csr_array((weights.ravel(), (rows, taken.ravel())), shape=(len(middle), n))
