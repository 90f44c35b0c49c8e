"""A planned motion from one equilibrium to another, feedback that keeps the rig near it, then the LQR that holds."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from dipc_gym.controllers import lqr
from dipc_gym.kernels import TURN
from dipc_gym.mechanics.motion import POSTURES, Motion, state_of
from dipc_gym.policy import ControllerError
from dipc_gym.safety import untrusted
from dipc_gym.safety.files import write_whole
from dipc_gym.safety.untrusted import Format

Array = NDArray[np.float64]

SCHEMA = "dipc-gym/trajectory/1"
FORMAT = Format("trajectory", "dipc-gym plan", "plan it again", 5_000_000, ControllerError)
LONGEST = 10_000  # control periods
LARGEST = 1e6  # no position, rate, force or gain of a plan is this large
DIGITS = 9  # of a number in a plan's file
FASTEST, SLOWEST = 1e-4, 0.1  # control periods, s


@dataclass(frozen=True, eq=False)
class Tracking:
    """Time-varying LQR along a planned motion, then the LQR about the goal (`tvlqr`).

        F(k) = forces[k] - gains[k] (x(k) - states[k])  for k < n,  then  F = -hold (x - goal)

    Angles are compared the short way round. It counts its calls, one a control period; `reset` begins anew.

    Attributes:
        states: (n + 1, 6) planned, as `DIPC-Friction-v0` observes them, from `start` to `goal`.
        forces: (n,) planned, N.
        gains: (n, 6) N per unit of the state.
        hold: (6,) gain about the goal.
        period: control period, s.
        start: a name of `postures.POSTURES`.
        goal: a name of `postures.POSTURES`.
        name: what tables call it.

    Raises:
        ValueError: shapes do not go together, a number is too large, or a name is none.

    Source:
        Tedrake, "Underactuated Robotics" (2024), chapters 8 and 10.

    Example:
        >>> from dipc_gym import controllers
        >>> controllers.load("tvlqr").goal
        'up-up'
    """

    states: Array
    forces: Array
    gains: Array
    hold: Array
    period: float
    start: str = "down-down"
    goal: str = "up-up"
    name: str = "tvlqr"
    _calls: list[int] = field(default_factory=lambda: [0], init=False, repr=False)

    def __post_init__(self) -> None:
        n = len(self.forces)
        if not 0 < n <= LONGEST:
            raise ValueError(f"the plan has {n} periods; it can have 1 to {LONGEST:,}")
        for what, shape in (("states", (n + 1, 6)), ("forces", (n,)), ("gains", (n, 6)), ("hold", (6,))):
            numbers = getattr(self, what)
            if numbers.shape != shape or not (np.abs(numbers) < LARGEST).all():
                raise ValueError(f"{what} must be {shape} numbers below {LARGEST:g}")
        if not FASTEST <= self.period <= SLOWEST:
            raise ValueError(f"period is {self.period}; it must be from {FASTEST:g} to {SLOWEST:g} s")
        for what in ("start", "goal"):
            if getattr(self, what) not in POSTURES:
                raise ValueError(f"{what} is {getattr(self, what)!r}; it can be {', '.join(POSTURES)}")

    @property
    def seconds(self) -> float:
        """Length of the planned motion."""
        return len(self.forces) * self.period

    def require(self, start: str, goal: str, period: float) -> None:
        """Refuse a task that it was not planned for.

        Raises:
            ControllerError: it starts or ends elsewhere, or the control period is another.
        """
        if (start, goal) != (self.start, self.goal):
            raise ControllerError(
                f"{self.name} was planned from {self.start} to {self.goal}, and is to go from {start} to {goal}; say "
                f"dipc-gym plan --start {start} --goal {goal}"
            )
        if abs(period - self.period) > 1e-9:
            raise ControllerError(
                f"{self.name} was planned for a control period of {self.period:g} s, and the rig's is {period:g} s; "
                "plan it for this rig"
            )

    def reset(self) -> None:
        """Begin the plan anew."""
        self._calls[0] = 0

    def force(self, observation: Array) -> float:
        """Force wanted on the cart, N, for an observation (8,) of `DIPC-Friction-SwingUp-v0`.

        What is not finite counts as being where it was planned.
        """
        k = self._calls[0]
        self._calls[0] = min(k + 1, len(self.forces))
        moving = k < len(self.forces)
        off = state_of(observation) - self.states[k]
        off[1:3] -= TURN * np.round(off[1:3] / TURN)
        off = np.where(np.isfinite(off), off, 0.0)
        gain, planned = (self.gains[k], float(self.forces[k])) if moving else (self.hold, 0.0)
        return planned - float(gain @ off)

    # ------------------------------------------------------------------------------------------------ files

    def save(self, path: str | Path) -> None:
        """Write it to a JSON file, which appears whole or not at all.

        Raises:
            OSError: it cannot be written.
        """
        entries = ",\n".join(f"{json.dumps(k)}: {json.dumps(v, allow_nan=False)}" for k, v in self.to_dict().items())
        write_whole(path, f"{{\n{entries}\n}}\n".encode())

    def to_dict(self) -> dict[str, Any]:
        """What the file holds, rounded to nine digits."""
        rows = np.hstack([self.states[:-1], self.forces[:, None], self.gains])
        return {
            "schema": SCHEMA,
            "start": self.start,
            "goal": self.goal,
            "period": self.period,
            "columns": list(COLUMNS),
            "rows": [[_short(number) for number in row] for row in rows.tolist()],
            "end": [_short(number) for number in self.states[-1].tolist()],
            "hold": [_short(number) for number in self.hold.tolist()],
        }

    @classmethod
    def load(cls, path: str | Path) -> Tracking:
        """Read one; nothing in the file is executed, and everything is checked.

        Raises:
            ControllerError: the file cannot be read, or a field is missing, unknown, or not what it must be.
        """
        path = Path(path)
        return _Reader(FORMAT, str(path)).tracking(FORMAT.read(path), path.stem)

    @classmethod
    def shipped(cls) -> Tracking:
        """The one that comes with the package, for the paper's rig, from hanging to upright."""
        place = resources.files("dipc_gym.controllers").joinpath("tvlqr.json")
        with resources.as_file(place) as path:
            return cls.load(path)


