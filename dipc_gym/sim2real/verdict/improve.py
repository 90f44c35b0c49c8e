"""Write what was found back as MJCF, with a comment that says what it is and how well it predicts as it stands."""

from __future__ import annotations

import re

import mujoco
import numpy as np
from numpy.typing import NDArray

from dipc_gym import mjcf, physics
from dipc_gym.mjcf.edit import Document
from dipc_gym.recording.units import of_sensor
from dipc_gym.sim2real.effects.base import acts_on, is_dcmotor
from dipc_gym.sim2real.estimation.fit import Fit
from dipc_gym.sim2real.estimation.problem import Problem
from dipc_gym.sim2real.model.structure import Structure, Term
from dipc_gym.sim2real.result import AsWritten
from dipc_gym.sim2real.selection.progress import Partition
from dipc_gym.sim2real.simulation.batch import is_stiff
from dipc_gym.sim2real.verdict import sentences
from dipc_gym.sim2real.verdict.in_place import in_place_of
from dipc_gym.sim2real.verdict.settings import VERDICT
from dipc_gym.sim2real.verdict.written import written

Array = NDArray[np.float64]


def improved_model(
    source: mjcf.Source,
    given: physics.Physics,
    partition: Partition,
    test: Problem,
    fits: tuple[Fit, Fit, Fit],
    last: Fit,
) -> tuple[str, AsWritten | None, str]:
    """Text of the improved model in the forms that predict best at its own step, what it comes to there, and a note.

    Args:
        source: the model as given.
        given: the same, compiled.
        partition: windows to refit to, and to choose by.
        test: windows to judge by.
        fits: the model as given, recalibrated, and what was found.
        last: what was found, fitted to the windows to judge by as well; the same where it was not.
    """
    final = fits[-1]
    if not final.structure.model_parameters and not final.structure.terms:
        return source.text, None, ""
    option, said = written(given.model.opt.timestep, partition, test, fits, last)
    structure, z = option.structure, option.z
    if said.to_the_end:
        final = last
    document, forms = structure.write(z), dict(option.forms)
    lines = []
    # In other forms effects keep their order; fewer are in the forms that they were fitted in.
    kept = {term.key for term in structure.terms}
    dropped = [t.key for t in final.structure.terms if len(kept) < len(final.structure.terms) and t.key not in kept]
    found_terms = [term for term in final.structure.terms if term.key not in dropped]
    for term, found in zip(structure.terms, found_terms, strict=True):
        lines.append(in_words(structure, z, term, found))
        if found.key in forms:
            lines[-1] += f" Written as {forms[found.key]}, which predicts best at this file's step."
    loaders = [t.key for t in structure.terms if t.effect.needs_loader]
    if structure.model_parameters:
        moved = {
            n.key: abs(change) >= VERDICT.negligible for n, change in zip(structure.model_parameters, z, strict=False)
        }
        lines.append("Refitted: " + ", ".join(key if far else f"{key} (hardly)" for key, far in moved.items()) + ".")
    lines += _at_rest(Document(source), document)
    lines.append(sentences.as_written(said))
    if asks := sentences.asks_for(said):
        lines.append(asks)
    if said.to_the_end:
        lines.append("That was before its parameters were fitted once more, to all of the recordings.")
    if option.refitted:
        lines.append(
            f"Parameters are what this file's step of {1e3 * said.timestep:g} ms and its integrator need to predict "
            "the recordings; those that fine steps need are in diagnosis.json."
        )
    if loaders:
        lines.append(f"Stock MuJoCo leaves out {', '.join(loaders)}; dipc_gym.physics.load applies what <custom> says.")
    note = sentences.step_costs(said, dropped=dropped, alone=not kept, stiff=bool(_stiff(structure, z)))
    if not structure.model_parameters and not structure.terms:
        return source.text, said, note
    document.comment("Changed by dipc-gym diagnose.", *lines)
    return document.text(), said, note


def _at_rest(given: Document, improved: Document) -> list[str]:
    """A sentence on what dry friction sets beside its level, where it sets any of it."""
    option, attribute = "noslip_iterations", "solreffriction"
    soft, stiff = ({name: d.joint(name).get(attribute) for name in given.joint_names()} for d in (given, improved))
    names = [option] if given.get_option(option) != improved.get_option(option) else []
    names += [attribute] if soft != stiff else []
    if not names:
        return []
    return [f"{' and '.join(names)} {'both make' if len(names) > 1 else 'makes'} MuJoCo's soft friction hold at rest."]


def _stiff(structure: Structure, z: Array) -> bool:
    """Whether a model holds dry friction whose constants were chosen with its step in mind."""
    return bool(is_stiff(structure.physics(z).model).any())


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
        units[p.name] = _command_unit(model, term.at, hinge) if unit == "command" else unit
    return units


def _angular(unit: str) -> str:
    """A unit of a slide's parameter as that of a hinge's: N s/m becomes N m s/rad."""
    if "N m" in unit:
        return unit
    return re.sub(r"\bkg\b", "kg m^2", re.sub(r"\bN\b", "N m", re.sub(r"\bm\b", "rad", unit)))


def _command_unit(model: mujoco.MjModel, actuator: str, hinge: bool) -> str:
    """Unit of what is sent to an actuator; none where its gear makes a force of a number of its own."""
    if is_dcmotor(model, actuator):
        return "V"
    i = model.actuator(actuator).id
    force = model.actuator_trntype[i] == mujoco.mjtTrn.mjTRN_JOINT and model.actuator_gear[i, 0] == 1
    if force and model.actuator_gaintype[i] == mujoco.mjtGain.mjGAIN_FIXED and model.actuator_gainprm[i, 0] == 1:
        return "N m" if hinge else "N"
    return ""
