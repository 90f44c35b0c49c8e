"""Entries of `<custom>`: which the loader understands, and what is refused of what a file says."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import mujoco
import numpy as np
from numpy.typing import NDArray

from dipc_gym import mjcf
from dipc_gym.physics import formulas
from dipc_gym.physics.formulas import Moment, moment
from dipc_gym.safety.naming import suggestion

Stage = Literal["command", "force", "friction", "sensor", "lag"]
Rule = Callable[[NDArray[np.float64], Moment], NDArray[np.float64]]
Array = NDArray[np.float64]

LARGEST = 1e9  # of an entry's numbers; of what comes of them, its square
CLOSEST = 1e-12  # of a table's knots, as a share of what they are, or of 1
SHORTEST_LAG, LONGEST_LAG = 1e-9, 1e6  # time constants, s
TRIED = (-100.0, -1.0, -1e-3, 0.0, 1e-3, 1.0, 100.0)  # positions, forces, commands and times
OUTERMOST = (-1e10, 1e10)  # MuJoCo bounds a state to this; what comes of it need but be a number
MOST_KNOTS = 1024  # of a table in a file: 257 of the finest law, and as many beyond either end of it
MOST_LEVELS = 4096  # of a surface
FEWEST_EVEN = 4  # numbers of a table of equal distances: its ends, and two levels
MOST_NUMBERS = 3 * MOST_LEVELS  # of any entry
HEAD = 16  # numbers of an entry that say more than one level of a table

_TABLES = frozenset({"motor.map", "sensor.map"})
_EVEN = frozenset({"friction.position", "friction.time"})  # tables of equal distances between two ends
# How many numbers an entry has, where its law has no table.
_COUNTS = {
    "motor.deadzone": 1,
    "sensor.gain": 1,
    "sensor.bias": 1,
    "sensor.eccentric": 3,
    "timing.sensor_lag": 1,
    "friction.wave": 4,
    "friction.load": 3,
    "friction.load_stribeck": 5,
    "disturbance.periodic": 3,
    "disturbance.pulse": 3,
    "friction.resting": 4,
    "motor.sag": 4,
}
_NEVER_NEGATIVE = {"motor.deadzone": 0, "disturbance.pulse": 2}  # which number: a width, a duration
CREEPING, HYSTERESIS = "load.creeping", "friction.hysteresis"
RESTING, RESTED_BY_LAW = "friction.resting", "friction.rested_by_law"
SAG, SAG_BY_LAW = "motor.sag", "motor.sag_by_law"
LOAD_BY_SPEED = "friction.load_by_speed"
# Dry friction that no forces at its joint change.
_PLACED = frozenset({"friction.position", "friction.time", "friction.wave", RESTING, RESTED_BY_LAW})
RESIDUAL = "residual.force"  # what a model lacks that has no name: a force of whatever the data say
RECENT = "residual.recent"  # the same of what went before

_rules: dict[str, tuple[Stage, Rule]] = {
    "motor.deadzone": ("command", formulas.deadzone),
    "sensor.gain": ("sensor", formulas.sensor_gain),
    "sensor.bias": ("sensor", formulas.sensor_bias),
    "sensor.eccentric": ("sensor", formulas.sensor_eccentric),
    "timing.sensor_lag": ("lag", formulas.lag),
    "friction.position": ("friction", formulas.friction_along),
    "motor.map": ("command", formulas.mapped),
    "sensor.map": ("sensor", formulas.mapped),
    "friction.time": ("friction", formulas.friction_over_time),
    "friction.wave": ("friction", formulas.friction_wave),
    "friction.load": ("friction", formulas.friction_under_load),
    "friction.load_stribeck": ("friction", formulas.friction_under_load_at_rest),
    LOAD_BY_SPEED: ("friction", formulas.friction_under_load_by_speed),
    "disturbance.periodic": ("force", formulas.periodic_force),
    "disturbance.pulse": ("force", formulas.pulse_force),
    CREEPING: ("force", formulas.creeping_force),
    RESTING: ("friction", formulas.friction_rested),
    RESTED_BY_LAW: ("friction", formulas.friction_rested_by_law),
    HYSTERESIS: ("force", formulas.hysteresis_force),
    SAG: ("force", formulas.sagging_force),
    SAG_BY_LAW: ("force", formulas.sagging_force_by_law),
    RESIDUAL: ("force", formulas.force_of),
    RECENT: ("force", formulas.force_of_recent),
}
_ALONE = frozenset(_rules) - {RESIDUAL, RECENT, SAG, SAG_BY_LAW}  # they depend on nothing beyond their place
_memories: dict[str, Rule] = {
    CREEPING: formulas.creeping,
    RESTING: formulas.resting,
    RESTED_BY_LAW: formulas.resting,
    HYSTERESIS: formulas.bending,
    SAG: formulas.sagging,
    SAG_BY_LAW: formulas.sagging_by_law,
    RECENT: formulas.recent,
}


def register(effect: str, stage: Stage, rule: Rule, memory: Rule | None = None) -> None:
    """Make the loader understand a further effect.

    Args:
        effect: its id, as in `dipc_gym:EFFECT:PLACE`.
        stage: where it acts.
        rule: `rule(data, moment)`; for `command` and `sensor` the new value, for `friction` the level of dry friction,
            for `force` the force to add.
        memory: of a force or a level of friction that depends on what went before: rate, per second, of the number that
            the moment has as `memory`, by the joint's position and speed and that number; it begins at 0.

    Raises:
        ValueError: the id is taken, or neither a force nor friction is to remember.
    """
    if effect in _rules:
        raise ValueError(f"an effect {effect!r} is registered already")
    if memory is not None and stage not in ("force", "friction"):
        raise ValueError(f"{effect!r} changes a {stage}: only a force or friction can remember")
    _rules[effect] = (stage, rule)
    if memory is not None:
        _memories[effect] = memory


def rules() -> list[tuple[str, Stage, Rule]]:
    """Every effect that the loader understands: id, stage, rule."""
    return [(effect, stage, rule) for effect, (stage, rule) in _rules.items()]


def memory_of(effect: str) -> Rule | None:
    """Rate of what an effect remembers; None for one that remembers nothing."""
    return _memories.get(effect)


@dataclass(frozen=True)
class Extra:
    """One entry of `<custom>`: a rule, the place it acts at, and its numbers.

    Attributes:
        effect: id of the effect.
        at: name of the actuator, sensor or joint.
        stage: where it acts.
        index: the control, sensor address or degree of freedom.
        data: the numbers, (k,), or (n, k) for n simulations.
        inputs: of a law that depends on more than its place: `position`, `velocity` or `command`, and the index of the
            coordinate, the degree of freedom or the control.
        slot: of MuJoCo's `userdata`, where it keeps what it remembers; -1 for nothing.
    """

    effect: str
    at: str
    stage: Stage
    index: int
    data: Array
    inputs: tuple[tuple[str, int], ...] = ()
    slot: int = -1

    @property
    def remembers(self) -> bool:
        """Whether what it does depends on what went before."""
        return self.slot >= 0

    @property
    def pressed(self) -> bool:
        """Whether it is dry friction that may depend on the forces at its joint, and not on place and time alone."""
        return self.stage == "friction" and self.effect not in _PLACED

    def __call__(self, now: Moment) -> Array:
        """Apply the rule."""
        return _rules[self.effect][1](self.data, now)

    def grows(self, now: Moment) -> Array:
        """Rate of what it remembers, per second."""
        return _memories[self.effect](self.data, now)


def read(model: mujoco.MjModel) -> list[Extra]:
    """The entries of a compiled model, in the order of the file.

    Raises:
        mjcf.MjcfError: one names an unknown effect or place, or has numbers that it cannot have.
    """
    extras = []
    for i in range(model.nnumeric):
        name = model.numeric(i).name
        if not name.startswith(mjcf.PREFIX + ":"):
            continue
        parts = name.split(":", 2)
        if len(parts) != 3 or parts[1] not in _rules:
            near = suggestion(parts[1] if len(parts) > 1 else "", _rules)
            raise mjcf.MjcfError(f"<custom> entry {name!r}: known effects are {', '.join(sorted(_rules))}{near}")
        stage = _rules[parts[1]][0]
        index, inputs = _index(model, name, stage, parts[2]), _inputs(model, parts[1], parts[2])
        extras.append(Extra(parts[1], parts[2], stage, index, model.numeric(i).data.copy(), inputs))
    _one_dry_law_each(extras)
    extras = _with_slots(model, extras)
    for extra in extras:
        if not usable(extra):
            entry, rule = f"{mjcf.PREFIX}:{extra.effect}:{extra.at}", (_rules[extra.effect][1].__doc__ or "").strip()
            raise mjcf.MjcfError(
                f"<custom> entry '{entry}' has the numbers {_shown(extra.data)}, too few, too many or out of range"
                f"{_fault(extra)}; {rule.partition(chr(10))[0]}"
            )
    return extras


def _one_dry_law_each(extras: Sequence[Extra]) -> None:
    """Refuse two laws that both say how large the dry friction of one joint is.

    Raises:
        mjcf.MjcfError: there are two.
    """
    first = dict[str, str]()
    for extra in extras:
        if extra.stage == "friction" and first.setdefault(extra.at, extra.effect) != extra.effect:
            raise mjcf.MjcfError(
                f"<custom> entry '{mjcf.PREFIX}:{extra.effect}:{extra.at}': {first[extra.at]} says how large the dry "
                f"friction of {extra.at!r} is already; keep one of them"
            )


def _with_slots(model: mujoco.MjModel, extras: list[Extra]) -> list[Extra]:
    """The last numbers of MuJoCo's `userdata` are what entries remember, in their order; those before are the user's.

    Raises:
        mjcf.MjcfError: there are fewer.
    """
    remember = [extra for extra in extras if extra.effect in _memories]
    first = model.nuserdata - len(remember)
    if first < 0:
        names = " and ".join(f"{mjcf.PREFIX}:{extra.effect}:{extra.at}" for extra in remember)
        raise mjcf.MjcfError(
            f"{names} under <custom> remember what went before, and the file keeps room for {model.nuserdata} numbers; "
            f'write <size nuserdata="{len(remember)}"/>'
        )
    slots = iter(range(first, model.nuserdata))
    return [replace(extra, slot=next(slots)) if extra.effect in _memories else extra for extra in extras]


def _shown(numbers: Array) -> str:
    """Numbers of an entry, the first of many."""
    more = f", and {len(numbers) - HEAD:,} more" if len(numbers) > HEAD else ""
    return f"{numbers[:HEAD].tolist()}{more}"


def _fault(extra: Extra) -> str:
    """What is wrong with the numbers of an entry, where one thing can be told; begins with a colon."""
    numbers = extra.data
    if len(numbers) > MOST_NUMBERS:
        return f": {len(numbers):,} numbers, more than {MOST_NUMBERS:,}"
    wild = np.flatnonzero(~(np.abs(numbers) <= LARGEST))
    if len(wild):
        return f": number {wild[0] + 1} is {numbers[wild[0]]:g}"
    if extra.effect in _TABLES and len(numbers) % 2 == 0 and not _increase(numbers[: len(numbers) // 2]):
        return ": its knots do not increase"
    if extra.effect in _EVEN and len(numbers) > 1 and not _increase(numbers[:2]):
        return f": it goes from {numbers[0]:g} to {numbers[1]:g}"
    if extra.effect != RESIDUAL or len(numbers) < 3 or not np.all(numbers[1:3] == np.round(numbers[1:3])):
        return ""
    m, n = int(numbers[1]), int(numbers[2])
    if numbers[0] <= 0:
        return f": its speed is {numbers[0]:g}, and must be positive"
    if m * n > MOST_LEVELS:
        return f": a table of {m} x {n} is {m * n:,} levels, more than {MOST_LEVELS:,}"
    if len(numbers) != 3 + m + n + m * n:
        return f": a table of {m} x {n} has {3 + m + n + m * n} numbers, not {len(numbers)}"
    if not (_increase(numbers[3 : 3 + m]) and _increase(numbers[3 + m : 3 + m + n])):
        return ": its knots do not increase"
    return ": what it depends on is not said" if not extra.inputs else ""


def _increase(knots: Array) -> bool:
    """Whether knots increase by steps that numbers of their size can tell, and that can be divided by."""
    return bool(np.all(np.diff(knots) > CLOSEST * np.maximum(1.0, np.abs(knots[1:]))))


def usable(extra: Extra) -> bool:
    """Whether an entry's numbers give numbers, wherever a joint is and whenever it is."""
    numbers = extra.data
    if not (0 < len(numbers) <= MOST_NUMBERS and np.all(np.abs(numbers) <= LARGEST)):
        return False
    if len(numbers) != _COUNTS.get(extra.effect, len(numbers)):
        return False
    if extra.effect in _NEVER_NEGATIVE and numbers[_NEVER_NEGATIVE[extra.effect]] < 0:
        return False
    if extra.stage == "lag" and not SHORTEST_LAG <= numbers[0] <= LONGEST_LAG:
        return False
    # A table of bounded levels over knots that increase gives bounded numbers everywhere.
    if extra.effect in _TABLES:
        knots = numbers[: len(numbers) // 2]
        return len(numbers) % 2 == 0 and 2 <= len(knots) <= MOST_KNOTS and _increase(knots)
    if extra.effect in _EVEN:
        return len(numbers) >= FEWEST_EVEN and _increase(numbers[:2])
    if extra.effect == RESIDUAL:
        return _is_surface(numbers, len(extra.inputs))
    if extra.effect == RECENT:  # its table has two inputs: what it remembers of the one that is named, and that one
        return bool(numbers[0] >= formulas.SOONEST) and len(extra.inputs) == 1 and _is_surface(numbers[1:], 2)
    if extra.effect == SAG:  # one that gives more the more was drawn would drive its joint for ever
        return bool(numbers[2] >= 0 and numbers[3] >= formulas.SOONEST) and _commanded(extra)
    if extra.effect == SAG_BY_LAW:
        lasts = len(numbers) >= 3 + FEWEST_EVEN and bool(numbers[2] >= formulas.SOONEST and numbers[3] > CLOSEST)
        return lasts and bool(np.all(numbers[4:] >= 0)) and _commanded(extra)
    if extra.effect == CREEPING:  # one that pushes, or stretches of its own, would drive its joint for ever
        return len(numbers) >= FEWEST_EVEN and bool(np.all(numbers >= 0)) and bool(numbers[1] > CLOSEST)
    if extra.effect == HYSTERESIS:  # a loop that is stiffer loading than unloading would give energy away
        falls = len(numbers) >= FEWEST_EVEN and bool(np.all(np.diff(numbers[1:]) <= 0))
        return falls and bool(numbers[0] > CLOSEST) and numbers[-1] == 0
    if extra.effect == RESTING:
        return bool(np.all(numbers[2:] > CLOSEST))
    if extra.effect == RESTED_BY_LAW:
        return len(numbers) >= 2 + FEWEST_EVEN and bool(np.all(numbers[1:4] > CLOSEST))
    if extra.effect == LOAD_BY_SPEED:
        lasts = len(numbers) >= 3 + FEWEST_EVEN and bool(np.all(numbers[3:5] > CLOSEST))
        return lasts and bool(np.all(numbers >= 0))
    # At its own numbers as positions a wave of no length shows itself.
    usual = np.unique([*numbers[:HEAD], numbers.min(), numbers.max(), *TRIED])
    try:
        with np.errstate(all="ignore"):
            near, far = _alike(extra, usual), _alike(extra, np.array(OUTERMOST))
        return bool(np.all(np.abs(near) <= LARGEST**2) and np.all(np.isfinite(far)))
    except (IndexError, ValueError):
        return False


def _commanded(extra: Extra) -> bool:
    """Whether an entry depends on one command, and says so."""
    return [kind for kind, _ in extra.inputs] == ["command"]


def _alike(extra: Extra, x: Array) -> Array:
    """What comes of an entry where position, force, command, time and all else are the same number of x (n,)."""
    everywhere = replace(extra, data=np.broadcast_to(extra.data, (len(x), len(extra.data))))
    now = replace(moment(np.abs(x), x, x, x, x), speed=x, inputs=(x, x), memory=x)
    return np.stack([everywhere(now), everywhere.grows(now)]) if extra.remembers else everywhere(now)


def _is_surface(numbers: Array, inputs: int) -> bool:
    """Whether numbers are those of a residual law, and what it depends on is said."""
    head, remainder = numbers[:3], numbers[3:]
    if len(head) < 3 or not 1 <= inputs <= 2 or head[0] <= 0:
        return False
    if not (np.all(head[1:] == np.round(head[1:])) and head[1] >= 2 and inputs <= head[2] <= MOST_LEVELS):
        return False
    if inputs == 1 and head[2] != 1:
        return False
    m, n = int(head[1]), int(head[2])
    sorted_ = _increase(remainder[:m]) and _increase(remainder[m : m + n])
    return bool(m * n <= MOST_LEVELS and len(remainder) == m + n + m * n and sorted_)


def _inputs(model: mujoco.MjModel, effect: str, at: str) -> tuple[tuple[str, int], ...]:
    """What a law depends on beyond its place, as `<text>` of `<custom>` names it."""
    texts = mjcf.texts(model)
    if effect in _ALONE:
        if (name := f"{mjcf.INPUTS}1:{effect}:{at}") in texts:
            raise mjcf.MjcfError(f"<custom> entry {name!r}: {effect} depends on nothing beyond its place; take it out")
        return ()
    joints = {model.joint(j).name: j for j in range(model.njnt)}
    commands = {control: k for k, control in enumerate(mjcf.controls(model))}
    found = []
    for name in (f"{mjcf.INPUTS}{k}:{effect}:{at}" for k in (1, 2)):
        if name not in texts:
            break
        kind, _, of = texts[name].partition(" ")
        known = {"position": joints, "velocity": joints, "command": commands}.get(kind)
        if known is None or of not in known:
            what = f"{', '.join(known)}{suggestion(of, known)}" if known else "position, velocity and command"
            raise mjcf.MjcfError(f"<custom> entry {name!r}: no {texts[name]!r} in the model; there are {what}")
        address = {"position": model.jnt_qposadr, "velocity": model.jnt_dofadr}.get(kind)
        found.append((kind, known[of] if address is None else int(address[known[of]])))
    return tuple(found)


def _index(model: mujoco.MjModel, name: str, stage: Stage, at: str) -> int:
    known: Mapping[str, int]
    if stage == "command":
        known = {control: i for i, control in enumerate(mjcf.controls(model))}
    elif stage in ("sensor", "lag"):
        addresses = mjcf.sensor_addresses(model)
        known = {sensor: int(a) for sensor, a in zip(mjcf.scalar_sensors(model), addresses, strict=True)}
    else:
        known = {model.joint(j).name: int(model.jnt_dofadr[j]) for j in range(model.njnt)}
    if at not in known:
        there_are = f"there are {', '.join(known)}{suggestion(at, known)}"
        raise mjcf.MjcfError(f"<custom> entry {name!r}: no {at!r} in the model; {there_are}")
    return known[at]
