"""Drag in proportion to the square of speed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import mujoco
import numpy as np

from dipc_gym.mjcf.edit import Document
from dipc_gym.sim2real.effects.shared.base import Effect, Evidence, Parameter, Values, dof


class Quadratic(Effect):
    """Air or fluid drag, coefficient v |v|."""

    id = "drag.quadratic"
    place = "joint"
    linear = ("coefficient",)
    parameters = (Parameter("coefficient", "N s^2/m^2", 0.0),)
    rivals = ("friction.viscous", "friction.coulomb")

    def guesses(self, evidence: Evidence) -> Sequence[Values]:
        """The part of the unexplained force in proportion to the square of speed, and what the model has."""
        c, _ = evidence.along(-evidence.velocity * np.abs(evidence.velocity), -evidence.velocity)
        typical = evidence.force_scale / evidence.speed_scale**2
        own = self.own(evidence.model, evidence.at)
        return [{"coefficient": own + float(np.clip(c, 0.1 * typical, 5 * typical))}]

    def own(self, model: mujoco.MjModel, at: str) -> float:
        """The second coefficient of the joint's damping."""
        return float(np.ravel(model.dof_dampingpoly[dof(model, at)])[0])

    def edit(self, document: Document, at: str, values: Values) -> None:
        """Second coefficient of the joint's damping."""
        joint = document.joint(at)
        damping = [*document.effective(joint, "damping", "0").split(), "0", "0", "0"][:3]
        damping[1] = repr(float(values["coefficient"]))
        document.set(joint, damping=" ".join(damping))

    def sentence(self, at: str, values: Values, unit: Mapping[str, str]) -> str:
        """In words."""
        return f"Drag that grows with the square of speed, {values['coefficient']:.3g} {unit['coefficient']}, at {at}."
