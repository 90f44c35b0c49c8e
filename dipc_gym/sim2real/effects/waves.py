"""Waves over position: what cogging, an uneven rail and friction that comes and goes have in common."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dipc_gym.sim2real.effects.base import Evidence

Array = NDArray[np.float64]

FINE = 0.05  # relative change of a wavelength that is a sizeable one over several waves
_MOST = 100.0  # waves over the range of position; an axis that turns many times has as many
_BINS = 4096  # of position, forty to the shortest wave
_STEP = 0.2  # of the waves counted over the range; two that differ by one are told apart


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
    # The force is mostly noise of differentiated encoders, so all of it is needed; by position it is soon summed up.
    edges = np.linspace(x.min(), x.min() + reach, _BINS + 1)
    which = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, _BINS - 1)
    weight, force = np.bincount(which, c * c, _BINS), np.bincount(which, c * f, _BINS)
    counted = np.arange(fewest, _MOST, _STEP)
    angles = np.outer(2 * np.pi * counted / reach, (edges[1:] + edges[:-1]) / 2)
    shapes = np.stack([np.sin(angles), np.cos(angles), np.ones_like(angles)], axis=1)
    normal = np.einsum("kib,b,kjb->kij", shapes, weight, shapes, optimize=True)
    cross = shapes @ np.stack([np.bincount(which, c * one, _BINS) for one in known.T], axis=1)
    normal -= cross @ np.linalg.pinv(known.T @ known, hermitian=True) @ np.swapaxes(cross, 1, 2)
    right = shapes @ force
    sizes = np.einsum("kij,kj->ki", np.linalg.pinv(normal, rcond=1e-9, hermitian=True), right)
    power = np.einsum("ki,ki->k", sizes, right)
    near = round(1 / _STEP)
    peaks = [k for k in range(len(power)) if power[k] >= power[max(0, k - near) : k + near + 1].max()]
    small = 0.02 * evidence.force_scale
    return [
        {
            "sine": float(sizes[k, 0]) if abs(sizes[k, 0]) > small else small,
            "cosine": float(sizes[k, 1]) if abs(sizes[k, 1]) > small else small,
            "wavelength": float(reach / counted[k]),
        }
        for k in sorted(peaks, key=lambda k: -power[k])[:count]
    ]
