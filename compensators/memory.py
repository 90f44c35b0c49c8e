"""What compensators with a memory have in common: states of many rigs in an array, and no trust in what comes in."""

from __future__ import annotations

import math
from abc import abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from dipc_gym.compensators.base import GARBAGE, HUGE, Array, Compensator, RigConstants, Samples, Signal, numbers
from dipc_gym.plant import RANGES

FRESH = 2 * HUGE
"""A velocity before that no rig has: that of rigs that were just reset, of which nobody knows it."""


def just_reset(before: Array) -> NDArray[np.bool_]:
    """Which rigs were just reset, (n, ...), by the velocities before."""
    return np.asarray(before > HUGE)


def gone_on(before: Array, velocity: Array) -> Array:
    """Velocities before (n, ...); of rigs that were just reset, those that they have now: they need not be at rest."""
    return np.where(just_reset(before), velocity, before)


def check_period(compensator: Compensator, period: float) -> None:
    """Refuse a compensator that would be called at another control period, s, than its memory is for.

    Raises:
        ValueError: naming both, and what to do.
    """
    own = getattr(compensator, "period", period)
    if not math.isclose(own, period, rel_tol=1e-9):
        raise ValueError(
            f"the compensator {compensator.name!r} remembers from one call to the next after {1000 * own:g} ms, and "
            f"the control period is {1000 * period:g} ms; fit it to a rig with this one"
        )


@dataclass(frozen=True)
class Remembering(Compensator):
    """A compensator whose voltage depends on more of the past than the last velocity.

    A subclass says what the memory of n rigs is at a reset (`begin`), and gives voltages and a new memory (`respond`).
    Whatever comes in, the voltage stays within the supply. Where force or velocity is not finite or impossibly large,
    or the memory gets so, the memory of that rig becomes what it is after a reset, the trained self without the past;
    the voltage is then that of no force at standstill, and it is said once (`FallbackWarning`).

    Attributes:
        newtons_per_volt: Motor gain, N/V.
        supply_voltage: Largest voltage either way, V; the smaller of this and `supply` is both, so that a copy with
            another one has it lowered by either and raised by both.
        period: Control period, s, between one call and the next.
    """

    remembers_voltage: ClassVar[bool] = False
    """True if the last column of the memory is the voltage that was applied."""

    newtons_per_volt: float = numbers(positive=True)
    supply_voltage: float = numbers(positive=True)
    period: float = numbers(positive=True)

    def __post_init__(self) -> None:
        least, most, unit = RANGES["control_period"]  # friction is stepped through it, which must come to an end
        if not least <= self.period <= most:
            raise ValueError(f"period is {self.period:g}; it must be from {least:g} to {most:g} {unit}")
        least = self.supply_voltage if self.supply is None else min(self.supply, self.supply_voltage)
        object.__setattr__(self, "supply", least)
        object.__setattr__(self, "supply_voltage", least)
        super().__post_init__()

    def behind(self, supply: float) -> Self:
        """Likewise; what it remembers of voltages is what such an amplifier lets through."""
        own = super().behind(supply)
        object.__setattr__(own, "supply_voltage", min(self.supply_voltage, supply))
        return own

    @abstractmethod
    def begin(self, n: int) -> Array:
        """Return the memory (n, k) of n rigs after a reset; all of it finite."""

    @abstractmethod
    def respond(self, force: Array, velocity: Array, memory: Array) -> tuple[Array, Array]:
        """Return voltages (n,), not yet limited, and the new memory (n, k), for forces, velocities (n,) and memory."""

    @property
    def parameters(self) -> int:
        """Count of learned numbers; gain, supply and period are given."""
        return super().parameters - 3

    def voltage(self, force: float, velocity: float) -> float:
        """Return the motor voltage for the next control period of one rig, within the supply."""
        volts, after = self.voltage_batch(np.array([float(force)]), np.array([float(velocity)]), self.state())
        self._memory[0] = after  # type: ignore[call-overload]
        return float(volts[0])

    def state(self) -> Array:
        """Return what `voltage` remembers now, as `voltage_batch` takes it for one rig."""
        memory: Any = self._memory[0]
        return self.initial_state(1) if isinstance(memory, float) else memory.copy()

    def voltage_batch(self, force: Array, velocity: Array, state: Array) -> tuple[Array, Array]:
        """Return the motor voltages (n,) for many rigs at once, within the supply, and their memory (n, k)."""
        force, velocity = np.asarray(force, dtype=np.float64), np.asarray(velocity, dtype=np.float64)
        usable = (np.abs(force) < HUGE) & (np.abs(velocity) < HUGE) & np.isfinite(state).all(axis=1)
        if not usable.all():
            self._fall(GARBAGE)
            force, velocity = np.where(usable, force, 0.0), np.where(usable, velocity, 0.0)
            state = np.where(usable[:, None], state, self.begin(len(force)))
        self._check_range(force, velocity)
        with np.errstate(all="ignore"):
            volts, after = self.respond(force, velocity, state)
        sound = np.isfinite(volts) & np.isfinite(after).all(axis=1)
        if not sound.all():
            self._fall("its memory is no longer finite")
            volts = np.where(sound, volts, force / self.newtons_per_volt)
            after = np.where(sound[:, None], after, self.begin(len(force)))
        return np.clip(volts, -self.supply_voltage, self.supply_voltage), after

    def initial_state(self, n: int) -> Array:
        """Return the memory (n, k) of n rigs just after a reset."""
        return self.begin(n)

    def reset(self) -> None:
        """Forget the past: a new episode begins."""
        self._memory[0] = math.nan

    def volts(self, force: Signal, velocity: Signal, previous_velocity: Signal) -> Signal:
        """Return the voltage after a past that is the previous velocity alone, under the same force."""
        now, before, wanted = np.broadcast_arrays(*map(np.atleast_1d, (velocity, previous_velocity, force)))
        _, memory = self.respond(wanted, before, self.begin(len(wanted)))
        volts, _ = self.respond(wanted, now, memory)
        return volts if isinstance(force, np.ndarray) else float(volts[0])

    def replay(self, samples: Samples) -> Array:
        """Return the voltages (n,) along a run.

        Stretches of 200 samples run side by side, each after the 40 before it, which give it its memory.
        """
        index, first = stretches(len(samples.force))
        memory, volts = self.begin(index.shape[1]), np.empty(index.shape)
        for row, now in zip(volts, index, strict=True):
            row[:], memory = self.respond(samples.force[now], samples.velocity[now], memory)
            if self.remembers_voltage:
                memory[:, -1] = samples.voltage[now]
        replayed = np.empty(len(samples.force))
        replayed[index[first:]] = volts[first:]
        return np.clip(replayed, -self.supply_voltage, self.supply_voltage)


