"""Every example runs."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).resolve().parent.parent / "examples"
QUICKLY = {"balance.py": ["--seconds", "1"], "worn_rig.py": ["--seconds", "1"]}
QUICKLY["train_policy.py"] = ["--steps", "2000", "--rollout", "125", "--rigs", "8", "--seconds", "1"]


@pytest.mark.parametrize("file", sorted(path.name for path in EXAMPLES.glob("*.py")))
def test_example_runs(file: str, tmp_path: Path) -> None:
    command = [sys.executable, str(EXAMPLES / file), *QUICKLY.get(file, [])]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout
