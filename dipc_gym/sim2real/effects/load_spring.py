"""A spring."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import mujoco
import numpy as np

from dipc_gym.mjcf.edit import Document
from dipc_gym.sim2real.effects.shared.base import Effect, Evidence, Parameter, Values


class Spring(Effect):
    """A spring between a joint and the frame: a cable that bends, a hose, a cover that stretches."""

    id = "load.spring"
    place = "joint"
    parameters = (Parameter("stiffness", "N/m", 0.0), Parameter("rest", "m"))
    rivals = ("load.position", "load.constant", "friction.position")
    contains = ("load.constant",)

    def fits(self, model: mujoco.MjModel, at: str) -> bool:
        """Where the model has no spring yet."""
        own = model.joint(at).id
        return not (np.any(model.jnt_stiffness[own]) or np.any(model.jnt_stiffnesspoly[own]))

    def guesses(self, evidence: Evidence) -> Sequence[Values]:
        """The part of the unexplained force in proportion to position."""
        centre = float(np.mean(evidence.position))
        reach = max(float(np.std(evidence.position)), 1e-9)
        k, _ = evidence.along(-(evidence.position - centre), -evidence.velocity)
        typical = evidence.force_scale / reach
        k = float(np.clip(k, 0.05 * typical, 2 * typical))
        unbent = float(np.clip(centre + np.mean(evidence.force) / k, centre - 3 * reach, centre + 3 * reach))
        return [{"stiffness": k, "rest": unbent if abs(unbent) > 0.1 * reach else 0.1 * reach}]

    def edit(self, document: Document, at: str, values: Values) -> None:
        """Stiffness and rest position of the joint."""
        joint = document.joint(at)
        document.set(joint, stiffness=values["stiffness"], springref=document.angle(joint, values["rest"]))

    def sentence(self, at: str, values: Values, unit: Mapping[str, str]) -> str:
        """In words."""
        return (
            f"A spring of {values['stiffness']:.3g} {unit['stiffness']} at {at}, at rest at "
            f"{values['rest']:.3g} {unit['rest']}."
        )
