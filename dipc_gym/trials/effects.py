"""What can be hidden in a rig: each effect as numbers of the plant, with units and ranges to draw from.

The same table serves twice. `draw` takes a size at random, log-uniform from clearly visible down to the noise
floor; `dipc_gym.trials.windows` frees the same numbers to see whether another name explains a recording as well.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dipc_gym.trials.integrator import index
from dipc_gym.trials.rigs import Array, Rig


@dataclass(frozen=True)
class Number:
    """One number of an effect.

    Attributes:
        name: its natural name, such as `level`.
        unit: its unit.
        place: its place in the plant vector; `factor` times the number is added there.
        low: smallest value, or smallest magnitude for `signed`.
        high: largest.
        kind: `log`, `signed` (log-uniform magnitude, either sign) or `uniform`.
        factor: see `place`.
        also: further places that it is added to, with their factors.
    """

    name: str
    unit: str
    place: int
    low: float
    high: float
    kind: str = "log"
    factor: float = 1.0
    also: tuple[tuple[int, float], ...] = ()

    def draw(self, rng: np.random.Generator) -> float:
        """A value at random."""
        if self.kind == "uniform":
            return float(rng.uniform(self.low, self.high))
        value = float(np.exp(rng.uniform(np.log(self.low), np.log(self.high))))
        return value * float(rng.choice([-1.0, 1.0])) if self.kind == "signed" else value


@dataclass(frozen=True)
class Effect:
    """An effect that may act at one place of one rig.

    Attributes:
        name: id, such as `friction.coulomb`, or `unknown`.
        at: joint, actuator, sensor or body name, or `world`.
        numbers: its numbers; the first one is its size.
        fixed: plant entries that come with it, added: (place, value).
        also_at: other places that name the same thing.
        includes: ids that are honest parts of it.
        kind: for `unknown`, which one.
    """

    name: str
    at: str
    numbers: tuple[Number, ...]
    fixed: tuple[tuple[int, float], ...] = ()
    also_at: tuple[str, ...] = ()
    includes: tuple[str, ...] = ()
    kind: str = ""

    def apply(self, plant: Array, values: Array) -> Array:
        """The plant with this effect added."""
        result = plant.copy()
        for place, value in self.fixed:
            result[place] += value
        for number, value in zip(self.numbers, values, strict=True):
            result[number.place] += number.factor * value
            for place, factor in number.also:
                result[place] += factor * value
        return result


@dataclass(frozen=True)
class Hidden:
    """An effect with its values, as it acts in a trial."""

    effect: Effect
    values: tuple[float, ...]

    def apply(self, plant: Array) -> Array:
        """The plant with this effect added."""
        return self.effect.apply(plant, np.asarray(self.values))

    def parameters(self) -> dict[str, dict[str, float | str]]:
        """Natural parameters with units; a static level is also given as such."""
        found: dict[str, dict[str, float | str]] = {
            number.name: {"value": value, "unit": number.unit}
            for number, value in zip(self.effect.numbers, self.values, strict=True)
        }
        if self.effect.name == "friction.stribeck":
            level, excess = self.values[0], self.values[1]
            found["static"] = {"value": level + excess, "unit": self.effect.numbers[0].unit}
        if self.effect.name == "friction.asymmetric":
            level, share = self.values
            found["forward"] = {"value": level * (1 + share), "unit": self.effect.numbers[0].unit}
            found["backward"] = {"value": level * (1 - share), "unit": self.effect.numbers[0].unit}
        return found


def draw(effect: Effect, rng: np.random.Generator) -> Hidden:
    """The effect with values at random."""
    return Hidden(effect, tuple(number.draw(rng) for number in effect.numbers))


def effects(rig: Rig) -> list[Effect]:
    """Every catalogue effect that makes sense on this rig, at every place where it does."""
    found = _motor(rig) + _drive(rig)
    for joint in range(rig.count):
        found += _joint(rig, joint)
    return found


def _units(rig: Rig, joint: int) -> tuple[str, str]:
    """Units of force and of length at a joint."""
    return ("N", "m") if rig.linear and joint == 0 else ("N m", "rad")


def _joint(rig: Rig, joint: int) -> list[Effect]:
    at = rig.joints[joint]
    force, speed, span = rig.force[joint], rig.speed[joint], rig.span[joint]
    n, m = _units(rig, joint)

    def place(name: str) -> int:
        return index(name, joint)

    level = Number("level", n, place("coulomb"), 0.0008 * force, 0.5 * force)
    pulse = (
        Number("force", n, place("pulse_size"), 0.02 * force, 1.5 * force, "signed"),
        Number("start", "s", place("pulse_start"), 3.0, 14.0, "uniform"),
        Number("duration", "s", place("pulse_length"), 0.03, 0.3),
    )
    found = [
        Effect("friction.coulomb", at, (level,)),
        Effect(
            "friction.viscous",
            at,
            (Number("damping", f"{n} s/{m}", place("damping"), 0.001 * force / speed, 0.5 * force / speed),),
        ),
        Effect(
            "drag.quadratic",
            at,
            (Number("drag", f"{n} s^2/{m}^2", place("quadratic"), 0.001 * force / speed**2, 0.4 * force / speed**2),),
        ),
        Effect(
            "load.spring",
            at,
            (Number("stiffness", f"{n}/{m}", place("spring"), 0.0015 * force / span, 0.8 * force / span),),
        )
        if rig.name != "motor_axis"
        else Effect(
            "load.spring",
            at,
            (Number("stiffness", f"{n}/{m}", place("spring"), 0.0005 * force / span, 0.2 * force / span),),
        ),
        Effect("load.constant", at, (Number("force", n, place("constant"), 0.001 * force, 0.4 * force, "signed"),)),
        Effect(
            "disturbance.periodic",
            at,
            (
                Number("amplitude", n, place("periodic_size"), 0.001 * force, 0.3 * force),
                Number("frequency", "rad/s", place("periodic_rate"), 4.0, 50.0),
                Number("phase", "rad", place("periodic_phase"), -np.pi, np.pi, "uniform"),
            ),
        ),
        Effect("disturbance.pulse", at, pulse, kind="half-sine"),
        Effect("disturbance.pulse", at, pulse, fixed=((place("pulse_square"), 1.0),), kind="square"),
    ]
    rotates = not (rig.linear and joint == 0)
    if rotates and rig.name != "motor_axis":
        found.append(Effect("sensor.bias", at, (Number("bias", m, place("bias"), 1e-4, 0.05, "signed"),)))
    if rig.name != "motor_axis":
        found.append(Effect("sensor.gain", at, (Number("gain", "1", place("gain"), 0.0005, 0.1, "signed"),)))
    longest = 0.004 if rig.name == "upright" else 0.012
    lag = Effect("timing.sensor_lag", at, (Number("delay", "s", place("lag"), 1e-4, longest),), kind="delay")
    smooth = Effect(
        "timing.sensor_lag", at, (Number("time_constant", "s", place("filter"), 1e-4, longest),), kind="filter"
    )
    return [*found, lag, smooth]


def _drive(rig: Rig) -> list[Effect]:
    """Effects at the driven joint only."""
    at = rig.joints[0]
    force, speed, span = rig.force[0], rig.speed[0], rig.span[0]
    n, m = _units(rig, 0)
    level = Number("level", n, index("coulomb", 0), 0.03 * force, 0.3 * force)
    stribeck = (
        level,
        Number("excess", n, index("excess", 0), 0.01 * force, 0.4 * force),
        Number("stribeck_speed", f"{m}/s", index("stribeck_speed", 0), 0.02 * speed, 0.15 * speed),
    )
    own = rig.plant[index("m0")]
    # Bristles deflect by a few thousandths of the range before they slip.
    bristle = 0.15 * force / (0.003 * span)
    part = ("friction.coulomb",)
    found = [
        Effect("friction.stribeck", at, stribeck, includes=part),
        Effect(
            "friction.stribeck",
            at,
            stribeck,
            fixed=((index("bristle", 0), bristle), (index("bristle_damping", 0), 0.5 * np.sqrt(bristle * own))),
            includes=part,
            kind="bristle",
        ),
        Effect(
            "friction.asymmetric",
            at,
            (level, Number("asymmetry", "1", index("asymmetry", 0), 0.03, 0.6, "signed")),
            includes=(*part, "load.constant"),
        ),
        Effect(
            "friction.position",
            at,
            (
                level,
                Number("variation", "1", index("place_size", 0), 0.1, 0.9),
                Number("wave", f"rad/{m}", index("place_wave", 0), np.pi / span, 8 * np.pi / span),
                Number("phase", "rad", index("place_phase", 0), -np.pi, np.pi, "uniform"),
            ),
            includes=part,
        ),
        Effect("friction.load", at, (Number("slope", "1", index("per_load", 0), 0.001, 0.3),), includes=part),
        Effect(
            "load.position",
            at,
            (
                Number("amplitude", n, index("force_size", 0), 0.0015 * force, 0.4 * force),
                Number("wave", f"rad/{m}", index("force_wave", 0), np.pi / span, 8 * np.pi / span),
                Number("phase", "rad", index("force_phase", 0), -np.pi, np.pi, "uniform"),
            ),
        ),
        _mass(rig),
    ]
    if rig.name != "motor_axis":
        found.append(
            Effect("load.tilt", "world", (Number("tilt", "rad", index("tilt"), 1e-4, 0.06, "signed"),), also_at=(at,))
        )
    return found


def _mass(rig: Rig) -> Effect:
    """More or less mass on the driven body."""
    at = rig.joints[0]
    if rig.name == "pendulum":
        com = rig.plant[index("com1")]
        m1 = rig.plant[index("m1")]
        extra = Number(
            "mass", "kg", index("m0"), 0.003 * m1, 0.4 * m1, factor=com**2, also=((index("mgl"), 9.81 * com),)
        )
        return Effect("inertia.mass", at, (extra,))
    own = rig.plant[index("m0")]
    return Effect(
        "inertia.mass", at, (Number("mass", "kg" if rig.linear else "kg m^2", index("m0"), 0.003 * own, 0.4 * own),)
    )


def _motor(rig: Rig) -> list[Effect]:
    """Effects at the motor."""
    plant, at = rig.plant, rig.joints[0]
    n, m = _units(rig, 0)
    force, speed, span = rig.force[0], rig.speed[0], rig.span[0]
    volt = "V" if rig.voltage_driven else "N m"
    own, rotor = plant[index("m0")], rig.rotor
    shared = rotor * (own - rotor) / own
    shaft = (index("rotor"), rotor), (index("m0"), -rotor)
    contact = rotor * 700.0**2
    longest = 0.004 if rig.name == "upright" else 0.012
    # The balancing rig falls where the limit is felt for long.
    least, most = (2.5, 7.0) if rig.name == "upright" else (0.8, 2.2)
    found = [
        Effect(
            "motor.deadzone", "motor", (Number("width", volt, index("dead"), 0.0015 * rig.command, 0.4 * rig.command),)
        ),
        Effect(
            "motor.saturation",
            "motor",
            (Number("voltage", volt, index("vlimit"), least * rig.command, most * rig.command),),
            kind="voltage",
        ),
        Effect("timing.delay", "motor", (Number("delay", "s", index("delay"), 1e-4, longest),)),
        Effect(
            "transmission.backlash",
            "motor",
            (Number("gap", m, index("gap"), 0.0003 * span, 0.04 * span),),
            fixed=(*shaft, (index("stiffness"), contact), (index("shaft_damping"), 0.3 * np.sqrt(contact * rotor))),
            also_at=(at,),
        ),
        Effect(
            "transmission.compliance",
            "motor",
            (
                Number(
                    "stiffness",
                    f"{n}/{m}",
                    index("stiffness"),
                    shared * (2 * np.pi * 5) ** 2,
                    shared * (2 * np.pi * 60) ** 2,
                ),
            ),
            fixed=(*shaft, (index("shaft_damping"), 0.06 * shared * 2 * np.pi * 20)),
            also_at=(at,),
        ),
    ]
    if not rig.voltage_driven:
        gain = plant[index("kt")]
        back = Number("back_emf", "N m s/rad", index("ke"), 0.001 * force / speed / gain, 0.3 * force / speed / gain)
        return [*found, Effect("motor.back_emf", "motor", (back,), also_at=(at,))]
    resistance, ke, kt = plant[index("resistance")], plant[index("ke")], plant[index("kt")]
    stall = rig.command * kt / resistance
    cogging = (
        Number("amplitude", n, index("cog_size"), 0.001 * force, 0.25 * force),
        Number("wave", f"rad/{m}", index("cog_wave"), 4 * rig.gear, 12 * rig.gear),
        Number("phase", "rad", index("cog_phase"), -np.pi, np.pi, "uniform"),
    )
    heat = rig.command**2 / resistance
    found += [
        Effect(
            "motor.saturation",
            "motor",
            (Number("force", n, index("flimit"), 0.7 * least * stall, 0.8 * most * stall),),
            kind="force",
        ),
        Effect(
            "motor.inductance",
            "motor",
            (Number("inductance", "H", index("inductance"), 1e-4 * resistance, 8e-3 * resistance),),
        ),
        Effect(
            "motor.back_emf",
            "motor",
            (Number("back_emf", f"V s/{m}", index("ke"), 0.003 * ke, 0.4 * ke, "signed"),),
            also_at=(at,),
        ),
        Effect("motor.cogging", "motor", cogging, also_at=(at,)),
        Effect(
            "motor.thermal",
            "motor",
            (
                Number(
                    "thermal_resistance", "K/W", index("heat_resistance"), 0.002 / 0.0039 / heat, 0.8 / 0.0039 / heat
                ),
                Number("time_constant", "s", index("heat_time"), 3.0, 15.0),
            ),
            fixed=((index("heat_coefficient"), 0.0039),),
        ),
    ]
    return found


def unknowns(rig: Rig) -> list[Effect]:
    """Physics that is in no catalogue, at the driven joint."""
    at = rig.joints[0]
    force, span = rig.force[0], rig.span[0]
    n, m = _units(rig, 0)
    own = rig.plant[index("m0")]
    level = Number("level", n, index("coulomb", 0), 0.05 * force, 0.25 * force)
    part = ("friction.coulomb",)
    found = [
        Effect(
            "unknown",
            at,
            (
                Number("drift", n, index("drift"), 0.05 * force, 0.3 * force),
                Number("drift_time", "s", index("drift_time"), 3.0, 10.0),
                level,
            ),
            includes=part,
            kind="dry friction that grows over the recording",
        ),
        Effect(
            "unknown",
            at,
            (
                Number("dwell", n, index("dwell"), 0.1 * force, 0.5 * force),
                Number("dwell_time", "s", index("dwell_time"), 0.03, 0.4),
                level,
            ),
            includes=(*part, "friction.stribeck"),
            kind="breakaway force that grows with the time at rest",
        ),
        Effect(
            "unknown",
            at,
            (Number("slosh_rate", "rad/s", index("slosh_rate"), 6.0, 30.0),),
            fixed=((index("slosh_mass"), 0.15 * own), (index("m0"), -0.15 * own), (index("slosh_damping"), 0.05)),
            kind="sloshing load with a resonance of its own",
        ),
        Effect(
            "unknown",
            at,
            (
                Number("stiffness", f"{n}/{m}", index("creep_stiffness"), 0.05 * force / span, 0.6 * force / span),
                Number("creep_time", "s", index("creep_time"), 0.05, 1.0),
            ),
            kind="creeping (viscoelastic) spring",
        ),
        Effect(
            "unknown",
            at,
            (Number("leak", "1/s", index("leak"), -0.025, 0.04, "uniform"),),
            kind="load that changes its mass over the recording",
        ),
        Effect(
            "unknown",
            at,
            (
                Number("eccentricity", m, index("encoder_size"), 0.0005 * span, 0.01 * span, "signed"),
                Number(
                    "wave",
                    f"rad/{m}",
                    index("encoder_wave"),
                    (rig.gear if rig.linear else 1.0),
                    (rig.gear if rig.linear else 1.0) * 1.001,
                ),
            ),
            kind="eccentric encoder",
        ),
        Effect("unknown", "motor", (), also_at=(at,), kind="amplifier gain that wanders"),
    ]
    return found


RIVALS: dict[str, tuple[str, ...]] = {
    "friction.coulomb": ("motor.deadzone",),
    "friction.stribeck": ("friction.coulomb",),
    "friction.viscous": ("motor.back_emf",),
    "friction.asymmetric": ("friction.coulomb", "load.constant"),
    "friction.position": ("friction.coulomb",),
    "friction.load": ("friction.coulomb",),
    "load.constant": ("load.tilt", "sensor.bias"),
    "load.tilt": ("load.constant", "sensor.bias"),
    "load.spring": ("load.position", "motor.cogging"),
    "load.position": ("motor.cogging", "load.spring"),
    "inertia.mass": ("sensor.gain",),
    "motor.deadzone": ("friction.coulomb",),
    "motor.inductance": ("timing.delay", "timing.sensor_lag", "transmission.compliance"),
    "motor.back_emf": ("friction.viscous",),
    "motor.cogging": ("load.position",),
    "timing.delay": ("motor.inductance", "timing.sensor_lag"),
    "timing.sensor_lag": ("timing.delay", "motor.inductance"),
    "transmission.backlash": ("transmission.compliance",),
    "transmission.compliance": ("transmission.backlash", "motor.inductance", "timing.delay"),
    "sensor.bias": ("load.tilt", "load.constant"),
    "sensor.gain": ("inertia.mass",),
    "unknown": ("friction.stribeck", "load.spring", "transmission.compliance", "motor.thermal"),
}
"""Names that could be the same model as another on some rig; whether they are is worked out by simulation."""

SETS: dict[str, tuple[tuple[str, ...], ...]] = {"friction.asymmetric": (("friction.coulomb", "load.constant"),)}
"""Several effects at one place that together could be the same model as a single one."""
