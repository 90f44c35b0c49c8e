"""The comparison: what it leaves, what it refuses, and that it can be stopped."""

from __future__ import annotations

import ctypes.util
import dataclasses
import json
import math
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dipc_gym import compensators, recording
from dipc_gym.compensators import StaticGain
from dipc_gym.controllers import LQR, lqr
from dipc_gym.env import DoublePendulumEnv
from dipc_gym.experiments import cells, compare
from dipc_gym.experiments.compare import Comparison, Spread
from dipc_gym.experiments.tables import PAPER, summarise, table
from dipc_gym.plant import Friction, Plant
from dipc_gym.runs import balance, identify

ROOT = Path(__file__).resolve().parent.parent
RIG = ROOT.joinpath("dipc_gym", "rig.xml").read_text()
QUICK = Comparison(compensators=("none", "feedforward", "llnf", "ideal"), seeds=2, seconds=2.0)


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, Any], Path]:
    out = tmp_path_factory.mktemp("compare") / "out"
    return compare.run(QUICK, out, jobs=1), out


def test_summary_has_the_promised_form(finished: tuple[dict[str, Any], Path]) -> None:
    summary, out = finished
    assert json.loads((out / "summary.json").read_text()) == json.loads(json.dumps(summary))
    assert summary["schema"] == "dipc-gym/compare/1"
    assert summary["complete"]
    assert [row["compensator"] for row in summary["rows"]] == list(QUICK.compensators)
    for row in summary["rows"]:
        assert row["controller"] == "lqr"
        assert (row["seeds"], row["survived"]) == (2, 2)
        for key in ("cost", "cost_printed_q", "cart_m", "pole1_deg", "pole2_deg", "voltage_rms"):
            assert row[key]["low"] <= row[key]["median"] <= row[key]["high"]
        assert row["cost_printed_q"]["median"] < row["cost"]["median"]
    learned = {row["compensator"]: (row["parameters"], row["test_mse"]) for row in summary["rows"]}
    assert learned["none"][0] == 0
    assert learned["feedforward"][0] == 5
    assert learned["llnf"][1] < learned["feedforward"][1] < learned["none"][1]
    assert learned["ideal"] == (0, None)


def test_rigs_are_compared_one_by_one(finished: tuple[dict[str, Any], Path]) -> None:
    summary, out = finished
    pairs = summary["rig_by_rig"]
    assert [(p["than"], p["compensator"], p["rigs"]) for p in pairs] == [
        ("none", "feedforward", 2), ("feedforward", "llnf", 2), ("llnf", "ideal", 2)
    ]  # fmt: skip
    costs = [
        [
            json.loads((out / "cells" / f"lqr-{name}-{s:02d}.json").read_text())["result"]["cost"]
            for name in ("none", "feedforward")
        ]
        for s in (0, 1)
    ]
    assert pairs[0]["cost_ratio"]["median"] == pytest.approx(np.mean([after / before for before, after in costs]))
    assert pairs[0]["less_on"] == sum(after < before for before, after in costs)


def test_folder_has_everything(finished: tuple[dict[str, Any], Path]) -> None:
    _, out = finished
    for seed in (0, 1):
        for name in QUICK.compensators:
            assert compensators.load(out / "compensators" / f"{name}-{seed:02d}.json").name == name
            cell = json.loads((out / "cells" / f"lqr-{name}-{seed:02d}.json").read_text())["result"]
            assert (cell["compensator"], cell["seed"], cell["survived"]) == (name, seed, True)
    for figure in ("fig07_identification", "fig09_lolimot", "fig10_llnf", "fig12_balance"):
        assert (out / "figures" / f"{figure}.png").read_bytes().startswith(b"\x89PNG")
    run = recording.read(out / "recordings" / "lqr-llnf-00.csv", DoublePendulumEnv().model)
    assert len(run) == 400
    notes = " ".join(finished[0]["notes"])
    assert (out / "rig.gif").exists() != ("rig.gif was not drawn" in notes)
    if any(ctypes.util.find_library(name) for name in ("EGL", "OSMesa")):  # else there is nothing to draw with
        assert (out / "rig.gif").read_bytes().startswith(b"GIF8")


def test_cost_is_what_the_summary_says() -> None:
    course = balance(LQR(), StaticGain(newtons_per_volt=4.0), seconds=1.0, seed=0)
    expected = sum(x @ lqr.RECOVERED_Q @ x + f * f for x, f in zip(course.state, course.force, strict=True))
    assert cells._cost(course, lqr.RECOVERED_Q) == pytest.approx(expected)


def test_results_are_the_same_with_more_processes(finished: tuple[dict[str, Any], Path], tmp_path: Path) -> None:
    again = compare.run(dataclasses.replace(QUICK, compensators=("none", "ideal")), tmp_path / "two", jobs=2)
    assert again["rows"] == [row for row in finished[0]["rows"] if row["compensator"] in ("none", "ideal")]


