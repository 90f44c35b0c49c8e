"""An amplifier that makes of a command any function of it."""

from __future__ import annotations

from collections.abc import Mapping

import mujoco
import numpy as np

from dipc_gym.sim2real.effects.base import Evidence, Values, dof, joint_of
from dipc_gym.sim2real.effects.law import Array, Map
from dipc_gym.sim2real.effects.tables import grow


class CommandMap(Map):
    """A map from the command that was sent to the one that acts: an amplifier with a bent characteristic."""

    id = "motor.map"
    place = "actuator"
    law = "command"
    of, kind, unit = "command", "command that acts", "command"
    rivals = ("motor.deadzone", "motor.saturation")
    contains = ("motor.deadzone", "motor.saturation")
    at_its_joint = ("load.constant",)  # one that shifts all commands alike

    def table(self, evidence: Evidence) -> tuple[Array, Array] | None:
        """The unexplained force by command, in commands."""
        gain = _gain(evidence.model, evidence.at)
        if not gain or not len(evidence.command) or np.ptp(evidence.command) == 0:
            return None
        beside = [evidence.velocity, evidence.direction]
        knots, more = grow(
            evidence.command, evidence.force / gain, np.ones_like(evidence.force), beside, evidence.time, evidence.width
        )
        return knots, knots + more

    def sentence(self, at: str, values: Values, unit: Mapping[str, str]) -> str:
        """In words."""
        off = np.subtract(self.values(values), self.knots)
        k = int(np.argmax(np.abs(off)))
        name = unit[self.parameters[0].name]
        acts = f"{self.knots[k]:.3g} acts as {self.knots[k] + off[k]:.3g} {name}".strip()
        return f"{at} does not act in proportion to its command: {acts}."


def _gain(model: mujoco.MjModel, actuator: str) -> float:
    """Force at the joint for each unit of command, at rest."""
    joint, data = joint_of(model, actuator), mujoco.MjData(model)
    if joint is None:
        return 0.0
    data.ctrl[int(model.actuator_ctrladr[model.actuator(actuator).id])] = 1.0
    mujoco.mj_forward(model, data)
    with_command = float(data.qfrc_actuator[dof(model, joint)])
    data.ctrl[:] = 0
    mujoco.mj_forward(model, data)
    return with_command - float(data.qfrc_actuator[dof(model, joint)])
