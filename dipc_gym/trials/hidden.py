"""Parameters of effects, effects made of them, and which names could be one and the same model."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dipc_gym.trials.rigs import Array


@dataclass(frozen=True)
class Parameter:
    """One parameter of an effect.

    Attributes:
        name: its natural name, such as `level`.
        unit: its unit.
        place: its place in the vector of a rig's parameters; `factor` times the parameter is added there.
        low: smallest value, or smallest magnitude for `signed`.
        high: largest.
        kind: `log`, `signed` (log-uniform magnitude, either sign) or `uniform`.
        factor: see `place`.
        also: further places that it is added to, with their factors.
    """

    name: str
    unit: str
    place: int
    low: float
    high: float
    kind: str = "log"
    factor: float = 1.0
    also: tuple[tuple[int, float], ...] = ()

    def draw(self, rng: np.random.Generator) -> float:
        """A value at random."""
        if self.kind == "uniform":
            return float(rng.uniform(self.low, self.high))
        value = float(np.exp(rng.uniform(np.log(self.low), np.log(self.high))))
        return value * float(rng.choice([-1.0, 1.0])) if self.kind == "signed" else value


@dataclass(frozen=True)
class Effect:
    """An effect that may act at one place of one rig.

    Attributes:
        name: id, such as `friction.coulomb`, or `unknown`.
        at: joint, actuator, sensor or body name, or `world`.
        parameters: its parameters; the first one is its size.
        fixed: entries of that vector that come with it, added: (place, value).
        also_at: other places that name the same thing.
        includes: ids that are honest parts of it.
        kind: for `unknown`, which one.
        alike: ids that name the same kind of physics, for a law of some other shape than theirs.
    """

    name: str
    at: str
    parameters: tuple[Parameter, ...]
    fixed: tuple[tuple[int, float], ...] = ()
    also_at: tuple[str, ...] = ()
    includes: tuple[str, ...] = ()
    kind: str = ""
    alike: tuple[str, ...] = ()

    def apply(self, parameters: Array, values: Array) -> Array:
        """Parameters with this effect added."""
        result = parameters.copy()
        for place, value in self.fixed:
            result[place] += value
        for parameter, value in zip(self.parameters, values, strict=True):
            result[parameter.place] += parameter.factor * value
            for place, factor in parameter.also:
                result[place] += factor * value
        return result


@dataclass(frozen=True)
class Hidden:
    """An effect with its values, as it acts in a trial."""

    effect: Effect
    values: tuple[float, ...]

    def apply(self, parameters: Array) -> Array:
        """Parameters with this effect added."""
        return self.effect.apply(parameters, np.asarray(self.values))

    def parameters(self) -> dict[str, dict[str, float | str]]:
        """Natural parameters with units; a static level is also given as such."""
        found: dict[str, dict[str, float | str]] = {
            parameter.name: {"value": value, "unit": parameter.unit}
            for parameter, value in zip(self.effect.parameters, self.values, strict=True)
        }
        if self.effect.alike:  # a shape, which no two people describe by the same parameters
            return {}
        if self.effect.name == "friction.stribeck":
            level, excess = self.values[0], self.values[1]
            found["static"] = {"value": level + excess, "unit": self.effect.parameters[0].unit}
        if self.effect.name == "friction.asymmetric":
            level, share = self.values
            found["forward"] = {"value": level * (1 + share), "unit": self.effect.parameters[0].unit}
            found["backward"] = {"value": level * (1 - share), "unit": self.effect.parameters[0].unit}
        return found


def draw(effect: Effect, rng: np.random.Generator) -> Hidden:
    """The effect with values at random."""
    return Hidden(effect, tuple(parameter.draw(rng) for parameter in effect.parameters))


RIVALS: dict[str, tuple[str, ...]] = {
    "friction.coulomb": ("motor.deadzone",),
    "friction.stribeck": ("friction.coulomb",),
    "friction.viscous": ("motor.back_emf",),
    "friction.asymmetric": ("friction.coulomb", "load.constant"),
    "friction.position": ("friction.coulomb",),
    "friction.load": ("friction.coulomb",),
    "friction.resting": ("friction.coulomb", "friction.stribeck"),
    "load.constant": ("load.tilt", "sensor.bias"),
    "load.tilt": ("load.constant", "sensor.bias"),
    "load.spring": ("load.position", "motor.cogging"),
    "load.position": ("motor.cogging", "load.spring"),
    "inertia.mass": ("sensor.gain",),
    "motor.deadzone": ("friction.coulomb",),
    "motor.inductance": ("timing.delay", "timing.sensor_lag", "transmission.compliance"),
    "motor.back_emf": ("friction.viscous",),
    "motor.cogging": ("load.position",),
    "timing.delay": ("motor.inductance", "timing.sensor_lag"),
    "timing.sensor_lag": ("timing.delay", "motor.inductance"),
    "transmission.backlash": ("transmission.compliance",),
    "transmission.compliance": ("transmission.backlash", "motor.inductance", "timing.delay"),
    "sensor.bias": ("load.tilt", "load.constant"),
    "sensor.gain": ("inertia.mass",),
    "sensor.eccentric": ("load.position", "motor.cogging"),
    "unknown": ("friction.stribeck", "load.spring", "transmission.compliance", "motor.thermal"),
}
"""Names that could be the same model as another on some rig; whether they are is worked out by simulation."""

SETS: dict[str, tuple[tuple[str, ...], ...]] = {
    "friction.asymmetric": (("friction.coulomb", "load.constant"),),
    "load.position": (("load.constant", "load.spring"),),
    "load.tilt": (("load.constant", "sensor.bias"),),
    "load.constant": (("load.tilt", "sensor.bias"),),
    "sensor.bias": (("load.constant", "load.tilt"),),
}
"""Several effects that together could be the same model as a single one; simulation tells here too."""
