"""Dry friction that grows while a joint rests: what it takes to break away depends on for how long it stood."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from dipc_gym.mjcf.edit import Document
from dipc_gym.sim2real.effects.base import Effect, Evidence, Parameter, Values, dry_beside

Array = NDArray[np.float64]

TRIED = np.geomspace(0.01, 3.0, 24)  # s, tried against how rests ended
TIMES, RISES = (0.05, 0.2, 0.8), (0.5, 1.5)  # s and levels, simulated as well
STILL = 0.02  # of the usual speed, below which a joint seems to rest
LAST = 4  # samples before and after the end of a rest, among which what broke it is found: forces are known smoothed
LEAST = 0.1  # of the level in motion, by which it grows at first
SHORTEST = 0.02  # s, that a rest lasts: a joint that turns round is as slow for a moment
FEWEST = 3  # rests that tell anything
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
        Parameter("time", "s", 1e-3, 60.0, log=True),
        Parameter("slow", "m/s", 0.0, fixed=True),
    )
    levels = ("level",)
    valleys = ("rise", "time")  # a joint breaks away or does not, and in between nothing shows
    needs_loader = True
    rivals = ("friction.stribeck", "friction.coulomb", "friction.hysteresis")
    contains = ("friction.coulomb",)
    shown_by = "rests of a twentieth of a second to a few seconds, each ended by a force that grows slowly"

    def guesses(self, evidence: Evidence) -> Sequence[Values]:
        """The level from the force that opposes motion; how that grows, from how long rests were and what ended them.

        Forces are known smoothed, so that what ended a rest was larger: the rise that they tell, and twice as much; and
        others, for when a joint breaks away shows in a simulation and hardly in a force.
        """
        level, slow = evidence.dry_level, SLOW * evidence.speed_scale
        rested, broke = _rests(evidence)
        if len(rested) < FEWEST:
            return []
        more, found = broke - level, list[tuple[float, float, float]]()
        for time in TRIED:
            grown = 1.0 - np.exp(-rested / time)
            rise = max(float(grown @ more / (grown @ grown)), LEAST * level)
            found.append((float(np.sum((more - rise * grown) ** 2)), float(time), rise))
        _, time, rise = min(found)
        likely = [(time, rise), (time, 2.0 * rise)]
        others = [(time, share * level) for time in TIMES for share in RISES]
        return [{"level": level, "rise": rise, "time": time, "slow": slow} for time, rise in likely + others]

    def unseen(self, evidence: Evidence, plain: Values) -> Values:
        """As much again as in motion, which a joint that hardly rests does not show."""
        level = plain["level"]
        return {"level": level, "rise": level, "time": TIMES[1], "slow": SLOW * evidence.speed_scale}

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


def _rests(evidence: Evidence) -> tuple[Array, Array]:
    """How long each rest lasted, s, and the largest force against the joint at its end, both (rests,)."""
    found = []
    for run in evidence.runs:
        still = np.abs(evidence.velocity[run]) < STILL * evidence.speed_scale
        turns = np.flatnonzero(np.diff(still.astype(int), prepend=0, append=0))
        time, force = evidence.time[run], np.abs(evidence.force[run])
        for first, end in turns.reshape(-1, 2):
            if end < len(run) and time[end] - time[first] > SHORTEST:
                around = force[max(first, end - LAST) : end + LAST]
                found.append((time[end] - time[first], float(around.max())))
    return np.array([one for one, _ in found]), np.array([one for _, one in found])
