"""What an identification run excites, what it leaves out, and whether anything can be learned from it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dipc_gym.compensators import RigConstants, Samples
from dipc_gym.identification.settings import EXCITATION

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Excitation:
    """What the training part of a run covers.

    Attributes:
        force: lowest and highest, N.
        velocity: lowest and highest, m/s.
        most_force: what the blocked motor exerts at full supply, N.
        force_noise: standard deviation of what the readings' noise makes of the force, N.
        reversals: how often the motion turns round.
        counts: (rows, columns) samples in equal cells from minus to plus the largest magnitude: force from the bottom
            up, velocity to the right.
        missing: what is not covered, in sentences.
        refusal: why no compensator can be trained from this, or None.
    """

    force: tuple[float, float]
    velocity: tuple[float, float]
    most_force: float
    force_noise: float
    reversals: int
    counts: NDArray[np.intp]
    missing: tuple[str, ...]
    refusal: str | None

    def report(self) -> str:
        """A few lines and a map for the terminal."""
        (f0, f1), (v0, v1) = self.force, self.velocity
        share = max(-f0, f1) / self.most_force
        covered = ["  " + "".join("#" if n >= EXCITATION.full else "." for n in row) for row in self.counts]
        lines = [
            f"force {f0:.3g} to {f1:.3g} N, {100 * share:.0f} % of what the motor can exert; "
            f"{self.force_noise:.2g} N of it is noise",
            f"velocity {v0:.3g} to {v1:.3g} m/s, {self.reversals} reversals",
            f"covered (# from {EXCITATION.full} samples on; force upwards, velocity to the right):",
            *covered,
            *(f"not covered: {sentence}" for sentence in self.missing),
        ]
        return "\n".join(lines)


def examine(samples: Samples, rig: RigConstants, *, force_noise: float) -> Excitation:
    """Look at what a run covers.

    Args:
        samples: the run; the training part is looked at.
        rig: motor gain and supply.
        force_noise: standard deviation of what the readings' noise makes of the force, N.

    Example:
        >>> time = np.arange(0, 20, 0.005)
        >>> v = 0.3 * np.sin(time * (1 + time))
        >>> force = 40 * v + 1.26 * np.gradient(v, 0.005)
        >>> samples = Samples(force, v, np.roll(v, 1), force / 4 + 2 * np.tanh(v / 0.01), time % 2 < 1)
        >>> found = examine(samples, RigConstants(4.0, 40.0, 24.0), force_noise=0.2)
        >>> found.refusal is None, found.missing
        (True, ())
    """
    train = samples.train
    force, velocity, volts = samples.force[train], samples.velocity[train], samples.voltage[train]
    fast, strong = float(np.abs(velocity).max()), float(np.abs(force).max())
    reversals = _reversals(velocity)
    edges = np.linspace(-strong, strong, EXCITATION.rows + 1), np.linspace(-fast, fast, EXCITATION.columns + 1)
    nothing = fast == 0 or strong == 0
    shape = EXCITATION.rows, EXCITATION.columns
    counts = np.zeros(shape) if nothing else np.histogram2d(force, velocity, bins=edges)[0][::-1]
    return Excitation(
        force=(float(force.min()), float(force.max())),
        velocity=(float(velocity.min()), float(velocity.max())),
        most_force=rig.newtons_per_volt * rig.supply_voltage,
        force_noise=force_noise,
        reversals=reversals,
        counts=counts.astype(np.intp),
        missing=() if nothing else tuple(_missing(force, velocity, counts)),
        refusal=_refusal(force, velocity, volts, force_noise, reversals)
        or _sticking(samples, rig)
        or _impossible(force, volts, rig),
    )


def _missing(force: Array, velocity: Array, counts: Array) -> list[str]:
    found, fast, strong = [], float(np.abs(velocity).max()), float(np.abs(force).max())
    share = float(np.mean(counts >= EXCITATION.full))
    if share < EXCITATION.narrow:
        found.append(f"all but {100 * share:.0f} % of the map; sweep over more frequencies")
    weak = (np.abs(velocity) < fast / EXCITATION.middle) & (np.abs(force) < strong / EXCITATION.middle)
    if np.sum(weak) < EXCITATION.few:
        found.append("weak forces at low speed, where balancing takes place; begin the sweep at a lower frequency")
    for sign, way in ((1, "+x"), (-1, "-x")):
        along = sign * velocity
        if along.max() < EXCITATION.one_sided * fast:
            found.append(f"towards {way} the cart reaches {along.max():.2g} m/s, the other way {fast:.2g}")
        slow = int(np.sum((along > 0) & (along < EXCITATION.slow * fast)))
        if slow < EXCITATION.few:
            found.append(
                f"slow motion towards {way}: {slow} samples below {EXCITATION.slow * fast:.2g} m/s, where friction is "
                "steepest"
            )
        if np.sum((along > 0) & (sign * force < 0)) < EXCITATION.few:
            found.append(f"braking while moving towards {way}: force and velocity hardly ever oppose each other there")
    return found


def _refusal(force: Array, velocity: Array, volts: Array, force_noise: float, reversals: int) -> str | None:
    """Why nothing can be learned: the first reason, with its mend."""
    if np.ptp(volts) == 0:
        return f"the voltage is {volts[0]:g} V throughout; record a run in which it swings, such as a frequency sweep"
    if reversals < EXCITATION.fewest_reversals:
        return (
            f"the motion turns round {reversals} times, and friction shows itself there; record a run that swings back "
            "and forth, such as a frequency sweep"
        )
    size = float(np.sqrt(np.mean(force**2)))
    if force_noise > EXCITATION.loudest * size:
        return (
            f"the encoder's noise makes {force_noise:.2g} N of a force of {size:.2g} N rms; drive the cart harder or "
            "take a finer encoder"
        )
    sign = np.tanh(velocity / (EXCITATION.slow * np.abs(velocity).max()))
    follows = np.column_stack([velocity, sign, np.ones_like(velocity)])
    own = force - follows @ np.linalg.lstsq(follows, force)[0]
    if np.sqrt(np.mean(own**2)) < max(EXCITATION.least_own * size, EXCITATION.above_noise * force_noise):
        return (
            "the force hardly varies independently of velocity, so that the two cannot be told apart; accelerate more, "
            "with higher frequencies"
        )
    everything = np.column_stack([force, follows])
    residual = volts - everything @ np.linalg.lstsq(everything, volts)[0]
    explained = 1 - float(np.var(residual) / np.var(volts))
    if explained < EXCITATION.least_explained:
        return (
            f"force and velocity explain {100 * max(explained, 0.0):.0f} % of the voltage, and of a cart nearly all; "
            "check --map and --unit, that voltage and position have one clock, and that the poles were locked"
        )
    return None


def _sticking(samples: Samples, rig: RigConstants) -> str | None:
    """Why a run shows no dry friction: the cart was pushed so gently that it bent what holds it, and did not slide.

    Friction that slides follows the direction of motion; one that is bent follows position, as a spring.
    """
    if samples.position is None:
        return None
    train = samples.train
    force, velocity, position = samples.force[train], samples.velocity[train], samples.position[train]
    share = float(np.abs(force).max()) / (rig.newtons_per_volt * rig.supply_voltage)
    lost = rig.newtons_per_volt * samples.voltage[train] - force
    sign = np.tanh(velocity / (EXCITATION.slow * np.abs(velocity).max()))

    def left(follows: Array) -> float:
        columns = np.column_stack([follows, velocity, np.ones_like(velocity)])
        return float(np.var(lost - columns @ np.linalg.lstsq(columns, lost)[0]))

    if share > EXCITATION.weak or left(sign) < left(position):
        return None
    return (
        f"the cart moves within {1000 * np.ptp(position):.2g} mm, and what holds it back follows its position, as a "
        "spring does, rather than its direction: it does not slide; drive it harder"
    )


def _impossible(force: Array, volts: Array, rig: RigConstants) -> str | None:
    """Why no such motor drives a cart so: most likely its position has another unit."""
    gain, size = rig.newtons_per_volt, float(np.sqrt(np.mean(force**2)))
    given = gain * float(np.sqrt(np.mean(volts**2)))
    strong, most = float(np.abs(force).max()), gain * rig.supply_voltage
    if strong > EXCITATION.most * most:
        what = f"the motion needs up to {strong:.3g} N, and the motor exerts {most:.3g} N at most"
    elif size < EXCITATION.least * given:
        what = f"the motion needs {size:.2g} N rms, and the motor was given voltages for {given:.3g} N"
    else:
        return None
    return f"{what}; check the cart's unit (--unit) and mass, and the motor's gain"


def _reversals(velocity: Array) -> int:
    """How often the sign changes, jitter about standstill not counted."""
    least = EXCITATION.standstill * float(np.abs(velocity).max())
    moving = np.sign(velocity[np.abs(velocity) > least])
    return int(np.sum(moving[1:] != moving[:-1]))


def force_noise(
    noise: float, response: Array, frequency: Array, *, mass: float, viscous: float, period: float
) -> float:
    """What the noise of position readings makes of the force, N.

    Args:
        noise: standard deviation of the readings, m.
        response: (n,) share of it that the smoothing lets pass, at each frequency.
        frequency: (n,) evenly between 0 and pi, radians per sample.
        mass: moving mass, kg.
        viscous: friction of the linear model, N s/m.
        period: s.

    Example:
        >>> w = np.linspace(0.0, math.pi, 4001)
        >>> round(force_noise(1e-5, np.ones(4001), w, mass=1.0, viscous=0.0, period=0.005), 3)
        0.4
    """
    ahead = np.exp(1j * frequency)
    acceleration = (ahead**2 - ahead - 1 + 1 / ahead) / (2 * period**2)
    passed = response * np.abs(mass * acceleration + viscous * (ahead - 1) / period)
    return noise * math.sqrt(float(np.mean(passed**2)))
