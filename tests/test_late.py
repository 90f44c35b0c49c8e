"""What takes long is not lost: late stages that fail, full disks, second runs in one folder, Ctrl-C."""

from __future__ import annotations

import json
import math
import os
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_diagnose import NOMINAL, run

from dipc_gym import cli, mjcf, recording
from dipc_gym.safety.alone import BusyError, alone
from dipc_gym.safety.files import whole, write_json, write_whole
from dipc_gym.sim2real import diagnosis
from dipc_gym.sim2real.diagnosis import diagnose
from dipc_gym.sim2real.effects import catalogue
from dipc_gym.sim2real.model.parameters import Wishes
from dipc_gym.sim2real.report import folder as saving
from dipc_gym.sim2real.report import page
from dipc_gym.sim2real.selection.baseline import baseline
from dipc_gym.sim2real.selection.case import part
from dipc_gym.sim2real.selection.search import Searched
from dipc_gym.sim2real.selection.stop import Stop
from dipc_gym.sim2real.verdict import details, findings, improve, intervals, measure, sentences, untouched
from dipc_gym.sim2real.verdict.guarded import Guarded
from dipc_gym.sim2real.verdict.withheld import gather

FEW = [catalogue()[name] for name in ("friction.coulomb", "drag.quadratic")]


def test_a_parameter_that_is_not_known_at_all_has_no_interval() -> None:
    case = part(gather(mjcf.from_text(NOMINAL), [run(1, 12, 3.0)], (), Wishes())[0], threads=1)
    fitted = baseline(case).recalibrated
    for wide in (1e4, math.inf, math.nan):
        unknown = findings.changed_parameters(fitted, np.full(len(fitted.z), wide))
        assert unknown
        assert not any("low" in entry for entry in unknown)
    known = findings.changed_parameters(fitted, np.full(len(fitted.z), 0.1))
    assert known
    for entry in known:
        assert 0 < entry["low"] < entry["value"] < entry["high"]


STAGES: dict[str, list[tuple[Any, str]]] = {
    "no comparison with rivals, no figures": [
        (diagnosis, "conclude"),
        (findings, "choice_shift"),
        (details, "_traces"),
    ],
    "no fine fit, no errors, no numbers": [
        (Searched, "refined"),
        (untouched, "error_on"),
        (measure, "_force_errors"),
        (intervals, "by_blocks"),
        (findings, "changed_parameters"),
        (findings, "missing_effects"),
        (improve, "improved_model"),
    ],
}


@pytest.mark.parametrize("stages", STAGES)
def test_late_stages_that_fail_lose_nothing_that_was_found(
    stages: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: Any, **__: Any) -> Any:
        raise OverflowError("math range error")

    monkeypatch.setattr(Guarded, "strict", False)

    for where, name in STAGES[stages]:
        monkeypatch.setattr(where, name, fail)
    found = diagnose(mjcf.from_text(NOMINAL), [run(1, 12, 3.0)], effects=FEW)
    saving.save(found, tmp_path / "out", model="cart.xml", command="")
    said = json.loads((tmp_path / "out" / "diagnosis.json").read_text())
    assert [one["effect"] for one in said["missing"]] == ["friction.coulomb"]
    assert said["missing"][0]["parameters"]["level"]["value"] == pytest.approx(3.0, rel=0.05)
    assert "OverflowError: math range error" in str(said["notes"])
    assert "OverflowError" in (tmp_path / "out" / "report.html").read_text()
    not_worked_out = (untouched, "error_on") in STAGES[stages]
    assert (sentences.NOT_HELD_OUT in said["notes"]) == not_worked_out
    assert said["fit"]["held_out_was_fitted"] == not_worked_out
    assert mjcf.compile(tmp_path / "out" / "improved.xml").dof_frictionloss[0] == pytest.approx(3.0, rel=0.1)


