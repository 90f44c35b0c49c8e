"""Steady Kalman filters on the rig's linear model: the best constant gain for noise of known size."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from scipy import linalg

from dipc_gym.controllers import lqr
from dipc_gym.dataflow import NoForm
from dipc_gym.estimators.base import Array, Command, Estimator, RigModel
from dipc_gym.estimators.late import Late
from dipc_gym.plant import Friction

if TYPE_CHECKING:
    from dipc_gym.dataflow import Program, Value

FLOOR = 1e-16
"""Added to the process noise of every state: the Riccati equation wants each to be moved by something."""
QUICKEST = 2.0
"""rad. On rigs of the paper's kind a filter of 2.5 still balances, and one of 3.2 shakes at the supply's limits."""


@dataclass(frozen=True)
class Kalman(Estimator):
    """Steady Kalman filter whose input is the force that the controller wanted (`kalman`), as LQG has it.

    It takes the compensator to be perfect. The model is exact between samples (the force is held), rounding to counts
    is the readings' noise, and the force is uncertain by what a tenth of the dry friction would do in a period: the
    share that a good compensator leaves.

    The readings are used at once: an estimate at k has seen the readings at k.

    Raises:
        ValueError: the model cannot be observed, so that there is no filter.

    Source:
        Kwakernaak, Sivan, "Linear Optimal Control Systems" (1972), section 6.5; rounding as noise: Widrow, Kollar,
        "Quantization Noise" (2008), chapter 4.
    """

    left: ClassVar[float] = 0.1
    """Share of the dry friction by which the force is uncertain."""
    _next: Array = field(init=False, repr=False, compare=False)
    _late: Late = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        A, B = np.array(self.rig.A), np.array(self.rig.B)[:, None]
        object.__setattr__(self, "_late", Late.of(A, B, period=self.rig.period, delay=self._delay))
        F, G = lqr.sampled(A, B, self.rig.period)
        moved = self.left * max(self.dry.coulomb, 1e-3) * G
        gain = steady_gain(F, moved @ moved.T, self.rig.reading_covariance)
        object.__setattr__(self, "_next", filter_matrix(F, G, gain))

    @property
    def _delay(self) -> float:
        return self.rig.delay

    def begin(self, observations: Array) -> Array:
        """What is observed at first, and no commands under way."""
        return np.hstack([observations, np.zeros((len(observations), self._late.columns))])

    def advance(self, state: Array, readings: Array, command: Command) -> Array:
        """Predict with the force, correct with the readings."""
        force, past = self._late.arrived(state[:, 6:], self.force(state, command))
        return np.hstack([apply(self._next, state[:, :6], force, readings), past])

    def force(self, state: Array, command: Command) -> Array:
        """Mean force (n,) on the cart in the period, N."""
        return command.force

    def observation(self, state: Array) -> Array:
        """The filtered state, when the next command will act."""
        return self._late.predicted(state, 6)

    def express(self, program: Program, readings: Value, voltage: Value, force: Value) -> Value:
        """The same, written into a program that can be exported."""
        return self._late.express(program, self._next, readings, force)[1]


@dataclass(frozen=True)
class CompensatedKalman(Kalman):
    """The same filter with the force after friction, as the compensator models friction (`kalman_friction`).

    The motor's force follows from the voltage that was applied, limits included. From it goes the friction that the
    compensator takes for granted, the mean of that at the velocity where the period began and at the one where, with
    the force wanted, it ends. A compensator that models none (`none`) leaves the motor's force.
    """

    def force(self, state: Array, command: Command) -> Array:
        """Motor force less modelled friction."""
        motor = self.rig.newtons_per_volt * command.voltage
        if command.friction is None:
            return motor
        before = state[:, 3]
        pull = (np.array([self.rig.A[3]]) @ state[:, :6, None])[:, 0, 0]  # each rig by itself: many get what one gets
        after = before + self.rig.period * (pull + self.rig.B[3] * command.force)
        return motor - 0.5 * (command.friction(before) + command.friction(after))

    def express(self, program: Program, readings: Value, voltage: Value, force: Value) -> Value:
        """Nothing: what it asks of the compensator, a program does not know.

        Raises:
            NoForm: always.
        """
        raise NoForm("it asks the compensator for the friction at two velocities; `kalman` has a form")


@dataclass(frozen=True)
class Disturbance(Estimator):
    """Kalman filter with dry friction as a seventh state that wanders (`disturbance`): a disturbance observer.

    No law of friction is assumed. The cart's encoder is fine enough to tell force from motion: within two or three
    samples the filter knows what held the cart back, whatever it was, and `friction` can be fed forward.

    Friction jumps from one Coulomb level to the other when the cart turns, and balancing turns it about as often as
    the rig would fall over. A random walk with that mean square has the step 2 Fc sqrt(pace T); `wander` keeps it to
    what the control period and the cart's encoder allow.

    Source:
        Friedland, "Control System Design" (1986), chapter 10; Chen, Yang, Guo, Li, "Disturbance-observer-based control
        and related methods", IEEE Transactions on Industrial Electronics 63 (2016) 1083-1095.
    """

    observes_friction: ClassVar[bool] = True
    _next: Array = field(init=False, repr=False, compare=False)
    _late: Late = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        A, B = with_friction(self.rig)
        object.__setattr__(self, "_late", Late.of(A, B, period=self.rig.period, delay=self.rig.delay))
        F, G, noise = disturbed(self)
        object.__setattr__(self, "_next", filter_matrix(F, G, steady_gain(F, noise, self.rig.reading_covariance)))

    def begin(self, observations: Array) -> Array:
        """What is observed at first, no friction, and no commands under way."""
        return np.hstack([observations, np.zeros((len(observations), 1 + self._late.columns))])

    def advance(self, state: Array, readings: Array, command: Command) -> Array:
        """Predict with the motor's force, correct with the readings."""
        force, past = self._late.arrived(state[:, 7:], self.rig.newtons_per_volt * command.voltage)
        return np.hstack([apply(self._next, state[:, :7], force, readings), past])

    def observation(self, state: Array) -> Array:
        """The filtered state, when the next command will act."""
        return self._late.predicted(state, 7)[:, :6].copy()

    def friction(self, state: Array) -> Array:
        """The seventh state, within what the motor can exert."""
        return np.clip(state[:, 6], -self.rig.largest_force, self.rig.largest_force)

    def express(self, program: Program, readings: Value, voltage: Value, force: Value) -> Value:
        """The same with friction, written into a program that can be exported."""
        motor, most = voltage * self.rig.newtons_per_volt, self.rig.largest_force
        state, ahead = self._late.express(program, self._next, readings, motor)
        return program.join(ahead.part(0, 6), state.part(6).clip(-most, most))


