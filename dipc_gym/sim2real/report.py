"""The diagnosis as one page that needs nothing else: plain language first, evidence after.

Whoever diagnoses fills a `ReportData`; `write` draws it. Every text in it may come from a stranger's model or
recording: the template escapes all, and characters that could turn or hide a line are replaced.
"""

from __future__ import annotations

import math
import re
import unicodedata
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from dipc_gym.sim2real import charts
from dipc_gym.sim2real.charts import Chart, Layer, axis, span, superscript

Array = NDArray[np.float64]
Status = Literal["chosen", "same model here", "not told apart", "ruled out", "screened out"]

VERDICTS = {
    "consistent": "The model predicts these recordings as well as their noise allows.",
    "recalibrated": "Some numbers of the model were off. No physics is missing.",
    "explained": "With the physics that was missing, prediction comes down to the noise.",
    "partly explained": "The physics named here helps. Some structure is left that no known effect accounts for.",
    "unexplained": "There is structure beyond noise, and no known effect accounts for it.",
    "cannot tell": "These recordings do not excite what would decide it.",
}
MOST_TRACES, MOST_MAPS, MOST_RESIDUALS, MOST_CANDIDATES = 16, 8, 12, 30  # drawn or listed in full: keeps it below 2 MB
MOST_LINES, MOST_CHARACTERS = 400, 4000  # of the difference, of any one text
CLOSE_UP = 4  # windows
NBSP = "\u00a0"  # a space that does not break


@dataclass(frozen=True)
class Trace:
    """A sensor on held-out data, predicted window by window; NaN where no window lies.

    Attributes:
        sensor: its name.
        unit: SI.
        recording: name of the file.
        time: s, rising, (n,).
        observed: readings, (n,).
        nominal: prediction of the model as given, (n,).
        recalibrated: with its own numbers refitted, (n,); None if there is nothing to refit.
        improved: with what was missing, (n,); None if nothing is.
    """

    sensor: str
    unit: str
    recording: str
    time: Array
    observed: Array
    nominal: Array
    recalibrated: Array | None = None
    improved: Array | None = None

    def __post_init__(self) -> None:
        _same_length(self, "time", "observed", "nominal", "recalibrated", "improved")


@dataclass(frozen=True)
class Mismatch:
    """Force at one joint that a model does not explain: where it sits.

    Attributes:
        joint: its name.
        unit: of the force, `N` or `N m`.
        position_unit: `m` or `rad`; velocity is per second.
        time: s, (n,); may begin anew with each recording.
        position: of the joint, (n,).
        velocity: of the joint, (n,).
        before: unexplained force without what was missing, (n,).
        after: unexplained force with it, (n,); None if nothing is missing.
    """

    joint: str
    unit: str
    position_unit: str
    time: Array
    position: Array
    velocity: Array
    before: Array
    after: Array | None = None

    def __post_init__(self) -> None:
        _same_length(self, "time", "position", "velocity", "before", "after")


@dataclass(frozen=True)
class Candidate:
    """A hypothesis and what became of it.

    Attributes:
        effect: id.
        at: place.
        words: the effect in plain words.
        status: what became of it.
        error: reached by the full fit, in units of noise; None if it was not fitted.
        improvement: mean fall of the log square error of windows it was not fitted to; None if not fitted.
        standard_error: of the improvement.
    """

    effect: str
    at: str
    words: str
    status: Status
    error: float | None = None
    improvement: float | None = None
    standard_error: float | None = None

    def __post_init__(self) -> None:
        if self.status not in get_args(Status):
            raise ValueError(f"status of {self.effect}: {self.status!r} is none of {', '.join(get_args(Status))}")


@dataclass(frozen=True)
class SensorResidual:
    """What prediction leaves of one sensor, in units of its noise.

    Attributes:
        sensor: its name.
        time: s, (n,).
        before: without what was missing, (n,).
        after: with it, (n,); None if nothing is missing.
        lags: s, (k,).
        before_autocorrelation: (k,).
        after_autocorrelation: (k,); None if nothing is missing.
        band: half width of the 95 % band of white noise.
        statement: whether this looks like noise, in one sentence.
    """

    sensor: str
    time: Array
    before: Array
    after: Array | None
    lags: Array
    before_autocorrelation: Array
    after_autocorrelation: Array | None
    band: float
    statement: str

    def __post_init__(self) -> None:
        _same_length(self, "time", "before", "after")
        _same_length(self, "lags", "before_autocorrelation", "after_autocorrelation")


