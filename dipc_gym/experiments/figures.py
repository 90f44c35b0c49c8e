"""Pictures of a comparison: the paper's figures from our data, and the rig in motion."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np

from dipc_gym import ENV_ID, compensators
from dipc_gym.compensators import LOLIMOT, Samples
from dipc_gym.files import whole

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from dipc_gym.runs import Course, Identification

GREY, BLUE, RED, GREEN = "#8a8f98", "#2b5d9b", "#c8452f", "#2c8c68"
COLOURS = {"none": RED, "feedforward": "#b07aa1", "mlp": BLUE, "llnf": GREEN, "ideal": GREY}
DASHES = ("-", "--", ":", "-.")
GIF_SECONDS, GIF_RATE, GIF_SIZE = 8.0, 12.5, (300, 340)
MOST_MODELS = 30


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
    time = identified.plant.control_period * np.arange(len(data.force))
    _save(identification(time, data), folder / "fig07_identification.png")
    for number, name in ((8, "mlp"), (10, "llnf")):
        if name in trained:
            picture = model_output(time, data, compensators.load(trained[name]), name)
            _save(picture, folder / f"fig{number:02d}_{name}.png")
    _save(lolimot_growth(data), folder / "fig09_lolimot.png")
    controller = next(iter(courses), ("", ""))[0]
    mine = {name: course for (brain, name), course in courses.items() if brain == controller}
    if mine:
        _save(balancing(controller, mine), folder / "fig12_balance.png")
    pair = [name for name in ("none", "llnf") if name in mine]
    if len(pair) < 2:
        return []
    try:
        animate({_CAPTIONS[name]: mine[name] for name in pair}, out / "rig.gif", model=model)
    except Exception as error:  # OpenGL fails in as many ways as there are drivers; the figures do not depend on it
        return [f"rig.gif was not drawn ({type(error).__name__}: {error}); see the README on headless drawing"]
    return []


def identification(time: np.ndarray, data: Samples) -> Figure:
    """Paper's Fig. 7: the run that compensators are trained on, force and velocity against voltage."""
    figure = _figure(3, "Identification run, poles locked", (8, 5.5))
    for axis, values, label in zip(
        figure.axes, (data.voltage, data.force, data.velocity), ("voltage, V", "force, N", "velocity, m/s"), strict=True
    ):
        for part, colour, name in ((data.train, BLUE, "training"), (~data.train, RED, "test")):
            axis.plot(time, np.where(part, values, np.nan), color=colour, lw=0.7, label=name)
        axis.set_ylabel(label)
    figure.axes[0].legend(loc="upper right", ncols=2)
    figure.axes[-1].set_xlabel("time, s")
    return figure


def model_output(time: np.ndarray, data: Samples, model: Any, name: str) -> Figure:
    """Paper's Figs. 8 and 10: voltage of the inverse model against the voltage applied, on test data."""
    output = model.volts(data.force, data.velocity, data.previous_velocity)
    error = output - data.voltage
    mse = float(np.mean(error[~data.train] ** 2))
    figure = _figure(2, f"{name.upper()} on test data: mean square error {mse:.3g} V²", (8, 4.5))
    for axis, start in zip(figure.axes, (9.0, 45.0), strict=True):
        shown = (time >= start) & (time <= start + 5)
        axis.plot(time[shown], data.voltage[shown], color=GREY, lw=2.5, label="applied")
        axis.plot(time[shown], np.where(data.train, np.nan, output)[shown], color=RED, lw=1.0, label="model, test")
        axis.set_ylabel("voltage, V")
    figure.axes[0].legend(loc="upper right", ncols=2)
    figure.axes[-1].set_xlabel("time, s (two stretches; gaps are training data)")
    return figure