def test_a_traceback_goes_to_the_log_and_not_to_the_terminal() -> None:
    """Who asked for no log reads a note in a line; who asked for one finds where it failed."""
    code = """
import logging, sys
from dipc_gym.sim2real.selection.stop import Stop
from dipc_gym.sim2real.verdict.guarded import Guarded
if len(sys.argv) > 1:
    logging.basicConfig()
Guarded(Stop(lambda line: None))("It", lambda: 1 / 0, lambda: 0)
"""
    quiet, logged = (
        subprocess.run([sys.executable, "-c", code, *more], capture_output=True, text=True, check=True).stderr
        for more in ([], ["log"])
    )
    assert quiet == ""
    assert "ZeroDivisionError" in logged


def test_ctrl_c_in_a_late_stage_keeps_what_was_found_and_the_second_stops() -> None:
    stop = Stop(lambda line: None)

    def interrupt() -> int:
        raise KeyboardInterrupt

    late = Guarded(stop)
    assert late("It", interrupt, lambda: 7) == 7
    assert stop.asked
    with pytest.raises(KeyboardInterrupt):
        late("It", interrupt, lambda: 7)


# --- a full disk ---------------------------------------------------------------------------------------------------


def small_disk(command: list[str], size: int, place: Path) -> subprocess.CompletedProcess[str]:
    """Run a command that can write no file beyond a size, as on a disk that has no more room."""

    def limit() -> None:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))

    return subprocess.run(
        command, cwd=place, capture_output=True, text=True, preexec_fn=limit, timeout=300, check=False
    )


def test_a_full_disk_is_told_with_file_and_what_is_whole(tmp_path: Path) -> None:
    write_whole(tmp_path / "note.json", b"old")
    body = "from dipc_gym.safety.files import write_json; write_json('note.json', list(range(10_000)))"
    done = small_disk([sys.executable, "-c", body], 4096, tmp_path)
    assert "make room and try again; what had this name before, if anything, is untouched: 'note.json'" in done.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["note.json"]
    assert (tmp_path / "note.json").read_bytes() == b"old"


def test_a_diagnosis_that_finds_no_room_says_so_and_prints_what_it_found(tmp_path: Path) -> None:
    (tmp_path / "cart.xml").write_text(NOMINAL)
    still = run(1, 4, 3.0)
    recording.write(still, tmp_path / "run.csv")
    command = [sys.executable, "-m", "dipc_gym", "diagnose", "cart.xml", "run.csv", "--out", "found"]
    done = small_disk([*command, "--jobs", "1"], 3000, tmp_path)
    assert done.returncode == 2, done.stderr
    assert "Traceback" not in done.stderr
    assert "nothing was written, and what was there is untouched: 'found'" in done.stderr.splitlines()[-1]
    said = json.loads(done.stdout[done.stdout.index("{\n") :])
    assert said["verdict"] in page.VERDICTS
    assert not (tmp_path / "found").exists()


FIGURE = """
from pathlib import Path
from matplotlib.figure import Figure
from dipc_gym.experiments import figures
figures.write(lambda width: Figure(), Path("fig"))"""
FILM = """
from pathlib import Path
import numpy as np
from PIL import Image
from dipc_gym.experiments.film import _mp4
with _mp4(Path("rig.mp4")) as take:
    for k in range(40):
        take(Image.fromarray(np.random.default_rng(k).integers(0, 255, (340, 300, 3), dtype=np.uint8)))"""


@pytest.mark.parametrize(("body", "name"), [(FIGURE, "fig.png"), (FILM, "rig.mp4")])
def test_a_picture_that_finds_no_room_leaves_the_old_one(body: str, name: str, tmp_path: Path) -> None:
    if name.endswith(".mp4"):
        pytest.importorskip("imageio_ffmpeg")
    (tmp_path / name).write_bytes(b"old")
    done = small_disk([sys.executable, "-c", body], 2000, tmp_path)
    assert "make room and try again" in done.stderr.splitlines()[-1]
    assert name in done.stderr.splitlines()[-1]
    assert [path.name for path in tmp_path.iterdir()] == [name]
    assert (tmp_path / name).read_bytes() == b"old"


