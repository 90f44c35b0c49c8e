"""The rigs of the trial: their parameters, the simulator that is given away, how they are driven and measured."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dipc_gym.trials import integrator
from dipc_gym.trials.entries import SIZE, index

Array = NDArray[np.float64]

SAMPLES = 10_000  # of a recording
SAMPLE_TIME = 0.002  # s
PULLEY = 78.74015748031496
"""Motor turns per metre of cart travel, rad/m (a pulley of 12.7 mm radius)."""
ENCODER_LINEAR, ENCODER_ANGULAR = 2e-5, 2 * np.pi / 8192  # m and rad, a count
NOISE_LINEAR, NOISE_ANGULAR = 5e-6, 1e-4  # m and rad, standard deviation beside counting


@dataclass(frozen=True)
class Rig:
    """One rig.

    Attributes:
        name: `cart` (poles locked), `hanging`, `upright`, `motor_axis` or `pendulum`.
        joints: joint names; the first one is driven.
        linear: whether the driven joint is a slide.
        parameters: as one flat vector, see `dipc_gym.trials.entries`.
        gear: motor turns per unit of the driven joint.
        voltage_driven: a DC motor; otherwise the command is a torque.
        rotor: inertia of the motor seen at the joint, of which the simulator knows (`armature`) if `knows_rotor`.
        command: typical effective value of the command, V or N m.
        force: typical force or torque at each joint, N or N m.
        speed: typical speed of each joint.
        span: typical range of each joint.
        feedback: see `integrator.simulate`.
        start: joint positions at the beginning.
    """

    name: str
    joints: tuple[str, ...]
    linear: bool
    parameters: Array
    gear: float
    voltage_driven: bool
    rotor: float
    knows_rotor: bool
    command: float
    force: tuple[float, ...]
    speed: tuple[float, ...]
    span: tuple[float, ...]
    feedback: Array
    start: tuple[float, ...]

    @property
    def count(self) -> int:
        """Number of joints."""
        return len(self.joints)

    @property
    def quantum(self) -> Array:
        """Encoder step of each joint, m or rad."""
        steps = np.full(self.count, ENCODER_ANGULAR)
        if self.linear:
            steps[0] = ENCODER_LINEAR
        return steps

    @property
    def white(self) -> Array:
        """Standard deviation of the noise before quantisation, m or rad."""
        return np.where(self.quantum == ENCODER_LINEAR, NOISE_LINEAR, NOISE_ANGULAR)

    @property
    def noise(self) -> Array:
        """Standard deviation of a reading: white noise and quantisation, m or rad."""
        return np.sqrt(self.quantum**2 / 12 + self.white**2)


def _parameters(**numbers: float) -> Array:
    parameters = np.zeros(SIZE)
    for name, value in numbers.items():
        parameters[index(name)] = value
    return parameters


def cart(rng: np.random.Generator) -> Rig:
    """The paper's cart with its poles locked."""
    vary = _spread(rng, 4)
    constant = 0.06 * PULLEY * vary[0]
    parameters = _parameters(m0=1.26 * vary[1], gravity=9.81, kt=constant, ke=constant, resistance=1.2 * vary[2])
    parameters[index("damping", 0)] = 21.4 * vary[3]
    feedback = integrator.NO_FEEDBACK.copy()
    feedback[0] = 7.62
    return Rig(
        "cart", ("cart",), True, parameters, PULLEY, True, 0.3 * parameters[0], False,
        3.0, (12.0,), (0.3,), (0.15,), feedback, (0.0,),
    )  # fmt: skip


def _double_pendulum(rng: np.random.Generator) -> tuple[Array, Array]:
    vary = _spread(rng, 6)
    constant = 0.06 * PULLEY * vary[0]
    parameters = _parameters(
        m0=0.50041 * vary[1], m1=0.63443 * vary[2], m2=0.12516 * vary[3], com1=0.2, com2=0.28125,
        inertia1=0.0279472 * vary[2], inertia2=0.00329965 * vary[3], length1=0.4, gravity=9.81,
        kt=constant, ke=constant, resistance=1.2 * vary[4],
    )  # fmt: skip
    for joint, value in enumerate((21.4 * vary[5], 1e-4, 1e-4)):
        parameters[index("damping", joint)] = value
    return parameters, vary


DOUBLE_PENDULUM_JOINTS = ("cart", "pole1", "pole2")


def hanging(rng: np.random.Generator) -> Rig:
    """The whole rig with its poles hanging."""
    parameters, _ = _double_pendulum(rng)
    feedback = integrator.NO_FEEDBACK.copy()
    feedback[0] = 7.62
    return Rig(
        "hanging", DOUBLE_PENDULUM_JOINTS, True, parameters, PULLEY, True, 0.3 * parameters[0], False,
        1.5, (6.0, 0.03, 0.015), (0.15, 1.0, 2.0), (0.07, 0.25, 0.5), feedback, (0.0, np.pi, 0.0),
    )  # fmt: skip


