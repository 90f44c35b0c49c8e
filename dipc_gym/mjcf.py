"""MJCF from strangers: scan it, compile it under limits, and ask the model what it commands and senses.

A model file is hostile input. MuJoCo follows `../` and absolute paths out of the model's folder, and a small file
can ask for a hundred million bodies. So `read` and `from_text` look at the text before anything is compiled, load
every file it names themselves, and `compile` first tries the result in a child process with a limit on time and
memory. MuJoCo then sees these loaded files only.
"""

from __future__ import annotations

import functools
import hashlib
import math
import os
import signal
import struct
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING
from xml.parsers import expat

import mujoco
import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

MAX_TEXT = 20_000_000  # bytes of one XML file
MAX_FILES = 400_000_000  # bytes of all files a model pulls in
MAX_ELEMENTS = 100_000  # XML elements after replicate, composite and flexcomp are expanded
CHILD_CPU = 20  # seconds of processor time for the trial compilation
CHILD_WALL = 60  # seconds on the clock for the trial compilation
CHILD_MEMORY = 4 << 30  # bytes of address space for the trial compilation

SUPPORTED = (
    "Supported are models with hinge and slide joints and no contacts, with any number of actuators, "
    "whose scalar sensors determine the joints."
)


class MjcfError(ValueError):
    """An MJCF that cannot be used; the message names the file, the element or line, and the mend."""


@dataclass(frozen=True)
class Source:
    """The text of a model and everything it pulls in.

    Attributes:
        path: where the text was read from; None for text from memory.
        folder: the folder that every file of the model must lie in.
        text: the XML.
        files: contents of included and referenced files, by the path that MuJoCo asks for.
    """

    path: Path | None
    folder: Path
    text: str
    files: Mapping[str, bytes] = field(default_factory=dict, repr=False)

    @property
    def name(self) -> str:
        """What messages call this model."""
        return str(self.path) if self.path else "MJCF text"

    @functools.cached_property
    def sha256(self) -> str:
        """Digest of the text and of every file."""
        digest = hashlib.sha256(self.text.encode())
        for name in sorted(self.files):
            digest.update(name.encode() + b"\0" + hashlib.sha256(self.files[name]).digest())
        return digest.hexdigest()

    def edited(self, text: str) -> Source:
        """The same model with another text; its files stay as they were read."""
        return replace(self, text=text)


def read(path: str | Path) -> Source:
    """Read and scan a model file; nothing is compiled.

    Args:
        path: an MJCF file. All it includes or references must lie in its folder.

    Raises:
        MjcfError: the file is missing, too large, not UTF-8, not well-formed, not MJCF, has a document type
            declaration, reaches outside its folder, names a file that is not there, or multiplies into too many
            elements.
    """
    path = Path(path)
    if not path.is_file():
        raise MjcfError(f"{path}: no such model file")
    return _scanned(path, path.parent, _decode(_load(path, str(path), MAX_TEXT), str(path)))


def from_text(text: str, folder: str | Path | None = None) -> Source:
    """Scan a model held in a string; files it names are looked up in `folder` (the current one if not given).

    Raises:
        MjcfError: as `read`.
    """
    if len(text.encode(errors="replace")) > MAX_TEXT:
        raise MjcfError(f"MJCF text: longer than {MAX_TEXT:,} bytes")
    return _scanned(None, Path.cwd() if folder is None else Path(folder), text)


def compile(source: Source | str | Path, *, trusted: bool = False) -> mujoco.MjModel:
    """Compile a model: scan, trial run in a child process with limits, then here.

    The child costs about 15 ms, once per content and process. It loads MuJoCo's library without Python's numerics.

    Args:
        source: a scanned source, a path, or MJCF text (a string that contains `<`).
        trusted: skip scan and child; for text that the project itself made from a checked source.

    Returns:
        The compiled model.

    Raises:
        MjcfError: as `read`; or the model does not compile, with MuJoCo's message; or it needs more time or memory
            than allowed.

    Example:
        >>> model = compile('<mujoco><worldbody><body><joint name="a"/><geom size="1"/></body></worldbody></mujoco>')
        >>> model.nq
        1
    """
    if not isinstance(source, Source):
        is_text = isinstance(source, str) and "<" in source
        source = from_text(str(source)) if is_text else read(source)
    elif not trusted and source.sha256 not in _tried:
        source = _scanned(source.path, source.folder, source.text)
    quiet_mujoco()
    if not trusted and source.sha256 not in _tried:
        _try_in_child(source)
        _tried.add(source.sha256)
    try:
        return mujoco.MjModel.from_xml_string(source.text, assets=dict(source.files))
    except ValueError as error:
        raise MjcfError(f"{source.name}: {_one_line(str(error))}") from None