@dataclass(frozen=True)
class ReportData:
    """All that the page shows.

    Attributes:
        model: name of the model's file.
        diagnosis: what `diagnosis.json` holds.
        before: what stands for "before" in maps and residuals.
        traces: held-out data, the most telling first.
        maps: where the mismatch sits, the joint with most of it first.
        candidates: hypotheses, the best first.
        residuals: per sensor.
        difference: unified difference of the MJCF, from the model to the improved one; empty if there is none.
        command: that makes this page again.
        notes: sentences about the recordings and about the step size.
    """

    model: str
    diagnosis: Mapping[str, Any]
    before: Literal["nominal", "recalibrated"] = "recalibrated"
    traces: Sequence[Trace] = ()
    maps: Sequence[Mismatch] = ()
    candidates: Sequence[Candidate] = ()
    residuals: Sequence[SensorResidual] = ()
    difference: str = ""
    command: str = ""
    notes: Sequence[str] = ()


def write(data: ReportData, path: Path) -> None:
    """Write the page: one file, no script, no request, at most 2 MB.

    Args:
        data: what to show.
        path: of the HTML file; written beside it first, so that no half page is left.

    Raises:
        ValueError: unknown verdict.

    Example:
        >>> import tempfile
        >>> found = {"verdict": "consistent", "sentence": "Nothing beyond noise."}
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     write(ReportData("cart.xml", found), Path(folder, "report.html"))
        ...     "Nothing beyond noise." in Path(folder, "report.html").read_text(encoding="utf-8")
        True
    """
    page = render(data)
    draft = path.with_name(path.name + ".part")
    draft.write_text(page, encoding="utf-8")
    draft.replace(path)


def render(data: ReportData) -> str:
    """The page as text; see `write`."""
    import jinja2

    verdict = data.diagnosis["verdict"]
    if verdict not in VERDICTS:
        raise ValueError(f"diagnosis: verdict {verdict!r} is none of {', '.join(VERDICTS)}")
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        finalize=_clean,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"number": number, "percent": percent, "short": short, "measured": measured, "tied": tied}
    with np.errstate(all="ignore"):  # a prediction may have diverged; charts leave out what is not finite
        parts = _parts(data)
    return environment.get_template("report.html.j2").render(
        data=data, d=data.diagnosis, gloss=VERDICTS[verdict], **parts
    )


def _parts(data: ReportData) -> dict[str, Any]:
    """What the template shows, drawn and sorted."""
    shown, rest, screened = _candidates(data.candidates)
    return {
        "fit": _fit(data.diagnosis),
        "traces": [(trace, *_trace(trace)) for trace in data.traces[:MOST_TRACES]],
        "maps": [(mismatch, _map(mismatch)) for mismatch in data.maps[:MOST_MAPS]],
        "residuals": [(residual, *_residual(residual)) for residual in data.residuals[:MOST_RESIDUALS]],
        "not_drawn": {
            "traces": data.traces[MOST_TRACES:],
            "maps": data.maps[MOST_MAPS:],
            "residuals": data.residuals[MOST_RESIDUALS:],
        },
        "candidates": shown,
        "candidates_left": rest,
        "screened": screened,
        "difference": _difference(data.difference),
    }


# --------------------------------------------------------------------------------------------------- words and numbers


def number(value: float | None, digits: int = 3) -> str:
    """A few digits that count, with a true minus and raised powers; a dash if there is no value."""
    if value is None or math.isnan(value):
        return "–"
    if math.isinf(value):
        return "∞" if value > 0 else "−∞"
    if value == 0:
        return "0"
    if 1e-3 <= abs(value) < 1e5:
        text = f"{value:#.{digits}g}"
        return (f"{value:.0f}" if "e" in text else text.rstrip(".")).replace("-", "−")
    mantissa, power = f"{value:.{digits - 1}e}".split("e")
    return f"{mantissa} × 10{superscript(int(power))}".replace("-", "−").replace(" ", NBSP)


def percent(share: float | None) -> str:
    """A share in whole percent."""
    return "–" if share is None or not math.isfinite(share) else f"{100 * share:.0f}{NBSP}%".replace("-", "−")


def measured(value: float | None, error: float | None) -> str:
    """A number with its standard error, both to the second digit of the error."""
    if value is None or error is None or not (math.isfinite(value) and 0 < error < 1e5):
        return number(value)
    decimals = max(0, 1 - math.floor(math.log10(error)))
    return f"{value:.{decimals}f}{NBSP}±{NBSP}{error:.{decimals}f}".replace("-", "−")


