"""Names in backticks in docstrings and comments are of something that there is.

Of a plain name it is enough that the package's code has the word, as a name or within a string. Of a dotted one the
first part is a module, a class or a package of others, and the rest must be found in it; or the whole is a string of
the code, such as the id of an effect, or a file.
"""

from __future__ import annotations

import ast
import builtins
import functools
import importlib
import importlib.util
import io
import re
import tokenize
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import pages
import pytest
from pages import ROOT

PLACES = {"dipc_gym": "dipc_gym", "wrappers": "dipc_gym.wrappers", "compensators": "dipc_gym.compensators"}
FILES = [path for folder in PLACES for path in sorted((ROOT / folder).rglob("*.py"))]
QUOTED = re.compile(r"(?<!`)`([A-Za-z_]\w*(?:\.[A-Za-z_]\w*)*)(?:\(\))?`(?!`)")
FILE = re.compile(r".*\.(json|csv|xml|html|onnx|pt|zip|py|toml|md|png|pdf|gif|mp4|c|h)")
OTHERS = (  # what others call something: MJCF and MuJoCo, Gymnasium, stable-baselines3, Matplotlib, Ray
    *("MjSpec.to_xml", "actearly", "data.ctrl", "data.sensordata", "data.warning", "geom", "inertial", "mjModel"),
    *("ClipAction", "SyncVectorEnv", "VecNormalize.save", "model.save", "Axes.plot", "matplotlibrc", "RAY_ADDRESS"),
)
EXAMPLES = ("at.attribute", "cart.mass", "place.attribute", "servo.pos", "servo.vel", "template.max_models")
STANDS_FOR = re.compile(r"(NAME|STEM)\b|(NAME|STEM)_")  # something that the reader puts in


@dataclass
class Known:
    """What the package's code holds."""

    modules: dict[str, set[str]] = field(default_factory=dict)  # dotted name -> names at its top
    classes: dict[str, set[str]] = field(default_factory=dict)  # name -> attributes, those of all classes so called
    bases: dict[str, set[str]] = field(default_factory=dict)
    made: dict[str, str] = field(default_factory=dict)  # constant -> the class that it is of, such as settings
    words: set[str] = field(default_factory=set)
    strings: set[str] = field(default_factory=set)
    begun: set[str] = field(default_factory=set)  # what strings that are put together begin with

    def attributes(self, name: str) -> set[str]:
        """Of a class and of what it inherits from."""
        found = set(self.classes.get(name, ()))
        for base in self.bases.get(name, ()):
            found |= self.attributes(base)
        return found


def dotted(path: Path) -> str:
    folder, *rest = path.relative_to(ROOT).with_suffix("").parts
    return ".".join([PLACES[folder], *(part for part in rest if part != "__init__")])


