"""The parameters of a rig, hidden effects included, as one flat vector; zero means "not there"."""

from __future__ import annotations

MAX_JOINTS = 3  # of a rig

GLOBAL = (
    "m0", "m1", "m2", "com1", "com2", "inertia1", "inertia2", "length1", "gravity", "tilt", "mgl",  # bodies
    "kt", "ke", "resistance", "inductance", "dead", "vlimit", "flimit",  # motor, seen at the joint
    "cog_size", "cog_wave", "cog_phase",
    "heat_coefficient", "heat_resistance", "heat_time", "delay",
    "rotor", "gap", "stiffness", "shaft_damping",  # transmission
    "drift", "drift_time",
    "dwell", "dwell_time", "dwell_power",  # friction that grows at rest, of its own shape if of a power
    "slosh_mass", "slosh_rate", "slosh_damping", "slosh_bend", "slosh_power",  # a load that swings, bent if of a power
    "creep_stiffness", "creep_time", "creep_width",  # a spring that gives way, the sooner the farther if of a width
    "leak", "encoder_size", "encoder_wave", "encoder_phase",
    "law", "bump1", "centre1", "width1", "bump2", "centre2", "width2", "bump3", "centre3", "width3",  # of any shape
    "fall", "fall_speed", "fall_power", "rise", "rise_speed", "rise_power",
    "hysteresis", "hysteresis_width", "hysteresis_power",
    "carried",  # friction under load that weakens with speed
    "sag", "sag_current", "sag_time", "sag_power",  # a supply that gives way under what was drawn from it
    "thin", "thin_time", "thin_shear",  # drag that thins with motion; in no catalogue
)  # fmt: skip

JOINT = (
    "damping", "quadratic", "coulomb", "asymmetry", "excess", "stribeck_speed", "bristle", "bristle_damping",
    "place_size", "place_wave", "place_phase", "per_load", "constant", "spring",
    "force_size", "force_wave", "force_phase",
    "periodic_size", "periodic_rate", "periodic_phase", "pulse_size", "pulse_start", "pulse_length", "pulse_square",
    "bias", "gain", "lag", "filter",
    "stop", "stop_stiffness", "stop_drag",  # where its way ends, on the side of its sign
)  # fmt: skip
JOINT_BASE = len(GLOBAL)
JOINT_SIZE = len(JOINT)
SIZE = JOINT_BASE + MAX_JOINTS * JOINT_SIZE


def index(name: str, joint: int | None = None) -> int:
    """Place of a parameter in that vector.

    Args:
        name: one of `GLOBAL`, or one of `JOINT` together with `joint`.
        joint: joint number, 0 is the driven one.

    Example:
        >>> index("m0")
        0
    """
    if joint is None:
        return GLOBAL.index(name)
    return JOINT_BASE + joint * JOINT_SIZE + JOINT.index(name)
