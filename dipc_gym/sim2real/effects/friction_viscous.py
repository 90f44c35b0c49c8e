"""Friction in proportion to speed, where the model has none."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import mujoco
import numpy as np

from dipc_gym.mjcf.edit import Document
from dipc_gym.sim2real.effects.base import Effect, Evidence, Parameter, Values, dof


class Viscous(Effect):
    """Viscous friction; a model that has some already gets its parameter refitted instead."""

    id = "friction.viscous"
    place = "joint"
    linear = ("coefficient",)
    parameters = (Parameter("coefficient", "N s/m", 0.0),)
    rivals = ("motor.back_emf", "drag.quadratic", "friction.coulomb")

    def fits(self, model: mujoco.MjModel, at: str) -> bool:
        """Where the model has no damping."""
        return bool(np.ravel(model.dof_damping[dof(model, at)])[0] == 0)

    def guesses(self, evidence: Evidence) -> Sequence[Values]:
        """The part of the unexplained force in proportion to speed."""
        (c,) = evidence.along(-evidence.velocity)
        typical = evidence.force_scale / evidence.speed_scale
        return [{"coefficient": float(np.clip(c, 0.05 * typical, 2 * typical))}]

    def edit(self, document: Document, at: str, values: Values) -> None:
        """Damping of the joint."""
        joint = document.joint(at)
        rest = document.effective(joint, "damping").split()[1:]
        document.set(joint, damping=" ".join([repr(float(values["coefficient"])), *rest]))

    def sentence(self, at: str, values: Values, unit: Mapping[str, str]) -> str:
        """In words."""
        return f"Viscous friction of {values['coefficient']:.3g} {unit['coefficient']} at {at}."