def given(rig: RigConstants) -> tuple[float, float, float]:
    """Return what every such compensator takes from the rig: gain, supply and period."""
    return rig.newtons_per_volt, rig.supply_voltage, rig.period


def known_mass(rig: RigConstants, name: str) -> float:
    """Return the moving mass, kg.

    Raises:
        ValueError: It is not known.
    """
    if rig.mass is None:
        raise ValueError(f"the {name} compensator tells force from motion and needs RigConstants.mass, in kg")
    return rig.mass


@dataclass(frozen=True, eq=False)
class Track:
    """An identification run as memory is fitted to it, in stretches that are simulated side by side.

    Attributes:
        speed: (periods, stretches) mean velocity in each period, m/s.
        ends: (periods + 1, stretches) velocity between periods, m/s.
        friction: (periods, stretches) force that was lost in each period, N, smoothed as `smooth` does.
        counts: (periods, stretches) whether a period is to be learned from.
    """

    speed: Array
    ends: Array
    friction: Array
    counts: np.ndarray

    @classmethod
    def of(cls, samples: Samples, rig: RigConstants) -> Self:
        """Cut a run into `stretches`; what goes before them only warms up the memory."""
        T, velocity = rig.period, samples.velocity
        position = samples.position if samples.position is not None else T * np.cumsum(velocity)
        ends = np.gradient(position, T)
        speed = np.append(np.diff(position) / T, ends[-1])
        lost = rig.newtons_per_volt * smooth(samples.voltage) - samples.force
        index, first = stretches(len(position))
        counts = samples.train[index]
        counts[:first] = False
        last = np.minimum(index[-1:] + 1, len(position) - 1)
        return cls(speed[index], ends[np.vstack([index, last])], lost[index], counts)

    def residual(self, friction: Array) -> Array:
        """What modelled friction (periods, stretches) leaves, over the periods that count, N."""
        return (smooth(friction) - self.friction)[self.counts]


def stretches(n: int, length: int = 200, warm: int = 40) -> tuple[np.ndarray, int]:
    """Return which samples of n make stretches of a run, (warm + length, stretches), and how many come only to warm up.

    Stretches cover the run; the last one overlaps the one before it, and nothing goes before the first sample.
    """
    length = min(length, n)
    starts = np.append(np.arange(0, n - length, length), n - length)
    return np.maximum(starts + np.arange(-warm, length)[:, None], 0), warm


def smooth(values: Array) -> Array:
    """Mean over three periods with weights 1, 2, 1, along the first axis.

    A force that is worked out by central differences of positions is the mean force of that much time.
    """
    padded = np.concatenate([values[:1], values, values[-1:]])
    return 0.25 * padded[:-2] + 0.5 * padded[1:-1] + 0.25 * padded[2:]