def docstrings(tree: ast.AST) -> Iterator[tuple[int, str]]:
    """Line and text of what stands alone as a string, wherever that is."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            yield node.lineno, node.value.value


def comments(text: str) -> Iterator[tuple[int, str]]:
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type == tokenize.COMMENT:
            yield token.start[0], token.string


def tops(body: list[ast.stmt]) -> Iterator[str]:
    """Names that statements define."""
    for node in body:
        if isinstance(node, ast.ClassDef | ast.FunctionDef):
            yield node.name
        elif isinstance(node, ast.Import | ast.ImportFrom):
            yield from ((one.asname or one.name).split(".")[0] for one in node.names)
        elif isinstance(node, ast.Assign | ast.AnnAssign):
            for target in node.targets if isinstance(node, ast.Assign) else [node.target]:
                yield from (name.id for name in ast.walk(target) if isinstance(name, ast.Name))
        elif isinstance(node, ast.If | ast.Try):
            yield from tops(node.body)


@functools.cache
def tree_of(path: Path) -> ast.Module:
    return ast.parse(path.read_text())


@functools.cache
def known() -> Known:
    found = Known()
    for path in FILES:
        tree = tree_of(path)
        found.modules[dotted(path)] = set(tops(tree.body))
        alone = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
        for node in ast.walk(tree):
            match node:
                case ast.ClassDef():
                    its = found.classes.setdefault(node.name, set())
                    its |= set(tops(node.body))
                    its |= {x.attr for x in ast.walk(node) if isinstance(x, ast.Attribute) and _is_self(x.value)}
                    bases = {x.id for base in node.bases for x in ast.walk(base) if isinstance(x, ast.Name)}
                    found.bases.setdefault(node.name, set()).update(bases - {node.name})
                    found.words.add(node.name)
                case ast.Assign(targets=[ast.Name(id=name)], value=ast.Call(func=ast.Name(id=its))):
                    found.made[name] = its
                case ast.FunctionDef():
                    found.words.add(node.name)
                case ast.Name():
                    found.words.add(node.id)
                case ast.Attribute():
                    found.words.add(node.attr)
                case ast.arg() | ast.keyword():
                    found.words.add(node.arg or "")
                case ast.alias():
                    found.words |= set(node.name.split("."))
                case ast.JoinedStr():  # `reward_{name}`
                    found.begun |= {x.value for x in node.values[:-1] if isinstance(x, ast.Constant)}
                case ast.Constant() if isinstance(node.value, str) and id(node) not in alone:
                    found.words |= set(re.findall(r"\w+", node.value))
                    found.strings.add(node.value)
        found.words |= set(dotted(path).split("."))
    return found


def _is_self(node: ast.expr) -> bool:
    return isinstance(node, ast.Name) and node.id in ("self", "cls")


@functools.cache
def exists(name: str) -> bool:
    """Whether there is what a name in backticks says."""
    parts, code = name.split("."), known()
    if name in code.strings or name in OTHERS or name in EXAMPLES or STANDS_FOR.match(name):
        return True
    if len(parts) == 1:
        before, _, after = name.partition("_")
        put_together = f"{before}_" in code.begun and after in code.words
        return name in code.words or hasattr(builtins, name) or put_together
    if FILE.fullmatch(name) or _within(parts) or _imported(parts):
        return True
    for module, names in code.modules.items():  # `simulation.memory`, `train.run`, `mjcf.Source.sha256`
        for cut in range(1, len(parts) + 1):
            if f".{module}".endswith("." + ".".join(parts[:cut])):
                rest = parts[cut:]
                if not rest or (rest[0] in names and _within(rest)):
                    return True
    return False


def _within(parts: list[str]) -> bool:
    """Whether parts are a name by itself, or that of a class, or of one made of it, and of what it has."""
    first = known().made.get(parts[0], parts[0])
    return len(parts) == 1 or (len(parts) == 2 and parts[1] in known().attributes(first))


def _imported(parts: list[str]) -> bool:
    """Whether it is of a package that somebody else wrote."""
    module = {"np": "numpy"}.get(parts[0], parts[0])
    if module not in ("gymnasium", "mujoco", "numpy", "scipy", "torch"):
        return False
    value: object = importlib.import_module(module)
    for part in parts[1:]:
        module = f"{module}.{part}"
        if hasattr(value, part):
            value = getattr(value, part)
        elif importlib.util.find_spec(module) is not None:
            value = importlib.import_module(module)
        else:
            return False
    return True


@pytest.mark.parametrize("path", FILES, ids=pages.name)
def test_names_in_backticks_are_of_something_that_there_is(path: Path) -> None:
    said = [*docstrings(tree_of(path)), *comments(path.read_text())]
    names = [(line, name) for line, one in said for name in QUOTED.findall(one)]
    gone = {f"line {line}": name for line, name in names if not exists(name)}
    assert gone == {}


@pytest.mark.parametrize(
    ("name", "there"),
    [
        ("simulation.memory", True),
        ("mjcf.Source.sha256", True),
        ("Source.sha256", True),
        ("friction.coulomb", True),
        ("policy.json", True),
        ("ESTIMATION.growth", True),
        ("np.exp", True),
        ("exp", True),
        ("reward_rest", True),
        ("stick.DryFriction", False),
        ("choice.no_such", False),
        ("Source.no_such", False),
        ("np.no_such", False),
        ("no_such_name", False),
    ],
)
def test_what_is_gone_is_noticed(name: str, there: bool) -> None:
    """The check itself."""
    assert exists(name) is there
