"""What is public: named in `__all__`, written of in the reference, and all that examples and pages make use of."""

from __future__ import annotations

import ast
import importlib
import importlib.util
import inspect
import json
import pkgutil
import re
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pages
import pytest
from pages import ROOT

import dipc_gym

REFERENCE = sorted((ROOT / "docs" / "reference").glob("*.md"))
PUBLIC = {name for page in REFERENCE for name in re.findall(r"^::: (dipc_gym[\w.]*)$", page.read_text(), re.MULTILINE)}
EXAMPLES = sorted((ROOT / "examples").rglob("*.py"))


def codes() -> Iterator[tuple[str, str]]:
    """Name and text of every piece of Python that people copy from."""
    for path in EXAMPLES:
        yield pages.name(path), path.read_text()
    for path in pages.PAGES:
        yield pages.name(path), pages.python(path)
    for path in pages.NOTEBOOKS:
        cells = json.loads(path.read_text())["cells"]
        lines = [line for cell in cells if cell["cell_type"] == "code" for line in [*cell["source"], "\n"]]
        yield pages.name(path), "".join(line for line in lines if not line.startswith(("!", "%")))


def is_module(name: str) -> bool:
    try:
        return importlib.util.find_spec(name) is not None
    except ModuleNotFoundError:  # its parent is no package
        return False


def not_public(module: str, name: str) -> str:
    """Why `module.name` may not be used, or an empty string."""
    if f"{module}.{name}" in PUBLIC:
        return ""
    if module not in PUBLIC:
        return f"{module} is not in docs/reference"
    return "" if name in importlib.import_module(module).__all__ else f"{name} is not in {module}.__all__"


def reached(text: str) -> Iterator[tuple[str, str]]:
    """Every (module, name) of the package that a piece of code makes use of."""
    tree = ast.parse(text)
    known: dict[str, str] = {}  # name in the code -> module of the package
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            for one in node.names:
                if one.name.split(".")[0] == "dipc_gym":
                    module, _, name = one.name.rpartition(".")
                    yield (module, name) if module else ("dipc_gym", "__version__")
                    known[one.asname or "dipc_gym"] = one.name if one.asname else "dipc_gym"
        elif isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "dipc_gym":
            for one in node.names:
                yield str(node.module), one.name
                if is_module(f"{node.module}.{one.name}") and f"{node.module}.{one.name}" in PUBLIC:
                    known[one.asname or one.name] = f"{node.module}.{one.name}"
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in known:
            yield known[node.value.id], node.attr


@pytest.mark.parametrize(("where", "text"), list(codes()), ids=lambda value: value if "\n" not in value else "")
def test_examples_and_pages_use_public_names_alone(where: str, text: str) -> None:
    reasons = {f"{module}.{name}": not_public(module, name) for module, name in reached(text)}
    assert {name: reason for name, reason in reasons.items() if reason} == {}


def test_a_name_that_is_not_public_is_noticed() -> None:
    """The check itself: both ways to reach past what is public."""
    assert [not_public(*one) for one in reached("from dipc_gym.sim2real.estimation.fit import fit")] != [""]
    assert any(not_public(*one) for one in reached("from dipc_gym import runs\nruns._unwrapped(env)"))
    assert not any(not_public(*one) for one in reached("from dipc_gym import runs\nruns.identify()"))


@pytest.mark.parametrize("name", sorted(PUBLIC))
def test_public_modules_say_what_is_public_and_all_of_it_is_documented(name: str) -> None:
    module = importlib.import_module(name)
    assert module.__doc__
    assert module.__all__ == sorted(module.__all__, key=_as_ruff_sorts)
    for public in module.__all__:
        value = getattr(module, public)
        if inspect.isclass(value) or inspect.isfunction(value):
            assert value.__doc__, f"{name}.{public} has no docstring"


def _as_ruff_sorts(name: str) -> tuple[int, str]:
    """Constants, classes, then the rest."""
    return (0 if name.isupper() else 1 if name[0].isupper() else 2, name)


@pytest.mark.parametrize("path", pages.PAGES, ids=pages.name)
def test_dotted_names_in_the_text_of_pages_exist(path: Path) -> None:
    """`dipc_gym.some.name` in a page: something that can be imported, whether public or not."""
    for dotted in re.findall(r"`(dipc_gym(?:\.\w+)+)[`(]", path.read_text()):
        assert _found(dotted) is not None, dotted


HOUSES = sorted(f"dipc_gym.{one.name}" for one in pkgutil.iter_modules(dipc_gym.__path__) if one.ispkg)
INSIDE = {"docs/engine.md", "docs/security.md"}  # which say how the package works, and name its parts


@pytest.mark.parametrize("path", [path for path in pages.PAGES if pages.name(path) not in INSIDE], ids=pages.name)
def test_dotted_names_that_pages_offer_are_public(path: Path) -> None:
    for dotted in re.findall(r"`(dipc_gym(?:\.\w+)+)[`(]", path.read_text()):
        module, _, name = dotted.rpartition(".")
        assert dotted in PUBLIC or not not_public(module, name), dotted


@pytest.mark.parametrize("path", [path for path in pages.PAGES if pages.name(path) not in INSIDE], ids=pages.name)
def test_names_without_the_package_before_them_are_public(path: Path) -> None:
    """`designs.limit_cycle` in a page: no module to import for whoever reads it."""
    for dotted in re.findall(r"`(\w+(?:\.\w+)+)(?<!\.json)(?<!\.py)[`(]", path.read_text()):
        homes = [package for package in ("dipc_gym", *HOUSES) if is_module(f"{package}.{dotted.split('.')[0]}")]
        for full in (f"{package}.{dotted}" for package in homes if not dotted.startswith("dipc_gym.")):
            module, _, name = full.rpartition(".")
            assert _found(full) is None or full in PUBLIC or not not_public(module, name), dotted


def test_the_overview_of_the_reference_lists_every_module() -> None:
    overview = (ROOT / "docs" / "reference" / "index.md").read_text()
    listed = {
        page: re.findall(r"`([\w.]+)`", modules)
        for page, modules in re.findall(r"^\| \[.*?\]\((\w+\.md)\) \| (.*) \|$", overview, re.MULTILINE)
    }
    documented = {
        page.name: names
        for page in REFERENCE
        if (names := re.findall(r"^::: (dipc_gym[\w.]*)$", page.read_text(), re.MULTILINE))
    }
    assert {page: sorted(names) for page, names in listed.items()} == {
        page: sorted(names) for page, names in documented.items()
    }


def _found(dotted: str) -> object:
    parts = dotted.split(".")
    for cut in range(len(parts), 0, -1):
        if is_module(".".join(parts[:cut])):
            value: object | ModuleType = importlib.import_module(".".join(parts[:cut]))
            for name in parts[cut:]:
                value = getattr(value, name, None)
            return value
    return None
