"""Springs that yield and loads that swing: where a model has them, which nothing but its motion before tells of."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from dipc_gym import mjcf
from dipc_gym.engine.swing import Spring

ROUNDING = 1e-9  # of third powers that cancel each other


@dataclass(frozen=True)
class Load:
    """A joint that swings on springs against another one, or creeps after it, driven by nothing else.

    Attributes:
        at: its degree of freedom.
        tendons: the springs between them; one pulls at once, others where it is stretched by more than their slack.
    """

    at: int
    tendons: tuple[int, ...]

    def held(self, model: mujoco.MjModel) -> tuple[tuple[Spring, ...], float, float]:
        """What holds it, per inertia: springs, and damping against the other joint and of its own, 1/s."""
        inertia = max(float(model.dof_M0[self.at]), 1e-300)  # a leaf of the tree: the same wherever it is
        springs = tuple(
            Spring(
                float(np.ptp(model.tendon_lengthspring[t])) / 2,
                float(model.tendon_stiffness[t]) / inertia,
                float(model.tendon_stiffnesspoly[t, 1]) / inertia,
            )
            for t in self.tendons
        )
        damping = float(sum(model.tendon_damping[t] for t in self.tendons))
        return springs, damping / inertia, float(model.dof_damping[self.at]) / inertia


def loads(model: mujoco.MjModel) -> dict[str, Load]:
    """Loads that swing, by name of their joints."""
    driven = {int(i) for k, i in enumerate(model.actuator_trnid[:, 0]) if model.actuator_trntype[k] == 0}
    found = {}
    for name, leader in mjcf.followers(model).items():
        at, lead = (int(model.joint(one).dofadr[0]) for one in (name, leader))
        between = [t for t in range(model.ntendon) if {joint for joint, _ in mjcf.along(model, t)} == {at, lead}]
        # Springs that pull either way alike and never push, and dampers in proportion; one that pulls at all without
        # slack, and others that may do nothing.
        cubes = model.tendon_stiffnesspoly[between, 1]
        alike = not (
            np.any(model.tendon_lengthspring[between].sum(axis=1))
            or np.any(model.tendon_stiffnesspoly[between, 0])
            or np.any(model.tendon_dampingpoly[between])
            or np.any(model.dof_dampingpoly[at])
            or cubes.sum() < -ROUNDING * np.abs(cubes).sum()
        )
        taut = [t for t in between if model.tendon_stiffness[t] > 0 and not np.any(model.tendon_lengthspring[t])]
        if int(model.joint(name).id) not in driven and alike and len(taut) == 1:
            found[name] = Load(at, tuple(between))
    return found
