"""What has no name and goes in proportion to one thing, by a factor that depends on another."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dipc_gym import mjcf
from dipc_gym.mjcf.edit import Document
from dipc_gym.physics import RESIDUAL
from dipc_gym.sim2real.effects.shared.base import Effect, Evidence, Values, joint_of
from dipc_gym.sim2real.effects.shared.law import FAR, Array, Law, described, holding_new
from dipc_gym.sim2real.effects.shared.smoothing import smoothing
from dipc_gym.sim2real.effects.shared.tables import grow, odd_blocks
from dipc_gym.sim2real.effects.unknown_force import BEYOND, driven_up_to, in_words, unit_of

MOST = 2  # that are proposed: each costs a fit


class UnknownProduct(Law):
    """A force in proportion to a velocity or a command, by a factor that is any function of a position.

    A drag that is larger on one stretch, a drive that pulls harder here than there: a table of both inputs would need
    the square of the knots, and be coarse. It is asked for last and is no name, as `unknown_force` is.

    Args:
        knots: of the position.
        values: of the force there, where what it is in proportion to is as large as `most`.
        inputs: names of the position, and of what it is in proportion to.
        most: of that, in its unit.
        speed: of the joint, up to which it drives.
        units: of both inputs.
    """

    id = f"{RESIDUAL}:product"
    place = "joint"
    one_of = "unknown force"
    of_no_kind = True
    needs_loader = True
    unit = "N"
    kind = "force"

    def __init__(
        self,
        knots: Sequence[float] = (),
        values: Sequence[float] = (),
        inputs: tuple[str, str] = ("", ""),
        most: float = 1.0,
        speed: float = 1.0,
        units: tuple[str, str] = ("", ""),
    ) -> None:
        super().__init__(knots, values)
        self.names, self.most, self.speed, self.units = inputs, most, speed, units

    @property
    def labels(self) -> tuple[str, str]:
        """What a table of it calls its inputs."""
        return self.names

    def each(self, unit: str) -> str:
        """Unit of the factor."""
        return f"{unit} per {self.units[1] or 'unit'}"

    def inputs(self, at: str) -> tuple[str, ...]:
        """Both."""
        return self.names

    def axes(self, at: str) -> tuple[str, ...]:
        """The position."""
        return self.names[:1]

    def table(self, evidence: Evidence) -> None:
        """None: it has two inputs, which `proposals` chooses."""

    def proposals(self, evidence: Evidence) -> Sequence[tuple[Effect, Values]]:
        """The products that take most of the unexplained force, of blocks of time that did not fit them."""
        tried = []
        for carrier in carriers(evidence):
            for position in (name for name in evidence.inputs if name.startswith("position ")):
                found = self._grown(evidence, position, carrier)
                if found is not None:
                    tried.append(found)
        best = sorted(tried, key=lambda one: one[0])[:MOST]
        return [(shaped, shaped.guess) for _, shaped in best]

    def _grown(self, evidence: Evidence, position: str, carrier: str) -> tuple[float, UnknownProduct] | None:
        """What a product leaves of the force, and the product; None where one of its inputs never changes."""
        found = self._over(evidence, evidence.inputs[position], carrier)
        if found is None:
            return None
        left, most, knots, values = found
        units = (unit_of(evidence.model, position), unit_of(evidence.model, carrier))
        speed, names = driven_up_to(evidence), (position, carrier)
        return left, UnknownProduct(knots.tolist(), values.tolist(), names, most, speed, units)

    def _over(self, evidence: Evidence, x: Array, carrier: str) -> tuple[float, float, Array, Array] | None:
        """A product with a factor of x (n,): what it leaves of the force, the most of the carrier, knots and values.

        None where one of both never changes.
        """
        y = evidence.inputs[carrier]
        most = BEYOND * float(np.abs(y).max())
        if not (most > 0 and np.ptp(x) > 0):
            return None
        others = beside_product(evidence)
        knots, values = grow(x, evidence.force, y / most, others, evidence.time, evidence.width)
        if len(knots) == 2 and np.ptp(values) == 0:
            return None
        mean = smoothing(evidence.time, evidence.width)
        late, force = odd_blocks(mean @ evidence.time), mean @ evidence.force
        columns = mean @ np.column_stack([np.interp(x, knots, values) * y / most, *others])
        left = 0.0
        for fitted, told in ((late, ~late), (~late, late)):
            weights = np.linalg.lstsq(columns[fitted], force[fitted], rcond=None)[0]
            left += float(np.sum((force[told] - columns[told] @ weights) ** 2))
        return left, most, knots, values

    def _begun(self, knots: Array, values: Array, new: NDArray[np.bool_]) -> tuple[Effect, Values]:
        shaped = UnknownProduct(knots.tolist(), values.tolist(), self.names, self.most, self.speed, self.units)
        shaped.parameters = holding_new(shaped.parameters, new)
        return shaped, shaped.guess

    def _surface(self, values: Values, across: Sequence[float]) -> tuple[list[float], list[float], Array]:
        """The same as a table of both: knots along the first and some of the second, and levels."""
        along, levels = self.written(values)
        return along.tolist(), list(across), np.outer(levels, np.array(across) / self.most)

    def _numbers(self, values: Values) -> list[float]:
        """The same as the loader reads it, with two knots along what it is in proportion to, beyond the data as well.

        A drag does not let go of a joint that is faster, and what drives it fades there.
        """
        far = FAR * self.most
        along, across, levels = self._surface(values, (-far, far))
        return [self.speed, len(along), len(across), *along, *across, *levels.ravel().tolist()]

    def edit(self, document: Document, at: str, values: Values) -> None:
        """A table for the loader; stock MuJoCo leaves it out."""
        document.custom(RESIDUAL, at, self._numbers(values))
        document.depends(RESIDUAL, at, self.names)

    def law_of(self, values: Values, unit: Mapping[str, str]) -> dict[str, Any]:
        """A table of both inputs."""
        most, far = self.most, FAR * self.most
        along, across, levels = self._surface(values, (-far, -most, 0.0, most, far))
        inputs = [
            {"name": name, "unit": of, "knots": knots}
            for name, of, knots in zip(self.labels, self.units, (along, across), strict=True)
        ]
        per = unit[self.parameters[0].name]
        passive = self.names[1].startswith("velocity") and bool(np.all(levels[:, -1] <= 0))
        return described(
            self.kind,
            inputs,
            levels.tolist(),
            per,
            passive=passive,
            driven_up_to=self.speed,
            remembers=self.remembered(values),
            supported=[[along[0], along[-1]], [-most, most]],
        )

    def remembered(self, values: Values) -> str | None:
        """Of a law of the past, how its first input comes about."""
        return None

    def sentence(self, at: str, values: Values, unit: Mapping[str, str]) -> str:
        """In words."""
        factors = np.array(self.values(values)) / self.most
        per = self.each(unit[self.parameters[0].name])
        where, what = map(in_words, self.names)
        return (
            f"Something acts at {at} that no effect in the catalogue accounts for; modelled as a force in proportion "
            f"to {what}, by {factors.min():.3g} to {factors.max():.3g} {per}, that depends on {where}."
        )


def beside_product(evidence: Evidence) -> list[Array]:
    """What explains a part of the force as well, (n,) each: what a drag, friction, a load and another gear would do."""
    commands = [evidence.inputs[name] for name in carriers(evidence) if name.startswith("command")]
    return [evidence.velocity, evidence.direction, np.ones_like(evidence.velocity), *commands]


def carriers(evidence: Evidence) -> list[str]:
    """What a product may be in proportion to: the joint's own velocity, and commands to its own motors."""
    found, rotors = [f"velocity {evidence.at}"], mjcf.followers(evidence.model)
    for name in evidence.inputs:
        kind, _, of = name.partition(" ")
        driven = joint_of(evidence.model, of) if kind == "command" else None
        if driven is not None and rotors.get(driven, driven) == evidence.at:
            found.append(name)
    return [name for name in found if name in evidence.inputs]
