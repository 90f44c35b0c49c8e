"""The winding's current lags behind its voltage."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import mujoco

from dipc_gym.mjcf.edit import Document
from dipc_gym.sim2real.effects.shared.base import Effect, Evidence, Parameter, Values, is_dcmotor
from dipc_gym.sim2real.effects.shared.settings import EFFECTS


class Inductance(Effect):
    """Winding inductance, or the lag of a current loop: force follows the command with a time constant."""

    id = "motor.inductance"
    place = "actuator"
    parameters = (Parameter("time_constant", "s", 2e-5, 0.2, log=True),)
    rivals = ("timing.delay", "timing.sensor_lag", "timing.sensor_lag:delay", "transmission.compliance")
    finest = EFFECTS.fast
    warm = EFFECTS.slow_current

    def fits(self, model: mujoco.MjModel, at: str) -> bool:
        """On a motor without dynamics of its own."""
        i = model.actuator(at).id
        return bool(model.actuator_actnum[i] == 0) and (is_dcmotor(model, at) or _plain(model, i))

    def guesses(self, evidence: Evidence) -> Sequence[Values]:
        """A short and a long one."""
        return [{"time_constant": 0.002}, {"time_constant": 0.01}]

    def edit(self, document: Document, at: str, values: Values) -> None:
        """The motor's time constant; a plain motor is filtered, exactly, for the constant may be below the step."""
        actuator = document.actuator(at)
        if actuator.tag == "dcmotor":
            document.set(actuator, inductance=(0, values["time_constant"]))
        else:
            if actuator.tag == "motor":
                actuator.tag = "general"
                document.plain(actuator, gaintype="fixed", gainprm="1", biastype="none", actdim="-1")
            document.set(actuator, dyntype="filterexact", dynprm=values["time_constant"])

    def sentence(self, at: str, values: Values, unit: Mapping[str, str]) -> str:
        """In words."""
        return f"The force of {at} follows its command with a time constant of {1e3 * values['time_constant']:.3g} ms."


def _plain(model: mujoco.MjModel, actuator: int) -> bool:
    return bool(
        model.actuator_gaintype[actuator] == mujoco.mjtGain.mjGAIN_FIXED
        and model.actuator_biastype[actuator] == mujoco.mjtBias.mjBIAS_NONE
    )
