"""Laws of any shape, for the trial of laws: of a kind that has a name, and of none.

Shapes are sums of bell curves, powers and exponentials, with numbers at random. The tool writes laws as straight lines
between knots, its formulas are sines, constants and squares, its friction with memory springs that slip, its loads hang
on springs of cubic pieces, its creeping springs creep by lines: none of these is one of them but by approximation.
"""

from __future__ import annotations

from dipc_gym.trials import integrator
from dipc_gym.trials.catalogue import creeping, resting, unknowns, warming
from dipc_gym.trials.entries import index
from dipc_gym.trials.hidden import Effect, Parameter
from dipc_gym.trials.rigs import Rig

NARROWEST, WIDEST = 0.08, 0.6
"""Widths of bell curves, in usual ranges of the input."""


def named(rig: Rig) -> list[Effect]:
    """Physics that has a name in kind, with a shape of its own.

    Of an axis that turns for good, nothing goes with where it is but what comes back with every turn.
    """
    at, force, speed, span = rig.joints[0], rig.force[0], rig.speed[0], rig.span[0]
    n, m = ("N", "m") if rig.linear else ("N m", "rad")
    middle, own = rig.start[0], rig.parameters[index("m0")]
    level = Parameter("level", n, index("coulomb", 0), 0.02 * force, 0.3 * force)
    found = [
        _law(
            "friction.position",
            at,
            integrator.LEVEL_OF_PLACE,
            (level, *_bumps(n, m, 0.03 * force, 0.4 * force, middle, span, "log")),
            alike=("friction.position",),
        ),
        _law(
            "friction.speed",
            at,
            integrator.LEVEL_OF_SPEED,
            (
                level,
                Parameter("fall", n, index("fall"), 0.02 * force, 0.2 * force),
                Parameter("fall_speed", f"{m}/s", index("fall_speed"), 0.05 * speed, 0.8 * speed),
                Parameter("fall_power", "", index("fall_power"), 0.5, 1.6),
                Parameter("rise", n, index("rise"), 0.02 * force, 0.3 * force),
                Parameter("rise_speed", f"{m}/s", index("rise_speed"), 0.7 * speed, 1.5 * speed),
                Parameter("rise_power", "", index("rise_power"), 0.4, 3.0),
            ),
            alike=("friction.speed", "friction.stribeck"),
        ),
        _law(
            "load.position",
            at,
            integrator.FORCE_OF_PLACE,
            _bumps(n, m, 0.03 * force, 0.4 * force, middle, span),
            alike=("load.position", "motor.cogging"),
            also_at=("motor",),
        ),
        _law(
            "motor.map",
            "motor",
            integrator.AMPLIFIER,
            _bumps("", "", 0.03 * rig.command, 0.3 * rig.command, 0.0, 1.5 * rig.command),
            alike=("motor.map", "motor.deadzone", "motor.saturation"),
            also_at=(at,),
        ),
        Effect(
            "friction.hysteresis",
            at,
            (
                Parameter("force", n, index("hysteresis"), 0.03 * force, 0.4 * force),
                Parameter("width", m, index("hysteresis_width"), 0.02 * span, 0.4 * span),
                Parameter("power", "", index("hysteresis_power"), 1.0, 3.0),
            ),
            kind="hysteresis after Bouc and Wen",
            alike=("friction.hysteresis", "friction.stribeck"),
        ),
        Effect(
            "load.swinging",
            at,
            (
                Parameter("slosh_rate", "rad/s", index("slosh_rate"), 6.0, 30.0),
                Parameter("slosh_damping", "", index("slosh_damping"), 0.02, 0.2),
                Parameter("slosh_bend", f"{m}/s^2", index("slosh_bend"), 0.3 * force / own, 3.0 * force / own),
                Parameter("slosh_power", "", index("slosh_power"), 0.15, 0.45, "signed"),
            ),
            fixed=((index("slosh_mass"), 0.15 * own), (index("m0"), -0.15 * own)),
            kind="load that swings wide by a law of its own",
            alike=("load.swinging",),
        ),
        creeping(
            rig,
            Parameter("creep_width", m, index("creep_width"), 0.05 * span, 0.5 * span),
            kind="spring that creeps the faster the more it is bent",
        ),
        _law(
            "friction.load",
            at,
            integrator.LEVEL_UNDER_LOAD,
            (
                Parameter("carried", "", index("carried"), 0.03, 0.3),
                Parameter("fall", "", index("fall"), 0.2, 1.5),
                Parameter("fall_speed", f"{m}/s", index("fall_speed"), 0.05 * speed, 0.5 * speed),
                Parameter("fall_power", "", index("fall_power"), 0.5, 1.6),
                level,
            ),
            alike=("friction.load",),
            kind="friction under load that weakens with speed",
        ),
        _sagging(rig),
        warming(rig),
        resting(
            rig,
            Parameter("dwell_power", "", index("dwell_power"), 0.35, 0.8),
            kind="dry friction that grows at rest, fast at first and for long",
        ),
        _law(
            "sensor.map",
            at,
            integrator.SCALE,
            _bumps(m, m, 0.0005 * span, 0.01 * span, middle, span),
            alike=("sensor.map", "sensor.eccentric"),
        ),
    ]
    of_place = ("friction.position", "load.position", "sensor.map")
    return [law for law in found if not (rig.name == "motor_axis" and law.name in of_place)]


