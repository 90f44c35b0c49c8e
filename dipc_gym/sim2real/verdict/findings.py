"""What was found, as diagnosis.json lists it: effects with sizes, intervals and rivals; model parameters that
changed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dipc_gym.sim2real.effects.shared.law import Law
from dipc_gym.sim2real.estimation.fit import Fit, fit
from dipc_gym.sim2real.estimation.problem import Problem, normalised_residual, predict
from dipc_gym.sim2real.estimation.settings import ESTIMATION
from dipc_gym.sim2real.estimation.shooting import typical
from dipc_gym.sim2real.model.settings import MODEL
from dipc_gym.sim2real.model.structure import Slot, Term, names
from dipc_gym.sim2real.result import Errors, Missing, significant
from dipc_gym.sim2real.selection.partitioning import evenly
from dipc_gym.sim2real.selection.search import Searched
from dipc_gym.sim2real.selection.settings import SCORE
from dipc_gym.sim2real.verdict import intervals, location, sentences, stand_ins, untouched
from dipc_gym.sim2real.verdict.conclude import Conclusion
from dipc_gym.sim2real.verdict.effect_words import in_words, place_units
from dipc_gym.sim2real.verdict.settings import VERDICT

Array = NDArray[np.float64]


def changed_parameters(final: Fit, wide: Array) -> list[dict[str, Any]]:
    """Model parameters that had to change, as diagnosis.json lists them, with intervals of +- `wide` mapped
    parameters (p,).
    """
    out = []
    for i, parameter in enumerate(final.structure.model_parameters):
        if abs(final.z[i]) < VERDICT.negligible:
            continue
        slot = final.structure.slots[i]
        value = slot.value(final.z[i])
        entry = {"parameter": parameter.attribute, "at": parameter.at, "was": parameter.value, "value": value}
        if wide[i] <= MODEL.widest:
            entry |= _interval(slot, final.z[i], wide[i])
        out.append(entry | {"unit": parameter.unit})
    return out


def beyond_limits(problem: Problem, validation: Problem, recalibrated: Fit) -> list[str]:
    """Note on model parameters that would explain all, were they allowed to be further off than their kind is taken
    to be.

    Args:
        problem: windows to fit.
        validation: windows that no fit has touched.
        recalibrated: the model's parameters refitted, within their limits.
    """
    parameters, stand = recalibrated.structure.model_parameters, _at_limits(recalibrated)
    if not any(stand):
        return []
    wider = tuple(
        replace(n, sigma=max(n.sigma, VERDICT.free)) if at else n for n, at in zip(parameters, stand, strict=True)
    )
    freed = fit(
        problem,
        replace(recalibrated.structure, model_parameters=wider),
        recalibrated.z,
        recalibrated.initial,
        most=ESTIMATION.from_afar,
    )
    error = untouched.error_on(validation, freed)
    if error > SCORE.at_floor:
        return []
    reached = [slot.value(z) for slot, z in zip(freed.structure.slots, freed.z, strict=True)]
    far = [(n, value) for n, value, at in zip(parameters, reached, stand, strict=True) if at]
    names = " and ".join(
        f"{sentences.called(n.attribute, n.at)} ({value:.3g} for {n.value:.3g} {n.unit})" for n, value in far
    )
    priors = " ".join(f"--prior {n.key}={n.value:g}+-{n.value:g}" for n, _ in far)
    return [
        f"Without any new physics {names} would explain these recordings too, to {error:.3g} times the noise; that is "
        f"further off than a parameter of its kind is taken to be. If it may be, say so: {priors}."
    ]


def _at_limits(fitted: Fit) -> list[bool]:
    """Which of the model's own parameters a fit has at the limit that its kind is taken to have."""
    slots = fitted.structure.slots[: len(fitted.structure.model_parameters)]
    values = [slot.value(z) for slot, z in zip(slots, fitted.z, strict=False)]
    return [min(v / slot.low, slot.high / v) < 1 + VERDICT.at_limit for v, slot in zip(values, slots, strict=True)]


