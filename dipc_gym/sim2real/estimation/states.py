"""Estimate the joints' motion from the sensors, and the force that the model does not explain.

These estimates propose: they give windows their initial states, and effects their first guesses; and they are drawn.
What is decided is decided by simulation, since differentiated encoder noise biases any regression on accelerations.
"""

from __future__ import annotations

import copy
import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid
from scipy.interpolate import CubicSpline
from scipy.linalg import solveh_banded

from dipc_gym import mjcf
from dipc_gym.physics import Extra, Moment, Physics
from dipc_gym.recording import Recording
from dipc_gym.recording.held import held_mean
from dipc_gym.sim2real.estimation.settings import ESTIMATION
from dipc_gym.sim2real.simulation.compiled import BESIDE
from dipc_gym.sim2real.simulation.memory import bends, memories
from dipc_gym.sim2real.simulation.motion import Motion

Array = NDArray[np.float64]


class Undetermined(ValueError):
    """The sensors do not determine the joints, so a simulation has no initial state.

    Attributes:
        reason: why, in words.
        mend: what to do, as a sentence.
    """

    def __init__(self, reason: str, mend: str) -> None:
        super().__init__(f"{reason}. {mend}")
        self.reason, self.mend = reason, mend


_AFFINE = frozenset({"sensor.gain", "sensor.bias"})  # what sensors do to readings, that a sensor map holds


def _bent(physics: Physics) -> dict[int, list[Extra]]:
    """What sensors whose scale is bent do to their readings, in order, by the address of the sensor."""
    does: dict[int, list[Extra]] = {}
    for extra in physics.stage("sensor"):
        does.setdefault(extra.index, []).append(extra)
    return {at: own for at, own in does.items() if any(extra.effect not in _AFFINE for extra in own)}


def straightened(physics: Physics, readings: Array) -> Array:
    """Readings (..., ns) of the scalar sensors, a bent scale's as a straight one would give them; see `sensor_map`."""
    out, addresses = readings.copy(), mjcf.sensor_addresses(physics.model)
    for at, does in _bent(physics).items():
        k = int(np.flatnonzero(addresses == at)[0])
        out[..., k] = _straight(does, readings[..., k])
    return out


def _straight(does: Sequence[Extra], reading: Array) -> Array:
    """What a sensor's reading (...) was before it was bent, by Newton's method."""

    def read(value: Array) -> Array:
        zero = np.zeros(())
        return functools.reduce(lambda y, extra: extra(Moment(zero, zero, zero, zero, y)), does, value)

    straight = reading
    for _ in range(ESTIMATION.newton):
        slope = (read(straight + BESIDE) - read(straight - BESIDE)) / (2 * BESIDE)
        straight = straight + (reading - read(straight)) / np.maximum(slope, ESTIMATION.least_slope)
    return straight


def sensor_map(physics: Physics) -> tuple[Array, Array, Array]:
    """How the scalar sensors read positions and velocities of the base joints: y = P q + V v + c.

    What the model's `<custom>` entries do to readings is in it, lags and delays excepted, and bent scales, which
    `straightened` takes out of readings.

    Returns:
        P (ns, nb), V (ns, nb), c (ns,).

    Raises:
        Undetermined: a sensor is not linear in them.
    """
    model = copy.copy(physics.model)
    model.sensor_delay[:] = 0
    bent = _bent(physics)
    straight = replace(physics, extras=tuple(x for x in physics.extras if x.stage != "sensor" or x.index not in bent))
    data, address = mujoco.MjData(model), mjcf.sensor_addresses(model)
    base, out = mjcf.base_joints(model), mjcf.spread_out(model)
    rng = np.random.default_rng(0)

    def read(q: Array, v: Array, command: float = 0.0) -> Array:
        data.qpos[:], data.qvel[:], data.ctrl[:] = out @ q, out @ v, command
        mujoco.mj_forward(model, data)
        return np.array(straight.sense(data.sensordata)[address])

    nb = len(base)
    c = read(np.zeros(nb), np.zeros(nb))
    eye = np.eye(nb)
    P = np.stack([read(eye[j], np.zeros(nb)) - c for j in range(nb)], axis=1)
    V = np.stack([read(np.zeros(nb), eye[j]) - c for j in range(nb)], axis=1)
    names = mjcf.scalar_sensors(model)
    for _ in range(3):
        q, v = rng.normal(size=nb), rng.normal(size=nb)
        off = np.abs(read(q, v) - (P @ q + V @ v + c)) > 1e-6 * (1 + np.abs(P @ q) + np.abs(V @ v))
        if off.any():
            odd = names[int(np.flatnonzero(off)[0])]
            if cutoff := float(model.sensor(odd).cutoff[0]):
                raise Undetermined(
                    f"sensor {odd!r} has a cutoff of {cutoff:g}, beyond which its reading stays as it is",
                    "Take the cutoff out of the model; readings that were cut off say nothing, and may go as well.",
                )
            raise Undetermined(
                f"sensor {odd!r} is not linear in joint positions and velocities; "
                "supported are jointpos, jointvel, tendonpos, tendonvel, actuatorpos and actuatorvel on fixed "
                "transmissions",
                "Take that sensor out of the model; its column may stay in the recording.",
            )
    at_once = np.abs(read(np.zeros(nb), np.zeros(nb), 1.0) - c) > 1e-6 * (1 + np.abs(c))
    if at_once.any():
        raise Undetermined(
            f"sensor {names[int(np.flatnonzero(at_once)[0])]!r} reads what a command does at once, as a force or an "
            "acceleration; supported are sensors of positions and velocities",
            "Take that sensor out of the model; its column may stay in the recording.",
        )
    return P, V, c