def nameless(rig: Rig) -> list[Effect]:
    """Physics that has no name, and goes with the state or with its past."""
    at, force, speed, span = rig.joints[0], rig.force[0], rig.speed[0], rig.span[0]
    n, m = ("N", "m") if rig.linear else ("N m", "rad")
    middle, drag = rig.start[0], force / speed
    gain = force / rig.command
    found = [
        _law(
            "unknown",
            at,
            integrator.DRAG_OF_PLACE,
            _bumps(n, m, 0.05 * drag, 0.6 * drag, middle, span, "log"),
            kind="drag along a stretch of the way",
        ),
        _law(
            "unknown",
            at,
            integrator.GAIN_OF_PLACE,
            _bumps(n, m, 0.03 * gain, 0.3 * gain, middle, span),
            also_at=("motor",),
            kind="drive that is stronger here and weaker there",
        ),
    ]
    if rig.name == "motor_axis":  # goes round and round
        found = []
    found += [other for other in unknowns(rig) if other.kind.startswith("drag")]
    if rig.count > 1:
        pull = rig.force[1]
        found.append(
            _law(
                "unknown",
                rig.joints[1],
                integrator.PULL_OF_CART,
                _bumps("N m", "m", 0.05 * pull, 0.5 * pull, middle, span),
                kind="torque on a pole that goes with where the cart is",
            )
        )
    return found


def _sagging(rig: Rig) -> Effect:
    """A supply that gives way with a power of the current that was drawn of late."""
    usual = rig.command / rig.parameters[index("resistance")]
    return Effect(
        "motor.sag",
        "motor",
        (
            Parameter("sag", "", index("sag"), 0.03, 0.3),
            Parameter("sag_time", "s", index("sag_time"), 0.2, 5.0),
            Parameter("sag_power", "", index("sag_power"), 0.6, 2.0),
        ),
        fixed=((index("sag_current"), usual),),
        also_at=(rig.joints[0],),
        kind="supply that sags with past current",
        alike=("motor.sag",),
    )


def _law(
    name: str,
    at: str,
    law: int,
    numbers: tuple[Parameter, ...],
    *,
    alike: tuple[str, ...] = (),
    also_at: tuple[str, ...] = (),
    kind: str = "",
) -> Effect:
    return Effect(name, at, numbers, ((index("law"), float(law)),), also_at, (), kind or f"{name} of any shape", alike)


def _bumps(
    n: str, m: str, low: float, high: float, middle: float, span: float, kind: str = "signed"
) -> tuple[Parameter, ...]:
    """Heights, centres and widths of three bell curves within a usual range of the input."""
    return tuple(
        number
        for k in (1, 2, 3)
        for number in (
            Parameter(f"bump{k}", n, index(f"bump{k}"), low, high, kind),
            Parameter(f"centre{k}", m, index(f"centre{k}"), middle - 0.7 * span, middle + 0.7 * span, "uniform"),
            Parameter(f"width{k}", m, index(f"width{k}"), NARROWEST * span, WIDEST * span),
        )
    )
