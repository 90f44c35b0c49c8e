"""A part of what a joint moves swings on its own, by a law: wide swings are slower than small ones, or faster."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dipc_gym.engine.swing import Spring
from dipc_gym.mjcf.edit import Document
from dipc_gym.sim2real.effects.shared.base import Effect, Evidence, Parameter, Values
from dipc_gym.sim2real.effects.shared.coupling import bend, beside, couple
from dipc_gym.sim2real.effects.shared.law import FAR, at_joint, described, either_way, halved
from dipc_gym.sim2real.effects.shared.loads import DAMPED, FLATTEST, RATES, STEEPEST, Load, most_alike, slope_of, smooth
from dipc_gym.sim2real.effects.shared.settings import LAWS
from dipc_gym.sim2real.effects.shared.tables import between

Array = NDArray[np.float64]

SHARES = (0.35, 0.65, 0.85, 0.97)  # of all samples the load is nearer than a knot: most of them near the middle
FINEST = 20  # stretches between knots: as many springs are followed in each simulation
BENDS: tuple[Callable[[Array], Array], ...] = (np.tanh, np.sinh)  # a rope or a fluid softens, a link or rubber hardens
WIDE = (1.0, 2.5)  # swings, in what they bend by
TOLD = 8  # lines of an exported table that follow the curve from one knot to the next
FURTHER = 1.2  # times the widest swing, which the table goes up to: a fit may swing it a little wider


class SwingingLoadOfAnyLaw(Effect):
    """One hidden mode whose spring is any rising function of its stretch: a load on a rope, a sloshing fluid, rubber.

    As plain MJCF: `load.swinging`, and beside its spring others that pull or soften from some stretch on, either way,
    all together a smooth curve. Beyond the last knot its slope stays as it is there.

    Args:
        knots: stretches that divide the curve, the first 0, m or rad; none in the catalogue.
        first: guess of the parameters of `load.swinging`, and of slopes.
    """

    id = "load.swinging:law"
    place = "joint"
    one_of = "swinging load"
    free = True
    rivals = ("transmission.compliance", "transmission.backlash", "friction.hysteresis", "residual.force")
    contains = ("load.swinging",)

    def __init__(self, knots: Sequence[float] = (), first: Values | None = None) -> None:
        self.knots, self.first = tuple(map(float, knots)), dict(first or {})
        sigma = LAWS.loose / LAWS.step
        slopes = (Parameter(_slope(k), "", FLATTEST, STEEPEST, log=True, sigma=sigma) for k in range(1, len(knots) - 1))
        self.parameters = (
            ()
            if not self.knots
            else (
                Parameter("mass", "kg", 1e-9, log=True),
                Parameter("small_swing_frequency", "Hz", 0.05, 60.0, log=True, fine=0.1),
                Parameter("damping_ratio", "", 1e-3, 3.0, log=True),
                *slopes,
            )
        )

    def inputs(self, at: str) -> tuple[str, ...]:
        """How wide the load swings, which no sensor reads: where it never swung so wide, its spring is not known."""
        return (f"swing {at}",)

    def proposals(self, evidence: Evidence) -> Sequence[tuple[Effect, Values]]:
        """Of springs that soften and of those that harden, the load that pulls most like the unexplained force."""
        found = []
        swings = _swings(evidence)
        for load, mass in (one for bent in BENDS for one in most_alike(evidence, _tries(bent, swings))):
            begin = {
                "mass": mass,
                "small_swing_frequency": load.rate / (2 * np.pi),
                "damping_ratio": load.ratio,
            }
            found.append(self._shaped(load.knots, begin, load.slopes[1:]))
        return found

    def guesses(self, evidence: Evidence) -> Sequence[Values]:
        """Of a law that has its shape, what it begins with."""
        return [self.first] if self.first else []

    def finer(self, values: Values, told: NDArray[np.bool_] | None = None) -> Sequence[tuple[Effect, Values]]:
        """A slope more in each stretch of the table."""
        knots = halved(np.array(self.knots))
        if len(knots) - 1 > FINEST:
            return []
        slope = slope_of(self.knots, self._slopes(values).tolist())
        # A parabola over half a stretch is drawn by this, which leaves the curve as it is.
        finer = 2 * slope(0.5 * (knots[1:] + knots[:-1])) - 0.5 * (slope(knots[1:]) + slope(knots[:-1]))
        return [self._shaped(knots.tolist(), values, finer[1:].tolist())]

    def edit(self, document: Document, at: str, values: Values) -> None:
        """A body beside the one that the joint moves, and springs between them."""
        mass, rate = values["mass"], 2 * np.pi * values["small_swing_frequency"]
        name = beside(document, f"{at}_load", at, mass)
        (_, stiffness, cubic), *others = self._springs(values)
        couple(document, name, name, at, stiffness, 2 * values["damping_ratio"] * rate * mass, cubic)
        for other in others:
            bend(document, name, name, at, *other)

    def law_of(self, values: Values, unit: Mapping[str, str]) -> dict[str, Any]:
        """What the spring pulls with, by its stretch."""
        force, last = _force(unit), self.knots[-1]
        knots = np.append(between(np.array(self.knots), TOLD), FAR * last)
        inputs = [{"name": "stretch", "unit": at_joint("m", force), "knots": either_way(knots.tolist())}]
        damping = 2 * values["damping_ratio"] * 2 * np.pi * values["small_swing_frequency"] * values["mass"]
        how = (
            f"The stretch is how far a part of {values['mass']:.4g} {unit['mass']} has moved ahead of the joint that "
            "carries it; this force pulls that part back and the joint along, and so do "
            f"{damping:.4g} {force} for each {at_joint('m', force)}/s that the part is faster."
        )
        pulls = either_way(self._pulls(values, knots).tolist())
        return described("force", inputs, pulls, force, passive=True, remembers=how, supported=[[-last, last]])

    def sentence(self, at: str, values: Values, unit: Mapping[str, str]) -> str:
        """In words."""
        slide, last = at_joint("m", _force(unit)), self._slopes(values)[-1]
        how = "harder" if last > 1 else "softer"
        return (
            f"A part of what {at} moves, {values['mass']:.3g} {unit['mass']}, swings on its own by a law of its own: "
            f"at {values['small_swing_frequency']:.3g} Hz where it swings little, with a damping ratio of "
            f"{values['damping_ratio']:.2g}, and {how} where it swings wide (at {self.knots[-1]:.3g} {slide} its "
            f"spring is {last:.2g} times as stiff)."
        )

    def _shaped(self, knots: Sequence[float], values: Values, slopes: Sequence[float]) -> tuple[Effect, Values]:
        plain = {name: values[name] for name in ("mass", "small_swing_frequency", "damping_ratio")}
        begin = plain | {_slope(k + 1): float(np.clip(v, FLATTEST, STEEPEST)) for k, v in enumerate(slopes)}
        return type(self)(knots, begin), begin

    def _slopes(self, values: Values) -> Array:
        return np.array([1.0, *(values[p.name] for p in self.parameters[3:])])

    def _springs(self, values: Values) -> list[Spring]:
        """What makes up the spring: slack, m or rad, N/m or N m/rad, and N/m^3 or N m/rad^3."""
        stiffness = values["mass"] * (2 * np.pi * values["small_swing_frequency"]) ** 2
        return smooth(self.knots, (stiffness * self._slopes(values)).tolist())

    def _pulls(self, values: Values, stretches: Array) -> Array:
        """What it pulls with, N or N m, (n,)."""
        return np.sum([one.pull(stretches) for one in self._springs(values)], axis=0)


def _slope(k: int) -> str:
    return f"slope_{k + 1}"


def _force(unit: Mapping[str, str]) -> str:
    return "N m" if unit["mass"].endswith("m^2") else "N"


def _swings(evidence: Evidence) -> list[tuple[float, Array]]:
    """Rates, rad/s, and knots (k + 1,) where a spring would have them, by how wide a load on a straight one swings."""
    found = []
    for rate in RATES.tolist():
        away = np.abs(Load(rate).swung(evidence)[0])
        knots = np.array([0.0, *np.quantile(away, SHARES), FURTHER * away.max()])
        if np.all(np.diff(knots) > 0):
            found.append((rate, knots))
    return found


def _tries(bent: Callable[[Array], Array], swings: Sequence[tuple[float, Array]]) -> Iterator[Load]:
    """Loads whose spring bends that way."""
    for rate, knots in swings:
        for wide in WIDE:
            slopes = np.diff(bent(wide * knots / knots[-1])) / np.diff(knots)
            yield Load(rate, DAMPED, tuple(knots.tolist()), tuple((slopes / slopes[0]).tolist()))
