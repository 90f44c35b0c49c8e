"""Run the diagnosis tool on a trial, through its command line and on files only, and note what becomes of it."""

from __future__ import annotations

import functools
import hashlib
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import dipc_gym
from dipc_gym.safety import intact
from dipc_gym.safety.places import inside
from dipc_gym.trials.covered import error_of, error_within
from dipc_gym.trials.records import digests

GIVEN = ("nominal.xml", "train_1.csv", "train_2.csv")
PATIENCE = 1800.0
"""Seconds after which a diagnosis is stopped and counts as failed."""
WINDOW = 0.25  # s, windows that a model is judged on
CONVERGED = 0.001
"""Step at which a model is judged, s: Runge-Kutta with located reversals, so that what is left is not integration.
A quarter of it moves no error by a hundredth of the noise."""
INTERRUPTED = (-signal.SIGINT, 128 + signal.SIGINT)  # exit codes of a diagnosis that Ctrl-C ended


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


def replay_tool(model: Path, recording: Path, *, step: float | None) -> dict[str, Any]:
    """Prediction error of a model on a recording, as the tool's `replay` command measures it.

    Args:
        model: MJCF file.
        recording: CSV file.
        step: s; None for the model's own integrator and step.

    Returns:
        What it says of windows of 0.25 s: errors of each sensor in SI units, and of each window in units of noise.
    """
    with tempfile.TemporaryDirectory(prefix="replay-") as place:
        out = Path(place) / "replay.json"
        command = [sys.executable, "-m", "dipc_gym", "replay", str(model.absolute()), str(recording.absolute())]
        command += ["--window", str(WINDOW), "--json", str(out)]
        _call(command + ([] if step is None else ["--step", str(step)]), Path(place), PATIENCE)
        return _read(out)


def _by_sensor(replayed: dict[str, Any]) -> dict[str, float]:
    return {name: error_of(sensor) for name, sensor in replayed["sensors"].items()}


def _read(path: Path) -> dict[str, Any]:
    try:
        found: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:
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


@functools.cache
def tool() -> str:
    """SHA-256 of the tool's sources, those of the trial left out: results of two versions do not make one rate."""
    package = Path(dipc_gym.__file__).parent
    digest = hashlib.sha256()
    for file in sorted(package.rglob("*.py")):
        if file.relative_to(package).parts[0] != "trials":
            digest.update(hashlib.sha256(file.read_bytes()).digest())
    return digest.hexdigest()


@dataclass(frozen=True, kw_only=True)
class Attempt:
    """Diagnose one trial, and test its improved model on the recording that the tool never saw.

    All is done in temporary folders, out of the tool's reach to the sealed answers, and out of the way of other nodes.

    Attributes:
        folder: of the trial; other nodes need it under the same path.
        seed: the tool's.
        limit: seconds before the tool is stopped, and the trial counts as failed.
    """

    folder: str
    seed: int
    limit: float

    @property
    def name(self) -> str:
        """Of the trial."""
        return Path(self.folder).name

    def run(self) -> dict[str, str]:
        """Diagnose; a failure is a result too, which is noted and scored as one.

        Returns:
            Texts by name of file: what the tool wrote, and `attempt.json`. That has the tool's version, seconds and
            their limit, what went wrong or null, whether time was up, and the errors by sensor on `test.csv` of a
            converged simulation (`sensor_errors`) and at the file's own step; of the former also the error in windows
            that go no further than the recordings that the tool was given (`error_within`).

        Raises:
            KeyboardInterrupt: the tool was interrupted, which is no failure.
            OSError: the trial's files are not there.
        """
        begun = time.perf_counter()
        note: dict[str, Any] = {"trial": self.name, "tool": tool(), "limit": self.limit, "failure": None}
        unknown = ("sensor_errors", "sensor_errors_own_step", "error_within", "replay_failure")
        note |= {"timed_out": False, **dict.fromkeys(unknown)}
        folder = Path(self.folder)
        with tempfile.TemporaryDirectory(prefix="result-") as place:
            result = Path(place) / "result"
            try:
                diagnosis = run_tool(folder, result, seed=self.seed, patience=self.limit)
            except RuntimeError as error:
                note["failure"], note["timed_out"] = str(error), isinstance(error, TookTooLong)
            note["seconds"] = time.perf_counter() - begun
            if note["failure"] is None:
                improved = inside(result, diagnosis.get("improved_model") or "improved.xml")
                model = improved if improved.exists() else folder / "nominal.xml"
                try:
                    test = folder / "test.csv"
                    replayed = replay_tool(model, test, step=CONVERGED)
                    note["sensor_errors"] = _by_sensor(replayed)
                    note["error_within"] = error_within([folder / name for name in GIVEN[1:]], test, replayed)
                    note["sensor_errors_own_step"] = _by_sensor(replay_tool(model, test, step=None))
                except RuntimeError as error:
                    note["replay_failure"] = str(error)
            written = {path.name: path.read_text(encoding="utf-8") for path in result.glob("*")}
        note["files"] = digests({name: text.encode() for name, text in written.items()})
        return {**written, "attempt.json": json.dumps(intact.signed(note), indent=1)}

    def check(self, result: Any) -> None:
        """Refuse what are no texts by name."""
        intact.fit(result, {str: str})
