"""Open the sealed answers and compare them with what the tool said.

What counts as right:

- *name*: the strongest effect the tool calls missing is the truth; or it is the same model as the truth on that
  rig with that data (the generator found so by simulation) and the tool says so in `same_here`; or it is a part of
  the truth (the Coulomb level within a Stribeck curve) and the truth itself follows in the list; or nothing is
  called missing where a refit of the model's own numbers already is the truth. Each route is counted by itself.
- *set*: every effect of the truth is named once by these rules, and nothing else, parts aside; one of several that
  by itself moves the held-out prediction by less than twice the noise may be left out.
- *place*: the first effect stands where the truth does (or its equivalent, for an equivalent name).
- *false alarm*: anything called missing, or a verdict of unexplained structure, where nothing is missing.
- *held-out error reached*: between the refitted nominal model (0 %) and the true structure (100 %) on a recording
  that the tool never saw, both by the generator's integrator; the tool's model is replayed by `dipc-gym replay`.
"""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

BINS = (0.0, 1.0, 2.0, 5.0, 20.0, 100.0, math.inf)
"""Edges of effect size: change of the held-out prediction in noise standard deviations."""
CLEAR = 2.0
"""From this size on an effect is expected to be found."""
STRUCTURE_LEFT = ("unexplained", "partly explained")


@dataclass
class Judgement:
    """One trial with its score; None where a question does not arise.

    Attributes:
        trial: name.
        rig: name.
        kind: `null`, `single`, `pair`, `unknown` or `wrong`.
        tuned: whether the nominal model was refitted beforehand.
        size: share of signal, see the generator.
        truth: effect ids.
        said: effect ids called missing, strongest first.
        verdict: the tool's; `failed` if it left none.
        name: right name first.
        route: how it was right: `truth`, `same`, `part` or `refit`.
        set: right set.
        place: right place.
        alarm: something called missing where nothing is.
        renumbered: numbers called wrong where none are.
        unknown: unknown physics called unknown.
        misnamed: unknown physics given a known name.
        reached: share of the reachable improvement on the held-out recording.
        inside: printed intervals that cover the truth.
        printed: intervals printed for parameters whose truth is known.
        parameters: parameters whose truth is known, of rightly named effects.
        seconds: taken by the tool.
        failure: the tool's last words.
    """

    trial: str
    rig: str
    kind: str
    tuned: bool
    size: float
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
    reached: float | None = None
    inside: int = 0
    printed: int = 0
    parameters: int = 0
    seconds: float = math.nan
    failure: str | None = None


def judge(answer: Mapping[str, Any], diagnosis: Mapping[str, Any] | None, attempt: Mapping[str, Any]) -> Judgement:
    """Score one diagnosis.

    Args:
        answer: the sealed answer.
        diagnosis: what the tool wrote, None if it failed.
        attempt: `seconds`, `failure` and `sensor_errors` on the held-out recording.
    """
    said = list((diagnosis or {}).get("missing") or [])
    result = Judgement(
        trial=answer["trial"],
        rig=answer["rig"],
        kind=answer["kind"],
        tuned=answer["tuned"],
        size=answer["share_of_signal"],
        truth=[m["effect"] for m in answer["missing"]],
        said=[m["effect"] for m in said],
        verdict=(diagnosis or {}).get("verdict", "failed"),
        seconds=attempt.get("seconds", math.nan),
        failure=attempt.get("failure"),
    )
    if answer["kind"] in ("null", "wrong"):
        # A tool that failed raised no alarm, but it gave no all-clear either.
        result.alarm = None if diagnosis is None else bool(said) or result.verdict in STRUCTURE_LEFT
        numbers = bool((diagnosis or {}).get("recalibrated"))
        if answer["kind"] == "null":
            result.renumbered = numbers and result.verdict == "recalibrated"
        else:
            result.name = diagnosis is not None and not said and result.verdict == "recalibrated"
            result.size = answer["moved_from_nominal"]
    elif answer["kind"] == "unknown":
        _judge_unknown(result, answer, said)
    else:
        _judge_names(result, answer, said)
        _judge_intervals(result, answer, said)
    result.reached = _reached(answer, attempt)
    return result


def _accepted(answer: Mapping[str, Any], truth: Mapping[str, Any]) -> dict[str, set[str]]:
    """Acceptable names of one hidden effect, with their places."""
    places = {truth["effect"]: {truth["at"], *truth["also_at"]}}
    for other in answer["equivalents"].get(f"{truth['effect']}@{truth['at']}", []):
        places.setdefault(other["effect"], set()).add(other["at"])
    return places


def _route(said: Mapping[str, Any], truth: Mapping[str, Any], places: Mapping[str, set[str]]) -> str:
    """How a name is right for a hidden effect; empty if it is not."""
    if said["effect"] == truth["effect"]:
        return "truth"
    listed = {other["effect"] for other in said.get("same_here") or []}
    return "same" if said["effect"] in places and truth["effect"] in listed else ""


