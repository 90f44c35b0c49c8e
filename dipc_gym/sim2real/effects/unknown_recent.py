"""What has no name and goes in proportion to a motion or a command, by a factor of how large that was of late."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from dipc_gym.mjcf.edit import Document
from dipc_gym.physics import RECENT, RESIDUAL
from dipc_gym.sim2real.effects.shared.base import Effect, Evidence, Parameter, Values
from dipc_gym.sim2real.effects.shared.law import Array, holding_new, recalled
from dipc_gym.sim2real.effects.shared.settings import LAWS, TABLES
from dipc_gym.sim2real.effects.shared.sought import apart
from dipc_gym.sim2real.effects.shared.tables import between, hats, smooth
from dipc_gym.sim2real.effects.unknown_force import BEYOND, driven_up_to, in_words, unit_of
from dipc_gym.sim2real.effects.unknown_product import UnknownProduct, beside_product, carriers

TIMES = np.geomspace(0.05, 10.0, 8)  # s, tried by regression
STRETCHES = 9  # of the table, and of that by which times are compared: drag that thins does so within a few of them
ROWS = 64  # of the table that is written, at least: straight lines between its knots alone would leave out how it bends
APART = 3.0  # times, by which two that are proposed differ at least
MOST = 2  # that are proposed for each thing that it may be in proportion to: each costs a fit


class UnknownRecent(UnknownProduct):
    """A force in proportion to a velocity or a command, by a factor that is any function of how large that was of late.

    Grease that thins while it is sheared, a supply that sags under what it gave, a drive that tires. What it remembers
    is a mean over the past that fades with a time constant. It is asked for last and is no name, as `unknown_force` is.

    Args:
        knots: of the square root of the mean over the past: near nothing, where rigs are seldom, a law is finer.
            Between them it is a cubic spline: it is large beside what else acts, so that chords would show.
        values: of the force there, where what it is in proportion to is as large as `most`.
        inputs: name of the input, for both.
        most: of that, in its unit.
        speed: of the joint, up to which it drives.
        units: of both.
        time: s, first guess of the time constant.
    """

    id = f"{RESIDUAL}:recent"
    of_the_past = True

    def __init__(
        self,
        knots: Sequence[float] = (),
        values: Sequence[float] = (),
        inputs: tuple[str, str] = ("", ""),
        most: float = 1.0,
        speed: float = 1.0,
        units: tuple[str, str] = ("", ""),
        time: float = 1.0,
    ) -> None:
        super().__init__(knots, values, inputs, most, speed, units)
        self.time = time
        if self.knots:
            pace = Parameter("time_constant", "s", 5e-3, 60.0, log=True, sigma=LAWS.loose / LAWS.step)
            self.parameters = (*self.parameters, pace)

    @property
    def labels(self) -> tuple[str, str]:
        """The mean over the past, and what it is in proportion to."""
        return f"recent {self.names[0]}", self.names[1]

    def remembered(self, values: Values) -> str:
        """How its first input comes about."""
        return (
            f"The {self.labels[0]} follows the size of the {self.names[0]} with a time constant of "
            f"{values['time_constant']:.4g} s."
        )

    @property
    def places(self) -> Array:
        """The mean over the past."""
        return np.array(self.knots) ** 2

    def knot_at(self, place: float) -> float:
        """The root of the mean over the past."""
        return math.sqrt(place)

    def inputs(self, at: str) -> tuple[str, ...]:
        """What it is in proportion to; of the past of that no window tells."""
        return self.names[:1]

    def axes(self, at: str) -> tuple[str, ...]:
        """Nothing that a window tells of."""
        return ()

    def proposals(self, evidence: Evidence) -> Sequence[tuple[Effect, Values]]:
        """For each thing it may be in proportion to, the time constant at which it takes most of the unexplained force.

        Which of them it is, simulation tells: forces that are estimated go with the command as well, since that is what
        moves the joint.
        """
        return [found for carrier in carriers(evidence) for found in self._paced(evidence, carrier)]

    def _paced(self, evidence: Evidence, carrier: str) -> Sequence[tuple[Effect, Values]]:
        """The law in proportion to one thing, with the time constants that take most; none where that never changes."""
        pasts = recalled(evidence, RECENT, TIMES[:, None], evidence.inputs[carrier])
        left = [self._left(evidence, past, carrier) for past in pasts]
        best = apart(left, TIMES.tolist(), count=MOST, ratio=APART)
        return [found for k in best for found in self._shaped(evidence, carrier, pasts[k], float(TIMES[k]))]

    def _shaped(self, evidence: Evidence, carrier: str, past: Array, time: float) -> Sequence[tuple[Effect, Values]]:
        """The law with one time constant."""
        moves, roots = evidence.inputs[carrier], np.sqrt(past)
        most, largest = BEYOND * float(np.abs(moves).max()), float(np.quantile(roots, 1 - TABLES.covered))
        if not (most > 0 and largest > 0):
            return []
        knots = np.linspace(0.0, largest, STRETCHES + 1)  # nothing moved of late after every rest
        values = smooth(knots, roots, evidence.force, moves / most, beside_product(evidence))
        unit, speed = unit_of(evidence.model, carrier), driven_up_to(evidence)
        names, units = (carrier, carrier), (unit, unit)
        shaped = UnknownRecent(knots.tolist(), values.tolist(), names, most, speed, units, time)
        return [(shaped, shaped.guess)]

    @staticmethod
    def _left(evidence: Evidence, past: Array, carrier: str) -> float:
        """Sum of squares that a rough table of the recent size leaves of the force.

        It is finer near nothing, where what thins does so.
        """
        edges = np.linspace(0.0, max(float(np.sqrt(past.max())), 1e-300), STRETCHES + 1)
        law = hats(edges, np.sqrt(past)) * evidence.inputs[carrier][:, None]
        free, size, _ = np.linalg.svd(np.column_stack([law, *beside_product(evidence)]), full_matrices=False)
        told = free[:, size > 1e-9 * size[0]].T @ evidence.force
        return float(evidence.force @ evidence.force - told @ told)

    @property
    def guess(self) -> dict[str, float]:
        """First values and time constant, by name."""
        return {p.name: v for p, v in zip(self.parameters, (*self.first, self.time), strict=True)}

    def _at(self, knots: Array, values: Values) -> Array:
        """The factor at other knots; those of its own lie evenly, or go on so: no spline swings between these."""
        return np.asarray(CubicSpline(self.knots, self.values(values))(knots))

    def written(self, values: Values) -> tuple[Array, Array]:
        """Over the mean itself, in so many rows that it bends."""
        roots = between(np.array(self.knots), -(-ROWS // (len(self.knots) - 1)))
        return roots**2, self._at(roots, values)

    def values(self, values: Values) -> list[float]:
        """The values of the table, in the order of its knots."""
        return [values[p.name] for p in self.parameters[: len(self.knots)]]

    def finer(self, values: Values, told: NDArray[np.bool_] | None = None) -> Sequence[tuple[Effect, Values]]:
        """A knot more in each stretch, there where the law was."""
        found = super().finer(values, None if told is None else told[: len(self.knots)])
        return [_as_long(shape, values) for shape in found]

    def reaching(self, values: Values, spans: Sequence[tuple[float, float]]) -> tuple[Effect, Values] | None:
        """The same law for larger sizes, which begins as it was."""
        found = super().reaching(values, spans)
        return found and _as_long(found, values)

    def shortened(self, values: Values, told: NDArray[np.bool_]) -> tuple[Effect, Values] | None:
        """The same law without sizes that no data tell; it begins at rest, whether they do or not."""
        found = super().shortened(values, np.append(True, told[1:]))
        return found and _as_long(found, values)

    def _begun(self, knots: Array, values: Array, new: NDArray[np.bool_]) -> tuple[Effect, Values]:
        shape = (knots.tolist(), values.tolist(), self.names, self.most, self.speed, self.units, self.time)
        shaped = UnknownRecent(*shape)
        shaped.parameters = (*holding_new(shaped.parameters[:-1], new), shaped.parameters[-1])
        return shaped, shaped.guess

    def edit(self, document: Document, at: str, values: Values) -> None:
        """A table for the loader, which keeps the mean over the past in mind; stock MuJoCo leaves it out."""
        document.remembering(RECENT, at, [values["time_constant"], *self._numbers(values)])
        document.depends(RECENT, at, self.names[:1])

    def sentence(self, at: str, values: Values, unit: Mapping[str, str]) -> str:
        """In words."""
        factors = np.array(self.values(values)) / self.most
        per, what = self.each(unit[self.parameters[0].name]), in_words(self.names[0])
        return (
            f"Something acts at {at} that no effect in the catalogue accounts for; modelled as a force in proportion "
            f"to {what}, by {factors.min():.3g} to {factors.max():.3g} {per}, that depends on how large that was in "
            f"the last {values['time_constant']:.2g} s."
        )


def _as_long(shape: tuple[Effect, Values], values: Values) -> tuple[Effect, Values]:
    """A shape that begins with the time constant that was found."""
    effect, begin = shape
    return effect, {**begin, "time_constant": values["time_constant"]}
