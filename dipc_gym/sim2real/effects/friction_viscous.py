"""Friction in proportion to speed, where the model has none."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import mujoco
import numpy as np

from dipc_gym.mjcf.edit import Document
from dipc_gym.sim2real.effects.shared.base import Effect, Evidence, Form, Parameter, Values, dof, passive_ramp

LARGE = 1e9  # N or N m


class Viscous(Effect):
    """Viscous friction; a model that has some already gets its parameter refitted instead."""

    id = "friction.viscous"
    place = "joint"
    linear = ("coefficient",)
    parameters = (Parameter("coefficient", "N s/m", 0.0),)
    rivals = ("motor.back_emf", "drag.quadratic", "friction.coulomb")
    element = "damping of the joint"

    def forms(self) -> Sequence[Form]:
        """The force of a passive actuator, which the integrator may treat otherwise than the damping of a joint."""
        return (ByActuator(),)

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
        others = document.effective(joint, "damping").split()[1:]
        document.set(joint, damping=" ".join([repr(float(values["coefficient"])), *others]))

    def sentence(self, at: str, values: Values, unit: Mapping[str, str]) -> str:
        """In words."""
        return f"Viscous friction of {values['coefficient']:.3g} {unit['coefficient']} at {at}."


class ByActuator(Form, Viscous):
    """Viscous friction, written as the force of an actuator: Euler's method takes it as it is when a step begins."""

    id = "friction.viscous:actuator"
    element = "the force of a passive actuator"

    def edit(self, document: Document, at: str, values: Values) -> None:
        """A passive force in proportion to speed, without limits that it would reach."""
        passive_ramp(document, f"{at}_drag", at, (0.0, 0.0, -values["coefficient"]), (-LARGE, LARGE))