def upright(rng: np.random.Generator) -> Rig:
    """The whole rig balanced by a state feedback on what the encoders say; their noise reaches the command."""
    parameters, _ = _double_pendulum(rng)
    return Rig(
        "upright", DOUBLE_PENDULUM_JOINTS, True, parameters, PULLEY, True, 0.3 * parameters[0], False,
        0.9, (3.5, 0.03, 0.015), (0.05, 0.05, 0.05), (0.02, 0.006, 0.004), balance(parameters), (0.0, 0.01, -0.02),
    )  # fmt: skip


def motor_axis(rng: np.random.Generator) -> Rig:
    """A DC motor that turns a disc."""
    vary = _spread(rng, 5)
    disc, rotor = 1.5e-4 * vary[0], 5e-5 * vary[1]
    parameters = _parameters(m0=disc + rotor, kt=0.05 * vary[2], ke=0.05 * vary[2], resistance=2.0 * vary[3])
    parameters[index("damping", 0)] = 2e-4 * vary[4]
    return Rig(
        "motor_axis", ("axis",), False, parameters, 1.0, True, rotor, True,
        3.0, (0.05,), (40.0,), (6.0,), integrator.NO_FEEDBACK, (0.0,),
    )  # fmt: skip


def pendulum(rng: np.random.Generator) -> Rig:
    """One driven pendulum, by a torque motor or by a geared DC motor."""
    vary = _spread(rng, 5)
    mass, com = 0.3 * vary[0], 0.25
    parameters = _parameters(
        m0=mass * com**2 + 0.002 * vary[1], m1=mass, com1=com, mgl=mass * 9.81 * com, resistance=1.0
    )
    geared = bool(rng.random() < 0.5)
    if geared:
        constant = 10 * 0.05 * vary[2]
        parameters[[index("kt"), index("ke"), index("resistance")]] = constant, constant, 1.5 * vary[3]
    else:
        parameters[index("kt")] = 1.0
    parameters[index("damping", 0)] = (0.02 if geared else 0.03) * vary[4]
    return Rig(
        "pendulum", ("pendulum",), False, parameters, 10.0 if geared else 1.0, geared, 0.25 * parameters[0], False,
        1.4 if geared else 0.25, (0.35,), (2.0,), (0.6,), integrator.NO_FEEDBACK, (0.0,),
    )  # fmt: skip


RIGS = {"cart": cart, "hanging": hanging, "upright": upright, "motor_axis": motor_axis, "pendulum": pendulum}


def _spread(rng: np.random.Generator, count: int) -> Array:
    """Factors near one: no two trials have the same rig."""
    return np.asarray(np.exp(0.12 * rng.standard_normal(count)))


def balance(parameters: Array) -> Array:
    """State feedback that balances the upright double pendulum (LQR on the equations linearised there).

    The slope of each reading is a filtered difference with a time constant of about 14 ms.
    """
    from scipy.linalg import solve_continuous_are

    def rate(state: Array, voltage: float) -> Array:
        full = np.zeros(integrator.STATE_SIZE)
        full[:6] = state
        out, hold, rhs = np.zeros_like(full), np.zeros(3), np.zeros(3)
        free = np.full(3, integrator.FREE)
        integrator.derivative(0.0, full, voltage, parameters, 3, free, out, hold, np.zeros((3, 3)), rhs)
        return out[:6].copy()

    step = 1e-5
    a = np.column_stack([(rate(step * e, 0.0) - rate(-step * e, 0.0)) / (2 * step) for e in np.eye(6)])
    b = ((rate(np.zeros(6), step) - rate(np.zeros(6), -step)) / (2 * step))[:, None]
    weight = np.diag([60.0, 20.0, 20.0, 1.0, 1.0, 1.0])
    gain = (b.T @ solve_continuous_are(a, b, weight, np.eye(1)))[0]
    return np.concatenate([gain, [0.87, 24.0]])


