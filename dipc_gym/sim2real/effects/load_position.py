"""A force that varies along the way."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from dipc_gym.sim2real.document import Document
from dipc_gym.sim2real.effects.base import Effect, Evidence, Parameter, Values, passive_wave


class Wave(Effect):
    """A force that depends on position and repeats along it: a rack's teeth, an unbalanced pulley, a wavy rail."""

    id = "load.position"
    place = "joint"
    linear = ("sine", "cosine")
    parameters = (
        Parameter("sine", "N"),
        Parameter("cosine", "N"),
        Parameter("wavelength", "m", 0.0, log=True),
    )
    rivals = ("motor.cogging", "load.spring", "friction.position")
    contains = ("load.constant", "load.spring")

    def guesses(self, evidence: Evidence) -> Sequence[Values]:
        """The two wavelengths that explain most of the force."""
        return waves(evidence, 2.0, 0.02)

    def edit(self, document: Document, at: str, values: Values) -> None:
        """A passive force that is a sine of position."""
        size, phase = np.hypot(values["sine"], values["cosine"]), np.arctan2(values["cosine"], values["sine"])
        passive_wave(document, f"{at}_wave", at, float(size), 2 * np.pi / values["wavelength"], float(phase))

    def sentence(self, at: str, values: Values, unit: Mapping[str, str]) -> str:
        """In words."""
        size = float(np.hypot(values["sine"], values["cosine"]))
        return (
            f"A force of up to {size:.3g} {unit['sine']} at {at} that repeats every "
            f"{values['wavelength']:.3g} {unit['wavelength']}."
        )


def waves(evidence: Evidence, longest: float, shortest: float, count: int = 2) -> list[dict[str, float]]:
    """Sine waves over position that explain most of the unexplained force, the best first.

    Args:
        evidence: at a joint.
        longest: longest wavelength, in ranges of position.
        shortest: shortest wavelength, in ranges of position.
        count: how many.
    """
    reach = max(float(np.ptp(evidence.position)), 1e-9)
    thin = slice(None, None, max(1, len(evidence.force) // 4000))
    x, f = evidence.position[thin], evidence.force[thin] - np.mean(evidence.force[thin])
    # Dry friction would hide a wave; what goes with velocity is taken out first.
    v = evidence.velocity[thin]
    known = np.stack([v, np.tanh(v / (0.05 * evidence.speed_scale)), np.ones_like(v)], axis=1)
    f = f - known @ np.linalg.lstsq(known, f, rcond=None)[0]
    found = []
    for wavelength in reach * np.geomspace(longest, shortest, 120):
        k = 2 * np.pi / wavelength
        shape = np.stack([np.sin(k * x), np.cos(k * x), np.ones_like(x)], axis=1)
        weights, *_ = np.linalg.lstsq(shape, f, rcond=None)
        found.append((float(np.var(shape @ weights)), float(weights[0]), float(weights[1]), float(wavelength)))
    peaks = [
        found[i]
        for i in range(len(found))
        if found[i][0] >= max(found[j][0] for j in range(max(0, i - 4), min(len(found), i + 5)))
    ]
    small = 0.02 * evidence.force_scale
    return [
        {"sine": a if abs(a) > small else small, "cosine": b if abs(b) > small else small, "wavelength": length}
        for _, a, b, length in sorted(peaks, reverse=True)[:count]
    ]