def disturbed(estimator: Estimator) -> tuple[Array, Array, Array]:
    """The sampled model whose seventh state, friction, is a random walk: F (7, 7), G (7, 1), process noise (7, 7)."""
    rig, noise = estimator.rig, np.zeros((7, 7))
    noise[6, 6] = wander(estimator.dry, rig) ** 2
    return *lqr.sampled(*with_friction(rig), rig.period), noise


def with_friction(rig: RigModel) -> tuple[Array, Array]:
    """A (7, 7) and B (7, 1) of the linear model with friction, a force that stays, as its seventh state."""
    A, B = np.zeros((7, 7)), np.zeros((7, 1))
    A[:6, :6], A[:6, 6], B[:6, 0] = np.array(rig.A), -np.array(rig.B), np.array(rig.B)
    return A, B


def wander(dry: Friction, rig: RigModel) -> float:
    """Step of a random walk that reverses Coulomb friction `pace` times a second, N per period, or less if too fast.

    A filter that tells a force from positions has the bandwidth (B w / (s T))^(1/3) rad/s, for a walk of step w in a
    period T, accelerations B per newton, and readings wrong by s: a finer encoder makes it faster. Friction that turns
    with the cart and is fed forward, held for a period and perhaps late, drives the cart meanwhile. So the filter may
    not turn by more than `QUICKEST` in the time from a reading until the command that answers it has acted.
    """
    reversing = 2 * max(dry.coulomb, 1e-3) * float(np.sqrt(rig.pace * rig.period))
    rounding, prompt = rig.cart_step / np.sqrt(12), rig.period + rig.delay
    return min(reversing, float(QUICKEST**3 * rounding * rig.period / (max(abs(rig.B[3]), 1e-9) * prompt**3)))


def steady_gain(F: Array, noise: Array, R: Array) -> Array:
    """Gain (k, 3) by which the difference between readings and prediction corrects the state.

    Args:
        F: (k, k) of the sampled model; its first three states are what is read.
        noise: (k, k) covariance of what a period adds to the state.
        R: (3, 3) covariance of the readings.

    Raises:
        ValueError: the Riccati equation has no solution.
    """
    C = np.eye(3, len(F))
    try:
        P = linalg.solve_discrete_are(F.T, C.T, noise + FLOOR * np.eye(len(F)), R)
    except (np.linalg.LinAlgError, ValueError) as error:
        raise ValueError(f"there is no Kalman filter for this rig's linear model ({error})") from None
    return np.asarray(P @ C.T @ np.linalg.inv(C @ P @ C.T + R))


def filter_matrix(F: Array, G: Array, gain: Array) -> Array:
    """The constant-gain filter as one matrix (k, k + 4): the next state from state, input and readings."""
    kept = np.eye(len(F)) - gain @ np.eye(3, len(F))
    return np.hstack([kept @ F, kept @ G, gain])


def apply(matrix: Array, state: Array, force: Array, readings: Array) -> Array:
    """The filter's matrix on every row; a product for each row by itself, so that many rigs get what one gets."""
    known = np.concatenate([state, force[:, None], readings], axis=1)
    return (matrix @ known[:, :, None])[:, :, 0]
