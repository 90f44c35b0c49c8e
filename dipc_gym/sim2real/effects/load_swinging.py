"""A part of what a joint moves swings on its own: a load on a rope, a fluid in a tank, a link that bends."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from dipc_gym.mjcf.edit import Document
from dipc_gym.sim2real.effects.base import Effect, Evidence, Parameter, Values
from dipc_gym.sim2real.effects.coupling import beside, couple, free_inertia
from dipc_gym.sim2real.unseen.operators import swing

Array = NDArray[np.float64]

RATES = 2 * np.pi * np.geomspace(0.4, 20.0, 40)  # rad/s, tried by regression
DAMPED = 0.05  # damping ratio to begin with
LIGHTEST, HEAVIEST = 0.01, 0.7  # of a first guess, as a share of what the joint moves


class SwingingLoad(Effect):
    """One hidden mode: a mass on a spring and a damper, that no sensor sees.

    It is taken out of what the joint moves, so that both together weigh as much as before. What it does at a window's
    start follows from the motion before (`simulation.memory`).
    """

    id = "load.swinging"
    place = "joint"
    law = "swinging load"
    parameters = (
        Parameter("mass", "kg", 1e-9, log=True),
        Parameter("frequency", "Hz", 0.05, 60.0, log=True, fine=0.1),
        Parameter("damping_ratio", "", 1e-3, 3.0, log=True),
    )
    rivals = ("transmission.compliance", "transmission.backlash", "load.spring", "friction.hysteresis")

    def guesses(self, evidence: Evidence) -> Sequence[Values]:
        """The two rates at which a load would pull most like the unexplained force."""
        begins = np.flatnonzero(np.diff(evidence.time, prepend=np.inf) <= 0)
        parts = np.split(np.arange(len(evidence.time)), begins[begins > 0])
        plain = np.stack([np.ones_like(evidence.force), evidence.velocity, evidence.position], axis=1)
        found = []
        for rate in RATES:
            pull = np.concatenate([_pull(rate, evidence, part) for part in parts])
            columns = np.column_stack([pull, plain])
            weights, *_ = np.linalg.lstsq(columns, evidence.force, rcond=None)
            left = float(np.sum((evidence.force - columns @ weights) ** 2))
            if weights[0] > 0:
                found.append((left, rate, float(weights[0])))
        peaks: list[tuple[float, float, float]] = []
        for one in sorted(found):
            if len(peaks) < 2 and all(abs(np.log(one[1] / other[1])) > 0.3 for other in peaks):
                peaks.append(one)
        inertia = free_inertia(evidence.model, evidence.at)
        return [
            {
                "mass": float(np.clip(mass, LIGHTEST * inertia, HEAVIEST * inertia)),
                "frequency": rate / (2 * np.pi),
                "damping_ratio": DAMPED,
            }
            for _, rate, mass in peaks
        ]

    def edit(self, document: Document, at: str, values: Values) -> None:
        """A body beside the one that the joint moves, and a spring between them."""
        mass, rate = values["mass"], 2 * np.pi * values["frequency"]
        name = beside(document, f"{at}_load", at, mass)
        couple(document, name, name, at, mass * rate**2, 2 * values["damping_ratio"] * rate * mass)

    def sentence(self, at: str, values: Values, unit: Mapping[str, str]) -> str:
        """In words."""
        return (
            f"A part of what {at} moves, {values['mass']:.3g} {unit['mass']}, swings on its own: at "
            f"{values['frequency']:.3g} Hz, with a damping ratio of {values['damping_ratio']:.2g}."
        )


def _pull(rate: float, evidence: Evidence, part: NDArray[np.intp]) -> Array:
    """Force of a load of 1 kg against one that is carried along, at its rate."""
    if len(part) < 3:
        return np.zeros(len(part))
    q, v, t = evidence.position[part], evidence.velocity[part], evidence.time[part]
    apart, faster = swing(rate**2, 2 * DAMPED * rate, q, v, t, t)
    return np.asarray(np.gradient(v, t) + rate**2 * apart + 2 * DAMPED * rate * faster)