@dataclass(frozen=True)
class Seen:
    """Which sensors tell where the base joints are.

    Attributes:
        sensors: indices of those that read positions, and of speeds where nothing else tells a position, (k,).
        speeds: which of them are speeds: their integral from the start of a recording on is taken for a position, (k,).
        rows: how they, or their integrals, go with the positions, (k, nb).
        zero: what they read of a rig that rests where all positions are 0, (k,).
    """

    sensors: NDArray[np.intp]
    speeds: NDArray[np.bool_]
    rows: Array
    zero: Array

    @property
    def by_speed(self) -> NDArray[np.bool_]:
        """Base joints (nb,) whose place follows from their speed alone."""
        return np.asarray(np.any(self.rows[self.speeds] != 0, axis=0))

    def inverse(self, noise: Array) -> Array:
        """Least-squares positions per reading, (nb, k), of sensors with this noise, (ns,)."""
        return inverse_map(self.rows, noise[self.sensors])

    def positions(self, time: Array, readings: Array, noise: Array) -> Array:
        """Positions (..., n, nb) at times (n,) that readings (..., n, ns) tell."""
        told = readings[..., self.sensors] - self.zero
        if self.speeds.any():
            whole = cumulative_trapezoid(told, time, axis=-2, initial=0)
            told = np.where(self.speeds, whole, told)
        return np.asarray(told @ self.inverse(noise).T)

    def noise(self, noise: Array, within: float) -> Array:
        """Standard deviation of the base joints' positions as they are read, (nb,).

        Args:
            noise: of the sensors, (ns,); infinite of one that never changes.
            within: s, for which a speed is integrated.
        """
        each = np.where(np.isfinite(noise), noise, 0.0)[self.sensors] * np.where(self.speeds, within, 1.0)
        return np.hypot.reduce(self.inverse(noise) * each, axis=1)


def seen(physics: Physics) -> Seen:
    """Which sensors tell where the base joints are.

    Raises:
        Undetermined: as `sensor_map`; or neither positions nor speeds tell it of a joint.
    """
    P, V, c = sensor_map(physics)
    base = mjcf.base_joints(physics.model)
    still, turning = ~V.any(axis=1), ~P.any(axis=1) & V.any(axis=1)
    turning &= np.abs(V @ _free(P[still], len(base)).T).max(axis=1, initial=0.0) > 1e-9
    rows = np.where(turning[:, None], V, P)
    free = _free(rows[still | turning], len(base))
    if len(free):
        joints = [name for name, column in zip(base, free.T, strict=True) if np.abs(column).max() > 1e-6]
        raise Undetermined(
            f"no position sensor sees joint {', '.join(joints)}, so its state cannot be known",
            "Add a sensor of its position, or of its speed, to the model and the recording, or lock the joint in the "
            "model.",
        )
    which = np.flatnonzero(still | turning)
    return Seen(which, turning[which], rows[which], c[which])


def _free(rows: Array, nb: int) -> Array:
    """Directions of the positions (m, nb) that rows (k, nb) do not tell."""
    if not len(rows):
        return np.eye(nb)
    _, s, directions = np.linalg.svd(rows)
    return np.asarray(directions[int((s > 1e-9).sum()) :])


def integrated(physics: Physics) -> list[str]:
    """A sentence if where a joint is follows from its speed alone."""
    moves = seen(physics).by_speed
    joints = [joint for joint, of in zip(mjcf.base_joints(physics.model), moves, strict=True) if of]
    if not joints:
        return []
    return [
        f"Of {' and '.join(joints)} only the speed is read: the position is taken to be 0 where a recording begins and "
        "integrated from there, so what depends on it is known no better than that."
    ]


