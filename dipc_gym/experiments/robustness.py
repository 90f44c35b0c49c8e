"""How far a pair of controller and compensator holds when the rig is no longer the one that it was trained on."""

from __future__ import annotations

import contextlib
import dataclasses
import itertools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from dipc_gym.experiments import cells
from dipc_gym.experiments.cells import Balancing
from dipc_gym.plant import Plant, PlantError
from dipc_gym.runs import Impulse
from dipc_gym.safety import intact
from dipc_gym.safety.naming import suggestion
from dipc_gym.sweep import Outcome

SCHEMA = "dipc-gym/robustness/1"
SECONDS = 20.0  # of a run; where pairs fall, they fall within the first few


@dataclass(frozen=True)
class Axis:
    """One way in which a rig is made worse.

    Attributes:
        label: what tables and figures call it, with its unit.
        values: those that are tried, from smallest to largest, `usual` among them.
        part: field of the plant that has the numbers; None for the plant itself.
        scaled: the numbers that are multiplied by a value.
        usual: the value that the rig has.
    """

    label: str
    values: tuple[float, ...]
    part: Literal["friction", "encoders"] | None = None
    scaled: tuple[str, ...] = ()
    usual: float = 1.0

    def rig(self, plant: Plant, value: float) -> Plant:
        """The changed rig.

        Raises:
            PlantError: the rig does not say what would have to change.
        """
        old: Any = plant if self.part is None else getattr(plant, self.part)
        if old is None:
            raise PlantError(
                "the axis friction needs a rig whose friction is a LuGre <dcmotor name='friction'>; leave it out, as "
                f"in --robustness {','.join(name for name in AXES if name != 'friction')}"
            )
        new = dataclasses.replace(old, **{name: getattr(old, name) * value for name in self.scaled})
        return new if self.part is None else dataclasses.replace(plant, **{self.part: new})

    def possible(self, plant: Plant) -> tuple[float, ...]:
        """Those of the values that a plant can have: twenty times a long control period is none.

        Example:
            >>> from dipc_gym.plant import Plant
            >>> AXES["period"].possible(Plant(control_period=0.1))[-1]
            10.0
        """
        found = []
        for value in self.values:
            with contextlib.suppress(PlantError):
                self.rig(plant, value)
                found.append(value)
        return tuple(found)

    def between(self, holds: Mapping[float, bool]) -> tuple[float, float] | None:
        """First and last of the values around the usual one at which it holds without a gap; None: not even there.

        Example:
            >>> AXES["impulse"].between({0.0: True, 2.0: True, 4.0: False, 6.0: True})
            (0.0, 2.0)
        """
        if not holds.get(self.usual):
            return None
        above = itertools.takewhile(holds.__getitem__, sorted(v for v in holds if v >= self.usual))
        below = itertools.takewhile(holds.__getitem__, sorted((v for v in holds if v <= self.usual), reverse=True))
        return min(below), max(above)


AXES = {
    "friction": Axis(
        label="dry friction, times that of training",
        values=(0.25, 0.35, 0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 3.4, 4.0, 4.8, 5.7, 6.7, 8.0),
        part="friction",
        scaled=("coulomb", "static"),
    ),
    "encoder": Axis(
        label="encoder step, times the rig's",
        values=(0.5, 1.0, 2.0, 2.8, 4.0, 4.8, 5.7, 6.7, 8.0, 9.5, 11.3, 13.5, 16.0),
        part="encoders",
        scaled=("cart", "pole"),
    ),
    "period": Axis(
        label="control period, times the rig's",
        values=(1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0, 12.0, 14.0, 16.0, 20.0),
        scaled=("control_period",),
    ),
    "supply": Axis(
        label="supply voltage, times the rig's",
        values=(0.12, 0.15, 0.18, 0.21, 0.25, 0.3, 0.35, 0.42, 0.5, 0.7, 1.0, 1.5),
        scaled=("supply",),
    ),
    "impulse": Axis(
        label="impulse on the cart, N s",
        values=(0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0),
        usual=0.0,
    ),
}
"""Coulomb and static friction together; counts and their noise together; a blow a quarter through the run."""


@dataclass(frozen=True, kw_only=True)
class Endurance:
    """One pair on one rig along one axis; the controller and the compensator know nothing of the change.

    Attributes:
        balancing: the pair, the rig that it was trained on, and the length of a run.
        axis: name of one of `AXES`.
        values: along it.
    """

    balancing: Balancing
    axis: str
    values: tuple[float, ...]

    @property
    def name(self) -> str:
        """Of its file."""
        return f"{self.balancing.name}-{self.axis}"

    def run(self) -> list[dict[str, Any]]:
        """Balance at every value; one dictionary for each, as `cells.figures` gives it, with its value."""
        axis, seconds = AXES[self.axis], self.balancing.seconds
        rows = []
        for value in self.values:
            plant = axis.rig(self.balancing.plant, value)
            impulse = Impulse(value, seconds / 4) if self.axis == "impulse" else None
            course, _ = self.balancing.course(plant, impulse)
            rows.append({"value": value, **cells.figures(course, plant, seconds)})
        return rows

    def check(self, result: Any) -> None:
        """Refuse what are no such runs along this axis."""
        intact.fit(result, [{"value": float, **cells.FIGURES}])
        for row in result:
            cells.check_figures(row)
        if [row["value"] for row in result] != list(self.values):
            raise ValueError(f"is not of the {len(self.values)} values along the axis {self.axis}")