def held_at_limits(final: Fit) -> list[str]:
    """Note on model parameters that stand at their limits beside what was found: what they lack, others make up for."""
    parameters = final.structure.model_parameters
    held = [n for n, at in zip(parameters, _at_limits(final), strict=True) if at]
    if not held:
        return []
    names = " and ".join(sentences.called(n.attribute, n.at) for n in held)
    priors = " ".join(f"--prior {n.key}={n.value:g}+-{n.value:g}" for n in held)
    return [
        f"{names} came to the limit of what is taken to be plausible of {'it' if len(held) == 1 else 'them'}, so that "
        "other numbers, and what was found, may make up for the rest: a load that the model does not carry, say. If "
        f"more may be, say so: {priors}; and what you know, by --fix."
    ]


def step_shift(final: Fit, problem: Problem) -> Array:
    """How far each mapped parameter is off because steps have a length, (p,).

    Twice what it would move by if they were halved, as errors of first order do; bristles and contacts have such. It
    is told from what halved steps change in the predictions.
    """
    if not len(final.z):
        return np.zeros(0)
    fine = problem.halved_by(1)
    change = final.raw - normalised_residual(fine, predict(fine, final.structure, [final.z], final.initial[None])[0])
    change = change.reshape(len(change), -1)
    w = 1.0 / (typical(final.mse) + final.mse + np.sum(change**2, axis=1) / problem.counts) / problem.counts
    curvature = final.structure.prior.in_covariance(np.einsum("n,nij->ij", w, final.quadratics.A), w)
    # A Jacobian that initial states have been eliminated from leaves out of the change what they could explain.
    slope = np.einsum("n,nmk,nm->k", w, final.jacobian[:, : change.shape[1]], change)
    return np.asarray(2 * np.abs(np.linalg.pinv(curvature, hermitian=True) @ slope))


def choice_shift(fitted: Fit, others: Sequence[Fit]) -> Array:
    """How far each mapped parameter moves if other model parameters were wrong than those that changed, (p,).

    Values of a law that has another shape since the others were fitted are of other places, and say nothing here.

    Args:
        fitted: with the fewest model parameters changed.
        others: with as many others changed, that predict as well.
    """
    shift = np.zeros(len(fitted.z))
    for other in others:
        known = {slot.key: z for slot, z in zip(other.structure.slots, other.z, strict=True)}
        shapes = {term.key: term.effect for term in other.structure.terms}
        reshaped = [t.key for t in fitted.structure.terms if t.effect.free and shapes.get(t.key) is not t.effect]
        for i, slot in enumerate(fitted.structure.slots):
            if slot.key.rpartition(".")[0] not in reshaped:
                there = known.get(slot.key, 0.0)  # nominal parameters map to zero
                shift[i] = max(shift[i], abs(there - fitted.z[i]))
    return shift


@dataclass(frozen=True)
class Wide:
    """Half widths of 90 % intervals of the mapped parameters, (p,) each, infinite where nothing is known.

    Attributes:
        of_laws: of what stands in tables, from resampled seconds of the recordings.
        of_names: of what has a name, and of the model; wider where something is left, or modelled by a law of no kind.
    """

    of_laws: Array
    of_names: Array


def beside_unknown(search: Searched, final: Fit, alone: Fit | None, wide: Array) -> Array:
    """Half widths (p,) beside physics that is left out, or modelled by a law of no kind, infinite for values of tables.

    What has a name makes up for it, by as much as parameters differ between regimes of motion, and as they move where
    the law is left out.

    Args:
        search: that has run.
        final: what it came to.
        alone: see `beside.names_alone`.
        wide: half widths where nothing is left, (p,).
    """
    wider = np.maximum(wide, intervals.by_regimes(final, search.partition.problem))
    if alone is not None:
        known = {slot.key: z for slot, z in zip(alone.structure.slots, alone.z, strict=True)}
        there = [known.get(slot.key, z) for slot, z in zip(final.structure.slots, final.z, strict=True)]
        wider += np.abs(np.array(there) - final.z)
    return np.where(final.structure.tables < 0, wider, np.inf)


