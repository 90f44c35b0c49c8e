"""Sweeps: what is kept, what is refused, what a failure costs, and Ray."""

from __future__ import annotations

import dataclasses
import json
import os
import signal
import subprocess
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from halving import Halve

from dipc_gym import sweep
from dipc_gym.experiments import compare
from dipc_gym.experiments.compare import Comparison
from dipc_gym.sim2real.replay import replay
from dipc_gym.sweep import Outcome, SweepError
from dipc_gym.training import seeds, train
from dipc_gym.training.train import Recipe, Training
from dipc_gym.trials.attempt import Attempt


def numbers(outcomes: list[Outcome[Halve]]) -> list[int]:
    return [outcome.cell.number for outcome in outcomes]


def test_results_are_those_of_the_cells_and_on_disk(tmp_path: Path) -> None:
    outcomes = list(sweep.run([Halve(n) for n in range(6)], tmp_path / "cells", jobs=2))
    assert sorted(numbers(outcomes)) == list(range(6))
    for outcome in outcomes:
        assert outcome.result["half"] == outcome.cell.number / 2
        assert outcome.failure is None
        held = json.loads((tmp_path / "cells" / f"{outcome.cell.name}.json").read_text())
        assert held["parameters"] == sweep.parameters(outcome.cell)
        assert held["result"] == outcome.result
    assert {outcome.result["threads"] for outcome in outcomes} == {"1"}
    assert os.getpid() not in {outcome.result["pid"] for outcome in outcomes}


def test_what_is_finished_is_not_run_again(tmp_path: Path) -> None:
    (tmp_path / "trace").mkdir()
    cells = [Halve(n, str(tmp_path / "trace")) for n in range(4)]
    first = list(sweep.run(cells[:3], tmp_path / "cells", jobs=1))
    again = list(sweep.run(cells, tmp_path / "cells", jobs=1))
    assert again[:3] == first
    assert len(list((tmp_path / "trace").iterdir())) == 4
    assert sweep.finished(cells, tmp_path / "cells") == again


def test_a_failed_cell_is_named_and_the_others_go_on(tmp_path: Path) -> None:
    cells = [Halve(n) for n in (12, 13, 14, 15)]
    failed = {o.cell.number: o.failure for o in sweep.run(cells, tmp_path, jobs=2)}
    assert failed[12] is None
    assert failed[15] is None
    assert failed[13] == "ArithmeticError: thirteen"
    assert "not JSON compliant" in str(failed[14])
    assert json.loads((tmp_path / "halve-013.json").read_text())["failure"] == failed[13]
    assert numbers(sweep.finished(cells, tmp_path)) == [12, 15]
    again = [o for o in sweep.run(cells, tmp_path, jobs=1) if o.failure]
    assert numbers(again) == [13, 14]  # tried again
    mended = dataclasses.replace(Halve(13), options={"scale": 2.0})
    assert sweep.finished([mended], tmp_path) == []  # nothing of it is kept, so nothing is mixed


def test_a_process_that_dies_costs_one_cell(tmp_path: Path) -> None:
    cells = [Halve(n) for n in (1, 99, 2, 3, 4, 5)]
    outcomes = {o.cell.number: o for o in sweep.run(cells, tmp_path, jobs=2)}
    assert sorted(outcomes) == [1, 2, 3, 4, 5, 99]
    assert "its process died" in str(outcomes[99].failure)
    assert all(outcomes[n].failure is None for n in range(1, 6))


def test_another_sweep_is_not_mixed_in(tmp_path: Path) -> None:
    list(sweep.run([Halve(1), Halve(2)], tmp_path, jobs=1))
    changed = dataclasses.replace(Halve(2), options={"scale": 3.0})
    with pytest.raises(SweepError, match=r"halve-002\.json: was made with options\.scale = 1\.0.* 3\.0.*--overwrite"):
        sweep.run([Halve(1), changed], tmp_path)
    with pytest.raises(SweepError, match=r"options\.more = null"):
        sweep.run([dataclasses.replace(Halve(2), options={"scale": 1.0, "more": 2.0})], tmp_path)


