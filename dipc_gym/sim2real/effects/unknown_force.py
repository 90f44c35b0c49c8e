"""What has no name: a force of whatever it goes with, so that the model predicts all the same."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from dipc_gym import mjcf
from dipc_gym.mjcf.edit import Document
from dipc_gym.physics import RESIDUAL
from dipc_gym.sim2real.effects.shared.base import Array, Effect, Evidence, Parameter, Values
from dipc_gym.sim2real.effects.shared.law import bisected, described, extended, holding_new
from dipc_gym.sim2real.effects.shared.settings import LAWS
from dipc_gym.sim2real.effects.shared.surfaces import Surface, surfaces

WORDS = {"position": "the position of {}", "velocity": "the velocity of {}", "command": "the command to {}"}
NEGLIGIBLE = 1e-9  # of the largest force, that one at speed 0 is off by from rounding
BEYOND = 1.2  # times the fastest and largest in the data, up to which a force without a name acts as it does there


class UnknownForce(Effect):
    """A force on a joint as a table of one or two inputs: positions, velocities and commands, of any joint.

    It is asked for last, where no effect of the catalogue comes to the noise, and is no name: it says what the unknown
    depends on, and predicts it. Outside the data it is constant, and it drives nothing beyond the speeds in the data.

    Args:
        shape: what the evidence asked for; None in the catalogue.
        speed: largest of the joint in the data.
        units: of the inputs.
        at: joint.
    """

    id = RESIDUAL
    place = "joint"
    one_of = "unknown force"
    free = True
    of_no_kind = True
    needs_loader = True

    def __init__(
        self, shape: Surface | None = None, speed: float = 1.0, units: Sequence[str] = ("", ""), at: str = ""
    ) -> None:
        self.shape, self.speed, self.units, self.at = shape, speed, tuple(units), at
        levels = [] if shape is None else shape.levels.ravel().tolist()
        self.first = {f"level_{k + 1}": level for k, level in enumerate(levels)}
        size = max((abs(level) for level in levels), default=1.0) or 1.0
        self.parameters = tuple(
            Parameter(name, "N", step=LAWS.step * size, sigma=LAWS.loose / LAWS.step) for name in self.first
        )
        self.linear = tuple(self.first)

    def proposals(self, evidence: Evidence) -> Sequence[tuple[Effect, Values]]:
        """Tables of what tells most of the unexplained force, and one of the joint's own motion.

        Under feedback all joints and the command move together; which of them a force follows only a fit tells.
        """
        at, speed = evidence.at, driven_up_to(evidence)
        own = {name: x for name, x in evidence.inputs.items() if name in (f"position {at}", f"velocity {at}")}
        found: dict[tuple[str, ...], tuple[Effect, Values]] = {}
        asked = [
            one
            for inputs in (evidence.inputs, own)
            for one in surfaces(inputs, evidence.force, evidence.time, evidence.width)
        ]
        for shape in asked:
            if shape.inputs not in found and shape.inputs != (f"position {at}",):  # that is a law of a kind
                units = [unit_of(evidence.model, one) for one in shape.inputs]
                shaped = UnknownForce(shape, speed, units, at)
                found[shape.inputs] = shaped, shaped.first
        return list(found.values())

    def inputs(self, at: str) -> tuple[str, ...]:
        """Those of its table."""
        return () if self.shape is None else self.shape.inputs

    def guesses(self, evidence: Evidence) -> Sequence[Values]:
        """Of a law that has its shape, the values it was given."""
        return [self.first] if self.shape is not None else []

    def finer(self, values: Values, told: NDArray[np.bool_] | None = None) -> Sequence[tuple[Effect, Values]]:
        """A knot more in each stretch, along one input or the other."""
        if self.shape is None:
            return []
        levels = np.reshape([values[name] for name in self.first], self.shape.levels.shape)
        found: list[tuple[Effect, Values]] = []
        for axis, old in enumerate(self.shape.knots):
            others = tuple(k for k in range(levels.ndim) if k != axis)
            here = None if told is None else np.asarray(told.reshape(levels.shape).any(axis=others))
            knots = bisected(old, (old[-1] - old[0]) / LAWS.narrowest, here)
            if len(knots) == len(old) or levels.size // len(old) * len(knots) > LAWS.most_levels:
                continue
            more = _at_knots(levels, axis, old, knots)
            axes = (*self.shape.knots[:axis], knots, *self.shape.knots[axis + 1 :])
            shaped = UnknownForce(Surface(self.shape.inputs, axes, more), self.speed, self.units, self.at)
            new = np.broadcast_to(np.expand_dims(~np.isin(knots, old), tuple(range(1, levels.ndim - axis))), more.shape)
            shaped.parameters = holding_new(shaped.parameters, new.ravel())
            found.append((shaped, shaped.first))
        return found

    def axes(self, at: str) -> tuple[str, ...]:
        """Its inputs."""
        return self.inputs(at)

    def reaching(self, values: Values, spans: Sequence[tuple[float, float]]) -> tuple[Effect, Values] | None:
        """The same law with a table that goes as far as its inputs do, on as it ends. None where it goes as far, or
        would be too large.

        Args:
            values: of the parameters.
            spans: smallest and largest of each input.
        """
        assert self.shape is not None
        levels = np.reshape([values[name] for name in self.first], self.shape.levels.shape)
        axes = tuple(extended(old, *ends) for old, ends in zip(self.shape.knots, spans, strict=True))
        shape = [len(knots) for knots in axes]
        if shape == list(levels.shape) or np.prod(shape) > LAWS.most_levels:
            return None
        new = np.zeros(shape, dtype=bool)
        for axis, (knots, old) in enumerate(zip(axes, self.shape.knots, strict=True)):
            levels = _at_knots(levels, axis, old, knots)
            new |= np.expand_dims(~np.isin(knots, old), tuple(k for k in range(len(shape)) if k != axis))
        own = f"velocity {self.at}"
        fastest = max(map(abs, spans[self.shape.inputs.index(own)])) if own in self.shape.inputs else 0.0
        speed = max(self.speed, BEYOND * fastest)
        shaped = UnknownForce(Surface(self.shape.inputs, axes, levels), speed, self.units, self.at)
        shaped.parameters = holding_new(shaped.parameters, new.ravel())
        return shaped, shaped.first

    def edit(self, document: Document, at: str, values: Values) -> None:
        """A table for the loader; stock MuJoCo leaves it out."""
        assert self.shape is not None
        first, second = (*self.shape.knots, np.zeros(1))[:2]
        levels = [values[name] for name in self.first]
        document.custom(RESIDUAL, at, [self.speed, len(first), len(second), *first, *second, *levels])
        document.depends(RESIDUAL, at, self.shape.inputs)

    def law_of(self, values: Values, unit: Mapping[str, str]) -> dict[str, Any] | None:
        """Knots along one or two inputs, and levels; with two a row over the second for each knot of the first."""
        if self.shape is None:
            return None
        inputs = [
            {"name": name, "unit": of, "knots": knots.tolist()}
            for name, of, knots in zip(self.shape.inputs, self.units, self.shape.knots, strict=False)
        ]
        levels = np.reshape([values[name] for name in self.first], self.shape.levels.shape)
        force = next(iter(unit.values()))
        passive = self._takes(levels)
        return described("force", inputs, levels.tolist(), force, passive=passive, driven_up_to=self.speed)

    def _takes(self, levels: Array) -> bool:
        """Whether the force is against the joint's own motion wherever the table has one."""
        assert self.shape is not None
        own = [k for k, name in enumerate(self.shape.inputs) if name == f"velocity {self.at}"]
        if not own:
            return False
        knots = self.shape.knots[own[0]]
        # Between two knots a line may pass through speed 0 elsewhere than through force 0, and drives there.
        speeds = np.union1d(knots, 0.0) if knots[0] < 0 < knots[-1] else knots
        forces = np.moveaxis(_at_knots(levels, own[0], knots, speeds), own[0], -1)
        driven = np.where(speeds == 0, np.abs(forces), forces * np.sign(speeds))
        return bool(np.all(driven <= NEGLIGIBLE * np.max(np.abs(forces), initial=0.0)))

    def sentence(self, at: str, values: Values, unit: Mapping[str, str]) -> str:
        """In words."""
        assert self.shape is not None
        levels, force = [values[name] for name in self.first], next(iter(unit.values()))
        inputs = map(in_words, self.shape.inputs)
        return (
            f"Something acts at {at} that no effect in the catalogue accounts for; modelled as a force of "
            f"{min(levels):.3g} to {max(levels):.3g} {force} that depends on {' and '.join(inputs)}."
        )


def _at_knots(levels: Array, axis: int, old: Array, knots: Array) -> Array:
    """A table's levels at other knots along one of its inputs; beyond its ends it goes on as it ends."""
    hats = np.stack([np.interp(knots, old, unit) for unit in np.eye(len(old))], axis=1)
    return np.asarray(np.moveaxis(np.tensordot(hats, levels, axes=(1, axis)), 0, axis))


def driven_up_to(evidence: Evidence) -> float:
    """Speed of the joint, beyond which a force without a name drives no further."""
    return BEYOND * float(np.max(np.abs(evidence.velocity))) or 1.0


def in_words(one: str) -> str:
    """An input, as a sentence has it."""
    kind, _, name = one.partition(" ")
    return WORDS[kind].format(name)


def unit_of(model: mujoco.MjModel, one: str) -> str:
    """Unit of an input."""
    kind, _, name = one.partition(" ")
    if kind == "command":
        return ""
    return mjcf.units(model, name).length + ("/s" if kind == "velocity" else "")