def _judge_names(result: Judgement, answer: Mapping[str, Any], said: Sequence[Mapping[str, Any]]) -> None:
    truths = answer["missing"]
    accepted = [_accepted(answer, truth) for truth in truths]
    if not said:
        refit = answer["recalibrated_suffices"] and result.verdict in ("recalibrated", "consistent")
        result.name = result.set = refit
        result.route = "refit" if refit else ""
        return
    if _judge_equal_set(result, answer, said):
        return
    parts = [m for m in said if m["effect"] in answer["includes"] and m["effect"] not in result.truth]
    whole = [m for m in said if m not in parts]
    left = list(range(len(truths)))
    extra = 0
    for one in whole:
        match = [i for i in left if _route(one, truths[i], accepted[i])]
        # Of two hidden effects with the same name, the one at this place.
        match.sort(key=lambda i: one["at"] not in accepted[i].get(one["effect"], set()))
        if match:
            left.remove(match[0])
        else:
            extra += 1
    alone = answer["share_of_each"]
    due = [i for i in left if alone.get(f"{truths[i]['effect']}@{truths[i]['at']}", math.inf) >= CLEAR]
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


def _judge_equal_set(result: Judgement, answer: Mapping[str, Any], said: Sequence[Mapping[str, Any]]) -> bool:
    """Several effects that together are the truth, if the tool says so for one of them; whether that is the case."""
    for truth, sets in answer["equivalent_sets"].items():
        effect = truth.split("@")[0]
        for one in sets:
            wanted = {(e["effect"], e["at"]) for e in one}
            same = [m for m in said if (m["effect"], m["at"]) in wanted]
            open_about_it = any(other["effect"] == effect for m in same for other in m.get("same_here") or [])
            if len(answer["missing"]) == 1 and len(same) == len(wanted) and said[0] in same and open_about_it:
                result.name, result.place, result.route = True, True, "same"
                result.set = len(said) == len(same)
                return True
    return False


def _judge_unknown(result: Judgement, answer: Mapping[str, Any], said: Sequence[Mapping[str, Any]]) -> None:
    """Unknown physics: say so; a part of it, or a name that explains it just as well, is no mistake."""
    fine = {"unknown", *answer["includes"]}
    for others in answer["equivalents"].values():
        fine |= {other["effect"] for other in others}
    explained = bool(said) and said[0]["effect"] in fine - {"unknown", *answer["includes"]}
    result.unknown = "unknown" in result.said or result.verdict in STRUCTURE_LEFT or explained
    result.misnamed = any(name not in fine for name in result.said)
    at = {place for m in answer["missing"] for place in (m["at"], *m["also_at"])}
    if said:
        result.place = said[0]["at"] in at


def _reached(answer: Mapping[str, Any], attempt: Mapping[str, Any]) -> float | None:
    """Share of the reachable improvement on the held-out recording."""
    errors = attempt.get("sensor_errors")
    if not answer["missing"] or not answer["held_out_predictable"] or errors is None:
        return None
    start = answer["test_error"]["nominal" if answer["recalibrated_suffices"] else "recalibrated"]
    goal = answer["test_error"]["truth"]
    if start - goal < 0.2:
        return None
    got = math.sqrt(float(np.mean([(errors[name] / noise) ** 2 for name, noise in answer["noise"].items()])))
    return (start - got) / (start - goal)


def _values(answer: Mapping[str, Any], truth: str) -> dict[str, float]:
    """True values of an effect under every name that a diagnosis may print, SI units."""
    values = {name: entry["value"] for name, entry in answer["parameters"].get(truth, {}).items()}
    effect = truth.split("@")[0]
    for printed, source, factor in (
        ("velocity", "stribeck_speed", 1.0),
        ("coefficient", "damping", 1.0),
        ("coefficient", "drag", 1.0),
        ("coefficient", "slope", 1.0),
        ("limit", "voltage", 1.0),
        ("about_y", "tilt", 1.0),
    ):
        if source in values:
            values[printed] = values[source] * factor
    if effect == "disturbance.periodic":
        values["frequency"] = values["frequency"] / (2 * math.pi)
    if effect == "sensor.gain":
        values["gain"] = 1 + values["gain"]
    if "wave" in values and effect in ("load.position", "friction.position"):
        values["wavelength"] = 2 * math.pi / values["wave"]
    if effect == "friction.position":
        # The level means something else where it is printed knot by knot.
        values.pop("level")
    return values


def _judge_intervals(result: Judgement, answer: Mapping[str, Any], said: Sequence[Mapping[str, Any]]) -> None:
    """Coverage, for effects that are named and placed as the truth is."""
    hidden = {
        (m["effect"], at): f"{m['effect']}@{m['at']}" for m in answer["missing"] for at in (m["at"], *m["also_at"])
    }
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


