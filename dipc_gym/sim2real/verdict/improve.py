"""Write what was found back as MJCF, with a comment that says what it is and how well it predicts as it stands."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dipc_gym import mjcf, physics
from dipc_gym.mjcf.edit import Document
from dipc_gym.sim2real.estimation.fit import Fit
from dipc_gym.sim2real.estimation.problem import Problem
from dipc_gym.sim2real.model.structure import Structure, Term
from dipc_gym.sim2real.result import AsWritten
from dipc_gym.sim2real.selection.progress import Partition
from dipc_gym.sim2real.simulation.batch import is_stiff
from dipc_gym.sim2real.verdict import sentences
from dipc_gym.sim2real.verdict.effect_words import in_words
from dipc_gym.sim2real.verdict.settings import VERDICT
from dipc_gym.sim2real.verdict.written import Option, written

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Improved:
    """The improved model as a file.

    Attributes:
        text: MJCF.
        written: what it comes to at its own step; None where that is the model as given.
        note: what that costs, and what was done about it; empty where nothing is to be said.
        needs_loader: effects and places of what it holds under `<custom>`, which stock MuJoCo leaves out.
    """

    text: str
    written: AsWritten | None = None
    note: str = ""
    needs_loader: tuple[str, ...] = ()


def needs_loader(structure: Structure) -> tuple[str, ...]:
    """Effects and places of a structure that stock MuJoCo leaves out."""
    return tuple(
        f"{'unknown' if term.effect.of_no_kind else term.effect.name}@{term.at}"
        for term in structure.terms
        if term.effect.needs_loader
    )


def improved_model(
    source: mjcf.Source,
    given: physics.Physics,
    partition: Partition,
    test: Problem,
    fits: tuple[Fit, Fit, Fit],
    last: Fit,
) -> Improved:
    """The improved model in the forms that predict best at its own step.

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
        return Improved(source.text)
    option, said = written(given.model.opt.timestep, partition, test, fits, last)
    structure, z = option.structure, option.z
    if said.to_the_end:
        final = last
    # In other forms effects keep their order; fewer are in the forms that they were fitted in.
    kept = {term.key for term in structure.terms}
    dropped = [t.key for t in final.structure.terms if len(kept) < len(final.structure.terms) and t.key not in kept]
    note = sentences.step_costs(said, dropped=dropped, alone=not kept, stiff=bool(_stiff(structure, z)))
    if option.refitted:
        note = f"{note} {sentences.made_up(said, _differing(option, last))}".strip()
    if not structure.model_parameters and not structure.terms:
        return Improved(source.text, said, note)
    document = structure.write(z)
    found = [term for term in final.structure.terms if term.key not in dropped]
    rests = _at_rest(Document(source), document)
    document.comment("Changed by dipc-gym diagnose.", *_effects(option, found), *rests, *_predictions(option, said))
    return Improved(document.text(), said, note, needs_loader(structure))


def _effects(option: Option, found: Sequence[Term]) -> list[str]:
    """What was changed, in sentences.

    Args:
        option: what is written.
        found: its effects in the forms that they were fitted in.
    """
    structure, z, forms = option.structure, option.z, dict(option.forms)
    lines = []
    for term, fitted in zip(structure.terms, found, strict=True):
        lines.append(in_words(structure, z, term, fitted))
        if fitted.key in forms:
            lines[-1] += f" Written as {forms[fitted.key]}, which predicts best at this file's step."
    if structure.model_parameters:
        moved = {
            n.key: abs(change) >= VERDICT.negligible for n, change in zip(structure.model_parameters, z, strict=False)
        }
        lines.append("Refitted: " + ", ".join(key if far else f"{key} (hardly)" for key, far in moved.items()) + ".")
    return lines


def _predictions(option: Option, said: AsWritten) -> list[str]:
    """How well the file predicts as it stands, and what it needs for that, in sentences."""
    lines = [sentences.as_written(said)]
    if asks := sentences.asks_for(said):
        lines.append(asks)
    if said.to_the_end:
        lines.append("That was before its parameters were fitted once more, to all of the recordings.")
    if option.refitted:
        lines.append(
            f"Parameters are what this file's step of {1e3 * said.timestep:g} ms and its integrator need to predict "
            "the recordings; those that fine steps need are in diagnosis.json."
        )
    model = option.structure.physics(option.z).model
    if model.nu > mjcf.commanded(model):
        lines.append(
            f"Its controls from number {mjcf.commanded(model)} on, counted from 0, are of forces that nobody commands; "
            "they move nothing."
        )
    if model.nplastic:
        lines.append(
            "Springs that yield are unbent where joints stand at 0. Begun elsewhere, they throw the joint: write where "
            "it begins into data.plastic, at tendon_plasticadr and after it, as dipc_gym's environments do."
        )
    loaders = [term.key for term in option.structure.terms if term.effect.needs_loader]
    if loaders:
        lines.append(f"Stock MuJoCo leaves out {', '.join(loaders)}; dipc_gym.physics.load applies what <custom> says.")
    return lines


def _differing(option: Option, found: Fit) -> list[tuple[str, float, float]]:
    """Parameters that make up for a step, but values of tables: key, what was found, and what is written."""
    values, written = found.structure.values(found.z), option.structure.values(option.z)
    return [
        (key, values[key], value)
        for (key, value), table in zip(written.items(), option.structure.tables, strict=True)
        if table < 0 and key in values and abs(value - values[key]) > VERDICT.differs * abs(values[key])
    ]


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
