"""Look at an MJCF text before anything compiles it.

MuJoCo follows `../` and absolute paths out of a model's folder, even from a string, and a few lines can ask for a
hundred million bodies. The scan walks through the XML, refuses entities, follows includes and sub-models, counts
what `replicate` and its kin multiply, and loads every file that the model names, from the model's folder only.
"""

from __future__ import annotations

import math
import posixpath
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from xml.parsers import expat

from dipc_gym.safety.places import PlaceError, inside

MAX_TEXT = 20_000_000  # bytes of XML, everything that is included counted as often as it is
MAX_FILES = 400_000_000  # bytes of all files that a model pulls in
MAX_DEPTH = 50  # files that include one another
MAX_NAME = 200  # characters; messages and reports say names in full
MAX_NESTED = 300  # elements in each other; chains of a hundred links have fewer
NAMING = ("name", "prefix", "suffix", "sep", "model")  # attributes that names are made of
MAX_PATH = 1_000  # characters of a file's name with its folders
MAX_ELEMENTS = 100_000  # XML elements after replicate, composite and flexcomp are multiplied out


class MjcfError(ValueError):
    """An MJCF that cannot be used; the message names the file, the element or line, and the mend."""


def scan(text: str, name: str, folder: Path, known: Mapping[str, bytes] | None = None) -> dict[str, bytes]:
    """Scan a model and load the files it names.

    Args:
        text: the XML.
        name: what messages call it.
        folder: the folder that all its files must lie in.
        known: files of it that were read before, by the path that MuJoCo asks for.

    Returns:
        File contents, by the path that MuJoCo asks for.

    Raises:
        MjcfError: as the module says.
    """
    whole = _Scan(folder.resolve(), known or {})
    whole.document(text, name, base="", ancestors=())
    return whole.files


def load_text(path: Path, name: str) -> str:
    """Text of an XML file.

    Raises:
        MjcfError: no such file, too large, or not UTF-8.
    """
    if not path.is_file():
        raise MjcfError(f"{name}: no such model file")
    return _decode(_load(path, name, MAX_TEXT), name)


@dataclass
class _Document:
    """A main model or a sub-model: what its includes share."""

    base: str  # its folder, relative to the main model's
    meshdir: str = ""
    texturedir: str = ""
    strippath: bool = False
    assets: list[tuple[str, str, str]] = field(default_factory=list)  # element, file, where it is named
    models: list[tuple[str, str]] = field(default_factory=list)  # file, where it is named

    def compiler(self, attributes: dict[str, str]) -> None:
        """Note where assets are looked up. The last setting holds for all; meshdir goes before assetdir."""
        both = attributes.get("assetdir")
        self.meshdir = attributes.get("meshdir", self.meshdir if both is None else both)
        self.texturedir = attributes.get("texturedir", self.texturedir if both is None else both)
        self.strippath = attributes.get("strippath", str(self.strippath).lower()) == "true"

    def asset(self, element: str, file: str) -> str:
        """Where MuJoCo looks for an asset, relative to the main model."""
        directory = self.texturedir if element == "texture" else self.meshdir
        return posixpath.join(self.base, directory, posixpath.basename(file) if self.strippath else file)


