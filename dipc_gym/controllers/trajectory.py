"""Plans a motion from one equilibrium to another: trajectory optimisation with CasADi and IPOPT (the `plan` extra).

What is chosen is the acceleration of the cart, held for four control periods. So cart and drag are simple, and the
force that is needed is a limit among others; with the force itself as what is chosen, IPOPT found no way up from any
of nine first guesses. Multiple shooting; every piece is one or two steps of Runge and Kutta's fourth order.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dipc_gym.controllers.tracking import Tracking, equilibrium, feedback
from dipc_gym.mechanics.motion import Motion

Array = NDArray[np.float64]

HELD = 4  # control periods for which the cart's acceleration is constant
DURATIONS = (2.0, 2.5, 3.0)  # s, that are tried
GUESSES = 4  # for each
MARGIN = 0.7  # of the motor's force that a plan uses; the rest is for friction and feedback
ROOM = 0.75  # of the rail that a plan uses
EFFORT, CENTRE = 0.01, 1.0  # weights of the squared acceleration, (m/s^2)^-2 s^-1, and of the cart's place, m^-2 s^-1
ITERATIONS = 400  # of IPOPT for each guess, at most


class NoPlanError(ValueError):
    """No motion was found."""


@dataclass(frozen=True)
class Limits:
    """What a plan has to keep within.

    Attributes:
        force: of the motor at full supply, N; a plan uses 0.7 of it.
        rail: from the middle to the nearer stop, m; a plan uses 0.75 of it.
    """

    force: float
    rail: float


def plan(
    motion: Motion,
    limits: Limits,
    period: float,
    *,
    start: str = "down-down",
    goal: str = "up-up",
    seed: int = 0,
) -> Tracking:
    """The best of some locally optimal motions, with feedback around it.

    Twelve first guesses of three lengths are improved by IPOPT. Among those that reach the goal it takes the one along
    which an uncertain force costs the least, see `tracking.feedback`.

    Args:
        motion: of the rig.
        limits: of motor and rail.
        period: control period, s.
        start: a name of `postures.POSTURES`.
        goal: another.
        seed: of the first guesses.

    Raises:
        NoPlanError: no guess led to the goal.
        ImportError: CasADi is not installed.
    """
    solved = list(_solved(motion, limits, period, start, goal, seed))
    if not solved:
        raise NoPlanError(
            f"no motion from {start} to {goal} was found within {MARGIN * limits.force:.3g} N and "
            f"{ROOM * limits.rail:.3g} m; try another --seed, or a rig with more force or rail"
        )
    best: tuple[float, Tracking] | None = None
    for states, forces in solved:
        around = feedback(motion, states, forces, period, states[-1])
        if best is None or around.cost < best[0]:
            best = around.cost, Tracking(states, forces, around.gains, around.hold, period, start, goal)
    assert best is not None
    return best[1]


def _solved(
    motion: Motion, limits: Limits, period: float, start: str, goal: str, seed: int
) -> Iterator[tuple[Array, Array]]:
    """States (n + 1, 6) and forces (n,) in control periods of every motion that reaches the goal."""
    rng = np.random.default_rng(seed)
    for seconds in DURATIONS:
        pieces = round(seconds / (HELD * period))
        solver, step = _solver(motion, HELD * period, pieces)
        for _ in range(GUESSES):
            begin, end = equilibrium(start), equilibrium(goal)
            begin[1:3] *= rng.choice([-1.0, 1.0], 2)  # hanging is half a turn either way
            guess = _guess(rng, begin, end, pieces, HELD * period)
            low, high = np.full((pieces + 1, 6), -np.inf), np.full((pieces + 1, 6), np.inf)
            high[:, 0] = ROOM * limits.rail
            low[:, 0] = -high[:, 0]
            low[0], high[0], low[-1], high[-1] = begin, begin, end, end
            still = np.zeros(pieces)
            force = np.concatenate([np.zeros(6 * pieces), np.full(2 * pieces, MARGIN * limits.force)])
            found = solver(
                x0=np.concatenate([guess.ravel(), still]),
                lbx=np.concatenate([low.ravel(), still - np.inf]),
                ubx=np.concatenate([high.ravel(), still + np.inf]),
                lbg=-force,
                ubg=force,
            )
            if solver.stats()["success"]:
                numbers = np.array(found["x"]).ravel()
                states = numbers[: 6 * (pieces + 1)].reshape(pieces + 1, 6)
                yield _in_periods(step, states, numbers[6 * (pieces + 1) :], period)


def _guess(rng: np.random.Generator, begin: Array, end: Array, pieces: int, length: float) -> Array:
    """A first guess (pieces + 1, 6): poles go over smoothly, early or late, while the cart swings."""
    time = np.linspace(0.0, 1.0, pieces + 1)
    states = np.zeros((pieces + 1, 6))
    more = np.cos(end[1:3]).sum() - np.cos(begin[1:3]).sum()
    late = more > 0.5 or (more > -0.5 and rng.random() < 0.5)  # upright is the last to be had and the first to be lost
    for k in (1, 2):
        power = rng.uniform(1.0, 3.0)
        share = time**power if late else 1 - (1 - time) ** power
        states[:, k] = begin[k] + (end[k] - begin[k]) * share
    states[:, 0] = 0.15 * np.sin(2 * np.pi * rng.uniform(1.0, 4.0) * time)
    states[:-1, 3:] = np.diff(states[:, :3], axis=0) / length
    return states


def _in_periods(step: Any, states: Array, accelerations: Array, period: float) -> tuple[Array, Array]:
    """States at every control period, and the force in the middle of each."""
    fine, forces = [states[0]], []
    for k, acceleration in enumerate(accelerations.tolist()):
        now = states[k]
        for i in range(HELD):
            after, force = step(now, acceleration, period)
            forces.append(float(force))
            now = np.array(after).ravel() if i < HELD - 1 else states[k + 1]
            fine.append(now)
    return np.array(fine), np.array(forces)


def _solver(motion: Motion, length: float, pieces: int) -> tuple[Any, Any]:
    """IPOPT for so many pieces, and a function that goes on for a time and tells the force half way."""
    try:
        import casadi as ca
    except ImportError as missing:
        raise ImportError(
            "planning a motion needs casadi: add its extra: pip install '.[plan]' in a clone"
        ) from missing
    d1, d2, d3, d4, d5, d6 = motion.d
    state, pull, time = ca.SX.sym("state", 6), ca.SX.sym("acceleration"), ca.SX.sym("time")
    a, b, v, p, r = (state[k] for k in range(1, 6))
    spread, both = d5 * ca.cos(a - b), d5 * ca.sin(a - b)
    first = d2 * motion.gravity * ca.sin(a) - both * r**2 - d2 * ca.cos(a) * pull
    second = d3 * motion.gravity * ca.sin(b) + both * p**2 - d3 * ca.cos(b) * pull
    size = d4 * d6 - spread**2
    bent = ca.vertcat((d6 * first - spread * second) / size, (d4 * second - spread * first) / size)
    rate = ca.Function("rate", [state, pull], [ca.vertcat(state[3:], pull, bent)])
    needed = d1 * pull + d2 * ca.cos(a) * bent[0] + d3 * ca.cos(b) * bent[1]
    needed += motion.viscous * v - d2 * ca.sin(a) * p**2 - d3 * ca.sin(b) * r**2
    force = ca.Function("force", [state, pull], [needed])

    def runge_kutta(x: Any, h: Any) -> Any:
        k1 = rate(x, pull)
        k2 = rate(x + h / 2 * k1, pull)
        k3 = rate(x + h / 2 * k2, pull)
        k4 = rate(x + h * k3, pull)
        return x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)

    half = runge_kutta(state, time / 2)
    step = ca.Function("step", [state, pull, time], [runge_kutta(half, time / 2), force(half, pull)])
    piece = ca.Function("piece", [state, pull], [step(state, pull, length)[0]])
    X, U = ca.MX.sym("states", 6, pieces + 1), ca.MX.sym("accelerations", 1, pieces)
    gaps = piece.map(pieces)(X[:, :-1], U) - X[:, 1:]
    forces = [force.map(pieces)(X[:, where], U) for where in (slice(0, pieces), slice(1, pieces + 1))]
    problem: dict[str, Any] = {
        "x": ca.vertcat(ca.vec(X), ca.vec(U)),
        "f": length * (EFFORT * ca.sumsqr(U) + CENTRE * ca.sumsqr(X[0, :])),
        "g": ca.vertcat(ca.vec(gaps), *(ca.vec(each) for each in forces)),
    }
    options: dict[str, Any] = {
        "ipopt.print_level": 0,
        "ipopt.sb": "yes",
        "print_time": False,
        "ipopt.max_iter": ITERATIONS,
    }
    return ca.nlpsol("plan", "ipopt", problem, options), step
