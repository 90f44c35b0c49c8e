"""The paper's identification run: poles locked, a voltage swept in frequency, and what it says about friction."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Collection
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from numpy.typing import NDArray

from dipc_gym import kernels, mjcf
from dipc_gym.compensators import RigConstants, Samples
from dipc_gym.compensators.memory import smooth as smoothed_force
from dipc_gym.identification.excitation import Excitation, examine, force_noise
from dipc_gym.identification.settings import RUN
from dipc_gym.identification.smoothing import smooth
from dipc_gym.mechanics.rigid import Rigid
from dipc_gym.physics import from_model
from dipc_gym.plant import Encoders, Plant, physics_steps
from dipc_gym.recording import Recording, resample_commands

__all__ = ["Cart", "Sweep"]

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Sweep:
    """A sinusoidal voltage whose frequency rises linearly, as in the paper.

    The paper does not give the amplitude. 8 V takes the cart over 0.6 m of its 0.9 m rail at 0.3 Hz.

    Attributes:
        duration: s.
        low: first frequency, Hz.
        high: last frequency, Hz.
        amplitude: V.
        block: length of the alternating stretches for training and for test, s; so both hold every frequency.
    """

    duration: float = 60.0
    low: float = 0.3
    high: float = 10.0
    amplitude: float = 8.0
    block: float = 1.0

    def voltage(self, time: Array) -> Array:
        """Voltage at `time` (n,), V. A cosine: the cart then swings about where it starts."""
        share = time / self.duration
        phase = 2 * math.pi * time * (self.low + (self.high - self.low) * share / 2)
        return self.amplitude * np.cos(phase)


@dataclass(frozen=True)
class Cart:
    """The cart with its poles locked, as a linear controller's model sees it: mass a + viscous v = F.

    Attributes:
        mass: moving mass, kg; the paper's d1.
        constants: motor gain, viscous friction (back-EMF included) and supply.
    """

    mass: float
    constants: RigConstants


def locked(text: str, joints: Collection[str]) -> str:
    """The model's text with the poles fixed to the cart: without their joints and what needs these.

    Example:
        >>> text = '<mujoco><worldbody><body><joint name="pole1"/></body></worldbody></mujoco>'
        >>> "pole1" in locked(text, ["pole1", "pole2"])
        False
    """
    root = ET.fromstring(text)
    gone = set(joints)
    for parent in root.iter():
        for child in list(parent):
            named = parent.tag != "default" and child.tag == "joint" and child.get("name") in joints
            if named or child.get("joint") in joints or child.tag == "keyframe":
                parent.remove(child)
                gone.add(child.get("name", ""))
    for custom in root.iter("custom"):
        entries = custom.findall("numeric")
        of_what = [(t.get("name", ""), t.get("data", "").partition(" ")[2]) for t in custom.findall("text")]
        for effect in entries:
            prefix, _, place = effect.get("name", "").partition(":")
            inputs = {of for name, of in of_what if name in (f"{mjcf.INPUTS}{k}:{place}" for k in (1, 2))}
            if prefix == mjcf.PREFIX and ({place.partition(":")[2]} | inputs) & gone:
                custom.remove(effect)
    return ET.tostring(root, encoding="unicode")


def cart_model(source: mjcf.Source, plant: Plant) -> mujoco.MjModel:
    """Compile a rig, for a plant, with the joints locked that its sensors `pole1` and `pole2` read.

    Raises:
        ValueError: such a joint is not in the text under its name, so that it cannot be locked.
    """
    rig = source.edited(plant.to_mjcf(source.text))
    free = mjcf.compile(rig, trusted=True)
    sensors = [free.sensor(i) for i in range(free.nsensor)]
    poles = [free.joint(int(s.objid[0])).name for s in sensors if s.name in ("pole1", "pole2")]
    model = mjcf.compile(rig.edited(locked(rig.text, poles)), trusted=True)
    for i in range(model.njnt):
        if model.joint(i).name in poles:
            raise ValueError(
                f"{source.name}: the joint {model.joint(i).name!r} of a pole cannot be locked, for it does not stand "
                "in the text under this name; write the pole's body out, without <replicate> or <attach>"
            )
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET  # a run that diverges must be seen
    return model


def cart(model: mujoco.MjModel) -> Cart:
    """Mass, motor gain and viscous friction of a rig with locked poles; dry friction, lags and play left out.

    Args:
        model: as `cart_model` gives it.
    """
    motor = mjcf.controls(model).index("motor")
    rigid = Rigid(model, [int(model.jnt_dofadr[model.sensor("cart").objid[0]])])

    def acceleration(volts: float, velocity: float, force: float) -> float:
        return float(rigid.acceleration(None, [velocity], [force], (motor, volts))[0])

    per_newton = (acceleration(0, 0, 1) - acceleration(0, 0, -1)) / 2
    per_volt = (acceleration(1, 0, 0) - acceleration(-1, 0, 0)) / 2
    per_speed = (acceleration(0, 1e-3, 0) - acceleration(0, -1e-3, 0)) / 2e-3
    supply = float(np.abs(model.actuator_ctrlrange[motor]).max())
    mass = 1 / per_newton
    return Cart(mass, RigConstants(per_volt / per_newton, -per_speed / per_newton, supply, mass))


def record(model: mujoco.MjModel, plant: Plant, sweep: Sweep, *, seed: int = 0) -> Recording:
    """Drive the locked rig with the sweep and read its cart encoder once a control period.

    What the model says under `<custom>` acts too.

    Args:
        model: as `cart_model` gives it.
        plant: encoders, supply and control period.
        sweep: the voltage.
        seed: of the encoders' noise.

    Returns:
        A recording with the command `motor` (V) and the sensor `cart` (m).

    Raises:
        ValueError: the simulation diverges, or the cart runs into an end of its rail.
    """
    rng = np.random.default_rng(seed)
    period, encoders = plant.control_period, plant.encoders
    nstep = physics_steps(period, model.opt.timestep)
    time: Array = period * np.arange(round(sweep.duration / period), dtype=np.float64)
    volts = np.clip(sweep.voltage(time), -plant.supply, plant.supply)
    motor = mjcf.controls(model).index("motor")
    data, physics = mujoco.MjData(model), from_model(model)
    sensed = bool(physics.stage("sensor") or physics.stage("lag") or np.any(model.sensor_delay > 0))
    memory, command = physics.sensor_memory(data.sensordata), np.zeros(model.nu)
    position, where, joint = np.empty(len(time)), np.empty(len(time)), int(model.sensor("cart").objid[0])
    for k, u in enumerate(volts.tolist()):
        position[k] = where[k] = data.qpos[model.jnt_qposadr[joint]]
        if sensed:
            mujoco.mj_forward(model, data)
            position[k] = physics.sense(data.sensordata, memory, period)[model.sensor("cart").adr[0]]
        command[motor] = u
        physics.step(data, command, nstep)
    if not np.isfinite(position).all():
        at = time[np.argmin(np.isfinite(position))]
        raise ValueError(
            f"the simulated identification run diverges at {at:g} s; give the model a smaller <option timestep>"
        )
    low, high = model.jnt_range[joint] if model.jnt_limited[joint] else (-math.inf, math.inf)
    if (where < low).any() or (where > high).any():
        at = time[np.argmax((where < low) | (where > high))]
        raise ValueError(
            f"the simulated identification run drives the cart into an end of its rail at {at:g} s, and what a blow "
            f"does would be learned as friction; give a sweep of less than {sweep.amplitude:g} V, or a recording"
        )
    position += encoders.noise * encoders.cart * rng.standard_normal(len(time))
    reading = kernels.quantise(position, encoders.cart)
    return Recording("identification", time, volts[:, None], reading[:, None], ("motor",), ("cart",))


def samples(
    recording: Recording,
    cart: Cart,
    encoders: Encoders,
    period: float,
    *,
    block: float = 1.0,
    smoothed: bool = False,
) -> Samples:
    """Turn an identification run into what compensators are fitted to.

    Over each period, the linear model's force is F(k) = mass (v(k+1) - v(k)) / T + viscous (p(k+1) - p(k)) / T, with
    central differences v of the readings p: no filter, no lag. The velocities that stand beside it as inputs are those
    that the loop will have, from the encoders' filter.

    Args:
        recording: with the command `motor` and the sensor `cart`; sampled anew where its period is another.
        cart: mass and viscous friction of the linear model.
        encoders: for the velocity filter.
        period: control period, s.
        block: length of the alternating stretches for training and test, s.
        smoothed: whether readings are smoothed first, as much as their noise asks for (`smooth`), as those of a real
            rig have to be; the paper's simulated run is taken as it comes.

    Raises:
        ValueError: the recording has no `motor` or `cart`, or is shorter than two blocks.
    """
    for name, names in (("motor", recording.actuator_names), ("cart", recording.sensor_names)):
        if name not in names:
            raise ValueError(f"{recording.path or recording.name}: no {name!r} to identify friction from")
    if recording.duration < 2 * block:
        raise ValueError(
            f"{recording.path or recording.name}: {recording.duration:.3g} s are too short; "
            f"training and test need {2 * block:g} s or more"
        )
    grid, volts, p = _on_grid(recording, period)
    clean = smooth(p).values if smoothed else p
    v = np.gradient(clean, period)
    force = cart.mass * np.diff(v) / period + cart.constants.viscous * np.diff(clean) / period
    keep, gain = kernels.velocity_gains(encoders.velocity_filter, period)
    filtered = [0.0]
    for now, before in zip(p[1:].tolist(), p[:-1].tolist(), strict=True):
        filtered.append(kernels.velocity(now, before, filtered[-1], keep, gain))
    seen = np.array(filtered)
    part = slice(1, len(p) - 2)  # central differences need a neighbour on both sides
    train = (grid - grid[0])[part] // block % 2 == 0
    return Samples(force[part], seen[part], seen[: len(p) - 3], volts[part], train, p[part])


def excitation(
    recording: Recording, cart: Cart, encoders: Encoders, period: float, *, block: float = 1.0, late: float = 0.0
) -> Excitation:
    """What the run covers, what it leaves out, and whether a compensator can be trained from it.

    Arguments and errors are those of `samples`; voltages act `late` seconds late.
    """
    data = samples(recording, cart, encoders, period, block=block, smoothed=True)
    if late:
        data = replace(data, voltage=delayed(data.voltage, period, late))
    smoothed = smooth(_on_grid(recording, period)[2])
    frequency = np.linspace(0, math.pi, 2001)
    noise = force_noise(
        smoothed.noise,
        smoothed.response(frequency),
        frequency,
        mass=cart.mass,
        viscous=cart.constants.viscous,
        period=period,
    )
    return examine(data, cart.constants, force_noise=noise)


def delayed(voltage: Array, period: float, delay: float) -> Array:
    """The mean voltages (n,) that arrive in each period when commands (n,) act `delay` seconds late.

    Example:
        >>> delayed(np.array([0.0, 2.0, 2.0, 2.0]), 0.005, 0.0075).tolist()
        [0.0, 0.0, 1.0, 2.0]
    """
    whole = int(delay / period + 1e-9)
    share = delay / period - whole
    now = np.concatenate([np.full(whole, voltage[0]), voltage])[: len(voltage)]
    before = np.concatenate([voltage[:1], now])[: len(voltage)]
    return (1 - share) * now + share * before


def delay(data: Samples, constants: RigConstants) -> float:
    """By how much the motor is late in an identification run, s; 0 if that is less than half a period.

    Tried are delays of up to 60 ms, in steps of a quarter of a period: with the right one the force that is lost while
    the cart moves fast is best explained by a constant against the motion and one in proportion to it. A delay that
    does not halve what is left over without one is none. Where dry friction holds the cart for the most part it comes
    out too short.

    Args:
        data: samples with positions.
        constants: of the cart.
    """
    if data.position is None:
        return 0.0
    period, speed = constants.period, np.gradient(data.position, constants.period)
    moving = np.abs(speed) > RUN.fast * np.abs(speed).max()
    if not moving.any():
        return 0.0
    columns = np.column_stack([np.sign(speed), speed])[moving]
    tried = np.arange(0.0, RUN.longest_delay, 0.25 * period)
    left = np.empty(len(tried))
    for i, late in enumerate(tried.tolist()):
        lost = constants.newtons_per_volt * smoothed_force(delayed(data.voltage, period, late)) - data.force
        shares = np.linalg.lstsq(columns, lost[moving])[0]
        left[i] = np.mean((lost[moving] - columns @ shares) ** 2)
    best = int(np.argmin(left))
    return float(tried[best]) if tried[best] > 0.5 * period and left[best] < 0.5 * left[0] else 0.0


def _on_grid(recording: Recording, period: float) -> tuple[Array, Array, Array]:
    """Times, voltages and positions once a control period."""
    time = recording.time
    volts = recording.commands[:, recording.actuator_names.index("motor")]
    position = recording.sensors[:, recording.sensor_names.index("cart")]
    if np.all(np.abs(np.diff(time) - period) < 0.01 * period):
        return time, volts, position
    grid = time[0] + period * np.arange(int(recording.duration / period))
    borders = np.append(grid, grid[-1] + period)
    held = resample_commands(recording, borders)[:, recording.actuator_names.index("motor")]
    return grid, held, np.interp(grid, time, position)
