"""Write a diagnosis into a folder: diagnosis.json, improved.xml, report.html."""

from __future__ import annotations

import difflib
import json
import os
import shutil
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dipc_gym import mjcf
from dipc_gym.files import write_whole
from dipc_gym.mjcf.edit import Document
from dipc_gym.places import inside
from dipc_gym.recording.units import of_sensor
from dipc_gym.sim2real.estimation.fit import readings
from dipc_gym.sim2real.estimation.segments import joined
from dipc_gym.sim2real.report import page
from dipc_gym.sim2real.result import Diagnosis, Work
from dipc_gym.sim2real.selection.score import compare
from dipc_gym.sim2real.verdict.late import finite

Array = NDArray[np.float64]

DRAFTS = ".diagnosis-"  # what the folder of files that are not in place yet is called, with a few letters more
LAGS = 60  # of the autocorrelation shown
WHITE = 0.1  # an autocorrelation below this at every lag shown passes for noise; quantisation leaves a little


def save(found: Diagnosis, folder: Path, *, model: str, command: str, overwrite: bool = False) -> Path:
    """Write a diagnosis; each file appears whole or not at all, and none before all are made.

    Args:
        found: what was found.
        folder: to write into; made if it does not exist.
        model: name of the model's file, for the report.
        command: that makes this again.
        overwrite: whether a folder that is not empty may be replaced. Only the files that are written are.

    Raises:
        FileExistsError: the folder is not empty, or is a file.
        OSError: a file cannot be written; the message says at which, and which are whole.

    Returns:
        The folder.
    """
    check_free(folder, overwrite)
    drawn = _page(found, model, command).encode()
    said = json.dumps(finite(found.to_dict()), indent=2, allow_nan=False) + "\n"
    texts = {
        **found.files,
        "improved.xml": found.improved.encode(),
        "report.html": drawn,
        "diagnosis.json": said.encode(),
    }
    whole: list[str] = []
    at_work = "."
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for old in folder.glob(f"{DRAFTS}*"):  # of a run that was killed
            shutil.rmtree(old, ignore_errors=True)
        with tempfile.TemporaryDirectory(dir=folder, prefix=DRAFTS) as draft:
            for at_work, text in texts.items():
                file = inside(draft, at_work)
                file.parent.mkdir(parents=True, exist_ok=True)
                write_whole(file, text)
            for at_work in texts:
                place = inside(folder, at_work)
                place.parent.mkdir(parents=True, exist_ok=True)
                (Path(draft) / at_work).replace(place)
                whole.append(at_work)
    except OSError as error:
        stand = (
            f"whole are {', '.join(whole)} alone" if whole else "nothing was written, and what was there is untouched"
        )
        reason = os.strerror(error.errno) if error.errno else error
        raise OSError(error.errno, f"{reason}, at {at_work}; {stand}", str(folder)) from error
    return folder


def _page(found: Diagnosis, model: str, command: str) -> str:
    """The page; without figures if one cannot be drawn, for what was found goes before."""
    try:
        return page.render(report_data(found, model, command))
    except Exception as error:  # whatever it is, the other files wait for this one
        said = f"The figures could not be drawn ({type(error).__name__}: {error}). Please report this with the files."
        bare = page.ReportData(model, finite(found.to_dict()), command=command, notes=(*found.notes, said))
        return page.render(bare)


def check_free(folder: Path, overwrite: bool) -> None:
    """Refuse a folder that holds something, or that cannot be written: before the work rather than after it.

    Raises:
        FileExistsError: with what to do.
        PermissionError: likewise.
    """
    nearest = next(place for place in (folder, *folder.absolute().parents) if place.exists())
    if not nearest.is_dir():
        raise FileExistsError(f"{nearest} is a file; name a folder for the results")
    if not os.access(nearest, os.W_OK | os.X_OK):
        raise PermissionError(f"{nearest} may not be written; name another folder for the results")
    if folder.is_dir() and any(folder.iterdir()) and not (overwrite or _unfinished(folder)):
        raise FileExistsError(f"{folder} is not empty; name another folder or add --overwrite")


def _unfinished(folder: Path) -> bool:
    """Whether a diagnosis was killed while it wrote here: its drafts are there, and what comes last is not."""
    return any(folder.glob(f"{DRAFTS}*")) and not (folder / "diagnosis.json").exists()


def report_data(found: Diagnosis, model: str, command: str) -> page.ReportData:
    """What the page shows of a diagnosis."""
    diagnosis = finite(found.to_dict())
    work = found.work
    if work is None:
        return page.ReportData(model, diagnosis, command=command, notes=found.notes)
    before = "recalibrated" if work.recalibrated.structure.model_parameters else "nominal"
    held = {
        name: readings(work.held, fitted.structure, fitted.z)
        for name, fitted in (("nominal", work.nominal), ("recalibrated", work.recalibrated), ("improved", work.final))
    }
    structural = bool(work.final.structure.terms)
    return page.ReportData(
        model,
        diagnosis,
        before,  # type: ignore[arg-type]
        _traces(work, held, structural),
        _maps(work, structural, [x.at for x in found.located]),
        _candidates(work),
        _residuals(work, held, before, structural),
        _difference(work, found.improved),
        command,
        found.notes,
    )


