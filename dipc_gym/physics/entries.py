"""Entries of `<custom>`: of each, where it acts, its formula, and which numbers it takes; one's own are registered."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from dipc_gym.physics import formulas, numbers
from dipc_gym.physics.formulas import Moment, moment
from dipc_gym.physics.numbers import LARGEST, Check, Inputs

Stage = Literal["command", "force", "friction", "sensor", "lag"]
Rule = Callable[[NDArray[np.float64], Moment], NDArray[np.float64]]
Array = NDArray[np.float64]

SAG, SAG_BY_LAW = "motor.sag", "motor.sag_by_law"
RESTED_BY_LAW = "friction.rested_by_law"
RESIDUAL = "residual.force"  # what a model lacks that has no name: a force of whatever the data say
RECENT = "residual.recent"  # the same of what went before

TRIED = (-100.0, -1.0, -1e-3, 0.0, 1e-3, 1.0, 100.0)  # positions, forces, commands and times
OUTERMOST = (-1e10, 1e10)  # MuJoCo bounds a state to this; what comes of it need but be a number
HEAD = 16  # numbers of an entry that say more than one level of a table


@dataclass(frozen=True, eq=False)  # there is one of each effect; every simulation asks whether they are the same ones
class Entry:
    """What entries of one effect are.

    Attributes:
        effect: its id, as in `dipc_gym:EFFECT:PLACE`.
        stage: where it acts.
        rule: `rule(data, moment)`; for `command` and `sensor` the new value, for `friction` the level of dry friction,
            for `force` the force to add.
        check: of its numbers, see `numbers`; None where nothing is known of them, so that the rule is tried.
        tried: whether the check is no proof, so that the rule is tried as well.
        memory: of what depends on what went before: rate, per second, of the number that the moment has as `memory`, by
            the joint's position and speed and that number; it begins at 0.
        alone: whether it depends on nothing beyond its place.
        pressed: of dry friction, whether forces at its joint may change it, and not place and time alone.
    """

    effect: str
    stage: Stage
    rule: Rule
    check: Check | None = None
    tried: bool = False
    memory: Rule | None = None
    alone: bool = True
    pressed: bool = False


_known = {
    entry.effect: entry
    for entry in (
        Entry("motor.deadzone", "command", formulas.deadzone, numbers.plain(1, never_negative=0), tried=True),
        Entry("motor.map", "command", formulas.mapped, numbers.table),
        Entry("sensor.gain", "sensor", formulas.sensor_gain, numbers.plain(1), tried=True),
        Entry("sensor.bias", "sensor", formulas.sensor_bias, numbers.plain(1), tried=True),
        Entry("sensor.eccentric", "sensor", formulas.sensor_eccentric, numbers.plain(3), tried=True),
        Entry("sensor.map", "sensor", formulas.mapped, numbers.table),
        Entry("timing.sensor_lag", "lag", formulas.lag, numbers.lag),
        Entry("friction.position", "friction", formulas.friction_along, numbers.even_table),
        Entry("friction.time", "friction", formulas.friction_over_time, numbers.even_table),
        Entry("friction.wave", "friction", formulas.friction_wave, numbers.plain(4), tried=True),
        Entry("friction.load", "friction", formulas.friction_under_load, numbers.plain(3), tried=True, pressed=True),
        Entry(
            "friction.load_stribeck",
            "friction",
            formulas.friction_under_load_at_rest,
            numbers.plain(5),
            tried=True,
            pressed=True,
        ),
        Entry(
            "friction.load_by_speed",
            "friction",
            formulas.friction_under_load_by_speed,
            numbers.load_table,
            pressed=True,
        ),
        Entry("friction.resting", "friction", formulas.friction_rested, numbers.rest, memory=formulas.resting),
        Entry(RESTED_BY_LAW, "friction", formulas.friction_rested_by_law, numbers.rest_table, memory=formulas.resting),
        Entry("friction.hysteresis", "force", formulas.hysteresis_force, numbers.loop, memory=formulas.bending),
        Entry("load.creeping", "force", formulas.creeping_force, numbers.creep, memory=formulas.creeping),
        Entry("disturbance.periodic", "force", formulas.periodic_force, numbers.plain(3), tried=True),
        Entry("disturbance.pulse", "force", formulas.pulse_force, numbers.plain(3, never_negative=2), tried=True),
        Entry(SAG, "force", formulas.sagging_force, numbers.sag, memory=formulas.sagging, alone=False),
        Entry(
            SAG_BY_LAW,
            "force",
            formulas.sagging_force_by_law,
            numbers.sag_table,
            memory=formulas.sagging_by_law,
            alone=False,
        ),
        Entry(RESIDUAL, "force", formulas.force_of, numbers.surface, alone=False),
        Entry(RECENT, "force", formulas.force_of_recent, numbers.recent_surface, memory=formulas.recent, alone=False),
    )
}


def register(effect: str, stage: Stage, rule: Rule, memory: Rule | None = None) -> None:
    """Make the loader understand a further effect.

    Args:
        effect: its id, as in `dipc_gym:EFFECT:PLACE`.
        stage: where it acts.
        rule: what it does there, as in `Entry`.
        memory: of a force or a level of friction that depends on what went before, as in `Entry`.

    Raises:
        ValueError: the id is taken, or neither a force nor friction is to remember.
    """
    if effect in _known:
        raise ValueError(f"an effect {effect!r} is registered already")
    if memory is not None and stage not in ("force", "friction"):
        raise ValueError(f"{effect!r} changes a {stage}: only a force or friction can remember")
    _known[effect] = Entry(effect, stage, rule, tried=True, memory=memory, alone=False, pressed=stage == "friction")


def known() -> tuple[Entry, ...]:
    """Every effect that the loader understands."""
    return tuple(_known.values())


def entry_of(effect: str) -> Entry | None:
    """What entries of an effect are; None for one that the loader does not understand."""
    return _known.get(effect)


@dataclass(frozen=True)
class Extra:
    """One entry of `<custom>`: its effect, the place it acts at, and its numbers.

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
    inputs: Inputs = ()
    slot: int = -1

    @property
    def entry(self) -> Entry:
        """What is known of its effect."""
        return _known[self.effect]

    @property
    def remembers(self) -> bool:
        """Whether what it does depends on what went before."""
        return self.slot >= 0

    @property
    def pressed(self) -> bool:
        """Whether it is dry friction that may depend on the forces at its joint, and not on place and time alone."""
        return self.entry.pressed

    @property
    def clocked(self) -> bool:
        """Whether what it does depends on the time."""
        zero, asked = np.zeros(()), set[str]()

        class Watched(Moment):
            def __getattribute__(self, name: str) -> Any:
                asked.add(name)
                return super().__getattribute__(name)

        self(Watched(zero, zero, zero, zero, zero, inputs=(zero, zero)))
        return "time" in asked

    def __call__(self, now: Moment) -> Array:
        """Apply the rule."""
        return self.entry.rule(self.data, now)

    def grows(self, now: Moment) -> Array:
        """Rate of what it remembers, per second.

        Raises:
            KeyError: it remembers nothing.
        """
        memory = self.entry.memory
        if memory is None:
            raise KeyError(self.effect)
        return memory(self.data, now)


