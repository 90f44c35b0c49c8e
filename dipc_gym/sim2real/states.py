"""Estimate the joints' motion from the sensors, and the force that the model does not explain.

These estimates propose: they start windows and first guesses, and they are drawn. What is decided is decided by
simulation, since differentiated encoder noise biases any regression on accelerations.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solveh_banded

from dipc_gym import mjcf
from dipc_gym.physics import Physics
from dipc_gym.sim2real.recording import Recording

Array = NDArray[np.float64]


class Undetermined(ValueError):
    """The sensors do not determine the joints, so there is no state to start a simulation from."""


@dataclass(frozen=True)
class Motion:
    """Smoothed motion of one recording.

    Attributes:
        time: s, (n,).
        position: of each joint, m or rad, (n, nq).
        velocity: m/s or rad/s, (n, nq).
        acceleration: m/s^2 or rad/s^2, (n, nq).
    """

    time: Array
    position: Array
    velocity: Array
    acceleration: Array

    def at(self, time: Array) -> Array:
        """Positions and velocities (..., 2 nq) at any time, linear between samples."""
        columns = [np.interp(time, self.time, c) for c in (*self.position.T, *self.velocity.T)]
        return np.stack(columns, axis=-1)


def sensor_map(model: mujoco.MjModel) -> tuple[Array, Array, Array]:
    """How the scalar sensors read positions and velocities: y = P q + V v + c.

    Returns:
        P (ns, nq), V (ns, nv), c (ns,).

    Raises:
        Undetermined: a sensor is not linear in them, or the position sensors leave a joint free.
    """
    data, address = mujoco.MjData(model), mjcf.sensor_addresses(model)
    rng = np.random.default_rng(0)

    def read(q: Array, v: Array) -> Array:
        data.qpos[:], data.qvel[:], data.ctrl[:] = q, v, 0
        mujoco.mj_forward(model, data)
        return data.sensordata[address].copy()

    nq = model.nq
    c = read(np.zeros(nq), np.zeros(nq))
    eye = np.eye(nq)
    P = np.stack([read(eye[j], np.zeros(nq)) - c for j in range(nq)], axis=1)
    V = np.stack([read(np.zeros(nq), eye[j]) - c for j in range(nq)], axis=1)
    names = mjcf.scalar_sensors(model)
    for _ in range(3):
        q, v = rng.normal(size=nq), rng.normal(size=nq)
        off = np.abs(read(q, v) - (P @ q + V @ v + c)) > 1e-6 * (1 + np.abs(P @ q) + np.abs(V @ v))
        if off.any():
            raise Undetermined(
                f"sensor {names[int(np.flatnonzero(off)[0])]!r} is not linear in joint positions and velocities; "
                "supported are jointpos, jointvel, tendonpos, tendonvel, actuatorpos and actuatorvel on fixed "
                "transmissions"
            )
    seen = P[~V.any(axis=1)]
    blind = np.linalg.matrix_rank(seen) < nq if len(seen) else True
    if blind:
        _, s, rows = np.linalg.svd(seen if len(seen) else np.zeros((1, nq)))
        free = rows[int((s > 1e-9).sum()) :]
        joints = [model.joint(j).name for j in range(model.njnt) if np.abs(free[:, j]).max() > 1e-6]
        raise Undetermined(
            f"no position sensor sees joint {', '.join(joints)}, so its state cannot be known; "
            "add a sensor for it to the recording, or lock the joint in the model"
        )
    return P, V, c


def estimate(recording: Recording, model: mujoco.MjModel, noise: Array) -> Motion:
    """Smooth the sensors and invert them to joints.

    Args:
        recording: with the model's sensors.
        model: says how the sensors read the joints.
        noise: standard deviation of each sensor, (ns,).

    Raises:
        Undetermined: as `sensor_map`.
    """
    P, V, c = sensor_map(model)
    positional = ~V.any(axis=1)
    smooth = [smoothed(recording.time, recording.sensors[:, s], noise[s]) for s in np.flatnonzero(positional)]
    weight = 1 / noise[positional]
    inverse = np.linalg.pinv(P[positional] * weight[:, None]) * weight
    position = (np.stack(smooth, axis=1) - c[positional]) @ inverse.T
    velocity = np.gradient(position, recording.time, axis=0, edge_order=2)
    acceleration = np.gradient(velocity, recording.time, axis=0, edge_order=2)
    return Motion(recording.time, position, velocity, acceleration)


def smoothed(time: Array, values: Array, noise: float) -> Array:
    """The smoothest curve (least integral of the squared third derivative) that leaves a residual of size `noise`.

    Args:
        time: s, (n,), irregular if need be.
        values: (n,).
        noise: standard deviation that the residual is to have.
    """
    n, scale = len(time), float(np.median(np.diff(time)))
    t = time / scale
    gaps = [t[j:] - t[: n - j] for j in range(4)]
    m = n - 3
    rows = np.zeros((4, m))  # third divided differences, times 3!
    for j in range(4):
        product = np.ones(m)
        for k in range(4):
            if k != j:
                lo, hi = min(j, k), max(j, k)
                gap = gaps[hi - lo][lo : lo + m]
                product = product * (gap if j > k else -gap)
        rows[j] = 6 / product
    rows *= np.sqrt(gaps[1][1 : 1 + m])
    roughness = np.zeros((4, n))
    for i in range(4):
        for j in range(i, 4):
            roughness[3 - (j - i), j : j + m] += rows[i] * rows[j]

    def solve(weight: float) -> Array:
        banded = weight * roughness
        banded[3] += 1
        return np.asarray(solveh_banded(banded, values))

    low, high = -6.0, 12.0
    for _ in range(18):
        middle = (low + high) / 2
        if np.std(values - solve(10**middle)) < noise:
            low = middle
        else:
            high = middle
    return solve(10**low)


def unexplained_force(physics: Physics, recording: Recording, motion: Motion) -> tuple[Array, Array]:
    """Generalised force that the motion needs beyond what the model gives, by inverse dynamics.

    Returns:
        The unexplained force (n, nv), N or N m, and the load that each joint transmits (n, nv).
    """
    model = physics.model
    data = mujoco.MjData(model)
    n = len(motion.time)
    commands = physics.command(recording.commands)
    rest, load = np.empty((n, model.nv)), np.empty((n, model.nv))
    nu = recording.commands.shape[1]
    for k in range(n):
        data.qpos[:], data.qvel[:] = motion.position[k], motion.velocity[k]
        data.ctrl[:nu] = commands[k]
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        mujoco.mj_fwdActuation(model, data)
        data.qacc[:] = motion.acceleration[k]
        mujoco.mj_inverse(model, data)
        rest[k] = data.qfrc_inverse - data.qfrc_actuator
        load[k] = data.qfrc_actuator + data.qfrc_bias
    return rest, load


def starts(motions: Sequence[Motion], source: NDArray[np.intp], time: Array) -> Array:
    """Start states (n, 2 nq) of windows that begin at `time` in the recordings `source`."""
    out = np.empty((len(time), 2 * motions[0].position.shape[1]))
    for i, motion in enumerate(motions):
        mine = source == i
        out[mine] = motion.at(time[mine])
    return out
