"""What can be hidden in each rig: every catalogue effect at every place where it makes sense, and unknown physics.

The same table serves twice. `draw` takes a size at random, log-uniform from clearly visible down to the noise
floor; `dipc_gym.trials.prediction` frees the same parameters to see whether another name explains a recording as well.
"""

from __future__ import annotations

import numpy as np

from dipc_gym.trials.entries import index
from dipc_gym.trials.hidden import Effect, Parameter
from dipc_gym.trials.rigs import Rig


def effects(rig: Rig) -> list[Effect]:
    """Every catalogue effect that makes sense on this rig, at every place where it does."""
    found = _motor(rig) + _drive(rig)
    for joint in range(rig.count):
        found += _joint(rig, joint)
    return found + (_rotor(rig) if rig.count > 1 else [])


def _units(rig: Rig, joint: int) -> tuple[str, str]:
    """Units of force and of length at a joint."""
    return ("N", "m") if rig.linear and joint == 0 else ("N m", "rad")


def _joint(rig: Rig, joint: int) -> list[Effect]:
    at = rig.joints[joint]
    force, speed, span = rig.force[joint], rig.speed[joint], rig.span[joint]
    n, m = _units(rig, joint)

    def place(name: str) -> int:
        return index(name, joint)

    level = Parameter("level", n, place("coulomb"), 0.0008 * force, 0.5 * force)
    pulse = (
        Parameter("force", n, place("pulse_size"), 0.02 * force, 1.5 * force, "signed"),
        Parameter("start", "s", place("pulse_start"), 3.0, 14.0, "uniform"),
        Parameter("duration", "s", place("pulse_length"), 0.03, 0.3),
    )
    found = [
        Effect("friction.coulomb", at, (level,)),
        Effect(
            "friction.viscous",
            at,
            (Parameter("damping", f"{n} s/{m}", place("damping"), 0.001 * force / speed, 0.5 * force / speed),),
        ),
        Effect(
            "drag.quadratic",
            at,
            (
                Parameter(
                    "drag", f"{n} s^2/{m}^2", place("quadratic"), 0.001 * force / speed**2, 0.4 * force / speed**2
                ),
            ),
        ),
        Effect(
            "load.spring",
            at,
            (Parameter("stiffness", f"{n}/{m}", place("spring"), 0.0015 * force / span, 0.8 * force / span),),
        )
        if rig.name != "motor_axis"
        else Effect(
            "load.spring",
            at,
            (Parameter("stiffness", f"{n}/{m}", place("spring"), 0.0005 * force / span, 0.2 * force / span),),
        ),
        Effect("load.constant", at, (Parameter("force", n, place("constant"), 0.001 * force, 0.4 * force, "signed"),)),
        Effect(
            "disturbance.periodic",
            at,
            (
                Parameter("amplitude", n, place("periodic_size"), 0.001 * force, 0.3 * force),
                Parameter("frequency", "rad/s", place("periodic_rate"), 4.0, 50.0),
                Parameter("phase", "rad", place("periodic_phase"), -np.pi, np.pi, "uniform"),
            ),
        ),
        Effect("disturbance.pulse", at, pulse, kind="half-sine"),
        Effect("disturbance.pulse", at, pulse, fixed=((place("pulse_square"), 1.0),), kind="square"),
    ]
    rotates = not (rig.linear and joint == 0)
    if rotates and rig.name != "motor_axis":
        found.append(Effect("sensor.bias", at, (Parameter("bias", m, place("bias"), 1e-4, 0.05, "signed"),)))
    if rig.name != "motor_axis":
        found.append(Effect("sensor.gain", at, (Parameter("gain", "1", place("gain"), 0.0005, 0.1, "signed"),)))
    longest = 0.004 if rig.name == "upright" else 0.012
    lag = Effect("timing.sensor_lag", at, (Parameter("delay", "s", place("lag"), 1e-4, longest),), kind="delay")
    smooth = Effect(
        "timing.sensor_lag", at, (Parameter("time_constant", "s", place("filter"), 1e-4, longest),), kind="filter"
    )
    return [*found, lag, smooth]