def test_rigs_differ_within_the_spread() -> None:
    spread, base = Spread(), Plant()
    rigs = [spread.draw(base, seed) for seed in range(200)]
    frictions = [rig.friction or Friction() for rig in rigs]
    coulomb = np.array([f.coulomb for f in frictions]) / 8.0
    assert coulomb.min() >= 1 - spread.friction
    assert coulomb.max() <= 1 + spread.friction
    assert np.ptp(coulomb) > 1.8 * spread.friction
    assert all(f.static > f.coulomb for f in frictions)
    noise = np.array([rig.encoders.noise for rig in rigs])
    assert 0 <= noise.min() < 0.02 * spread.noise
    assert 0.98 * spread.noise < noise.max() <= spread.noise
    assert spread.draw(base, 3) == rigs[3]


def test_what_goes_with_a_file_is_part_of_its_fingerprint(tmp_path: Path) -> None:
    """A model's includes, and the statistics beside a saved policy."""
    model, part = tmp_path / "rig.xml", tmp_path / "part.xml"
    policy, statistics = tmp_path / "policy.zip", tmp_path / "policy.statistics.json"
    model.write_text('<mujoco><include file="part.xml"/></mujoco>')
    for file in (part, policy, statistics):
        file.write_text("<mujoco/>")
    seen = [cells.fingerprints(str(model), str(policy), "lqr", None)]
    for file in (part, statistics):
        file.write_text("<mujoco><option/></mujoco>")
        seen.append(cells.fingerprints(str(model), str(policy), "lqr", None))
    assert seen[0] != seen[1] != seen[2]


def test_a_plant_that_is_drawn_anew_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "worn.json"
    file.write_text(json.dumps({"friction": {"coulomb": {"uniform": [5.0, 9.0]}}}))
    with pytest.raises(ValueError, match=r"worn\.json: friction\.coulomb would be drawn anew"):
        dataclasses.replace(QUICK, plant=str(file)).check()


def test_fallen_runs_are_counted_and_left_out_of_the_figures() -> None:
    zeros = dict.fromkeys(("cost_printed_q", "cart_m", "pole1_deg", "pole2_deg", "force_rms", "voltage_rms"), 0.0)
    shared = {
        **zeros,
        "controller": "lqr",
        "compensator": "none",
        "trained_with": None,
        "test_mse": None,
        "parameters": 0,
        "notes": [],
    }
    cells = [
        {**shared, "seed": 0, "survived": False, "cost": 9.0, "cart_m": None, "seconds": 3.21},
        {**shared, "seed": 1, "survived": True, "cost": 1.0, "seconds": 80.0},
    ]
    row = summarise({}, QUICK.pairs(), cells, [], True)["rows"][0]
    assert (row["seeds"], row["survived"], row["cost"]["median"]) == (2, 1, 1.0)
    none = summarise({}, QUICK.pairs(), cells[:1], [], True)
    assert none["rows"][0]["cost"] is None
    assert "0/1" in table(none)
    assert none["rows"][0]["fell_after_s"]["median"] == 3.21
    assert "lqr, none: 1 fell, after 3.21 s in the median" in table(none)


def test_the_papers_figures_stand_beside_runs_of_its_length_alone(finished: tuple[dict[str, Any], Path]) -> None:
    """Costs are sums over the run, and deviations grow with it."""
    assert "paper" not in table(finished[0])
    assert "paper" in table({**finished[0], "paper": PAPER})
    cell = json.loads((finished[1] / "cells" / "lqr-none-00.json").read_text())["result"]
    as_long = summarise(dataclasses.asdict(Comparison()), QUICK.pairs(), [cell], [], True)
    assert as_long["paper"] == PAPER


def test_training_from_a_recording(tmp_path: Path) -> None:
    recording.write(identify(seed=5).run, tmp_path / "sweep.csv")
    comparison = Comparison(compensators=("feedforward",), seeds=2, seconds=2.0, recording=str(tmp_path / "sweep.csv"))
    compare.run(comparison, tmp_path / "out", jobs=1)
    assert [path.name for path in (tmp_path / "out" / "compensators").iterdir()] == ["feedforward-00.json"]
    expected = identify(from_recording=str(tmp_path / "sweep.csv")).fit("feedforward")
    assert compensators.load(tmp_path / "out" / "compensators" / "feedforward-00.json") == expected


