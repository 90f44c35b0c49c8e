"""Something pushed the rig once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from dipc_gym.mjcf.edit import Document
from dipc_gym.sim2real.effects.shared.base import Effect, Evidence, Parameter, Values

_HALF = 0.125  # s, half a window


class Pulse(Effect):
    """A push: a constant force on a joint for a short time."""

    id = "disturbance.pulse"
    place = "joint"
    of_the_clock = True
    parameters = (
        Parameter("force", "N"),
        Parameter("start", "s", step=0.1),
        Parameter("duration", "s", 1e-3, log=True),
    )
    rivals = ("disturbance.periodic",)
    needs_loader = True
    once = True
    leaves = 0.0

    def guesses(self, evidence: Evidence) -> Sequence[Values]:
        """Where the unexplained force, averaged over a short time, stands out most, in the outlier windows."""
        f = evidence.force - np.median(evidence.force)
        found = []
        stretches = [np.abs(evidence.time - (start + _HALF)) < 2 * _HALF for start in evidence.outliers[:3]]
        for width in (0.05, 0.2):
            n = max(3, int(width / max(evidence.period, 1e-9)))
            mean = np.convolve(f, np.ones(n) / n, mode="same")
            for stretch in stretches or [np.ones(len(f), dtype=bool)]:
                k = int(np.argmax(np.where(stretch, np.abs(mean), -1.0)))
                found.append(
                    {
                        "force": float(mean[k]) or evidence.force_scale,
                        "start": max(float(evidence.time[k]) - n // 2 * evidence.period, float(evidence.time.min())),
                        "duration": n * evidence.period,
                    }
                )
        return found

    def happened(self, values: Values) -> tuple[float, float]:
        """While it pushes."""
        return values["start"], values["start"] + values["duration"]

    def edit(self, document: Document, at: str, values: Values) -> None:
        """An entry for the loader."""
        document.custom(self.id, at, [values["force"], values["start"], values["duration"]])

    def sentence(self, at: str, values: Values, unit: Mapping[str, str]) -> str:
        """In words."""
        return (
            f"A push of {values['force']:.3g} {unit['force']} on {at} from {values['start']:.3f} s on, for "
            f"{1e3 * values['duration']:.0f} ms."
        )
