"""Units that recordings come in, and their factors to SI."""

from __future__ import annotations

import math
from collections.abc import Mapping

import mujoco

from dipc_gym.mjcf import gear, servo, units
from dipc_gym.safety.naming import suggestion

_TURN = 2 * math.pi  # rad

# By the SI unit of what they measure.
KINDS: Mapping[str, Mapping[str, float]] = {
    "s": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0},
    "rad": {"rad": 1.0, "mrad": 1e-3, "deg": math.pi / 180, "rev": _TURN},
    "rad/s": {"rad/s": 1.0, "deg/s": math.pi / 180, "rev/s": _TURN, "rpm": _TURN / 60},
    "m": {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "in": 0.0254},
    "m/s": {"m/s": 1.0, "cm/s": 1e-2, "mm/s": 1e-3},
    "m/s^2": {"m/s2": 1.0, "g0": 9.80665},
    "rad/s^2": {"rad/s2": 1.0, "deg/s2": math.pi / 180},
    "V": {"V": 1.0, "mV": 1e-3},
    "A": {"A": 1.0, "mA": 1e-3},
    "N": {"N": 1.0, "mN": 1e-3, "kN": 1e3},
    "N m": {"Nm": 1.0, "mNm": 1e-3, "Ncm": 1e-2},
    "": {"%": 1e-2},
}
# To SI.
FACTORS: dict[str, float] = {unit: number for kind in KINDS.values() for unit, number in kind.items()}


def likely_time(step: float) -> str:
    """In what time was most likely counted, where samples are `step` apart and too many for seconds.

    Rigs are sampled at more than 10 Hz, and at 10 kHz at most.

    Example:
        >>> likely_time(2.0), likely_time(100.0), likely_time(2e6)
        ('ms', 'us', 'ns')
    """
    return "ns" if step >= 1e5 else "us" if step >= 100 else "ms"


def check_kind(unit: str, si: str) -> None:
    """Refuse a unit that measures something else; factors as numbers measure anything.

    Args:
        unit: as `factor` takes it.
        si: SI unit of what it is given for; empty where nobody knows.

    Raises:
        ValueError: naming the units that would do.

    Example:
        >>> check_kind("mm", "rad")
        Traceback (most recent call last):
        ValueError: it is measured in rad: use rad, mrad, deg, rev or a number (the factor to rad)
    """
    unit = unit.removeprefix("-")
    if si and unit in FACTORS and unit not in KINDS[si]:
        raise ValueError(f"it is measured in {si}: use {', '.join(KINDS[si])} or a number (the factor to {si})")


def factor(unit: str) -> float:
    """What a number in this unit is multiplied with to be in SI.

    Args:
        unit: a name from the list, with a minus before it where the other way is positive, or the factor itself as a
            number (for encoder counts, say).

    Raises:
        ValueError: neither of the two; the message lists the names.

    Example:
        >>> factor("mm")
        0.001
        >>> factor("-mm")
        -0.001
        >>> factor("0.5")
        0.5
    """
    name = unit.removeprefix("-")
    if name in FACTORS:
        return -FACTORS[name] if unit != name else FACTORS[name]
    try:
        value = float(unit)
    except ValueError:
        value = math.nan
    if not math.isfinite(value) or value == 0:
        raise ValueError(
            f"unknown unit {unit!r}; use a number (the factor to SI) or one of {', '.join(FACTORS)}"
            f"{suggestion(name, FACTORS)}"
        )
    return value


def of_sensor(model: mujoco.MjModel, name: str) -> str:
    """SI unit of a joint, tendon or actuator sensor's reading; empty where it is none of these, or mixes units."""
    kind = mujoco.mjtSensor
    sensor = model.sensor(name).id
    what, of = int(model.sensor_type[sensor]), int(model.sensor_objid[sensor])
    if what in (int(kind.mjSENS_JOINTPOS), int(kind.mjSENS_JOINTVEL)):
        joints = [of]
    elif what in (int(kind.mjSENS_TENDONPOS), int(kind.mjSENS_TENDONVEL)):
        wraps = range(model.tendon_adr[of], model.tendon_adr[of] + model.tendon_num[of])
        joints = [int(model.wrap_objid[w]) for w in wraps if model.wrap_type[w] == mujoco.mjtWrap.mjWRAP_JOINT]
    elif what in (int(kind.mjSENS_ACTUATORPOS), int(kind.mjSENS_ACTUATORVEL)):
        on_joint = model.actuator_trntype[of] == mujoco.mjtTrn.mjTRN_JOINT
        joints = [int(model.actuator_trnid[of, 0])] if on_joint and abs(gear(model, of)) == 1 else []
    else:
        return ""
    lengths = {units(model, joint).length for joint in joints}
    if len(lengths) != 1:
        return ""
    speed = what in (int(kind.mjSENS_JOINTVEL), int(kind.mjSENS_TENDONVEL), int(kind.mjSENS_ACTUATORVEL))
    return lengths.pop() + ("/s" if speed else "")


def commanded_by(model: mujoco.MjModel, control: str) -> int:
    """Number of the actuator that a control belongs to; of one with several inputs it is called `servo.pos`."""
    known = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_ACTUATOR, control)
    return known if known >= 0 else int(model.actuator(control.rpartition(".")[0]).id)


def of_command(model: mujoco.MjModel, control: str) -> str:
    """SI unit of what is sent to an actuator; empty where its gear makes a force of a number of its own.

    Args:
        model: compiled.
        control: as `mjcf.controls` names it; of an actuator with several inputs `servo.pos` or `servo.vel`.
    """
    i = commanded_by(model, control)
    several = model.actuator_ctrlnum[i] > 1
    asked = control.rpartition(".")[2] if several else mujoco.mj_actuatorInputName(model, i, 0)
    if asked == "voltage":
        return "V"
    on_joint = model.actuator_trntype[i] == mujoco.mjtTrn.mjTRN_JOINT
    if not on_joint or abs(gear(model, i)) != 1:
        return ""
    force, length, _ = units(model, int(model.actuator_trnid[i, 0]))
    asked = asked if asked in ("pos", "vel") else servo(model, i)  # a <general> says neither
    if asked in ("pos", "vel"):
        return length if asked == "pos" else f"{length}/s"
    fixed = model.actuator_gaintype[i] == mujoco.mjtGain.mjGAIN_FIXED and model.actuator_gainprm[i, 0] == 1
    return force if fixed and model.actuator_biastype[i] == mujoco.mjtBias.mjBIAS_NONE else ""
