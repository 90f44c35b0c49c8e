"""Other gains than the printed one, what friction makes of a gain, and dither.

The gains are designed for the linear model of the paper's rig, sampled exactly at 5 ms.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dipc_gym import mjcf
from dipc_gym.controllers import lqr
from dipc_gym.controllers.base import Controller

if TYPE_CHECKING:
    from dipc_gym.dataflow import Program, Value

Array = NDArray[np.float64]

PERIOD = 0.005  # s, the paper's control period


@functools.cache
def paper_model() -> tuple[Array, Array]:
    """A (6, 6) and B (6, 1) of the paper's rig, from `rig.xml`."""
    text = resources.files("dipc_gym").joinpath("rig.xml").read_text(encoding="utf-8")
    return lqr.linear_model(mjcf.compile(mjcf.Source(None, Path(), text), trusted=True))


@dataclass(frozen=True)
class LimitCycle:
    """The oscillation that a describing function predicts.

    Attributes:
        rate: rad/s.
        cart: amplitude of the cart, m.
    """

    rate: float
    cart: float


def limit_cycle(gain: Array, coulomb: float) -> LimitCycle | None:
    """The limit cycle that Coulomb friction makes of a gain on the paper's rig, by harmonic balance; None if none.

    Friction is a relay on the cart's velocity, whose describing function is 4 Fc / (pi a) at an amplitude a. A cycle is
    where the closed loop from friction to velocity turns it by half a turn. No gain avoids it: a cart that sticks
    leaves poles that fall, so every equilibrium with the cart at rest is unstable. A gain can only make it small.

    Args:
        gain: (6,) of the state feedback.
        coulomb: friction, N.

    Source:
        Armstrong-Helouvry, Dupont, Canudas de Wit, Automatica 30 (1994) 1083-1138, section 4.

    Example:
        >>> found = limit_cycle(lqr.PRINTED_GAIN, 8.0)
        >>> round(1000 * found.cart), round(float(found.rate), 1)
        (40, 4.7)
    """
    A, B = paper_model()
    closed = A - B @ gain[None]
    rates = np.geomspace(0.1, 100.0, 8000)
    values, vectors = np.linalg.eig(closed)
    share = np.linalg.solve(vectors, B[:, 0].astype(complex)) * vectors[3]
    response = (share / (1j * rates[:, None] - values)).sum(axis=1)
    turned = np.flatnonzero((response.imag[:-1] * response.imag[1:] < 0) & (response.real[:-1] < 0))
    if not len(turned):
        return None
    cycles = [LimitCycle(rates[i], 4 * coulomb / math.pi * abs(response[i]) / rates[i]) for i in turned.tolist()]
    return max(cycles, key=lambda cycle: cycle.cart)


def gain_of(cart: float, effort: float) -> Array:
    """Gain (6,) at 5 ms for the recovered Q with another weight of the cart's position, and another of the force."""
    Q = lqr.RECOVERED_Q.copy()
    Q[0, 0] = cart
    F, G = lqr.sampled(*paper_model(), PERIOD)
    return lqr.dlqr(F, G, Q, effort)[0]


@dataclass(frozen=True, eq=False)
class Dither:
    """The printed gain plus a square wave that shakes the cart loose (`dither`).

    Below the force of static friction it does nothing; 30 N of 25 Hz, three times that force, move the cart some tenths
    of a millimetre and take the limit cycle away, at a cost of force far above what they save.

    Attributes:
        gain: (6,) N per unit of the observation.
        amplitude: of the wave, N.
        half: control periods for which it stays on one side.

    Source:
        Zames, Shneydor, "Dither in nonlinear systems", IEEE Transactions on Automatic Control 21 (1976) 660-667.

    Example:
        >>> shaking = Dither()
        >>> [shaking.force(np.zeros(6)) for _ in range(5)]
        [30.0, 30.0, 30.0, 30.0, -30.0]
    """

    gain: Array = field(default_factory=lqr.PRINTED_GAIN.copy)
    amplitude: float = 30.0
    half: int = 4
    name: str = "dither"
    _calls: list[int] = field(default_factory=lambda: [0], init=False, repr=False, compare=False)

    def reset(self) -> None:
        """Begin the wave anew."""
        self._calls[0] = 0

    def force(self, observation: Array) -> float:
        """Minus gain times state, plus the wave, which goes on from call to call."""
        side = self._calls[0] // self.half % 2
        self._calls[0] += 1
        return -float(self.gain @ observation) + (-self.amplitude if side else self.amplitude)

    def express(self, program: Program, observation: Value) -> Value:
        """The same, written into a program that can be exported; the wave begins anew with a reset."""
        calls = program.state("calls", 0.0)
        program.update(calls, (calls + 1.0).below(2.0 * self.half).choose(calls + 1.0, 0.0))
        return observation.affine(-self.gain) + calls.below(float(self.half)).choose(self.amplitude, -self.amplitude)


def _designed(name: str, cart: float, effort: float) -> Callable[[], Controller]:
    return lambda: lqr.LQR(_gain(cart, effort), name)


@functools.cache
def _gain(cart: float, effort: float) -> Array:
    return gain_of(cart, effort)


DESIGNS: dict[str, Callable[[], Controller]] = {
    "lqr_sampled": _designed("lqr_sampled", 1e3, 1.0),
    "lqr_cart": _designed("lqr_cart", 1e5, 1.0),
    "lqr_quiet": _designed("lqr_quiet", 1e5, 0.1),
    "dither": Dither,
}
"""Beside the printed gain: the same weights at 5 ms; the cart weighed a hundred times; the smallest of the limit cycles
that `limit_cycle` predicts for weights of cart and force changed by decades, up to a hundred and down to a tenth; and
dither."""
