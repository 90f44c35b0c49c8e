"""What can differ from one rig to the next: motor, friction, encoders, masses, delay, supply and control period.

A plant is written into the model's MJCF and read back from it, so the XML stays the only physics there is.
"""

from __future__ import annotations

import dataclasses
import json
import math
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from dipc_gym.mjcf import PREFIX
from dipc_gym.mjcf.defaults import effective
from dipc_gym.safety.files import write_whole
from dipc_gym.safety.naming import suggestion
from dipc_gym.safety.untrusted import Format, shown

__all__ = ["Encoders", "Friction", "Masses", "Motor", "Plant", "PlantError"]

SCHEMA = "dipc-gym/plant/1"
MAX_DELAY = 1.0  # s; the simulation keeps that much of the past at every step
MOST_STEPS = 1_000  # of the physics within a control period

RANGES = {
    "motor.resistance": (1e-3, 1e4, "ohm"),
    "motor.constant": (1e-6, 1e3, "N m/A"),
    "motor.pulley_radius": (1e-4, 10.0, "m"),
    "friction.coulomb": (0.0, 1e5, "N"),
    "friction.static": (0.0, 1e5, "N"),
    "friction.stribeck_velocity": (1e-6, 100.0, "m/s"),
    "friction.bristle_stiffness": (1e-3, 1e9, "N/m"),
    "friction.bristle_damping": (0.0, 1e6, "N s/m"),
    "friction.viscous": (0.0, 1e6, "N s/m"),
    "encoders.cart": (1e-9, 0.1, "m"),
    "encoders.pole": (1e-9, 1.0, "rad"),
    "encoders.noise": (0.0, 1e4, "counts"),
    "encoders.velocity_filter": (0.0, 10.0, "s"),
    "masses.cart": (1e-4, 1e4, "kg"),
    "masses.pole1": (1e-4, 1e4, "kg"),
    "masses.pole2": (1e-4, 1e4, "kg"),
    "delay": (0.0, MAX_DELAY, "s"),
    "supply": (1e-3, 1e4, "V"),
    "control_period": (1e-4, 1.0, "s"),
}
"""Least and largest of each number, and its unit: what carts on rails can have, from toys to cranes, with room to
spare. Beyond, a simulation overflows, or takes as long as it likes."""


class PlantError(ValueError):
    """A plant that cannot be; the message names file, field and mend."""


FORMAT = Format("plant file", "Plant.write", "write it again", 1_000_000, PlantError)


@dataclass(frozen=True, kw_only=True)
class Motor:
    """A DC motor that pulls the cart by a belt.

    Attributes:
        resistance: terminal resistance, ohm.
        constant: torque per ampere, N m/A; the same number is the back-EMF, V s/rad.
        pulley_radius: pitch radius of the belt pulley, m.
    """

    resistance: float = 1.2
    constant: float = 0.06
    pulley_radius: float = 0.0125

    def __post_init__(self) -> None:
        _physical(self, "resistance", "constant", "pulley_radius")

    @property
    def force_per_volt(self) -> float:
        """Force on the blocked cart, N/V."""
        return self.constant / self.pulley_radius / self.resistance

    @property
    def back_emf(self) -> float:
        """Braking by the motor's own voltage, N s/m."""
        return (self.constant / self.pulley_radius) ** 2 / self.resistance


@dataclass(frozen=True, kw_only=True)
class Friction:
    """Friction of rail and belt: viscous drag and the LuGre model of stick and slip.

    `coulomb = static = 0` means that only the viscous drag is there.

    Attributes:
        coulomb: sliding friction, N.
        static: force that breaks the cart away, N; at least `coulomb`.
        stribeck_velocity: speed at which friction has fallen most of the way from static to Coulomb, m/s.
        bristle_stiffness: force per metre of creep before the cart breaks away, N/m. The simulation integrates the
            bristle explicitly: 2e4 costs 0.4 % of accuracy at 1 ms, 1e5 already makes a limit cycle of its own.
        bristle_damping: N s/m.
        viscous: drag of the bearings, N s/m.

    Source:
        Canudas de Wit, Olsson, Astrom, Lischinsky, "A new model for control of systems with friction", IEEE
        Transactions on Automatic Control 40 (1995) 419-425.
    """

    coulomb: float = 8.0
    static: float = 11.0
    stribeck_velocity: float = 0.02
    bristle_stiffness: float = 2e4
    bristle_damping: float = 60.0
    viscous: float = 20.8

    def __post_init__(self) -> None:
        _physical(self, "stribeck_velocity", "bristle_stiffness", "coulomb", "static", "bristle_damping", "viscous")
        if self.static < self.coulomb:
            raise PlantError(
                f"friction.static is {self.static:g} N, below friction.coulomb {self.coulomb:g} N; set friction.static "
                "as well, to at least that"
            )
        if self.static > 0 and self.coulomb == 0:
            raise PlantError("friction.coulomb is 0 while friction.static is not; set both to 0 for no dry friction")