STATE = ("cart", "pole1", "pole2", "cart_rate", "pole1_rate", "pole2_rate")
COLUMNS = (*STATE, "force", *(f"gain_{name}" for name in STATE))


class _Reader(untrusted.Reader):
    def tracking(self, data: Any, name: str) -> Tracking:
        self.document(data, SCHEMA, ("start", "goal", "period", "columns", "rows", "end", "hold"))
        self.entries(data["columns"], "columns", len(COLUMNS))
        for i, column in enumerate(COLUMNS):
            self.one_of(data["columns"][i], (column,), f"columns[{i}]")
        entries = self.entries(data["rows"], "rows")
        if not 0 < len(entries) <= LONGEST:
            self.fail("rows", f"has {len(entries)} entries; it can have 1 to {LONGEST:,}")
        rows = np.array([self.row(row, len(COLUMNS), f"rows[{i}]") for i, row in enumerate(entries)])
        end = np.array(self.row(data["end"], 6, "end"))
        try:
            return Tracking(
                states=np.vstack([rows[:, :6], end]),
                forces=rows[:, 6],
                gains=rows[:, 7:],
                hold=np.array(self.row(data["hold"], 6, "hold")),
                period=self.positive(data["period"], "period"),
                start=self.one_of(data["start"], tuple(POSTURES), "start"),
                goal=self.one_of(data["goal"], tuple(POSTURES), "goal"),
                name=name,
            )
        except ValueError as error:
            if isinstance(error, ControllerError):
                raise
            raise ControllerError(f"{self.source}: {error}; {self.format.mend}") from None

    def row(self, value: Any, length: int, where: str) -> list[float]:
        return [self.number(v, f"{where}[{i}]") for i, v in enumerate(self.entries(value, where, length))]


@dataclass(frozen=True, eq=False)
class Feedback:
    """A time-varying LQR.

    Attributes:
        gains: (n, 6) along the motion.
        hold: (6,) about the goal.
        to_go: (n + 1, 6, 6) what a deviation costs from then on, as a quadratic form of it.
        cost: that is to be expected where in every period the force is off by a newton, independently, rms.
    """

    gains: Array
    hold: Array
    to_go: Array
    cost: float


def feedback(motion: Motion, states: Array, forces: Array, period: float, goal: Array) -> Feedback:
    """Gains that keep a rig near a planned motion, and what keeping it there costs.

    The weights are those of the paper's LQR, at the goal and on the way; each period's model is the linear one about
    the middle of it.

    Args:
        motion: of the rig.
        states: (n + 1, 6) planned.
        forces: (n,) planned, N.
        period: s.
        goal: (6,) equilibrium.
    """
    Q, R = lqr.RECOVERED_Q, lqr.R
    F, G = lqr.sampled(*_columns(motion.linear(goal, 0.0)), period)
    hold, P = lqr.dlqr(F, G, Q, R)[0], linalg.solve_discrete_are(F, G, Q, np.eye(1) * R)
    gains, to_go, cost = np.zeros((len(forces), 6)), np.zeros((len(forces) + 1, 6, 6)), 0.0
    to_go[-1] = P
    for k in range(len(forces) - 1, -1, -1):
        F, G = lqr.sampled(*_columns(motion.linear(0.5 * (states[k] + states[k + 1]), forces[k])), period)
        cost += float(G[:, 0] @ P @ G[:, 0])
        gains[k : k + 1] = np.linalg.solve(R + G.T @ P @ G, G.T @ P @ F)
        P = Q + F.T @ P @ (F - G @ gains[k : k + 1])
        P = to_go[k] = 0.5 * (P + P.T)
    return Feedback(gains, hold, to_go, cost)


def equilibrium(name: str) -> Array:
    """The state (6,) of a posture.

    Example:
        >>> equilibrium("up-down").round(2).tolist()
        [0.0, 0.0, 3.14, 0.0, 0.0, 0.0]
    """
    first, second = POSTURES[name]
    return np.array([0.0, 0.0 if first else math.pi, 0.0 if second else math.pi, 0.0, 0.0, 0.0])


def _columns(linear: tuple[Array, Array]) -> tuple[Array, Array]:
    return linear[0], linear[1][:, None]


def _short(number: float) -> float:
    return float(f"{number:.{DIGITS}g}")
