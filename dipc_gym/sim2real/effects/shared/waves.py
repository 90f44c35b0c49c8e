"""Waves over position: what cogging, friction that comes and goes and an encoder off its axis have in common."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from dipc_gym.sim2real.effects.shared.base import Evidence
from dipc_gym.sim2real.effects.shared.settings import WAVES

Array = NDArray[np.float64]


def waves(evidence: Evidence, fewest: float, carrier: Array | None = None) -> list[dict[str, float]]:
    """Sine waves over position that explain most of the unexplained force, the best first.

    Args:
        evidence: at a joint.
        fewest: waves over the range of position.
        carrier: what the wave is multiplied by, (n,), as the direction of motion; nothing by default.

    Returns:
        `sine`, `cosine` (N or N m) and `wavelength` (m or rad) of each.
    """
    x = evidence.position
    reach = max(float(np.ptp(x)), 1e-9)
    known, f = _beside(evidence)
    c = np.ones_like(x) if carrier is None else carrier
    most = min(WAVES.most, WAVES.resolved * reach / evidence.period / evidence.speed_scale)
    counted = np.arange(round(fewest * WAVES.finer), max(round(most * WAVES.finer), round(fewest * WAVES.finer)) + 1)
    summed = _sums(x, reach)
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
        for k in sorted(peaks, key=lambda k: -power[k])[: WAVES.kept]
    ]


def eccentric(evidence: Evidence, fewest: float, known: Sequence[float] = ()) -> list[dict[str, float]]:
    """Waves in a sensor's reading over position whose acceleration explains most of the unexplained force, best first.

    A reading y = q + e(q) is taken for the motion, which then seems to need the force I d^2 e/dt^2 beside what it does.

    Args:
        evidence: at a sensor.
        fewest: waves over the range of position.
        known: wavelengths that are likely before anything is known, m or rad.

    Returns:
        `sine` and `cosine` (m or rad) and `wavelength` of each.
    """
    x, v, a = evidence.position, evidence.velocity, evidence.foretold
    reach = max(float(np.ptp(x)), 1e-9)
    beside, f = _beside(evidence)
    first = max(round(fewest * WAVES.finer), 1)
    most = min(WAVES.most, WAVES.resolved * reach / evidence.period / evidence.speed_scale)
    turns = np.arange(first, max(round(most * WAVES.finer), first) + 1)
    k = 2 * np.pi * turns / (WAVES.finer * reach)
    summed = _sums(x, reach)

    def along(values: Array) -> NDArray[np.complex128]:
        """Sums of values (n,) times the second derivative of exp(i k x) by time."""
        return np.asarray(1j * k * summed(values * a, turns) - k**2 * summed(values * v**2, turns))

    square, mixed, fourth = (summed(one, 2 * turns) for one in (a**2, a * v**2, v**4))
    twice = -(k**2) * square - 2j * k**3 * mixed + k**4 * fourth
    total = k**2 * float(np.sum(a**2)) + k**4 * float(np.sum(v**4))
    normal = np.empty((len(k), 2, 2))  # of sine and cosine
    normal[:, 0, 0], normal[:, 1, 1] = (total - twice.real) / 2, (total + twice.real) / 2
    normal[:, 0, 1] = normal[:, 1, 0] = twice.imag / 2
    cross = np.stack([np.stack([one.imag, one.real], axis=1) for one in map(along, beside.T)], axis=2)
    normal -= cross @ np.linalg.pinv(beside.T @ beside, hermitian=True) @ np.swapaxes(cross, 1, 2)
    right = np.stack([along(f).imag, along(f).real], axis=1)
    power = np.einsum("ki,kij,kj->k", right, np.linalg.pinv(normal, rcond=1e-9, hermitian=True), right)
    peaks = [j for j in range(len(power)) if power[j] >= power[max(0, j - WAVES.finer) : j + WAVES.finer + 1].max()]
    best = [2 * np.pi / k[j] for j in sorted(peaks, key=lambda j: -power[j])[: WAVES.kept]]
    return [_swaying(evidence, a, beside, float(wavelength)) for wavelength in [*known, *best]]


def _beside(evidence: Evidence) -> tuple[Array, Array]:
    """What would hide a wave, (n, 4), and the force less that, (n,): what goes with acceleration, for an inertia or an
    encoder's gain may be a little off, friction, and a constant force. Whoever looks for waves takes it out of these,
    too.
    """
    v = evidence.velocity
    known = np.stack([evidence.foretold, v, evidence.direction, np.ones_like(v)], axis=1)
    return known, evidence.force - known @ np.linalg.lstsq(known, evidence.force, rcond=None)[0]


def _swaying(evidence: Evidence, a: Array, beside: Array, wavelength: float) -> dict[str, float]:
    """How large a wave of one length in a sensor's reading is, by the force that it seems to need."""
    k = 2 * np.pi / wavelength
    turned = (1j * k * a - k**2 * evidence.velocity**2) * np.exp(1j * k * evidence.position)
    columns = evidence.inertia * np.column_stack([turned.imag, turned.real])
    sine, cosine = np.linalg.lstsq(np.column_stack([columns, beside]), evidence.force, rcond=None)[0][:2]
    steepest = WAVES.steepest / k
    size = max(float(np.hypot(sine, cosine)), 1e-12)
    held = min(1.0, steepest / size)
    return {"sine": float(sine) * held, "cosine": float(cosine) * held, "wavelength": wavelength}


def _sums(x: Array, reach: float) -> Callable[[Array, NDArray[np.intp]], NDArray[np.complex128]]:
    """What sums values (n,) times exp(2 pi i turns/finer position/reach), for each of many turns, (len(turns),).

    The force is mostly noise of differentiated encoders, so all of it is needed; by position it is soon summed up, and
    a Fourier transform then sums each wave.
    """
    which = np.clip(((x - x.min()) / reach * WAVES.bins).astype(np.intp), 0, WAVES.bins - 1)
    middle = x.min() / reach + 0.5 / WAVES.bins  # of the first bin, in ranges from zero

    def summed(values: Array, turns: NDArray[np.intp]) -> NDArray[np.complex128]:
        spectrum = np.fft.rfft(np.bincount(which, values, WAVES.bins), WAVES.finer * WAVES.bins)[turns].conj()
        return np.asarray(spectrum * np.exp(2j * np.pi * turns / WAVES.finer * middle))

    return summed


def _thirds(turned: NDArray[np.complex128], total: float) -> tuple[Array, Array, Array]:
    """Sums over sine, cosine and 1, each (k,), from those over exp(i angle), (k,), and the plain one."""
    return turned.imag, turned.real, np.full(len(turned), total)
