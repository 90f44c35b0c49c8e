"""The site: every snippet runs, every command is one that there is, links lead somewhere, notebooks run."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from pathlib import Path

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


@pytest.mark.usefixtures("registries")
@pytest.mark.parametrize("path", WITH_PYTHON, ids=pages.name)
def test_snippets_of_a_page_run_in_order(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "examples").symlink_to(pages.ROOT / "examples")
    monkeypatch.chdir(tmp_path)
    space: dict[str, object] = {"__name__": "__main__"}
    for snippet in pages.blocks(path, "python"):
        exec(compile(snippet, pages.name(path), "exec"), space)


def commands(path: Path) -> list[str]:
    """Lines of shell that call dipc-gym."""
    lines = [line for text in pages.blocks(path, "bash") for line in text.splitlines()]
    return [line.strip() for line in lines if re.match(r"\s*(\S*/)?dipc-gym ", line)]


@pytest.mark.parametrize("path", [path for path in pages.PAGES if commands(path)], ids=pages.name)
def test_commands_of_a_page_are_understood(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every option that a page shows exists, and takes what it is given there; nothing is run."""
    asked: list[object] = []
    for command in cli.COMMANDS.values():
        monkeypatch.setattr(command, "run", lambda self: asked.append(self) or 0)
    for line in commands(path):
        assert cli.main(shlex.split(line, comments=True)[1:]) == 0, line
    assert len(asked) == len(commands(path))


@pytest.mark.parametrize("path", pages.PAGES, ids=pages.name)
def test_links_and_pictures_lead_to_files(path: Path) -> None:
    """What the site's own check does, for those who read the files where they are; and for the README."""
    for link in re.findall(r"\]\(([^)\s#]+)(?:#[^)]*)?\)", path.read_text(encoding="utf-8")):
        if not link.startswith(("http:", "https:", "mailto:")):
            assert (path.parent / link).is_file(), link


@pytest.mark.parametrize("path", pages.NOTEBOOKS, ids=pages.name)
def test_notebooks_run(path: Path, tmp_path: Path) -> None:
    pytest.importorskip("nbclient")
    pytest.importorskip("ipykernel")
    (tmp_path / "examples").symlink_to(pages.ROOT / "examples")
    work = tmp_path / path.name
    work.write_bytes(path.read_bytes())
    done = subprocess.run(
        [sys.executable, "-m", "jupyter", "execute", "--kernel_name=python3", str(work)],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr


def test_the_settings_page_has_what_decides() -> None:
    """Made from the code: a constant of each kind is found, with its value and its reason."""
    sys.path.insert(0, str(pages.ROOT / "docs"))
    try:
        import hooks
    finally:
        sys.path.pop(0)
    page = hooks.settings()
    assert "| `LEAVES` | `1 / 3` | Share of the excess error that effects may leave and be named." in page
    for row in (
        "| `EstimationSettings.growth` | `10.0` | times its size that an initial error may grow to within a window |",
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
