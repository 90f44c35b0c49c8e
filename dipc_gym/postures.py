"""The four equilibria of a double pendulum, what being near one is worth, and tasks of going from one to another."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np

from dipc_gym.env import START_SPREAD, State, start_state
from dipc_gym.kernels import Number, cosine
from dipc_gym.mechanics.motion import POSTURES
from dipc_gym.safety.naming import suggestion

__all__ = ["POSTURES", "TASKS", "Task", "tagged"]

ANYWHERE = "anywhere"
"""A start that is no equilibrium: everywhere on the middle half of the rail, in every posture, moving."""
Start = str | tuple[tuple[float, ...], ...]
SPEEDS = (0.5, 5.0, 5.0)  # m/s and rad/s either way, of such a start

NEAR = math.cos(0.35)  # of an angle from the goal, within which a pole is there
SHARES = {"poles": 0.4, "rest": 0.4, "cart": 0.1, "voltage": 0.1}
"""Of the reward, which is 1 at rest at the goal with the cart in the middle and no voltage."""
HALF_REST = (0.02, 4.0, 0.25)
"""Where `rest` has lost half: mean of the poles' (1 - cos)/2, of their squared rates, square of the cart's velocity."""


@dataclass(frozen=True)
class Task:
    """A start and a goal, with tags by which to choose, after dm_control's suite.

    Attributes:
        start: a name of `POSTURES`, or `anywhere`.
        goal: a name of `POSTURES`.
        tags: `benchmarking` the one to compare learners on; `swing-up` and `swing-down` from one equilibrium to another
            with more or fewer poles up, `swing-across` with as many; `hold` from an equilibrium to itself.

    Example:
        >>> import gymnasium, dipc_gym
        >>> env = gymnasium.make("DIPC-Friction-SwingUp-v0", **TASKS["up-down to up-up"].arguments)
        >>> env.unwrapped.goal
        'up-up'
    """

    start: str
    goal: str
    tags: frozenset[str]

    @property
    def arguments(self) -> dict[str, str]:
        """What `gymnasium.make` takes."""
        return {"start": self.start, "goal": self.goal}


def _tasks() -> Iterator[tuple[str, Task]]:
    for start, before in POSTURES.items():
        for goal, after in POSTURES.items():
            more = sum(after) - sum(before)
            kind = "hold" if start == goal else "swing-up" if more > 0 else "swing-down" if more < 0 else "swing-across"
            benchmark = {"benchmarking"} if (start, goal) == ("down-down", "up-up") else set()
            yield f"{start} to {goal}", Task(start, goal, frozenset({kind} | benchmark))


TASKS: Mapping[str, Task] = MappingProxyType(dict(_tasks()))
"""All sixteen, by names such as `down-down to up-up`."""


def tagged(tag: str) -> dict[str, Task]:
    """The tasks that have a tag, by name.

    Raises:
        ValueError: none has it.

    Example:
        >>> list(tagged("benchmarking"))
        ['down-down to up-up']
    """
    found = {name: task for name, task in TASKS.items() if tag in task.tags}
    if not found:
        tags = sorted({one for task in TASKS.values() for one in task.tags})
        raise ValueError(f"no task has the tag {tag!r}; there are {', '.join(tags)}{suggestion(tag, tags)}")
    return found


def checked(name: Any, what: str, *, anywhere: bool = False) -> str:
    """A posture's name, if it is one.

    Args:
        name: that is given.
        what: the argument, for the message.
        anywhere: whether `anywhere` will do too.

    Raises:
        ValueError: it is not.
    """
    names = [*POSTURES, *([ANYWHERE] if anywhere else [])]
    if not isinstance(name, str) or name not in names:
        near = suggestion(name, names) if isinstance(name, str) else ""
        raise ValueError(f"{what} is {name!r}; it can be {', '.join(map(repr, names))}, first pole first{near}")
    return name


def checked_start(start: Any, what: str) -> Start:
    """Where episodes start, if it is a posture's name, `anywhere`, or states.

    Raises:
        ValueError: it is neither.
    """
    if isinstance(start, str) or np.ndim(start) != 2:
        return checked(start, what, anywhere=True)
    try:
        states = np.array(start, dtype=float)
    except (TypeError, ValueError):
        states = np.empty((0, 6))
    if states.ndim != 2 or states.shape[1] != 6 or not len(states) or not np.isfinite(states).all():
        raise ValueError(f"{what} must be rows of six finite numbers, as DIPC-Friction-v0 observes them")
    return tuple(map(tuple, states.tolist()))


def starting(rng: np.random.Generator, start: Start, state: Any = None) -> State:
    """The state in which an episode starts: at rest within 0.02 (m, rad) of an equilibrium, anywhere, or as given.

    Args:
        rng: of the episode.
        start: a name of `POSTURES`, `anywhere`, or states, one of which is drawn, within 0.02 (m, rad).
        state: six numbers, which are then taken as they are.

    Raises:
        ValueError: `state` is not understood.
    """
    if state is not None:
        return start_state(rng, None, state)
    if start == ANYWHERE:
        a, b, c, v, w1, w2 = rng.uniform(-1.0, 1.0, 6).tolist()
        return 0.225 * a, math.pi * b, math.pi * c, SPEEDS[0] * v, SPEEDS[1] * w1, SPEEDS[2] * w2
    x, theta1, theta2 = rng.uniform(-START_SPREAD, START_SPREAD, 3).tolist()
    if not isinstance(start, str):
        a, b, c, v, w1, w2 = start[int(rng.integers(len(start)))]
        return a + x, b + theta1, c + theta2, v, w1, w2
    first, second = POSTURES[start]
    return x, theta1 + math.pi * (not first), theta2 + math.pi * (not second), 0.0, 0.0, 0.0


def earned(
    state: tuple[Number, Number, Number, Number, Number, Number],
    volts: Number,
    goal: str,
    rail: float,
    supply: Number | float,
) -> tuple[Number, dict[str, Number], Any]:
    """Reward of states that periods ended in, its terms, and whether both poles are within 0.35 rad of the goal.

    Args:
        state: as observed, six numbers or arrays.
        volts: motor voltage.
        goal: a name of `POSTURES`.
        rail: m, where the cart meets its stop.
        supply: V.
    """
    x, theta1, theta2, v, w1, w2 = state
    first, second = (1.0 if up else -1.0 for up in POSTURES[goal])
    a, b = first * cosine(theta1), second * cosine(theta2)
    off, angles, rates, speed = 0.25 * (2.0 - a - b), *HALF_REST
    out, share = x / rail, volts / supply
    worth: dict[str, Any] = {
        "poles": (0.5 + 0.5 * a) * (0.5 + 0.5 * b),
        "rest": 1.0 / (1.0 + off / angles + 0.5 * (w1 * w1 + w2 * w2) / rates + v * v / speed),
        "cart": 1.0 - out * out,
        "voltage": 1.0 - share * share,
    }
    terms = {f"reward_{name}": SHARES[name] * value for name, value in worth.items()}
    poles, rest, cart, voltage = terms.values()
    return poles + rest + cart + voltage, terms, (a > NEAR) & (b > NEAR)


NOTHING: dict[str, float | bool] = {**{f"reward_{name}": 0.0 for name in SHARES}, "at_goal": False}
"""The terms at a reset, and of a simulation that diverged."""
