"""Extended Kalman filter with the bristle of the LuGre model in its state."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from dipc_gym.controllers import lqr
from dipc_gym.dataflow import Program, Value
from dipc_gym.estimators.base import LARGEST, Array, Command, Estimator
from dipc_gym.estimators.kalman import FLOOR, wander

STEP = 0.001
"""Longest step of the bristle's integration, s."""
STRETCH = 10
"""Of these steps are looked at together; the sums over those before grow with each."""
SIZE = 8
"""Six states of the rig, the bristle, and the force that the model leaves unexplained."""
ROWS, COLUMNS = np.tril_indices(SIZE)
"""Of the covariance's entries in the memory: its lower triangle, row after row."""
LEVEL = 0.2
"""Share of the Coulomb level by which the friction of a rig of the same build may differ; see `compare.Spread`."""
UNSURE = 1e30
"""Of an entry of the covariance; beyond it the filter has diverged, and single precision is near its end."""


@dataclass(frozen=True)
class ExtendedKalman(Estimator):
    """Extended Kalman filter with a LuGre bristle and a disturbance (`ekf`).

    The friction is the model's, with the numbers learned from the identification run,

        f = stiffness z + damping dz/dt,  dz/dt = v - stiffness abs(v) z / g(v),
        g(v) = coulomb + (static - coulomb) exp(-(v / stribeck)^2),

    plus a wandering force for what it misses. The bristle takes implicit steps of at most 1 ms; the rig's linear part
    is exact. The covariance follows every step. A fifth of the Coulomb level, the spread within a build, is what the
    disturbance has in a time in which the rig would fall over.

    The filter is written once, as a program: NumPy runs it here, and the export writes it in C. The motion is linear
    but for the bristle, so the slope of a whole period is that of the linear part, and a column times a row for each
    step of the bristle; with that and the symmetry of the covariance it takes a third of what full matrices would.

    Source:
        Canudas de Wit, Olsson, Astrom, Lischinsky, IEEE Transactions on Automatic Control 40 (1995) 419-425.
    """

    observes_friction: ClassVar[bool] = True
    _linear: tuple[Array, Array] = field(init=False, repr=False, compare=False)
    _walk: float = field(init=False, repr=False, compare=False)
    _following: Program = field(init=False, repr=False, compare=False)
    _observing: Program = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        F, G = lqr.sampled(np.array(self.rig.A), np.array(self.rig.B)[:, None], self.rig.period / self.substeps)
        object.__setattr__(self, "_linear", (F, G[:, 0]))
        object.__setattr__(self, "_walk", wander(self.dry, self.rig))
        following, observing = Program(), Program()
        x, P = following.state("filtered", np.zeros(SIZE)), following.state("covariance", np.zeros(len(ROWS)))
        motor, *readings = (following.input(name) for name in ("motor", "cart", "pole1", "pole2"))
        after, spread = self._followed(x, P, following.join(*readings), motor)
        following.update(x, after)
        following.update(P, spread)
        observing.output("friction", self._expected(observing.state("filtered", np.zeros(SIZE))))
        object.__setattr__(self, "_following", following)
        object.__setattr__(self, "_observing", observing)

    @property
    def substeps(self) -> int:
        """Steps of the bristle in a period."""
        return max(1, math.ceil(self.rig.period / STEP - 1e-9))

    def begin(self, observations: Array) -> Array:
        """What is observed at first, bristle at rest, friction not known."""
        n = len(observations)
        P = np.zeros((SIZE, SIZE))
        P[:3, :3] = self.rig.reading_covariance
        P[3:6, 3:6] = P[:3, :3] / self.rig.period**2
        P[6, 6] = (self.dry.static / self.dry.bristle_stiffness) ** 2
        P[7, 7] = (LEVEL * self.dry.coulomb) ** 2
        return np.hstack([observations, np.zeros((n, 2)), np.tile(P[ROWS, COLUMNS], (n, 1))])

    def advance(self, state: Array, readings: Array, command: Command) -> Array:
        """Predict through the bristle's steps, correct with the readings."""
        motor = self.rig.newtons_per_volt * command.voltage
        inputs = {"motor": motor, "cart": readings[:, 0], "pole1": readings[:, 1], "pole2": readings[:, 2]}
        memory = {"filtered": state[:, :SIZE].T, "covariance": state[:, SIZE:].T}
        after = np.concatenate([*self._following.run(inputs, memory)[1].values()]).T
        after[~(np.abs(after[:, SIZE:]) < UNSURE).all(axis=1)] = np.nan  # begins anew, as `update` sees to
        return after

    def observation(self, state: Array) -> Array:
        """The filtered state."""
        return state[:, :6].copy()

    def friction(self, state: Array) -> Array:
        """Mean over the coming period if the cart kept its velocity, within what the motor can exert."""
        return self._observing.run({}, {"filtered": state[:, :SIZE].T})[0]["friction"][0]

    def express(self, program: Program, readings: Value, voltage: Value, force: Value) -> Value:
        """The same with friction, written into a program that can be exported."""
        first = program.constant(self.begin(np.zeros((1, 6)))[0, SIZE:])
        x, P = program.state("filtered", np.zeros(SIZE)), program.state("covariance", np.zeros(len(ROWS)))
        after, spread = self._followed(x, P, readings, voltage * self.rig.newtons_per_volt)
        sound = after.part(0, 6).within(LARGEST).least() * spread.within(UNSURE).least()
        anew = program.first().maximum(1.0 - sound)
        after = anew.choose(program.join(readings, program.constant(np.zeros(SIZE - 3))), after)
        program.update(x, after)
        program.update(P, anew.choose(first, spread))
        return program.join(after.part(0, 6), self._expected(after))

    # ------------------------------------------------------------------------------------------------ the formulas

    def _followed(self, x: Value, P: Value, readings: Value, motor: Value) -> tuple[Value, Value]:
        """State (8,) and covariance (36,) a period later, when the encoders read (3,)."""
        x, slope = self._moved(x, motor)
        return self._corrected(x, self._spread(P, slope), readings)

    def _moved(self, x: Value, motor: Value) -> tuple[Value, Value]:
        """State (8,) a period later without a look at the encoders, and the slope (7, 8) of all but the last of it."""
        x, slope = self._coasted(x, motor, min(STRETCH, self.substeps))
        for done in range(STRETCH, self.substeps, STRETCH):
            x, further = self._coasted(x, motor, min(STRETCH, self.substeps - done))
            slope = further.times(x.program.join(slope, x.program.constant(np.eye(SIZE)[7])), SIZE)
        return x, slope

    def _coasted(self, x: Value, motor: Value, n: int) -> tuple[Value, Value]:
        """The same over some steps of the bristle.

        Between two steps of the bristle the rig takes steps of a linear model, in which the state before and the
        force of each step count with constant weights. Only how velocity and bristle depend on the state before has
        therefore to be followed from step to step, and not how everything does.
        """
        program, (F, G) = x.program, self._linear
        powers = [np.eye(6)]
        for _ in range(n):
            powers.append(F @ powers[-1])
        answers = np.array([power @ G for power in powers[n - 1 :: -1]]).T  # (6, n) of the rig to the force of a step
        coasting = np.array(powers) @ np.eye(6, SIZE)  # (n + 1, 6, 8) of the rig without a force to the state
        ahead = x.part(0, 6).affine(np.vstack([coasting[1:n, 3, :6], powers[n]]))
        z, unexplained, pushed = x.part(6), x.part(7), motor - x.part(7)
        bent, held = program.constant(np.eye(SIZE)[6]), program.constant(np.eye(SIZE)[7])
        forces: list[Value] = []
        slopes: list[Value] = []
        for k in range(n):
            v, turned = (ahead.part(k - 1) if k else x.part(3)), program.constant(coasting[k, 3])
            if k:
                v = v + program.join(*forces).affine(answers[3, n - k :])
                turned = turned - program.constant(answers[3, n - k :]).times(program.join(*slopes), k)
            z, force, of_bristle, of_force = self._bristle(v, z)
            forces.append(pushed - force)
            slopes.append(turned * of_force[0] + bent * of_force[1] + held)
            bent = turned * of_bristle[0] + bent * of_bristle[1]
        rig = ahead.part(n - 1, 6) + program.join(*forces).affine(answers)
        slope = program.constant(coasting[n].ravel()) - program.constant(answers.ravel()).times(
            program.join(*slopes), n
        )
        return program.join(rig, z, unexplained), program.join(slope, bent)

    def _spread(self, P: Value, slope: Value) -> Value:
        """Covariance (36,) a period later, by the slope (7, 8) of the motion; what is unexplained only wanders."""
        noise = np.diag([FLOOR] * SIZE)
        noise[6, 6] += (self._walk / self.dry.bristle_stiffness) ** 2
        noise[7, 7] += (LEVEL * self._walk / 2) ** 2
        full = [_place(i, j) for i in range(SIZE) for j in range(SIZE)]
        across = slope.times(P.pick(full), SIZE)  # (7, 8)
        turned = slope.pick([SIZE * i + j for j in range(SIZE) for i in range(SIZE - 1)])
        both = across.times(turned, SIZE, half=True)
        last = across.pick([SIZE * i + SIZE - 1 for i in range(SIZE - 1)])
        return P.program.join(both, last, P.part(_place(7, 7))) + P.program.constant(noise[ROWS, COLUMNS])

    def _corrected(self, x: Value, P: Value, readings: Value) -> tuple[Value, Value]:
        """State and covariance after one reading has been taken in after the other, each without what it has in common
        with those before."""
        program, R = P.program, self.rig.reading_covariance
        off = [readings.part(j) - x.part(j) for j in range(3)]
        columns: list[Value] = []  # (11,) each: of the state and a reading, and of all readings and that one
        sizes: list[Value] = []
        for j in range(3):
            column = P.pick([_place(i, j) for i in range(SIZE)])
            column = program.join(column, column.part(0, 3) + program.constant(R[:, j]))
            for i in range(j):
                share = columns[i].part(SIZE + j) * sizes[i]
                column, off[j] = column - columns[i] * share, off[j] - off[i] * share
            columns.append(column)
            sizes.append(1.0 / column.part(SIZE + j))
        for column, size, missed in zip(columns, sizes, off, strict=True):
            whole = column.part(0, SIZE)
            gain = whole * size
            x, P = x + gain * missed, P - whole.pick(ROWS.tolist()) * gain.pick(COLUMNS.tolist())
        return x, P

    def _expected(self, x: Value) -> Value:
        """Friction, N: see `friction`. With the velocity, level and rate of the bristle stay, too."""
        v, z, dry, largest = x.part(3), x.part(6), self.dry, self.rig.largest_force
        h, last = self.rig.period / self.substeps, x.part(6)
        _, inverse = self._level(v)
        share, bent, total = 1.0 / (1.0 + abs(v) * inverse * (h * dry.bristle_stiffness)), h * v, 0.0 * z
        for _ in range(self.substeps):
            last = (last + bent) * share
            total = total + last
        held = total * (dry.bristle_stiffness / self.substeps) + (last - z) * (dry.bristle_damping / self.rig.period)
        return (held + x.part(7)).clip(-largest, largest)

    def _bristle(self, v: Value, z: Value) -> tuple[Value, Value, tuple[Value, Value], tuple[Value, Value]]:
        """Bristle after a substep, m; force in it, N; slopes of both against velocity and bristle before."""
        dry, h = self.dry, self.rig.period / self.substeps
        damping = dry.bristle_damping / h
        stiff = dry.bristle_stiffness + damping
        bump, inverse = self._level(v)
        sign = v.program.constant(0.0).below(v) - v.below(0.0)
        slipped = v * sign * inverse
        share = 1.0 / (1.0 + slipped * (h * dry.bristle_stiffness))
        after = (z + h * v) * share
        eased = slipped * bump * v * (2.0 / dry.stribeck_velocity**2)  # by the level, which falls with velocity
        of_bristle = ((h - after * (sign + eased) * inverse * (h * dry.bristle_stiffness)) * share, share)
        return after, after * stiff - z * damping, of_bristle, (of_bristle[0] * stiff, share * stiff - damping)

    def _level(self, v: Value) -> tuple[Value, Value]:
        """What static friction has above Coulomb's at this velocity, N, and the inverse of both."""
        bump = (v * v * (-1.0 / self.dry.stribeck_velocity**2)).exp() * (self.dry.static - self.dry.coulomb)
        return bump, 1.0 / (bump + max(self.dry.coulomb, 1e-3))


def _place(i: int, j: int) -> int:
    """Where an entry of the covariance stands in the memory."""
    return max(i, j) * (max(i, j) + 1) // 2 + min(i, j)
