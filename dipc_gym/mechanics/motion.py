"""The whole motion of a cart with two poles, not only near an equilibrium, from its linear model about upright.

    D(q) q'' = [F - viscous v + d2 sin a p^2 + d3 sin b r^2,
                d2 g sin a - d5 sin(a-b) r^2,
                d3 g sin b + d5 sin(a-b) p^2]
    D(q) = [[d1, d2 cos a, d3 cos b], [d2 cos a, d4, d5 cos(a-b)], [d3 cos b, d5 cos(a-b), d6]]

with q = (cart, a, b), absolute angles from upright, rates (v, p, r). The six numbers and gravity follow from A and B of
the linear model, as the paper's parameters followed from its printed ones.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dipc_gym import kernels

Array = NDArray[np.float64]

POSTURES: Mapping[str, tuple[bool, bool]] = MappingProxyType(
    {"down-down": (False, False), "down-up": (False, True), "up-down": (True, False), "up-up": (True, True)}
)
"""The equilibria, first pole first: which of the poles point up."""

SIZE = 8
"""Of an observation that has no jump where an angle comes round."""

LOOSE = 1e-4
"""Share by which a linear model may differ from the one that the numbers found in it give."""


def observed(state: Array) -> Array:
    """What `DIPC-Friction-SwingUp-v0` observes of states.

    Args:
        state: (..., 6) as `DIPC-Friction-v0` observes them.

    Returns:
        (..., 8) cart, cosine and sine of each absolute angle, and the three rates.

    Example:
        >>> observed(np.array([0.1, 0.0, np.pi, 0.2, 0.3, 0.4])).round(9).tolist()
        [0.1, 1.0, 0.0, -1.0, 0.0, 0.2, 0.3, 0.4]
    """
    seen = np.empty((*state.shape[:-1], SIZE))
    seen[..., 0], seen[..., 5:] = state[..., 0], state[..., 3:]
    angles = state[..., 1:3]
    seen[..., 1:4:2], seen[..., 2:5:2] = kernels.cosine(angles), kernels.sine(angles)
    return seen


def state_of(observation: Array) -> Array:
    """The states (..., 6) of observations (..., 8): angles absolute, from upright, within half a turn.

    Example:
        >>> state_of(observed(np.array([0.1, 0.3, -2.0, 0.2, 0.3, 0.4]))).round(9).tolist()
        [0.1, 0.3, -2.0, 0.2, 0.3, 0.4]
    """
    observation = np.asarray(observation, dtype=np.float64)
    angles = np.arctan2(observation[..., 2:5:2], observation[..., 1:4:2])
    return np.concatenate([observation[..., :1], angles, observation[..., 5:]], axis=-1)


@dataclass(frozen=True)
class Motion:
    """A cart with two poles in a plane.

    Attributes:
        d: (d1, ..., d6) kg, kg m, kg m, kg m^2, kg m^2, kg m^2.
        gravity: m/s^2.
        viscous: friction on the cart, N s/m, back-EMF included.

    Example:
        >>> from dipc_gym.controllers.designs import paper_model
        >>> motion = Motion.of(*paper_model())
        >>> round(motion.d[0], 6), round(motion.viscous, 6), round(motion.gravity, 6)
        (1.259999, 40.0, 9.81)
    """

    d: tuple[float, float, float, float, float, float]
    gravity: float
    viscous: float

    @classmethod
    def of(cls, A: ArrayLike, B: ArrayLike) -> Motion:
        """The motion whose linear model about upright is dx/dt = A x + B F.

        Args:
            A: (6, 6).
            B: (6,) or (6, 1).

        Raises:
            ValueError: there is none; the model is no cart with two poles in a plane, with friction on the cart alone.
        """
        A, B = np.asarray(A, dtype=float), np.asarray(B, dtype=float).reshape(-1)
        with np.errstate(all="ignore"):
            weights = A[3, 1] / B[4], A[3, 2] / B[5]  # d2 g and d3 g, for the inverse of D is symmetric
            inverse = np.column_stack([B[3:], A[3:, 1] / weights[0], A[3:, 2] / weights[1]])
            try:
                D = np.linalg.inv(inverse)
            except np.linalg.LinAlgError:
                D = np.full((3, 3), np.nan)
            d1, d2, d3, d4, d5, d6 = D[np.triu_indices(3)].tolist()
            found = cls((d1, d2, d3, d4, d5, d6), float(weights[0] / D[0, 1]), float(-A[3, 3] / B[3]))
            again, other = found.linear(np.zeros(6), 0.0) if np.isfinite(D).all() else (A + np.nan, B)
        size = np.abs(A).max(), np.abs(B).max()
        if not (np.abs(again - A).max() <= LOOSE * size[0] and np.abs(other - B).max() <= LOOSE * size[1]):
            raise ValueError(
                "the linear model is not that of a cart with two poles in a plane, with friction on the cart alone"
            )
        return found

    def mass(self, angles: Array) -> Array:
        """D, (..., 3, 3), for absolute angles (..., 2)."""
        d1, d2, d3, d4, d5, d6 = self.d
        a, b = angles[..., 0], angles[..., 1]
        D = np.empty((*a.shape, 3, 3))
        D[..., 0, 0], D[..., 1, 1], D[..., 2, 2] = d1, d4, d6
        D[..., 0, 1] = D[..., 1, 0] = d2 * np.cos(a)
        D[..., 0, 2] = D[..., 2, 0] = d3 * np.cos(b)
        D[..., 1, 2] = D[..., 2, 1] = d5 * np.cos(a - b)
        return D

    def rate(self, state: Array, force: Array) -> Array:
        """Rates (..., 6) of states (..., 6) under forces (...) on the cart, N."""
        return np.concatenate([state[..., 3:], self._solved(state, self._pushed(state, force))], axis=-1)

    def after(self, state: Array, force: Array, period: float) -> Array:
        """States (..., 6) after a period, s, in which the force is held: one step of Runge and Kutta's fourth order."""
        k1 = self.rate(state, force)
        k2 = self.rate(state + 0.5 * period * k1, force)
        k3 = self.rate(state + 0.5 * period * k2, force)
        k4 = self.rate(state + period * k3, force)
        return state + period / 6 * (k1 + 2 * (k2 + k3) + k4)

    def linear(self, state: Array, force: Array | float) -> tuple[Array, Array]:
        """A (..., 6, 6) and B (..., 6) about states (..., 6) under forces (...)."""
        _, d2, d3, _, d5, _ = self.d
        x, a, b, _, p, r = np.moveaxis(np.asarray(state, dtype=float), -1, 0)
        acceleration = self.rate(state, np.asarray(force))[..., 3:]
        _, bent1, bent2 = np.moveaxis(acceleration, -1, 0)
        first = acceleration[..., 0]
        sine, both, spread = np.sin, np.sin(a - b), np.cos(a - b)
        slope = np.zeros((*x.shape, 3, 6))  # of what stands right, less that of D times the acceleration
        slope[..., 0, 1] = d2 * np.cos(a) * p * p + d2 * sine(a) * bent1
        slope[..., 0, 2] = d3 * np.cos(b) * r * r + d3 * sine(b) * bent2
        slope[..., 0, 3], slope[..., 0, 4] = -self.viscous, 2 * d2 * sine(a) * p
        slope[..., 0, 5] = 2 * d3 * sine(b) * r
        one, other = d5 * spread * r * r - d5 * both * bent2, d5 * spread * p * p + d5 * both * bent1
        slope[..., 1, 1] = d2 * self.gravity * np.cos(a) + d2 * sine(a) * first - one
        slope[..., 1, 2] = one
        slope[..., 1, 5] = -2 * d5 * both * r
        slope[..., 2, 1] = other
        slope[..., 2, 2] = d3 * self.gravity * np.cos(b) + d3 * sine(b) * first - other
        slope[..., 2, 4] = 2 * d5 * both * p
        A, B = np.zeros((*x.shape, 6, 6)), np.zeros((*x.shape, 6))
        A[..., [0, 1, 2], [3, 4, 5]] = 1.0
        D = self.mass(np.stack([a, b], axis=-1))
        A[..., 3:, :] = np.linalg.solve(D, slope)
        B[..., 3:] = np.linalg.inv(D)[..., 0]
        return A, B

    def _pushed(self, state: Array, force: Array) -> Array:
        _, d2, d3, _, d5, _ = self.d
        _, a, b, v, p, r = np.moveaxis(state, -1, 0)
        both = d5 * np.sin(a - b)
        return np.stack(
            [
                force - self.viscous * v + d2 * np.sin(a) * p * p + d3 * np.sin(b) * r * r,
                d2 * self.gravity * np.sin(a) - both * r * r,
                d3 * self.gravity * np.sin(b) + both * p * p,
            ],
            axis=-1,
        )

    def _solved(self, state: Array, right: Array) -> Array:
        """Accelerations, by Cramer's rule: the same bits for one state and for many."""
        D = self.mass(state[..., 1:3])
        m00, m01, m02, m11, m12, m22 = (D[..., i, j] for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)))
        f0, f1, f2 = np.moveaxis(right, -1, 0)
        c00, c01, c02 = m11 * m22 - m12 * m12, m02 * m12 - m01 * m22, m01 * m12 - m02 * m11
        c11, c12, c22 = m00 * m22 - m02 * m02, m01 * m02 - m00 * m12, m00 * m11 - m01 * m01
        size = m00 * c00 + m01 * c01 + m02 * c02
        return np.stack(
            [
                (c00 * f0 + c01 * f1 + c02 * f2) / size,
                (c01 * f0 + c11 * f1 + c12 * f2) / size,
                (c02 * f0 + c12 * f1 + c22 * f2) / size,
            ],
            axis=-1,
        )
