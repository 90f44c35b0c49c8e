"""Disturb real commands at random moments, start them again, and compare with a run that nobody disturbed.

    python -m benchmarks.kill                         twenty moments of each command
    python -m benchmarks.kill --moments 5 --command compare
    python -m benchmarks.kill --how interrupt         Ctrl-C in the place of kill -9
    python -m benchmarks.kill --how disk              a disk that is full (by root: it mounts small ones)

Every second time the process alone is killed, so that its workers are orphans while the same command goes on, else all
of its group. What was whole on disk at that moment must still be there, untouched, when the same command has gone on to
its end; what the two runs leave must be equal to the byte, but for the seconds that they took. After Ctrl-C there must
be a sentence and no traceback, and what a diagnosis had found by then is its result. A disk has a random share of the
room that the whole command takes; the command must end with a sentence that names a file or folder there, and with
room made, the same command must go on.
"""

from __future__ import annotations

import argparse
import contextlib
import errno
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

How = Literal["kill", "interrupt", "disk"]
PAGE = os.sysconf("SC_PAGE_SIZE")
"""Bytes, of which a file in memory takes whole ones."""
ROOM = 50_000_000
"""Bytes that are made for what a command goes on to write."""
MODEL = """<mujoco model="cart"><option timestep="0.002" integrator="implicitfast"/>
<worldbody><body><joint name="cart" type="slide" axis="1 0 0" damping="21.4"/>
<geom type="box" size="0.1 0.05 0.05" mass="1.26" contype="0" conaffinity="0"/></body></worldbody>
<actuator><motor name="motor" joint="cart" gear="4" ctrlrange="-24 24"/></actuator>
<sensor><jointpos name="cart" joint="cart"/></sensor></mujoco>"""


@dataclass(frozen=True)
class Command:
    """A command that fills a folder.

    Attributes:
        arguments: of `dipc-gym`, without `--out`.
        cells: pattern of the files that must survive a kill.
        content: what of the folder must be equal, by name.
        resumed: file with which a folder goes on by `--resume` alone; without one, by the same command.
    """

    arguments: tuple[str, ...]
    cells: str
    content: Callable[[Path], dict[str, Any]]
    resumed: str = ""


def _files(folder: Path, patterns: Iterable[str]) -> dict[str, Any]:
    found = sorted({path for pattern in patterns for path in folder.glob(pattern)})
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in found}


def _compared(folder: Path) -> dict[str, Any]:
    kinds = ("cells/*.json", "compensators/*.json", "recordings/*.csv", "summary.json", "table.txt", "figures/*.png")
    return _files(folder, kinds)


def _policy(folder: Path) -> dict[str, Any]:
    curve = [line.split(",") for line in (folder / "curve.csv").read_text().splitlines()]
    timed = curve[0].index("seconds")
    rows = [[cell for k, cell in enumerate(row) if k != timed] for row in curve]
    return {**_files(folder, ("policy.json", "compensator.json", "training.json")), "curve.csv": rows}


def _policies(folder: Path) -> dict[str, Any]:
    return {path.name: _policy(path) for path in sorted(folder.glob("ppo-*"))}


def _diagnosed(folder: Path) -> dict[str, Any]:
    said = json.loads((folder / "diagnosis.json").read_text())
    said["provenance"].pop("seconds", None)
    return {"diagnosis.json": said, **_files(folder, ("improved.xml",))}


def _trials(folder: Path) -> dict[str, Any]:
    results = {path.name: _diagnosed(path) for path in sorted((folder / "results").iterdir())}
    return {**_files(folder, ("sealed/*.json", "trials/*/*", "generator.json")), **results}


COMMANDS = {
    "compare": Command(
        ("compare", "--compensator", "none,feedforward", "--seeds", "2", "--seconds", "2", "--jobs", "2"),
        "cells/*.json",
        _compared,
    ),
    "train-policy": Command(
        ("train-policy", "--compensator", "none", "--steps", "16000", "--num-envs", "1"),
        "training.json",
        _policy,
        "training.json",
    ),
    "train-policy --seeds": Command(
        ("train-policy", "--compensator", "none", "--steps", "4000", "--num-envs", "1", "--seeds", "3", "--jobs", "2"),
        "trainings/*.json",
        _policies,
    ),
    "trial": Command(("trial", "--seed", "10", "--count", "2", "--jobs", "2"), "results/*/attempt.json", _trials),
    "diagnose": Command(("diagnose", "cart.xml", "run.csv", "--jobs", "1"), "diagnosis.json", _diagnosed),
}


