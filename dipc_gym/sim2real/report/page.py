"""The diagnosis as one page that needs nothing else: plain language first, evidence after.

Whoever diagnoses fills a `ReportData`; `render` draws it. Every text in it may come from a stranger's model or
recording: the template escapes all, and characters that could turn or hide a line are replaced.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dipc_gym.sim2real.report import plots
from dipc_gym.sim2real.report.charts import Tone
from dipc_gym.sim2real.report.wording import clean, fine_percent, measured, number, percent, short, tied
from dipc_gym.sim2real.result import MOST_MAPS, MOST_RESIDUALS, MOST_TRACES, Candidate, Details, Verdict, scaled

Array = NDArray[np.float64]

VERDICTS: dict[Verdict, str] = {
    "consistent": "The model predicts these recordings: nothing is missing that is large beside noise or motion.",
    "recalibrated": "Parameters of the model were off; nothing else is missing that is large beside noise or motion.",
    "explained": "With the physics that was missing, prediction comes down to the noise.",
    "modelled": "Prediction comes down to the noise with a law that has no name: a fit, not yet an understanding.",
    "partly explained": "The physics named here helps. Some structure is left that no known effect accounts for.",
    "unexplained": "There is structure beyond noise, and no known effect accounts for it.",
    "cannot tell": "These recordings cannot decide it.",
}
MOST_CANDIDATES = 30  # listed in full; what is drawn is bounded as well: keeps the page below 2 MB
MOST_LINES = 400  # of the difference


@dataclass(frozen=True)
class ReportData:
    """All that the page shows.

    Attributes:
        model: name of the model's file.
        diagnosis: what `diagnosis.json` holds.
        details: what is drawn and listed.
        command: that makes this page again.
        notes: sentences about the recordings and about the step size.
    """

    model: str
    diagnosis: Mapping[str, Any]
    details: Details = field(default_factory=Details)
    command: str = ""
    notes: Sequence[str] = ()


def render(data: ReportData) -> str:
    """The page as text: one file, no script, no request, at most 2 MB.

    Args:
        data: what to show.

    Raises:
        ValueError: unknown verdict.

    Example:
        >>> found = {"verdict": "consistent", "sentence": "Nothing beyond noise."}
        >>> "Nothing beyond noise." in render(ReportData("cart.xml", found))
        True
    """
    import jinja2

    verdict = data.diagnosis["verdict"]
    if verdict not in VERDICTS:
        raise ValueError(f"diagnosis: verdict {verdict!r} is none of {', '.join(VERDICTS)}")
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        finalize=clean,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"number": number, "percent": percent, "fine_percent": fine_percent}
    environment.filters |= {"short": short, "measured": measured, "tied": tied}
    with np.errstate(all="ignore"):  # a prediction may have diverged; charts leave out what is not finite
        parts = _parts(data)
    return environment.get_template("page.html.j2").render(
        data=data, d=data.diagnosis, gloss=VERDICTS[verdict], **parts
    )


def _parts(data: ReportData) -> dict[str, Any]:
    """What the template shows, drawn and sorted."""
    shown, left, screened = _candidates(data.details.candidates)
    first: Tone = "nominal" if data.details.before == "nominal" else "before"
    return {
        "first": first,
        "fit": _fit(data.diagnosis),
        "traces": [(trace, *plots.trace(trace)) for trace in data.details.traces[:MOST_TRACES]],
        "laws": [plots.law(m["law"]) if m.get("law") else None for m in data.diagnosis.get("missing") or []],
        "maps": [(mismatch, plots.mismatch_map(mismatch, first)) for mismatch in data.details.maps[:MOST_MAPS]],
        "residuals": [
            (residual, *plots.residual(residual, first)) for residual in data.details.residuals[:MOST_RESIDUALS]
        ],
        "not_drawn": {
            "traces": data.details.traces[MOST_TRACES:],
            "maps": data.details.maps[MOST_MAPS:],
            "residuals": data.details.residuals[MOST_RESIDUALS:],
        },
        "candidates": shown,
        "candidates_left": len(left),
        "left_out_ruled_out": all(c.status == "ruled out" for c in left),
        "screened": screened,
        "difference": _difference(data.details.difference),
    }


# ----------------------------------------------------------------------------------------------------------- sections


def _fit(diagnosis: Mapping[str, Any]) -> dict[str, Any]:
    """Bars of the held-out error: label, value, width in percent; the floor's place; errors of comparison windows."""
    fit = diagnosis.get("fit") or {}
    held_out, floor = fit.get("held_out") or {}, fit.get("noise_floor")
    labels = {
        "nominal": "The model as given",
        "recalibrated": "Its parameters refitted",
        "improved": "With the missing physics",
    }
    if all(m["effect"] == "unknown" and not m.get("law") for m in diagnosis.get("missing") or []):
        del labels["improved"]
    known = {k: held_out[k] for k in labels if held_out.get(k) is not None and math.isfinite(held_out[k])}
    written, as_given = fit.get("as_written"), (fit.get("held_out_in_noise") or {}).get("nominal")
    if written and as_given and written["held_out_in_noise"].get("improved") is not None:
        labels["written"] = f"improved.xml at its own step, {1e3 * written['timestep']:g} ms"
        known["written"] = written["held_out_in_noise"]["improved"] / as_given
    comparison = fit.get("comparison") or {}
    full = max([*known.values(), floor or 0.0, 1e-12]) * 1.02
    return {
        "bars": [{"key": k, "label": labels[k], "value": v, "width": 100 * v / full} for k, v in known.items()],
        "unseen": not fit.get("held_out_was_fitted"),
        "floor": floor,
        "floor_at": None if floor is None else 100 * floor / full,
        "first": known.get("nominal"),
        "last": next((known[k] for k in ("improved", "recalibrated", "nominal") if k in known), None),
        "comparison": [(labels[k], comparison[k]) for k in labels if comparison.get(k) is not None],
        "sensors": [
            {
                "name": name,
                "unit": scaled(0.0, one["unit"])[1],
                "rows": _sensor(one),
                "noise": _as_measured(one["noise"], one["unit"]),
            }
            for name, one in (fit.get("held_out_by_sensor") or {}).items()
        ],
    }


