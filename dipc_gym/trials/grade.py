"""Grade one trial: what the tool said, beside the sealed answer.

What counts as right:

- *name*: the strongest effect the tool calls missing is the truth; or it is the same model as the truth on that
  rig with that data (the generator found so by simulation) and the tool says so in `same_here`, as may be several
  effects that together are the same model; or it is a part of the truth (the Coulomb level within a Stribeck
  curve) and the truth itself follows in the list; or nothing is called missing where a refit of the model's own
  parameters already is the truth. Each route is counted by itself.
- *set*: every effect of the truth is named once by these rules, and nothing else, parts aside; one of several that
  by itself moves the held-out prediction by less than twice the noise may be left out.
- *place*: the first effect stands where the truth does (or its equivalent, for an equivalent name).
- *formula*: drag that thins does so exponentially; its law is said to be one exponential, falling over the true length
  to a tenth of it, and nothing more.
- *false alarm*: anything called missing, or a verdict of unexplained structure, where nothing is missing.
- *held-out error reached*: between the refitted nominal model (0 %) and the true structure (100 %) on a recording
  that the tool never saw, both by the generator's integrator; the tool's model is replayed by `dipc-gym replay
  --step`, so finely that none of its error is owed to integration.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

CLEAR = 2.0
"""From this size on, in noise standard deviations, an effect is expected to be found."""
STRUCTURE_LEFT = ("unexplained", "partly explained")
AS_LONG = 0.1
"""Share by which a length in a formula may be off and be called right."""
BROKEN = "Please report this with the files"
"""Ends the note on a stage that failed inside; the diagnosis goes on without it."""


@dataclass
class Grade:
    """One trial with its score; None where a question does not arise.

    Attributes:
        trial: name.
        rig: name.
        kind: `null`, `single`, `pair`, `unknown` or `wrong`.
        tuned: whether the nominal model was refitted beforehand.
        size: what the truth changes in held-out predictions beyond a refit of the nominal model's parameters, in noise
            standard deviations; where such a refit is the truth, beyond the nominal model itself.
        share: the same as a share of the signal, of what the command does within a window.
        truth: effect ids.
        said: effect ids called missing, strongest first.
        verdict: the tool's; `failed` if it left none.
        name: right name first.
        route: how it was right: `truth`, `same`, `part` or `refit`.
        set: right set.
        place: right place.
        alarm: something called missing where nothing is.
        renumbered: parameters called wrong where none are.
        unknown: unknown physics called unknown.
        misnamed: unknown physics given a known name.
        formula: of drag that thins, the right formula is said.
        beside: an effect with a name that is hidden beside a law, and moves predictions by twice the noise or more
            beside it, is named at its place.
        reached: share of the reachable improvement on the held-out recording, converged simulation.
        reached_own_step: the same with the integrator and step of the model's file.
        error: of the improved model on the held-out recording, in noise standard deviations, converged simulation.
        error_within: the same in windows that go no further than the recordings that the tool was given.
        inside: printed intervals that cover the truth.
        printed: intervals printed for parameters whose truth is known.
        parameters: parameters whose truth is known, of rightly named effects.
        seconds: taken by the tool.
        failure: the tool's last words.
        timed_out: stopped because its time was up.
        broken: a stage of the diagnosis failed inside, and what it would have found is lacking.
    """

    trial: str
    rig: str
    kind: str
    tuned: bool
    size: float
    share: float
    truth: list[str]
    said: list[str]
    verdict: str
    name: bool | None = None
    route: str = ""
    set: bool | None = None
    place: bool | None = None
    alarm: bool | None = None
    renumbered: bool | None = None
    unknown: bool | None = None
    misnamed: bool | None = None
    formula: bool | None = None
    beside: bool | None = None
    reached: float | None = None
    reached_own_step: float | None = None
    error: float | None = None
    error_within: float | None = None
    inside: int = 0
    printed: int = 0
    parameters: int = 0
    seconds: float = math.nan
    failure: str | None = None
    timed_out: bool = False
    broken: bool = False

    @property
    def clear(self) -> bool:
        """Whether hidden physics moves the held-out prediction by at least twice the noise."""
        return self.kind in ("single", "pair", "unknown") and self.size >= CLEAR


def grade(answer: Mapping[str, Any], diagnosis: Mapping[str, Any] | None, attempt: Mapping[str, Any]) -> Grade:
    """Score one diagnosis.

    Args:
        answer: the sealed answer.
        diagnosis: what the tool wrote, None if it failed.
        attempt: `seconds`, `failure` and `sensor_errors` on the held-out recording.
    """
    if attempt.get("failure"):
        diagnosis = None
    said = list((diagnosis or {}).get("missing") or [])
    # What a refit explains, or a simulator with wrong parameters lacks, shows against the nominal model only.
    renumber = answer["recalibrated_suffices"] or answer["kind"] == "wrong"
    size = answer["moved_from_nominal" if renumber else "share_of_signal"]
    if answer.get("beside"):
        size = answer["share_of_each"][_key(answer["missing"][0])]
    result = Grade(
        trial=answer["trial"],
        rig=answer["rig"],
        kind=answer["kind"],
        tuned=answer["tuned"],
        size=size,
        share=size / answer["signal"],
        truth=[m["effect"] for m in answer["missing"]],
        said=[m["effect"] for m in said],
        verdict=(diagnosis or {}).get("verdict", "failed"),
        seconds=attempt.get("seconds", math.nan),
        failure=attempt.get("failure"),
        timed_out=attempt.get("timed_out", False),
        broken=BROKEN in str((diagnosis or {}).get("notes", "")),
    )
    if answer["kind"] in ("null", "wrong"):
        # A tool that failed raised no alarm, but it gave no all-clear either.
        result.alarm = None if diagnosis is None else bool(said) or result.verdict in STRUCTURE_LEFT
        refitted = bool((diagnosis or {}).get("recalibrated"))
        if answer["kind"] == "null":
            result.renumbered = refitted and result.verdict == "recalibrated"
        else:
            result.name = diagnosis is not None and not said and result.verdict == "recalibrated"
    else:
        _grade_intervals(result, answer, said)
        law, about_it = _beside(result, answer, said) if answer.get("beside") else (answer, said)
        if answer["kind"] == "unknown":
            _grade_unknown(result, law, about_it)
        else:
            _grade_names(result, law, about_it)
    result.reached = _reached(answer, attempt.get("sensor_errors"))
    result.reached_own_step = _reached(answer, attempt.get("sensor_errors_own_step"))
    errors = attempt.get("sensor_errors")
    result.error = None if errors is None else in_noise(errors, answer["noise"])
    result.error_within = attempt.get("error_within")
    return result


def _beside(
    result: Grade, answer: Mapping[str, Any], said: Sequence[Mapping[str, Any]]
) -> tuple[Mapping[str, Any], Sequence[Mapping[str, Any]]]:
    """Grade the effect with a name beside a law; the answer about the law alone, and what else was said."""
    law, usual = answer["missing"]
    places = _accepted(answer, usual)
    its = [m for m in said if _route(m, usual, places) and m["at"] in places.get(m["effect"], set())]
    if answer["share_of_each"][_key(usual)] >= CLEAR:
        result.beside = bool(its)
    others = [m for m in said if m not in its]
    result.said = [m["effect"] for m in others]
    # What takes only the usual effect up leaves the law unsaid.
    return {**answer, "missing": [law], "recalibrated_suffices": False}, others


def _key(effect: Mapping[str, Any]) -> str:
    return f"{effect['effect']}@{effect['at']}"


def _accepted(answer: Mapping[str, Any], truth: Mapping[str, Any]) -> dict[str, set[str]]:
    """Acceptable names of one hidden effect, with their places."""
    places = {truth["effect"]: {truth["at"], *truth["also_at"]}}
    for other in answer["equivalents"].get(_key(truth), []):
        places.setdefault(other["effect"], set()).add(other["at"])
    return places


def _route(said: Mapping[str, Any], truth: Mapping[str, Any], places: Mapping[str, set[str]]) -> str:
    """How a name is right for a hidden effect; empty if it is not."""
    if said["effect"] == truth["effect"]:
        return "same" if said.get("together") else "truth"
    if said["effect"] in truth.get("alike", ()):
        return "truth"
    listed = {(other["effect"], other["at"]) for other in said.get("same_here") or []}
    there = {(truth["effect"], at) for at in (truth["at"], *truth["also_at"])}
    return "same" if said["effect"] in places and listed & there else ""


def _there(said: Mapping[str, Any], truth: Mapping[str, Any], places: Mapping[str, set[str]]) -> bool:
    """Whether a name that is right for a hidden effect stands at its place."""
    named = said["effect"] if said["effect"] in places else truth["effect"]  # one that is alike acts where it does
    return bool(said.get("together")) or said["at"] in places[named]


def _grade_names(result: Grade, answer: Mapping[str, Any], said: Sequence[Mapping[str, Any]]) -> None:
    truths = answer["missing"]
    accepted = [_accepted(answer, truth) for truth in truths]
    if not said:
        enough = ("recalibrated",) if result.clear else ("recalibrated", "consistent")
        refit = answer["recalibrated_suffices"] and result.verdict in enough
        result.name = result.set = refit
        result.route = "refit" if refit else ""
        result.place = None if refit else False
        return
    said = _collapsed(answer, said)
    parts = [m for m in said if m["effect"] in answer["includes"] and m["effect"] not in result.truth]
    whole = [m for m in said if m not in parts]
    left = list(range(len(truths)))
    extra = 0
    for one in whole:
        match = [i for i in left if _route(one, truths[i], accepted[i]) and _there(one, truths[i], accepted[i])]
        if match:
            left.remove(match[0])
        else:
            extra += 1
    alone = answer["share_of_each"]
    due = [i for i in left if alone.get(_key(truths[i]), math.inf) >= CLEAR]
    result.set = not due and not extra
    first = said[0]
    routes = [_route(first, truth, places) for truth, places in zip(truths, accepted, strict=True)]
    result.route = next((route for route in routes if route), "")
    if not result.route and first in parts and len(left) < len(truths):
        result.route = "part"
    result.name = bool(result.route)
    good = {place for places in accepted for place in set().union(*places.values())}
    if first["effect"] in {name for places in accepted for name in places}:
        good = set().union(*(places.get(first["effect"], set()) for places in accepted))
    result.place = first["at"] in good


def _collapsed(answer: Mapping[str, Any], said: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """What was said, with several effects that together are the truth, and are said to be, as that one effect."""
    result = list(said)
    for truth, sets in answer["equivalent_sets"].items():
        effect, at = truth.split("@")
        for one in sets:
            wanted = {(e["effect"], e["at"]) for e in one}
            parts = [m for m in result if (m["effect"], m["at"]) in wanted]
            listed = [(other["effect"], other["at"]) for m in parts for other in m.get("same_here") or []]
            open_about_it = (effect, at) in listed
            if len(parts) == len(wanted) and open_about_it:
                whole = {"effect": effect, "at": at, "together": True}
                result = [whole if m is parts[0] else m for m in result if m is parts[0] or m not in parts]
                break
    return result


def _grade_unknown(result: Grade, answer: Mapping[str, Any], said: Sequence[Mapping[str, Any]]) -> None:
    """Unknown physics: say so; a part of it, or a name that explains it just as well, is no mistake."""
    equal = {other["effect"] for others in answer["equivalents"].values() for other in others}
    explained = bool(said) and said[0]["effect"] in equal
    result.unknown = "unknown" in result.said or result.verdict in STRUCTURE_LEFT or explained
    if result.verdict != "failed":
        result.misnamed = any(name not in equal | {"unknown", *answer["includes"]} for name in result.said)
    at = {place for m in answer["missing"] for place in (m["at"], *m["also_at"])}
    if said:
        result.place = said[0]["at"] in at
    thins = [values["thin_shear"]["value"] for values in answer["parameters"].values() if "thin_shear" in values]
    if thins and result.clear:
        result.formula = any(one["at"] in at and _falls_over(thins[0], one) for one in said)


def _falls_over(length: float, said: Mapping[str, Any]) -> bool:
    """Whether a law without a name is said to be one exponential that falls over so large a speed of late."""
    law = said.get("law") or {}
    terms = (law.get("formula") or {}).get("terms") or []
    if said["effect"] != "unknown" or len(terms) != 1 or not law["of"][0].startswith("recent velocity "):
        return False
    return abs(terms[0].get("scale", math.inf) - length) <= AS_LONG * length


def _reached(answer: Mapping[str, Any], errors: Mapping[str, float] | None) -> float | None:
    """Share of the reachable improvement on the held-out recording."""
    if not answer["missing"] or not answer["held_out_predictable"] or errors is None:
        return None
    start = answer["test_error"]["nominal" if answer["recalibrated_suffices"] else "recalibrated"]
    goal = answer["test_error"]["truth"]
    if start - goal < 0.2:
        return None
    return (start - in_noise(errors, answer["noise"])) / (start - goal)


def in_noise(errors: Mapping[str, float], noise: Mapping[str, float]) -> float:
    """Root mean square of the sensors' errors, each in units of its noise."""
    return math.sqrt(float(np.mean([(errors[name] / size) ** 2 for name, size in noise.items()])))


