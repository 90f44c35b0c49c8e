"""An effect in words: its sentence with the units of its place, and what of the model it takes the place of."""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import NDArray

from dipc_gym import mjcf
from dipc_gym.recording.units import of_command, of_sensor
from dipc_gym.sim2real.effects.shared.base import acts_on
from dipc_gym.sim2real.model.structure import Structure, Term
from dipc_gym.sim2real.verdict.in_place import in_place_of

Array = NDArray[np.float64]


def in_words(structure: Structure, z: Array, term: Term, found: Term | None = None) -> str:
    """An effect in a sentence, and what of the model it takes the place of.

    Args:
        structure: that holds it.
        z: mapped parameters, (p,).
        term: the effect.
        found: as it was fitted, where `term` is another form of it.
    """
    values, found = structure.term_values(z, term), found or term
    said = found.effect.sentence(found.at, values, place_units(structure, term))
    before = in_place_of(structure.document, term, values)
    return f"{said} It takes the place of {before}." if before else said


def place_units(structure: Structure, term: Term) -> dict[str, str]:
    """Unit of each parameter of an effect, in terms of its joint's kind."""
    model = structure.model
    joint = acts_on(model, term.effect, term.at) or ""
    hinge = bool(joint) and mjcf.is_hinge(model, joint)
    units = {}
    for p in term.effect.parameters:
        unit = p.unit
        if hinge and p.translated:
            unit = _angular(unit)
        if unit == "reading":
            unit = of_sensor(model, term.at)
        units[p.name] = of_command(model, term.at) if unit == "command" else unit
    return units


def _angular(unit: str) -> str:
    """A unit of a slide's parameter as that of a hinge's: N s/m becomes N m s/rad."""
    if "N m" in unit:
        return unit
    return re.sub(r"\bkg\b", "kg m^2", re.sub(r"\bN\b", "N m", re.sub(r"\bm\b", "rad", unit)))
