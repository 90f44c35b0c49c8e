"""What every compensator is: a frozen inverse model from the wanted force to the motor voltage."""

from __future__ import annotations

import copy
import dataclasses
import math
import warnings
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, ClassVar, Self, TypeVar

import numpy as np
import numpy.typing as npt

from dipc_gym.dataflow import NoForm, Program, Value

Array = npt.NDArray[np.float64]
Signal = TypeVar("Signal", float, Array)
"""A number in the control loop, or an array with one entry for each of many rigs."""

SCHEMA = "dipc-gym/compensator/1"
INPUTS = (("force", "N"), ("velocity", "m/s"), ("previous_velocity", "m/s"))
MARGIN = 0.5
"""Share of the training range beyond each of its ends from which on a query counts as far outside."""


HUGE = 1e6
"""No force in N and no velocity in m/s of a rig is this large."""
GARBAGE = "a force or velocity is not finite, or larger than any rig's"
NO_NUMBER = "it gives no finite voltage"


class OutOfRangeWarning(UserWarning):
    """A learned compensator is asked far outside the range of its training data."""


class FallbackWarning(UserWarning):
    """A compensator was fed garbage and went back to what it was trained to be."""


@dataclass(frozen=True)
class RigConstants:
    """What is known of the rig before anything is learned.

    Attributes:
        newtons_per_volt: Motor force on the cart per volt at standstill, N/V.
        viscous: Viscous friction that the linear controller's model has in it, back-EMF included, N s/m.
        supply_voltage: Largest motor voltage, V.
        mass: Moving mass with the poles locked, kg; None if it is not known.
        period: Control period, s.

    Raises:
        ValueError: A constant is not a finite number, or has the wrong sign.

    Example:
        >>> RigConstants(newtons_per_volt=3.937, viscous=40.0, supply_voltage=24.0).viscous
        40.0
    """

    newtons_per_volt: float
    viscous: float
    supply_voltage: float
    mass: float | None = None
    period: float = 0.005

    def __post_init__(self) -> None:
        limits = {"newtons_per_volt": 0.0, "supply_voltage": 0.0, "viscous": -math.inf, "period": 0.0}
        if self.mass is not None:
            limits["mass"] = 0.0
        for name, least in limits.items():
            value = getattr(self, name)
            if not (math.isfinite(value) and value > least):
                raise ValueError(f"RigConstants.{name} is {value}; it must be finite and above {least}")


@dataclass(frozen=True, eq=False)
class Samples:
    """An identification run, sample by sample.

    Attributes:
        force: (n,) N, the force that the linear controller's model assumes behind the motion: d1 times the
            acceleration plus the viscous friction in that model.
        velocity: (n,) m/s, cart velocity at the instant the voltage is applied.
        previous_velocity: (n,) m/s, cart velocity one control period earlier.
        voltage: (n,) V, motor voltage that made the motion.
        train: (n,) bool, True for training; the rest is for test.
        position: (n,) m, what the cart's encoder read at that instant; None if only velocities are known.

    Raises:
        ValueError: Lengths differ, a value is not finite, or training or test part is empty.

    Example:
        >>> import numpy as np
        >>> x = np.linspace(-1.0, 1.0, 4)
        >>> samples = Samples(40 * x, x, x, 10 * x, np.array([True, True, False, False]))
        >>> samples.inputs.shape
        (4, 3)
    """

    force: Array
    velocity: Array
    previous_velocity: Array
    voltage: Array
    train: npt.NDArray[np.bool_]
    position: Array | None = None

    def __post_init__(self) -> None:
        given = () if self.position is None else ("position",)
        for name in ("force", "velocity", "previous_velocity", "voltage", *given):
            values = np.asarray(getattr(self, name), dtype=np.float64)
            if values.ndim != 1 or values.shape != np.shape(self.force):
                raise ValueError(f"Samples.{name} has shape {values.shape}; all columns must be (n,) of one length")
            if not np.isfinite(values).all():
                row = int(np.flatnonzero(~np.isfinite(values))[0])
                raise ValueError(f"Samples.{name}[{row}] is {values[row]}; drop or repair that sample")
            object.__setattr__(self, name, values)
        train = np.asarray(self.train)
        if train.dtype != np.bool_ or train.shape != self.force.shape:
            raise ValueError(f"Samples.train must be a boolean array of shape {self.force.shape}")
        if not train.any() or train.all():
            raise ValueError("Samples.train must leave samples for both training and test")
        object.__setattr__(self, "train", train)

    @property
    def inputs(self) -> Array:
        """(n, 3) table of force, velocity and previous velocity."""
        return np.column_stack([self.force, self.velocity, self.previous_velocity])


