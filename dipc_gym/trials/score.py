"""Open the sealed answers, grade every trial, and sum up."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from dipc_gym.trials.grade import Grade
from dipc_gym.trials.records import graded

SIZES = (0.0, 1.0, 2.0, 5.0, 20.0, 100.0, math.inf)
"""Edges of effect size: change of the held-out prediction in noise standard deviations."""
CLOSE = 1.5
"""Times the noise: a held-out error up to which a law is as good as right."""
SHARES = (0.0, 0.001, 0.003, 0.01, 0.03, 0.1, math.inf)
"""Edges of the same as a share of the signal."""


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
        `summary`, `by_size`, `by_share`, `confusion` and `trials`, ready for JSON.

    Raises:
        DamagedError: an answer or an attempt is not what was written.
    """
    tried = [name for name in names if (out / "results" / name / "attempt.json").exists()]
    judged = [graded(out, name) for name in tried]
    return {"open": len(names) - len(judged), **summarise(judged)}


def _rate(values: Sequence[bool | None]) -> dict[str, float | int | None]:
    known = [bool(v) for v in values if v is not None]
    return {"right": sum(known), "of": len(known), "rate": sum(known) / len(known) if known else None}


def summarise(judged: Sequence[Grade]) -> dict[str, Any]:
    """Rates, quantiles, the confusion matrix and the single judgements."""
    hidden = [j for j in judged if j.kind in ("single", "pair")]
    clear = [j for j in hidden if j.clear]
    nulls = [j for j in judged if j.kind == "null" and j.alarm is not None]
    unknown = [j for j in judged if j.kind == "unknown"]
    alarms = sum(bool(j.alarm) for j in nulls)
    inside, printed, known = (sum(getattr(j, name) for j in judged) for name in ("inside", "printed", "parameters"))
    summary = {
        "trials": len(judged),
        "failed": [j.trial for j in judged if j.verdict == "failed"],
        "timed_out": [j.trial for j in judged if j.timed_out],
        "broken": [j.trial for j in judged if j.broken],
        "unreplayed": [j.trial for j in judged if j.verdict != "failed" and j.error is None],
        "clear": len(clear),
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
        "unknown": _rate([j.unknown for j in unknown if j.clear]),
        "unknown_misnamed": _rate([j.misnamed for j in unknown]),
        "formula": _rate([j.formula for j in judged]),
        "beside": _rate([j.beside for j in judged]),
        # A tool that failed, or wrote what cannot be replayed, is not close; some windows all lie beyond what was seen.
        "close": _rate([j.error is not None and j.error <= CLOSE for j in clear]),
        "close_within": _rate(
            [
                j.error_within is not None and j.error_within <= CLOSE
                for j in clear
                if j.error is None or j.error_within is not None
            ]
        ),
        "unknown_error": _quartiles([j.error for j in unknown if j.clear]),
        "unknown_error_within": _quartiles([j.error_within for j in unknown if j.clear]),
        "reached": _quartiles([j.reached for j in clear]),
        "reached_own_step": _quartiles([j.reached_own_step for j in clear]),
        "interval_coverage": _rate([k < inside for k in range(printed)]),
        "intervals_printed": _rate([k < printed for k in range(known)]),
        "seconds": {rig: _seconds([j for j in judged if j.rig == rig]) for rig in sorted({j.rig for j in judged})},
        "seconds_total": sum(j.seconds for j in judged if math.isfinite(j.seconds)),
    }
    confusion: dict[str, dict[str, int]] = {}
    for j in judged:
        if j.kind != "pair":
            row = confusion.setdefault(j.truth[0] if j.truth else f"({j.kind})", {})
            column = j.said[0] if j.said else f"({j.verdict})"
            row[column] = row.get(column, 0) + 1
    return {
        "summary": summary,
        "by_size": _binned(hidden, SIZES, lambda j: j.size),
        "by_share": _binned(hidden, SHARES, lambda j: j.share),
        "confusion": confusion,
        "trials": [asdict(j) for j in judged],
    }


def _binned(judged: Sequence[Grade], edges: Sequence[float], key: Callable[[Grade], float]) -> list[dict[str, Any]]:
    rows = []
    for low, high in itertools.pairwise(edges):
        some = [j for j in judged if low <= key(j) < high]
        rows.append(
            {
                "low": low,
                "high": high if math.isfinite(high) else None,
                "trials": len(some),
                "name": _rate([j.name for j in some]),
                "set": _rate([j.set for j in some]),
                "place": _rate([j.place for j in some]),
                "reached": _quartiles([j.reached for j in some]),
            }
        )
    return rows


def _quartiles(values: Sequence[float | None]) -> dict[str, float | int | None]:
    known = [v for v in values if v is not None]
    low, median, high = np.quantile(known, [0.25, 0.5, 0.75]).tolist() if known else (None, None, None)
    return {"median": median, "low": low, "high": high, "of": len(known)}


def _seconds(judged: Sequence[Grade]) -> dict[str, float | None]:
    known = [j.seconds for j in judged if math.isfinite(j.seconds)]
    return {"median": float(np.median(known)) if known else None, "most": max(known, default=None)}
