"""A diagnosis in plain words: what is missing, what is left, what to record next."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from dipc_gym.recording.settings import CHECKS
from dipc_gym.sim2real.effects import Effect, catalogue
from dipc_gym.sim2real.model.parameters import ModelParameter
from dipc_gym.sim2real.model.structure import Term
from dipc_gym.sim2real.result import AsWritten, Beyond, Errors, Missing, SensorFit, Verdict, scaled
from dipc_gym.sim2real.selection.settings import SCORE, SEARCH
from dipc_gym.sim2real.verdict.conventions import Convention
from dipc_gym.sim2real.verdict.settings import VERDICT

NOT_HELD_OUT = (
    "What is given as the error on held-out data is that on data which were fitted: the other was not worked out."
)


def called(attribute: str, at: str) -> str:
    """A parameter of the model in words.

    Example:
        >>> called("centre_of_mass", "pole1")
        'centre of mass of pole1'
    """
    return f"{attribute.replace('_', ' ')} of {at}"


def verb(where: str) -> str:
    """What the unexplained force does, as the end of a sentence."""
    return where if where.startswith(("goes", "grows", "changes")) else f"is {where}"


def in_one_sentence(
    verdict: Verdict,
    missing: Sequence[Missing],
    changed: Sequence[dict[str, Any]],
    errors: Errors,
    *,
    others: bool = False,
    written: AsWritten | None = None,
    sensors: Sequence[SensorFit] = (),
    beyond: Beyond | None = None,
    later: float | None = None,
    compared: Errors | None = None,
) -> str:
    """What happened, in words that a rig's owner understands.

    Args:
        verdict: see `word.verdict`.
        missing: effects that were found.
        changed: model parameters that had to change.
        errors: on held-out windows, in units of noise.
        others: whether other parameters would have done as well.
        written: what the improved model comes to at its own step.
        sensors: errors of each, in its own unit.
        beyond: held-out windows that go beyond what laws were fitted with.
        later: error of laws of time that were fitted to the held-out time as well, which no law of time foretells.
        compared: on windows that were compared on, which are no test: whether what is left acts there as well.
    """
    times = f"from {errors.nominal:.3g} to {errors.improved:.3g} times the noise"
    told = in_units(sensors)
    diverging = " and ".join(one.name for one in sensors if not math.isfinite(one.errors.nominal))
    fall = f"As given, the model's predictions diverge at {diverging}. " if diverging else ""
    fall += f"On held-out data the error {f'{told}: ' if told else f'{_goes(errors)} '}{times}"
    if written is not None:
        at = f"improved.xml at its own step of {1e3 * written.timestep:g} ms"
        fall += f" ({at}: {written.held_out.improved:.3g})"
    telling = errors
    if beyond is not None:
        telling = beyond.within
        fall += (
            f"; in the {beyond.of - beyond.count} of {beyond.of} windows that stay where its laws have data, from "
            f"{telling.nominal:.3g} to {telling.improved:.3g} times"
        )
    if later is not None and later < telling.improved:
        telling = replace(telling, improved=later)
        fall += f"; fitted to that time as well, which no law of time foretells, {later:.3g} times are left"
    worse = errors.improved > max(errors.nominal, SCORE.at_floor)
    fitted = math.inf if compared is None else min(compared.recalibrated, compared.improved)
    changed_since = "where the rig is driven otherwise or has changed. Fit recordings of both, and hold out one of each"
    if worse:
        fall += f". That is worse than as given: what was fitted does not hold there, {changed_since}"
    elif fitted <= SCORE.at_floor and telling.improved > SEARCH.in_reach:
        fall += (
            f". What was fitted is predicted to {fitted:.3g} times the noise: what is left acts in the held-out data "
            f"alone, {changed_since}"
        )
    known = " ".join(_or_another(m) for m in missing if m.effect != "unknown" or m.law is not None)
    off = [one for one in changed if "low" in one and not one["low"] <= one["was"] <= one["high"]]
    if off and known:
        known += f" Wrong as well {'were' if len(off) > 1 else 'was'} {', '.join(map(_change, off))}."
    left = ""
    if telling.improved > SCORE.at_floor:
        left = " What is left is not noise, but small beside the motion, and no known effect accounts for it."
    if verdict == "consistent":
        told = " and ".join(f"{_shown(one.errors.nominal, one.unit)} at {one.name}" for one in _telling(sensors))
        within = f"{told + ', ' if told else ''}{errors.nominal:.3g} times the noise"
        nothing = "Nothing that is large beside the motion" if left else "Nothing"
        return f"{nothing} is missing: the model predicts held-out data to {within}.{left}"
    if verdict == "recalibrated":
        names = ", ".join(called(c["parameter"], c["at"]) for c in changed)
        instead = " (or others, which predict as well: see the notes)" if others else ""
        none = "No physics that is large beside the motion" if left else "No physics"
        return f"{none} is missing; wrong parameters were: {names}{instead}. {fall}.{left}"
    if verdict == "explained":
        where = " there" if beyond is not None else ""
        return f"The model lacks this: {known} {fall}; what is left{where} is as small as noise."
    if verdict == "modelled":
        law = " ".join(m.sentence for m in missing) or "What the model lacks has no name, but a law that predicts it."
        return f"{law} {fall}.{left}"
    if verdict == "partly explained" and telling.improved <= SCORE.at_floor:
        return f"{known} {fall}; what is left is as small as noise. What has no name is modelled, not understood."
    if verdict == "partly explained":
        helps = "That helps where it was fitted" if worse else "That helps"
        return f"{known} {helps}, but structure is left that no known effect accounts for. {fall}."
    return f"{missing[0].sentence if missing else ''} {fall}.".strip()


def _or_another(one: Missing) -> str:
    """An effect in words, and what is one model with it on these recordings; what holds it and more goes unsaid."""
    more = {
        effect.name for effect in catalogue().values() if one.effect in {of.partition(":")[0] for of in effect.contains}
    }
    others = [f"{other['effect']} at {other['at']}" for other in one.same_here if other["effect"] not in more]
    return f"{one.sentence} These recordings cannot tell that from {' or '.join(others)}." if others else one.sentence


def _change(one: dict[str, Any]) -> str:
    """A model parameter that was wrong, with what it is instead."""
    value, was = (f"{one[key]:.4g} {one['unit']}".rstrip() for key in ("value", "was"))
    return f"{called(one['parameter'], one['at'])} ({value}, not {was})"


def in_units(sensors: Sequence[SensorFit]) -> str:
    """How errors fall of the two sensors that tell most, in words an owner measures by; empty if nothing is known.

    Example:
        >>> in_units([SensorFit("arm", "rad", 1e-3, 0.5, Errors(0.05, 0.02, 0.001))])
        'falls from 2.86 to 0.0573 degrees at arm (10 to 0.2 % of its motion)'
    """
    parts, before = list[str](), ""
    for one in _telling(sensors):
        e = one.errors
        share = ""
        if one.motion > 0:  # a sensor may rest where it is tested
            share = f" ({_percent(e.nominal / one.motion)} to {_percent(e.improved / one.motion)} % of its motion)"
        goes, before = "" if _goes(e) == before else f"{_goes(e)} ", _goes(e)
        fall = f"{goes}from {_shown(e.nominal, one.unit, bare=True)} to {_shown(e.improved, one.unit)}"
        parts.append(f"{fall} at {one.name}{share}")
    return " and ".join(parts)


def _percent(share: float) -> str:
    """A share in percent, of two digits, and all before the point."""
    return f"{100 * share:.0f}" if share >= 1 else f"{100 * share:.2g}"


def _goes(errors: Errors) -> str:
    """Which way errors go from those of the model as given to those of the improved one."""
    return "falls" if errors.improved < errors.nominal else "goes"


def _telling(sensors: Sequence[SensorFit]) -> list[SensorFit]:
    """The two sensors whose errors are largest beside their noise, of those whose predictions stay finite."""
    known = [
        one for one in sensors if 0 < one.noise < math.inf and math.isfinite(one.errors.nominal + one.errors.improved)
    ]
    return sorted(known, key=lambda one: -one.errors.nominal / one.noise)[:2]


def _shown(value: float, unit: str, *, bare: bool = False) -> str:
    """A number in a unit that people measure by."""
    number, name = scaled(value, unit)
    return f"{number:.3g}" if bare else f"{number:.3g} {name}".strip()


def begins_otherwise(error: float) -> str:
    """Note on the first moments of recordings that begin at rest, which no fit has touched.

    Args:
        error: there, in units of noise.
    """
    return (
        f"The first moments of recordings that begin at rest are predicted to {error:.3g} times the noise only. No "
        "verdict goes by them: commands from before a file begins may act there. If there were none, something that "
        "goes with what was of late is missing; begin a recording with a second at rest to tell."
    )


def goes_beyond(outside: Beyond, *, fitted: bool) -> str:
    """Note on held-out windows that go beyond what laws were fitted with.

    Args:
        outside: these windows.
        fitted: whether laws were fitted to them once they had judged.
    """
    one = outside.count == 1
    return (
        f"{outside.count} of {outside.of} held-out windows {'goes' if one else 'go'} beyond what laws were fitted with "
        f"({_ranges(outside)}). Laws stay there as they end, and the error is {outside.there:.3g} times the noise; "
        "such windows do not say what else is missing."
        + (" The laws that are reported and written were fitted to all of the recordings after that." if fitted else "")
    )


def _ranges(outside: Beyond) -> str:
    """What goes how far beyond what was fitted."""
    ranges = []
    for one in outside.inputs:
        (least, most), (low, high) = one["fitted"], one["asked"]
        name = one["name"].replace(" ", " of ", 1)
        ranges.append(f"{name} from {low:.3g} to {high:.3g}, fitted from {least:.3g} to {most:.3g}")
    return "; ".join(ranges) or "between fitted data that lie apart"


# What to record, by what an unknown force goes with; for time, and for all alike, commands that repeat tell.
SHOWN_BY = {
    "velocity": "move it at several constant speeds, each of them both ways, and turn round slowly between them.",
    "position": "move it slowly from one end to the other and back, several times, and then faster.",
    "load": "record the same commands once more with another load.",
}


def next_experiment(
    verdict: Verdict,
    missing: Sequence[Missing],
    *,
    others: bool = False,
    slow: bool = False,
    beyond: Beyond | None = None,
) -> str:
    """What to record to settle what is left.

    Args:
        verdict: see `word.verdict`.
        missing: effects that were found.
        others: whether other model parameters than those that changed would have done as well.
        slow: whether a recording is sampled slowly; see `recording.checks.sampled_slowly`.
        beyond: held-out windows that go beyond what laws were fitted with.
    """
    open_ = [(m, s) for m in missing for s in m.same_here]
    if open_:
        m, s = open_[0]
        return (
            f"On this rig with this data {m.effect} at {m.at} and {s['effect']} at {s['at']} are one model. To tell "
            f"them apart, record {catalogue().get(s['effect'], Effect).shown_by}."
        )
    doubt = [(m, r) for m in missing for r in m.rivals if not r["ruled_out"]]
    if doubt:
        m, r = doubt[0]
        return (
            f"{r['effect']} at {r['at']} predicts nearly as well as {m.effect} at {m.at}. Record slow reversals and "
            "fast steps over the whole range for a minute."
        )
    if beyond is not None:
        return (
            f"Fit recordings that go as far as the held-out data do ({_ranges(beyond)}): a law says nothing of where "
            "no data were."
        )
    if verdict == "modelled":
        return (
            "A law is a fit, not yet an understanding: record again with another load, speed or range, and see whether "
            "it still predicts. Where it does not, what it stands for depends on what was changed."
        )
    if verdict in ("partly explained", "unexplained") and slow:
        return (
            f"Record again at {CHECKS.rate:g} Hz or more (see the notes): commands that changed between two rows are "
            "in no file, and nothing can explain what they did."
        )
    if verdict in ("partly explained", "unexplained"):
        for m in missing:
            inputs = list(m.law["of"]) if m.law and m.effect == "unknown" else []
            own = [n for n in SHOWN_BY if inputs == [f"{n} {m.at}"] or re.search(rf"\bwith {n}\b", m.where)]
            if own:
                return f"What is unknown at {m.at} goes with {own[0]}: {SHOWN_BY[own[0]]}"
        return (
            "Repeat one short command many times over several minutes, at rest in between: what changes from one time "
            "to the next depends on time or temperature, what does not depends on the state."
        )
    if others:
        return (
            "Which of the model's parameters were wrong is open (see the notes): weigh or measure one of them and say "
            "so with --fix or --prior."
        )
    return "Nothing is open. Record again when the rig is changed."


def not_in_test(before: float, test: float) -> str:
    """Note on what test data do not show; errors on windows compared on and on test data, in units of noise."""
    return (
        f"The test data do not show what is missing ({test:.3g} times the noise there, {before:.3g} in the part before "
        "them): they hold no motion in which it acts. Record such motion again, and hold that recording out."
    )


def disagreement(errors: Errors, force: dict[str, Errors]) -> list[str]:
    """Notes where predictions and forces disagree on whether the improved model is better."""
    notes = []
    less, more = VERDICT.disagree
    for at, e in force.items():
        if errors.improved < less * errors.recalibrated and e.improved > more * e.recalibrated:
            better, worse = "predicts motion better", "forces"
        elif errors.improved > more * errors.recalibrated and e.improved < less * e.recalibrated:
            better, worse = "explains forces better", "motion"
        else:
            continue
        notes.append(
            f"The improved model {better} than the recalibrated one, but {worse} at {at} worse on the same held-out "
            f"data (force error {100 * e.recalibrated:.3g} to {100 * e.improved:.3g} %, prediction error "
            f"{errors.recalibrated:.3g} to {errors.improved:.3g} times the noise)."
        )
    return notes


def as_written(said: AsWritten) -> str:
    """What the improved model comes to as its owner will run it."""
    at = f"At its own step of {1e3 * said.timestep:g} ms ({said.integrator})"
    return (
        f"{at} this file predicts held-out data to {said.held_out.improved:.3g} times the noise, the model as given to "
        f"{said.held_out.nominal:.3g}; in fine steps what was found predicts them to {said.fine:.3g}."
    )


def made_up(said: AsWritten, differing: Sequence[tuple[str, float, float]]) -> str:
    """Note on parameters that make up for the step of the file.

    Args:
        said: what the file comes to.
        differing: key, what was found, and what is written.
    """
    named = ", ".join(f"{key} {put:.3g} ({found:.3g})" for key, found, put in differing)
    return (
        f"The numbers of improved.xml make up for its own step of {1e3 * said.timestep:g} ms and are right at no "
        f"other; what was found is in diagnosis.json{f': {named}' if named else ''}."
    )


def asks_for(said: AsWritten) -> str:
    """A sentence on the integrator that the file asks for in the place of its own; empty if it does not."""
    if not said.exact:
        return ""
    return (
        f"improved.xml asks for the integrator {said.integrator}: with the model's own at the same step of "
        f"{1e3 * said.timestep:g} ms, a model that lacks what was found would predict better. A step takes about four "
        "times as long."
    )


def initial_states(said: AsWritten, errors: Errors) -> str:
    """Note on an error that no initial states were found for; empty where it is what simulation comes to.

    Args:
        said: what the file comes to.
        errors: with what yet other initial states would explain, as derivatives have it, in units of noise.
    """
    if said.fine <= SCORE.at_floor * max(errors.improved, 1.0):
        return ""
    return (
        f"Simulated from the best initial states that were found, held-out data are predicted to {said.fine:.3g} times "
        f"the noise, whatever the step: {errors.improved:.3g} grants every window what yet another initial state would "
        "explain by derivatives, and where joints stick there may be no such state."
    )


def step_costs(said: AsWritten, *, dropped: Sequence[str], alone: bool, stiff: bool) -> str:
    """Note on a file that predicts worse at its own step than what was found does in fine ones; empty if it does not.

    Args:
        said: what the file comes to.
        dropped: effects that are left out of the file.
        alone: whether it holds none.
        stiff: whether dry friction in it has constants chosen with its step in mind.
    """
    asks = asks_for(said)
    allowed = SCORE.at_floor * max(said.fine, 1.0)
    if not dropped and said.finer is None and said.held_out.improved <= allowed:
        return asks
    note = asks and f"{asks} "
    note += (
        f"At the model's own step of {1e3 * said.timestep:g} ms and with its integrator improved.xml predicts to "
        f"{said.held_out.improved:.3g} times the noise, with a converged step to {said.fine:.3g}, and no "
        "parameters make up for that: finer steps are worth more than any further physics."
    )
    if dropped:
        left_out = "what was found beside it" if alone else " and ".join(dropped)
        note += f" With {left_out}, it would predict worse there than without, so that is left out of it."
    if said.finer is None:
        return f"{note} None of the steps tried, down to 1/{max(VERDICT.shorter)} of it, brings it there."
    finer = said.finer
    if finer.timestep == said.timestep:
        steps = f"the integrator {finer.integrator} at this step"
    else:
        also = f" and each solreffriction {said.timestep / finer.timestep:.0f} times shorter as well" if stiff else ""
        steps = f"a timestep of {1e3 * finer.timestep:g} ms{also}"
    return f"{note} With {steps} it predicts to {finer.error:.3g} times the noise."


def pushed_elsewhere(count: int) -> str:
    """Note on test windows that are left aside, so many."""
    return (
        f"What pushed one recording pushed no other: {count} window{'s' * (count > 1)} of other recordings at the same "
        f"time on their clocks {'are' if count > 1 else 'is'} not tested with."
    )


def own_step(step: float, fine: float) -> str:
    """Note on recordings that the model, with what it lacks, predicts as it steps and not as it would move.

    Args:
        step: of the model, s.
        fine: error of what was found in fine steps, in units of noise.
    """
    return (
        f"These recordings look simulated by MuJoCo, at the model's own step of {1e3 * step:g} ms and with its "
        f"integrator: they are predicted to the noise there, and clearly worse in fine steps ({fine:.3g} times the "
        "noise). They are judged at that step, and dry friction is taken to be as soft as MuJoCo's."
    )


def conventions(found: Sequence[Convention], given: float, error: float) -> tuple[str, str]:
    """Why nothing can be told of recordings that count otherwise than the model, and what to do.

    Args:
        found: conventions any one of which would mend it.
        given: error of the model as given, in units of noise.
        error: with a convention changed.
    """
    reason = (
        f"they seem to {', or to '.join(one.words for one in found)} (with that changed, the model as given is off by "
        f"{error:.3g} times the noise instead of {given:.3g})"
    )
    mend = ", or ".join(dict.fromkeys(one.mend for one in found))
    return reason, f"{mend[0].upper()}{mend[1:]}, and diagnose again: whatever is fitted over that is nonsense."


def other_parameters(changed: Sequence[dict[str, Any]], others: Sequence[Sequence[ModelParameter]]) -> list[str]:
    """Note on model parameters that may have been wrong in place of those that were changed."""
    if not changed or not others:
        return []
    names = " and ".join(called(one["parameter"], one["at"]) for one in changed)
    instead = "; ".join(" and ".join(called(one.attribute, one.at) for one in other) for other in others)
    return [
        f"These recordings do not tell whether {names} had to change, or others that predict as well: {instead}. Weigh "
        "or measure one of them and say so with --fix."
    ]


def refutation(terms: Sequence[Term], before: float, after: float, otherwise: str = "") -> str:
    """Note on effects that fit the recordings and fail on validation data, with the errors there, in units of noise."""
    return (
        f"{' and '.join(term.key for term in terms) or otherwise} would explain the recordings that were fitted, but "
        f"validation data speak against it (the error rises from {before:.3g} to {after:.3g} times the noise), "
        "so it is not named."
    )


def not_alone(term: Term, left: float) -> str:
    """Note on what is told by when it acts, where more is left; the error on validation data, in units of noise."""
    return (
        f"{term.key} would explain a part, but it is told from other causes by when it acts alone, and validation data "
        f"hold more that it does not explain ({left:.3g} times the noise); that may have the same cause, so it is not "
        "named."
    )


def _smaller(gain: float) -> str:
    """By how much an error is smaller whose log square fell so far."""
    return f"{100 * (1 - math.exp(-gain / 2)):.0f} %"


def divided(term: Term, gain: float) -> str:
    """Note on a law of no kind over which validation data are divided; the fall of the log square error."""
    much = f"by {_smaller(gain)} better" if gain > 0 else "no better"
    return (
        f"{term.key} would explain more of what was fitted, but validation data are divided over it: it predicts some "
        f"of them worse, and all of them {much}; improved.xml leaves it out."
    )


def no_name(term: Term, gain: float) -> str:
    """Note on an effect that improves predictions by less than it would have to; the fall of the log square error."""
    return (
        f"{term.key} improves predictions of windows that no fit has touched by {_smaller(gain)}, which is too little, "
        "or too uneven, to be believed; improved.xml holds it, and it is not named."
    )