def missing_effects(
    search: Searched, found: Conclusion, test: Problem, nominal: Fit, alone: Fit | None, wide: Wide
) -> list[Missing]:
    """The effects that a search came to, the strongest first.

    Args:
        search: that has run.
        found: what it came to.
        test: windows to judge by.
        nominal: the model as given.
        alone: see `beside.names_alone`: beside a law that can do the same, nothing is lost without a name.
        wide: of the intervals of the parameters.
    """
    final = found.fitted
    worth = [final] if alone is None else [final, alone]
    some = test.pick(evenly(len(test.windows), VERDICT.windows))
    as_given = untouched.error_on(some, nominal) if any(found.rivals.values()) else 1.0
    before, after = (search.scorer.comparison_error(one) for one in (search.progress.path[0], final))
    improved = max(before - after, 1e-9)
    terms = [term for term in final.structure.terms if term.key not in found.unnamed]
    rivals = [[one for one in found.rivals.get(term.key, ()) if _name(one.term) != _name(term)] for term in terms]

    def told(k: int) -> tuple[float, list[dict[str, Any]]]:
        key = terms[k].key
        lost = [_lost(search, one, key) for one in worth if key in names(one.structure.terms)]
        return min(max(lost) / improved, 1.0), [_rival(rival, some, as_given) for rival in rivals[k]]

    with search.fitter.side_by_side([partial(told, k) for k in range(len(terms))], worth) as result:
        asked = [result(k) for k in range(len(terms))]
    missing = []
    for term, others, (share, tried) in zip(terms, rivals, asked, strict=True):
        units = place_units(final.structure, term)
        sentence = in_words(final.structure, final.z, term)
        law = _law(final, term, units, wide.of_laws)
        if term.effect.once:
            sentence += _once(search, final, term)
        effect, formula = term.effect, found.formulas.get(term.key)
        if law is not None and isinstance(effect, Law) and formula is not None:
            unit, per = effect.each(law["table"]["unit"]), law["table"]["inputs"][0]["unit"]
            law["formula"] = formula.to_dict(unit, per)
            law["supported"][0] = list(formula.told)  # from there on the formula foretells the table
            sentence += f" Its shape is that of a formula: {formula.text(unit, per)}."
        # What happened once leaves no blocks to resample.
        known = np.full(len(final.z), np.inf) if term.effect.once else wide.of_names
        missing.append(
            Missing(
                "unknown" if term.effect.of_no_kind else term.effect.name,
                term.at,
                sentence,
                share,
                _parameters(final, term, units, known),
                tuple(_each_once([_name(rival.term) for rival in others if rival.same])),
                tuple(_each_once(sorted(tried, key=lambda one: one["held_out"]))),
                law,
            )
        )
    return sorted(missing, key=lambda one: -one.share)


def _once(search: Searched, final: Fit, term: Term) -> str:
    """Of what happened once, in which of several recordings it did, and what that means for the model."""
    where = ""
    if len(search.partition.problem.windows.recordings) > 1:
        where = f" That was in {' and '.join(one.name for one in untouched.happened(search, final, term))}."
    return f"{where} The model has it at this time in every simulation."


def named_alone(final: Fit) -> list[Missing]:
    """The effects of a fit with their parameters, where what they are worth cannot be told: shares are null."""
    missing = []
    for term in final.structure.terms:
        units = place_units(final.structure, term)
        sentence = in_words(final.structure, final.z, term)
        parameters = _parameters(final, term, units, np.full(len(final.z), np.inf))
        name = "unknown" if term.effect.of_no_kind else term.effect.name
        missing.append(Missing(name, term.at, sentence, math.nan, parameters))
    return missing