def check(names: Iterable[str], plant: Plant) -> None:
    """Refuse axes that are not there or that a rig cannot be changed along.

    Raises:
        ValueError: an unknown name; the message lists those that there are.
        PlantError: the rig does not say what would have to change.
    """
    for name in names:
        if name not in AXES:
            raise ValueError(
                f"there is no robustness axis {name!r}; there are {', '.join(AXES)}, all for all of them, and score"
                f"{suggestion(name, (*AXES, 'all', 'score'))}"
            )
        AXES[name].rig(plant, AXES[name].usual)


def plan(balancings: Sequence[Balancing], axes: Sequence[str]) -> list[Endurance]:
    """The cells: every balancing along every axis, in shorter runs."""
    return [
        Endurance(
            balancing=dataclasses.replace(balancing, seconds=min(balancing.seconds, SECONDS)),
            axis=axis,
            values=AXES[axis].possible(balancing.plant),
        )
        for balancing in balancings
        for axis in axes
    ]


def summarise(
    cells: Sequence[Endurance], outcomes: Iterable[Outcome[Any]], pairs: Sequence[tuple[str, str]]
) -> dict[str, Any]:
    """How far each pair holds along each axis, over the rigs.

    Args:
        cells: all that were asked for.
        outcomes: those that were finished; others than of `Endurance` are passed over.
        pairs: controllers and compensators in the order of the table.

    Returns:
        What `robustness.json` holds. In a row, `every` and `half` are the first and the last value around the usual one
        at which every rig, or at least half of them, stood without a gap between; None if not even at the usual one.
    """
    done = [o for o in outcomes if isinstance(o.cell, Endurance)]
    rows = []
    for pair in pairs:
        for name in dict.fromkeys(cell.axis for cell in cells):
            mine = [o for o in done if o.cell.axis == name and _pair(o.cell) == pair]
            if mine:
                rows.append(_row(pair, name, mine))
    return {
        "schema": SCHEMA,
        "rows": rows,
        "axes": {name: {"label": axis.label, "usual": axis.usual} for name, axis in AXES.items()},
        "seconds": cells[0].balancing.seconds if cells else None,
    }


def _pair(cell: Endurance) -> tuple[str, str]:
    return cell.balancing.brain, cells.label(cell.balancing.compensator)


def _row(pair: tuple[str, str], name: str, outcomes: Sequence[Outcome[Any]]) -> dict[str, Any]:
    axis, steps = AXES[name], []
    for value in outcomes[0].cell.values:
        runs = [run for outcome in outcomes for run in outcome.result if run["value"] == value]
        stood = [run for run in runs if run["survived"]]
        step: dict[str, Any] = {"value": value, "rigs": len(runs), "stood": len(stood)}
        for key in ("cart_m", "pole1_deg", "pole2_deg", "force_rms"):
            spread = np.percentile([run[key] for run in stood], [10, 50, 90]).tolist() if stood else None
            step[key] = None if spread is None else dict(zip(("low", "median", "high"), spread, strict=True))
        steps.append(step)
    held = {step["value"]: step["stood"] / step["rigs"] for step in steps}
    return {
        "controller": pair[0],
        "compensator": pair[1],
        "axis": name,
        "rigs": len(outcomes),
        "every": axis.between({value: share == 1 for value, share in held.items()}),
        "half": axis.between({value: share >= 0.5 for value, share in held.items()}),
        "steps": steps,
    }


def table(summary: Mapping[str, Any]) -> str:
    """How far each pair holds, as text: on every rig, and below it on half of them."""
    rows = summary["rows"]
    axes = list(dict.fromkeys(row["axis"] for row in rows))
    lines: list[tuple[str, ...]] = [("controller", "compensator", "holds on", *axes)]
    for pair in dict.fromkeys((row["controller"], row["compensator"]) for row in rows):
        mine = {row["axis"]: row for row in rows if (row["controller"], row["compensator"]) == pair}
        most = max(row["rigs"] for row in mine.values())
        for key, head in (("every", (*pair, f"all {most} rigs")), ("half", ("", "", "half"))):
            lines.append((*head, *(_range(mine[a], key) if a in mine else "-" for a in axes)))
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    text = ["  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip() for line in lines]
    text.insert(1, "-" * max(map(len, text)))
    text += [f"{name}: {summary['axes'][name]['label']}" for name in axes]
    text.append(
        f"runs of {summary['seconds']:g} s; ≤ and ≥ where it held as far as was tried; x: not on the rig as it is"
    )
    return "\n".join(text)


def _range(row: Mapping[str, Any], key: str) -> str:
    """Such as `0.5..≥5.6`; only the far end on an axis that has one."""
    tried = [step["value"] for step in row["steps"]]
    if row[key] is None:
        return "x"
    low, high = row[key]
    first, last = f"{'≤' if low == tried[0] else ''}{low:g}", f"{'≥' if high == tried[-1] else ''}{high:g}"
    return last if AXES[row["axis"]].usual == tried[0] else f"{first}..{last}"


def draw(summary: Mapping[str, Any], folder: Path) -> None:
    """Write the figure as `robustness.png`, `robustness.pdf` and `robustness-narrow.pdf`; see `figures.write`."""
    from dipc_gym.experiments import figures

    figures.write(lambda width: figures.robustness(summary, width), folder / "robustness")
