"""What a window begins with that no sensor shows, where that remembers longer than any warm-up lasts.

A spring that yields keeps its rest until it is bent as far the other way; a load that swings, swings on for seconds,
and a spring that creeps takes as long. All follow from how the joints moved before: one pass over the whole recording
gives what they are at each window's start, as it does for the heat of a winding. A recording is taken to begin with
springs unbent and loads at rest.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from dipc_gym import mjcf
from dipc_gym.physics import Physics
from dipc_gym.sim2real.simulation.motion import Motion
from dipc_gym.sim2real.simulation.operators import play, swing

Array = NDArray[np.float64]


def yielding(model: mujoco.MjModel) -> list[int]:
    """Tendons whose springs yield, in the order in which the engine has their rests."""
    return [int(t) for t in np.flatnonzero(model.tendon_plasticadr >= 0)]


def along(model: mujoco.MjModel, tendon: int) -> list[tuple[int, float]]:
    """Degrees of freedom of a fixed tendon, and its coefficients."""
    first = int(model.tendon_adr[tendon])
    span = range(first, first + int(model.tendon_num[tendon]))
    return [(int(model.jnt_dofadr[model.wrap_objid[w]]), float(model.wrap_prm[w])) for w in span]


def bends(variants: Sequence[Physics], tendon: int, motion: Motion, time: Array) -> Array:
    """How far a spring that yields is bent, at times within a recording.

    Args:
        variants: one model with different parameters.
        tendon: a fixed one.
        motion: of the base joints.
        time: s, (n,).

    Returns:
        m or rad, (variants, n).
    """
    model = variants[0].model
    at = [int(model.joint(name).dofadr[0]) for name in mjcf.base_joints(model)]
    length, wanted = np.zeros(len(motion.time)), np.zeros(len(time))
    for joint, coefficient in along(model, tendon):
        if joint in at:  # what hides behind a gap is where its leader is, but for the gap
            q = motion.position[:, at.index(joint)]
            length += coefficient * q
            wanted += coefficient * np.interp(time, motion.time, q)
    stamps = np.concatenate([motion.time, time])
    order = np.argsort(stamps, kind="stable")
    bears = np.array([v.model.tendon_springyield[tendon] for v in variants])
    unbent = np.array([v.model.tendon_lengthspring[tendon, 0] for v in variants])
    rest = np.empty((len(stamps), len(variants)))
    rest[order] = play(np.concatenate([length, wanted])[order], bears, unbent)
    return np.ascontiguousarray((wanted[:, None] - rest[len(motion.time) :]).T)


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


def swings(variants: Sequence[Physics], load: Load, joint: int, motion: Motion, time: Array) -> Array:
    """Where a load is against the joint that it hangs on, and how fast, at times within a recording.

    Args:
        variants: one model with different parameters.
        load: the load.
        joint: that it hangs on, among the base joints.
        motion: of them.
        time: s, (n,).

    Returns:
        m or rad, then m/s or rad/s, (2, variants, n).
    """
    out = np.empty((2, len(variants), len(time)))
    known: dict[tuple[float, float, float], Array] = {}
    for v, variant in enumerate(variants):
        rates = load.rates(variant.model)
        if rates not in known:
            moved = motion.position[:, joint], motion.velocity[:, joint], motion.time
            pull, drag, ground = rates
            known[rates] = swing(pull, drag, *moved, time, ground=ground)
        out[:, v] = known[rates]
    return out
