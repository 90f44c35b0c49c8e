"""The compensator that a model of the rig implies, without a recording: its friction and its motor, turned round."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from dipc_gym import mjcf
from dipc_gym.compensators import Compensator, Curve, RigConstants, Samples, registry
from dipc_gym.env import DoublePendulumEnv
from dipc_gym.identification.run import cart, cart_model
from dipc_gym.physics import Extra, Physics, from_model
from dipc_gym.plant import Plant
from dipc_gym.runs import identify

Array = NDArray[np.float64]

SPEEDS = np.geomspace(3e-3, 1.0, 18)
"""m/s, each way; what is slower is smoothed anyway."""
TRAVEL = 3e-3
"""m, over which bristles and belts settle at a constant speed."""
SETTLE = 0.1
"""s, over which windings and delays settle."""
PLACES = np.array([-0.6, 0.0, 0.6])
"""Shares of the rail where friction is looked at."""
VOLTAGES = 241
"""Of a table of the drive: a fifth of a volt apart at 24 V of supply."""
SHARE = 0.05
"""Of friction, above which its differences along the rail are told."""
WIDTHS = np.geomspace(1e-3, 0.3, 41)
"""m/s; candidates for the velocity within which the sign is smoothed."""


@dataclass(frozen=True, eq=False)
class Law:
    """What a model says of the cart in steady motion.

    Attributes:
        velocity: (n,) m/s, increasing, none of them zero.
        friction: (n,) force that keeps the velocity up beyond the linear model's viscous friction, mean along the
            rail, N.
        spread: largest difference between two places on the rail at one velocity, N.
        voltage: (m,) V, increasing.
        force: (m,) of the motor on the blocked cart, N.
        linear: what the linear controller's model has of the cart.
        left_out: effects of the model that neither velocity nor voltage tells, by id.
    """

    velocity: Array
    friction: Array
    spread: float
    voltage: Array
    force: Array
    linear: RigConstants
    left_out: tuple[str, ...]

    @property
    def slowest(self) -> float:
        """Speed nearest to standstill at which friction was looked at, m/s."""
        return float(np.abs(self.velocity).min())

    def notes(self) -> list[str]:
        """What a compensator that sees force and velocity alone cannot take out, in sentences."""
        found = []
        if self.spread > SHARE * float(np.abs(self.friction).max()):
            found.append(
                f"friction differs by up to {self.spread:.2g} N along the rail; a compensator sees no position and "
                "takes the mean"
            )
        if self.left_out:
            found.append(f"not in the compensator: {', '.join(dict.fromkeys(self.left_out))}")
        return found

    def curve(self, width: float) -> Curve:
        """The compensator whose friction goes from one sign to the other within `width` (m/s)."""
        near = np.abs(self.velocity) == self.slowest
        load = float(np.mean(self.friction[near]))  # what pulls either way alike
        smooth = load + (self.friction - load) * np.tanh(np.abs(self.velocity) / width)
        middle = int(np.searchsorted(self.velocity, 0.0))
        forces, commands = _turned(self.force, self.voltage)
        return Curve(
            velocities=tuple(np.insert(self.velocity, middle, 0.0).tolist()),
            friction=tuple(np.insert(smooth, middle, load).tolist()),
            forces=tuple(forces.tolist()),
            commands=tuple(commands.tolist()),
        )


def compensator(model: str | Path, plant: Plant | str | None = None, *, seed: int = 0) -> tuple[Compensator, Law]:
    """The compensator that a model of the rig implies.

    Friction is looked up in steady motion, whatever it consists of: elements of MJCF, entries of `<custom>`, laws of
    free shape. One number remains, the velocity within which its sign is smoothed: it depends on encoder and filter,
    and the one is taken that fits a simulated identification run best.

    Args:
        model: MJCF file of the rig, such as the `improved.xml` of a diagnosis.
        plant: as the environment takes it; encoders and control period matter.
        seed: of the simulated encoder's noise.

    Returns:
        The compensator, with ranges and errors of that run, and what it was made from.

    Raises:
        ValueError: the model is no rig, or its motor has no effect or not a single voltage for each force.
    """
    env = DoublePendulumEnv(plant=plant, model=model)
    law = steady(cart_model(env.source, env.plant))
    identified = identify(plant, model=str(model), seed=seed)
    run = identified.samples

    def error(curve: Curve) -> float:
        return _error(curve, run)

    best = min((law.curve(width) for width in WIDTHS.tolist()), key=error)
    return registry.judged(dataclasses.replace(best, supply=identified.cart.constants.supply_voltage), run), law


def steady(model: mujoco.MjModel) -> Law:
    """Measure a rig with locked poles in steady motion.

    Args:
        model: as `identification.run.cart_model` gives it.

    Raises:
        ValueError: the motor has no effect, or not a single voltage for each force.
    """
    whole, linear = from_model(model), cart(model).constants
    joint = int(model.sensor("cart").objid[0])
    told, untold = _parted(whole, joint)
    physics = dataclasses.replace(whole, extras=told)
    low, high = model.jnt_range[joint] if model.jnt_limited[joint] else (-0.45, 0.45)
    places = (low + high) / 2 + PLACES * (high - low) / 2
    speeds = np.concatenate([-SPEEDS[::-1], SPEEDS])
    held = np.array([[_holding(physics, joint, float(v), float(x)) for v in speeds] for x in places])
    volts = np.linspace(-linear.supply_voltage, linear.supply_voltage, VOLTAGES)
    force = np.array([_pushing(physics, float(u)) for u in volts])
    return Law(
        velocity=speeds,
        friction=held.mean(axis=0) - linear.viscous * speeds,
        spread=float(np.ptp(held, axis=0).max()),
        voltage=volts,
        force=force,
        linear=linear,
        left_out=tuple(extra.effect for extra in untold),
    )


def _parted(physics: Physics, joint: int) -> tuple[tuple[Extra, ...], tuple[Extra, ...]]:
    """What stands under `<custom>` that the cart's place, its velocity and the voltage tell, and what they do not."""
    model = physics.model
    own = {("position", int(model.jnt_qposadr[joint])), ("velocity", int(model.jnt_dofadr[joint]))}

    def tells(extra: Extra) -> bool:
        if extra.stage != "force":
            return extra.stage not in ("sensor", "lag")
        return own.issuperset(extra.inputs) and not (extra.remembers or extra.clocked)

    return tuple(filter(tells, physics.extras)), tuple(extra for extra in physics.extras if not tells(extra))


