"""Which charts the report shows of a trace, a mismatch and a residual."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from dipc_gym.sim2real.report import charts
from dipc_gym.sim2real.report.charts import Chart, Layer, Tone, axis, span
from dipc_gym.sim2real.report.wording import number

if TYPE_CHECKING:
    from dipc_gym.sim2real.result import Mismatch, SensorResidual, Trace

Array = NDArray[np.float64]

CLOSE_UP = 4  # windows


def trace(trace: Trace) -> tuple[Chart, Chart]:
    """Readings and predictions close up, and prediction errors all along."""
    predictions: list[tuple[Tone, Array]] = [("nominal", trace.nominal)]
    if trace.recalibrated is not None:
        predictions.append(("before", trace.recalibrated))
    if trace.improved is not None:
        predictions.append(("after", trace.improved))
    start, end = _close_up(trace)
    inside = (trace.time >= start) & (trace.time <= end)
    low, high = span([trace.observed[inside]])
    wide = 0.5 * (high - low)
    all_low, all_high = span([p[inside] for _, p in predictions] + [trace.observed[inside]], 0.98)
    across = axis(start, end, "time", "s")
    up = axis(max(min(low, all_low), low - wide), min(max(high, all_high), high + wide), "reading", trace.unit, 5)
    layers = [charts.line("observed", trace.time, trace.observed, across, up, 600)]
    layers += [charts.line(tone, trace.time, p, across, up, 600) for tone, p in predictions]
    close = Chart(f"Sensor {trace.sensor} and its predictions, {number(end - start)} s", across, up, tuple(layers))

    errors = [(tone, p - trace.observed) for tone, p in predictions[-2:]]
    across = axis(*_ends(trace.time), "time", "s")
    up = axis(*span([e for _, e in errors], 0.99, zero=True), "prediction error", trace.unit, 5)
    edges = np.array([start, end])
    shade = charts.area("shade", edges, np.full(2, up.low), np.full(2, up.high), across, up)
    drawn = [charts.line(tone, trace.time, e, across, up, 800) for tone, e in errors]
    sizes = ", ".join(f"{tone} {number(_rms(e))} {trace.unit}" for tone, e in errors)
    return close, Chart(
        f"Prediction error of sensor {trace.sensor}; root mean square: {sizes}", across, up, (shade, *drawn)
    )


def _close_up(trace: Trace) -> tuple[float, float]:
    """A few windows around the one where prediction gained most, or failed most if nothing was gained."""
    last = next(p for p in (trace.improved, trace.recalibrated, trace.nominal) if p is not None)
    fine = np.flatnonzero(np.isfinite(trace.nominal) & np.isfinite(trace.observed) & np.isfinite(last))
    if len(fine) == 0:
        return _ends(trace.time)
    first = trace.recalibrated if trace.improved is not None and trace.recalibrated is not None else trace.nominal
    gain = (first - trace.observed)[fine] ** 2
    if last is not first:
        gain = gain - (last - trace.observed)[fine] ** 2
    run = np.cumsum(np.diff(fine, prepend=fine[0]) > 1)
    best = int(np.argmax(np.bincount(run, np.nan_to_num(gain))))
    length = float(np.median(np.diff(trace.time[fine[np.flatnonzero(np.diff(run, prepend=-1))]]))) if run[-1] else 0.0
    begin, end = _ends(trace.time)
    width = min(CLOSE_UP * length, end - begin) if length else end - begin
    middle = float(trace.time[fine[run == best]].mean())
    start = min(max(middle - width / 2, begin), end - width)
    return start, start + width


def mismatch_map(mismatch: Mismatch, first: Tone) -> list[Chart]:
    """Unexplained force against velocity, position and time; `first` says which model stands for before."""
    forces: list[tuple[Tone, Array]] = [(first, mismatch.before)]
    if mismatch.after is not None:
        forces.append(("after", mismatch.after))
    low, high = span([f for _, f in forces], 0.98, zero=True)
    up = axis(low, high, "unexplained force", mismatch.unit, 5)
    unit = mismatch.position_unit
    found = []
    for name, u, x in (
        ("velocity", f"{unit}/s", mismatch.velocity),
        ("position", unit, mismatch.position),
        ("time", "s", _end_to_end(mismatch.time)),
    ):
        across = axis(*span([x], 1.0 if name == "time" else 0.995), name, u, room=22)
        inside = (x >= across.low) & (x <= across.high)
        layers: list[Layer] = [charts.dots(tone, x, f, across, up) for tone, f in forces]
        for tone, f in forces:
            centre, mean, spread = charts.binned(x[inside], f[inside], 120 if name == "time" else 40)
            layers.append(charts.area(tone, centre, mean - spread, mean + spread, across, up))
            fine = np.isfinite(mean)
            layers.append(charts.line(tone, centre[fine], mean[fine], across, up))
        found.append(Chart(f"Unexplained force at {mismatch.joint} against {name}", across, up, tuple(layers)))
    return found


def law(law: Mapping[str, Any]) -> Chart:
    """A law over its first input, its interval shaded; of two inputs, where the second is small, middle and large.

    It goes on a little beyond the data, where it is constant: there it is drawn as what it is without them.
    """
    table = law["table"]
    first, *others = table["inputs"]
    x, levels = np.array(first["knots"], dtype=float), np.array(table["levels"], dtype=float)
    lines: list[tuple[Tone, Array]] = [("after", levels)]
    words, band = "", None
    if "low" in table and not others:
        band = np.array(table["low"], dtype=float), np.array(table["high"], dtype=float)
    if others:
        least, largest = law["supported"][1]
        within = [k for k, knot in enumerate(others[0]["knots"]) if least <= knot <= largest]
        picked = (within[0], within[len(within) // 2], within[-1])
        tones: tuple[Tone, ...] = ("nominal", "before", "after")
        lines = [(tone, levels[:, k]) for tone, k in zip(tones, picked, strict=True)]
        drawn_as = zip(("dashed", "orange", "blue"), picked, strict=True)
        at = ", ".join(f"{number(float(others[0]['knots'][k]))} ({how})" for how, k in drawn_as)
        words = f", at {others[0]['name']} of {at} {others[0]['unit']}".rstrip()
    begin, end = map(float, law["supported"][0])
    beyond = 0.08 * (end - begin) if law["outside"] == "constant" else 0.0
    # A table may go on far beyond the data; drawn is as much of it as beside another one.
    drawn = np.concatenate([[begin - beyond], x[(x > begin - beyond) & (x < end + beyond)], [end + beyond]])
    lines = [(tone, np.interp(drawn, x, y)) for tone, y in lines]
    band = band and (np.interp(drawn, x, band[0]), np.interp(drawn, x, band[1]))
    across = axis(begin - beyond, end + beyond, first["name"], first["unit"])
    seen = [y for _, y in lines] + ([] if band is None else list(band))
    low, high = span(seen, 1.0, zero=True)
    up = axis(low, high, law["kind"], table["unit"], 5)
    layers = []
    for ends in (np.array([begin - beyond, begin]), np.array([end, end + beyond])) if beyond else ():
        layers.append(charts.area("shade", ends, np.full(2, low), np.full(2, high), across, up))
    if band is not None:
        told = (drawn >= begin) & (drawn <= end)
        layers.append(charts.area("after", drawn[told], band[0][told], band[1][told], across, up))
    layers += [charts.line(tone, drawn, y, across, up) for tone, y in lines]
    interval = ", with its 90 % interval" if band is not None else ""
    how = "is foretold by the form of the law" if begin > x[0] or end < x[-1] else "stays as it ends"
    outside = f"; grey: beyond the data, where it {how}" if beyond else ""
    return Chart(f"The law over {first['name']}{words}{interval}{outside}", across, up, tuple(layers))


def residual(residual: SensorResidual, first: Tone) -> tuple[Chart, Chart]:
    """Residual over time and its autocorrelation; `first` says which model stands for before."""
    series: list[tuple[Tone, Array]] = [(first, residual.before)]
    echoes: list[tuple[Tone, Array]] = [(first, residual.before_autocorrelation)]
    if residual.after is not None:
        series.append(("after", residual.after))
    if residual.after_autocorrelation is not None:
        echoes.append(("after", residual.after_autocorrelation))
    time = _end_to_end(residual.time)
    low, high = span([s for _, s in series], 0.99)
    across, up = axis(*_ends(time), "time", "s"), axis(min(low, -4.0), max(high, 4.0), "residual, × noise", "", 5)
    two = np.full(2, 2.0)
    layers = [charts.area("shade", np.array(_ends(time)), -two, two, across, up)]
    layers += [charts.dots(tone, time, s, across, up, 600) for tone, s in series]
    course = Chart(f"Residual of {residual.sensor} in units of noise", across, up, tuple(layers))

    across, up = axis(*_ends(residual.lags), "lag", "s"), axis(-1.05, 1.05, "autocorrelation", "", 5)
    band = np.full(2, residual.band)
    layers = [charts.area("shade", np.array(_ends(residual.lags)), -band, band, across, up)]
    layers += [charts.line(tone, residual.lags, e, across, up, 400) for tone, e in echoes]
    return course, Chart(
        f"Autocorrelation of the residual of {residual.sensor}, with the 95 % band of white noise",
        across,
        up,
        tuple(layers),
    )


def _ends(values: Array) -> tuple[float, float]:
    fine = values[np.isfinite(values)]
    return (float(fine.min()), float(fine.max())) if len(fine) else (0.0, 1.0)


def _end_to_end(time: Array) -> Array:
    """Time of several recordings laid one after the other."""
    back = np.minimum(np.diff(time, prepend=time[:1]), 0.0)
    return time - np.cumsum(back)


def _rms(values: Array) -> float:
    fine = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(fine**2))) if len(fine) else math.nan
