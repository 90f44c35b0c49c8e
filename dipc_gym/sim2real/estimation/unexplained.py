"""Gather what is known at each place before anything is fitted there."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from dipc_gym import mjcf
from dipc_gym.mjcf.model import base_joints
from dipc_gym.physics import Physics
from dipc_gym.recording import Recording
from dipc_gym.sim2real.effects.shared.base import (
    Effect,
    Evidence,
    Misread,
    Place,
    Together,
    joint_of,
    rms,
    sensed_joint,
)
from dipc_gym.sim2real.effects.shared.coupling import base_inertia, inertia_at
from dipc_gym.sim2real.effects.shared.smoothing import width_for
from dipc_gym.sim2real.estimation.fit import Fit
from dipc_gym.sim2real.estimation.settings import ESTIMATION
from dipc_gym.sim2real.estimation.states import acting, straightened, unexplained_force
from dipc_gym.sim2real.simulation.motion import Motion
from dipc_gym.sim2real.simulation.windows import Windows

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Scene:
    """Motion and unexplained force over all recordings.

    Attributes:
        model: whose force is lacking.
        recordings: what was measured.
        time: s, (n,), beginning anew with each recording.
        position: of each joint, (n, nq).
        velocity: (n, nv).
        force: unexplained generalised force, (n, nv).
        load: that each joint transmits, (n, nv).
        resisting: force of the model's dry friction, (n, nv).
        noise: that encoders leave in the force for each second squared, kg m or kg m^2 rad, (nv,).
        outliers: times at which outlier windows begin, the worst first, s.
        fitted: the windows of the fit, and the fit, whose model leaves that force.
    """

    model: mujoco.MjModel
    recordings: tuple[Recording, ...]
    time: Array
    position: Array
    velocity: Array
    force: Array
    load: Array
    resisting: Array
    noise: Array
    outliers: tuple[float, ...] = ()
    fitted: tuple[Windows, Fit] | None = None

    def at(self, place: Place, name: str, levels: dict[str, float]) -> Evidence:
        """The evidence at one place; a sensor's or actuator's joint stands for it.

        Args:
            place: kind of place.
            name: of the joint, actuator or sensor; anything for the world.
            levels: dry friction that the structure has at joints.
        """
        joint, command, reading, gear, goes = name, np.zeros(0), np.zeros(0), 0.0, 1.0
        if place == "actuator":
            joint = joint_of(self.model, name) or ""
            k = self.recordings[0].actuator_names.index(name)
            command = self._commands[:, k]
            gear = float(self.model.actuator(name).gear[0])
        elif place == "sensor":
            joint = sensed_joint(self.model, name) or ""
            k = self.recordings[0].sensor_names.index(name)
            reading = np.concatenate([r.sensors[:, k] for r in self.recordings])
        joint = mjcf.followers(self.model).get(joint, joint)  # a rotor stands for the joint that it drives
        if joint not in self._joints:  # it goes so many times as far as the one that leads it
            joint, goes = mjcf.coupled(self.model).get(joint, (joint, goes))
        if joint not in self._joints:
            power = np.sqrt(np.mean(self.force**2, axis=0)) / (np.sqrt(np.mean(self.load**2, axis=0)) + 1e-12)
            joint = self._joints[int(np.argmax(power))]
        j = self._joints.index(joint)
        period = min(r.period for r in self.recordings)
        return Evidence(
            self.model,
            self.force[:, j] / goes,
            self.velocity[:, j] * goes,
            self.position[:, j] * goes,
            self.load[:, j] / goes,
            self.time,
            command,
            reading,
            gear,
            inertia_at(self.model, joint) / goes**2,
            period,
            levels.get(joint),
            name,
            self.outliers,
            self._inputs,
            self._misread(name) if place == "sensor" else None,
            width_for(rms(self.force[:, j]), float(self.noise[j]), period),
            self.resisting[:, j] / goes,
            Together(self.position, self.velocity, self.force),
        )

    def _misread(self, sensor: str) -> Misread | None:
        """What the windows of the fit leave of a sensor; None where their residuals are not at hand."""
        if self.fitted is None or not self.fitted[1].whole:
            return None
        windows, fit = self.fitted
        k = windows.recordings[0].sensor_names.index(sensor)
        if not np.isfinite(windows.noise[k]):
            return None
        count, sensors = windows.observed.shape[1:]
        Q, _ = np.linalg.qr(fit.sensitivity)
        straight = straightened(fit.structure.physics(fit.z), windows.observed)
        return Misread(
            windows.start[:, None] + windows.times,
            windows.observed[..., k],
            (windows.observed - straight)[..., k],
            fit.left,
            Q,
            np.arange(count) * sensors + k,
            windows.valid / windows.noise[k],
        )

    @functools.cached_property
    def _commands(self) -> Array:
        """Commands (n, nu) as actuators take them around each sample: a log may hold more."""
        sent = np.concatenate([acting(np.zeros(r.commands.shape[1]), r) for r in self.recordings])
        low, high = (end[: sent.shape[1]] for end in mjcf.command_ranges(self.model))
        return np.clip(sent, low, high)

    @functools.cached_property
    def _inputs(self) -> dict[str, Array]:
        """Whatever a law of no kind may depend on."""
        found = {f"position {joint}": self.position[:, j] for j, joint in enumerate(self._joints)}
        found |= {f"velocity {joint}": self.velocity[:, j] for j, joint in enumerate(self._joints)}
        if not self.model.actuator_delay.any():
            found |= {
                f"command {name}": self._commands[:, k] for k, name in enumerate(self.recordings[0].actuator_names)
            }
        return found

    @property
    def _joints(self) -> list[str]:
        return list(base_joints(self.model))


def scene(physics: Physics, recordings: Sequence[Recording], motions: Sequence[Motion]) -> Scene:
    """What a model leaves unexplained.

    Args:
        physics: the model.
        recordings: what was measured.
        motions: of the joints.
    """
    model = physics.model
    parts = []
    for recording, motion in zip(recordings, motions, strict=True):
        forces = unexplained_force(physics, recording, motion)
        parts.append((recording.time, motion.position, motion.velocity, *forces))
    time, position, velocity, force, load, resisting = (np.concatenate(part) for part in zip(*parts, strict=True))
    noise = np.hypot.reduce(base_inertia(model) * np.max([motion.noise for motion in motions], axis=0), axis=1)
    return Scene(model, tuple(recordings), time, position, velocity, force, load, resisting, noise)


def _index(recording: Recording, share: float) -> int:
    """The first sample at or after a share of a recording's duration; with all of it, one past the last."""
    if share >= 1.0:
        return len(recording)
    return int(np.searchsorted(recording.time, recording.time[0] + share * recording.duration))


