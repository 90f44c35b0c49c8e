"""What lies in the current folder gives no orders: settings of libraries, caches of compiled code."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from dipc_gym import cli
from dipc_gym.engine import machine
from dipc_gym.recording.tables import write_table

MODEL = """<mujoco model="axis"><option timestep="0.002"/><worldbody><body><joint name="axis" damping="0.1"/>
<geom type="capsule" size="0.02 0.2" mass="0.5" contype="0" conaffinity="0"/></body></worldbody>
<actuator><motor name="motor" joint="axis" ctrlrange="-5 5"/></actuator>
<sensor><jointpos name="$x^" joint="axis"/></sensor></mujoco>"""


def test_settings_of_matplotlib_in_a_strangers_folder_run_no_latex(tmp_path: Path) -> None:
    """And a sensor whose name is broken mathematics is drawn by its name."""
    (tmp_path / "rig.xml").write_text(MODEL)
    t = 0.01 * np.arange(100)
    write_table(tmp_path / "run.csv", {"time": t, "motor": np.sin(9 * t), "$x^": 0.2 * np.cos(7 * t)})
    (tmp_path / "matplotlibrc").write_text("text.usetex: True\ntext.latex.preamble: \\input{/etc/passwd}\n")
    command = [sys.executable, "-m", "dipc_gym", "replay", "rig.xml", "run.csv", "--plot", "run.png"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "run.png").stat().st_size > 10_000


def test_settings_of_numba_in_a_strangers_folder_are_refused(tmp_path: Path) -> None:
    """They say where its cache is, which it unpickles."""
    pytest.importorskip("numba")
    (tmp_path / ".numba_config.yaml").write_text(f"cache_dir: {tmp_path / 'theirs'}\n")
    command = [sys.executable, "-m", "dipc_gym", "trial", "--count", "1", "--out", "out"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "Numba would take orders from this file" in done.stderr
    assert "Traceback" not in done.stderr
    assert [path.name for path in tmp_path.iterdir()] == [".numba_config.yaml"]


def test_compiled_code_is_never_looked_for_in_the_current_folder(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "platform", "linux")
    for relative in ("", ".", "theirs"):
        monkeypatch.setenv("XDG_CACHE_HOME", relative)
        assert machine.cache_folder() == Path.home() / ".cache" / "dipc-gym" / "engine"
    monkeypatch.setenv("XDG_CACHE_HOME", "/mine")
    assert machine.cache_folder() == Path("/mine/dipc-gym/engine")


def test_a_compensator_of_a_model_is_written_as_json_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["compensator", "rig.xml", "--out", str(tmp_path / "rig.xml")]) == 2
    assert "end its name so" in capsys.readouterr().err