def quiet_mujoco() -> None:
    """Stop MuJoCo from writing MUJOCO_LOG.TXT into the current folder and warnings to the terminal.

    The warnings stay countable in `data.warning`, and whoever simulates has to look there.
    """
    config = mujoco.MjLogConfig.get()
    if config.logto_file or config.logto_console:
        config.logto_file = config.logto_console = False
        config.set()


# ------------------------------------------------------------------------------------ what a model commands and senses


def controls(model: mujoco.MjModel) -> list[str]:
    """Names of the model's controls, in the order of `data.ctrl`.

    A passive actuator (`input="none"`) has no control and no name here. One with several inputs has one name for
    each: `servo.pos`, `servo.vel`.

    Raises:
        MjcfError: an actuator with a control has no name.
    """
    names = [""] * model.nu
    for actuator in range(model.nactuator):
        name = model.actuator(actuator).name
        first, count = int(model.actuator_ctrladr[actuator]), int(model.actuator_ctrlnum[actuator])
        if count and not name:
            raise MjcfError(
                f"actuator {actuator} has no name; recordings are matched by name, so give it one"
            )
        for k in range(count):
            part = mujoco.mj_actuatorInputName(model, actuator, k) or str(k)
            names[first + k] = name if count == 1 else f"{name}.{part}"
    return names


def scalar_sensors(model: mujoco.MjModel) -> list[str]:
    """Names of the model's sensors that measure one number, in the model's order; unnamed ones are left out."""
    return [
        model.sensor(i).name
        for i in range(model.nsensor)
        if model.sensor_dim[i] == 1 and model.sensor(i).name
    ]


def sensor_addresses(model: mujoco.MjModel) -> NDArray[np.intp]:
    """Where the `scalar_sensors` stand in `data.sensordata`."""
    return np.array([model.sensor(name).adr[0] for name in scalar_sensors(model)], dtype=np.intp)


def check_supported(model: mujoco.MjModel) -> None:
    """Refuse models that the system identification cannot treat.

    Raises:
        MjcfError: free or ball joints, flexible bodies, geoms that can touch, no joint, or no named scalar sensor.
    """
    for joint in range(model.njnt):
        kind = mujoco.mjtJoint(model.jnt_type[joint])
        if kind not in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE):
            word = "free" if kind == mujoco.mjtJoint.mjJNT_FREE else "ball"
            raise MjcfError(f"joint {_label(model.joint(joint))} is a {word} joint. {SUPPORTED}")
    if model.nflex:
        raise MjcfError(f"the model has flexible bodies (flex). {SUPPORTED}")
    if not model.nv:
        raise MjcfError(f"the model has no joints, so nothing in it moves. {SUPPORTED}")
    if not scalar_sensors(model):
        raise MjcfError(f"the model has no named scalar sensor, such as <jointpos name=.../>. {SUPPORTED}")
    pair = touching_pair(model)
    if pair:
        raise MjcfError(
            f'geoms {pair[0]} and {pair[1]} can touch. {SUPPORTED} If they never touch, set contype="0" '
            'conaffinity="0" on them, or <option><flag contact="disable"/></option>.'
        )


def touching_pair(model: mujoco.MjModel) -> tuple[str, str] | None:
    """The first two geoms whose contact the model allows, or None; MuJoCo's own filters, no geometry."""
    if model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_CONTACT:
        return None
    if model.npair:
        return _label(model.geom(model.pair_geom1[0])), _label(model.geom(model.pair_geom2[0]))
    parents_touch = bool(model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_FILTERPARENT)
    excluded = set(model.exclude_signature.tolist())
    weld, parent = model.body_weldid, model.body_parentid
    solid = [g for g in range(model.ngeom) if model.geom_contype[g] or model.geom_conaffinity[g]]
    for i, g in enumerate(solid):
        for h in solid[i + 1 :]:
            a, b = int(model.geom_bodyid[g]), int(model.geom_bodyid[h])
            wa, wb = int(weld[a]), int(weld[b])
            if wa == wb or (min(a, b) << 16) + max(a, b) in excluded:
                continue
            related = wa and wb and (weld[parent[wa]] == wb or weld[parent[wb]] == wa)
            if related and not parents_touch:
                continue
            if (model.geom_contype[g] & model.geom_conaffinity[h]) or (
                model.geom_contype[h] & model.geom_conaffinity[g]
            ):
                return _label(model.geom(g)), _label(model.geom(h))
    return None


def _label(thing: object) -> str:
    name, number = getattr(thing, "name", ""), getattr(thing, "id", "?")
    return repr(name) if name else f"number {number}"


# -------------------------------------------------------------------------------------------------------------- the scan


@dataclass
class _Directories:
    """Folders in which MuJoCo looks for assets, as the compiler elements of one model set them."""

    mesh: str = ""
    texture: str = ""


