"""Waves over position: what cogging, an uneven rail and friction that comes and goes have in common."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dipc_gym.sim2real.effects.base import Evidence
from dipc_gym.sim2real.effects.settings import WAVES

Array = NDArray[np.float64]


def waves(evidence: Evidence, fewest: float, carrier: Array | None = None, count: int = 3) -> list[dict[str, float]]:
    """Sine waves over position that explain most of the unexplained force, the best first.

    Args:
        evidence: at a joint.
        fewest: waves over the range of position.
        carrier: what the wave is multiplied by, (n,), as the direction of motion; nothing by default.
        count: how many waves to return.

    Returns:
        `sine`, `cosine` (N or N m) and `wavelength` (m or rad) of each.
    """
    x, v = evidence.position, evidence.velocity
    reach = max(float(np.ptp(x)), 1e-9)
    # Dry friction would hide a wave; what goes with velocity is taken out of the force, and below out of the waves.
    known = np.stack([v, evidence.direction, np.ones_like(v)], axis=1)
    f = evidence.force - known @ np.linalg.lstsq(known, evidence.force, rcond=None)[0]
    c = np.ones_like(x) if carrier is None else carrier
    most = min(WAVES.most, WAVES.resolved * reach / evidence.period / evidence.speed_scale)
    counted = np.arange(round(fewest * WAVES.finer), max(round(most * WAVES.finer), round(fewest * WAVES.finer)) + 1)
    # The force is mostly noise of differentiated encoders, so all of it is needed; by position it is soon summed up,
    # and a Fourier transform then sums each wave.
    which = np.clip(((x - x.min()) / reach * WAVES.bins).astype(np.intp), 0, WAVES.bins - 1)
    middle = x.min() / reach + 0.5 / WAVES.bins  # of the first bin, in ranges from zero

    def summed(values: Array, turns: NDArray[np.intp]) -> NDArray[np.complex128]:
        """Sums of values (n,) times exp(2 pi i turns/finer position/reach), (len(turns),)."""
        spectrum = np.fft.rfft(np.bincount(which, values, WAVES.bins), WAVES.finer * WAVES.bins)[turns].conj()
        return np.asarray(spectrum * np.exp(2j * np.pi * turns / WAVES.finer * middle))

    once, twice, total = summed(c * c, counted), summed(c * c, 2 * counted), float(np.sum(c * c))
    normal = np.empty((len(counted), 3, 3))  # of sine, cosine and 1
    normal[:, 0, 0], normal[:, 1, 1] = (total - twice.real) / 2, (total + twice.real) / 2
    normal[:, 0, 1] = normal[:, 1, 0] = twice.imag / 2
    normal[:, 0, 2] = normal[:, 2, 0] = once.imag
    normal[:, 1, 2] = normal[:, 2, 1] = once.real
    normal[:, 2, 2] = total
    along = [c * one for one in (*known.T, f)]
    sums = [_thirds(summed(values, counted), float(values.sum())) for values in along]
    *cross, right = (np.stack(three, axis=1) for three in sums)
    beside = np.stack(cross, axis=2)
    normal -= beside @ np.linalg.pinv(known.T @ known, hermitian=True) @ np.swapaxes(beside, 1, 2)
    sizes = np.einsum("kij,kj->ki", np.linalg.pinv(normal, rcond=1e-9, hermitian=True), right)
    power = np.einsum("ki,ki->k", sizes, right)
    peaks = [k for k in range(len(power)) if power[k] >= power[max(0, k - WAVES.finer) : k + WAVES.finer + 1].max()]
    small = WAVES.small * evidence.force_scale
    return [
        {
            "sine": float(sizes[k, 0]) if abs(sizes[k, 0]) > small else small,
            "cosine": float(sizes[k, 1]) if abs(sizes[k, 1]) > small else small,
            "wavelength": float(reach * WAVES.finer / counted[k]),
        }
        for k in sorted(peaks, key=lambda k: -power[k])[:count]
    ]


def _thirds(turned: NDArray[np.complex128], total: float) -> tuple[Array, Array, Array]:
    """Sums over sine, cosine and 1, each (k,), from those over exp(i angle), (k,), and the plain one."""
    return turned.imag, turned.real, np.full(len(turned), total)