@dataclass(frozen=True, kw_only=True)
class Encoders:
    """Three incremental encoders and the filter that makes velocities of their readings.

    Velocity is the backward difference of the readings through a first-order low-pass, the "dirty derivative" of
    practice: v(k) = a v(k-1) + (1 - a) (p(k) - p(k-1)) / T with a = exp(-T / velocity_filter).

    Attributes:
        cart: metres per count; the default is 4096 counts a turn of the 12.5 mm pulley.
        pole: radians per count of the two angle encoders.
        noise: standard deviation of what is added to a position before it is rounded, counts.
        velocity_filter: time constant of the low-pass, s; 0 is the bare difference.
    """

    cart: float = 2 * math.pi * 0.0125 / 4096
    pole: float = 2 * math.pi / 4096
    noise: float = 0.0
    velocity_filter: float = 0.01

    def __post_init__(self) -> None:
        _physical(self, "cart", "pole", "noise", "velocity_filter")


@dataclass(frozen=True, kw_only=True)
class Masses:
    """Masses of the moving bodies; None leaves the model's. Moments of inertia change in proportion.

    Attributes:
        cart: kg, belt and rotor included.
        pole1: kg.
        pole2: kg.
    """

    cart: float | None = None
    pole1: float | None = None
    pole2: float | None = None

    def __post_init__(self) -> None:
        _physical(self, *self.given())

    def given(self) -> dict[str, float]:
        """The masses that are not left to the model, by body."""
        every = {"cart": self.cart, "pole1": self.pole1, "pole2": self.pole2}
        return {name: mass for name, mass in every.items() if mass is not None}


