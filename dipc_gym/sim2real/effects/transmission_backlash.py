"""Play between motor and load."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import mujoco
import numpy as np

from dipc_gym.sim2real.document import Document
from dipc_gym.sim2real.effects.base import Effect, Evidence, Parameter, Values
from dipc_gym.sim2real.effects.coupling import SETTLE, can_split, couple, split

STEP = 2.5e-4


class Backlash(Effect):
    """Play in gears or belt: the motor turns a little before the load follows."""

    id = "transmission.backlash"
    place = "actuator"
    law = "rotor"
    parameters = (
        Parameter("gap", "m", 1e-9, log=True),
        Parameter("rotor_inertia", "kg", 1e-12, log=True),
    )
    rivals = ("motor.deadzone", "transmission.compliance", "friction.coulomb", "timing.delay")
    finest = STEP
    warm = SETTLE

    def fits(self, model: mujoco.MjModel, at: str) -> bool:
        """Where a motor drives a joint."""
        return can_split(model, at)

    def guesses(self, evidence: Evidence) -> Sequence[Values]:
        """Small shares of the range."""
        reach = max(float(np.std(evidence.position)), 1e-9)
        return [{"gap": share * reach, "rotor_inertia": 0.1 * evidence.inertia} for share in (0.01, 0.05)]

    def edit(self, document: Document, at: str, values: Values) -> None:
        """A rotor beside the load, and a stiff spring at each end of the play."""
        rotor, load = split(document, at, values["rotor_inertia"])
        # As stiff as explicit integration bears; damping there would add inertia under implicitfast.
        step = max(document.timestep, STEP)
        couple(document, f"{at}_play", rotor, load, values["rotor_inertia"] * (0.5 / step) ** 2, 0.0, values["gap"])

    def sentence(self, at: str, values: Values, unit: Mapping[str, str]) -> str:
        """In words."""
        return f"Backlash of {values['gap']:.3g} {unit['gap']} between {at} and what it drives."