def upper_bound(events: int, trials: int, level: float = 0.95) -> float:
    """One-sided Clopper-Pearson upper bound of a rate.

    Example:
        >>> round(upper_bound(0, 150), 4)
        0.0198
    """
    from scipy.stats import beta

    return 1.0 if events >= trials else float(beta.ppf(level, events + 1, trials - events))


def score(out: Path, names: Sequence[str]) -> dict[str, Any]:
    """Judge every attempted trial under `out` and sum up.

    Args:
        out: folder with `sealed/` and `results/`.
        names: trials; those without an attempt are counted as open.

    Returns:
        `summary`, `by_size`, `confusion` and `trials`, ready for JSON.
    """
    judged = []
    for name in names:
        note = out / "results" / name / "attempt.json"
        if not note.exists():
            continue
        answer = json.loads((out / "sealed" / f"{name}.json").read_text(encoding="utf-8"))
        attempt = json.loads(note.read_text(encoding="utf-8"))
        written = note.with_name("diagnosis.json")
        diagnosis = json.loads(written.read_text(encoding="utf-8")) if written.exists() else None
        judged.append(judge(answer, diagnosis, attempt))
    return {"open": len(names) - len(judged), **summarise(judged)}


def _rate(values: Sequence[bool | None]) -> dict[str, float | int | None]:
    known = [bool(v) for v in values if v is not None]
    return {"right": sum(known), "of": len(known), "rate": sum(known) / len(known) if known else None}


def summarise(judged: Sequence[Judgement]) -> dict[str, Any]:
    """Rates, quantiles, the confusion matrix and the single judgements."""
    hidden = [j for j in judged if j.kind in ("single", "pair")]
    clear = [j for j in hidden if j.size >= CLEAR or j.route == "refit"]
    nulls = [j for j in judged if j.kind == "null" and j.alarm is not None]
    unknown = [j for j in judged if j.kind == "unknown"]
    alarms = sum(bool(j.alarm) for j in nulls)
    reached = [j.reached for j in clear if j.reached is not None]
    seconds = [j.seconds for j in judged if math.isfinite(j.seconds)]
    printed, known = sum(j.printed for j in judged), sum(j.parameters for j in judged)
    summary = {
        "trials": len(judged),
        "failed": [j.trial for j in judged if j.verdict == "failed"],
        "name": _rate([j.name for j in clear]),
        "routes": {route: sum(j.route == route for j in clear) for route in ("truth", "same", "part", "refit")},
        "set": _rate([j.set for j in clear]),
        "place": _rate([j.place for j in clear]),
        "name_all_sizes": _rate([j.name for j in hidden]),
        "nulls": len(nulls),
        "false_alarms": alarms,
        "false_alarms_upper_95": upper_bound(alarms, len(nulls)) if nulls else None,
        "nulls_renumbered": sum(bool(j.renumbered) for j in nulls),
        "wrong_numbers": _rate([j.name for j in judged if j.kind == "wrong"]),
        "unknown": _rate([j.unknown for j in unknown]),
        "unknown_misnamed": _rate([j.misnamed for j in unknown]),
        "reached_median": float(np.median(reached)) if reached else None,
        "reached_quartiles": np.quantile(reached, [0.25, 0.75]).tolist() if reached else None,
        "reached_trials": len(reached),
        "interval_coverage": _rate(
            [True] * sum(j.inside for j in judged) + [False] * (printed - sum(j.inside for j in judged))
        ),
        "intervals_printed": {"right": printed, "of": known, "rate": printed / known if known else None},
        "seconds_median": float(np.median(seconds)) if seconds else None,
        "seconds_by_rig": {
            rig: float(
                np.median([j.seconds for j in judged if j.rig == rig and math.isfinite(j.seconds)] or [math.nan])
            )
            for rig in sorted({j.rig for j in judged})
        },
    }
    by_size = []
    for low, high in itertools.pairwise(BINS):
        some = [j for j in hidden if low <= j.size < high]
        by_size.append(
            {
                "low": low,
                "high": high if math.isfinite(high) else None,
                "trials": len(some),
                "name": _rate([j.name for j in some]),
                "set": _rate([j.set for j in some]),
                "place": _rate([j.place for j in some]),
                "reached_median": _median([j.reached for j in some if j.reached is not None]),
            }
        )
    confusion: dict[str, dict[str, int]] = {}
    for j in judged:
        if j.kind != "pair":
            row = confusion.setdefault(j.truth[0] if j.truth else f"({j.kind})", {})
            column = j.said[0] if j.said else f"({j.verdict})"
            row[column] = row.get(column, 0) + 1
    return {"summary": summary, "by_size": by_size, "confusion": confusion, "trials": [asdict(j) for j in judged]}


def _median(values: Sequence[float]) -> float | None:
    return float(np.median(values)) if values else None
