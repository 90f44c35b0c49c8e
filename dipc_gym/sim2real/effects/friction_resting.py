"""Dry friction that grows while a joint rests: what it takes to break away depends on for how long it stood."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

from dipc_gym.mjcf.edit import Document
from dipc_gym.sim2real.effects.shared.base import Effect, Evidence, Parameter, Values, dry_beside
from dipc_gym.sim2real.effects.shared.rests import Rests

Array = NDArray[np.float64]

TIMES = (0.02, 0.1, 0.5)  # s, from which the nearest time constant is looked for
RATIOS = (0.63, 1.6, 2.5)  # of that, which are simulated as well
SOONEST = 1e-3  # s, shortest time constant
UNSEEN = 0.2  # s, time constant of a rise that is supposed
SLOW = 1e-3  # of the usual speed, up to which a joint rests: less than encoders tell from rest


class Resting(Effect):
    """Breakaway friction that grows with the time at rest, to a limit; motion wears it off.

    What it remembers is the age of the contact, which grows at rest and is lost in motion (Dieterich 1979, Ruina 1983),
    here over so short a way that no sensor follows it.
    """

    id = "friction.resting"
    place = "joint"
    one_of = "dry friction"
    parameters = (
        Parameter("level", "N", 0.0),
        Parameter("rise", "N", 0.0),
        Parameter("time", "s", SOONEST, 60.0, log=True),
        Parameter("slow", "m/s", 0.0, fixed=True),
    )
    levels = ("level",)
    valleys = by_steps = ("rise", "time")  # a joint breaks away or does not, and in between nothing shows
    needs_loader = True
    rivals = ("friction.stribeck", "friction.coulomb", "friction.hysteresis")
    contains = ("friction.coulomb",)
    shown_by = "rests of a twentieth of a second to a few seconds, each ended by a force that grows slowly"

    def guesses(self, evidence: Evidence) -> Sequence[Values]:
        """The level from the force that opposes motion; how that grows, from what rests withstood and what ended them.

        Quicker and slower ones as well, for rests leave room.
        """
        rests = Rests.of(evidence)
        if not rests.tell:
            return []
        slow = SLOW * evidence.speed_scale
        return [{"level": rests.level, "rise": rise, "time": time, "slow": slow} for rise, time in likely(rests)]

    def unseen(self, evidence: Evidence, plain: Values) -> Values:
        """As much again as in motion, which a joint that hardly rests does not show."""
        level = plain["level"]
        return {"level": level, "rise": level, "time": UNSEEN, "slow": SLOW * evidence.speed_scale}

    def edit(self, document: Document, at: str, values: Values) -> None:
        """The law for the loader, which keeps the time at rest in mind; the level in motion for stock MuJoCo."""
        dry_beside(document, at, values["level"])
        document.remembering(self.id, at, [values[p.name] for p in self.parameters])

    def sentence(self, at: str, values: Values, unit: Mapping[str, str]) -> str:
        """In words."""
        force = unit["level"]
        return (
            f"Dry friction at {at} that grows at rest: {values['level']:.3g} {force} in motion, and up to "
            f"{values['level'] + values['rise']:.3g} {force} to break away after a rest, with a time constant of "
            f"{values['time']:.2g} s."
        )


def likely(rests: Rests) -> list[tuple[float, float]]:
    """Rises, N or N m, and time constants, s, of exponentials that grow as rests say, the nearest one first."""
    rise, best = nearest(rests)
    found = [(rise, best)]
    for time in best * np.array(RATIOS):
        (other,), _ = rests.nearest(partial(_grown, time=time), np.array([rise]))
        found.append((float(other), float(time)))
    return found


def nearest(rests: Rests) -> tuple[float, float]:
    """Rise, N or N m, and time constant, s, of the exponential that grows most nearly as rests say."""
    tries = [rests.nearest(_grown, np.array([rests.level, time])) for time in TIMES]
    (rise, time), _ = min(tries, key=lambda one: one[1])
    return float(rise), max(float(time), SOONEST)


def _grown(ages: Array, now: Array, time: float = 0.0) -> Array:
    """What an exponential has grown by at ages (n,): parameters are rise and time constant, if that is not given."""
    return np.asarray(-now[0] * np.expm1(-ages / (time or now[1])))
