"""Where on a body a mass would sit that pulls at all joints most like an unexplained force.

The force that a point mass asks of the joints is linear in ten numbers: one, its place on the body, and the products of
that with itself (Atkeson, An and Hollerbach 1986). So one look at the motion tells what any place would do.
"""

from __future__ import annotations

import itertools

import mujoco
import numpy as np
from numpy.typing import NDArray

from dipc_gym import mjcf
from dipc_gym.sim2real.effects.shared.base import Evidence
from dipc_gym.sim2real.effects.shared.coupling import base_inertia
from dipc_gym.sim2real.effects.shared.smoothing import smoothing

Array = NDArray[np.float64]

MOMENTS = 250  # of the motion that are looked at: more would say the same
SIDE = 9  # places along each axis that are looked at first
LEAST = 0.1  # share of the unexplained force that a mass has to take to be simulated
HALVINGS = 6  # of the distance between them, around the best ones
PRODUCTS = tuple(itertools.combinations_with_replacement(range(3), 2))  # of a place's coordinates

_CROSS = np.zeros((3, 3, 3))  # of two vectors: (a x b)_i is the sum of _CROSS[i, j, k] a_j b_k
for _i, _j, _k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
    _CROSS[_i, _j, _k], _CROSS[_i, _k, _j] = 1.0, -1.0


def seat(evidence: Evidence, body: int, axes: list[int], reach: float) -> list[tuple[float, Array]]:
    """The mass, kg, and its place in the body's frame, (3,) m, that explain most of the force; none if it takes so
    little of it that a simulation would tell nothing.

    Args:
        evidence: of a joint of the body, with the motion of all joints.
        body: of the model.
        axes: of its frame along which a place is looked for; along others it is that of the centre of mass.
        reach: m to either side of the centre of mass that it is looked for.
    """
    asked, force = _asked_of_joints(evidence, body)
    normal = np.einsum("nji,njk->ik", asked, asked)
    right = np.einsum("nji,nj->i", asked, force)
    place, near, steps = evidence.model.body_ipos[body], reach, np.linspace(-1, 1, SIDE)
    for _ in range(1 + HALVINGS):
        around = np.tile(place, (len(steps) ** len(axes), 1))
        around[:, axes] += near * np.array(list(itertools.product(steps, repeat=len(axes))))
        place = around[np.argmax(_told(around, normal, right)[0])]
        near, steps = near / (SIDE - 1) if len(steps) == SIDE else near / 2, np.array([-1.0, 0.0, 1.0])
    gain, mass = _told(place[None], normal, right)
    return [(float(mass[0]), place)] if gain[0] > LEAST * float(np.sum(force**2)) else []


def _told(places: Array, normal: Array, right: Array) -> tuple[Array, Array]:
    """How much of the force a mass at each place (k, 3) explains, and its mass, (k,) each."""
    products = np.stack([places[:, i] * places[:, j] for i, j in PRODUCTS], axis=1)
    shapes = np.concatenate([np.ones((len(places), 1)), places, products], axis=1)
    along = shapes @ right
    mass = np.maximum(along, 0.0) / np.maximum(np.einsum("ki,ij,kj->k", shapes, normal, shapes), 1e-300)
    return mass * along, mass


def _asked_of_joints(evidence: Evidence, body: int) -> tuple[Array, Array]:
    """What a kilogram asks of the base joints for each of the ten numbers of its place, (m, nb, 10), and what is
    unexplained there, (m, nb); both as accelerations, of which joints of any kind and size have some.
    """
    model, together = evidence.model, evidence.together
    assert together is not None
    out, ease = mjcf.spread_out(model), np.linalg.inv(base_inertia(model))
    mean = smoothing(evidence.time, evidence.width)
    mean = mean[:: max(1, mean.shape[0] // MOMENTS)]
    moved = np.concatenate(
        [np.gradient(together.velocity[run], evidence.time[run], axis=0) for run in evidence.runs], axis=0
    )
    force = mean @ together.force
    # As it moved, and not as the model foretells, which a load that outweighs a small link would be far from: so widely
    # smoothed, encoders' noise is a hundredth of the force.
    positions, velocities, accelerations = (
        each @ out.T for each in (mean @ together.position, mean @ together.velocity, mean @ moved)
    )
    data, count = mujoco.MjData(model), len(force)
    axes, moves, turns = np.empty((count, 3, 3)), *np.empty((2, count, 3, model.nv))
    moving, turning = np.empty((2, 3, model.nv))
    pulls, spins, swings = np.empty((3, count, 3))
    for n in range(count):
        data.qpos[:], data.qvel[:] = positions[n], velocities[n]
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_comVel(model, data)
        point = data.xpos[body]
        mujoco.mj_jac(model, data, moves[n], turns[n], point, body)
        mujoco.mj_jacDot(model, data, moving, turning, point, body)
        axes[n] = data.xmat[body].reshape(3, 3)
        pulls[n] = moves[n] @ accelerations[n] + moving @ velocities[n] - model.opt.gravity
        spins[n], swings[n] = turns[n] @ velocities[n], turns[n] @ accelerations[n] + turning @ velocities[n]
    # In the body's directions, and as seen from the base joints.
    pulls, spins, swings = (np.einsum("nij,ni->nj", axes, x) for x in (pulls, spins, swings))
    forces, moments = (np.einsum("bv,nkv,nki->nbi", ease @ out.T, x, axes) for x in (moves, turns))
    spin = np.einsum("iaj,na->nij", _CROSS, spins)
    swing = np.einsum("iaj,na->nij", _CROSS, swings) + spin @ spin
    at_origin = np.einsum("nbi,ni->nb", forces, pulls)[..., None]
    # A place p turns the pull on it into a moment, p x pull, and is pulled by how the body turns, swing p.
    by_place = forces @ swing + np.einsum("nbi,ikj,nj->nbk", moments, _CROSS, pulls)
    by_products = np.einsum("nbi,ikj,njl->nbkl", moments, _CROSS, swing)
    products = [by_products[..., i, k] + (by_products[..., k, i] if i != k else 0.0) for i, k in PRODUCTS]
    asked = np.concatenate([at_origin, by_place, np.stack(products, axis=-1)], axis=-1)
    return asked, -force @ ease  # what a model without it lacks is what would hold it
