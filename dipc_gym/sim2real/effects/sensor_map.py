"""A position sensor whose scale is bent in any way."""

from __future__ import annotations

from collections.abc import Mapping

import mujoco
import numpy as np
from numpy.typing import NDArray

from dipc_gym.sim2real.effects.shared.base import Evidence, Values, sensed_position
from dipc_gym.sim2real.effects.shared.law import Array, Map
from dipc_gym.sim2real.effects.shared.settings import TABLES
from dipc_gym.sim2real.effects.shared.tables import Nested, grown, hats, odd_blocks

BINS = 128  # of the range of motion; no knot lies closer to another than one of them
FAINT = 0.5  # of the sensor's noise: an error of the scale that is nowhere larger shows in no reading


class ScaleMap(Map):
    """A map from what a sensor should read to what it reads: a worn potentiometer, a camera's lens, a slack belt."""

    id = "sensor.map"
    place = "sensor"
    one_of = "scale"
    of, kind, unit = "reading", "reading", "reading"
    rivals = ("sensor.eccentric", "sensor.gain", "load.position:law", "friction.position:law")
    contains = ("sensor.eccentric", "sensor.gain", "sensor.bias")
    moves_readings = True

    def fits(self, model: mujoco.MjModel, at: str) -> bool:
        """Where a sensor reads the position of a joint."""
        return sensed_position(model, at)

    def table(self, evidence: Evidence) -> tuple[Array, Array] | None:
        """The error that what is left of its readings asks for, freed of what initial states could explain."""
        seen = evidence.misread
        if seen is None:
            return None
        read = seen.scale > 0
        x = seen.reading[read]
        low, high = (float(one) for one in np.quantile(x, [TABLES.covered, 1 - TABLES.covered]))
        late = odd_blocks(seen.time[:, 0])
        if not high > low or late.all() or not late.any():
            return None
        edges = np.linspace(low, high, BINS + 1)
        n, m = seen.reading.shape
        errors = hats(edges, seen.reading.ravel()).reshape(n, m, -1)

        def part(windows: NDArray[np.bool_]) -> Nested:
            return Nested(*seen.asked(errors, windows))

        counts = np.append(0, np.cumsum(np.histogram(x, edges)[0]))
        chosen = grown(part(~late), part(late), counts)
        error, knots = part(np.ones(n, dtype=bool)).weights(chosen), edges[chosen]
        # How steep the scale is as a whole, other parameters say as well; a constant error, initial states.
        bent = error - np.polynomial.Polynomial.fit(x, np.interp(x, knots, error), 1)(knots)
        if np.abs(bent).max() * seen.scale.max() < FAINT:
            return None
        return knots, knots + bent

    def per(self, unit: Mapping[str, str]) -> str:
        """What it reads is what it should read, in another place."""
        return unit[self.parameters[0].name]

    def sentence(self, at: str, values: Values, unit: Mapping[str, str]) -> str:
        """In words."""
        along = np.linspace(self.knots[0], self.knots[-1], BINS + 1)
        off = self._at(along, values) - along
        off -= np.polynomial.Polynomial.fit(along, off, 1)(along)  # a straight one shows in other parameters as well
        k, name = int(np.argmax(np.abs(off))), self.per(unit)
        return (
            f"The scale of sensor {at} is bent: near {along[k]:.3g} it reads {off[k]:+.2g} {name} off a straight one."
        )
