"""Springs that yield and loads that swing: where a model has them, which nothing but its motion before tells of."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from dipc_gym import mjcf


def yielding(model: mujoco.MjModel) -> list[int]:
    """Tendons whose springs yield, in the order of their states in the engine."""
    return [int(t) for t in np.flatnonzero(model.tendon_plasticadr >= 0)]


def along(model: mujoco.MjModel, tendon: int) -> list[tuple[int, float]]:
    """Degrees of freedom of a fixed tendon, and its coefficients."""
    first = int(model.tendon_adr[tendon])
    span = range(first, first + int(model.tendon_num[tendon]))
    return [(int(model.jnt_dofadr[model.wrap_objid[w]]), float(model.wrap_prm[w])) for w in span]


@dataclass(frozen=True)
class Load:
    """A joint that swings on a spring against another one, or creeps after it, driven by nothing else.

    Attributes:
        at: its degree of freedom.
        tendon: the spring between them.
    """

    at: int
    tendon: int

    def rates(self, model: mujoco.MjModel) -> tuple[float, float, float]:
        """Stiffness, damping against the other joint, and damping of its own, per inertia: 1/s^2, 1/s and 1/s."""
        data, full = mujoco.MjData(model), np.zeros((model.nv, model.nv))
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fullM(model, data, full)
        inertia = max(float(full[self.at, self.at]), 1e-300)
        stiffness, damping = float(model.tendon_stiffness[self.tendon]), float(model.tendon_damping[self.tendon])
        return stiffness / inertia, damping / inertia, float(model.dof_damping[self.at]) / inertia


def loads(model: mujoco.MjModel) -> dict[str, Load]:
    """Loads that swing, by name of their joints."""
    driven = {int(i) for k, i in enumerate(model.actuator_trnid[:, 0]) if model.actuator_trntype[k] == 0}
    found = {}
    for name, leader in mjcf.followers(model).items():
        at, lead = (int(model.joint(one).dofadr[0]) for one in (name, leader))
        between = [t for t in range(model.ntendon) if {joint for joint, _ in along(model, t)} == {at, lead}]
        springs = [t for t in between if model.tendon_stiffness[t] > 0 and not np.ptp(model.tendon_lengthspring[t])]
        if int(model.joint(name).id) not in driven and len(between) == len(springs) == 1:
            found[name] = Load(at, springs[0])
    return found