def _drive(rig: Rig) -> list[Effect]:
    """Effects at the driven joint only."""
    at = rig.joints[0]
    force, speed, span = rig.force[0], rig.speed[0], rig.span[0]
    n, m = _units(rig, 0)
    level = Parameter("level", n, index("coulomb", 0), 0.03 * force, 0.3 * force)
    stribeck = (
        level,
        Parameter("excess", n, index("excess", 0), 0.01 * force, 0.4 * force),
        Parameter("stribeck_speed", f"{m}/s", index("stribeck_speed", 0), 0.02 * speed, 0.15 * speed),
    )
    own = rig.parameters[index("m0")]
    turns = rig.gear if rig.linear else 1.0
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
            (level, Parameter("asymmetry", "1", index("asymmetry", 0), 0.03, 0.6, "signed")),
            includes=(*part, "load.constant"),
        ),
        Effect(
            "friction.position",
            at,
            (
                level,
                Parameter("variation", "1", index("place_size", 0), 0.1, 0.9),
                Parameter("wave", f"rad/{m}", index("place_wave", 0), np.pi / span, 8 * np.pi / span),
                Parameter("phase", "rad", index("place_phase", 0), -np.pi, np.pi, "uniform"),
            ),
            includes=part,
        ),
        Effect("friction.load", at, (Parameter("slope", "1", index("per_load", 0), 0.001, 0.3),), includes=part),
        Effect(
            "load.position",
            at,
            (
                Parameter("amplitude", n, index("force_size", 0), 0.0015 * force, 0.4 * force),
                Parameter("wave", f"rad/{m}", index("force_wave", 0), np.pi / span, 8 * np.pi / span),
                Parameter("phase", "rad", index("force_phase", 0), -np.pi, np.pi, "uniform"),
            ),
        ),
        Effect(
            "sensor.eccentric",
            at,
            (
                Parameter("amplitude", m, index("encoder_size"), 0.0005 * span, 0.01 * span),
                # An encoder on a hinge's axis turns with it, one on a belt with its pulley.
                Parameter("wave", f"rad/{m}", index("encoder_wave"), turns, turns * 1.001),
                Parameter("phase", "rad", index("encoder_phase"), -np.pi, np.pi, "uniform"),
            ),
        ),
        _mass(rig),
        Effect(
            "load.swinging",
            at,
            (
                Parameter("slosh_rate", "rad/s", index("slosh_rate"), 6.0, 30.0),
                Parameter("damping_ratio", "", index("slosh_damping"), 0.02, 0.2),
            ),
            fixed=((index("slosh_mass"), 0.15 * own), (index("m0"), -0.15 * own)),
        ),
        creeping(rig),
        resting(rig),
    ]
    if rig.name != "upright":  # which a stop throws off its balance
        hard = Parameter("stiffness", f"{n}/{m}", index("stop_stiffness", 0), own * 60.0**2, own * 600.0**2)
        soft = Parameter("drag", f"{n} s/{m}", index("stop_drag", 0), own * 20.0, own * 400.0)
        ends = Parameter("position", m, index("stop", 0), 0.3 * span, span, "signed")
        found.append(Effect("load.stop", at, (ends, hard, soft)))
    if rig.name != "motor_axis":
        found.append(
            Effect(
                "load.tilt", "world", (Parameter("tilt", "rad", index("tilt"), 1e-4, 0.06, "signed"),), also_at=(at,)
            )
        )
    return found


def _mass(rig: Rig) -> Effect:
    """More or less mass on the driven body."""
    at = rig.joints[0]
    if rig.name == "pendulum":
        com = rig.parameters[index("com1")]
        m1 = rig.parameters[index("m1")]
        extra = Parameter(
            "mass", "kg", index("m0"), 0.003 * m1, 0.4 * m1, factor=com**2, also=((index("mgl"), 9.81 * com),)
        )
        return Effect("inertia.mass", at, (extra,))
    own = rig.parameters[index("m0")]
    return Effect(
        "inertia.mass", at, (Parameter("mass", "kg" if rig.linear else "kg m^2", index("m0"), 0.003 * own, 0.4 * own),)
    )


def _rotor(rig: Rig) -> list[Effect]:
    """A flywheel that turns with the first pole; on the driven body it would be more of its mass."""
    of = rig.parameters
    carries = (
        of[index("m1")] * of[index("com1")] ** 2 + of[index("inertia1")] + of[index("m2")] * of[index("length1")] ** 2
    )
    extra = Parameter("inertia", "kg m^2", index("inertia1"), 0.003 * carries, 0.4 * carries)
    return [Effect("load.inertia", rig.joints[1], (extra,))]


