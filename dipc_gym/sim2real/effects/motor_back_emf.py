"""Turning, the motor brakes itself."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import mujoco
import numpy as np

from dipc_gym.mjcf.edit import Document
from dipc_gym.sim2real.effects.shared.base import Effect, Evidence, Parameter, Values, dof, is_dcmotor, joint_of


class BackEmf(Effect):
    """Back-EMF of a voltage-driven motor that the model takes for a source of force."""

    id = "motor.back_emf"
    place = "actuator"
    linear = ("coefficient",)
    parameters = (Parameter("coefficient", "N s/m", 0.0),)
    rivals = ("friction.viscous", "motor.saturation")

    def fits(self, model: mujoco.MjModel, at: str) -> bool:
        """On an actuator that is no DC motor, at a joint without damping (else that parameter is refitted)."""
        joint = joint_of(model, at)
        return (
            not is_dcmotor(model, at)
            and joint is not None
            and bool(np.ravel(model.dof_damping[dof(model, joint)])[0] == 0)
        )

    def guesses(self, evidence: Evidence) -> Sequence[Values]:
        """The part of the unexplained force in proportion to speed."""
        (c,) = evidence.along(-evidence.velocity)
        typical = evidence.force_scale / evidence.speed_scale
        return [{"coefficient": float(np.clip(c, 0.05 * typical, 2 * typical))}]

    def edit(self, document: Document, at: str, values: Values) -> None:
        """Damping of the actuator beside what it has, which MuJoCo multiplies by the gear squared."""
        actuator = document.actuator(at)
        gear = float(document.effective(actuator, "gear", "1").split()[0])
        own, *others = document.effective(actuator, "damping", "0").split()
        document.set(actuator, damping=[float(own) + values["coefficient"] / gear**2, *map(float, others)])

    def sentence(self, at: str, values: Values, unit: Mapping[str, str]) -> str:
        """In words."""
        return f"Back-EMF of {at}: it brakes with {values['coefficient']:.3g} {unit['coefficient']}."