def run(name: str, moments: int, seed: int, place: Path, how: How) -> list[str]:
    """Disturb a command at so many moments; what went wrong, in words."""
    command, rng = COMMANDS[name], random.Random(seed)
    begun = time.monotonic()
    calm = _start(command, place / "calm", place)
    calm.wait()
    took = time.monotonic() - begun
    if calm.returncode:
        return [f"undisturbed, it ends with {calm.returncode}: {_said(place)}"]
    expected, wrong = command.content(place / "calm"), []
    size = sum(_room(path) for path in (place / "calm").rglob("*"))
    for k in range(moments):
        share = rng.uniform(0.02, 0.98)
        out, at = place / f"killed-{k:02d}" / "out", share * took
        out.parent.mkdir()
        if how == "disk":
            at = share * size
            _mount(out.parent, max(PAGE, int(at)))
        killed = _start(command, out, place)
        try:
            killed.wait(timeout=None if how == "disk" else at)
        except subprocess.TimeoutExpired:
            if how == "interrupt":
                os.killpg(killed.pid, signal.SIGINT)
            elif k % 2:
                os.kill(killed.pid, signal.SIGKILL)
            else:
                os.killpg(killed.pid, signal.SIGKILL)
        killed.wait()
        faults = []
        if how == "interrupt" and ("Traceback" in _said(place) or killed.returncode not in (0, 130)):
            faults.append(f"interrupted, it ends with {killed.returncode}: {_said(place)}")
        if how == "disk":
            faults += _without_room(killed.returncode, _said(place), out)
            _mount(out.parent, 2 * size + ROOM, "remount")
        if killed.returncode == 0 and (out / "diagnosis.json").exists():
            shutil.rmtree(out)  # interrupted, it wrote what it had found; or it ended before, and does not begin anew
        kept = {path: (path.stat().st_mtime_ns, path.read_bytes()) for path in out.glob(command.cells)}
        again = _start(command, out, place)
        again.wait()
        if again.returncode:
            faults.append(f"goes on with {again.returncode}: {_said(place)}")
        elif (found := command.content(out)) != expected:
            names = [key for key in expected.keys() | found.keys() if expected.get(key) != found.get(key)]
            faults.append(f"leaves other {', '.join(sorted(names))}")
        if "Traceback" in _said(place):
            faults.append(f"says {_said(place)}")
        lost = [path.name for path, what in kept.items() if (path.stat().st_mtime_ns, path.read_bytes()) != what]
        if lost:
            faults.append(f"did {', '.join(lost)} once more, though whole")
        when = f"{at / 1024:.0f} KiB of {size / 1024:.0f}" if how == "disk" else f"{at:.1f} s of {took:.0f}"
        print(f"{name:20} {how} after {when}, {len(kept)} kept: {faults or 'equal'}", flush=True)
        wrong += [f"{name}, {how} after {when}: {fault}" for fault in faults]
        if how == "disk":
            subprocess.run(["umount", "--lazy", out.parent], check=True)
        shutil.rmtree(out.parent, ignore_errors=True)
        with contextlib.suppress(ProcessLookupError):
            os.killpg(killed.pid, signal.SIGKILL)  # workers that have nobody left to work for
    return wrong


def _without_room(code: int, said: str, out: Path) -> list[str]:
    """What is wrong with how a command ended on a full disk, and with what it left there."""
    faults = []
    if "Traceback" in said or code not in (0, 1, 2):
        faults.append(f"without room, it ends with {code}: {said}")
    last = said.strip().splitlines()[-1:]
    if code and not (last and str(out) in last[0] and os.strerror(errno.ENOSPC) in said):
        faults.append(f"names no file that found no room: {said}")
    for path in out.rglob("*"):
        if ".partial" in path.suffix:
            faults.append(f"leaves {path.name}")
        elif path.suffix == ".json":
            try:
                json.loads(path.read_text())
            except ValueError:
                faults.append(f"leaves half of {path.name}")
    return faults


def _mount(folder: Path, size: int, *options: str) -> None:
    """Put a disk of so many bytes at a folder, or make the one there larger."""
    subprocess.run(["mount", "-t", "tmpfs", "-o", ",".join([*options, f"size={size}"]), "tmpfs", folder], check=True)


def _room(path: Path) -> int:
    return -(-path.stat().st_size // PAGE) * PAGE if path.is_file() else PAGE


def _start(command: Command, out: Path, place: Path) -> subprocess.Popen[bytes]:
    arguments = [sys.executable, "-m", "dipc_gym", *command.arguments, "--out", str(out)]
    if command.resumed and (out / command.resumed).exists():
        arguments.append("--resume")
    (place / "said").unlink(missing_ok=True)  # a worker of the one before may still write to it
    with (place / "said").open("w") as said:
        return subprocess.Popen(
            arguments,
            cwd=place,
            env=os.environ | {"OMP_NUM_THREADS": "1"},
            stdout=subprocess.DEVNULL,
            stderr=said,
            start_new_session=True,
        )


def _said(place: Path) -> str:
    """The last words of the command that was started last."""
    return (place / "said").read_text(errors="replace")[-2000:]


def _record(place: Path) -> None:
    """A cart with dry friction that its model lacks, driven for 4 s."""
    import mujoco
    import numpy as np

    (place / "cart.xml").write_text(MODEL)
    model = mujoco.MjModel.from_xml_string(MODEL.replace('damping="21.4"', 'damping="21.4" frictionloss="4"'))
    data, rng, rows = mujoco.MjData(model), np.random.default_rng(0), ["time,motor,cart"]
    for k in range(1_000):
        t = 0.004 * k
        data.ctrl[0] = round(6 * np.sin(5 * t + 0.4 * t**2) + 3 * np.sin(17 * t), 4)
        rows.append(f"{t:.3f},{data.ctrl[0]},{data.qpos[0] + 1e-5 * rng.standard_normal():.8f}")
        mujoco.mj_step(model, data, 2)
    (place / "run.csv").write_text("\n".join(rows) + "\n")


def main() -> int:
    """Kill; the exit code is 1 if anything was lost or came out otherwise."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--moments", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--how", choices=get_args(How), default="kill", help="what disturbs")
    parser.add_argument("--command", choices=list(COMMANDS), action="append")
    given = parser.parse_args()
    wrong = []
    for name in given.command or COMMANDS:
        with tempfile.TemporaryDirectory(prefix="kill-") as folder:
            _record(Path(folder))
            wrong += run(name, given.moments, given.seed, Path(folder), given.how)
    print(*wrong, f"{len(wrong)} faults", sep="\n")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