def excitation(rig: Rig, kind: str, rng: np.random.Generator) -> Array:
    """Command of one recording, V or N m, shape (SAMPLES,).

    Args:
        rig: the rig, for the size of the command.
        kind: `chirp`, `noise` (filtered), `steps` (random levels and lengths) or `sines`.
        rng: source of every draw.
    """
    from scipy.signal import lfilter

    time = np.arange(SAMPLES) * SAMPLE_TIME
    size = rig.command * np.exp(0.15 * rng.standard_normal())
    if kind == "chirp":
        low, high = 0.4 * np.exp(0.2 * rng.standard_normal()), 4.0 * np.exp(0.2 * rng.standard_normal())
        duration = SAMPLES * SAMPLE_TIME
        return np.asarray(2.4 * size * np.cos(2 * np.pi * (low * time + (high - low) / (2 * duration) * time**2)))
    if kind == "noise":
        keep = np.exp(-SAMPLE_TIME / 0.25)
        raw = lfilter([1 - keep], [1, -keep], rng.standard_normal(SAMPLES + 2000))
        raw = lfilter([0.1], [1, -0.9], raw)[2000:]
        return np.asarray(size * raw / raw.std())
    if kind == "steps":
        levels = np.empty(0)
        while levels.size < SAMPLES:
            level = size * rng.uniform(-1.7, 1.7)
            levels = np.append(levels, np.full(int(rng.uniform(0.15, 0.9) / SAMPLE_TIME), level))
        return levels[:SAMPLES]
    if kind == "sines":
        frequencies = np.exp(rng.uniform(np.log(0.15), np.log(3.0), 7))
        waves = np.sin(2 * np.pi * frequencies[:, None] * time + rng.uniform(0, 2 * np.pi, (7, 1)))
        return np.asarray(size * waves.sum(0) / np.sqrt(3.5))
    raise ValueError(f"unknown excitation {kind!r}")


def motor_constant(rig: Rig, parameters: Array) -> float:
    """N m/A at the motor's own shaft."""
    return float(parameters[index("kt")] / rig.gear)


def nominal_xml(rig: Rig, parameters: Array) -> str:
    """The simulator that is given away: the rig's structure with these parameters, as MJCF text."""
    model = ElementTree.Element(
        "mujoco", model={"hanging": "dipc_rig", "upright": "dipc_rig"}.get(rig.name, f"{rig.name}_rig")
    )
    ElementTree.SubElement(model, "option", timestep="0.0005", integrator="implicitfast")
    world = ElementTree.SubElement(model, "worldbody")

    def number(value: float) -> str:
        return repr(float(value))

    def body(parent: ElementTree.Element, joint: int, kind: str, axis: str, **inertial: str) -> ElementTree.Element:
        name = rig.joints[joint]
        place = {"pos": f"0 0 {number(parameters[index('length1')])}"} if joint == 2 else {}
        element = ElementTree.SubElement(parent, "body", place, name=name)
        ElementTree.SubElement(element, "inertial", inertial)
        dof = ElementTree.SubElement(
            element, "joint", name=name, type=kind, axis=axis, damping=number(parameters[index("damping", joint)])
        )
        if joint == 0 and rig.knows_rotor:
            dof.set("armature", number(rig.rotor))
        if parameters[index("coulomb", joint)] > 0:
            dof.set("frictionloss", number(parameters[index("coulomb", joint)]))
            dof.set("solreffriction", "0.002 1")
        return element

    m0 = parameters[index("m0")]
    if rig.name == "motor_axis":
        disc = m0 - rig.rotor
        body(
            world,
            0,
            "hinge",
            "0 0 1",
            pos="0 0 0",
            mass="0.1",
            diaginertia=f"{number(disc)} {number(disc)} {number(disc)}",
        )
    elif rig.name == "pendulum":
        mass, com = parameters[index("m1")], parameters[index("com1")]
        own = m0 - mass * com**2
        body(
            world, 0, "hinge", "0 1 0", pos=f"0 0 {number(-com)}", mass=number(mass),
            diaginertia=f"{number(own)} {number(own)} {number(0.1 * own)}",
        )  # fmt: skip
    else:
        parent = body(world, 0, "slide", "1 0 0", pos="0 0 0", mass=number(m0), diaginertia="1e-3 1e-3 1e-3")
        for joint in range(1, rig.count):
            own = number(parameters[index(f"inertia{joint}")])
            parent = body(
                parent, joint, "hinge", "0 1 0", pos=f"0 0 {number(parameters[index(f'com{joint}')])}",
                mass=number(parameters[index(f"m{joint}")]), diaginertia=f"{own} {own} 1e-4",
            )  # fmt: skip
    actuators = ElementTree.SubElement(model, "actuator")
    if rig.voltage_driven:
        motor = ElementTree.SubElement(
            actuators, "dcmotor", name="motor", joint=rig.joints[0], gear=number(rig.gear),
            resistance=number(parameters[index("resistance")]), motorconst=number(motor_constant(rig, parameters)),
        )  # fmt: skip
        if rig.count == 3:
            motor.set("ctrlrange", "-24 24")
    else:
        ElementTree.SubElement(
            actuators, "motor", name="motor", joint=rig.joints[0], gear=number(parameters[index("kt")])
        )
    sensors = ElementTree.SubElement(model, "sensor")
    for name in rig.joints:
        ElementTree.SubElement(sensors, "jointpos", name=name, joint=name)
    ElementTree.indent(model)
    return ElementTree.tostring(model, encoding="unicode") + "\n"


def with_parameters(rig: Rig, parameters: Array) -> Rig:
    """The same rig with other parameters."""
    return replace(rig, parameters=parameters)
