"""Run the diagnosis tool on trials, through its command line and on files only, and score what it says."""

from __future__ import annotations

import json
import os
import shutil
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
PATIENCE = 1800
"""Seconds after which a diagnosis counts as failed."""


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
        RuntimeError: the tool failed, took too long, or left no diagnosis; its last words are quoted.
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
    found: dict[str, Any] = json.loads(written.read_text(encoding="utf-8"))
    return found


def replay_tool(model: Path, recording: Path, *, window: float) -> dict[str, Any]:
    """Prediction error of a model on a recording, as the tool's `replay` command measures it.

    Args:
        model: MJCF file.
        recording: CSV file.
        window: seconds.

    Returns:
        What `--json` writes; `sensors` has the root mean square error of each in SI units.
    """
    with tempfile.TemporaryDirectory(prefix="replay-") as place:
        out = Path(place) / "replay.json"
        command = [sys.executable, "-m", "dipc_gym", "replay", str(model.absolute()), str(recording.absolute())]
        _call([*command, "--window", str(window), "--json", str(out)], Path(place), PATIENCE)
        found: dict[str, Any] = json.loads(out.read_text(encoding="utf-8"))
        return found


def _call(command: list[str], place: Path, patience: float) -> None:
    single = {name: "1" for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")}
    try:
        done = subprocess.run(
            command, cwd=place, env={**os.environ, **single}, capture_output=True, text=True, timeout=patience
        )
    except subprocess.TimeoutExpired:
        raise RuntimeError(f"{command[3]} took longer than {patience:.0f} s") from None
    if done.returncode != 0:
        raise RuntimeError(f"{command[3]} ended with {done.returncode}: {done.stderr.strip()[-2000:]}")


def attempt(folder: Path, result: Path, *, seed: int) -> dict[str, Any]:
    """Diagnose one trial, judge its improved model on the recording that the tool never saw, note it all.

    A failure is a result too: it is written down and scored as one.

    Args:
        folder: trial folder.
        result: where `diagnosis.json`, `improved.xml` and `attempt.json` go.
        seed: the tool's.

    Returns:
        What was written to `attempt.json`: seconds, what went wrong or None, errors by sensor on `test.csv`.
    """
    begun = time.perf_counter()
    note: dict[str, Any] = {"trial": folder.name, "failure": None, "sensor_errors": None}
    try:
        diagnosis = run_tool(folder, result, seed=seed)
        note["seconds"] = time.perf_counter() - begun
        improved = result / (diagnosis.get("improved_model") or "improved.xml")
        model = improved if improved.exists() else folder / "nominal.xml"
        replayed = replay_tool(model, folder / "test.csv", window=0.25)
        note["sensor_errors"] = {name: sensor["error"] for name, sensor in replayed["sensors"].items()}
    except RuntimeError as error:
        note.setdefault("seconds", time.perf_counter() - begun)
        note["failure"] = str(error)
    result.mkdir(parents=True, exist_ok=True)
    (result / "attempt.json").write_text(json.dumps(note, indent=1), encoding="utf-8")
    return note


def _done(result: Path) -> bool:
    note = result / "attempt.json"
    return note.exists() and json.loads(note.read_text(encoding="utf-8"))["failure"] is None


def trial(
    out: Path, *, seed: int = 1, count: int | None = None, full: bool = False, jobs: int = 1, resume: bool = True
) -> dict[str, Any]:  # fmt: skip
    """The blind trial: generate, diagnose, score.

    Args:
        out: folder; gets `trials/`, `sealed/`, `results/`, `report.md`, `report.json` and `report.png`.
        seed: determines the trials.
        count: number of trials; None: 42, or 430 with `full`.
        full: the long version.
        jobs: trials at a time.
        resume: keep the diagnoses that are there, failures aside; otherwise diagnose everything anew.

    Returns:
        The scores, as in `report.json`.

    Raises:
        ValueError: `out` holds trials of another seed or composition.
    """
    from joblib import Parallel, delayed
    from tqdm import tqdm

    made = generate(out, seed=seed, count=count, full=full, jobs=jobs)
    results = out / "results"
    open_ones = [plan.name for plan in made if not (resume and _done(results / plan.name))]
    runs = Parallel(n_jobs=jobs, return_as="generator_unordered")(
        delayed(attempt)(out / "trials" / name, results / name, seed=0) for name in open_ones
    )
    for _ in tqdm(runs, total=len(open_ones), desc="diagnose", disable=None):
        pass
    scores = score(out, [plan.name for plan in made])
    write_report(out, scores, seed=seed)
    return scores
