"""The blind trial: generate, diagnose some at a time, and score what the tool says."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from dipc_gym import sweep
from dipc_gym.safety import intact
from dipc_gym.safety.alone import alone
from dipc_gym.safety.files import write_whole
from dipc_gym.safety.intact import DamagedError
from dipc_gym.safety.places import inside
from dipc_gym.sweep import Backend, Cell
from dipc_gym.trials import records
from dipc_gym.trials.attempt import PATIENCE, Attempt, tool
from dipc_gym.trials.generate import generate, plans
from dipc_gym.trials.publish import write_report
from dipc_gym.trials.score import score
from dipc_gym.trials.secret import Plan


def trial(
    out: Path, *, seed: int, count: int | None = None, full: bool = False, laws: bool = False,
    jobs: int | None = None, backend: Backend = "local", patience: float = PATIENCE,
) -> dict[str, Any]:  # fmt: skip
    """The blind trial: generate, diagnose, score.

    Args:
        out: folder; gets `trials/`, `sealed/`, `results/`, `report.md`, `report.json`, `report.png` and its PDFs.
        seed: determines the trials.
        count: number of trials; None: 42, 430 with `full`, 150 with `laws`.
        full: the long version.
        laws: the trial of laws.
        jobs: trials at a time; see `sweep.run`.
        backend: where the tool runs; on a cluster the nodes must share `out`. See `sweep.run`.
        patience: seconds before a diagnosis is stopped and counts as failed.

    Returns:
        The scores, as in `report.json`.

    Raises:
        ValueError: `out` holds trials of another seed or composition, or results of another version of the tool; or
            see `sweep.run`.
        BusyError: another run is at work in `out`.
        ImportError: Ray is asked for and not installed.
        KeyboardInterrupt: after what is done was scored.
    """
    sweep.check(jobs, backend)
    with alone(out):
        planned = plans(seed, count=count, full=full, laws=laws)
        return _trial(out, planned, seed, count, full, laws, jobs, backend, patience)


def _trial(
    out: Path, planned: Sequence[Plan], seed: int, count: int | None, full: bool, laws: bool, jobs: int | None,
    backend: Backend, patience: float,
) -> dict[str, Any]:  # fmt: skip
    # Rates of false alarms take the most trials and the least time: a run that is stopped early has these.
    order = [plan.name for plan in sorted(planned, key=lambda plan: plan.kind != "null")]
    attempts = [
        Attempt(folder=str((out / "trials" / name).absolute()), seed=0, limit=patience)
        for name in order
        if not _done(out, name)
    ]
    generate(out, seed=seed, count=count, full=full, laws=laws, jobs=processes(jobs, backend))
    try:
        for name, texts in swept(attempts, jobs=jobs, backend=backend, label="diagnose"):
            _keep(texts, inside(out, f"results/{name}"))
    finally:
        scores = score(out, [plan.name for plan in planned])
        write_report(out, scores, seed=seed)
    return scores


def swept(cells: Sequence[Cell], *, jobs: int | None, backend: Backend, label: str) -> Iterator[tuple[str, Any]]:
    """Run cells, and give names and results as they finish; one that breaks off is reported and stays open.

    What is finished stands in `results/`, and by that a run goes on; the files that `sweep.run` writes are not kept.
    """
    with tempfile.TemporaryDirectory(prefix="sweep-") as place:
        for outcome in sweep.run(cells, place, jobs=jobs, backend=backend, label=label):
            if outcome.failure is None:
                yield outcome.cell.name, outcome.result
            else:
                said = f"{outcome.cell.name}: {outcome.failure}; the same command tries it again"
                print(said, file=sys.stderr)


def processes(jobs: int | None, backend: Backend) -> int:
    """How many of the trials are generated at a time, which is done on this machine."""
    return jobs if jobs is not None and backend == "local" else sweep.LOCAL_JOBS


def _done(out: Path, name: str) -> bool:
    note = inside(out, f"results/{name}/attempt.json")
    if not note.exists():
        return False
    try:
        said, _ = records.attempt(out, name)
        if said["failure"] is None and _answered(out, name):
            records.graded(out, name)
    except DamagedError as damage:
        intact.set_aside(note, damage)
        return False
    if said["failure"] is None and said.get("tool") != tool():
        raise ValueError(
            f"{note}: diagnosed by another version of the tool, and the two make no rate; choose another folder, or "
            f"remove {note.parent.parent} to diagnose all anew"
        )
    return said["failure"] is None


def _answered(out: Path, name: str) -> bool:
    """Whether a trial and its answer are whole; what is not is made again from the seed, the same."""
    try:
        records.answer(out, name)
    except DamagedError:
        return False
    return True


def _keep(texts: Mapping[str, str], result: Path) -> None:
    """Write what an attempt gave; its note comes last, for it says that all is there. What rivals gave stays."""
    result.mkdir(parents=True, exist_ok=True)
    (result / "attempt.json").unlink(missing_ok=True)
    for old in result.iterdir():
        if old.is_file() and old.name != "rivals.json" and old.suffix != intact.ASIDE:
            old.unlink()
    for name in sorted(texts, key="attempt.json".__eq__):
        write_whole(inside(result, name), texts[name].encode())