def _parameters(final: Fit, term: Term, units: Mapping[str, str], wide: Array) -> dict[str, dict[str, Any]]:
    """Parameters of an effect with units and 90 % intervals of +- `wide` mapped parameters (p,), where that is
    finite.
    """
    parameters: dict[str, dict[str, Any]] = {}
    own = {f"{term.key}.{p.name}": p.name for p in term.effect.parameters}
    for slot, z, half in zip(final.structure.slots, final.z, wide, strict=True):
        if slot.key not in own:
            continue
        name = own[slot.key]
        parameters[name] = {"value": slot.value(z), "unit": units[name]}
        if np.isfinite(half):
            parameters[name] |= _interval(slot, z, half)
    return parameters


def _interval(slot: Slot, z: float, half: float) -> dict[str, float]:
    """Ends of an interval of +- `half` about a mapped parameter, and how often such an interval holds the truth."""
    low, high = sorted((slot.value(z - half), slot.value(z + half)))
    return {"low": low, "high": high, "level": 0.9}


def _law(final: Fit, term: Term, units: Mapping[str, str], wide: Array) -> dict[str, Any] | None:
    """The law of an effect whose shape is free, its table with 90 % intervals of every level where all are known.

    The intervals are from resampled seconds of recordings, so they say how far the table would be another one with
    other data, whatever is left over.
    """
    law = term.effect.law_of(final.structure.term_values(final.z, term), units)
    if law is None:
        return None
    keys = {f"{term.key}.{p.name}" for p in term.effect.parameters if not p.fixed}
    own = np.array([slot.key in keys for slot in final.structure.slots])
    levels = np.array(law["table"]["levels"])
    values = [slot.value(z) for slot, z in zip(final.structure.slots, final.z, strict=True) if slot.key in keys]
    on_a_curve = isinstance(term.effect, Law) and term.effect.smooth
    as_they_are = len(values) == levels.size and np.allclose(values, levels.ravel())
    if (on_a_curve or as_they_are) and np.isfinite(wide[own]).all():
        apart = np.where(own, wide, 0.0)
        ends = [final.structure.term_values(final.z + sign * apart, term) for sign in (-1, 1)]
        tables = [(term.effect.law_of(end, units) or law)["table"]["levels"] for end in ends]
        law["table"] |= dict(zip(("low", "high"), np.sort(tables, axis=0).tolist(), strict=True))
    return law


def _lost(search: Searched, full: Fit, key: str) -> float:
    """By how much a fit predicts worse without one effect, all else refitted; without the only one it is the
    recalibrated model. In units of noise.
    """
    alone = len(full.structure.terms) == 1
    without = search.progress.path[0] if alone else search.fitter.roughly_without(full, key)
    error, left = (search.scorer.comparison_error(one) for one in (full, without))
    return max(left - error, 0.0)


def _rival(rival: stand_ins.Rival, test: Problem, as_given: float) -> dict[str, Any]:
    """One of the other effects that were tried, with its error on test data relative to that of the model as given."""
    return {
        **_name(rival.term),
        "held_out": significant(untouched.error_on(test, rival.fitted) / max(as_given, 1e-12)),
        "ruled_out": rival.ruled_out,
    }


def _name(term: Term) -> dict[str, str]:
    """What an effect is called, whichever of its laws it follows, and where it acts."""
    return {"effect": term.effect.name, "at": term.at}


def _each_once(named: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Of several laws of one effect at one place the first."""
    kept: dict[tuple[str, str], dict[str, Any]] = {}
    for one in named:
        kept.setdefault((one["effect"], one["at"]), one)
    return list(kept.values())


def with_unknown(
    missing: list[Missing], errors: Errors, search: Searched, final: Fit, joints: Sequence[str]
) -> list[Missing]:
    """Add what no effect of the catalogue explains; it comes first if what was found merely stands in for it."""
    left = max(errors.improved - 1, 0.0) / max(errors.recalibrated - 1, 1e-9)
    place = location.locate(search.question.look(final), joints)[0]
    unknown = Missing(
        "unknown",
        place.at,
        f"Something acts at {place.at} that no effect in the catalogue accounts for; it {sentences.verb(place.where)}.",
        float(np.clip(left, 0, 1)),
        where=place.where,
    )
    return [unknown, *missing] if not missing or left > VERDICT.stands_in else [*missing, unknown]
