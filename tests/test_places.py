"""Names from files lead nowhere but into their folder: the rule, and every door that such a name could come through."""

from __future__ import annotations

import json
import os
from pathlib import Path, PurePosixPath

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dipc_gym import sweep
from dipc_gym.experiments import compare
from dipc_gym.safety import files
from dipc_gym.safety.places import PlaceError, inside
from dipc_gym.training import folder as training_folder
from dipc_gym.training import seeds, train
from dipc_gym.training.train import Recipe, Training

PARTS = st.sampled_from(["..", ".", "", "a", "out", "up", "ring", "/", "\\", "\0", "~", "C:", "\ud800", "ü", "a" * 300])
NAMES = st.one_of(st.text(), st.lists(PARTS, max_size=6).map("/".join), st.lists(PARTS, max_size=6).map("".join))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with links out of it, up, in a ring, and to a place within."""
    top = tmp_path_factory.mktemp("places")
    folder = top / "folder"
    (folder / "a").mkdir(parents=True)
    (folder / "out").symlink_to(top)
    (folder / "up").symlink_to("..")
    (folder / "ring").symlink_to("ring")
    (folder / "within").symlink_to("a")
    return folder


@settings(deadline=None)
@given(name=NAMES)
def test_a_name_leads_into_its_folder_or_nowhere(folder: Path, name: str) -> None:
    try:
        place = inside(folder, name)
    except PlaceError:
        return
    assert place.resolve().is_relative_to(folder.resolve())
    assert place.resolve() != folder.resolve()
    assert place == folder / name


@settings(deadline=None)
@given(parts=st.lists(st.from_regex(r"[a-z0-9_][a-z0-9_. -]{0,20}", fullmatch=True), min_size=1, max_size=4))
def test_plain_names_are_borne(folder: Path, parts: list[str]) -> None:
    name = "/".join(["within", *parts])
    assert inside(folder, name) == folder / PurePosixPath(name)


@pytest.mark.parametrize(
    "name", ["", ".", "..", "a/../..", "/etc/passwd", "out/x", "up/x", "a\\..\\x", "C:x", "x" * 300, 7, None]
)
def test_what_leads_out_is_refused_in_words(folder: Path, name: str) -> None:
    with pytest.raises(PlaceError, match="leads out of this folder"):
        inside(folder, name)


def test_the_folder_itself_may_be_a_link(folder: Path) -> None:
    link = folder.parent / "link"
    link.symlink_to(folder)
    assert inside(link, "a/b") == link / "a" / "b"


def test_a_planted_link_does_not_lead_a_whole_file_elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    target = tmp_path / "elsewhere"
    target.write_text("mine")
    (tmp_path / "f").mkdir()
    monkeypatch.setattr(files.os, "getpid", lambda: 77)
    (tmp_path / "f" / ".note.77.partial").symlink_to(target)
    (tmp_path / "f" / "note").symlink_to(target)
    files.write_whole(tmp_path / "f" / "note", b"theirs")
    assert target.read_text() == "mine"
    assert (tmp_path / "f" / "note").read_text() == "theirs"


def test_partial_files_of_runs_that_are_at_work_stay(tmp_path: Path) -> None:
    for number in (os.getppid(), 99_999_999):
        (tmp_path / f".cell.json.{number}.partial").touch()
    files.remove_partial(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == [f".cell.json.{os.getppid()}.partial"]


TINY = Training(
    compensator="none", seed=5, recipe=Recipe(steps=1_000, num_envs=4, stage=250, rollout=125, batch_size=250)
)


@pytest.mark.parametrize("name", ["../../elsewhere", "ABSOLUTE", "notes.txt"])
def test_a_sweep_from_a_stranger_writes_only_its_own_files(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    cell = seeds.PolicyTraining.of(TINY)
    name = str(tmp_path / "elsewhere") if name == "ABSOLUTE" else name
    held = {"parameters": sweep.parameters(cell), "failure": None, "result": {"policy.json": "{}", name: "surprise"}}
    out = tmp_path / "sweep"
    (out / "trainings").mkdir(parents=True)
    (out / "trainings" / f"{cell.name}.json").write_text(json.dumps(held))
    if name != "notes.txt":  # even if nobody looked at what the cell holds
        with monkeypatch.context() as patch:
            patch.setattr(seeds.PolicyTraining, "check", lambda cell, result: None)
            with pytest.raises(PlaceError, match="leads out of this folder"):
                seeds.run([TINY], out)
    assert sweep.finished([cell], out / "trainings") == []
    assert "which no training leaves" in capsys.readouterr().err
    assert not [
        p for p in tmp_path.rglob("*") if p.is_file() and p.name not in (f"{cell.name}.json.damaged", "policy.json")
    ]


@pytest.mark.parametrize("part", ["trainings", "ppo-none-05"])
def test_a_link_in_a_sweep_from_a_stranger_is_not_followed(part: str, tmp_path: Path) -> None:
    out, mine = tmp_path / "sweep", tmp_path / "mine"
    (out / "trainings").mkdir(parents=True)
    mine.mkdir()
    cell = seeds.PolicyTraining.of(TINY)
    held = {"parameters": sweep.parameters(cell), "failure": None, "result": {"policy.json": "surprise"}}
    (out / "trainings" / f"{cell.name}.json").write_text(json.dumps(held))
    if part == "trainings":
        (out / part).rename(mine / "cells")
        (out / part).symlink_to(mine / "cells")
    else:
        (out / part).symlink_to(mine)
    with pytest.raises(PlaceError):
        seeds.run([TINY], out)
    assert not list(mine.glob("*.json"))


def test_a_link_in_a_training_from_a_stranger_is_not_followed(tmp_path: Path) -> None:
    pytest.importorskip("stable_baselines3")
    (tmp_path / "mine").mkdir()
    out = tmp_path / "training"
    training_folder.prepare(TINY, out, resume=False, overwrite=False)
    (out / "tensorboard").symlink_to(tmp_path / "mine")
    with pytest.raises(PlaceError, match="tensorboard"):
        train.run(TINY, out, resume=True, quiet=True)
    assert not list((tmp_path / "mine").iterdir())


@pytest.mark.parametrize("part", compare.FOLDERS)
def test_a_link_in_a_comparison_from_a_stranger_is_not_followed(part: str, tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    out = tmp_path / "comparison"
    (out / "cells").mkdir(parents=True)
    if part == "cells":
        (out / "cells").rmdir()
    (out / part).symlink_to(tmp_path / "mine")
    with pytest.raises(PlaceError, match=part):
        compare.prepare_folder(out, overwrite=False)