def lolimot_growth(data: Samples) -> Figure:
    """Paper's Fig. 9: error over the number of local models, grown beyond the point where training stops."""
    train = data.train
    model = LOLIMOT(max_models=MOST_MODELS, border_validity=0.7, patience=MOST_MODELS).fit(
        data.inputs[train], data.voltage[train], test=(data.inputs[~train], data.voltage[~train])
    )
    figure = _figure(1, "LOLIMOT: error over number of local linear models", (6, 3.6))
    axis = figure.axes[0]
    models = np.arange(1, len(model.train_errors_) + 1)
    axis.semilogy(models, model.train_errors_, "o-", color=BLUE, ms=3, label="training")
    axis.semilogy(models, model.test_errors_, "s-", color=RED, ms=3, label="test")
    axis.set_xlabel("local models")
    axis.set_ylabel("mean square error, V²")
    axis.legend()
    return figure


def balancing(controller: str, courses: Mapping[str, Course]) -> Figure:
    """Paper's Fig. 12: cart and poles over the whole run, without and with compensation."""
    figure = _figure(3, f"Balancing under {controller}, one rig", (8, 6))
    labels = ("cart, m", "pole 1, deg", "pole 2, deg")
    for name, course in courses.items():
        for axis, column, scale in zip(figure.axes, range(3), (1, 180 / np.pi, 180 / np.pi), strict=True):
            axis.plot(course.time, scale * course.state[:, column], color=COLOURS.get(name), lw=0.7, label=name)
    for axis, label in zip(figure.axes, labels, strict=True):
        axis.set_ylabel(label)
    figure.axes[0].legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=len(courses), frameon=False)
    figure.axes[-1].set_xlabel("time, s")
    return figure


