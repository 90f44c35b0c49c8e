"""The site: every snippet runs, every command is one that there is, links lead somewhere, notebooks run."""

from __future__ import annotations

import argparse
import dataclasses
import importlib
import json
import re
import runpy
import shlex
import shutil
import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import NoReturn

import pages
import pytest

from dipc_gym import cli, compensators
from dipc_gym.sim2real import effects
from dipc_gym.sim2real.report.page import VERDICTS

WITH_PYTHON = [path for path in pages.PAGES if pages.python(path) and path.name != "README.md"]


@pytest.fixture
def registries(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a page registers is gone after it."""
    effects.catalogue()
    monkeypatch.setattr(effects, "_effects", dict(effects._effects))
    monkeypatch.setattr(compensators.registry, "_KINDS", dict(compensators.registry._KINDS))


def exported(to: Path) -> None:
    """A loop, as a page has it written by a command."""
    compensators.save(compensators.StaticGain(newtons_per_volt=4.0), to.parent / "none.json")
    kind = {".h": "c", ".onnx": "onnx"}[to.suffix]
    assert cli.main(["export", str(to.parent / "none.json"), "--to", kind, "--out", str(to)]) == 0


@pytest.mark.usefixtures("registries")
@pytest.mark.parametrize("path", WITH_PYTHON, ids=pages.name)
def test_snippets_of_a_page_run_in_order(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "examples").symlink_to(pages.ROOT / "examples")
    monkeypatch.chdir(tmp_path)
    if "onnxruntime" in pages.python(path):
        pytest.importorskip("onnxruntime")
        pytest.importorskip("onnx")
        exported(tmp_path / "rig.onnx")
    space: dict[str, object] = {"__name__": "__main__"}
    for snippet in pages.blocks(path, "python"):
        exec(compile(snippet, pages.name(path), "exec"), space)


@pytest.mark.parametrize("path", pages.PAGES, ids=pages.name)
def test_a_language_goes_by_the_name_that_the_tests_know(path: Path) -> None:
    """A block of Python labelled `py` would be run by nobody."""
    labels = re.findall(r"^ *```(\w+)$", path.read_text(encoding="utf-8"), re.MULTILINE)
    assert set(labels) <= {"python", "bash", "c", "csv", "text"}


def lines_of_shell(path: Path) -> list[str]:
    """Commands of a page, each on one line."""
    whole = [text.replace("\\\n", " ") for text in pages.blocks(path, "bash")]
    return [line.strip() for text in whole for line in text.splitlines()]


def commands(path: Path) -> list[str]:
    """Those that call dipc-gym."""
    return [line for line in lines_of_shell(path) if re.match(r"(\S*/)?dipc-gym ", line)]


def without_blocks(path: Path) -> str:
    """The text of a page between its fenced blocks."""
    return re.sub(r"^ *```.*?^ *```", "", path.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)


def benchmarks_of(path: Path) -> list[str]:
    """Commands of a page that run a benchmark, in blocks and within sentences."""
    spans = [" ".join(span.split()) for span in re.findall(r"`([^`]+)`", without_blocks(path))]
    return [one for one in [*lines_of_shell(path), *spans] if re.match(r"python (-m benchmarks\b|benchmarks/)", one)]


@pytest.mark.parametrize("path", [path for path in pages.PAGES if commands(path)], ids=pages.name)
def test_commands_of_a_page_are_understood(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every option that a page shows exists, and takes what it is given there; nothing is run."""
    asked: list[object] = []
    for command in cli.COMMANDS.values():
        monkeypatch.setattr(command, "run", lambda self: asked.append(self) or 0)
    for line in commands(path):
        assert cli.main(shlex.split(line, comments=True)[1:]) == 0, line
    assert len(asked) == len(commands(path))


@pytest.mark.parametrize("path", [path for path in pages.PAGES if benchmarks_of(path)], ids=pages.name)
def test_benchmarks_of_a_page_are_understood(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """They parse what the page gives them, and stop there."""
    parse = argparse.ArgumentParser.parse_args
    monkeypatch.setattr(argparse.ArgumentParser, "parse_args", lambda self: _Parsed.after(parse(self)))
    monkeypatch.chdir(pages.ROOT)
    monkeypatch.syspath_prepend(str(pages.ROOT))
    for line in benchmarks_of(path):
        words = shlex.split(line, comments=True)[1:]
        file = words[1].replace(".", "/") + ".py" if words[0] == "-m" else words[0]
        if file == "benchmarks.py":  # all of them, which take no options
            assert words == ["-m", "benchmarks"]
            continue
        monkeypatch.setattr(sys, "argv", [file, *words[2 if words[0] == "-m" else 1 :]])
        with pytest.raises(_Parsed):
            runpy.run_path(file, run_name="__main__")


class _Parsed(Exception):
    """The options were understood."""

    @classmethod
    def after(cls, _: object) -> NoReturn:
        raise cls


@pytest.mark.parametrize("path", pages.PAGES, ids=pages.name)
def test_commands_stand_in_blocks_that_name_their_language(path: Path) -> None:
    """An indented one would not be looked at by the tests above."""
    assert (
        re.findall(r"^ {4,}(?:\S*/)?(?:dipc-gym|python|pip|make|cc|git) .*$", without_blocks(path), re.MULTILINE) == []
    )


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
@pytest.mark.parametrize("path", [path for path in pages.PAGES if pages.blocks(path, "c")], ids=pages.name)
def test_c_of_a_page_compiles_beside_an_exported_loop(path: Path, tmp_path: Path) -> None:
    exported(tmp_path / "rig.h")
    for k, snippet in enumerate(pages.blocks(path, "c")):
        (tmp_path / f"{k}.c").write_text(snippet)
        subprocess.run(["cc", "-std=c99", "-Wall", "-Wextra", "-Werror", "-c", f"{k}.c"], cwd=tmp_path, check=True)


@pytest.mark.parametrize("path", pages.PAGES, ids=pages.name)
def test_links_and_pictures_lead_to_files(path: Path) -> None:
    """What the site's own check does, for those who read the files where they are; and for the README."""
    for link in re.findall(r"\]\(([^)\s#]+)(?:#[^)]*)?\)", path.read_text(encoding="utf-8")):
        if not link.startswith(("http:", "https:", "mailto:")):
            assert (path.parent / link).is_file(), link


# Closed loops near a limit cycle amplify rounding, by up to 15 % from processor to processor; a diagnosis does not.
WITHIN = {"compensate.ipynb": 0.15, "diagnose.ipynb": 0.02}
NUMBER = re.compile(r"(?<![A-Za-z_\d])-?\d+(?:\.\d+)?(?:e[+-]?\d+)?")


def said(notebook: Path) -> list[str]:
    """What each cell of code prints."""
    cells = [one for one in json.loads(notebook.read_text(encoding="utf-8"))["cells"] if one["cell_type"] == "code"]
    return ["".join("".join(out.get("text", ())) for out in cell["outputs"]) for cell in cells]


@pytest.mark.parametrize("path", pages.NOTEBOOKS, ids=pages.name)
def test_notebooks_run_and_print_what_they_keep(path: Path, tmp_path: Path) -> None:
    pytest.importorskip("nbclient")
    pytest.importorskip("ipykernel")
    (tmp_path / "examples").symlink_to(pages.ROOT / "examples")
    work = tmp_path / path.name
    work.write_bytes(path.read_bytes())
    done = subprocess.run(
        [sys.executable, "-m", "jupyter", "execute", "--inplace", "--kernel_name=python3", str(work)],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    for now, kept in zip(said(work), said(path), strict=True):
        assert NUMBER.sub("#", now).split() == NUMBER.sub("#", kept).split(), "make notebooks keeps what they print"
        numbers, expected = ([float(one) for one in NUMBER.findall(text)] for text in (now, kept))
        assert numbers == pytest.approx(expected, rel=WITHIN[path.name])


@pytest.fixture
def hooks(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(pages.ROOT / "docs"))
    return importlib.import_module("hooks")


def test_every_constant_says_what_it_is_for(hooks: ModuleType) -> None:
    """In whatever folder it is: of the packages, all are walked."""
    files = [path for package in hooks.PACKAGES for path in (pages.ROOT / package).rglob("*.py")]
    bare = {one.name: pages.name(path) for path in files for one in hooks.constants(path) if not one.meaning.strip()}
    assert bare == {}


def test_a_constant_without_a_reason_is_noticed(hooks: ModuleType, tmp_path: Path) -> None:
    """The check itself: bare, private and grouped ones, and what is no setting."""
    path = tmp_path / "one.py"
    path.write_text(
        '# Why.\nA = 1\nB = 2\n_C, D = 3, 4  # both\nE = \'word\'\nF = Format(\'name\', 5)\ng = 6\nH = 7\n"""S."""\n'
    )
    assert {one.name: one.meaning for one in hooks.constants(path)} == {
        "A": "Why.",
        "B": "",
        "_C, D": "both",
        "H": "S.",
    }


def test_a_stage_has_its_constants_in_one_place(hooks: ModuleType) -> None:
    """The stages of the diagnosis keep none beside their settings, whatever its name."""
    for stage in ("estimation", "model", "selection", "verdict"):
        files = (pages.ROOT / "dipc_gym" / "sim2real" / stage).glob("*.py")
        beside = {pages.name(path): [one.name for one in hooks.constants(path)] for path in files}
        settings = beside.pop(f"dipc_gym/sim2real/{stage}/settings.py")
        assert settings
        assert not any(beside.values()), beside


@pytest.mark.parametrize("stage", ["effects.shared", "estimation", "model", "selection", "verdict"])
def test_settings_are_explained_in_the_order_that_they_have(stage: str) -> None:
    """Whoever looks a constant up finds its reason where it stands among the others, and none without."""
    module = importlib.import_module(f"dipc_gym.sim2real.{stage}.settings")
    classes = [one for one in vars(module).values() if dataclasses.is_dataclass(one) and isinstance(one, type)]
    assert classes
    for one in classes:
        explained = re.findall(r"^        (\w+): ", one.__doc__ or "", re.MULTILINE)
        assert explained == [field.name for field in dataclasses.fields(one)], one.__name__


def test_the_settings_page_has_what_decides(hooks: ModuleType) -> None:
    """Made from the code: a constant of each kind is found, with its value and its reason."""
    page = hooks.settings()
    assert (
        "| `EffectSettings.leaves` | `1 / 3` | share of the excess error that effects may leave and be named." in page
    )
    for row in (
        "| `EstimationSettings.growth` | `10.0` | times its size that an initial error may grow to within a window",
        "| `ScoreSettings.worth` | `0.02` | smallest improvement of the mean log square error that is worth an effect",
        "| `VerdictSettings.shorter` | `(2, 4, 8, 16, 32)` |",
    ):
        assert row in page
    for effect in effects.catalogue().values():
        assert f"## {effect.name}\n" in hooks.effects()


def test_pages_count_what_the_code_has() -> None:
    """Effects by their names, and the verdicts: numbers in prose that a new one would make wrong."""
    read = {path: path.read_text(encoding="utf-8") for path in (pages.ROOT / "README.md", pages.ROOT / "CHANGELOG.md")}
    effect_names = {effect.name for effect in effects.catalogue().values()}
    for path, text in read.items():
        told = [int(number) for number in re.findall(r"(\d+) effects", text)]
        assert told == [len(effect_names)], path.name
    table = (pages.ROOT / "docs" / "sim2real" / "verdicts.md").read_text(encoding="utf-8")
    assert set(re.findall(r"^\| \*([a-z ]+)\* \|", table, re.MULTILINE)) == set(VERDICTS)
    assert len(VERDICTS) == 7
    assert "one of [seven words]" in (pages.ROOT / "docs" / "glossary.md").read_text(encoding="utf-8")


def test_the_page_on_the_engine_has_every_file_of_it() -> None:
    page = (pages.ROOT / "docs" / "engine.md").read_text()
    for file in (pages.ROOT / "dipc_gym" / "engine").glob("*.py"):
        assert file.name == "__init__.py" or f"`{file.name}`" in page, file.name


def test_what_decides_is_where_the_page_on_the_method_says() -> None:
    rows = re.findall(r"^\| wh.*", (pages.ROOT / "docs" / "sim2real" / "method.md").read_text(), re.MULTILINE)
    named = [pair for row in rows for pair in re.findall(r"`(\w+/\w+)\.py`: `(\w+)`", row)]
    assert len(named) >= 9
    for file, name in named:
        module = importlib.import_module(f"dipc_gym.sim2real.{file.replace('/', '.')}")
        assert getattr(module, name).__module__ == module.__name__
