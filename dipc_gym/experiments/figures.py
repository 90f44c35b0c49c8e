"""Pictures of a comparison: the paper's figures from our data.

Its Figs. 7 to 10 and 12 have a counterpart. Fig. 11 has none: the text of the paper at hand does not say what it shows.
Every figure is written for the screen (`NAME.png`), for two columns of a journal (`NAME.pdf`, 7 inches wide), and for
one (`NAME-narrow.pdf`, 3.4 inches).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from dipc_gym import compensators
from dipc_gym.compensators import LOLIMOT, Samples
from dipc_gym.drawing import style
from dipc_gym.experiments import film
from dipc_gym.safety.files import whole

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from dipc_gym.runs import Course, Identification

Array = NDArray[np.float64]

MARKERS = ("o", "s", "^", "x")  # of controllers
MOST_MODELS = 30  # of Fig. 9, beyond the point where training stops
STRETCHES = ((9.0, 12.0), (45.0, 46.0))  # s of the identification run that Figs. 8 and 10 show
SWEEP_ZOOM = (28.0, 31.0)  # s, with a block of training between two of test
BALANCE_ZOOM = 6.0  # s at the end of a run, where it has settled
FILMED = ("none", "llnf")


def draw_all(
    identified: Identification,
    trained: Mapping[str, dict[str, Any]],
    courses: Mapping[tuple[str, str], Course],
    out: Path,
    *,
    model: str | None = None,
) -> list[str]:
    """Draw what the first rig of a comparison has data for, into `out`.

    Args:
        identified: its identification run.
        trained: its compensators as dictionaries, by name.
        courses: its balancing runs, by controller and compensator.
        out: folder of the comparison.
        model: MJCF file of the rig; None is the package's.

    Returns:
        What could not be drawn, and why.
    """
    folder = out / "figures"
    data = identified.samples
    time: Array = identified.plant.control_period * np.arange(len(data.force), dtype=np.float64)
    write(lambda width: identification(time, data, width), folder / "fig07_identification")
    for number, name in ((8, "mlp"), (10, "llnf")):
        if name in trained:
            _write_output(time, data, compensators.load(trained[name]), name, folder / f"fig{number:02d}_{name}")
    grown = _grown(data)
    write(lambda width: lolimot_growth(grown, width), folder / "fig09_lolimot")
    controller = next(iter(courses), ("", ""))[0]
    mine = {name: course for (brain, name), course in courses.items() if brain == controller}
    if mine:
        write(lambda width: balancing(controller, mine, width), folder / "fig12_balance")
    if not all(name in mine for name in FILMED):
        return []
    films = [out / "rig.gif", *([out / "rig.mp4"] if film.ffmpeg() else [])]
    try:
        film.shoot({name: mine[name] for name in FILMED}, *films, model=model)
    except Exception as error:  # OpenGL fails in as many ways as there are drivers; the figures do not depend on it
        what = f"{type(error).__name__}: {error}"
        return [f"rig.gif was not drawn ({what}); see 'Drawing fails without a display' in docs/troubleshooting.md"]
    return []


def write(draw: Callable[[float], Figure], stem: Path) -> None:
    """Write a figure as `STEM.png`, `STEM.pdf` and `STEM-narrow.pdf`.

    Args:
        draw: the figure of a width, inches.
        stem: path without suffix.
    """
    for width, end, points in style.SIZES:
        with style.text(points), whole(stem.with_name(stem.name + end)) as file:
            style.write(draw(width), file, end.rpartition(".")[2])


def identification(time: Array, data: Samples, width: float = 7.0) -> Figure:
    """Paper's Fig. 7: the run that compensators are trained on, whole and enlarged.

    Args:
        time: (n,) s.
        data: the run.
        width: inches.
    """
    figure, panels = _grid(3, (2.2, 1.0), (width, 0.66 * width))
    for row, values, label in zip(
        panels, (data.voltage, data.force, data.velocity), ("voltage, V", "force, N", "velocity, m/s"), strict=True
    ):
        for axis, shown in zip(row, (_between(time, 0.0, time[-1]), _between(time, *SWEEP_ZOOM)), strict=True):
            for part, colour, name in ((data.train, style.SKY, "training"), (~data.train, style.ORANGE, "test")):
                axis.plot(time[shown], np.where(part, values, np.nan)[shown], color=colour, lw=0.7, label=name)
        row[0].set_ylabel(label)
    panels[0, 0].set_title("identification run, poles locked", loc="left")
    panels[0, 1].set_title("enlarged", loc="left")
    return _finished(figure, panels, "time, s", 2)


def model_output(time: Array, data: Samples, model: Any, name: str, width: float = 7.0) -> Figure:
    """Paper's Figs. 8 and 10: voltage of the inverse model beside the one applied, and what is between, on test data.

    Args:
        time: (n,) s.
        data: the identification run.
        model: the compensator.
        name: what it is called.
        width: inches.
    """
    output = model.volts(data.force, data.velocity, data.previous_velocity)
    error = output - data.voltage
    mse = float(np.mean(error[~data.train] ** 2))
    figure, panels = _grid(2, (1.0, 1.0), (width, 0.55 * width), heights=(2.0, 1.0))
    tested = np.where(data.train, np.nan, 1.0)
    for column, (start, end) in enumerate(STRETCHES):
        above, below = panels[:, column]
        shown = _between(time, start, end)
        above.plot(time[shown], data.voltage[shown], color=style.GREY, lw=2.2, alpha=0.6, label="applied")
        above.plot(time[shown], (tested * output)[shown], lw=1.0, label=name, **style.of(name).line)
        below.plot(time[shown], (tested * error)[shown], lw=0.8, color=style.of(name).colour)
        below.axhline(0.0, color=style.GREY, lw=0.5)
    panels[0, 0].set_ylabel("voltage, V")
    panels[1, 0].set_ylabel("error, V")
    panels[0, 0].set_title(f"{name.upper()} on test data: mean square error {mse:.3g} V²", loc="left")
    return _finished(figure, panels, "time, s (gaps are training data)", 2)


def lolimot_growth(model: LOLIMOT, width: float = 7.0) -> Figure:
    """Paper's Fig. 9: error over the number of local models, grown beyond the point where training stops.

    Args:
        model: a LOLIMOT with its errors on the way.
        width: inches.
    """
    figure, panels = _grid(1, (1.0,), (width, 0.5 * width))
    axis = panels[0, 0]
    models = np.arange(1, len(model.train_errors_) + 1)
    axis.semilogy(models, model.train_errors_, "o-", color=style.SKY, ms=3, label="training")
    axis.semilogy(models, model.test_errors_, "s--", color=style.ORANGE, ms=3, label="test")
    axis.set_ylabel("mean square error, V²")
    return _finished(figure, panels, "local linear models", 2)


def balancing(controller: str, courses: Mapping[str, Course], width: float = 7.0) -> Figure:
    """Paper's Fig. 12: cart and poles over the whole run, and its end enlarged, without and with compensation.

    Args:
        controller: what commands the force.
        courses: by compensator.
        width: inches.
    """
    figure, panels = _grid(3, (2.2, 1.0), (width, 0.75 * width))
    names = tuple(courses)
    end = max(float(course.time[-1]) for course in courses.values())
    for row, column, scale, label in zip(
        panels, range(3), (1000, 180 / np.pi, 180 / np.pi), ("cart, mm", "pole 1, deg", "pole 2, deg"), strict=True
    ):
        for name, course in courses.items():
            look = style.of(name, names).line
            late = _between(course.time, end - BALANCE_ZOOM, end)
            row[0].plot(course.time, scale * course.state[:, column], lw=0.6, label=name, **look)
            row[1].plot(course.time[late], scale * course.state[late, column], lw=1.0, **look)
        row[0].set_ylabel(label)
    panels[0, 0].set_title(f"balancing under {controller}, one rig", loc="left")
    panels[0, 1].set_title("the end, enlarged", loc="left")
    return _finished(figure, panels, "time, s", 5 if width > style.NARROW else 3)


def robustness(summary: Mapping[str, Any], width: float = 7.0) -> Figure:
    """How far each pair holds along each axis: the share of rigs that stand, and how far the cart strays.

    Colours and dashes are the compensators'; with several controllers, markers are the controllers'. Deviations are
    medians over the rigs that stand, with 10th and 90th percentile, as far as half of the rigs stand; shares are set
    apart by a hundredth, so that none hides another. In one column of a journal, axes stand below each other.

    Args:
        summary: as `robustness.summarise` gives it.
        width: inches.
    """
    from matplotlib.figure import Figure

    rows = summary["rows"]
    axes = list(dict.fromkeys(row["axis"] for row in rows))
    controllers = list(dict.fromkeys(row["controller"] for row in rows))
    names = tuple(dict.fromkeys(row["compensator"] for row in rows))
    pairs = list(dict.fromkeys((row["controller"], row["compensator"]) for row in rows))
    narrow = width <= style.NARROW
    figure = Figure((width, 0.3 + 1.3 * len(axes) if narrow else 3.2), layout="constrained")
    if narrow:
        grid = figure.subplots(len(axes), 2, sharex="row", squeeze=False)
    else:
        grid = figure.subplots(2, len(axes), sharex="col", sharey="row", squeeze=False).T
    for (share, stray), name in zip(grid, axes, strict=True):
        for row in (row for row in rows if row["axis"] == name):
            look = style.of(row["compensator"], names).line
            look["marker"] = MARKERS[controllers.index(row["controller"]) % len(MARKERS)]
            _one_pair(share, stray, row, 0.012 * pairs.index((row["controller"], row["compensator"])), look)
        _axis_of(share, stray, summary["axes"][name])
        share.set_ylim(-0.04 - 0.012 * len(pairs), 1.04)
        stray.set_yscale("log")
        for panel in (share, stray) if narrow else (stray,):
            panel.set_xlabel(summary["axes"][name]["label"].replace(", ", ",\n"))
    for share, stray in grid if narrow else grid[:1]:
        share.set_ylabel("rigs that stand")
        stray.set_ylabel("largest deviation\nof the cart, mm")
    handles, labels = grid[0][1].get_legend_handles_labels()
    if len(controllers) == 1:
        labels = [label.partition(", ")[2] for label in labels]
    figure.legend(
        handles, labels, loc="outside upper center", ncols=min(len(labels), 3 if narrow else 5), frameon=False
    )
    return figure


def _one_pair(share: Axes, stray: Axes, row: Mapping[str, Any], apart: float, look: Mapping[str, Any]) -> None:
    steps = row["steps"]
    share.plot([s["value"] for s in steps], [s["stood"] / s["rigs"] - apart for s in steps], ms=2.5, **look)
    kept = [s for s in steps if row["half"] and row["half"][0] <= s["value"] <= row["half"][1]]
    values = [s["value"] for s in kept]
    cart = {key: [1000 * s["cart_m"][key] for s in kept] for key in ("low", "median", "high")}
    stray.plot(values, cart["median"], ms=2.5, label=f"{row['controller']}, {row['compensator']}", **look)
    stray.fill_between(values, cart["low"], cart["high"], color=look["color"], alpha=0.15, lw=0)


def _axis_of(share: Axes, stray: Axes, about: Mapping[str, Any]) -> None:
    """Scale, ticks and the usual value of an axis of robustness."""
    from matplotlib.ticker import LogLocator, MaxNLocator

    if about["usual"] > 0:
        stray.set_xscale("log", base=2)
        stray.xaxis.set_major_locator(LogLocator(base=2, numticks=12))
        stray.xaxis.set_major_formatter("{x:g}")
    else:
        stray.xaxis.set_major_locator(MaxNLocator(5, integer=True))
    for panel in (share, stray):
        panel.axvline(about["usual"], color=style.GREY, lw=0.5, zorder=0)
        panel.spines[["top", "right"]].set_visible(False)


# ------------------------------------------------------------------------------------------------ parts


def _grid(
    rows: int, widths: Sequence[float], size: tuple[float, float], heights: Sequence[float] | None = None
) -> tuple[Figure, NDArray[Any]]:
    """Panels whose rows share an axis of time within each column."""
    from matplotlib.figure import Figure

    figure = Figure(size, layout="constrained")
    panels = figure.subplots(
        rows, len(widths), sharex="col", squeeze=False, width_ratios=widths, height_ratios=heights or [1.0] * rows
    )
    for axis in figure.axes:
        axis.spines[["top", "right"]].set_visible(False)
        axis.grid(alpha=0.25)
    return figure, panels


def _finished(figure: Figure, panels: NDArray[Any], along: str, columns: int) -> Figure:
    """The figure with its legend above, and what runs along its lowest axes."""
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=columns, frameon=False)
    figure.supxlabel(along, fontsize="medium")
    return figure


def _between(time: Array, start: float, end: float) -> NDArray[np.bool_]:
    return (time >= start) & (time <= end)


def _grown(data: Samples) -> LOLIMOT:
    """A LOLIMOT grown beyond the point where training stops."""
    train = data.train
    return LOLIMOT(max_models=MOST_MODELS, border_validity=0.7, patience=MOST_MODELS).fit(
        data.inputs[train], data.voltage[train], test=(data.inputs[~train], data.voltage[~train])
    )


def _write_output(time: Array, data: Samples, model: Any, name: str, stem: Path) -> None:
    write(lambda width: model_output(time, data, model, name, width), stem)