def test_no_room_while_results_are_put_in_place_names_those_that_are_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = diagnosis.Diagnosis("cannot tell", "These recordings cannot tell.", improved="<mujoco/>")
    move = Path.replace

    def refuse(self: Path, target: Path) -> Path:
        if target == tmp_path / "out" / "report.html":
            raise OSError(28, "No space left on device")
        return move(self, target)

    monkeypatch.setattr(Path, "replace", refuse)
    with pytest.raises(
        OSError, match=r"No space left on device, at report.html; whole are improved.xml, report.json alone: .*out"
    ):
        saving.save(found, tmp_path / "out", model="m", command="")
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"improved.xml", "report.json"}


def test_an_interrupted_writing_leaves_the_old_file(tmp_path: Path) -> None:
    def interrupted() -> None:
        with whole(tmp_path / "a.json") as file:
            file.write(b"half")
            raise KeyboardInterrupt

    write_json(tmp_path / "a.json", 1)
    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert [path.name for path in tmp_path.iterdir()] == ["a.json"]
    assert (tmp_path / "a.json").read_text() == "1\n"


# --- two of one command --------------------------------------------------------------------------------------------

HOLD = (
    "from dipc_gym.safety.alone import alone\nimport time\nwith alone({!r}):\n"
    "    print('held', flush=True); time.sleep(60)"
)


@pytest.fixture
def held(tmp_path: Path) -> Any:
    """A folder that another process is at work in."""
    folder = tmp_path / "out"
    folder.mkdir()
    (folder / "mine").touch()
    process = subprocess.Popen([sys.executable, "-c", HOLD.format(str(folder))], stdout=subprocess.PIPE)
    assert process.stdout is not None
    process.stdout.readline()
    yield folder, process
    process.kill()
    process.wait()
    process.stdout.close()


def test_a_second_run_says_so_and_stops_and_a_killed_one_leaves_no_lock(held: Any) -> None:
    folder, process = held
    with pytest.raises(BusyError, match="out: another run is at work in this folder"), alone(folder):
        pass
    process.kill()
    process.wait()
    with alone(folder):
        pass
    assert [path.name for path in folder.iterdir()] == ["mine"]