def _values(answer: Mapping[str, Any], truth: str) -> dict[str, float]:
    """True values of an effect under the names and in the units that a diagnosis prints."""
    values = {name: entry["value"] for name, entry in answer["parameters"].get(truth, {}).items()}
    effect = truth.split("@")[0]
    drive = answer["drive"]
    for printed, source in (
        ("velocity", "stribeck_speed"),
        ("coefficient", "damping"),
        ("coefficient", "drag"),
        ("by_drive", "slope"),
        ("limit", "voltage"),
    ):
        if source in values:
            values[printed] = values[source]
    if effect == "load.tilt":
        # Gravity that pushes the cart forwards is gravity turned backwards about y.
        values |= {"about_x": 0.0, "about_y": -values["tilt"]}
    if effect == "motor.back_emf":
        values["coefficient"] = values["back_emf"] * drive["kt"] / drive["resistance"]
    if effect == "motor.inductance":
        values["time_constant"] = values["inductance"] / drive["resistance"]
    if effect.startswith("transmission."):
        values["rotor_inertia"] = drive["rotor"]
    if effect == "disturbance.periodic":
        values["frequency"] /= 2 * math.pi
    if effect == "load.swinging" and "slosh_rate" in values:
        values["frequency"] = values["slosh_rate"] / (2 * math.pi)
    if effect == "sensor.gain":
        values["gain"] += 1
    if effect == "load.spring":
        values["rest"] = 0.0
    if effect == "load.stop":
        values["high" if values["position"] > 0 else "low"] = values["position"]
    if effect in ("load.position", "sensor.eccentric") and "wave" in values:  # a law of any shape has none
        values["wavelength"] = 2 * math.pi / values["wave"]
    if effect == "motor.cogging":
        values["poles"] = values["wave"] / drive["gear"]
    if "amplitude" in values:
        size = values["amplitude"] / (drive["gear"] if effect == "motor.cogging" else 1.0)
        values |= {"sine": size * math.cos(values["phase"]), "cosine": size * math.sin(values["phase"])}
    if effect == "friction.position" and "wave" in values:
        size = values["level"] * values["variation"]
        values |= {"sine": size * math.cos(values["phase"]), "cosine": size * math.sin(values["phase"])}
        values["wavelength"] = 2 * math.pi / values["wave"]
    return values


def _grade_intervals(result: Grade, answer: Mapping[str, Any], said: Sequence[Mapping[str, Any]]) -> None:
    """Coverage, for effects that are named and placed as the truth is."""
    hidden = {(m["effect"], at): _key(m) for m in answer["missing"] for at in (m["at"], *m["also_at"])}
    for one in said:
        truth = hidden.get((one["effect"], one["at"]))
        if truth is None:
            continue
        known = _values(answer, truth)
        for name, entry in (one.get("parameters") or {}).items():
            if name not in known or not isinstance(entry, Mapping):
                continue
            result.parameters += 1
            low, high = entry.get("low"), entry.get("high")
            if low is None or high is None:
                continue
            result.printed += 1
            result.inside += low <= known[name] <= high