DAMAGE: dict[str, Callable[[str], str]] = {
    "cut short": lambda text: text[: len(text) // 2],
    "empty": lambda text: "",
    "a digit": lambda text: text.replace('"half": 0.5', '"half": 0.6'),
    "a parameter": lambda text: text.replace('"number": 1', '"number": 2'),
    "another shape": lambda text: "[1, 2]",
    "another value": lambda text: json.dumps({**json.loads(text), "failure": {}}),
    "deep": lambda text: "[" * 100_000,
    "a result without a digest": lambda text: json.dumps(
        {**{k: v for k, v in json.loads(text).items() if k != "sha256"}, "result": {"half": "much"}}
    ),
}


@pytest.mark.parametrize("damage", DAMAGE)
def test_a_damaged_cell_is_named_set_aside_and_run_again(
    damage: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "trace").mkdir()
    cells = [Halve(n, str(tmp_path / "trace")) for n in (1, 2)]
    list(sweep.run(cells, tmp_path / "cells", jobs=1))
    file = tmp_path / "cells" / "halve-001.json"
    damaged = DAMAGE[damage](file.read_text())
    file.write_text(damaged)
    capsys.readouterr()
    outcomes = {o.cell.number: o.result["half"] for o in sweep.run(cells, tmp_path / "cells", jobs=1)}
    assert outcomes == {1: 0.5, 2: 1.0}
    assert len(list((tmp_path / "trace").iterdir())) == 3, "one cell is lost, not more"
    said = capsys.readouterr().err
    assert "halve-001.json" in said
    assert "set aside as halve-001.json.damaged" in said
    assert file.with_name("halve-001.json.damaged").read_text() == damaged
    assert [o.result["half"] for o in sweep.run(cells, tmp_path / "cells")] == [0.5, 1.0]


@pytest.mark.parametrize("jobs", [0, -1])
def test_jobs_must_be_positive(jobs: int, tmp_path: Path) -> None:
    with pytest.raises(SweepError, match="1 or more"):
        sweep.run([Halve(1)], tmp_path / "new", jobs=jobs)
    assert not (tmp_path / "new").exists()


def test_unknown_backend_and_shared_names_are_refused(tmp_path: Path) -> None:
    with pytest.raises(SweepError, match="no backend 'dusk'; there are local and ray"):
        sweep.run([Halve(1)], tmp_path, backend="dusk")  # type: ignore[arg-type]
    with pytest.raises(SweepError, match="two cells are called 'halve-001'"):
        sweep.run([Halve(1), Halve(1)], tmp_path)


def test_without_ray_the_mend_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(
        ImportError,
        match=r"add its extra: pip install '\.\[ray\]' in a clone",
    ):
        sweep.run([Halve(1)], tmp_path, backend="ray")


def test_a_killed_sweep_goes_on(tmp_path: Path) -> None:
    (tmp_path / "trace").mkdir()
    code = (
        "import sys; from pathlib import Path; sys.path.insert(0, sys.argv[1])\n"
        "from halving import Halve; from dipc_gym import sweep\n"
        "place = Path(sys.argv[2])\n"
        "cells = [Halve(n, str(place / 'trace')) for n in range(100, 300)]\n"
        "if __name__ == '__main__':\n"
        "    list(sweep.run(cells, place / 'cells', jobs=2))\n"
    )
    command = [sys.executable, "-c", code, str(Path(__file__).parent), str(tmp_path)]
    process = subprocess.Popen(command, stderr=subprocess.DEVNULL, start_new_session=True)
    deadline = time.monotonic() + 60
    while len(list((tmp_path / "cells").glob("*.json"))) < 5 and time.monotonic() < deadline:
        time.sleep(0.01)
    os.killpg(process.pid, signal.SIGKILL)
    process.wait(timeout=30)
    cells = [Halve(n, str(tmp_path / "trace")) for n in range(100, 300)]
    kept = numbers(sweep.finished(cells, tmp_path / "cells"))
    assert 5 <= len(kept) < 200
    outcomes = list(sweep.run(cells, tmp_path / "cells", jobs=2))
    assert numbers(outcomes)[: len(kept)] == kept
    assert sorted(numbers(outcomes)) == list(range(100, 300))
    runs = [path.name.split("-")[0] for path in (tmp_path / "trace").iterdir()]
    assert all(runs.count(str(n)) == 1 for n in kept)


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    ray = pytest.importorskip("ray")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("RAY_worker_niceness", "0")  # else its processes wait for those of all other tests
        ray.init(
            num_cpus=1,
            include_dashboard=False,
            object_store_memory=80 * 2**20,
            log_to_driver=False,
            runtime_env={"env_vars": {"PYTHONPATH": str(Path(__file__).parent)}},  # where a worker finds Halve
        )
    yield ray
    ray.shutdown()


@pytest.mark.filterwarnings("default")
def test_ray_runs_the_cells_in_its_own_processes(cluster: Any, tmp_path: Path) -> None:
    cells = [Halve(n) for n in (1, 2, 13, 4)]
    for jobs in (1, None):
        folder = tmp_path / str(jobs)
        outcomes = {o.cell.number: o for o in sweep.run(cells, folder, jobs=jobs, backend="ray")}
        assert sorted(outcomes) == [1, 2, 4, 13]
        assert all(outcomes[n].result["half"] == n / 2 for n in (1, 2, 4))
        assert all(outcomes[n].result["threads"] == "1" for n in (1, 2, 4))
        assert os.getpid() not in {outcomes[n].result["pid"] for n in (1, 2, 4)}
        assert outcomes[13].failure == "ArithmeticError: thirteen"
        assert numbers(sweep.finished(cells, folder)) == [1, 2, 4]


@pytest.mark.filterwarnings("default")
def test_a_worker_of_ray_that_dies_costs_one_cell(cluster: Any, tmp_path: Path) -> None:
    outcomes = {o.cell.number: o for o in sweep.run([Halve(n) for n in (1, 99, 2)], tmp_path, backend="ray")}
    assert "Ray gave it up" in str(outcomes[99].failure)
    assert outcomes[1].result["half"] == 0.5
    assert outcomes[2].result["half"] == 1.0


@pytest.mark.filterwarnings("default")
def test_a_comparison_on_ray_is_the_one_made_here(cluster: Any, tmp_path: Path) -> None:
    comparison = Comparison(compensators=("none", "feedforward"), seeds=1, seconds=2.0, robustness=("impulse",))
    here = compare.run(comparison, tmp_path / "here", jobs=1)
    there = compare.run(comparison, tmp_path / "there", backend="ray")
    assert there["failures"] == {}
    assert there["rows"] == here["rows"]
    assert (tmp_path / "there" / "robustness.json").read_text() == (tmp_path / "here" / "robustness.json").read_text()


@pytest.mark.filterwarnings("default")
def test_a_training_on_ray_is_the_one_made_here(cluster: Any, tmp_path: Path) -> None:
    pytest.importorskip("stable_baselines3")
    recipe = Recipe(steps=1_000, num_envs=4, stage=250, rollout=125, batch_size=250, width=4)
    training = Training(compensator="feedforward", seed=5, recipe=recipe)
    train.run(training, tmp_path / "here", quiet=True)
    (outcome,) = seeds.run([training], tmp_path / "there", backend="ray")
    assert outcome.failure is None
    for name in ("training.json", "policy.json", "compensator.json"):
        there = tmp_path / "there" / "ppo-feedforward-05" / name
        assert there.read_bytes() == (tmp_path / "here" / name).read_bytes()


AXIS = """<mujoco model="axis">
  <option timestep="0.0005" integrator="implicitfast"/>
  <worldbody>
    <body>
      <inertial pos="0 0 0" mass="0.1" diaginertia="0.0002 0.0002 0.0002"/>
      <joint name="axis" type="hinge" axis="0 0 1" damping="0.0002"/>
    </body>
  </worldbody>
  <actuator><motor name="motor" joint="axis" gear="0.02"/></actuator>
  <sensor><jointpos name="axis" joint="axis"/></sensor>
</mujoco>"""


def small_trial(folder: Path, noise: float) -> Path:
    """A trial in which nothing is missing, of 2 s."""
    folder.mkdir(parents=True)
    (folder / "nominal.xml").write_text(AXIS)
    rng = np.random.default_rng(0)
    for name in ("train_1", "train_2", "test"):
        model = mujoco.MjModel.from_xml_string(AXIS)
        data, rows, phase = mujoco.MjData(model), ["time,motor,axis"], rng.uniform(0.0, 6.0)
        for k in range(1_000):
            data.ctrl[0] = round(np.sin(phase + 12.0 * k * 0.002) + 0.5 * np.sin(40.0 * k * 0.002), 6)
            rows.append(f"{k * 0.002:.3f},{data.ctrl[0]},{data.qpos[0] + noise * rng.standard_normal():.9g}")
            mujoco.mj_step(model, data, 4)
        (folder / f"{name}.csv").write_text("\n".join(rows) + "\n")
    return folder


@pytest.mark.filterwarnings("default")
def test_a_trial_is_diagnosed_on_ray(cluster: Any, tmp_path: Path) -> None:
    pytest.importorskip("numba")  # the generator's, which comes along
    from dipc_gym.trials.run import swept

    trial = small_trial(tmp_path / "trials" / "t001_axis", noise=1e-3)
    attempt = Attempt(folder=str(trial), seed=0, limit=120.0)
    ((name, texts),) = swept([attempt], jobs=None, backend="ray", label="diagnose")
    note = json.loads(texts["attempt.json"])
    assert (name, note["failure"], note["replay_failure"]) == ("t001_axis", None, None)
    assert {"diagnosis.json", "improved.xml", "report.html"} < set(texts)
    assert list(tmp_path.iterdir()) == [trial.parent]  # all comes back; nothing is written here
    (tmp_path / "improved.xml").write_text(texts["improved.xml"])
    here = replay(tmp_path / "improved.xml", trial / "test.csv", window=0.25, step=0.001, threads=1)
    assert note["sensor_errors"] == {"axis": here.sensors[0].error}


HOARD: list[np.ndarray] = []


@dataclass(frozen=True)
class Grow:
    """Leaves its process larger than before, as what imports a large library does."""

    name: str

    def run(self) -> int:
        time.sleep(1.1)  # joblib looks every second
        if len(HOARD) == 1:  # what the first cell takes is the reference
            HOARD.append(np.ones(45_000_000))
        HOARD.append(np.ones(1))
        return os.getpid()


def test_a_worker_that_grows_is_replaced_without_a_word(tmp_path: Path) -> None:
    pytest.importorskip("psutil")  # without it joblib does not look
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        outcomes = list(sweep.run([Grow(f"grow-{n}") for n in range(5)], tmp_path, jobs=2))
    assert [outcome.failure for outcome in outcomes] == [None] * 5
    assert len({outcome.result for outcome in outcomes}) > 2  # processes: some were replaced
    assert [str(one.message) for one in said] == []


def test_no_progress_bar_where_nobody_looks(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    list(sweep.run([Halve(2), Halve(4)], tmp_path, jobs=1))
    assert capsys.readouterr().err == ""
