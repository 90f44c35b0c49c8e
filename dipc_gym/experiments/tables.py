"""Medians and spreads of a comparison, and the paper's Table 2 beside them."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy import stats

from dipc_gym.controllers import lqr
from dipc_gym.provenance import versions

SCHEMA = "dipc-gym/compare/1"

PAPER_SECONDS = 80.0  # length of the paper's runs; costs of shorter ones are sums over less

# Table 2 of the paper: largest deviations of cart (m) and poles (degrees), cost.
PAPER = {
    "none": {"cart_m": 0.045, "pole1_deg": 5.0, "pole2_deg": 3.0, "cost": 9.49e6},
    "mlp": {"cart_m": 0.04, "pole1_deg": 2.0, "pole2_deg": 1.5, "cost": 6.74e6},
    "llnf": {"cart_m": 0.02, "pole1_deg": 1.0, "pole2_deg": 0.6, "cost": 4.93e6},
}


def summarise(
    settings: Mapping[str, Any],
    wanted: Sequence[tuple[str, str]],
    cells: Sequence[Mapping[str, Any]],
    notes: Sequence[str],
    complete: bool,
    failures: Mapping[str, str] | None = None,
) -> dict[str, Any]:
    """Medians and spreads over the seeds; costs and deviations are those of runs that did not fall.

    Args:
        settings: of the comparison, as plain numbers and strings.
        wanted: controllers and compensators in the order of the table.
        cells: what finished runs gave, as `cells/*.json` holds it.
        notes: what else the reader should know.
        complete: whether all runs were finished.
        failures: what went wrong, by the name of the cell.
    """
    rows = []
    pairs = dict.fromkeys((cell["controller"], cell["compensator"]) for cell in cells)
    for pair in (pair for pair in wanted if pair in pairs):
        mine = [cell for cell in cells if (cell["controller"], cell["compensator"]) == pair]
        stood = [cell for cell in mine if cell["survived"]]
        errors = [cell["test_mse"] for cell in mine if cell["test_mse"] is not None]
        row: dict[str, Any] = {"controller": pair[0], "compensator": pair[1], "seeds": len(mine)}
        row["trained_with"] = mine[0]["trained_with"]
        row["survived"] = len(stood)
        row["fell_after_s"] = _spread([cell["seconds"] for cell in mine if not cell["survived"]])
        for key in ("cost", "cost_printed_q", "cart_m", "pole1_deg", "pole2_deg", "force_rms", "voltage_rms"):
            row[key] = _spread([cell[key] for cell in stood])
        row["test_mse"] = float(np.median(errors)) if errors else None
        row["parameters"] = round(float(np.median([cell["parameters"] for cell in mine])))
        rows.append(row)
    outside = sorted({cell["compensator"] for cell in cells if cell["notes"]})
    if outside:
        notes = [*notes, f"asked far outside their training range in some runs: {', '.join(outside)}"]
    return {
        "schema": SCHEMA,
        "complete": complete,
        "failures": dict(failures or {}),
        "rows": rows,
        "rig_by_rig": _rig_by_rig(cells, wanted),
        "against_first": against_first(cells, wanted),
        "paper": PAPER if settings.get("seconds") == PAPER_SECONDS else {},
        "cost_is": "sum over control periods of x'Qx + F^2, x the simulated state, F the commanded force (N)",
        "Q": np.diag(lqr.RECOVERED_Q).tolist(),
        "printed_Q": np.diag(lqr.PRINTED_Q).tolist(),
        "settings": dict(settings),
        "notes": list(notes),
        "versions": versions("mujoco", "gymnasium", "numpy"),
    }


def _rig_by_rig(cells: Sequence[Mapping[str, Any]], wanted: Sequence[tuple[str, str]]) -> list[dict[str, Any]]:
    """Each compensator's cost over that of the one before it, on the same rig: rigs differ more than compensators."""
    costs = {(c["controller"], c["compensator"], c["seed"]): c["cost"] for c in cells if c["survived"]}
    pairs = []
    for (controller, before), (same, after) in itertools.pairwise(wanted):
        rigs = [s for c, name, s in costs if (c, name) == (same, after) and (controller, before, s) in costs]
        if controller == same and rigs:
            ratios = [costs[same, after, s] / costs[same, before, s] for s in rigs]
            pair = {"controller": same, "compensator": after, "than": before, "cost_ratio": _spread(ratios)}
            pairs.append({**pair, "less_on": sum(ratio < 1 for ratio in ratios), "rigs": len(rigs)})
    return pairs


