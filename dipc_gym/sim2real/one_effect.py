"""Fit one effect at every place it can act: a quick look at an effect, without a search among many."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import mujoco
import numpy as np

from dipc_gym import mjcf, physics
from dipc_gym.mjcf.edit import Document
from dipc_gym.recording import Recording
from dipc_gym.recording.clock import clocked
from dipc_gym.recording.degrees import IN_PYTHON, refuse_odd_units
from dipc_gym.recording.glitches import without_glitches
from dipc_gym.sim2real.effects import Effect
from dipc_gym.sim2real.estimation import unexplained
from dipc_gym.sim2real.estimation.fit import Fit, fit
from dipc_gym.sim2real.estimation.problem import Problem, predict
from dipc_gym.sim2real.estimation.segments import prepare
from dipc_gym.sim2real.estimation.settings import ESTIMATION
from dipc_gym.sim2real.model.parameters import in_full, model_parameters
from dipc_gym.sim2real.model.structure import Term, carry
from dipc_gym.sim2real.selection.settings import WINDOWS
from dipc_gym.sim2real.simulation.batch import Stepping
from dipc_gym.sim2real.verdict.effect_words import place_units

NOTHING = 1e-9  # times the noise: predictions that change by less do not change


@dataclass(frozen=True)
class EffectFit:
    """One effect, fitted at one place.

    Attributes:
        effect: its id.
        at: the place.
        error_without: prediction error of the model with its parameters refitted and no effect added, in units of the
            sensors' noise, on windows that were not fitted.
        error: the same with the effect.
        values: fitted parameters of the effect, SI.
        units: of these parameters.
        sentence: the effect in words.
        improved: MJCF text of the model with refitted parameters and the effect.
    """

    effect: str
    at: str
    error_without: float
    error: float
    values: Mapping[str, float]
    units: Mapping[str, str]
    sentence: str
    improved: str = field(repr=False)


def fit_effect(
    effect: Effect, model: str | Path | mjcf.Source, recordings: Sequence[Recording], *, threads: int = 0
) -> list[EffectFit]:
    """Fit an effect at each of its places, one at a time, with the model's parameters refitted as well.

    This is a look at one effect, for whoever writes one. It compares the effect with no other and gives no verdict:
    `diagnose` does. Every second window is fitted, the others are predicted; the first ones are among them, which a
    diagnosis leaves out where what happened before them may still act. Times count from each recording's first sample.

    Args:
        effect: of the catalogue or one's own; it need not be registered.
        model: MJCF file or scanned source.
        recordings: of the real thing, read with this model.
        threads: of the simulations; 0 for all cores.

    Returns:
        The fits, the one with the smallest error first; none where the effect makes no sense at any place. A place
        where it changes no prediction is left out, as friction at a joint that never moves.

    Raises:
        ValueError: no parameter of the effect changes a prediction, at any place.
        mjcf.MjcfError: the model cannot be treated.
        RecordingError: the recordings hold no window, or angles look like degrees and no unit was told.

    Example:
        >>> from dipc_gym.sim2real import catalogue, fit_effect
        >>> coulomb = catalogue()["friction.coulomb"]
        >>> best, *others = fit_effect(coulomb, "cart.xml", recordings)         # doctest: +SKIP
        >>> print(best.sentence, best.error_without, best.error)                # doctest: +SKIP
    """
    source = model if isinstance(model, mjcf.Source) else mjcf.read(model)
    given = physics.load(source)
    mjcf.check_supported(given.model, source.name)
    source, given = in_full(source, given)
    refuse_odd_units(recordings, given.model, mend=IN_PYTHON)
    recordings = without_glitches(clocked(recordings), given.model)
    step = min(WINDOWS.coarsest, *(r.period for r in recordings))
    ready = prepare(source, given, recordings, Stepping(step, mujoco.mjtIntegrator.mjINT_RK4), threads=threads)
    fitted = ready.problem.pick(np.arange(0, len(ready.problem.windows), 2))
    comparison = ready.problem.pick(np.arange(1, len(ready.problem.windows), 2))
    free = replace(ready.structure, model_parameters=tuple(model_parameters(Document(source), given.model)))
    without = fit(fitted, free, most=ESTIMATION.from_afar)
    error_without = fit(comparison, free, without.z, most=0).error
    seen = unexplained.scene(without.structure.physics(without.z), recordings, ready.motions)
    seen = replace(seen, fitted=(fitted.windows, without))

    found, dead = [], []
    for at in unexplained.places(effect, given.model, ready.structure.base, recordings[0]):
        fits = [
            fit(fitted, structure, carry(free, without.z, structure), without.initial)
            for shaped, guess in effect.proposals(seen.at(effect.place, at, {}))
            for structure in (free.with_term(Term(shaped, at, guess)),)
        ]
        if not fits:
            continue
        best = min(fits, key=lambda one: one.error)
        (term,) = best.structure.terms
        if not any(_acts(fitted, one, without) for one in fits):
            dead.append(at)
            continue
        values, units = best.structure.term_values(best.z, term), place_units(best.structure, term)
        error = fit(comparison, best.structure, best.z, most=0).error
        sentence, improved = term.effect.sentence(at, values, units), best.structure.write(best.z).text()
        found.append(EffectFit(effect.id, at, error_without, error, values, units, sentence, improved))
    if dead and not found:
        raise ValueError(
            f"{effect.id} at {', '.join(dead)} changes no prediction: does something override its edit, as an "
            "<inertial> does a geom's mass?"
        )
    return sorted(found, key=lambda one: one.error)


def _acts(problem: Problem, found: Fit, without: Fit) -> bool:
    """Whether predictions change with any parameter of the effect that is fitted; True where none is."""
    structure, own = found.structure, slice(len(found.structure.model_parameters), None)
    begun = carry(without.structure, without.z, structure)
    if not len(begun[own]):
        return True
    tries = [begun]
    for moved in (found.z[own], begun[own] + 1.0, begun[own] - 1.0):
        tries.append(begun.copy())
        tries[-1][own] = moved
    initial = np.repeat(without.initial[None], len(tries), axis=0)
    readings = np.nan_to_num(predict(problem, structure, [structure.clip(z) for z in tries], initial))
    apart = np.where(problem.windows.valid[..., None], readings[1:] - readings[0], 0.0)
    return bool(np.any(np.abs(apart) > NOTHING * problem.windows.noise))
