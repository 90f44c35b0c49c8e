"""Something shakes the rig."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from dipc_gym.sim2real.document import Document
from dipc_gym.sim2real.effects.base import Effect, Evidence, Parameter, Values


class Periodic(Effect):
    """A force that swings with time, whatever the rig does: a fan, a pump, a vibrating table."""

    id = "disturbance.periodic"
    place = "joint"
    linear = ("sine", "cosine")
    parameters = (
        Parameter("sine", "N"),
        Parameter("cosine", "N"),
        Parameter("frequency", "Hz", 0.0, log=True, fine=0.01),
    )
    rivals = ("load.position", "disturbance.pulse")
    needs_loader = True

    def guesses(self, evidence: Evidence) -> Sequence[Values]:
        """The strongest lines of the unexplained force over time."""
        step = max(evidence.period, 1e-9)
        # Recordings begin anew; the first one alone has one phase.
        back = np.flatnonzero(np.diff(evidence.time) < 0)
        n = int(back[0]) + 1 if len(back) else len(evidence.time)
        t = np.arange(evidence.time[0], evidence.time[n - 1], step)
        f = np.interp(t, evidence.time[:n], evidence.force[:n])
        # What goes with the motion is no disturbance: friction, and own numbers that are off.
        v, load, q = (
            np.interp(t, evidence.time[:n], x[:n]) for x in (evidence.velocity, evidence.load, evidence.position)
        )
        known = np.stack([v, np.tanh(v / (0.05 * evidence.speed_scale)), load, q, np.ones_like(v)], axis=1)
        f = f - known @ np.linalg.lstsq(known, f, rcond=None)[0]
        size = 8 * len(f)
        spectrum = np.fft.rfft(f * np.hanning(len(f)), size)
        frequency = np.fft.rfftfreq(size, step)
        spectrum[frequency > min(50.0, 0.2 / step)] = 0
        found = []
        for _ in range(2):
            k = int(np.argmax(np.abs(spectrum)))
            if not frequency[k]:
                break
            shape = np.stack([np.sin(2 * np.pi * frequency[k] * t), np.cos(2 * np.pi * frequency[k] * t)], axis=1)
            a, b = np.linalg.lstsq(shape, f, rcond=None)[0]
            small = 0.02 * evidence.force_scale
            found.append(
                {
                    "sine": float(a) if abs(a) > small else small,
                    "cosine": float(b) if abs(b) > small else small,
                    "frequency": float(frequency[k]),
                }
            )
            spectrum[max(0, k - 24) : k + 25] = 0
        return found

    def edit(self, document: Document, at: str, values: Values) -> None:
        """An entry for the loader: amplitude, frequency, phase."""
        size, phase = np.hypot(values["sine"], values["cosine"]), np.arctan2(values["cosine"], values["sine"])
        document.custom(self.id, at, [float(size), values["frequency"], float(phase)])

    def sentence(self, at: str, values: Values, unit: Mapping[str, str]) -> str:
        """In words."""
        size = float(np.hypot(values["sine"], values["cosine"]))
        return f"A force of {size:.3g} {unit['sine']} at {values['frequency']:.3g} Hz shakes {at}."