@dataclass(frozen=True, kw_only=True)
class Plant:
    """One rig. A number that is not given has the default rig's value.

    Attributes:
        motor: the motor; None leaves the model's as it is.
        friction: friction of the cart; None leaves the model's as it is.
        encoders: resolution, noise and velocity filter.
        masses: of cart and poles.
        delay: from a command to the motor's terminals, s, at most 1; 0 leaves the model's as it is.
        supply: largest voltage either way, V.
        control_period: time between two commands, s; a whole number of physics steps.

    Raises:
        PlantError: a number is outside of its range, see `RANGES`, or does not go with the others.

    Example:
        >>> dry = Plant(friction=Friction(coulomb=12.0, static=15.0))
        >>> Plant.from_dict(dry.to_dict()) == dry
        True
    """

    motor: Motor | None = field(default_factory=Motor)
    friction: Friction | None = field(default_factory=Friction)
    encoders: Encoders = field(default_factory=Encoders)
    masses: Masses = field(default_factory=Masses)
    delay: float = 0.0
    supply: float = 24.0
    control_period: float = 0.005

    def __post_init__(self) -> None:
        _physical(self, "supply", "control_period", "delay")

    @property
    def layout(self) -> tuple[object, ...]:
        """What plants that are simulated together share: actuators, supply and rhythm."""
        rough = None if self.friction is None else self.friction.coulomb > 0
        return self.motor is None, rough, self.supply, self.control_period

    # -------------------------------------------------------------------------------------------- files

    @classmethod
    def read(cls, path: str | Path, base: Plant | None = None) -> Plant:
        """Read a JSON file as `write` makes it; what the file leaves out comes from `base`.

        Raises:
            PlantError: the file is missing, not JSON, of a later format, or has a wrong or unknown field.
        """
        data = FORMAT.read(path)
        try:
            return cls.from_dict(data, base)
        except PlantError as error:
            raise PlantError(f"{path}: {error}") from None

    def write(self, path: str | Path) -> None:
        """Write the plant to a JSON file that `gymnasium.make(..., plant=path)` takes."""
        text = json.dumps({"schema": SCHEMA, **self.to_dict()}, indent=2)
        write_whole(path, (text + "\n").encode())

    def to_dict(self) -> dict[str, Any]:
        """The plant as plain numbers in nested dictionaries."""
        return dataclasses.asdict(self)

    @classmethod
    def from_dict(cls, data: Mapping[str, Any], base: Plant | None = None) -> Plant:
        """The plant `base` (default: the default rig) with the given fields changed.

        Raises:
            PlantError: an unknown field, or a value that is no number or impossible.
        """
        if not isinstance(data, Mapping):
            raise PlantError(f"a plant is a JSON object of named fields, not {type(data).__name__}")
        schema = data.get("schema", SCHEMA)
        if schema != SCHEMA:
            raise PlantError(f"schema is {shown(schema)}; this version reads {SCHEMA!r}")
        base = cls() if base is None else base
        values = {key: value for key, value in data.items() if key != "schema"}
        _known(cls, values)
        for name, kind in (
            ("motor", Motor),
            ("friction", Friction),
            ("encoders", Encoders),
            ("masses", Masses),
        ):
            if name in values:
                values[name] = _changed(getattr(base, name), kind, values[name], name)
        return dataclasses.replace(base, **values)

    @classmethod
    def of(cls, value: Plant | Mapping[str, Any] | str | Path | None, base: Plant | None = None) -> Plant:
        """A plant from any of the forms that the environment's `plant` argument takes."""
        if isinstance(value, Plant):
            return value
        if isinstance(value, (str, Path)):
            return cls.read(value, base)
        return cls.from_dict(value or {}, base)

    # -------------------------------------------------------------------------------------------- MJCF

    @classmethod
    def from_mjcf(cls, text: str) -> Plant:
        """The plant that a model's text describes.

        The motor is the `dcmotor` named `motor`. Friction is the damping of the joint `cart` and the LuGre friction of
        a passive `dcmotor` on it: the one named `friction`, or the only one there is. What the text does not say that
        way stays None, that is, as the model has it: `frictionloss`, and laws under `<custom>`.
        """
        return cls._of_tree(ET.fromstring(text))

    @classmethod
    def _of_tree(cls, root: ET.Element) -> Plant:
        motor = _actuator(root, "motor")
        found: dict[str, Any] = {"motor": None, "friction": _friction_of(root)}
        if motor is not None and motor.tag == "dcmotor" and {"resistance", "motorconst"} <= motor.attrib.keys():
            gear = _numbers(root, motor, "gear", "1")[0]
            if not gear > 0:
                raise PlantError(f"<dcmotor name='motor'>: gear is {gear:g}; a pulley's is 1 / radius, above 0")
            # Of two constants, torque's and back-EMF's, MuJoCo takes the geometric mean.
            constants = [k for k in _numbers(root, motor, "motorconst") if k > 0]
            found["motor"] = Motor(
                resistance=_numbers(root, motor, "resistance")[0],
                constant=math.prod(constants) ** (1 / max(len(constants), 1)),
                pulley_radius=1 / gear,
            )
        if motor is not None and effective(root, motor, "ctrlrange"):
            bounds = _numbers(root, motor, "ctrlrange")
            if len(bounds) != 2 or bounds[0] != -bounds[1]:
                raise PlantError(
                    f"<{motor.tag} name='motor'>: ctrlrange is {' '.join(f'{one:g}' for one in bounds)}; the "
                    "environment's supply drives either way alike, so write as much below 0 as above"
                )
            found["supply"] = abs(bounds[1])
        return cls(**found)

    def to_mjcf(self, text: str) -> str:
        """The model's text with this plant's motor, friction and supply written into it.

        Args:
            text: of the model, its includes put in place.

        Raises:
            PlantError: the text has no actuator `motor` or no joint `cart` to write to, or says by a law under
                `<custom>` how large the cart's dry friction is.
        """
        root = ET.fromstring(text)
        motor = _actuator(root, "motor")
        if motor is None:
            raise PlantError("the model's text has no actuator named 'motor'")
        # What is the same in the text stays as it stands there: it may say more than a plant knows of.
        given = Plant._of_tree(root)
        motor.set("ctrlrange", f"{-self.supply!r} {self.supply!r}")
        if self.motor is not None and self.motor != given.motor:
            if motor.tag != "dcmotor":
                raise PlantError(f"motor: the model's actuator is a <{motor.tag}>, not a <dcmotor>; leave it None")
            motor.set("resistance", repr(self.motor.resistance))
            motor.set("motorconst", repr(self.motor.constant))
            motor.set("gear", repr(1 / self.motor.pulley_radius))
        if self.friction is not None and self.friction != given.friction:
            self._write_friction(root, self.friction)
        if self.delay > 0:
            steps = [float(e.attrib["timestep"]) for e in root.iter("option") if "timestep" in e.attrib]
            timestep = steps[-1] if steps else 0.002  # as MuJoCo takes it
            motor.set("delay", repr(self.delay))
            motor.set("nsample", str(math.ceil(self.delay / timestep) + 2))
            motor.set("interp", "linear")
        for name, mass in self.masses.given().items():
            body = root.find(f".//body[@name='{name}']")
            inertial = None if body is None else body.find("inertial")
            if inertial is None or "diaginertia" not in inertial.attrib:
                raise PlantError(f"masses.{name}: the model has no body '{name}' with <inertial mass= diaginertia=>")
            scale = mass / _numbers(root, inertial, "mass")[0]
            inertial.set("diaginertia", " ".join(repr(i * scale) for i in _numbers(root, inertial, "diaginertia")))
            inertial.set("mass", repr(mass))
        return ET.tostring(root, encoding="unicode")

    def _write_friction(self, root: ET.Element, friction: Friction) -> None:
        joint = _joint(root, "cart")
        if joint is None:
            raise PlantError("friction: the model's text has no joint named 'cart'")
        law = _law(root)
        if law and friction.coulomb > 0:
            raise PlantError(
                f"friction: <custom> entry {shown(law)} says how large the dry friction of 'cart' is already; take it "
                "out of the model, or leave the plant's friction out"
            )
        # A polynomial's further terms stay.
        beyond = effective(root, joint, "damping").split()[1:]
        joint.set("damping", " ".join([repr(friction.viscous), *beyond]))
        if friction.coulomb > 0 and _frictionloss(root, joint):
            joint.set("frictionloss", "0")
        own = _bristles(root)
        for element in own:  # of names that the model's sensors may hold
            element.set("lugre", "0 0 0 0 0")
        if friction.coulomb == 0:
            for actuators in root.iter("actuator"):
                for element in actuators.findall("dcmotor[@name='friction']"):
                    actuators.remove(element)
        if friction.coulomb > 0:
            numbers = (
                friction.bristle_stiffness,
                friction.bristle_damping,
                friction.coulomb,
                friction.static,
                friction.stribeck_velocity,
            )
            lugre = " ".join(map(repr, numbers))
            if own:
                own[0].set("lugre", lugre)
            else:  # passive elements come last, so that the controls keep their places
                attributes = {"name": "friction", "joint": "cart", "input": "none", "motorconst": "0 0"}
                attributes |= {"resistance": "1", "lugre": lugre}
                ET.SubElement(ET.SubElement(root, "actuator"), "dcmotor", attributes)


