"""What is on disk, what is declared, and what is shipped are the same."""

from __future__ import annotations

import ast
import doctest
import importlib
import os
import pkgutil
import re
import subprocess
import sys
import tomllib
from importlib import metadata, resources
from pathlib import Path

import pytest

import dipc_gym

ROOT = Path(__file__).resolve().parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
SETUPTOOLS = PROJECT["tool"]["setuptools"]


def folder(package: str) -> Path:
    known = SETUPTOOLS["package-dir"]
    owner = max((name for name in known if package == name or package.startswith(name + ".")), key=len)
    return ROOT.joinpath(known[owner], *package.removeprefix(owner).strip(".").split(".")).resolve()


def test_every_folder_is_a_listed_package() -> None:
    """Those that hold data alone too: setuptools leaves out, in time, what no list names."""
    listed = {folder(package) for package in SETUPTOOLS["packages"]}
    found = {
        path.parent
        for top in SETUPTOOLS["package-dir"].values()
        for path in (ROOT / top).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    assert found == listed


def test_every_other_file_is_package_data() -> None:
    for package in SETUPTOOLS["packages"]:
        patterns = SETUPTOOLS["package-data"].get(package, [])
        shipped = {path for pattern in patterns for path in folder(package).glob(pattern)}
        others = {path for path in folder(package).iterdir() if path.is_file() and path.suffix not in (".py", ".pyc")}
        assert others <= shipped


def test_examples_in_docstrings_run(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    packages = [importlib.import_module(name) for name in SETUPTOOLS["packages"]]
    modules = [
        importlib.import_module(f"{package.__name__}.{found.name}")
        for package in packages
        for found in pkgutil.iter_modules(package.__path__)
        if not found.ispkg and found.name != "__main__"
    ]
    tried = {module.__name__: doctest.testmod(module) for module in [*packages, *modules]}
    assert {name: result.failed for name, result in tried.items() if result.failed} == {}
    assert {name.split(".")[1] for name, result in tried.items() if result.attempted} >= {"compensators", "sim2real"}


def test_versions_agree() -> None:
    assert dipc_gym.__version__ == PROJECT["project"]["version"] == metadata.version("dipc-gym")
    assert f"## {dipc_gym.__version__}" in (ROOT / "CHANGELOG.md").read_text()
    assert f"version: {dipc_gym.__version__}" in (ROOT / "CITATION.cff").read_text()


def test_rig_is_shipped() -> None:
    assert resources.files("dipc_gym").joinpath("rig.xml").is_file()
    assert resources.files("dipc_gym").joinpath("py.typed").is_file()


def test_pins_cover_what_is_declared() -> None:
    pinned = {
        line.split("==")[0].lower().replace("_", "-")
        for line in (ROOT / "constraints.txt").read_text().splitlines()
        if "==" in line
    }
    project = PROJECT["project"]
    declared = [
        *project["dependencies"],
        *(item for extra in project["optional-dependencies"].values() for item in extra),
    ]
    names = {re.split(r"[\[<>=!~ ;]", item)[0].lower() for item in declared} - {"dipc-gym"}
    assert names <= pinned


@pytest.mark.parametrize("top", ["dipc_gym", "wrappers", "compensators", "examples", "benchmarks"])
def test_imports_are_absolute(top: str) -> None:
    for path in (ROOT / top).rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom):
                assert node.level == 0, path
                assert (node.module or "").split(".")[0] not in ("wrappers", "compensators"), path


def test_every_extra_for_users_is_in_the_documentation() -> None:
    page = (ROOT / "docs" / "start.md").read_text()
    named = set(re.findall(r"^\| `(\w+)` \|", page, re.MULTILINE))
    assert named == set(PROJECT["project"]["optional-dependencies"]) - {"test", "dev"}


@pytest.mark.parametrize(
    ("missing", "extra", "arguments"),
    [
        ("numba", "trial", ["trial", "--count", "1"]),
        ("stable_baselines3", "rl", ["train-policy", "--compensator", "none"]),
        ("ray", "ray", ["compare", "--compensator", "none", "--backend", "ray"]),
        ("casadi", "plan", ["plan"]),
    ],
)
def test_a_package_that_is_not_installed_is_named_with_its_extra(
    missing: str, extra: str, arguments: list[str], tmp_path: Path
) -> None:
    gone, work = tmp_path / "gone", tmp_path / "work"
    gone.mkdir()
    work.mkdir()
    error = f"raise ModuleNotFoundError({f'No module named {missing!r}'!r}, name={missing!r})"
    (gone / f"{missing}.py").write_text(error)
    command = [sys.executable, "-P", "-m", "dipc_gym", *arguments, "--out", str(work / "out.json")]
    environment = os.environ | {"PYTHONPATH": f"{gone}{os.pathsep}{os.environ.get('PYTHONPATH', '')}"}
    done = subprocess.run(command, cwd=work, env=environment, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 2, done.stderr
    assert missing in done.stderr
    assert f"'.[{extra}]'" in done.stderr
    assert not list(work.iterdir())