def fault(extra: Extra) -> str | None:
    """What is wrong with an entry's numbers: no words where its formula says enough, None where nothing is."""
    for check in (numbers.bounded, extra.entry.check):
        wrong = check(extra.data, extra.inputs) if check else None
        if wrong is not None:
            return wrong
    return None if not extra.entry.tried or _gives_numbers(extra) else ""


def _gives_numbers(extra: Extra) -> bool:
    """Whether a rule gives numbers where it is tried."""
    data = extra.data
    # At its own numbers as positions a wave of no length shows itself.
    usual = np.unique([*data[:HEAD], data.min(), data.max(), *TRIED])
    try:
        with np.errstate(all="ignore"):
            near, far = _alike(extra, usual), _alike(extra, np.array(OUTERMOST))
        return bool(np.all(np.abs(near) <= LARGEST**2) and np.all(np.isfinite(far)))
    except (IndexError, ValueError):
        return False


def _alike(extra: Extra, x: Array) -> Array:
    """What comes of an entry where position, force, command, time and all else are the same number of x (n,)."""
    everywhere = replace(extra, data=np.broadcast_to(extra.data, (len(x), len(extra.data))))
    now = replace(moment(np.abs(x), x, x, x, x), speed=x, inputs=(x, x), memory=x)
    return np.stack([everywhere(now), everywhere.grows(now)]) if extra.remembers else everywhere(now)
