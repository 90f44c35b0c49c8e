"""The supply of a motor gives way under what was drawn from it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import mujoco
import numpy as np

from dipc_gym import mjcf
from dipc_gym.mjcf.edit import Document
from dipc_gym.physics import SAG
from dipc_gym.sim2real.effects.shared.base import Effect, Evidence, Parameter, Values, is_dcmotor, joint_of, rms
from dipc_gym.sim2real.effects.shared.drives import drive_of
from dipc_gym.sim2real.effects.shared.law import recalled
from dipc_gym.sim2real.effects.shared.sought import Sought, apart

TIMES = np.geomspace(0.02, 20.0, 16)  # s, tried against the unexplained force
APART = 3.0  # times, by which two that are proposed differ at least
LEAST, MOST = 0.02, 0.5  # share of the supply that a first guess takes off
USUAL, PACE = 0.1, 1.0  # the same, and s, where forces tell neither


class Sag(Effect):
    """A supply that sags with past current: commands act with less of it the more was drawn of late.

    What it remembers is the mean current of the past, which fades with a time constant: a battery that tires, a
    capacitor that empties. Current is told by the voltage across the winding, what is left of the command less the
    back-EMF; of an actuator that takes a force, by what is left of the command.
    """

    id = "motor.sag"
    place = "actuator"
    linear = ("drop",)
    parameters = (
        Parameter("drop", "", 0.0, 10.0),
        Parameter("time_constant", "s", 5e-3, 600.0, log=True),
        Parameter("current", "command", 0.0, fixed=True),
        Parameter("gain", "", fixed=True),
        Parameter("back", "", fixed=True),
    )
    valleys = ("time_constant",)
    needs_loader = True
    of_the_past = True
    rivals = ("motor.thermal", "motor.map", "motor.saturation", "motor.back_emf")
    shown_by = "hard work for some seconds, and the same motion once more after a rest"

    def fits(self, model: mujoco.MjModel, at: str) -> bool:
        """On a joint that no other actuator with a command drives; what is sent is a voltage or a force, no target."""
        return drains(model, at)

    def guesses(self, evidence: Evidence) -> Sequence[Values]:
        """The share and the time constants with which it takes most of the unexplained force."""
        gain, back = drive_of(evidence.model, evidence.at)
        if not len(evidence.command) or not np.any(evidence.command):
            return []
        current = rms(evidence.command - back * evidence.velocity)
        held = {"current": current, "gain": gain, "back": back}
        found = most_alike(evidence) or [(USUAL / current, PACE)]
        return [{"drop": per * current, "time_constant": time, **held} for per, time in found]

    def edit(self, document: Document, at: str, values: Values) -> None:
        """A force against the drive for the loader, which keeps the past in mind; stock MuJoCo leaves it out."""
        joint = document.effective(document.actuator(at), "joint")
        per = values["drop"] / values["current"]
        document.remembering(SAG, joint, [values["gain"], values["back"], per, values["time_constant"]])
        document.depends(SAG, joint, [f"command {at}"])

    def sentence(self, at: str, values: Values, unit: Mapping[str, str]) -> str:
        """In words."""
        size = f"{values['current']:.3g} {unit['current']}".strip()
        across = f"{size} across its winding" if values["back"] else f"a command of {size}"
        return (
            f"The supply of {at} sags with past current: under {across} it comes to lose {100 * values['drop']:.3g} % "
            f"of its force, with a time constant of {values['time_constant']:.2g} s."
        )


def drains(model: mujoco.MjModel, at: str) -> bool:
    """Whether a supply that sags shows at an actuator: one with a command that drives a joint alone, and whose command
    is a voltage or a force, no target, whether of a position or of a speed.
    """
    joint, i = joint_of(model, at), model.actuator(at).id
    if is_dcmotor(model, at):
        powers = bool(model.actuator_ctrlspec[i] == mujoco.mjtCtrlInput.mjINPUT_VOLTAGE)
    else:
        gain, bias = model.actuator_gainprm[i, 0], model.actuator_biasprm[i]
        powers = bool(bias[1] == 0 and (bias[2] == 0 or bias[2] != -gain))  # a servo's gain stands in both
    drives = (model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT) & (
        model.actuator_trnid[:, 0] == model.actuator_trnid[i, 0]
    )
    drives[mjcf.passive_actuators(model)] = False
    alone = int(np.sum(drives)) == 1
    return joint is not None and powers and alone and bool(drive_of(model, at)[0])


def most_alike(evidence: Evidence) -> list[tuple[float, float]]:
    """Shares of the drive that are lost for each unit of current, and time constants in s, with which most of the
    unexplained force is; none where all would have to add to the drive.
    """
    gain, back = drive_of(evidence.model, evidence.at)
    current = rms(evidence.command - back * evidence.velocity)
    tries = np.stack(np.broadcast_arrays(gain, back, 0.0, TIMES), axis=1)
    pasts = recalled(evidence, SAG, tries, evidence.command)
    sought = Sought(evidence, [evidence.velocity, evidence.command, evidence.direction])
    told = [sought.explained(-gain * evidence.command * past / current) for past in pasts]
    best = apart([one.left_by_pulling for one in told], TIMES.tolist(), count=2, ratio=APART)
    return [(float(np.clip(told[k].weight, LEAST, MOST)) / current, float(TIMES[k])) for k in best]