def test_a_folder_that_was_made_in_vain_goes_before_it_is_let_go(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whoever waits for it would hold a folder that is none any more."""
    folder, close, there = tmp_path / "out", os.close, []

    def closing(handle: int) -> None:
        there.append(folder.exists())
        close(handle)

    with alone(folder):
        monkeypatch.setattr(os, "close", closing)
    assert there == [False]


@pytest.mark.parametrize(
    "command",
    [
        ["compare", "--compensator", "none", "--seeds", "1", "--seconds", "1"],
        ["train-policy", "--compensator", "none", "--resume"],
        ["train-policy", "--compensator", "none", "--seeds", "1"],
        ["trial", "--count", "1"],
        ["trial", "--count", "1", "--rivals"],
    ],
)
def test_every_command_that_fills_a_folder_works_in_it_alone(
    command: list[str], held: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, _ = held
    assert cli.main([*command, "--out", str(folder)]) == 2
    assert "another run is at work in this folder" in capsys.readouterr().err
    assert [path.name for path in folder.iterdir()] == ["mine"]


def test_a_diagnosis_too(held: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder, _ = held
    (tmp_path / "cart.xml").write_text(NOMINAL)
    recording.write(run(1, 4, 3.0), tmp_path / "run.csv")
    files = [str(tmp_path / "cart.xml"), str(tmp_path / "run.csv")]
    assert cli.main(["diagnose", *files, "--out", str(folder), "--overwrite"]) == 2
    assert "another run is at work in this folder" in capsys.readouterr().err


def test_a_model_whose_part_would_be_written_over_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """improved.xml with a part of that name had included itself."""
    part = NOMINAL.replace("<worldbody>", '<include file="improved.xml"/><worldbody>')
    (tmp_path / "cart.xml").write_text(part)
    (tmp_path / "improved.xml").write_text('<mujocoinclude><statistic extent="2"/></mujocoinclude>')
    files = [str(tmp_path / "cart.xml"), str(tmp_path / "run.csv")]
    assert cli.main(["diagnose", *files, "--out", str(tmp_path / "found")]) == 2
    assert "the model's own file improved.xml" in capsys.readouterr().err


def test_a_folder_made_for_nothing_is_removed(tmp_path: Path) -> None:
    with alone(tmp_path / "a"):
        pass
    assert not (tmp_path / "a").exists()
    (tmp_path / "file").touch()
    with pytest.raises(FileExistsError, match="is a file"), alone(tmp_path / "file"):
        pass


# --- Ctrl-C ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("sent", [signal.SIGINT, signal.SIGTERM])
def test_ctrl_c_ends_in_a_sentence(sent: signal.Signals, tmp_path: Path) -> None:
    """And what a batch system sends before it kills."""
    command = [sys.executable, "-m", "dipc_gym", "compare", "--compensator", "none,mlp", "--seeds", "3", "--out", "out"]
    process = subprocess.Popen(
        command,
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # tests in the background ignore it
    )
    # Once a first cell is there, all processes have started; Python itself is not ours to interrupt.
    while not list(tmp_path.glob("out/cells/*.json")) and process.poll() is None:
        time.sleep(0.05)
    os.killpg(process.pid, sent)  # as terminals and batch systems do
    _, said = process.communicate(timeout=120)
    assert process.returncode == 130, said
    assert "Traceback" not in said
    assert "interrupted" in said.splitlines()[-1]
    for path in tmp_path.rglob("*.json"):
        json.loads(path.read_text())
    assert not list(tmp_path.rglob("*.partial"))


def test_no_worker_of_a_sweep_gets_ctrl_c() -> None:
    """The first one had: what tracks the resources of processes let it through while it started."""
    code = """
import signal
from joblib import Parallel, delayed
from dipc_gym.safety.interrupts import held_back

def holds():
    return signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, ())

parallel = Parallel(n_jobs=2, batch_size=1, pre_dispatch=2, return_as="generator_unordered")
with held_back():
    said = parallel(delayed(holds)() for _ in range(6))
print(all(said), holds())
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["True", "False"], done.stderr


# --- nobody reads what is printed ------------------------------------------------------------------------------------


def test_a_diagnosis_whose_output_goes_to_a_pipe_that_breaks_is_written(tmp_path: Path) -> None:
    """`diagnose ... 2>&1 | tee log`, and Ctrl-C: both get it, and tee is gone at once."""
    (tmp_path / "cart.xml").write_text(NOMINAL)
    recording.write(run(1, 6, 3.0), tmp_path / "run.csv")
    command = [sys.executable, "-m", "dipc_gym", "diagnose", "cart.xml", "run.csv", "--out", "found", "--jobs", "1"]
    process = subprocess.Popen(
        command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, start_new_session=True
    )
    assert process.stdout is not None
    while "added" not in process.stdout.readline():
        assert process.poll() is None
    process.stdout.close()
    os.killpg(process.pid, signal.SIGINT)
    assert process.wait(timeout=300) == 1
    said = json.loads((tmp_path / "found" / "diagnosis.json").read_text())
    assert said["missing"][0]["effect"] == "friction.coulomb"
    assert (tmp_path / "found" / "report.html").exists()


def test_a_pipe_that_breaks_leaves_no_traceback(tmp_path: Path) -> None:
    command = f"{sys.executable} -m dipc_gym --help | true; echo ${{PIPESTATUS[0]}}"
    done = subprocess.run(["bash", "-c", command], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert done.stderr == ""
    assert done.stdout.strip() in ("0", "1")  # 0 where all fitted into the pipe before its reader had gone