def bristles(text: str) -> str:
    """Name of the passive motor that is the cart's dry friction in a model's text, empty where there is none."""
    found = _bristles(ET.fromstring(text))
    return found[0].get("name", "") if found else ""


def worked_out(text: str) -> tuple[float, float]:
    """What MuJoCo works out anew for each motor that is put into a model: the time constant of a winding of so many H,
    and the torque at a current limit of so many A; 0 where the model's motor has none.

    Args:
        text: of the model.

    Raises:
        PlantError: one of them is no number.
    """
    root = ET.fromstring(text)
    motor = _actuator(root, "motor")
    if motor is None or motor.tag != "dcmotor":
        return 0.0, 0.0
    inductance = _numbers(root, motor, "inductance", "0")[0]
    torque, current, *_ = [*_numbers(root, motor, "saturation", "0"), 0.0]
    return max(inductance, 0.0), current if torque == 0 else 0.0


# ------------------------------------------------------------------------------------------------ checks


def _physical(instance: Any, *names: str) -> None:
    part = "" if isinstance(instance, Plant) else type(instance).__name__.lower() + "."
    for name in names:
        value = getattr(instance, name)
        if isinstance(value, bool) or not isinstance(value, (int, float, np.integer, np.floating)):
            raise PlantError(f"{part}{name} must be a number, not {shown(value)}")
        least, most, unit = RANGES[part + name]
        if not least <= value <= most:
            raise PlantError(f"{part}{name} is {shown(value)}; it must be from {least:g} to {most:g} {unit}")
        object.__setattr__(instance, name, float(value))


