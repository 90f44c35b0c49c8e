"""Sweeps of trainings: the same policies as single trainings, and what a failure or a kill costs."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from dipc_gym import cli
from dipc_gym.policy import Policy
from dipc_gym.sweep import SweepError
from dipc_gym.training import seeds, train
from dipc_gym.training.seeds import KEPT, PolicyTraining
from dipc_gym.training.train import Recipe, Training

pytest.importorskip("torch")
pytest.importorskip("stable_baselines3")

TINY = Recipe(steps=1_000, num_envs=4, stage=250, rollout=125, batch_size=250, width=4)


def tiny(**changes: Any) -> Training:
    return Training(**{"compensator": "none", "seed": 5, "recipe": TINY} | changes)


def texts(folder: Path) -> dict[str, str]:
    return {path.name: path.read_text() for path in folder.iterdir() if path.suffix in (".json", ".csv")}


def without_times(curve: str) -> list[list[str]]:
    head = curve.splitlines()[0].split(",")
    return [[c for c, name in zip(row.split(","), head, strict=True) if name != "seconds"] for row in curve.split()]


def same_policy(ours: dict[str, str], theirs: dict[str, str]) -> bool:
    """Equal to the byte, but for the seconds that the training took."""
    names = [name for name in KEPT if name != "curve.csv" and name in theirs]
    return [ours.get(n) for n in names] == [theirs[n] for n in names] and without_times(
        ours["curve.csv"]
    ) == without_times(theirs["curve.csv"])


@pytest.fixture(scope="module")
def alone(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """What a single training of seed 5 leaves."""
    out = tmp_path_factory.mktemp("alone") / "run"
    train.run(tiny(), out, quiet=True)
    return texts(out)


def test_a_sweep_trains_the_policies_of_single_trainings_and_goes_on(alone: dict[str, str], tmp_path: Path) -> None:
    out = tmp_path / "sweep"
    first = seeds.run([tiny()], out, jobs=1)
    assert [outcome.cell.name for outcome in first] == ["ppo-none-05"]
    assert {path.name for path in (out / "ppo-none-05").iterdir()} == set(alone)
    assert same_policy(texts(out / "ppo-none-05"), alone)
    kept = (out / "trainings" / "ppo-none-05.json").stat().st_mtime_ns
    both = seeds.run([tiny(seed=6), tiny()], out, jobs=1)
    assert [outcome.cell.training.seed for outcome in both] == [6, 5]
    assert (out / "trainings" / "ppo-none-05.json").stat().st_mtime_ns == kept
    assert Policy.load(out / "ppo-none-06" / "policy.json").seed == 6
    with pytest.raises(SweepError, match=r"ppo-none-05\.json: was made with training\.limit = 60\.0"):
        seeds.run([tiny(limit=30.0)], out)


def test_a_training_that_fails_leaves_the_others(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    # A rollout of one period in one rig has no spread to normalise by, which PPO refuses.
    broken = tiny(seed=7, recipe=dataclasses.replace(TINY, num_envs=1, rollout=1))
    outcomes = seeds.run([broken, tiny()], tmp_path / "sweep", jobs=1)
    assert "AssertionError" in str(outcomes[0].failure)
    assert outcomes[1].failure is None
    assert sorted(path.name for path in (tmp_path / "sweep").iterdir()) == ["ppo-none-05", "trainings"]


def test_overwriting_begins_anew_and_spares_what_is_not_ours(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out = tmp_path / "sweep"
    out.mkdir()
    (out / "note.txt").write_text("mine")
    with pytest.raises(FileExistsError, match="holds no sweep of trainings; choose another folder"):
        seeds.run([tiny()], out, overwrite=True)
    cell, earlier = PolicyTraining.of(tiny()), out / "ppo-none-99"
    (out / "trainings").mkdir()
    (out / "trainings" / "mine.json").write_text("{}")
    with pytest.raises(FileExistsError, match="no earlier sweep to overwrite"):
        seeds.run([tiny()], out, overwrite=True)
    held: dict[str, Any] = {"parameters": {}, "failure": None, "result": {}}
    (out / "trainings" / "ppo-none-99.json").write_text(json.dumps(held))
    earlier.mkdir()
    for name in ("policy.json", "note.txt"):
        (earlier / name).write_text("old")
    monkeypatch.setattr(seeds.sweep, "run", lambda cells, *_, **__: iter([seeds.Outcome(cells[0], {}, None)]))
    assert [outcome.cell for outcome in seeds.run([tiny()], out, overwrite=True)] == [cell]
    assert [path.name for path in (out / "trainings").iterdir()] == ["mine.json"]
    assert (out / "note.txt").read_text() == "mine"
    assert [path.name for path in earlier.iterdir()] == ["note.txt"]


def test_a_changed_file_is_a_changed_parameter(tmp_path: Path) -> None:
    plant = tmp_path / "rig.json"
    plant.write_text("{}")
    before = PolicyTraining.of(tiny(plant=str(plant)))
    plant.write_text('{"supply": 12.0}')
    assert PolicyTraining.of(tiny(plant=str(plant))).files != before.files


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--seeds", "0"], "--seeds 0: give the number"),
        (["--seeds", "2", "--jobs", "0"], "jobs is 0"),
        (["--seeds", "2", "--seed", "-1"], "--seed -1: it must be a whole number from 0 on"),
        (["--seeds", "2", "--plant", "gone.json"], "gone.json: cannot be read"),
        (["--seeds", "2", "--compensator", "gone.json"], "gone.json: cannot be read"),
        (["--jobs", "2"], "say --seeds too"),
        (["--backend", "ray"], "say --seeds too"),
    ],
)
def test_bad_options_are_refused_before_anything_is_written(
    options: list[str], says: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["train-policy", "--out", str(tmp_path / "run"), *options]) == 2
    assert says in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


def test_the_command_line_says_what_became_of_each(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    asked = {}

    def run(cells: list[PolicyTraining], *_: Any, jobs: int, backend: str, **__: Any) -> Iterator[Any]:
        asked.update({"seeds": [cell.training.seed for cell in cells], "jobs": jobs, "backend": backend})
        shipped = Path(seeds.__file__).parents[1] / "policies" / "ppo-none.json"
        yield seeds.Outcome(cells[1], None, "OSError: gone")
        yield seeds.Outcome(cells[0], {"policy.json": shipped.read_text()}, None)

    monkeypatch.setattr(seeds.sweep, "run", run)
    out = tmp_path / "run"
    command = ["train-policy", "--out", str(out), "--compensator", "none", "--seed", "3", "--seeds", "2", "--jobs", "4"]
    assert cli.main(command) == 1
    assert asked == {"seeds": [3, 4], "jobs": 4, "backend": "local"}
    said = capsys.readouterr()
    assert "ppo-none-03/policy.json: ppo, voltage" in said.out
    assert "ppo-none-04: OSError: gone\n1 failed; the same command tries them again" in said.err
