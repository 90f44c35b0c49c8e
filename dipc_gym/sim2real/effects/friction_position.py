"""Dry friction that varies along the way."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from dipc_gym.mjcf.edit import Document
from dipc_gym.sim2real.effects.shared.base import Effect, Evidence, Parameter, Values, dry_beside

KNOTS = 5  # of the table along the way


class AlongTheWay(Effect):
    """Coulomb friction whose level depends on position: a bent rail, a stiff spot in a gearbox."""

    id = "friction.position"
    place = "joint"
    one_of = "dry friction"
    parameters = (
        Parameter("first", "m", fixed=True),
        Parameter("last", "m", fixed=True),
        *(Parameter(f"level_{k + 1}", "N", 0.0) for k in range(KNOTS)),
    )
    levels = tuple(f"level_{k + 1}" for k in range(KNOTS))
    rivals = ("load.position", "friction.coulomb", "friction.load", "load.spring")
    contains = ("friction.coulomb",)
    needs_loader = True

    def guesses(self, evidence: Evidence) -> Sequence[Values]:
        """Force that opposes motion in each stretch of the range that was visited."""
        first, last = (float(x) for x in np.quantile(evidence.position, [0.005, 0.995]))
        at = np.linspace(first, last, KNOTS)
        hats = [np.interp(evidence.position, at, row) for row in np.eye(KNOTS)]
        parts = evidence.along(*(-evidence.direction * hat for hat in hats))
        level = evidence.dry_level
        found = parts if evidence.level is None else level + parts
        levels = np.clip(found, 0.1 * level, 3 * level)
        return [{"first": first, "last": last} | {f"level_{k + 1}": float(x) for k, x in enumerate(levels)}]

    def edit(self, document: Document, at: str, values: Values) -> None:
        """An entry for the loader; stock MuJoCo gets the mean level."""
        levels = [values[f"level_{k + 1}"] for k in range(KNOTS)]
        dry_beside(document, at, float(np.mean(levels)))
        document.custom(self.id, at, [values["first"], values["last"], *levels])

    def sentence(self, at: str, values: Values, unit: Mapping[str, str]) -> str:
        """In words."""
        levels = [values[f"level_{k + 1}"] for k in range(KNOTS)]
        most = values["first"] + (values["last"] - values["first"]) * int(np.argmax(levels)) / (KNOTS - 1)
        return (
            f"Dry friction at {at} that varies with position, from {min(levels):.3g} to {max(levels):.3g} "
            f"{unit['level_1']}, largest near {most:.3g} {unit['first']}."
        )