def against_first(
    cells: Sequence[Mapping[str, Any]], wanted: Sequence[tuple[str, str]], of: str = "cost"
) -> list[dict[str, Any]]:
    """Each pair's cost over that of the first pair on the same rig: geometric mean, and its 95 % interval.

    Costs differ by factors, so their logarithms are compared: a t interval for the mean of the differences over rigs on
    which both stood. Without two such rigs there is none.

    Args:
        cells: what runs gave, with their controller, compensator and seed.
        wanted: controllers and compensators; the first is what the others are compared with.
        of: what is compared, a positive number of every cell; with it begins the name of the ratio.
    """
    sizes = {(c["controller"], c["compensator"], c["seed"]): c[of] for c in cells if c["survived"]}
    found = []
    for pair in wanted[1:]:
        seeds = [seed for *names, seed in sizes if tuple(names) == pair and (*wanted[0], seed) in sizes]
        if len(seeds) < 2:
            continue
        logs = np.log([sizes[(*pair, seed)] / sizes[(*wanted[0], seed)] for seed in seeds])
        half = float(stats.t.ppf(0.975, len(logs) - 1) * logs.std(ddof=1) / np.sqrt(len(logs)))
        ratio, low, high = np.exp([logs.mean(), logs.mean() - half, logs.mean() + half]).tolist()
        row = {"controller": pair[0], "compensator": pair[1], "than": list(wanted[0]), f"{of}_ratio": ratio}
        found.append({**row, "low": low, "high": high, "rigs": len(logs), "less_on": int((logs < 0).sum())})
    return found


def table(summary: Mapping[str, Any]) -> str:
    """Ours as text: medians, below them 10th and 90th percentile, and the paper's Table 2 if runs are as long."""
    lines: list[tuple[str, ...]] = [_HEAD]
    for row in summary["rows"]:
        columns = [(row[key], form) for key, form in _FORMATS.items()]
        mse = "-" if row["test_mse"] is None else f"{row['test_mse']:.3g}"
        lines.append(
            (
                row["controller"],
                row["compensator"] + ("*" if row["trained_with"] else ""),
                f"{row['survived']}/{row['seeds']}",
                *("-" if c is None else format(c["median"], form) for c, form in columns),
                mse,
                str(row["parameters"]),
            )
        )
        spread = ("" if c is None else f"{c['low']:{form}}..{c['high']:{form}}" for c, form in columns)
        lines.append(("", "", "", *spread, "", ""))
        paper = summary["paper"].get(row["compensator"]) if row["controller"] == "lqr" else None
        if paper:
            lines.append(
                (
                    "",
                    "  paper",
                    "",
                    *(format(paper[key], form) if key in paper else "" for key, form in _FORMATS.items()),
                    "",
                    "",
                )
            )
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    text = ["  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip() for line in lines]
    text.insert(1, "-" * len(text[0]))
    text += [
        f"{row['controller']}, {row['compensator']}: {row['seeds'] - row['survived']} fell, after "
        f"{row['fell_after_s']['median']:.2f} s in the median"
        for row in summary["rows"]
        if row["fell_after_s"]
    ]
    text += [
        f"rig by rig, {pair['controller']}: {pair['compensator']} costs {pair['cost_ratio']['median']:.2f} times what "
        f"{pair['than']} costs, less on {pair['less_on']} of {pair['rigs']} rigs"
        for pair in summary["rig_by_rig"]
    ]
    text += [
        f"against {', '.join(row['than'])}: {row['controller']}, {row['compensator']} costs {row['cost_ratio']:.3g} "
        f"times as much ({row['low']:.3g} to {row['high']:.3g}, 95 %), less on {row['less_on']} of {row['rigs']} rigs"
        for row in summary["against_first"]
    ]
    others = {row["controller"]: row["trained_with"] for row in summary["rows"] if row["trained_with"]}
    text += [f"* {name} was trained with {own}, not with this" for name, own in others.items()]
    text += [f"failed: {name}: {why}" for name, why in summary["failures"].items()]
    if not summary["complete"]:
        text.append("interrupted: this is what was finished")
    return "\n".join([*text, *(f"note: {note}" for note in summary["notes"])])


_HEAD = (
    "controller",
    "compensator",
    "stood",
    "cart m",
    "pole 1 deg",
    "pole 2 deg",
    "cost J",
    "printed Q",
    "force N",
    "test MSE",
    "parameters",
)
_FORMATS = {
    "cart_m": ".3f",
    "pole1_deg": ".2f",
    "pole2_deg": ".2f",
    "cost": ".3g",
    "cost_printed_q": ".3g",
    "force_rms": ".1f",
}


def _spread(values: Sequence[float]) -> dict[str, float] | None:
    if not values:
        return None
    low, median, high = np.percentile(values, [10, 50, 90]).tolist()
    return {"median": median, "low": low, "high": high}
