"""Dry friction that grows with the load."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import mujoco
import numpy as np

from dipc_gym.mjcf.edit import Document
from dipc_gym.sim2real.effects.shared.base import Effect, Evidence, Parameter, Values, dry_beside


class UnderLoad(Effect):
    """Friction of a gearbox or bearing that grows with what it carries: level + by_drive |drive| + by_weight |weight|.

    The drive is the actuator's force, the weight what gravity and the motion of other joints ask of the joint: a gear
    is loaded from both sides, as in the servo models of Duclusaud et al. (BAM, 2024).
    """

    id = "friction.load"
    place = "joint"
    one_of = "dry friction"
    parameters = (
        Parameter("level", "N", 0.0),
        Parameter("by_drive", "", 0.0, 2.0),
        Parameter("by_weight", "", 0.0, 2.0),
    )
    levels = ("level",)
    rivals = ("friction.coulomb", "friction.position", "friction.viscous")
    contains = ("friction.coulomb",)
    needs_loader = True

    def guesses(self, evidence: Evidence) -> Sequence[Values]:
        """Dry friction, three tenths of it in proportion to load; and as the unexplained force has it."""
        share = 0.3
        typical = max(float(np.mean(np.abs(evidence.load))), 1e-12)
        level = evidence.dry_level
        part = min(share * level / typical, 0.5)
        loaded = -evidence.direction * np.abs(evidence.load)
        seen, more, _ = evidence.along(loaded, -evidence.direction, -evidence.velocity)
        seen, more = float(np.clip(seen, 0.02, 0.5)), max((evidence.level or 0.0) + float(more), 0.1 * level)
        weighs = _weighs(evidence.model, evidence.at)
        return [
            {"level": (1 - share) * level, "by_drive": part, "by_weight": weighs * part},
            {"level": more, "by_drive": seen, "by_weight": weighs * seen},
        ]

    def edit(self, document: Document, at: str, values: Values) -> None:
        """An entry for the loader; stock MuJoCo gets the level without load."""
        dry_beside(document, at, values["level"])
        document.custom(self.id, at, [values["level"], values["by_drive"], values["by_weight"]])

    def sentence(self, at: str, values: Values, unit: Mapping[str, str]) -> str:
        """In words."""
        parts = [f"{values['level']:.3g} {unit['level']}"] if values["level"] > 0 else []
        parts += [
            f"{100 * values[name]:.3g} % of the {what}"
            for name, what in (("by_drive", "drive"), ("by_weight", "weight"))
            if values[name] > 0
        ]
        return f"Friction at {at} that grows with load: {' and '.join(parts) or 'nothing'}."


def _weighs(model: mujoco.MjModel, joint: str) -> bool:
    """Whether anything but a drive loads a joint: gravity, or what hangs on it."""
    data, dof = mujoco.MjData(model), int(model.joint(joint).dofadr[0])
    loads = []
    for position in (0.0, 0.7, 2.0):
        data.qpos[:], data.qvel[:] = position, 1.0
        mujoco.mj_forward(model, data)
        loads.append(abs(float(data.qfrc_bias[dof])))
    return max(loads) > 1e-9
