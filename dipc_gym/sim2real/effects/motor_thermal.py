"""The motor gets hot."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import mujoco
import numpy as np

from dipc_gym.mjcf.edit import Document
from dipc_gym.sim2real.effects.shared.base import Effect, Evidence, Parameter, Values, is_dcmotor

COPPER = 0.0039  # 1/K by which copper's resistance grows
AMBIENT = 25.0  # deg C at which the model's resistance holds, and of the motor's surroundings


class Thermal(Effect):
    """The winding heats, its resistance grows, and the motor gives less force per volt the longer it works hard.

    The temperature follows the losses i^2 R with a time constant, far longer than a window; `heat` works out how hot
    the winding is when one begins.
    """

    id = "motor.thermal"
    place = "actuator"
    of_the_clock = True
    parameters = (
        Parameter("thermal_resistance", "K/W", 1e-9, log=True),
        Parameter("time_constant", "s", 0.5, 1e4, log=True),
    )
    rivals = ("motor.saturation", "drag.quadratic", "motor.back_emf")
    leaves = 0.02  # a load that changed its mass passed for it in three blind trials, and left 0.05 to 0.26

    def fits(self, model: mujoco.MjModel, at: str) -> bool:
        """On a DC motor that is driven by a voltage and stays cold in the model."""
        i = model.actuator(at).id
        return (
            is_dcmotor(model, at)
            and model.actuator_ctrlspec[i] == mujoco.mjtCtrlInput.mjINPUT_VOLTAGE
            and bool(model.actuator_dynprm[i, 2] == 0)
        )

    def guesses(self, evidence: Evidence) -> Sequence[Values]:
        """Five per cent more resistance in the end: soon, and hardly within the recording."""
        resistance, constant = evidence.model.actuator(evidence.at).gainprm[:2]
        drive = evidence.command - constant * evidence.gear * evidence.velocity
        losses = float(np.mean(drive**2)) / float(resistance)
        if losses <= 0:
            return []
        per_watt, span = 0.05 / COPPER / losses, float(np.ptp(evidence.time))
        return [
            {"thermal_resistance": per_watt, "time_constant": max(0.25 * span, 1.0)},
            {"thermal_resistance": 4 * per_watt, "time_constant": max(2 * span, 4.0)},
        ]

    def edit(self, document: Document, at: str, values: Values) -> None:
        """The motor's thermal model."""
        document.set(
            document.actuator(at),
            thermal=(values["thermal_resistance"], 0, values["time_constant"], COPPER, AMBIENT, AMBIENT),
        )

    def sentence(self, at: str, values: Values, unit: Mapping[str, str]) -> str:
        """In words."""
        return (
            f"{at} gets hot and loses force: its winding warms by {values['thermal_resistance']:.3g} "
            f"{unit['thermal_resistance']} with a time constant of {values['time_constant']:.3g} "
            f"{unit['time_constant']}."
        )