def force_errors(
    physics: Physics, recordings: Sequence[Recording], motions: Sequence[Motion], span: tuple[float, float]
) -> Array:
    """Error of the inverse model at each base joint, relative to the force that the joint transmits, (nb,).

    NaN at a joint that transmits none, as of a puck that coasts. Identification by inverse dynamics (Janot, Gautier
    and Brunot 2019 for one) judges itself by this number. Force and error are averaged over stretches of 25 ms first,
    as its filters do: no acceleration is known faster than that.

    Args:
        physics: the model.
        recordings: what was measured.
        motions: of the joints.
        span: the part of each recording to judge, as fractions of its length.
    """
    lacking: list[Array] = []
    transmitted: list[Array] = []
    for recording, motion in zip(recordings, motions, strict=True):
        force, load, _ = unexplained_force(physics, recording, motion)
        low, high = (_index(recording, x) for x in span)
        mean = max(1, round(ESTIMATION.averaged / recording.period))
        count = (high - low) // mean
        for kept, values in ((lacking, force), (transmitted, load)):
            kept.append(values[low : low + count * mean].reshape(count, mean, values.shape[1]).mean(axis=1))
    size = np.linalg.norm(np.concatenate(transmitted), axis=0)
    return np.asarray(np.linalg.norm(np.concatenate(lacking), axis=0) / np.where(size > 0, size, np.nan))


def force_in_windows(physics: Physics, windows: Windows) -> Array:
    """Mean square of the unexplained force in each window and at each base joint, (n, nb), N^2 or (N m)^2.

    Averaged over stretches of 25 ms first, see `force_errors`.

    Args:
        physics: the model.
        windows: with the motions of their recordings.
    """
    found = np.zeros((len(windows), windows.motions[0].position.shape[1]))
    for i, (recording, motion) in enumerate(zip(windows.recordings, windows.motions, strict=True)):
        own = np.flatnonzero(windows.source == i)
        if not len(own):
            continue
        force, _, _ = unexplained_force(physics, recording, motion)
        mean = max(1, round(ESTIMATION.averaged / recording.period))
        firsts = np.searchsorted(recording.time, windows.start[own] - 1e-9)
        for k, first, samples in zip(own, firsts, windows.valid[own].sum(axis=1), strict=True):
            each = min(mean, samples)
            kept = force[first : first + samples // each * each].reshape(-1, each, force.shape[1])
            found[k] = np.mean(kept.mean(axis=1) ** 2, axis=0)
    return found


def places(effect: Effect, model: mujoco.MjModel, joints: Sequence[str], recording: Recording) -> list[str]:
    """Names of the places at which an effect may be missing."""
    names: dict[Place, list[str]] = {
        "joint": list(joints),
        # One with several inputs is no such place: which of them is late or limited would have to be said as well.
        "actuator": [
            n for n in recording.actuator_names if mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_ACTUATOR, n) >= 0
        ],
        "sensor": list(recording.sensor_names),
        "world": ["world"],
    }
    return [name for name in names[effect.place] if effect.fits(model, name)]