def physics_steps(control_period: float, timestep: float) -> int:
    """How many physics steps a control period takes.

    Args:
        control_period: s.
        timestep: of the model, s.

    Raises:
        PlantError: it is no whole number of them, or more than a thousand.
    """
    steps = control_period / timestep
    if steps > MOST_STEPS:
        raise PlantError(
            f"control_period {control_period:g} s is {steps:.3g} physics steps of {timestep:g} s; take "
            f"{MOST_STEPS:,} at most, by a shorter period or a longer timestep"
        )
    if round(steps) < 1 or abs(steps - round(steps)) > 1e-6:
        raise PlantError(
            f"control_period {control_period:g} s is not a whole number of physics steps of {timestep:g} s"
        )
    return round(steps)


def _changed(current: Any, kind: type, changes: Any, where: str) -> Any:
    """`current`, a `kind` or None, with the named numbers changed."""
    if changes is None and kind not in (Encoders, Masses):
        return None
    if isinstance(changes, kind):
        return changes
    if not isinstance(changes, Mapping):
        raise PlantError(f"{where} must be an object of named numbers, not {shown(changes)}")
    _known(kind, changes, f"{where}.")
    if kind is Friction and current is None and "viscous" not in changes:
        raise PlantError(
            "friction: the model has dry friction of another kind, as frictionloss is, and a plant puts its own in the "
            "place of all of it; give friction.viscous as well"
        )
    return dataclasses.replace(kind() if current is None else current, **changes)


def _known(kind: Any, names: Iterable[str], where: str = "") -> None:
    known = [f.name for f in dataclasses.fields(kind)]
    for name in names:
        if name not in known:
            unknown, there_are = shown(f"{where}{name}"), ", ".join(where + n for n in known)
            raise PlantError(f"unknown field {unknown}; there are {there_are}{suggestion(name, known)}")


def _actuator(root: ET.Element, name: str) -> ET.Element | None:
    return next((e for group in root.iter("actuator") for e in group if e.get("name") == name), None)


def _joint(root: ET.Element, name: str) -> ET.Element | None:
    return next((e for e in root.iter("joint") if e.get("name") == name), None)


def _friction_of(root: ET.Element) -> Friction | None:
    """What a model's tree says of the cart's friction; None where it says it in a way that a plant does not know."""
    joint, found = _joint(root, "cart"), _bristles(root)
    if joint is None or len(found) > 1 or _frictionloss(root, joint) or _law(root):
        return None
    viscous = _numbers(root, joint, "damping", "0")[0]
    numbers = _numbers(root, found[0], "lugre", "0") if found else [0.0]
    if not any(numbers):
        return Friction(coulomb=0.0, static=0.0, viscous=viscous) if viscous >= 0 else None
    if len(numbers) != 5:
        raise PlantError(
            f"<dcmotor name={shown(found[0].get('name', ''))}>: lugre has {len(numbers)} numbers; the environment "
            "needs stiffness, damping, Coulomb and static friction, and Stribeck velocity"
        )
    stiffness, damping, coulomb, static, stribeck = numbers
    return Friction(
        coulomb=coulomb,
        static=static,
        stribeck_velocity=stribeck,
        bristle_stiffness=stiffness,
        bristle_damping=damping,
        viscous=viscous,
    )


def _bristles(root: ET.Element) -> list[ET.Element]:
    """Passive motors on the cart that are LuGre friction, the one named `friction` first."""
    found = [
        element
        for group in root.iter("actuator")
        for element in group.findall("dcmotor")
        if element.get("joint") == "cart"
        and effective(root, element, "input") == "none"
        and (element.get("name") == "friction" or any(_numbers(root, element, "lugre", "0")))
    ]
    return sorted(found, key=lambda element: element.get("name") != "friction")


def _frictionloss(root: ET.Element, joint: ET.Element) -> float:
    return _numbers(root, joint, "frictionloss", "0")[0]


def _law(root: ET.Element) -> str:
    """Name of the entry of `<custom>` that says how large the cart's dry friction is, empty where none does."""
    names = (element.get("name", "") for element in root.iter("numeric"))
    return next((name for name in names if name.startswith(f"{PREFIX}:friction.") and name.endswith(":cart")), "")


def _numbers(root: ET.Element, element: ET.Element, attribute: str, default: str = "") -> list[float]:
    """The numbers of an attribute, one at least."""
    text = effective(root, element, attribute, default)
    try:
        if numbers := [float(word) for word in text.split()]:
            return numbers
    except ValueError:
        pass
    named = f" name={shown(element.get('name'))}" if element.get("name") else ""
    raise PlantError(f"<{element.tag}{named}>: {attribute} is {shown(text)}; it must be one number or more")