def estimate(recording: Recording, physics: Physics, noise: Array) -> Motion:
    """Smooth the sensors and invert them to joints.

    Args:
        recording: with the model's sensors.
        physics: says how the sensors read the joints.
        noise: standard deviation of each sensor, (ns,); of a sensor that never changes, infinite.

    Raises:
        Undetermined: as `sensor_map`.
    """
    told, smooth = seen(physics), recording.sensors.copy()
    for s in told.sensors:
        smooth[:, s] = smoothed(recording.time, recording.sensors[:, s], noise[s])
    as_read, smooth = smooth, straightened(physics, smooth)
    _undo_lateness(physics, recording.time, smooth)
    position = told.positions(recording.time, smooth, noise)
    velocity = np.gradient(position, recording.time, axis=0, edge_order=2)
    acceleration = np.gradient(velocity, recording.time, axis=0, edge_order=2)
    read = told.noise(noise, within=recording.period)
    if not told.speeds.any():
        when, first = _first_readings(physics, recording, told.sensors)
        velocity[0] = _begins(recording.time, position, velocity, when, told.positions(when, first, noise), read)
    return Motion(recording.time, position, velocity, acceleration, read, as_read)


def _first_readings(physics: Physics, recording: Recording, which: NDArray[np.intp]) -> tuple[Array, Array]:
    """When the first of what some sensors read was so, s, (k,), and the readings of all, (k, ns).

    None where they are late by different times, or lag: what they read first was then before the recording.
    """
    delays, lags = mjcf.sensor_delays(physics.model)[which], {extra.index for extra in physics.stage("lag")}
    if np.ptp(delays) > 0 or lags.intersection(mjcf.sensor_addresses(physics.model)[which].tolist()):
        return np.zeros(0), recording.sensors[:0]
    begin = int(np.searchsorted(recording.time, recording.time[0] + delays[0] - 1e-9))
    span = slice(begin, begin + ESTIMATION.begins)
    return recording.time[span] - delays[0], straightened(physics, recording.sensors[span])


def _begins(time: Array, position: Array, velocity: Array, when: Array, read: Array, noise: Array) -> Array:
    """Velocities (nb,) with which a recording begins, by its first readings.

    A recording mostly begins at rest, and with a command that jumps: what is smoothed is then off by far more than its
    noise, and a load that swings would remember that for seconds. Where the first readings lie on a cubic that tells
    the velocity well, and not on the smoothed curve, it is theirs, or none where that may be. A little of it is none as
    well, if they may say so.

    Args:
        time: s, (n,).
        position: smoothed, m or rad, (n, nb).
        velocity: smoothed, (n, nb).
        when: what was read first was so, s, (k,).
        read: positions, (k, nb).
        noise: of these, (nb,).
    """
    count = ESTIMATION.begins
    if len(read) < count:
        return velocity[0]
    cubic = np.vander(when - when[0], 4)
    inverse, usual = np.linalg.pinv(cubic), velocity.std(axis=0)
    told, doubt = inverse[2] @ read, ESTIMATION.surely * np.linalg.norm(inverse[2]) * noise
    off = np.linalg.norm(read - cubic @ (inverse @ read), axis=0) / math.sqrt(count - 4)
    smooth = np.stack([np.interp(when, time, one) for one in position.T], axis=1)
    refuted = np.sqrt(np.mean((read - smooth) ** 2, axis=0)) > ESTIMATION.surely * noise
    rests = (np.abs(told) < doubt) & (refuted | (np.abs(velocity[0]) < ESTIMATION.rough_speed * usual))
    begins = np.where(rests, 0.0, np.where(refuted, told, velocity[0]))
    well = (off < ESTIMATION.on_it * noise) & (doubt < ESTIMATION.sure * usual)
    return np.where(well, begins, velocity[0])


def inverse_map(P: Array, noise: Array) -> Array:
    """Least-squares inverse (nb, ns) of y = P q; sensors that never change count like the noisiest other one.

    They may be dead, or their joint locked: they have to do where nothing else sees the joint.
    """
    known = noise[np.isfinite(noise)]
    weight = 1 / np.where(np.isfinite(noise), noise, known.max(initial=0.0) or 1.0)
    return np.asarray(np.linalg.pinv(P * weight[:, None]) * weight)


