"""The blind trial's scores as a table, as JSON and as a figure."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dipc_gym.drawing import style
from dipc_gym.safety.files import finite, whole, write_json, write_whole

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def write_report(out: Path, scores: Mapping[str, Any], *, seed: int) -> None:
    """Write `report.md`, `report.json` and, if anything was judged, `report.png`, `report.pdf` and
    `report-narrow.pdf` into `out`.

    Args:
        out: folder.
        scores: from `dipc_gym.trials.score.score`.
        seed: of the trials, for the record.
    """
    write_json(out / "report.json", finite({"seed": seed, **scores}))
    write_whole(out / "report.md", markdown(scores, seed=seed).encode())
    if scores["trials"]:
        for width, end, points in style.SIZES:
            with style.text(points), whole(out / f"report{end}") as file:
                style.write(figure(scores, width), file, end.rpartition(".")[2])


def _share(rate: Mapping[str, Any]) -> str:
    if not rate["of"]:
        return "none"
    return f"{100 * rate['rate']:.0f} % ({rate['right']} of {rate['of']})"


def _percent(quartiles: Mapping[str, Any]) -> str:
    if not quartiles["of"]:
        return "none"
    low, median, high = (f"{100 * quartiles[key]:.0f}" for key in ("low", "median", "high"))
    return f"{median} % ({low} to {high}, {quartiles['of']} trials)"


def _times(quartiles: Mapping[str, Any]) -> str:
    if not quartiles["of"]:
        return "none"
    low, median, high = (f"{quartiles[key]:.3g}" for key in ("low", "median", "high"))
    return f"{median} ({low} to {high}, {quartiles['of']} trials)"


def markdown(scores: Mapping[str, Any], *, seed: int) -> str:
    """Tables of the report, `report.md`.

    Args:
        scores: from `dipc_gym.trials.score.score`.
        seed: of the trials.
    """
    s = scores["summary"]
    routes = ", ".join(f"{count} by {route}" for route, count in s["routes"].items() if count)
    alarms = "none"
    if s["nulls"]:
        alarms = f"{s['false_alarms']} of {s['nulls']} (95 % upper bound {100 * s['false_alarms_upper_95']:.1f} %)"
    seconds = ", ".join(
        f"{rig} {value['median']:.0f} ({value['most']:.0f})" for rig, value in s["seconds"].items() if value["most"]
    )
    lines = [
        f"Blind trial, seed {seed}: {s['trials']} trials, {len(s['failed'])} failed "
        f"({len(s['timed_out'])} of them out of time), {len(s['broken'])} with a stage that failed inside, "
        f"{scores['open']} open; {len(s['unreplayed'])} with a model that replay refuses; "
        f"{s['seconds_total'] / 3600:.2f} h of diagnosis in all.",
        "",
        f"| {s['clear']} trials in which the hidden moves the held-out prediction by twice the noise or more | |",
        "|---|---|",
        f"| right name first | {_share(s['name'])}{f': {routes}' if routes else ''} |",
        f"| right set | {_share(s['set'])} |",
        f"| right place | {_share(s['place'])} |",
        f"| held-out error reached, median (quartiles) | {_percent(s['reached'])} |",
        f"| the same at the file's own time step | {_percent(s['reached_own_step'])} |",
        f"| held-out error of 1.5 times the noise or less | {_share(s['close'])} |",
        f"| the same in windows that go no further than the fitted recordings | {_share(s['close_within'])} |",
        "| **other questions** | |",
        f"| false alarms where nothing is missing | {alarms} |",
        f"| right parameters called wrong there | {s['nulls_renumbered']} of {s['nulls']} |",
        f"| wrong parameters called just that | {_share(s['wrong_numbers'])} |",
        f"| unknown physics of twice the noise or more called unknown | {_share(s['unknown'])} |",
        f"| unknown physics given a known name | {_share(s['unknown_misnamed'])} |",
        f"| drag that thins exponentially said to be that, its length to a tenth | {_share(s['formula'])} |",
        f"| effects with a name beside a law, named | {_share(s['beside'])} |",
        f"| held-out error of unknown physics, times the noise, median (quartiles) | {_times(s['unknown_error'])} |",
        f"| the same in windows that go no further | {_times(s['unknown_error_within'])} |",
        f"| 90 % intervals that cover the truth | {_share(s['interval_coverage'])} |",
        f"| intervals printed, of parameters of effects named right | {_share(s['intervals_printed'])} |",
        f"| right name first, all sizes | {_share(s['name_all_sizes'])} |",
        f"| seconds a trial, median (most) | {seconds or 'none'} |",
    ]
    lines += _sizes("size (noise = 1)", scores["by_size"], 1.0, "")
    lines += _sizes("size (share of signal)", scores["by_share"], 100.0, " %")
    confusion = scores["confusion"]
    columns = sorted({name for row in confusion.values() for name in row})
    lines += ["", "| truth, said first | " + " | ".join(columns) + " |", "|---" * (len(columns) + 1) + "|"]
    for truth in sorted(confusion):
        cells = " | ".join(str(confusion[truth].get(name, "")) for name in columns)
        lines.append(f"| {truth} | {cells} |")
    wrong = [t for t in scores["trials"] if _amiss(t)]
    if wrong:
        lines += ["", "| not right | truth | size | said | verdict |", "|---|---|---|---|---|"]
        lines += [
            f"| {t['trial']}{' (tuned)' if t['tuned'] else ''} | {', '.join(t['truth']) or t['kind']} "
            f"| {t['size']:.3g} | {', '.join(t['said']) or '-'} | {t['verdict']} |"
            for t in wrong
        ]
    return "\n".join(lines) + "\n"


def _amiss(trial: Mapping[str, Any]) -> bool:
    """Whether a trial is worth a look: a wrong name, an alarm, an unknown that was missed or misnamed, a failure."""
    wrong = trial["name"] is False or trial["alarm"] or trial["unknown"] is False or trial["misnamed"]
    return bool(wrong or trial["broken"]) or trial["verdict"] == "failed"


def _sizes(title: str, rows: Sequence[Mapping[str, Any]], scale: float, unit: str) -> list[str]:
    lines = ["", f"| {title} | trials | right name first | right set | right place | error reached |", "|---" * 6 + "|"]
    for row in rows:
        low = f"{scale * row['low']:g}"
        size = f"{low} to {scale * row['high']:g}{unit}" if row["high"] else f"over {low}{unit}"
        lines.append(
            f"| {size} | {row['trials']} | {_share(row['name'])} | {_share(row['set'])} | {_share(row['place'])} "
            f"| {_percent(row['reached'])} |"
        )
    return lines


def figure(scores: Mapping[str, Any], width: float = style.WIDE) -> Figure:
    """Naming rate against effect size, and the confusion matrix; one above the other where the figure is narrow.

    Args:
        scores: from `dipc_gym.trials.score.score`.
        width: inches.
    """
    from matplotlib.figure import Figure

    confusion = scores["confusion"]
    rows = sorted(confusion)
    columns = sorted({name for row in confusion.values() for name in row})
    narrow = width <= style.NARROW
    tall = max(1.0, 0.11 * len(rows)) + 1.4  # inches of the matrix with its names
    canvas = Figure(figsize=(width, tall + 2.0 if narrow else max(3.2, tall)), layout="constrained")
    if narrow:
        left, right = canvas.subplots(2, 1, height_ratios=(1.9, tall))
    else:
        left, right = canvas.subplots(1, 2, width_ratios=(1, 1.6))
    small = 4.0 if narrow else 5.0  # points
    marks = {
        "name": ("right name first", "o-", style.BLUE),
        "set": ("right set", "s--", style.VERMILION),
        "place": ("right place", "^:", style.GREEN),
    }
    filled = [row for row in scores["by_size"] if row["trials"]]
    for key, (label, line, colour) in marks.items():
        known = [row for row in filled if row[key]["of"]]
        centres = [math.sqrt(max(row["low"], 0.3) * (row["high"] or 5 * row["low"])) for row in known]
        left.plot(centres, [100 * row[key]["rate"] for row in known], line, color=colour, ms=3, label=label)
    left.set(xscale="log", ylim=(-5, 105), xlabel="effect size (noise standard deviations)", ylabel="%")
    left.axvline(2.0, color=style.GREY, linewidth=0.8)
    left.legend(loc="lower right")
    if not rows:  # no trial of a single effect was judged
        right.set_axis_off()
        return canvas
    counts = np.array([[confusion[truth].get(name, 0) for name in columns] for truth in rows], dtype=float)
    shares = counts / counts.sum(axis=1, keepdims=True)
    right.imshow(shares, cmap="Blues", vmin=0, vmax=1, aspect="auto")
    right.set_xticks(range(len(columns)), columns, rotation=90, fontsize=small)
    right.set_yticks(range(len(rows)), rows, fontsize=small)
    right.set(xlabel="said first", ylabel="truth")
    for i, j in zip(*np.nonzero(counts), strict=True):
        ink = "white" if shares[i, j] > 0.5 else "black"
        right.text(j, i, f"{counts[i, j]:.0f}", ha="center", va="center", fontsize=small, color=ink)
    return canvas