class _Scan:
    def __init__(self, folder: Path, known: Mapping[str, bytes]) -> None:
        self.folder, self.known = folder, known
        self.files: dict[str, bytes] = {}
        self.file_bytes = 0
        self.text_bytes = 0
        self.elements = 0.0

    def document(self, text: str, name: str, base: str, ancestors: tuple[str, ...]) -> None:
        document = _Document(base)
        self.xml(text, name, document, ancestors, 1.0, outermost=True)
        for element, file, where in document.assets:
            self.fetch(document.asset(element, file), where)
        for file, where in document.models:
            path, inner = self.fetch_xml(posixpath.join(base, file), where, ancestors)
            self.document(inner, f"{name} -> {path}", posixpath.dirname(path), (*ancestors, path))

    def xml(
        self,
        text: str,
        name: str,
        document: _Document,
        ancestors: tuple[str, ...],
        factor: float,
        outermost: bool,
        depth: int = 0,
    ) -> None:
        """Walk through one XML text; `factor` says how often its place is replicated, `depth` how deep it stands."""
        self.text_bytes += len(text)
        if self.text_bytes > MAX_TEXT:
            raise MjcfError(f"{name}: the model has more than {MAX_TEXT:,} characters with its includes")
        parser = expat.ParserCreate()
        factors = [factor]

        def start(element: str, attributes: dict[str, str]) -> None:
            where = f"{name}, line {parser.CurrentLineNumber}, <{element}>"
            if outermost and len(factors) == 1 and element != "mujoco":
                raise MjcfError(f"{where}: not an MJCF file; its outermost element must be <mujoco>")
            if len(attributes.get("name", "")) > MAX_NAME:
                raise MjcfError(f"{where}: its name has more than {MAX_NAME} characters; give it a shorter one")
            for key in NAMING:
                if not attributes.get(key, "").isprintable():  # a terminal may take orders from such characters
                    raise MjcfError(f"{where}: its {key} has characters that cannot be printed; remove them")
            if depth + len(factors) > MAX_NESTED:
                raise MjcfError(f"{where}: elements may stand {MAX_NESTED} deep in each other, and no deeper")
            own = factors[-1] * _multiple(element, attributes, where)
            factors.append(own if element == "replicate" else factors[-1])
            self.elements += own
            if self.elements > MAX_ELEMENTS:
                raise MjcfError(f"{where}: the model multiplies into more than {MAX_ELEMENTS:,} elements")
            if element == "compiler":
                document.compiler(attributes)
            files = [value for key, value in attributes.items() if key.startswith("file") and value]
            for file in (value.replace("\\", "/") for value in files):
                if element == "include":
                    path, inner = self.fetch_xml(posixpath.join(document.base, file), where, ancestors)
                    within, deeper = (*ancestors, path), depth + len(factors)
                    self.xml(inner, f"{name} -> {path}", document, within, factors[-1], False, deeper)
                elif element == "model":
                    document.models.append((file, where))
                else:
                    document.assets.append((element, file, where))

        def end(_: str) -> None:
            factors.pop()

        def refuse(*_: object) -> None:
            raise MjcfError(
                f"{name}, line {parser.CurrentLineNumber}: document types and entities are not allowed; "
                "remove the <!DOCTYPE ...> part"
            )

        parser.StartElementHandler, parser.EndElementHandler = start, end
        parser.StartDoctypeDeclHandler = parser.EntityDeclHandler = refuse
        try:
            parser.Parse(text, True)
        except expat.ExpatError as error:
            raise MjcfError(f"{name}, line {error.lineno}: {expat.ErrorString(error.code)}") from None
        except UnicodeEncodeError:
            raise MjcfError(f"{name}: contains characters that UTF-8 does not have") from None

    def fetch_xml(self, path: str, where: str, ancestors: tuple[str, ...]) -> tuple[str, str]:
        key = self.fetch(path, where)
        if key in ancestors:
            raise MjcfError(f"{where}: {key!r} contains itself")
        if len(ancestors) >= MAX_DEPTH:
            raise MjcfError(f"{where}: {key!r} is included {MAX_DEPTH} files deep; put them into fewer files")
        return key, _decode(self.files[key], f"{where}, file {key!r}")

    def fetch(self, path: str, where: str) -> str:
        """Load one file of the model's folder; returns the name that MuJoCo asks for."""
        if len(path) > MAX_PATH:
            raise MjcfError(f"{where}: its file's name has more than {MAX_PATH:,} characters; give a shorter one")
        key = posixpath.normpath(path)
        if key in self.files:
            return key
        if key in self.known:
            self.files[key] = self.known[key]
            return key
        if key.startswith("/") or ":" in key:
            raise MjcfError(f"{where}: {path!r} is not a path inside the model's folder; use a relative one")
        try:
            full = inside(self.folder, key)
        except PlaceError:
            raise MjcfError(
                f"{where}: {path!r} leads out of the model's folder {self.folder}; move the file into that folder"
            ) from None
        if not full.is_file():
            raise MjcfError(f"{where}: file {key!r} is not in {self.folder}")
        self.files[key] = _load(full, where, MAX_FILES - self.file_bytes)
        self.file_bytes += len(self.files[key])
        return key


def _multiple(element: str, attributes: dict[str, str], where: str) -> float:
    """How many elements one element stands for."""
    if element not in ("replicate", "composite", "flexcomp"):
        return 1.0
    numbers = f"{attributes.get('count', '1')} {attributes.get('cellcount', '1')}".split()
    try:
        multiple = math.prod(max(1.0, abs(float(number))) for number in numbers)
    except ValueError:
        multiple = math.nan
    if math.isnan(multiple):
        raise MjcfError(f"{where}: count {attributes.get('count')!r} is not a number")
    return multiple


def _load(path: Path, where: str, limit: int) -> bytes:
    try:
        size = path.stat().st_size
        if size > limit:
            raise MjcfError(f"{where}: {path.name} is too large ({size:,} bytes; {limit:,} are left to the model)")
        return path.read_bytes()
    except OSError as error:
        raise MjcfError(f"{where}: {path} cannot be read: {error.strerror}") from None


def _decode(data: bytes, name: str) -> str:
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise MjcfError(f"{name}: not UTF-8 text at byte {error.start}; save the XML as UTF-8") from None
