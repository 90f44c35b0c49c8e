"""The supply of a motor gives way under what was drawn from it, by a law of its own."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from dipc_gym.mjcf.edit import Document
from dipc_gym.physics import SAG_BY_LAW
from dipc_gym.sim2real.effects.motor_sag import PACE, USUAL, drains, most_alike
from dipc_gym.sim2real.effects.shared.base import Effect, Evidence, Parameter, Values
from dipc_gym.sim2real.effects.shared.drives import drive_of
from dipc_gym.sim2real.effects.shared.increments import LawOfIncrements
from dipc_gym.sim2real.effects.shared.law import described

Array = NDArray[np.float64]

FIRST = 8  # stretches between the knots of a law at first
FURTHEST = 0.995  # quantile of the current, which the table goes up to
LEAST = 1e-2  # of all that it takes off, by which it takes off more from one knot to the next, to begin with


class SagOfAnyLaw(LawOfIncrements):
    """A supply that sags with past current as any function that grows with it; `motor.sag` in proportion.

    A battery's chemistry gives way at once under little and then hardly any more, a regulator not at all up to its
    limit, and what gets hot does so with the square. The law is one of the current itself, before the past is averaged,
    so that short peaks may count for more than their mean. It takes off all of the drive at most, and never drives.

    Increments say how much more of the drive is lost with each stretch of the table, which is never less.
    """

    id = "motor.sag:law"
    place = "actuator"
    valleys = ("time_constant",)
    of_the_past = True
    contains = ("motor.sag",)
    rivals = ("motor.thermal", "motor.map", "motor.saturation", "residual.force")
    shown_by = "hard work for some seconds, and the same motion once more after a rest"

    increment = "more", ""
    beside = (
        Parameter("time_constant", "s", 5e-3, 600.0, log=True),
        Parameter("current", "command", 0.0, fixed=True),
        Parameter("gain", "", fixed=True),
        Parameter("back", "", fixed=True),
    )

    def __init__(self, first: Values | None = None) -> None:
        super().__init__(first, largest=1.0)

    def fits(self, model: mujoco.MjModel, at: str) -> bool:
        """Where `motor.sag` does."""
        return drains(model, at)

    def proposals(self, evidence: Evidence) -> Sequence[tuple[Effect, Values]]:
        """In proportion, with the time constants at which that takes most of the unexplained force."""
        gain, back = drive_of(evidence.model, evidence.at)
        if not len(evidence.command) or not np.any(evidence.command):
            return []
        drawn = float(np.quantile(np.abs(evidence.command - back * evidence.velocity), FURTHEST))
        if not drawn:
            return []
        held = {"current": drawn, "gain": gain, "back": back}
        tries = most_alike(evidence) or [(USUAL / drawn, PACE)]
        return [self._shaped({**held, "time_constant": t}, np.full(FIRST, per * drawn / FIRST)) for per, t in tries]

    def reshaped(self, levels: Array, values: Values) -> tuple[Effect, Values]:
        """The law with other shares."""
        return self._shaped({p.name: values[p.name] for p in self.beside}, np.diff(levels))

    def edit(self, document: Document, at: str, values: Values) -> None:
        """A table for the loader, which keeps the past in mind; stock MuJoCo leaves it out."""
        joint = document.effective(document.actuator(at), "joint")
        numbers = [values[name] for name in ("gain", "back", "time_constant", "current")]
        document.remembering(SAG_BY_LAW, joint, [*numbers, self._beyond(values), *self.at_knots(values)])
        document.depends(SAG_BY_LAW, joint, [f"command {at}"])

    def law_of(self, values: Values, unit: Mapping[str, str]) -> dict[str, Any]:
        """Which share of the drive comes to be lost, by the current that is drawn."""
        levels, most = self.at_knots(values).tolist(), values["current"]
        knots = np.linspace(0.0, most, len(levels)).tolist()
        if levels[-1] < 1.0 and self._beyond(values) > 0:  # beyond the data it goes on so, until all is lost
            knots, levels = [*knots, most + (1.0 - levels[-1]) / self._beyond(values)], [*levels, 1.0]
        inputs = [{"name": "current", "unit": unit["current"], "knots": knots}]
        left = "the command times the share that is left"
        what = f"|{left}, less {values['back']:.4g} times the speed of its joint|" if values["back"] else f"|{left}|"
        how = (
            f"The current is told as {what}. What is lost follows the law of it with a time constant of "
            f"{values['time_constant']:.4g} s."
        )
        kind, told = "share of the drive that comes to be lost", [[0.0, most]]
        return described(kind, inputs, levels, "", passive=True, remembers=how, supported=told)

    def sentence(self, at: str, values: Values, unit: Mapping[str, str]) -> str:
        """In words."""
        levels = np.minimum(self.at_knots(values), 1.0)  # no more than all
        half = len(levels) // 2
        little, much = (
            f"{values['current'] * k / (len(levels) - 1):.3g} {unit['current']}".strip()
            for k in (half, len(levels) - 1)
        )
        under = f"{little} across its winding" if values["back"] else f"a command of {little}"
        return (
            f"The supply of {at} sags with past current by a law of its own: under {under} it comes to lose "
            f"{100 * levels[half]:.3g} % of its force, under {much} {100 * levels[-1]:.3g} %, with a time constant of "
            f"{values['time_constant']:.2g} s."
        )

    def _shaped(self, beside: Values, shares: Array) -> tuple[Effect, Values]:
        begin = {**beside, **self.by_name(np.clip(shares, LEAST * max(float(np.sum(shares)), LEAST), 1.0))}
        return type(self)(begin), begin

    def _beyond(self, values: Values) -> float:
        """Share that is lost for each unit of current beyond the table: as much as in its last stretch."""
        levels = self.at_knots(values)
        return float((levels[-1] - levels[-2]) * (len(levels) - 1) / values["current"])
