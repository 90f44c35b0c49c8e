"""What the pages take from the code when the site is built, so that they cannot go stale.

`{{ settings }}` on a page becomes the tables of decision constants, `{{ effects }}` a section for each effect of the
catalogue, `{{ commands }}` the help of every command, `{{ contributing }}` the guide at the top of the repository.
"""

from __future__ import annotations

import ast
import re
import shutil
import subprocess
import sys
import textwrap
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("dipc_gym", "compensators", "wrappers")
TITLES = {
    "dipc_gym": "Environment, runs and sweeps",
    "dipc_gym/cli": "Command line",
    "dipc_gym/mjcf": "Models",
    "dipc_gym/recording": "Recordings",
    "dipc_gym/sim2real": "Diagnosis",
    "dipc_gym/sim2real/model": "Diagnosis: model and parameters",
    "dipc_gym/trials": "Blind trials",
}
"""Of folders whose name does not say it."""


def on_startup(**_: Any) -> None:
    """Lay the packages out as they are installed: the reference is read from there (`paths` in mkdocs.yml)."""
    place = ROOT / "build" / "docs-source"
    shutil.rmtree(place, ignore_errors=True)
    packages = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["setuptools"]["package-dir"]
    for name, folder in packages.items():
        shutil.copytree(ROOT / folder, place.joinpath(*name.split(".")), ignore=shutil.ignore_patterns("__pycache__"))
    for path in place.rglob("*.py"):  # only the plural is read as code
        text = path.read_text(encoding="utf-8")
        path.write_text(re.sub(r"^( +)Example:$", r"\1Examples:", text, flags=re.MULTILINE), encoding="utf-8")


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Fill in what is taken from the code."""
    for mark, made in (
        ("settings", settings),
        ("effects", effects),
        ("commands", commands),
        ("contributing", contributing),
    ):
        if f"{{{{ {mark} }}}}" in markdown:
            markdown = markdown.replace(f"{{{{ {mark} }}}}", made())
    return markdown


def settings() -> str:
    """A table of decision constants for each folder of the packages."""
    files = [path for package in PACKAGES for path in sorted((ROOT / package).rglob("*.py"))]
    parts = []
    for folder, of_folder in groupby(sorted(files, key=lambda path: (path.parent, path)), key=lambda path: path.parent):
        rows = [row(one, path) for path in of_folder for one in constants(path)]
        if rows:
            parts += [f"## {title(folder)}", "", "| name | value | meaning | file |", "|---|---|---|---|", *rows, ""]
    return "\n".join(parts)


def title(folder: Path) -> str:
    """What a folder is called: its name, and that of the room that it is in."""
    name = folder.relative_to(ROOT).as_posix()
    if name in TITLES:
        return TITLES[name]
    above = TITLES.get(folder.parent.relative_to(ROOT).as_posix(), "") if folder.parent.name != "dipc_gym" else ""
    own = folder.name.replace("_", " ")
    return f"{above}: {own}" if above else own.capitalize()


@dataclass(frozen=True)
class Constant:
    """A number by which the package decides.

    Attributes:
        name: with its class, of a field.
        value: as the code has it.
        meaning: what is said of it there; empty where nothing is.
    """

    name: str
    value: str
    meaning: str


def constants(path: Path) -> Iterator[Constant]:
    """Of a file: its numbers in capitals, and the fields of its `...Settings`, with what is said of them."""
    text = path.read_text(encoding="utf-8")
    lines = text.splitlines()
    body = ast.parse(text).body
    for node, after in zip(body, [*body[1:], None], strict=True):
        if isinstance(node, ast.ClassDef) and node.name.endswith("Settings"):
            said = attributes(ast.get_docstring(node) or "")
            for field in node.body:
                if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name) and field.value:
                    name, meaning = field.target.id, comment(lines, field)
                    yield Constant(f"{node.name}.{name}", source(text, field.value), said.get(name) or meaning)
        elif isinstance(node, ast.Assign | ast.AnnAssign) and node.value and has_number(node.value):
            target = node.targets[0] if isinstance(node, ast.Assign) else node.target
            names = [
                x.id for x in (target.elts if isinstance(target, ast.Tuple) else [target]) if isinstance(x, ast.Name)
            ]
            meaning = comment(lines, node)
            if not meaning and isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant):
                meaning = str(after.value.value)
            if names and all(re.fullmatch(r"_?[A-Z][A-Z0-9_]*", name) for name in names):
                yield Constant(", ".join(names), source(text, node.value), meaning)


def source(text: str, value: ast.expr) -> str:
    """A value as the code has it."""
    return " ".join((ast.get_source_segment(text, value) or "").split())


def has_number(value: ast.expr) -> bool:
    """Whether there is a number in an expression: names and formats decide nothing, nor do things that are made."""
    called = [x.func for x in ast.walk(value) if isinstance(x, ast.Call)]
    names = [
        one.id if isinstance(one, ast.Name) else one.attr for one in called if isinstance(one, ast.Name | ast.Attribute)
    ]
    if any(name[0].isupper() or name in ("zeros", "ones") for name in names):
        return False  # a class says what its fields are, and an empty array has a size alone
    return any(isinstance(x, ast.Constant) and type(x.value) in (int, float) for x in ast.walk(value))


def attributes(docstring: str) -> dict[str, str]:
    """What the section `Attributes:` says of each name."""
    section = docstring.partition("Attributes:\n")[2]
    return dict(re.findall(r"^ {4}(\w+): (.+?)(?=^ {4}\w+:|\n\n|\Z)", section, re.MULTILINE | re.DOTALL))


def comment(lines: list[str], node: ast.stmt) -> str:
    """The comment behind a statement, or the one above it."""
    last = lines[(node.end_lineno or node.lineno) - 1]
    if "  # " in last:
        return last.partition("  # ")[2]
    above: list[str] = []
    for line in reversed(lines[: node.lineno - 1]):
        if not line.startswith("# "):
            break
        above.insert(0, line[2:])
    return " ".join(above)


def row(one: Constant, path: Path) -> str:
    """One row; a long value is left to the file."""
    shown = one.value if len(one.value) <= 40 else "in the file"
    cells = (f"`{one.name}`", f"`{shown}`", " ".join(one.meaning.split()), f"`{path.relative_to(ROOT)}`")
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def effects() -> str:
    """A section for each effect of the catalogue, its forms together."""
    from dipc_gym.sim2real import catalogue

    parts: list[str] = []
    for name, forms in _named(catalogue().values()):
        parts += [f"## {name}", ""]
        for effect in forms:
            if len(forms) > 1:
                parts += [f"### {effect.id}", ""]
            parts += [f"{_plain(effect.__doc__)}", ""]
            parts += [f"Acts at: {effect.place}.", ""]
            parts += ["| parameter | unit | from | to | |", "|---|---|---|---|---|"]
            parts += [
                f"| {p.name} | {p.unit or '-'} | {p.low:g} | {p.high:g} | "
                f"{'on a logarithmic scale' if p.log else ''}{'not fitted' if p.fixed else ''} |"
                for p in effect.parameters
            ]
            parts += [""]
            if effect.contains:
                parts += [
                    f"Contains: {_links(effect.contains)} (a nested model: this with a parameter at its limit).",
                    "",
                ]
            if effect.rivals:
                parts += [f"Easily mistaken for: {_links(effect.rivals)}.", ""]
            if effect.needs_loader:
                parts += ["Stock MuJoCo leaves it out: load the model with `dipc_gym.physics.load`.", ""]
    return "\n".join(parts)


def _named(found: Any) -> list[tuple[str, list[Any]]]:
    names: dict[str, list[Any]] = {}
    for effect in found:
        names.setdefault(effect.name, []).append(effect)
    return list(names.items())


def _links(ids: tuple[str, ...]) -> str:
    return ", ".join(f"[{one}](#{re.sub('[^a-z_-]', '', one.partition(':')[0].lower())})" for one in ids)


def _plain(text: str | None) -> str:
    return "\n\n".join(" ".join(part.split()) for part in (text or "").split("\n\n"))


def commands() -> str:
    """The help of every command, as the terminal prints it."""
    from dipc_gym.cli import COMMANDS

    parts = []
    for name in COMMANDS:
        done = subprocess.run(
            [sys.executable, "-m", "dipc_gym", name, "--help"],
            capture_output=True,
            text=True,
            check=True,
            env={"PATH": "", "COLUMNS": "88", "NO_COLOR": "1", "PYTHONIOENCODING": "utf-8"},
        )
        plain = re.sub(r"\x1b\[[0-9;]*m", "", done.stdout).strip()
        parts += [f"## {name}", "", "```text", *(folded(line) for line in plain.splitlines()), "```", ""]
    return "\n".join(parts)


def folded(line: str) -> str:
    """A line of help that a page has room for; what is drawn in a box has been folded already."""
    return line if line.startswith(("│", " ")) else "\n".join(textwrap.wrap(line, 88)) or line


def contributing() -> str:
    """The guide, without its title; its links are relative to the repository."""
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    return text.partition("\n")[2].replace("](docs/", "](")
