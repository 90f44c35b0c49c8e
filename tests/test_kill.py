"""kill -9 at a few moments of a small comparison; `make kill` does it to every command, at twenty moments each."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

ARGUMENTS = ["compare", "--compensator", "none,feedforward", "--seeds", "2", "--seconds", "2", "--jobs", "2"]


def start(out: Path) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", "dipc_gym", *ARGUMENTS, "--out", str(out)]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True)


def content(out: Path) -> dict[str, bytes]:
    kinds = ("cells/*.json", "compensators/*", "recordings/*", "summary.json", "table.txt")
    return {p.relative_to(out).as_posix(): p.read_bytes() for kind in kinds for p in out.glob(kind)}


def test_a_killed_comparison_goes_on_to_the_same_bits(tmp_path: Path) -> None:
    """Killed at its first cell, once more at its fourth, the process alone and then its group."""
    out = tmp_path / "killed"
    for cells, kill in ((1, os.kill), (4, os.killpg)):
        process = start(out)
        deadline = time.monotonic() + 120
        while len(list(out.glob("cells/*.json"))) < cells and process.poll() is None and time.monotonic() < deadline:
            time.sleep(0.01)
        kill(process.pid, signal.SIGKILL)
        process.wait()
    kept = {path: path.stat().st_mtime_ns for path in out.glob("cells/*.json")}
    assert len(kept) >= 4
    assert start(out).wait() == 0
    assert all(path.stat().st_mtime_ns == then for path, then in kept.items()), "what was whole is not done again"
    assert start(tmp_path / "calm").wait() == 0
    assert content(out) == content(tmp_path / "calm")
    assert len(content(out)) > 8
    assert not [path for path in out.rglob(".*")]