def _motor(rig: Rig) -> list[Effect]:
    """Effects at the motor."""
    parameters, at = rig.parameters, rig.joints[0]
    n, m = _units(rig, 0)
    force, speed, span = rig.force[0], rig.speed[0], rig.span[0]
    volt = "V" if rig.voltage_driven else "N m"
    own, rotor = parameters[index("m0")], rig.rotor
    shared = rotor * (own - rotor) / own
    shaft = (index("rotor"), rotor), (index("m0"), -rotor)
    contact = rotor * 700.0**2
    longest = 0.004 if rig.name == "upright" else 0.012
    # The balancing rig falls where the limit is felt for long.
    least, most = (2.5, 7.0) if rig.name == "upright" else (0.8, 2.2)
    found = [
        Effect(
            "motor.deadzone",
            "motor",
            (Parameter("width", volt, index("dead"), 0.0015 * rig.command, 0.4 * rig.command),),
        ),
        Effect(
            "motor.saturation",
            "motor",
            (Parameter("voltage", volt, index("vlimit"), least * rig.command, most * rig.command),),
            kind="voltage",
        ),
        Effect("timing.delay", "motor", (Parameter("delay", "s", index("delay"), 1e-4, longest),)),
        Effect(
            "transmission.backlash",
            "motor",
            (Parameter("gap", m, index("gap"), 0.0003 * span, 0.04 * span),),
            fixed=(*shaft, (index("stiffness"), contact), (index("shaft_damping"), 0.3 * np.sqrt(contact * rotor))),
            also_at=(at,),
        ),
        Effect(
            "transmission.compliance",
            "motor",
            (
                Parameter(
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
        gain = parameters[index("kt")]
        back = Parameter("back_emf", "N m s/rad", index("ke"), 0.001 * force / speed / gain, 0.3 * force / speed / gain)
        return [*found, Effect("motor.back_emf", "motor", (back,), also_at=(at,))]
    resistance, ke, kt = parameters[index("resistance")], parameters[index("ke")], parameters[index("kt")]
    stall = rig.command * kt / resistance
    cogging = (
        Parameter("amplitude", n, index("cog_size"), 0.001 * force, 0.25 * force),
        Parameter("wave", f"rad/{m}", index("cog_wave"), 4 * rig.gear, 12 * rig.gear),
        Parameter("phase", "rad", index("cog_phase"), -np.pi, np.pi, "uniform"),
    )
    heat = rig.command**2 / resistance
    found += [
        Effect(
            "motor.saturation",
            "motor",
            (Parameter("force", n, index("flimit"), 0.7 * least * stall, 0.8 * most * stall),),
            kind="force",
        ),
        Effect(
            "motor.inductance",
            "motor",
            (Parameter("inductance", "H", index("inductance"), 1e-4 * resistance, 8e-3 * resistance),),
        ),
        Effect(
            "motor.back_emf",
            "motor",
            (Parameter("back_emf", f"V s/{m}", index("ke"), 0.003 * ke, 0.4 * ke, "signed"),),
            also_at=(at,),
        ),
        Effect("motor.cogging", "motor", cogging, also_at=(at,)),
        Effect(
            "motor.thermal",
            "motor",
            (
                Parameter(
                    "thermal_resistance", "K/W", index("heat_resistance"), 0.002 / 0.0039 / heat, 0.8 / 0.0039 / heat
                ),
                Parameter("time_constant", "s", index("heat_time"), 3.0, 15.0),
            ),
            fixed=((index("heat_coefficient"), 0.0039),),
        ),
    ]
    return found


def creeping(rig: Rig, *more: Parameter, kind: str = "") -> Effect:
    """A spring that creeps, at the driven joint."""
    force, span, (n, m) = rig.force[0], rig.span[0], _units(rig, 0)
    pulls = Parameter("stiffness", f"{n}/{m}", index("creep_stiffness"), 0.05 * force / span, 0.6 * force / span)
    gives = Parameter("relaxation_time", "s", index("creep_time"), 0.05, 1.0)
    alike = ("load.creeping",) if more else ()
    return Effect("load.creeping", rig.joints[0], (pulls, gives, *more), kind=kind, alike=alike)


def warming(rig: Rig) -> Effect:
    """Dry friction that grows while the rig runs, the slower the longer, at the driven joint."""
    force, (n, _) = rig.force[0], _units(rig, 0)
    grows = Parameter("drift", n, index("drift"), 0.05 * force, 0.3 * force)
    takes = Parameter("drift_time", "s", index("drift_time"), 3.0, 10.0)
    level = Parameter("level", n, index("coulomb", 0), 0.05 * force, 0.25 * force)
    kind = "dry friction that grows over the recording"
    return Effect("friction.time", rig.joints[0], (grows, takes, level), kind=kind, alike=("friction.time",))


def resting(rig: Rig, *more: Parameter, kind: str = "") -> Effect:
    """Dry friction that grows with the time at rest, at the driven joint."""
    force, (n, _) = rig.force[0], _units(rig, 0)
    rise = Parameter("rise", n, index("dwell"), 0.1 * force, 0.5 * force)
    takes = Parameter("time", "s", index("dwell_time"), 0.03, 0.4)
    level = Parameter("level", n, index("coulomb", 0), 0.05 * force, 0.25 * force)
    name, part = "friction.resting", ("friction.coulomb", "friction.stribeck")
    alike = (name,) if more else ()
    return Effect(name, rig.joints[0], (rise, takes, level, *more), includes=part, kind=kind, alike=alike)


def unknowns(rig: Rig) -> list[Effect]:
    """Physics that is in no catalogue, at the driven joint."""
    at = rig.joints[0]
    force, speed, (n, m) = rig.force[0], rig.speed[0], _units(rig, 0)
    found = [
        Effect(
            "unknown",
            at,
            (
                Parameter("thin", f"{n} s/{m}", index("thin"), 0.2 * force / speed, 1.5 * force / speed),
                Parameter("thin_time", "s", index("thin_time"), 0.1, 2.0),
                Parameter("thin_shear", f"{m}/s", index("thin_shear"), 0.1 * speed, 0.6 * speed),
            ),
            kind="drag that thins with motion",
        ),
        Effect(
            "unknown",
            at,
            (Parameter("leak", "1/s", index("leak"), -0.025, 0.04, "uniform"),),
            kind="load that changes its mass over the recording",
        ),
        Effect("unknown", "motor", (), also_at=(at,), kind="amplifier gain that wanders"),
    ]
    return found