@dataclass(frozen=True)
class InputRange:
    """Smallest and largest value that one input had in training, in SI units."""

    low: float
    high: float


@dataclass(frozen=True)
class FitFigures:
    """How well a compensator repeats the voltages of its identification run.

    Attributes:
        train_mse: Mean squared error on the training part, V^2.
        test_mse: Mean squared error on the test part, V^2.
        train_samples: Number of training samples.
        test_samples: Number of test samples.
    """

    train_mse: float
    test_mse: float
    train_samples: int
    test_samples: int


@dataclass(frozen=True)
class Compensator(ABC):
    """An inverse model of motor and friction: wanted force and velocity in, motor voltage out.

    A subclass is a frozen dataclass whose fields are its numbers (floats, or nested tuples declared with
    `numbers`), with one formula, `volts`, and a way to find the numbers, `fit`. The formula is written once
    for floats and for arrays: plain operators, NumPy functions through `elementwise`. So one rig and many
    rigs get the same voltages to the last bit.

    Besides force F(k) and velocity v(k) the formula gets one past value, the velocity v(k-1). It tells which
    way the motion goes and needs nothing but the encoder. A past voltage would close a second loop through
    the compensator itself. In a trial with LuGre friction, encoders and the paper's gains (MLP and LLNF, two
    ways to differentiate the encoder, five starts each), networks fed with u(k-1) fitted held-out data
    better in one of the four cases and cost 1.5 to 3.9 times as much in the loop. F(k-1) was no clear gain:
    0.99 and 1.09 times the cost for the LLNF, 0.5 and 1.2 times for the MLP. On the first call after
    `reset`, v(k-1) is taken to be v(k). A compensator that needs another memory is a `Remembering` one.

    Whatever comes in, `voltage` and `voltage_batch` give a finite voltage, within the supply where it is known. Where
    force or velocity is not finite or impossibly large, they give the voltage of no force at standstill, forget the
    previous velocity, and say so once (`FallbackWarning`). The formula itself is not limited.

    Attributes:
        name: Name under which the compensator is registered.
        needs_friction: True if `voltage` and `voltage_batch` want the friction as `friction=` (N).
        observed_friction: True if that is the friction that an estimator observes, and not the simulation's own.
        ranges: Training range of each input (force, velocity, previous velocity); empty if nothing was
            learned. A query further out than half a range beyond it warns once (`OutOfRangeWarning`).
        figures: How well it fits its identification run, or None.
        supply: Largest voltage either way, V; None if it is not known. A fit takes it from the rig. `ForceCommand`
            leaves it to the environment's amplifier, which says what it clipped.

    Raises:
        ValueError: The supply is not a positive, finite number.
    """

    name: ClassVar[str] = ""
    needs_friction: ClassVar[bool] = False
    observed_friction: ClassVar[bool] = False

    ranges: tuple[InputRange, ...] = field(default=(), kw_only=True)
    figures: FitFigures | None = field(default=None, kw_only=True)
    supply: float | None = field(default=None, kw_only=True)
    _memory: list[float] = field(
        default_factory=lambda: [math.nan], init=False, repr=False, compare=False, kw_only=True
    )
    _limits: list[float] = field(default_factory=list, init=False, repr=False, compare=False, kw_only=True)
    _fallen: list[bool] = field(default_factory=list, init=False, repr=False, compare=False, kw_only=True)

    def __post_init__(self) -> None:
        if self.supply is not None and not 0 < self.supply < math.inf:
            raise ValueError(f"supply is {self.supply}; it must be a positive, finite number of volts, or None")
        for column in number_fields(type(self)):
            value = getattr(self, column.name)
            if column.metadata.get("shape") != ():
                continue
            if not isinstance(value, (int, float, np.number)) or not math.isfinite(value):
                raise ValueError(f"{column.name} is {value!r}; it must be a finite number")
            if column.metadata["positive"] and not value > 0:
                raise ValueError(f"{column.name} is {value!r}; it must be above 0")
        self._watch_range()

    @classmethod
    @abstractmethod
    def fit(cls, samples: Samples, rig: RigConstants, *, seed: int = 0) -> Self:
        """Find the numbers from an identification run.

        Args:
            samples: The run, split into training and test.
            rig: What is known of the rig.
            seed: Seed of whatever is random in the training.
        """

    @abstractmethod
    def volts(self, force: Signal, velocity: Signal, previous_velocity: Signal) -> Signal:
        """Return the motor voltage (V) for a wanted force (N) and velocities (m/s): the formula itself."""

    def behind(self, supply: float) -> Self:
        """Return a copy for one rig, whose amplifier limits voltages to `supply`, V, and says where it did.

        A copy, for it has a memory, which two rigs must not share.
        """
        own = copy.deepcopy(self)
        object.__setattr__(own, "supply", None)
        return own

    @property
    def parameters(self) -> int:
        """Count of learned numbers."""
        return sum(np.size(getattr(self, column.name)) for column in number_fields(type(self)))

    def voltage(self, force: float, velocity: float) -> float:
        """Return the motor voltage for the next control period of one rig.

        Args:
            force: Force wanted on the cart, N.
            velocity: Cart velocity now, m/s.

        Returns:
            Motor voltage, V.
        """
        force, velocity = float(force), float(velocity)
        memory = self._memory
        previous = memory[0]
        memory[0] = velocity
        if previous != previous:  # NaN: the first call after a reset
            previous = velocity
        if not (-HUGE < force < HUGE and -HUGE < velocity < HUGE):  # NaN is not between them either
            self._fall(GARBAGE)
            force, velocity, previous, memory[0] = 0.0, 0.0, 0.0, math.nan
        if self._limits:
            low_force, high_force, low_velocity, high_velocity = self._limits
            if not (low_force <= force <= high_force and low_velocity <= velocity <= high_velocity):
                self._warn(force, velocity)
        volts = float(self.volts(force, velocity, previous))
        if not math.isfinite(volts):
            self._fall(NO_NUMBER)
            return 0.0
        return volts if self.supply is None else min(max(volts, -self.supply), self.supply)

    def voltage_batch(self, force: Array, velocity: Array, state: Array) -> tuple[Array, Array]:
        """Return the motor voltages for many rigs at once; the object itself keeps no memory of the call.

        Args:
            force: (n,) forces wanted on the carts, N.
            velocity: (n,) cart velocities now, m/s.
            state: (n,) what the previous call returned, or `initial_state(n)`. The caller owns it: for rigs
                that were reset, put entries of `initial_state` in their place.

        Returns:
            (n,) motor voltages, V, and the state for the next call.
        """
        force, velocity = np.asarray(force, dtype=np.float64), np.asarray(velocity, dtype=np.float64)
        previous, after = np.where(np.isnan(state), velocity, state), velocity.copy()
        usable = (np.abs(force) < HUGE) & (np.abs(velocity) < HUGE) & (np.abs(previous) < HUGE)
        if not usable.all():
            self._fall(GARBAGE)
            force, velocity, previous = (np.where(usable, signal, 0.0) for signal in (force, velocity, previous))
            after = np.where(usable, after, math.nan)
        self._check_range(force, velocity)
        volts = self.volts(force, velocity, previous)
        sound = np.isfinite(volts)
        if not sound.all():
            self._fall(NO_NUMBER)
            volts = np.where(sound, volts, 0.0)
        return volts if self.supply is None else np.clip(volts, -self.supply, self.supply), after

    def state(self) -> Array:
        """Return what `voltage` remembers now, as `voltage_batch` takes it for one rig."""
        return np.array(self._memory)

    def initial_state(self, n: int) -> Array:
        """Return the memory of n rigs just after a reset: (n,) NaN, no previous velocity yet."""
        return np.full(n, math.nan)

    def replay(self, samples: Samples) -> Array:
        """Return the voltages (n,) that it gives along a run, for the forces and velocities of its samples."""
        return self.volts(samples.force, samples.velocity, samples.previous_velocity)

    def reset(self) -> None:
        """Forget the previous velocity: a new episode begins."""
        self._memory[0] = math.nan

    def express(self, program: Program, force: Value, velocity: Value) -> Value:
        """Write the compensator into a program that can be exported to C or ONNX.

        The formula `volts` writes itself, for values of a program take plain operators too, and NumPy's exponential
        and hyperbolic tangent. A compensator with another memory, or whose formula is shorter on vectors, overrides
        this.

        Args:
            program: What is written.
            force: Force wanted on the cart, N.
            velocity: Cart velocity now, m/s.

        Returns:
            The motor voltage, V.

        Raises:
            NoForm: The formula cannot be written that way.
        """
        if type(self).voltage is not Compensator.voltage:
            raise NoForm("it overrides `voltage`, so it needs an `express` of its own")
        previous = program.previous("previous_velocity", velocity)
        return self.volts(force, velocity, previous)  # type: ignore[type-var]

    def to_dict(self) -> dict[str, Any]:
        """Return everything as plain numbers, strings, lists and dicts, as `load` takes it."""
        within = {} if self.supply is None else {"low": -self.supply, "high": self.supply}
        return {
            "schema": SCHEMA,
            "kind": self.name,
            "inputs": [
                {"name": name, "unit": unit, "low": limits.low, "high": limits.high}
                for (name, unit), limits in zip(INPUTS, self.ranges, strict=False)
            ],
            "output": {"name": "voltage", "unit": "V", **within},
            "parameters": {column.name: _as_lists(getattr(self, column.name)) for column in number_fields(type(self))},
            "fit": None if self.figures is None else dataclasses.asdict(self.figures),
        }

    def _watch_range(self) -> None:
        """Set the limits beyond which a query warns (once: the warning takes them away again)."""
        self._limits.clear()
        for limits in self.ranges[:2]:
            margin = MARGIN * (limits.high - limits.low)
            self._limits.extend((limits.low - margin, limits.high + margin))

    def _check_range(self, force: Array, velocity: Array) -> None:
        """Warn, once, if any of many rigs asks far outside the training range."""
        if self._limits:
            low_force, high_force, low_velocity, high_velocity = self._limits
            inside = (low_force <= force) & (force <= high_force)
            inside &= (low_velocity <= velocity) & (velocity <= high_velocity)
            if not inside.all():
                worst = int(np.argmin(inside))
                self._warn(float(force[worst]), float(velocity[worst]))

    def _warn(self, force: float, velocity: float) -> None:
        self._limits.clear()
        trained = self.ranges
        warnings.warn(
            f"the {self.name} compensator is asked for {force:.4g} N at {velocity:.4g} m/s, far outside its "
            f"training data ({trained[0].low:.4g} to {trained[0].high:.4g} N, {trained[1].low:.4g} to "
            f"{trained[1].high:.4g} m/s); train on a run that covers this (said once)",
            OutOfRangeWarning,
            stacklevel=3,
        )

    def _fall(self, why: str) -> None:
        """Say, once, that it was fed garbage."""
        if not self._fallen:
            self._fallen.append(True)
            warnings.warn(
                f"the {self.name} compensator: {why}; it goes on as it was trained (said once)",
                FallbackWarning,
                stacklevel=3,
            )


def numbers(*shape: int | str, positive: bool = False) -> Any:
    """Declare a field of a compensator that is a nested tuple of numbers.

    Args:
        shape: Length of each level; a string names a length that is not fixed, but is the same wherever the
            name stands in the class.
        positive: True if every number must be above zero.
    """
    return field(metadata={"shape": shape, "positive": positive})


def number_fields(kind: type[Compensator]) -> list[dataclasses.Field[Any]]:
    """Return the fields that are a compensator's own numbers, in order."""
    shared = {column.name for column in dataclasses.fields(Compensator)}
    return [column for column in dataclasses.fields(kind) if column.name not in shared and column.init]


def elementwise(function: Callable[[Array], Array], rows: list[Signal]) -> list[Signal]:
    """Apply a NumPy function to every entry of a list of floats or of arrays.

    The `math` module's functions may differ from NumPy's in the last bit. Sending all floats through one
    NumPy call keeps a formula the same for one rig and for many, and costs about a microsecond.
    """
    result = function(np.array(rows))
    return result.tolist() if result.ndim == 1 else list(result)


def _as_lists(value: Any) -> Any:
    return [_as_lists(entry) for entry in value] if isinstance(value, tuple) else value