def _scanned(path: Path | None, folder: Path, text: str) -> Source:
    name = str(path) if path else "MJCF text"
    scan = _Scan(folder)
    scan.document(text, name, base=PurePosixPath())
    return Source(path, folder, text, scan.files)


class _Scan:
    """One pass over a model and the XML it pulls in, collecting every file it names."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder.resolve()
        self.files: dict[str, bytes] = {}
        self.size = 0
        self.elements = 0.0

    def document(self, text: str, name: str, base: PurePosixPath, ancestors: tuple[str, ...] = ()) -> None:
        """Scan a main model or a sub-model; its assets lie relative to `base`."""
        directories = _Directories()
        assets: list[tuple[str, str, str]] = []
        models: list[tuple[str, str]] = []
        self._xml(text, name, directories, assets, models, base, ancestors, 1.0, root="mujoco")
        for tag, file, where in assets:
            folder = directories.texture if tag == "texture" else directories.mesh
            self.fetch(base / folder / file, where)
        for file, where in models:
            target = base / file
            if str(target) in ancestors:
                raise MjcfError(f"{where}: {file!r} contains itself")
            data = self.fetch(target, where)
            label = f"{name} -> {file}"
            self.document(_decode(data, label), label, target.parent, (*ancestors, str(target)))

    def fetch(self, target: PurePosixPath, where: str) -> bytes:
        """Load one file, which must lie in the model's folder, under the name that MuJoCo asks for."""
        key = str(target)
        if key in self.files:
            return self.files[key]
        if target.is_absolute() or ":" in key:
            raise MjcfError(f"{where}: {key!r} is not a path inside the model's folder; use a relative one")
        full = (self.folder / target).resolve()
        if not full.is_relative_to(self.folder) or ".." in target.parts:
            raise MjcfError(
                f"{where}: {key!r} leads out of the model's folder {self.folder}; "
                "move the file into that folder and name it without '..'"
            )
        if not full.is_file():
            raise MjcfError(f"{where}: file {key!r} is not in {self.folder}")
        self.files[key] = _load(full, where, MAX_FILES - self.size)
        self.size += len(self.files[key])
        return self.files[key]

    def _xml(
        self,
        text: str,
        name: str,
        directories: _Directories,
        assets: list[tuple[str, str, str]],
        models: list[tuple[str, str]],
        base: PurePosixPath,
        ancestors: tuple[str, ...],
        factor: float,
        root: str | None = None,
    ) -> None:
        parser = expat.ParserCreate()
        factors = [factor]

        def start(tag: str, attributes: dict[str, str]) -> None:
            where = f"{name}, line {parser.CurrentLineNumber}, <{tag}>"
            if root and len(factors) == 1 and tag != root:
                raise MjcfError(f"{where}: not an MJCF file; its outermost element must be <{root}>")
            repeat = factors[-1]
            if tag == "replicate":
                repeat *= _count(attributes.get("count", "1"), where)
            grown = repeat
            if tag in ("composite", "flexcomp"):
                grown *= _count(attributes.get("count", "1"), where) * _count(
                    attributes.get("cellcount", "1"), where
                )
            factors.append(repeat)
            self.elements += grown
            if self.elements > MAX_ELEMENTS:
                raise MjcfError(f"{where}: the model multiplies into more than {MAX_ELEMENTS:,} elements")
            if tag == "compiler":
                both = attributes.get("assetdir", "")
                directories.mesh = attributes.get("meshdir", both or directories.mesh)
                directories.texture = attributes.get("texturedir", both or directories.texture)
            for key, value in attributes.items():
                if key.startswith("file") and value:
                    self._reference(tag, value.replace("\\", "/"), where, models, assets, include)

        def include(file: str, where: str) -> None:
            target = base / file
            if str(target) in ancestors:
                raise MjcfError(f"{where}: {file!r} includes itself")
            data, label = self.fetch(target, where), f"{name} -> {file}"
            inner = (*ancestors, str(target))
            self._xml(_decode(data, label), label, directories, assets, models, base, inner, factors[-1])

        def end(tag: str) -> None:
            factors.pop()

        def refuse(*_: object) -> None:
            raise MjcfError(
                f"{name}, line {parser.CurrentLineNumber}: document type declarations and entities are not allowed; "
                "remove the <!DOCTYPE ...> part"
            )

        parser.StartElementHandler, parser.EndElementHandler = start, end
        parser.StartDoctypeDeclHandler = parser.EntityDeclHandler = refuse
        try:
            parser.Parse(text, True)
        except expat.ExpatError as error:
            raise MjcfError(f"{name}, line {error.lineno}: {expat.ErrorString(error.code)}") from None

    def _reference(self, tag, file, where, models, assets, include) -> None:  # type: ignore[no-untyped-def]
        if tag == "include":
            include(file, where)
        elif tag == "model":
            models.append((file, where))
        else:
            assets.append((tag, file, where))


