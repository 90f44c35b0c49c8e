"""Run the diagnosis tool on trials, through its command line and on files only, and score what it says."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from dipc_gym.trials.generate import generate
from dipc_gym.trials.publish import write_report
from dipc_gym.trials.score import score

GIVEN = ("nominal.xml", "train_1.csv", "train_2.csv")
PATIENCE = 1800.0
"""Seconds after which a diagnosis is stopped and counts as failed."""
WINDOW = 0.25
CONVERGED = 0.001
"""Step at which a model is judged, s: Runge-Kutta with located reversals, so that what is left is not integration.
A quarter of it moves no error by a hundredth of the noise."""
INTERRUPTED = (-signal.SIGINT, 128 + signal.SIGINT)


class TookTooLong(RuntimeError):
    """The tool was stopped because its time was up."""


def run_tool(folder: Path, out: Path, *, seed: int = 0, patience: float = PATIENCE) -> dict[str, Any]:
    """Diagnose one trial: what a user would type, on copies of the given files in a folder with nothing else in it.

    Args:
        folder: trial folder.
        out: where the tool writes.
        seed: the tool's.
        patience: seconds before the tool is stopped.

    Returns:
        The diagnosis.

    Raises:
        TookTooLong: the time was up.
        RuntimeError: the tool failed or left no readable diagnosis; its last words are quoted.
        KeyboardInterrupt: the tool was interrupted.
    """
    shutil.rmtree(out, ignore_errors=True)
    with tempfile.TemporaryDirectory(prefix="trial-") as place:
        for name in GIVEN:
            shutil.copy(folder / name, Path(place) / name)
        command = [sys.executable, "-m", "dipc_gym", "diagnose", *GIVEN, "--out", str(out.absolute()), "--jobs", "1"]
        _call([*command, "--seed", str(seed)], Path(place), patience)
    written = out / "diagnosis.json"
    if not written.exists():
        raise RuntimeError(f"{folder.name}: the tool ended well but left no {written}")
    return _read(written)


def replay_tool(model: Path, recording: Path, *, step: float | None) -> dict[str, float]:
    """Prediction error of a model on a recording, as the tool's `replay` command measures it.

    Args:
        model: MJCF file.
        recording: CSV file.
        step: s; None for the model's own integrator and step.

    Returns:
        Root mean square error of each sensor in windows of 0.25 s, SI units.
    """
    with tempfile.TemporaryDirectory(prefix="replay-") as place:
        out = Path(place) / "replay.json"
        command = [sys.executable, "-m", "dipc_gym", "replay", str(model.absolute()), str(recording.absolute())]
        command += ["--window", str(WINDOW), "--json", str(out)]
        _call(command + ([] if step is None else ["--step", str(step)]), Path(place), PATIENCE)
        return {name: sensor["error"] for name, sensor in _read(out)["sensors"].items()}


def _read(path: Path) -> dict[str, Any]:
    try:
        found: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise RuntimeError(f"{path} is not JSON: {error}") from None
    return found


def _call(command: list[str], place: Path, patience: float) -> None:
    single = {name: "1" for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")}
    try:
        done = subprocess.run(
            command, cwd=place, env={**os.environ, **single}, capture_output=True, text=True, timeout=patience
        )
    except subprocess.TimeoutExpired:
        raise TookTooLong(f"{command[3]} took longer than {patience:.0f} s") from None
    if done.returncode in INTERRUPTED:
        raise KeyboardInterrupt
    if done.returncode != 0:
        raise RuntimeError(f"{command[3]} ended with {done.returncode}: {done.stderr.strip()[-2000:]}")


def attempt(folder: Path, result: Path, *, seed: int, patience: float = PATIENCE) -> dict[str, Any]:
    """Diagnose one trial, judge its improved model on the recording that the tool never saw, note it all.

    A failure is a result too: it is written down and scored as one. An interruption is not.

    Args:
        folder: trial folder.
        result: where `diagnosis.json`, `improved.xml` and `attempt.json` go.
        seed: the tool's.
        patience: seconds before the tool is stopped.

    Returns:
        What was written to `attempt.json`: seconds and their limit, what went wrong or None, whether time was up,
        errors by sensor on `test.csv` of a converged simulation (`sensor_errors`) and at the file's own step.
    """
    begun = time.perf_counter()
    note: dict[str, Any] = {"trial": folder.name, "limit": patience, "failure": None, "timed_out": False}
    note |= {"sensor_errors": None, "sensor_errors_own_step": None, "replay_failure": None}
    try:
        diagnosis = run_tool(folder, result, seed=seed, patience=patience)
    except RuntimeError as error:
        note["failure"], note["timed_out"] = str(error), isinstance(error, TookTooLong)
    note["seconds"] = time.perf_counter() - begun
    if note["failure"] is None:
        improved = result / (diagnosis.get("improved_model") or "improved.xml")
        model = improved if improved.exists() else folder / "nominal.xml"
        try:
            note["sensor_errors"] = replay_tool(model, folder / "test.csv", step=CONVERGED)
            note["sensor_errors_own_step"] = replay_tool(model, folder / "test.csv", step=None)
        except RuntimeError as error:
            note["replay_failure"] = str(error)
    result.mkdir(parents=True, exist_ok=True)
    (result / "attempt.json").write_text(json.dumps(note, indent=1), encoding="utf-8")
    return note


def _done(result: Path) -> bool:
    note = result / "attempt.json"
    return note.exists() and json.loads(note.read_text(encoding="utf-8"))["failure"] is None


def trial(
    out: Path, *, seed: int = 1, count: int | None = None, full: bool = False, jobs: int = 1, resume: bool = True,
    patience: float = PATIENCE,
) -> dict[str, Any]:  # fmt: skip
    """The blind trial: generate, diagnose, score.

    Args:
        out: folder; gets `trials/`, `sealed/`, `results/`, `report.md`, `report.json` and `report.png`.
        seed: determines the trials.
        count: number of trials; None: 42, or 430 with `full`.
        full: the long version.
        jobs: trials at a time.
        resume: keep the diagnoses that are there, failures aside; otherwise diagnose everything anew.
        patience: seconds before a diagnosis is stopped and counts as failed.

    Returns:
        The scores, as in `report.json`.

    Raises:
        ValueError: `out` holds trials of another seed or composition.
        KeyboardInterrupt: after what is done was scored.
    """
    from joblib import Parallel, delayed
    from tqdm import tqdm

    made = generate(out, seed=seed, count=count, full=full, jobs=jobs)
    names = [plan.name for plan in made]
    results = out / "results"
    open_ones = [name for name in names if not (resume and _done(results / name))]
    try:
        # The tool runs in processes of its own; here threads wait for them.
        runs = Parallel(n_jobs=jobs, prefer="threads", return_as="generator_unordered")(
            delayed(attempt)(out / "trials" / name, results / name, seed=0, patience=patience) for name in open_ones
        )
        for _ in tqdm(runs, total=len(open_ones), desc="diagnose", disable=None):
            pass
    finally:
        scores = score(out, names)
        write_report(out, scores, seed=seed)
    return scores
