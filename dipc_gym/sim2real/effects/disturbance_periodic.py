"""Something shakes the rig."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from dipc_gym.mjcf.edit import Document
from dipc_gym.sim2real.effects.shared.base import Array, Effect, Evidence, Parameter, Values

FASTEST = 65.0  # Hz, of what shakes a rig: the mains are not above it
MAINS = (50.0, 60.0)  # Hz
FELT = 2.0  # Hz, from which a force turns round within a window of a quarter second, and moves less the faster it does


class Periodic(Effect):
    """A force that swings with time, whatever the rig does: a fan, a pump, a vibrating table."""

    id = "disturbance.periodic"
    place = "joint"
    of_the_clock = True
    linear = ("sine", "cosine")
    rivals = ("load.position", "disturbance.pulse")
    needs_loader = True

    def __init__(self, slowest: float = 0.0) -> None:
        self.parameters = (
            Parameter("sine", "N"),
            Parameter("cosine", "N"),
            Parameter("frequency", "Hz", slowest, log=True, fine=0.01),
        )

    def proposals(self, evidence: Evidence) -> Sequence[tuple[Effect, Values]]:
        """With a frequency at which it comes round half in a recording at least: of less, a bend is all that shows."""
        longest = max(float(np.ptp(evidence.time[run])) for run in evidence.runs)
        return [(Periodic(0.5 / max(longest, 1e-9)), values) for values in self.guesses(evidence)]

    def guesses(self, evidence: Evidence) -> Sequence[Values]:
        """The strongest lines of the unexplained force over time."""
        step = max(evidence.period, 1e-9)
        # Recordings begin anew; the first one alone has one phase.
        back = np.flatnonzero(np.diff(evidence.time) < 0)
        n = int(back[0]) + 1 if len(back) else len(evidence.time)
        t = np.arange(evidence.time[0], evidence.time[n - 1], step)
        f = np.interp(t, evidence.time[:n], evidence.force[:n])
        # What goes with the motion may be friction, or model parameters that are off; or the motion is what the rig
        # makes of the disturbance, as where it is balanced.
        v, load, q = (
            np.interp(t, evidence.time[:n], x[:n]) for x in (evidence.velocity, evidence.load, evidence.position)
        )
        known = np.stack([v, np.tanh(v / (0.05 * evidence.speed_scale)), load, q, np.ones_like(v)], axis=1)
        beside = f - known @ np.linalg.lstsq(known, f, rcond=None)[0]
        small = 0.02 * evidence.force_scale
        # Noise of accelerations is strongest where forces move the rig least.
        lines = _lines(t, f - f.mean(), step) | _lines(t, beside, step) | _lines(t, f - f.mean(), step, felt=FELT)
        return [
            {
                "sine": a if abs(a) > small else small,
                "cosine": b if abs(b) > small else small,
                "frequency": frequency,
            }
            for frequency, (a, b) in lines.items()
        ]

    def edit(self, document: Document, at: str, values: Values) -> None:
        """An entry for the loader: amplitude, frequency, phase."""
        size, phase = np.hypot(values["sine"], values["cosine"]), np.arctan2(values["cosine"], values["sine"])
        document.custom(self.id, at, [float(size), values["frequency"], float(phase)])

    def sentence(self, at: str, values: Values, unit: Mapping[str, str]) -> str:
        """In words."""
        size, frequency = float(np.hypot(values["sine"], values["cosine"])), values["frequency"]
        hums = any(abs(frequency - mains) < 0.01 * mains for mains in MAINS)
        hum = " That is the frequency of the mains: hum in the wires of a sensor would look the same." if hums else ""
        return f"A force of {size:.3g} {unit['sine']} at {frequency:.3g} Hz shakes {at}.{hum}"


def _lines(t: Array, force: Array, step: float, felt: float = np.inf) -> dict[float, tuple[float, float]]:
    """Weights of sine and cosine, by frequency in Hz, of the two strongest lines of a force (n,) at times t (n,).

    By what they move, if `felt` is given: like a constant force below that frequency, less by its square above.
    """
    size = 8 * len(force)
    spectrum = np.fft.rfft(force * np.hanning(len(force)), size)
    frequency = np.fft.rfftfreq(size, step)
    spectrum[(frequency > min(FASTEST, 0.2 / step)) | (frequency * step * len(force) < 1)] = 0  # at least once round
    spectrum /= 1 + (frequency / felt) ** 2
    found = {}
    for _ in range(2):
        k = int(np.argmax(np.abs(spectrum)))
        if not frequency[k]:
            break
        angle = 2 * np.pi * frequency[k] * t
        a, b = np.linalg.lstsq(np.stack([np.sin(angle), np.cos(angle)], axis=1), force, rcond=None)[0]
        found[float(frequency[k])] = float(a), float(b)
        spectrum[max(0, k - 24) : k + 25] = 0
    return found
