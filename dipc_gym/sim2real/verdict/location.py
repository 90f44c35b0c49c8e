"""Where a mismatch sits: which joint carries it, and what it goes with."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from dipc_gym.sim2real.effects.shared.base import runs_of
from dipc_gym.sim2real.estimation.settings import ESTIMATION
from dipc_gym.sim2real.estimation.unexplained import Scene
from dipc_gym.sim2real.result import Located
from dipc_gym.sim2real.verdict.settings import VERDICT


def locate(scene: Scene, joints: Sequence[str]) -> list[Located]:
    """Which joints carry the unexplained force, and in which region of motion; the largest share first."""
    size = np.sqrt(np.mean(scene.force**2, axis=0))
    scale = (
        np.sqrt(np.mean(scene.load**2, axis=0)) + VERDICT.light * np.sqrt(np.mean(scene.load**2, axis=0)).max() + 1e-12
    )
    power = (size / scale) ** 2
    total = float(power.sum()) or 1.0
    found = [Located(joint, float(power[j] / total), *_region(scene, j)) for j, joint in enumerate(joints)]
    return sorted(found, key=lambda x: -x.share)


def _region(scene: Scene, j: int) -> tuple[str, float, float]:
    """What the unexplained force at a joint goes with, and how far: with a quantity of the moment, and with what was of
    late.
    """
    force = scene.force[:, j]
    if not np.any(force):
        return "nowhere", 0.0, 0.0
    where, most = _instant(scene, j)
    late = _of_late(scene, j)
    if most < VERDICT.pattern and late > VERDICT.of_late:
        where = f"goes with velocity, by how fast it was of late ({100 * late:.0f} % of its variance)"
    return where, most, late


def _instant(scene: Scene, j: int) -> tuple[str, float]:
    """The quantity of the moment whose bins explain most of the unexplained force at a joint, and how much."""
    force = scene.force[:, j]
    v, q, load, t = scene.velocity[:, j], scene.position[:, j], scene.load[:, j], scene.time
    explained = {
        name: _explained(force, quantity)
        for name, quantity in (("velocity", v), ("position", q), ("load", load), ("time", t))
    }
    best = max(explained, key=lambda name: explained[name])
    most, percent = explained[best], f"{100 * explained[best]:.0f} % of its variance"
    if most < VERDICT.pattern:
        return "spread over position, velocity, load and time alike", most
    if best != "velocity":
        return f"goes with {best} ({percent})", most
    slow = np.abs(v) < VERDICT.slow * np.std(v)
    forward, backward = force[~slow & (v > 0)], force[~slow & (v < 0)]
    step = abs(float(np.mean(forward) - np.mean(backward))) if len(forward) and len(backward) else 0.0
    slope = abs(float(np.polyfit(v, force, 1)[0])) * 2 * float(np.std(v))
    at_rest = np.mean(np.abs(force[slow]))
    if step > VERDICT.step * slope or at_rest > VERDICT.stronger * np.mean(np.abs(force[~slow])):
        return f"changes sign with velocity, at reversals ({percent})", most
    return f"grows with velocity ({percent})", most


def _of_late(scene: Scene, j: int) -> float:
    """Share of the variance of the unexplained force that a drag explains which changes with how fast the joint was of
    late: grease that thins, of whose force no bins of one quantity tell.

    The rest of a drag is in every refit. Forces are means over stretches, for samples hold the noise of accelerations.
    """
    runs = [run for run in runs_of(scene.time) if len(run) > 1]
    if not runs:
        return 0.0
    periods = [float(np.median(np.diff(scene.time[run]))) for run in runs]

    def means(each_run: Iterable[NDArray[np.float64]]) -> NDArray[np.float64]:
        found = []
        for values, period in zip(each_run, periods, strict=True):
            each = max(1, round(ESTIMATION.averaged / period))
            found.append(values[: len(values) // each * each].reshape(-1, each).mean(axis=1))
        return np.concatenate(found)

    def of_late(seconds: float) -> Iterator[NDArray[np.float64]]:
        for run, period in zip(runs, periods, strict=True):
            share = min(period / seconds, 1.0)
            yield lfilter([share], [1.0, share - 1.0], np.abs(scene.velocity[run, j]))

    force, velocity = means(scene.force[run, j] for run in runs), means(scene.velocity[run, j] for run in runs)
    plain = np.column_stack([np.ones_like(force), velocity])
    left = _beside(plain, force)
    if not left > 0:
        return 0.0
    shares = [
        1.0 - _beside(np.column_stack([plain, velocity * means(of_late(seconds))]), force) / left
        for seconds in VERDICT.late
    ]
    return max(shares)


def _beside(columns: NDArray[np.float64], force: NDArray[np.float64]) -> float:
    """Sum of squares that columns leave of a force."""
    off = force - columns @ np.linalg.lstsq(columns, force, rcond=None)[0]
    return float(off @ off)


def _explained(force: NDArray[np.float64], quantity: NDArray[np.float64]) -> float:
    """Share of the variance of the force between bins of a quantity (correlation ratio)."""
    bins = VERDICT.bins
    edges = np.quantile(quantity, np.linspace(0, 1, bins + 1)[1:-1])
    which = np.searchsorted(edges, quantity)
    counts = np.bincount(which, minlength=bins)
    means = np.bincount(which, force, minlength=bins) / np.maximum(counts, 1)
    variance = float(np.var(force))
    return float(np.sum(counts * (means - np.mean(force)) ** 2) / len(force) / variance) if variance > 0 else 0.0