def _sensor(one: Mapping[str, Any]) -> list[tuple[str, float | None, float | None]]:
    """Column, error in the unit people measure by, and its share of the motion, of each model."""
    columns = (("As given", "nominal"), ("Refitted", "recalibrated"), ("Improved", "improved"))
    return [
        (column, _as_measured(one["error"].get(key), one["unit"]), one["share_of_motion"].get(key))
        for column, key in columns
    ]


def _as_measured(value: float | None, unit: str) -> float | None:
    """In the unit that people measure by; None of a prediction that diverged, or of a sensor that never changes."""
    return None if value is None else scaled(value, unit)[0]


def _candidates(
    rows: Sequence[Candidate],
) -> tuple[list[tuple[Candidate, dict[str, float]]], list[Candidate], list[Candidate]]:
    """Rows, as they are sorted, each with the places of its interval; those left out; those only screened."""
    fitted = [c for c in rows if c.status != "screened out"]
    ends = [0.0]
    for c in fitted:
        if c.improvement is not None and math.isfinite(c.improvement):
            margin = 2 * (c.standard_error or 0.0)
            ends += [c.improvement - margin, c.improvement + margin]
    low, high = min(ends), max(max(ends), 1e-9)
    low, high = low - 0.04 * (high - low), high + 0.04 * (high - low)

    def place(value: float) -> float:
        return 100 * min(max((value - low) / (high - low), 0.0), 1.0)

    found = []
    for c in fitted[:MOST_CANDIDATES]:
        at = {"zero": place(0.0)}
        if c.improvement is not None and math.isfinite(c.improvement):
            margin = 2 * (c.standard_error or 0.0)
            left = place(c.improvement - margin)
            at |= {"middle": place(c.improvement), "left": left, "width": place(c.improvement + margin) - left}
        found.append((c, at))
    return found, fitted[MOST_CANDIDATES:], [c for c in rows if c.status == "screened out"]


def _difference(text: str) -> list[tuple[str, str]]:
    """Lines with what they are: file, hunk, add, remove or same."""
    kinds = (("---", "file"), ("+++", "file"), ("@@", "hunk"), ("+", "add"), ("-", "remove"))
    lines = text.splitlines()
    found = [(next((k for mark, k in kinds if line.startswith(mark)), "same"), line) for line in lines[:MOST_LINES]]
    if len(lines) > MOST_LINES:
        found.append(("hunk", f"… {len(lines) - MOST_LINES} more lines; compare the two files"))
    return found