def tied(text: str) -> str:
    """A sentence whose numbers stay on one line with their short units."""
    return re.sub(r"(?<=\d) (?=\S{1,4}(?:[\s.,;:)]|$))", NBSP, text)


def short(text: object, most: int = 48) -> str:
    """A name with its middle left out if it is too long for a label."""
    text = str(text)
    return text if len(text) <= most else f"{text[: most // 2]}…{text[-most // 2 + 1 :]}"


def _clean(value: object) -> object:
    """Of a text: nothing that turns the direction of a line, is invisible control, or has no encoding."""
    if not isinstance(value, str) or hasattr(value, "__html__"):
        return value
    if len(value) > MOST_CHARACTERS:
        value = value[:MOST_CHARACTERS] + "…"
    return "".join(_visible(c) for c in value)


def _visible(c: str) -> str:
    turns = unicodedata.bidirectional(c) in ("LRE", "RLE", "LRO", "RLO", "PDF", "LRI", "RLI", "FSI", "PDI")
    hidden = unicodedata.category(c) in ("Cc", "Cs") and c not in "\n\t"
    return "\ufffd" if turns or hidden else c


def _same_length(record: object, *names: str) -> None:
    values = [(name, getattr(record, name)) for name in names]
    lengths = {name: np.shape(value) for name, value in values if value is not None}
    if len(set(lengths.values())) > 1 or any(len(shape) != 1 for shape in lengths.values()):
        raise ValueError(f"{type(record).__name__}: fields must be vectors of one length, not {lengths}")


# ----------------------------------------------------------------------------------------------------------- sections


def _fit(diagnosis: Mapping[str, Any]) -> dict[str, Any]:
    """Bars of the held-out error: label, value, width in percent; and the floor's place."""
    fit = diagnosis.get("fit") or {}
    held_out, floor = fit.get("held_out") or {}, fit.get("noise_floor")
    labels = {
        "nominal": "The model as given",
        "recalibrated": "Its own numbers refitted",
        "improved": "With the missing physics",
    }
    known = {k: held_out[k] for k in labels if held_out.get(k) is not None and math.isfinite(held_out[k])}
    if not diagnosis.get("missing"):
        known.pop("improved", None)
    full = max([*known.values(), floor or 0.0, 1e-12]) * 1.02
    return {
        "bars": [{"key": k, "label": labels[k], "value": v, "width": 100 * v / full} for k, v in known.items()],
        "floor": floor,
        "floor_at": None if floor is None else 100 * floor / full,
        "first": known.get("nominal"),
        "last": next((known[k] for k in ("improved", "recalibrated", "nominal") if k in known), None),
        "train": fit.get("train") or {},
        "held_out": held_out,
    }


def _trace(trace: Trace) -> tuple[Chart, Chart]:
    """Readings and predictions close up, and prediction errors all along."""
    predictions: list[tuple[charts.Tone, Array]] = [("nominal", trace.nominal)]
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

    errors = [(tone, p - trace.observed) for tone, p in predictions if tone != "nominal" or len(predictions) == 1]
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


def _map(mismatch: Mismatch) -> list[Chart]:
    """Unexplained force against velocity, position and time."""
    forces: list[tuple[charts.Tone, Array]] = [("before", mismatch.before)]
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


def _residual(residual: SensorResidual) -> tuple[Chart, Chart]:
    """Residual over time and its autocorrelation."""
    series: list[tuple[charts.Tone, Array]] = [("before", residual.before)]
    echoes: list[tuple[charts.Tone, Array]] = [("before", residual.before_autocorrelation)]
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


def _candidates(rows: Sequence[Candidate]) -> tuple[list[tuple[Candidate, dict[str, float]]], int, list[Candidate]]:
    """Rows by what became of them, each with the places of its interval; how many more; those only screened."""
    order = get_args(Status)
    fitted = sorted((c for c in rows if c.status != "screened out"), key=lambda c: order.index(c.status))
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
    return found, len(fitted) - len(found), [c for c in rows if c.status == "screened out"]


def _difference(text: str) -> list[tuple[str, str]]:
    """Lines with what they are: file, hunk, add, remove or same."""
    kinds = (("---", "file"), ("+++", "file"), ("@@", "hunk"), ("+", "add"), ("-", "remove"))
    lines = text.splitlines()
    found = [(next((k for mark, k in kinds if line.startswith(mark)), "same"), line) for line in lines[:MOST_LINES]]
    if len(lines) > MOST_LINES:
        found.append(("hunk", f"… {len(lines) - MOST_LINES} more lines; compare the two files"))
    return found


# -------------------------------------------------------------------------------------------------------------- arrays


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