def robustness(summary: Mapping[str, Any]) -> Figure:
    """How far each pair holds along each axis: above, the share of rigs that stand; below, how far the cart strays.

    Two columns of a paper wide, set in 7 points. Colours are the compensators', dashes the controllers'. The lower
    lines are medians over the rigs that stand, with 10th and 90th percentile, as far as half of the rigs stand; the
    upper ones are set apart by a hundredth, so that none hides another.

    Args:
        summary: as `robustness.summarise` gives it.
    """
    from matplotlib import rc_context
    from matplotlib.figure import Figure
    from matplotlib.ticker import LogLocator, MaxNLocator

    rows = summary["rows"]
    axes = list(dict.fromkeys(row["axis"] for row in rows))
    controllers = list(dict.fromkeys(row["controller"] for row in rows))
    names = list(dict.fromkeys(row["compensator"] for row in rows))
    pairs = list(dict.fromkeys((row["controller"], row["compensator"]) for row in rows))
    spare = iter(("#d9922e", "#5b4a9b", "#7d6b4f", "#3a3a3a") * len(names))
    colours = {name: COLOURS.get(name) or next(spare) for name in names}
    with rc_context({"font.size": 7, "axes.linewidth": 0.6, "lines.linewidth": 1.0, "pdf.fonttype": 42}):
        figure = Figure((max(7.2 * len(axes) / 5, 3.5), 3.2), layout="constrained")
        grid = figure.subplots(2, len(axes), sharex="col", sharey="row", squeeze=False)
        for (share, stray), name in zip(grid.T, axes, strict=True):
            for row in (row for row in rows if row["axis"] == name):
                style = {"color": colours[row["compensator"]], "ls": DASHES[controllers.index(row["controller"]) % 4]}
                steps, apart = row["steps"], 0.012 * pairs.index((row["controller"], row["compensator"]))
                stood = [s["stood"] / s["rigs"] - apart for s in steps]
                share.plot([s["value"] for s in steps], stood, marker=".", ms=3, **style)
                kept = [s for s in steps if row["half"] and row["half"][0] <= s["value"] <= row["half"][1]]
                values = [s["value"] for s in kept]
                cart = {key: [1000 * s["cart_m"][key] for s in kept] for key in ("low", "median", "high")}
                title = f"{row['controller']}, {row['compensator']}" if len(controllers) > 1 else row["compensator"]
                stray.plot(values, cart["median"], marker=".", ms=3, label=title, **style)
                stray.fill_between(values, cart["low"], cart["high"], color=style["color"], alpha=0.15, lw=0)
            about = summary["axes"][name]
            if about["usual"] > 0:
                stray.set_xscale("log", base=2)
                stray.xaxis.set_major_locator(LogLocator(base=2, numticks=12))
                stray.xaxis.set_major_formatter("{x:g}")
            else:
                stray.xaxis.set_major_locator(MaxNLocator(5, integer=True))
            for panel in (share, stray):
                panel.axvline(about["usual"], color=GREY, lw=0.5, zorder=0)
                panel.spines[["top", "right"]].set_visible(False)
            stray.set_xlabel(about["label"].replace(", ", ",\n"))
        grid[0, 0].set_ylabel("rigs that stand")
        grid[0, 0].set_ylim(-0.04 - 0.012 * len(pairs), 1.04)
        grid[1, 0].set_yscale("log")
        grid[1, 0].set_ylabel("largest deviation\nof the cart, mm")
        handles, labels = grid[1, 0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper center", ncols=min(len(labels), 6), frameon=False)
    return figure


def animate(
    courses: Mapping[str, Course], path: Path, *, model: str | None = None, seconds: float = GIF_SECONDS
) -> None:
    """Runs side by side as an animated GIF, from their start.

    Args:
        courses: by caption.
        path: of the GIF.
        model: MJCF file of the rig; None is the package's.
        seconds: how much of the runs, s.

    Raises:
        RuntimeError: nothing can be drawn on this machine.
    """
    from PIL import Image, ImageDraw

    width, height = GIF_SIZE
    env = gymnasium.make(ENV_ID, model=model, render_mode="rgb_array", width=width, height=height)
    frames = []
    try:
        length = min(seconds, max(c.time[-1] for c in courses.values()))
        for moment in np.arange(0.0, max(length, 1 / GIF_RATE), 1 / GIF_RATE):  # of the shortest run one
            frame = Image.new("RGB", (width * len(courses), height))
            for column, (caption, course) in enumerate(courses.items()):
                k = min(int(np.searchsorted(course.time, moment)), len(course.time) - 1)
                env.reset(options={"state": course.state[k]})
                picture: Any = env.render()
                frame.paste(Image.fromarray(picture), (width * column, 0))
                ImageDraw.Draw(frame).text((width * column + 10, 8), caption, fill=(20, 24, 30))
            frames.append(frame.quantize(128, method=Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE))
    finally:
        env.close()
    how: dict[str, Any] = {"duration": 1000 / GIF_RATE, "loop": 0, "optimize": True}
    with whole(path) as file:
        frames[0].save(file, "GIF", save_all=True, append_images=frames[1:], **how)


def show(course: Course, *, model: str | None = None, seconds: float = GIF_SECONDS) -> None:
    """A run in a window, in real time.

    Raises:
        ValueError: there is no display.
    """
    if not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")) and sys.platform == "linux":
        raise ValueError("there is no display for a window; write a GIF with --out")
    env = gymnasium.make(ENV_ID, model=model, render_mode="human")
    begin = time.perf_counter()
    try:
        while (now := time.perf_counter() - begin) < min(seconds, course.time[-1]):
            env.reset(options={"state": course.state[int(np.searchsorted(course.time, now))]})
    finally:
        env.close()


_CAPTIONS = {"none": "without compensation", "llnf": "with the LLNF compensator"}


def _figure(rows: int, title: str, size: tuple[float, float]) -> Figure:
    from matplotlib.figure import Figure

    figure = Figure(size, layout="constrained")
    figure.subplots(rows, 1, sharex=rows == 3)
    figure.suptitle(title, fontsize=11)
    for axis in figure.axes:
        axis.spines[["top", "right"]].set_visible(False)
        axis.grid(alpha=0.25)
    return figure


def _save(figure: Figure, path: Path) -> None:
    with whole(path) as file:
        figure.savefig(file, dpi=110, format=path.suffix[1:])
