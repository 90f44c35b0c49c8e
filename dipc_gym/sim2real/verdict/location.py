"""Where a mismatch sits: which joint carries it, and what it goes with."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

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


def _region(scene: Scene, j: int) -> tuple[str, float]:
    """What the unexplained force at a joint goes with, and how far: the quantity whose bins explain most of it."""
    force = scene.force[:, j]
    if not np.any(force):
        return "nowhere", 0.0
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


def _explained(force: NDArray[np.float64], quantity: NDArray[np.float64]) -> float:
    """Share of the variance of the force between bins of a quantity (correlation ratio)."""
    bins = VERDICT.bins
    edges = np.quantile(quantity, np.linspace(0, 1, bins + 1)[1:-1])
    which = np.searchsorted(edges, quantity)
    counts = np.bincount(which, minlength=bins)
    means = np.bincount(which, force, minlength=bins) / np.maximum(counts, 1)
    variance = float(np.var(force))
    return float(np.sum(counts * (means - np.mean(force)) ** 2) / len(force) / variance) if variance > 0 else 0.0