def _undo_lateness(physics: Physics, time: Array, smooth: Array) -> None:
    """Lead delayed and lagging sensors (n, ns), in place: what a lag follows is tau dy/dt + y."""
    address = mjcf.sensor_addresses(physics.model)
    delays = mjcf.sensor_delays(physics.model)
    for k in np.flatnonzero(delays > 0):
        read = CubicSpline(time, smooth[:, k])
        beyond = np.maximum(time + delays[k] - time[-1], 0.0)  # not read any more: it goes on as it went
        inside = np.minimum(time + delays[k], time[-1])
        smooth[:, k] = read(inside) + beyond * (read(time[-1], 1) + 0.5 * beyond * read(time[-1], 2))
    for extra in physics.stage("lag"):
        for k in np.flatnonzero(address == extra.index):
            smooth[:, k] += extra.data[0] * np.gradient(smooth[:, k], time, edge_order=2)


def smoothed(time: Array, values: Array, noise: float) -> Array:
    """The smoothest curve (least integral of the squared third derivative) that leaves a residual of size `noise`.

    Args:
        time: s, (n,), irregular if need be.
        values: (n,).
        noise: standard deviation that the residual is to have.
    """
    if np.ptp(values) == 0:
        return values.copy()
    # The curve may bend as a parabola does at no cost; taken out first, it does not suffer from rounding either.
    parabola = np.polynomial.Polynomial.fit(time, values, 2)(time)
    values = values - parabola
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

    # Stamps that nearly coincide make the matrix so stiff that its Cholesky factor is lost in rounding.
    high = min(12.0, 14.0 - math.log10(float(roughness.max())))
    low = min(-6.0, high)
    for _ in range(18):
        middle = (low + high) / 2
        if np.std(values - solve(10**middle)) < noise:
            low = middle
        else:
            high = middle
    return parabola + solve(10**low)


class Forces(NamedTuple):
    """Generalised forces at base joints along a motion, (n, nb) each, N or N m.

    Attributes:
        unexplained: what the motion needs beyond what the model gives.
        load: what each joint transmits: of its actuators, and what gravity and motion ask of it besides.
        resisting: of the model's dry friction.
    """

    unexplained: Array
    load: Array
    resisting: Array


def unexplained_force(physics: Physics, recording: Recording, motion: Motion) -> Forces:
    """Generalised force that the motion needs beyond what the model gives, by inverse dynamics.

    Joints that follow others are taken to move with them, loads that swing among them, and what acts on them counts
    for their leaders. Where a joint may rest, dry friction holds what it is asked to, up to its level: nothing is
    unexplained there that it can hold.
    """
    model, out = copy.copy(physics.model), mjcf.spread_out(physics.model)  # others simulate the model as well
    data = mujoco.MjData(model)
    level, stiffness = model.dof_frictionloss.copy(), model.tendon_stiffness.copy()
    n = len(motion.time)
    late = mjcf.control_delays(model)
    commands = physics.command(acting(late, recording), recording.time)
    model.actuator_delay[:] = 0
    slips = mjcf.yielding(model)
    model.tendon_stiffness[slips] = 0.0  # how far these are bent, the motion before says
    gaps = np.diff(motion.time, prepend=motion.time[0])
    needed, driven, biased = np.empty((3, n, model.nv))
    exerted = np.empty((n, model.nout))
    held = np.zeros((n, model.nv))
    time, sent = motion.time.tolist(), data.ctrl[: recording.commands.shape[1]]
    qpos, qvel, qacc, act = data.qpos, data.qvel, data.qacc, data.act
    inverse, actuator, bias = data.qfrc_inverse, data.qfrc_actuator, data.qfrc_bias
    every = motion.spread(out)
    position, velocity, acceleration = every.position, every.velocity, every.acceleration
    rests = _rests(motion)
    still = set(np.flatnonzero(rests.any(axis=1)).tolist())
    # What holds a joint may depend on the forces of the moment, so it is known only after these.
    dry = bool(physics.stage("friction"))
    for k in range(n):
        data.time, qpos[:], qvel[:], sent[:] = time[k], position[k], velocity[k], commands[k]
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        mujoco.mj_fwdActuation(model, data)
        if model.na:
            act[:] += data.act_dot * _relaxed(model, data, gaps[k])
            mujoco.mj_fwdActuation(model, data)
        driven[k], exerted[k], biased[k] = actuator, data.actuator_force, bias
        if not dry:
            qacc[:] = acceleration[k]
            mujoco.mj_inverseSkip(model, data, mujoco.mjtStage.mjSTAGE_VEL, 1)
            needed[k] = inverse
            if k in still:
                _hold(data, held[k])
    moments = SimpleNamespace(time=motion.time, qpos=position, qvel=velocity, ctrl=commands)
    moments.qfrc_actuator, moments.actuator_force, moments.qfrc_bias = driven, exerted, biased
    moments.userdata = np.zeros((n, model.nuserdata))
    for which, law in enumerate(physics.remembering):
        kept = memories([physics], which, late[None], recording, motion, motion.time)
        moments.userdata[:, law.slot] = kept[0]
    levels, pushed = np.tile(level, (n, 1)), np.zeros((n, model.nv))
    side_by_side = [replace(x, data=np.broadcast_to(x.data, (n, len(x.data)))) for x in physics.extras]
    replace(physics, extras=tuple(side_by_side)).act(moments, levels, pushed)
    for tendon in slips:
        bent = bends([physics], tendon, motion, motion.time)[0]
        for at, coefficient in mjcf.along(model, tendon):
            pushed[:, at] -= stiffness[tendon] * coefficient * bent
    for k in range(n if dry else 0):
        data.time, qpos[:], qvel[:], qacc[:] = time[k], position[k], velocity[k], acceleration[k]
        model.dof_frictionloss[:] = levels[k]
        mujoco.mj_inverse(model, data)
        needed[k] = inverse
        if k in still:
            _hold(data, held[k])
    lacking = (needed + held - driven - pushed) @ out
    level_at = levels @ np.abs(out)
    # At rest friction is whatever it is asked to hold: MuJoCo's, which is soft, would hold anything there.
    resisting = np.where(rests, np.clip(lacking, -level_at, level_at), held @ out)
    moving = -level_at * np.sign(motion.velocity)  # it is in what was needed already
    friction = np.where(rests.any(axis=1, keepdims=True), resisting, moving)
    return Forces(lacking - resisting, (driven + biased) @ out, friction)


