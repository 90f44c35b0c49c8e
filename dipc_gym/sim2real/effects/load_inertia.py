"""Inertia that moves with a joint alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import mujoco
import numpy as np

from dipc_gym.mjcf.edit import Document
from dipc_gym.sim2real.effects.shared.base import Effect, Evidence, Parameter, Values, dof

LEAST, MOST = 0.02, 2.0  # of the first guess, times what the joint moves: a gear of 100 makes a rotor heavy


class Inertia(Effect):
    """The inertia of what turns with a joint and has no weight there: a rotor behind its gear, a flywheel.

    Seen from the joint, a rotor has its inertia times the square of the gear ratio, often more than the link that it
    turns; models made from drawings leave it out.
    """

    id = "load.inertia"
    place = "joint"
    parameters = (Parameter("inertia", "kg", 0.0),)
    rivals = ("load.payload", "transmission.compliance", "load.swinging", "motor.inductance", "timing.delay")
    shown_by = "fast reversals in postures in which the joint carries little, and in others in which it carries much"

    def fits(self, model: mujoco.MjModel, at: str) -> bool:
        """Where the model has none yet, neither of the joint nor of a motor."""
        joint = model.joint(at).id
        by = int(model.jnt_actuatorid[joint])
        return bool(model.dof_armature[dof(model, at)] == 0 and (by < 0 or model.actuator_armature[by] == 0))

    def guesses(self, evidence: Evidence) -> Sequence[Values]:
        """The part of the unexplained force that opposes acceleration."""
        inertia, _ = evidence.along(-evidence.foretold, -evidence.velocity)
        return [{"inertia": float(np.clip(inertia, LEAST * evidence.inertia, MOST * evidence.inertia))}]

    def edit(self, document: Document, at: str, values: Values) -> None:
        """More armature of the joint; what swings on its own, or a rotor behind a soft coupling, has taken some out."""
        joint = document.joint(at)
        document.set(joint, armature=float(document.effective(joint, "armature", "0")) + values["inertia"])

    def sentence(self, at: str, values: Values, unit: Mapping[str, str]) -> str:
        """In words."""
        return (
            f"An inertia of {values['inertia']:.3g} {unit['inertia']} that moves with {at} alone, as a motor's rotor "
            "behind its gear (armature)."
        )