def test_folder_that_is_not_empty_is_refused(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("precious")
    with pytest.raises(FileExistsError, match="choose another folder"):
        compare.run(QUICK, tmp_path)
    for name in ("compensators", "cells"):
        with pytest.raises(FileExistsError, match="comparison"):
            compare.prepare_folder(tmp_path, overwrite=True)
        (tmp_path / name).mkdir()
        (tmp_path / name / "mine.json").write_text("{}")
    with pytest.raises(FileExistsError, match="no earlier comparison to overwrite"):
        compare.prepare_folder(tmp_path, overwrite=True)
    with pytest.raises(FileExistsError):
        compare.prepare_folder(tmp_path / "thesis.tex", overwrite=True)


def test_overwriting_deletes_what_a_comparison_wrote_and_nothing_else(
    finished: tuple[dict[str, Any], Path], tmp_path: Path
) -> None:
    out = tmp_path / "out"
    shutil.copytree(finished[1], out)
    for folder in compare.FOLDERS:
        (out / folder / "mine.json").write_text("{}")
    compare.prepare_folder(out, overwrite=True)
    assert {path.relative_to(out).as_posix() for path in out.rglob("*") if path.is_file()} == {
        f"{folder}/mine.json" for folder in compare.FOLDERS
    }
    with pytest.raises(FileExistsError, match="no earlier comparison to overwrite"):
        compare.prepare_folder(out, overwrite=True)
    (out / "cells" / "mine.json").unlink()
    compare.prepare_folder(out, overwrite=True)  # as if killed before its first cell was finished


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"controllers": ("pid",)}, "no controller 'pid'"),
        ({"compensators": ("magic",)}, "there are none, feedforward, mlp, llnf, ideal"),
        ({"compensators": ("missing.json",)}, "missing.json"),
        ({"compensators": ()}, "--compensator names none"),
        ({"seeds": 0}, "--seeds is 0; it must be 1 or more"),
        ({"seconds": 0.0}, "--seconds is 0; it must be more than 0"),
        ({"seconds": math.inf}, "--seconds is inf; it must be a finite number"),
        ({"seconds": 0.001}, "at least one control period, 0.005 s"),
        ({"exact_state": True, "estimators": ("kalman",)}, "leave out one of them"),
        ({"compensators": ("observed",)}, "add --estimator disturbance"),
        ({"plant": "missing.json"}, "missing.json: cannot be read"),
        ({"recording": "missing.csv"}, "missing.csv"),
        ({"model": "missing.xml"}, "no such model file"),
    ],
)
def test_what_cannot_run_is_refused_before_anything_is_written(change: Any, says: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=says):
        compare.run(Comparison(**change), tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_interrupt_leaves_what_is_finished(tmp_path: Path) -> None:
    out = tmp_path / "out"
    command = [sys.executable, "-m", "dipc_gym", "compare", "--out", str(out), "--jobs", "2", "--seeds", "12"]
    command += ["--compensator", "none,ideal", "--seconds", "80"]
    heard = signal.signal(signal.SIGINT, signal.default_int_handler)  # started in the background, Python ignores it
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    signal.signal(signal.SIGINT, heard)
    deadline = time.monotonic() + 60
    while len(list((out / "cells").glob("*.json"))) < 2 and time.monotonic() < deadline:
        time.sleep(0.02)
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does: the whole group
    _, said = process.communicate(timeout=60)
    assert process.returncode == 130, said
    summary = json.loads((out / "summary.json").read_text())
    assert not summary["complete"]
    finished = [json.loads(path.read_text()) for path in (out / "cells").glob("*.json")]
    assert 2 <= len(finished) < 24
    assert sum(row["seeds"] for row in summary["rows"]) <= len(finished)
    assert "interrupted" in (out / "table.txt").read_text()
    assert "summary.json" in said


def test_a_compensator_of_ones_own_is_known_to_other_processes(tmp_path: Path) -> None:
    code = (
        "import sys, json\n"
        "sys.path.insert(0, 'examples')\n"
        "from dipc_gym import compensators\n"
        "from own_compensator import TwoWay\n"
        "compensators.register('two_way', TwoWay)\n"
        "from dipc_gym.experiments.compare import Comparison, run\n"
        f"found = run(Comparison(compensators=('none', 'two_way'), seeds=1, seconds=1.0), {str(tmp_path / 'out')!r})\n"
        "print(json.dumps([found['failures'], [row['compensator'] for row in found['rows']]]))\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    assert json.loads(done.stdout.splitlines()[-1]) == [{}, ["none", "two_way"]]


def test_a_model_whose_friction_no_plant_can_change_is_said_to_be_the_same_on_all_rigs(tmp_path: Path) -> None:
    path = tmp_path / "own.xml"
    text = Plant(friction=Friction(coulomb=0.0, static=0.0)).to_mjcf(RIG)
    path.write_text(text.replace('<joint name="cart"', '<joint frictionloss="8" name="cart"'))
    comparison = Comparison(compensators=("none",), seeds=1, seconds=0.1, model=str(path))
    assert any("the same on all rigs" in note for note in compare.run(comparison, tmp_path / "out", jobs=1)["notes"])