def _rests(motion: Motion) -> NDArray[np.bool_]:
    """Where a base joint may rest, (n, nb): what its estimated velocity says of a direction is noise."""
    period = float(np.median(np.diff(motion.time)))
    return np.asarray(np.abs(motion.velocity) < motion.noise / (ESTIMATION.moves * period))


def _hold(data: mujoco.MjData, into: Array) -> None:
    """Force of MuJoCo's dry friction on each joint that has some, (nv,), of inverse dynamics that were just done."""
    dry = data.efc_type == mujoco.mjtConstraint.mjCNSTR_FRICTION_DOF
    into[data.efc_id[dry]] = data.efc_force[dry]


def acting(delays: Array, recording: Recording) -> Array:
    """Commands (n, nu) that act around each time stamp, each control's delay (nu,) later than they were given.

    One holds from its stamp to the next, and what motion tells of a moment is what went on before and after it: the
    command that begins to hold there would come half a sample early.
    """
    half = 0.5 * recording.period
    around = recording.time[:, None] + np.array([-half, half])
    each = [
        held_mean(recording, around - late, c)[:, 0] for c, late in enumerate(delays[: recording.commands.shape[1]])
    ]
    return np.stack(each, axis=1) if each else recording.commands


def _relaxed(model: mujoco.MjModel, data: mujoco.MjData, step: float) -> Array:
    """For how much of a step each activation, (na,), would keep its present rate: it decays with its time constant."""
    lasting = np.full(model.na, step)
    for i in np.flatnonzero(model.actuator_actadr >= 0).tolist():
        tau, _, heated, capacity, _, stiffness = model.actuator_dynprm[i, :6].tolist()
        first = int(model.actuator_actadr[i])
        end = first + int(model.actuator_actnum[i])
        rates = [1 / tau if tau > 0 else 0.0] * (end - first)
        if model.actuator_gaintype[i] == mujoco.mjtGain.mjGAIN_DCMOTOR:
            # MuJoCo keeps a winding's temperature first, then the bristles, and its current last.
            if heated > 0:
                rates[0] = 1 / (heated * capacity)
            if stiffness > 0:
                speed = float(data.actuator_velocity[model.actuator_outadr[i]])
                rates[-1 - (tau > 0)] = _bristle_rate(model, i, speed)
        lasting[first:end] = [-math.expm1(-rate * step) / rate if rate > 0 else step for rate in rates]
    return lasting


def _bristle_rate(model: mujoco.MjModel, motor: int, speed: float) -> float:
    """Rate at which LuGre's bristles follow the motion, 1/s: stiffness times |v| over the force at that speed."""
    level, static, velocity = map(float, model.actuator_biasprm[motor, 3:6])
    force = level + (static - level) * math.exp(-((speed / velocity) ** 2)) if velocity > 0 else level
    return float(model.actuator_dynprm[motor, 5]) * abs(speed) / max(force, 1e-12)
