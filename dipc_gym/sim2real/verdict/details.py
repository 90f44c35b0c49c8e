"""What stands behind a diagnosis, drawn together once: predictions on test data, forces, hypotheses, the difference."""

from __future__ import annotations

import difflib
from collections.abc import Iterator, Mapping, Sequence
from typing import get_args

import mujoco
import numpy as np
from numpy.typing import NDArray

from dipc_gym import mjcf
from dipc_gym.mjcf.edit import Document
from dipc_gym.recording.units import of_sensor
from dipc_gym.sim2real.estimation.fit import Fit, readings
from dipc_gym.sim2real.estimation.problem import Problem
from dipc_gym.sim2real.estimation.segments import joined
from dipc_gym.sim2real.estimation.shooting import rms
from dipc_gym.sim2real.estimation.unexplained import Scene
from dipc_gym.sim2real.model.structure import Structure
from dipc_gym.sim2real.result import (
    MOST_MAPS,
    MOST_RESIDUALS,
    MOST_SAMPLES,
    MOST_TRACES,
    Before,
    Candidate,
    Details,
    Errors,
    Located,
    Mismatch,
    SensorFit,
    SensorResidual,
    Status,
    Trace,
)
from dipc_gym.sim2real.selection.baseline import Baseline
from dipc_gym.sim2real.selection.partitioning import evenly
from dipc_gym.sim2real.selection.score import compare
from dipc_gym.sim2real.selection.screen import Tried
from dipc_gym.sim2real.selection.search import Searched
from dipc_gym.sim2real.selection.settings import SCORE
from dipc_gym.sim2real.simulation.windows import Windows
from dipc_gym.sim2real.verdict.conclude import Conclusion
from dipc_gym.sim2real.verdict.settings import VERDICT

Array = NDArray[np.float64]

NOTHING = np.zeros(0)


def details(
    source: mjcf.Source,
    base: Baseline,
    search: Searched,
    found: Conclusion,
    test: Problem,
    located: Sequence[Located],
    improved: str,
    predicted: Mapping[str, Array],
) -> Details:
    """Gather what the report draws.

    Args:
        source: the model as given.
        base: what was known before the search.
        search: that has run.
        found: what it came to, as it was judged.
        test: windows that it was judged on.
        located: where the mismatch sits.
        improved: text of the improved model.
        predicted: see `predictions`.
    """
    final, structural = found.fitted, bool(found.fitted.structure.terms)
    before: Before = "recalibrated" if base.recalibrated.structure.model_parameters else "nominal"
    first = base.recalibrated if before == "recalibrated" else base.nominal
    look = search.question.look
    after = look(final) if structural else None
    return Details(
        before,
        tuple(_traces(test.windows, final.structure, predicted, structural)),
        tuple(_maps(final.structure, look(first), after, [one.at for one in located])),
        tuple(_candidates(search, found)),
        tuple(_residuals(test.windows, predicted[before], predicted["improved"] if structural else None)),
        _difference(source, improved),
    )


def predictions(test: Problem, nominal: Fit, recalibrated: Fit, improved: Fit) -> dict[str, Array]:
    """Readings (n, m, ns) of test windows as each model predicts them, by its name."""
    three = {"nominal": nominal, "recalibrated": recalibrated, "improved": improved}
    return {name: readings(test, fitted.structure, fitted.z) for name, fitted in three.items()}


def sensor_fits(w: Windows, model: mujoco.MjModel, predicted: Mapping[str, Array]) -> tuple[SensorFit, ...]:
    """How far predictions are off, in each sensor's own unit; each sample counts alike."""
    valid, found = w.valid, []
    moved = np.where(valid[..., None], w.observed - w.observed[:, :1], 0.0)
    count = max(int(valid.sum()), 1)
    off = {
        name: np.sqrt(np.sum(np.where(valid[..., None], w.observed - one, 0.0) ** 2, axis=(0, 1)) / count)
        for name, one in predicted.items()
    }
    motion = np.sqrt(np.sum(moved**2, axis=(0, 1)) / count)
    for k, name in enumerate(w.recordings[0].sensor_names):
        three = Errors(*(float(off[which][k]) for which in ("nominal", "recalibrated", "improved")))
        found.append(SensorFit(name, of_sensor(model, name), float(w.noise[k]), float(motion[k]), three))
    return tuple(found)


def _traces(w: Windows, structure: Structure, predicted: Mapping[str, Array], structural: bool) -> Iterator[Trace]:
    """A trace for every sensor and recording; the worst predicted by the model as given comes first."""
    order = []
    for k, _ in enumerate(w.recordings[0].sensor_names):
        for i, _ in enumerate(w.recordings):
            mine = np.flatnonzero(w.source == i)
            if len(mine):
                off = (w.observed[mine, :, k] - predicted["nominal"][mine, :, k])[w.valid[mine]]
                order.append((float(np.nanmean(off**2) / max(w.noise[k] ** 2, 1e-300)), k, i, mine))
    order.sort(key=lambda one: -one[0])
    for place, (_, k, i, mine) in enumerate(order):
        sensor, recording = w.recordings[0].sensor_names[k], w.recordings[i].name
        unit = of_sensor(structure.model, sensor)
        if place >= MOST_TRACES:
            yield Trace(sensor, unit, recording, NOTHING, NOTHING, NOTHING)
            continue
        kept = mine[evenly(len(mine), max(MOST_SAMPLES // w.valid.shape[1], 1))]
        values = {name: joined(readings[kept, :, k], w.valid[kept]) for name, readings in predicted.items()}
        yield Trace(
            sensor,
            unit,
            recording,
            _rising(joined((w.start[:, None] + w.times)[kept], w.valid[kept])),
            joined(w.observed[kept, :, k], w.valid[kept]),
            values["nominal"],
            values["recalibrated"],
            values["improved"] if structural else None,
        )


def _rising(time: Array) -> Array:
    """Times with the gaps filled by a moment just after the last sample."""
    gaps = np.flatnonzero(np.isnan(time))
    time = time.copy()
    time[gaps] = time[gaps - 1] + 1e-9
    return time


def _maps(structure: Structure, first: Scene, after: Scene | None, order: Sequence[str]) -> Iterator[Mismatch]:
    """What is unexplained at each joint, in this order of joints."""
    kept = evenly(len(first.time), MOST_SAMPLES)
    for place, joint in enumerate(sorted(structure.base, key=list(order).index)):
        j = list(structure.base).index(joint)
        of = mjcf.units(structure.model, joint)
        units = of.force, of.length
        if place >= MOST_MAPS:
            yield Mismatch(joint, *units, NOTHING, NOTHING, NOTHING, NOTHING)
            continue
        yield Mismatch(
            joint,
            *units,
            first.time[kept],
            first.position[kept, j],
            first.velocity[kept, j],
            first.force[kept, j],
            None if after is None else after.force[kept, j],
        )


def _candidates(search: Searched, found: Conclusion) -> list[Candidate]:
    """Every hypothesis once, as the last round that fitted it saw it."""
    status: dict[str, Status] = {
        r.term.key: ("same model here" if r.same else "ruled out" if r.ruled_out else "not told apart")
        for rivals in found.rivals.values()
        for r in rivals
    }
    status |= {term.key: "chosen" for term in found.fitted.structure.terms}
    otherwise: Status = "not told apart" if search.stop.asked else "ruled out"
    rows: dict[str, Candidate] = {}
    for tried in [t for round_ in reversed(search.progress.rounds) for t in round_]:
        if tried.key in rows and (rows[tried.key].error is not None or tried.sketch is None):
            continue
        rows[tried.key] = _candidate(search, tried, status.get(tried.key, otherwise))
    order = get_args(Status)
    return sorted(rows.values(), key=lambda c: (order.index(c.status), c.error if c.error is not None else np.inf))


def _candidate(search: Searched, tried: Tried, status: Status) -> Candidate:
    effect = tried.term.effect
    words = (effect.__doc__ or "").split("\n")[0].rstrip(".")
    if tried.sketch is None:
        return Candidate(effect.id, tried.term.at, words, "screened out")
    first = search.progress.path[0]
    if tried.fitted is not None:
        error = tried.fitted.error
        gain = search.scorer.compare_on_others(tried.fitted, first)
    else:  # the windows of a sketch are among the worse ones
        subset = search.partition.known_to(tried.sketch)
        error = tried.sketch.error * first.error / rms(first.mse[subset])
        gain = compare(tried.sketch.mse, first.mse[subset], search.partition.problem.blocks[subset])
    spread = gain.error if np.isfinite(gain.error) else None
    return Candidate(effect.id, tried.term.at, words, status, error, gain.gain, spread)


def _residuals(w: Windows, before: Array, after: Array | None) -> Iterator[SensorResidual]:
    """What two predictions (n, m, ns) leave of each sensor whose noise is known."""
    known = np.flatnonzero(np.isfinite(w.noise))
    kept = evenly(len(w), max(MOST_SAMPLES // w.valid.shape[1], 1))
    time = _rising(joined((w.start[:, None] + w.times)[kept], w.valid[kept]))
    lags = min(VERDICT.lags, w.valid.shape[1] // 2)
    for place, k in enumerate(known):
        sensor = w.recordings[0].sensor_names[k]
        if place >= MOST_RESIDUALS:
            without = None if after is None else NOTHING
            yield SensorResidual(sensor, NOTHING, NOTHING, without, NOTHING, NOTHING, without, 0.0, "")
            continue
        left = [(w.observed[..., k] - one[..., k]) / w.noise[k] for one in (before, after) if one is not None]
        shown = [joined(one[kept], w.valid[kept]) for one in left]
        correlation = [_autocorrelation(one, w.valid, lags) for one in left]
        white = float(np.abs(correlation[-1][1:]).max())
        yield SensorResidual(
            sensor,
            time,
            shown[0],
            None if after is None else shown[1],
            np.arange(lags) * w.period,
            correlation[0],
            None if after is None else correlation[1],
            float(1.96 / np.sqrt(w.valid.sum())),
            _said(sensor, white, float(correlation[-1][1]), float(np.sqrt(np.mean(left[-1][w.valid] ** 2)))),
        )


def _said(sensor: str, white: float, next_to: float, size: float) -> str:
    """Whether what is left of a sensor looks like noise: by how it correlates, and by its size, times the noise."""
    if white < VERDICT.white:
        return f"What is left of {sensor} looks like noise: no lag correlates by more than {white:.2f}."
    if size <= SCORE.at_floor:
        return (
            f"What is left of {sensor} is as small as its noise ({size:.2f} times), though not without a pattern: "
            f"neighbouring samples correlate by {next_to:.2f}."
        )
    return f"What is left of {sensor} is not noise: neighbouring samples correlate by {next_to:.2f}."


def _autocorrelation(residual: Array, valid: NDArray[np.bool_], lags: int) -> Array:
    """Autocorrelation within windows, averaged over them."""
    residual = np.where(valid, residual, 0.0)
    power = np.array([np.sum(residual[:, : residual.shape[1] - lag] * residual[:, lag:]) for lag in range(lags)])
    pairs = np.array([np.sum(valid[:, : residual.shape[1] - lag] & valid[:, lag:]) for lag in range(lags)])
    mean = power / np.maximum(pairs, 1)
    return mean / max(mean[0], 1e-300)


def _difference(source: mjcf.Source, improved: str) -> str:
    if improved == source.text:
        return ""
    before, name = Document(source).text(), source.path.name if source.path else "model.xml"
    lines = difflib.unified_diff(before.splitlines(), improved.splitlines(), name, "improved.xml", lineterm="", n=2)
    return "\n".join(lines)