def _count(text: str, where: str) -> float:
    try:
        return math.prod(max(1.0, abs(float(number))) for number in text.split())
    except ValueError:
        raise MjcfError(f"{where}: count {text!r} is not a number") from None


def _load(path: Path, where: str, limit: int) -> bytes:
    if path.stat().st_size > limit:
        raise MjcfError(f"{where}: {path.name} is too large ({path.stat().st_size:,} bytes)")
    return path.read_bytes()


def _decode(data: bytes, name: str) -> str:
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise MjcfError(f"{name}: not UTF-8 text at byte {error.start}; save the XML as UTF-8") from None


# ------------------------------------------------------------------------------------------------------------- the child

_tried: set[str] = set()  # contents that compiled in a child of this process

_CHILD = """
import ctypes as c, os, resource, struct, sys
memory, cpu = int(sys.argv[2]), int(sys.argv[3])
resource.setrlimit(resource.RLIMIT_AS, (memory, memory))
resource.setrlimit(resource.RLIMIT_CPU, (cpu, cpu + 1))
resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
def block():
    size, = struct.unpack("<q", sys.stdin.buffer.read(8))
    return sys.stdin.buffer.read(size)
text, count = block(), int(block())
lib = c.CDLL(sys.argv[1])
class Log(c.Structure):
    _fields_ = [("console", c.c_bool), ("file", c.c_bool), ("name", c.c_char * 1024), ("topics", c.c_int)]
lib.mju_setLogConfig.argtypes = [Log]
lib.mju_setLogConfig(Log())
vfs = c.c_void_p()
lib.mj_defaultVFS(c.byref(vfs))
for _ in range(count):
    name, data = block(), block()
    lib.mj_addBufferVFS(c.byref(vfs), name, data, len(data))
error = c.create_string_buffer(4096)
lib.mj_parseXMLString.restype = lib.mj_compile.restype = lib.mj_makeData.restype = c.c_void_p
lib.mjs_getError.restype = c.c_char_p
spec = lib.mj_parseXMLString(text, c.byref(vfs), error, 4096)
if not spec:
    fail = error.value
else:
    model = lib.mj_compile(c.c_void_p(spec), c.byref(vfs))
    fail = b"" if model else (lib.mjs_getError(c.c_void_p(spec)) or b"cannot be compiled")
    if model and not lib.mj_makeData(c.c_void_p(model)):
        fail = b"MuJoCo cannot allocate the model's data"
sys.stdout.buffer.write(fail)
sys.stdout.flush()
os._exit(1 if fail else 0)
"""


def _try_in_child(source: Source) -> None:
    def block(data: bytes) -> bytes:
        return struct.pack("<q", len(data)) + data

    payload = [block(source.text.encode()), block(str(len(source.files)).encode())]
    for name, data in source.files.items():
        payload += [block(name.encode()), block(data)]
    # -I and -S: no user site, no environment, no start-up files; a tenth of the time that `import mujoco` takes.
    command = [sys.executable, "-I", "-S", "-c", _CHILD, _library(), str(CHILD_MEMORY), str(CHILD_CPU)]
    try:
        done = subprocess.run(
            command, input=b"".join(payload), capture_output=True, timeout=CHILD_WALL, check=False
        )
    except subprocess.TimeoutExpired:
        raise MjcfError(f"{source.name}: did not compile within {CHILD_WALL} s; simplify the model") from None
    if done.returncode == 0:
        return
    if done.returncode == 1 and done.stdout:
        raise MjcfError(f"{source.name}: {_one_line(done.stdout.decode(errors='replace'))}")
    if done.returncode in (-signal.SIGXCPU, -signal.SIGKILL):
        raise MjcfError(
            f"{source.name}: did not compile within {CHILD_CPU} s of computing; simplify the model"
        )
    last = done.stderr.decode(errors="replace").strip().splitlines()[-1:] or ["no message"]
    raise MjcfError(
        f"{source.name}: MuJoCo failed while compiling it (exit {done.returncode}: {last[0]}); it may need more than "
        f"{CHILD_MEMORY >> 30} GiB of memory"
    )


@functools.cache
def _library() -> str:
    folder = Path(mujoco.__file__).parent
    found = sorted(p for p in folder.iterdir() if p.name.startswith(("libmujoco.", "mujoco.dll")))
    if not found:
        raise MjcfError(f"MuJoCo's library is not in {folder}; reinstall mujoco")
    return os.fspath(found[0])


def _one_line(message: str) -> str:
    return "; ".join(line.strip() for line in message.splitlines() if line.strip())
