"""Every example runs."""

from __future__ import annotations

import runpy
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dipc_gym.wrappers import VectorForceCommand

EXAMPLES = Path(__file__).resolve().parent.parent / "examples"
QUICKLY = {"balance.py": ["--seconds", "1"], "worn_rig.py": ["--seconds", "1"]}
QUICKLY["train_policy.py"] = ["--steps", "2000", "--rollout", "125", "--num-envs", "8", "--seconds", "1"]


def test_what_falls_as_time_ends_is_worth_nothing_more(monkeypatch: pytest.MonkeyPatch) -> None:
    """The policy's trainer asks for no observation to value where both happen at once."""
    pytest.importorskip("torch")
    real = VectorForceCommand.step

    def both(envs: VectorForceCommand, forces: np.ndarray) -> tuple[Any, ...]:
        observations, rewards, *_ = real(envs, forces)
        ended = np.ones(envs.num_envs, dtype=bool)
        return observations, rewards, ended, ended, {}

    monkeypatch.setattr(VectorForceCommand, "step", both)
    monkeypatch.setattr(
        sys, "argv", ["train_policy.py", "--num-envs", "8", "--rollout", "4", "--steps", "32", "--seconds", "0.01"]
    )
    runpy.run_path(str(EXAMPLES / "train_policy.py"), run_name="__main__")


@pytest.mark.parametrize("file", sorted(path.name for path in EXAMPLES.glob("*.py")))
def test_example_runs(file: str, tmp_path: Path) -> None:
    command = [sys.executable, str(EXAMPLES / file), *QUICKLY.get(file, [])]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout


def test_an_own_effect_is_promised_where_it_is_tried() -> None:
    """It is registered in a program: the command line is another one, and never hears of it."""
    said = " ".join((EXAMPLES / "own_effect.py").read_text(encoding="utf-8").split('"""')[1].split())
    assert "The command line knows the catalogue only" in said
    assert "the command line compare" not in said


def test_recordings_of_the_arm_are_what_the_script_beside_them_makes(tmp_path: Path) -> None:
    folder = EXAMPLES / "diagnose"
    subprocess.run([sys.executable, str(folder / "record.py"), "--out", str(tmp_path)], check=True, capture_output=True)
    for name in ("run_1.csv", "run_2.csv"):
        shipped, made = (np.loadtxt(place / name, delimiter=",", skiprows=1) for place in (folder, tmp_path))
        np.testing.assert_array_equal(made[:, :2], shipped[:, :2])  # time and command
        count = 2 * np.pi / 8192
        np.testing.assert_allclose(made[:, 2], shipped[:, 2], atol=1.01 * count)  # where a machine rounds otherwise