def _traces(work: Work, held: dict[str, Array], structural: bool) -> list[page.Trace]:
    w = work.held.windows
    rec = w.recordings
    traces = []
    for k, sensor in enumerate(rec[0].sensor_names):
        for i, recording in enumerate(rec):
            mine = np.flatnonzero(w.source == i)
            if not len(mine):
                continue
            time = joined((w.start[:, None] + w.times)[mine], w.valid[mine])
            values = {name: joined(readings[mine, :, k], w.valid[mine]) for name, readings in held.items()}
            observed = joined(w.observed[mine, :, k], w.valid[mine])
            traces.append(
                (
                    float(np.nanmean((observed - values["nominal"]) ** 2) / max(w.noise[k] ** 2, 1e-300)),
                    page.Trace(
                        sensor,
                        of_sensor(work.prepared.structure.model, sensor),
                        recording.name,
                        _rising(time),
                        observed,
                        values["nominal"],
                        values["recalibrated"],
                        values["improved"] if structural else None,
                    ),
                )
            )
    return [trace for _, trace in sorted(traces, key=lambda t: -t[0])]


def _rising(time: Array) -> Array:
    """Times with the gaps filled by a moment just after the last sample."""
    gaps = np.flatnonzero(np.isnan(time))
    time = time.copy()
    time[gaps] = time[gaps - 1] + 1e-9
    return time


def _maps(work: Work, structural: bool, order: Sequence[str]) -> list[page.Mismatch]:
    structure = work.prepared.structure
    look = work.search.question.look
    first = look(work.recalibrated if work.recalibrated.structure.model_parameters else work.nominal)
    after = look(work.final) if structural else None
    maps = []
    for j, joint in enumerate(structure.base):
        hinge = mjcf.is_hinge(structure.model, joint)
        maps.append(
            page.Mismatch(
                joint,
                "N m" if hinge else "N",
                "rad" if hinge else "m",
                first.time,
                first.position[:, j],
                first.velocity[:, j],
                first.force[:, j],
                None if after is None else after.force[:, j],
            )
        )
    return sorted(maps, key=lambda m: order.index(m.joint))


def _candidates(work: Work) -> list[page.Candidate]:
    """Every hypothesis once, as the last round that fitted it saw it."""
    search = work.search
    chosen = {term.key for term in work.final.structure.terms}
    status = {
        r.term.key: ("same model here" if r.same else "ruled out" if r.ruled_out else "not told apart")
        for rs in work.replaced.values()
        for r in rs
    }
    otherwise = "not told apart" if search.interrupted else "ruled out"
    rows: dict[str, page.Candidate] = {}
    baseline = search.progress.path[0]
    for tried in [t for r in reversed(search.progress.rounds) for t in r]:
        if tried.key in rows and (rows[tried.key].error is not None or tried.sketch is None):
            continue
        words = (tried.term.effect.__doc__ or "").split("\n")[0].rstrip(".")
        if tried.sketch is None:
            rows[tried.key] = page.Candidate(tried.term.effect.name, tried.term.at, words, "screened out")
            continue
        if tried.fitted is not None:
            error = tried.fitted.error
            gain = search.scorer.compare_apart(tried.fitted, baseline)
        else:  # the windows of a sketch are among the worse ones
            subset = search.partition.known_to(tried.sketch)
            error = tried.sketch.error * baseline.error / float(np.sqrt(np.mean(baseline.mse[subset])))
            gain = compare(tried.sketch.mse, baseline.mse[subset], search.partition.problem.blocks[subset])
        rows[tried.key] = page.Candidate(
            tried.term.effect.name,
            tried.term.at,
            words,
            "chosen" if tried.key in chosen else status.get(tried.key, otherwise),  # type: ignore[arg-type]
            error,
            gain.gain,
            gain.error if np.isfinite(gain.error) else None,
        )
    rank = {"chosen": 0, "same model here": 1, "not told apart": 2, "ruled out": 3, "screened out": 4}
    return sorted(rows.values(), key=lambda c: (rank[c.status], c.error if c.error is not None else np.inf))


def _residuals(work: Work, held: dict[str, Array], before: str, structural: bool) -> list[page.SensorResidual]:
    w = work.held.windows
    out = []
    for k, sensor in enumerate(w.recordings[0].sensor_names):
        if not np.isfinite(w.noise[k]):
            continue
        residual = {n: (w.observed[..., k] - held[n][..., k]) / w.noise[k] for n in (before, "improved")}
        lags = min(LAGS, w.valid.shape[1] // 2)
        correlation = {n: _autocorrelation(r, w.valid, lags) for n, r in residual.items()}
        last = correlation["improved" if structural else before]
        band = 1.96 / np.sqrt(w.valid.sum())
        white = float(np.abs(last[1:]).max())
        words = (
            f"What is left of {sensor} looks like noise: no lag correlates by more than {white:.2f}."
            if white < WHITE
            else f"What is left of {sensor} is not noise: neighbouring samples correlate by {last[1]:.2f}."
        )
        time = _rising(joined(w.start[:, None] + w.times, w.valid))
        out.append(
            page.SensorResidual(
                sensor,
                time,
                joined(residual[before], w.valid),
                joined(residual["improved"], w.valid) if structural else None,
                np.arange(lags) * w.period,
                correlation[before],
                correlation["improved"] if structural else None,
                float(band),
                words,
            )
        )
    return out


def _autocorrelation(residual: Array, valid: NDArray[np.bool_], lags: int) -> Array:
    """Autocorrelation within windows, averaged over them."""
    residual = np.where(valid, residual, 0.0)
    power = np.array([np.sum(residual[:, : residual.shape[1] - lag] * residual[:, lag:]) for lag in range(lags)])
    pairs = np.array([np.sum(valid[:, : residual.shape[1] - lag] & valid[:, lag:]) for lag in range(lags)])
    mean = power / np.maximum(pairs, 1)
    return mean / max(mean[0], 1e-300)


def _difference(work: Work, improved: str) -> str:
    before = Document(work.source).text()
    if improved == work.source.text:
        return ""
    lines = difflib.unified_diff(
        before.splitlines(), improved.splitlines(), "model.xml", "improved.xml", lineterm="", n=2
    )
    return "\n".join(lines)
