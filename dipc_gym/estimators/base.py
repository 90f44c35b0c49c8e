"""What every estimator is: readings of the encoders and the last command in, the rig's state out."""

from __future__ import annotations

import dataclasses
import warnings
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from dipc_gym.plant import RANGES, Friction, Plant
from dipc_gym.safety.untrusted import shown

Array = NDArray[np.float64]
Rows = tuple[tuple[float, ...], ...]

SCHEMA = "dipc-gym/estimator/1"
FASTEST = 50.0
"""No entry of a model that a filter can follow changes its state by more than this times in a period."""
LARGEST = 1e3
"""No position or rate of a rig is this large, in m, rad or their rates; an estimate beyond it has diverged."""
STEEPEST = 1e10
"""Of the entries of a linear model: accelerations of the lightest joint that `mjcf` lets pass, for a unit force."""
PHYSICAL = {
    "newtons_per_volt": (1e-9, 1e9, "N/V"),
    "supply": RANGES["supply"],
    "period": RANGES["control_period"],
    "cart_step": RANGES["encoders.cart"],
    "pole_step": RANGES["encoders.pole"],
    "velocity_filter": RANGES["encoders.velocity_filter"],
    "delay": (0.0, 0.1, "s"),
}
"""Least and largest of what a rig model says of motor and encoders, and its unit, as of a plant."""


class EstimateWarning(UserWarning):
    """An estimator was fed garbage, or diverged, and began anew."""


@dataclass(frozen=True, kw_only=True)
class RigModel:
    """What is known of a rig before anything is learned: its linear model, as the LQR knows it, and its sensors.

    Attributes:
        A: (6, 6) of dx/dt = A x + B F about upright, with the state in the observation's order; see `lqr.linear_model`.
        B: (6,) of the force on the cart, N.
        newtons_per_volt: motor force on the blocked cart, N/V.
        supply: largest voltage, V.
        period: control period, s; commands are held for it.
        cart_step: metres per count.
        pole_step: radians per count, of both angle encoders; the second measures from the first pole.
        velocity_filter: time constant of the filtered differences, s.
        delay: from a command to the motor, s; `kalman`, `disturbance` and `rigid_body` count with it.

    Raises:
        ValueError: a number is outside of its range, see `PHYSICAL`, or a matrix has the wrong shape.
    """

    A: Rows
    B: tuple[float, ...]
    newtons_per_volt: float
    supply: float
    period: float
    cart_step: float
    pole_step: float
    velocity_filter: float
    delay: float = 0.0

    def __post_init__(self) -> None:
        for name, shape in (("A", (6, 6)), ("B", (6,))):
            values = np.array(getattr(self, name), dtype=float)
            if values.shape != shape or not np.all(np.abs(values) <= STEEPEST):
                raise ValueError(f"RigModel.{name} must be {shape} numbers of {STEEPEST:g} at most")
        for name, (least, most, unit) in PHYSICAL.items():
            if not least <= getattr(self, name) <= most:
                raise ValueError(
                    f"RigModel.{name} is {shown(getattr(self, name))}; it must be from {least:g} to {most:g} {unit}"
                )
        if not max(abs(entry) for row in self.A for entry in row) * self.period < FASTEST:
            raise ValueError(f"RigModel.A is too fast for a control period of {self.period:g} s; check both")

    @classmethod
    def of(cls, A: Array, B: Array, plant: Plant, newtons_per_volt: float, delay: float = 0.0) -> RigModel:
        """The linear model and the sensors of a plant, and the delay of its commands."""
        return cls(
            A=tuple(tuple(row) for row in A.tolist()),
            B=tuple(B[:, 0].tolist()),
            newtons_per_volt=newtons_per_volt,
            supply=plant.supply,
            period=plant.control_period,
            cart_step=plant.encoders.cart,
            pole_step=plant.encoders.pole,
            velocity_filter=plant.encoders.velocity_filter,
            delay=delay,
        )

    @property
    def largest_force(self) -> float:
        """What the blocked motor exerts at full supply, N."""
        return self.newtons_per_volt * self.supply

    @property
    def reading_covariance(self) -> Array:
        """(3, 3) covariance of rounding to counts: a twelfth of a step squared for each encoder.

        Readings are absolute angles, so the first pole's rounding is in both.
        """
        joints = np.diag([self.cart_step**2, self.pole_step**2, self.pole_step**2]) / 12
        absolute = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 1.0, 1.0]])
        return absolute @ joints @ absolute.T

    @property
    def pace(self) -> float:
        """Rate at which the rig falls over, the fastest unstable mode, 1/s; how often balancing turns the cart."""
        return max(float(np.linalg.eigvals(np.array(self.A)).real.max()), 1.0)


@dataclass(frozen=True, eq=False)
class Command:
    """What was commanded for the period that has just passed, for n rigs.

    Attributes:
        force: (n,) N, the force that the controller wanted, within its limit.
        voltage: (n,) V, what the compensator made of it, within the supply.
        friction: friction (n,) in N as the compensator models it, for velocities (n,) in m/s at this command: what it
            adds to the force beyond the motor's gain. None where no compensator stands between.
    """

    force: Array
    voltage: Array
    friction: Callable[[Array], Array] | None = None