def _holding(physics: Physics, joint: int, velocity: float, place: float) -> float:
    """Force that keeps the cart at a velocity past a place, with the motor shorted, N."""
    model, step = physics.model, physics.model.opt.timestep
    followers = {model.joint(name).id for name in mjcf.followers(model)}
    moving = [j for j in range(model.njnt) if j == joint or j in followers]
    position, dofs = model.jnt_qposadr[moving], model.jnt_dofadr[moving]
    data = mujoco.MjData(model)
    steps = math.ceil(max(SETTLE, TRAVEL / abs(velocity)) / step)
    for left in range(steps, -1, -1):
        data.qpos[position] = place - velocity * min(left * step, TRAVEL / abs(velocity))
        data.qvel[dofs] = velocity
        physics.act(data, model.dof_frictionloss, data.qfrc_applied)
        if left:
            mujoco.mj_step(model, data)
    mujoco.mj_forward(model, data)
    driven = data.qfrc_actuator + data.qfrc_applied
    data.qacc[:] = 0.0
    mujoco.mj_inverse(model, data)  # dry friction at its full level: nothing but this force keeps the cart going
    return float(np.sum((data.qfrc_inverse - driven)[dofs]))


def _pushing(physics: Physics, volts: float) -> float:
    """Force of the motor on the blocked cart, N."""
    model, motor = physics.model, mjcf.controls(physics.model).index("motor")
    free = Physics(model, tuple(extra for extra in physics.extras if extra.stage == "command"))
    data = mujoco.MjData(model)
    command = np.zeros(model.nu)
    command[motor] = volts
    for _ in range(math.ceil(SETTLE / model.opt.timestep)):
        data.ctrl[:] = free.command(command)
        mujoco.mj_step(model, data)
        data.qpos[:], data.qvel[:] = model.qpos0, 0.0
    mujoco.mj_forward(model, data)
    actuator = next(i for i in range(model.nactuator) if model.actuator(i).name == "motor")
    return float(data.actuator_force[actuator] * mjcf.gear(model, actuator))


def _turned(force: Array, voltage: Array) -> tuple[Array, Array]:
    """Points of the inverse of a motor, that is, voltage over force; a flat stretch becomes a steep one.

    Raises:
        ValueError: the motor has no effect, or its force falls as the voltage rises.
    """
    span = float(np.ptp(force))
    if span == 0 or np.any(np.diff(force) < -1e-6 * span):
        raise ValueError("the motor's force does not rise with the voltage, so no voltage can be told from a force")
    least = 1e-3 * span  # a dead zone is crossed within this force, either way
    points: list[tuple[float, float]] = []
    first = 0
    for last in range(len(force)):
        if last + 1 < len(force) and force[last + 1] - force[first] < least:
            continue
        if last > first:
            level = float(np.mean(force[first : last + 1]))
            points += [(level - least, float(voltage[first])), (level + least, float(voltage[last]))]
        else:
            points.append((float(force[last]), float(voltage[last])))
        first = last + 1
    rising = points[:1]
    for point in points[1:]:  # a shallow stretch beside another may begin before that one ends
        if point[0] > rising[-1][0]:
            rising.append(point)
    table = np.array(rising)
    return _without_straight(table)


def _without_straight(table: Array) -> tuple[Array, Array]:
    """Points of a curve, less those on a straight line between their neighbours."""
    slope = np.diff(table[:, 1]) / np.diff(table[:, 0])
    bends = np.abs(np.diff(slope)) > 1e-3 * np.abs(slope[1:])
    kept = table[np.concatenate([[True], bends, [True]])]
    return kept[:, 0], kept[:, 1]


def _error(curve: Curve, run: Samples) -> float:
    part = run.train
    volts = curve.volts(run.force[part], run.velocity[part], run.previous_velocity[part])
    return float(np.mean((volts - run.voltage[part]) ** 2))