@dataclass(frozen=True)
class Estimator(ABC):
    """An observer of the rig: from encoder readings and commands to positions, rates and, for some, friction.

    A subclass is a frozen dataclass. What it remembers of rigs is an array (n, k), one row for each, which the caller
    owns; so one object serves one rig and many, and gives each the same bits. It has four formulas: `begin`, `advance`,
    `observation`, and `friction` if it observes friction.

    Garbage stays out: a reading that is not finite counts as the predicted one, a command that is not as none, and a
    row that diverges begins anew from its readings. Each is said once (`EstimateWarning`).

    Attributes:
        rig: linear model, motor gain and encoders.
        dry: friction as learned from the identification run; its viscous part is in the rig's linear model.

    Example:
        >>> from dipc_gym import runs
        >>> kalman = runs.estimator("kalman")
        >>> state = kalman.initial_state(np.zeros((1, 6)))
        >>> state = kalman.update(state, np.array([[0.001, 0.0, 0.0]]), Command(np.zeros(1), np.zeros(1)))
        >>> bool(0 < kalman.observation(state)[0, 0] <= 0.001)
        True
    """

    name: ClassVar[str] = ""
    observes_friction: ClassVar[bool] = False
    everywhere: ClassVar[bool] = False
    """Whether it holds for poles in any posture; the others know the rig near upright."""

    rig: RigModel
    dry: Friction
    _said: list[str] = field(default_factory=list, init=False, repr=False, compare=False, kw_only=True)

    @abstractmethod
    def begin(self, observations: Array) -> Array:
        """Memory (n, k) of rigs that start with these observations (n, 6)."""

    @abstractmethod
    def advance(self, state: Array, readings: Array, command: Command) -> Array:
        """Memory one period later, when the encoders read (n, 3): cart, absolute angles."""

    @abstractmethod
    def observation(self, state: Array) -> Array:
        """Estimated state (n, 6) of the rigs now."""

    def foretold(self, state: Array) -> Array:
        """Readings (n, 3) one period later, as far as present velocities tell them, in the place of missing ones."""
        now = self.observation(state)
        return now[:, :3] + self.rig.period * now[:, 3:]

    def friction(self, state: Array) -> Array:
        """Dry friction (n,), N, expected over the coming period; positive where it holds back motion towards +x.

        Raises:
            TypeError: the estimator does not observe friction.
        """
        raise TypeError(f"the estimator {self.name!r} does not observe friction")

    def initial_state(self, observations: Array) -> Array:
        """Memory (n, k) of rigs whose episode begins.

        Args:
            observations: (n, 6) as the environment's reset gives them. What is not finite counts as zero.
        """
        observations = np.asarray(observations, dtype=np.float64)
        if not np.isfinite(observations).all():
            self._say("a first observation is not finite; it counts as zero")
        return self.begin(np.nan_to_num(observations, nan=0.0, posinf=0.0, neginf=0.0))

    def update(self, state: Array, readings: Array, command: Command) -> Array:
        """Take in the readings at the end of a period.

        Args:
            state: (n, k) memory, as `initial_state` or the last `update` returned it.
            readings: (n, 3) of cart, m, and absolute angles, rad.
            command: of the period that has just passed.

        Returns:
            (n, k) memory; the argument is left alone.
        """
        readings = np.asarray(readings, dtype=np.float64)
        if not (np.isfinite(command.force).all() and np.isfinite(command.voltage).all()):
            self._say("a command is not finite; it counts as none")
            force, voltage = (
                np.nan_to_num(u, nan=0.0, posinf=0.0, neginf=0.0) for u in (command.force, command.voltage)
            )
            command = dataclasses.replace(command, force=force, voltage=voltage)
        read = np.abs(readings) < LARGEST
        if not read.all():
            self._say("a reading is not finite, or larger than any rig; the estimate goes on without it")
            readings = np.where(read, readings, self.foretold(state))
        with np.errstate(all="ignore"):
            after = self.advance(state, readings, command)
            lost = np.logical_not((np.abs(self.observation(after)) < LARGEST).all(axis=1))
            lost = np.asarray(lost | ~np.isfinite(after).all(axis=1))
        if lost.any():
            self._say("an estimate diverged; it begins anew from the readings")
            after = np.where(lost[:, None], self.begin(np.hstack([readings, np.zeros_like(readings)])), after)
        return after

    def _say(self, what: str) -> None:
        if what not in self._said:
            self._said.append(what)
            warnings.warn(f"the {self.name} estimator: {what} (said once)", EstimateWarning, stacklevel=3)

    # ------------------------------------------------------------------------------------------------ files

    def to_dict(self) -> dict[str, Any]:
        """Everything as plain numbers, as `estimators.load` takes it."""
        rig, dry = dataclasses.asdict(self.rig), dataclasses.asdict(self.dry)
        rig["A"], rig["B"] = [list(row) for row in self.rig.A], list(self.rig.B)
        return {"schema": SCHEMA, "kind": self.name, "rig": rig, "friction": dry}
