"""MJCF from strangers: read it, and compile it under limits.

A model file is hostile input. `read` and `from_text` scan the text and load every file it names (see `scan`);
`compile` first tries the result in a child process with limits on time and memory, then compiles it here. MuJoCo is
given the loaded files by name, so that what was checked is what is compiled.
"""

from __future__ import annotations

import functools
import hashlib
import os
import signal
import struct
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import mujoco

from dipc_gym.mjcf.numbers import check_numbers
from dipc_gym.mjcf.scan import MjcfError, load_text, scan

CPU_LIMIT = 20  # seconds of computing for the trial compilation
WALL_LIMIT = 60  # seconds on the clock for the trial compilation
MEMORY_LIMIT = 2 << 30  # bytes of address space for the trial compilation
TABLES = (".csv", ".parquet", ".npz")  # recordings, which are easily named where the model belongs


@dataclass(frozen=True)
class Source:
    """The text of a model and everything it pulls in.

    Attributes:
        path: where the text was read from; None for text from memory.
        folder: the folder that every file of the model lies in.
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
        digest = hashlib.sha256(hashlib.sha256(self.text.encode()).digest())
        for name in sorted(self.files):
            digest.update(name.encode() + b"\0" + hashlib.sha256(self.files[name]).digest())
        return digest.hexdigest()

    def asked_by(self, text: str) -> dict[str, bytes]:
        """Of its files, as they were read, those that another text of the same model asks for; what it included may
        stand in that text itself.
        """
        return scan(text, self.name, self.folder, self.files)

    def edited(self, text: str) -> Source:
        """The same model with another text; its files stay as they were read."""
        return replace(self, text=text)


def read(path: str | Path) -> Source:
    """Read and scan a model file; nothing is compiled.

    Args:
        path: an MJCF file. All it includes or references must lie in its folder.

    Raises:
        MjcfError: the file is missing, too large, not UTF-8, not well-formed, not MJCF, declares a document type,
            reaches outside its folder, names a file that is not there, or multiplies into too many elements.
    """
    path = Path(path)
    if path.suffix.lower() in TABLES and path.is_file():
        raise MjcfError(f"{path}: is no MJCF but a recording, by its name; the model comes first, then recordings")
    text = load_text(path, str(path))
    return Source(path, path.parent, text, scan(text, str(path), path.parent))


def from_text(text: str, folder: str | Path | None = None) -> Source:
    """Scan a model held in a string; files it names are looked up in `folder` (the current one if not given).

    Raises:
        MjcfError: as `read`.
    """
    folder = Path.cwd() if folder is None else Path(folder)
    return Source(None, folder, text, scan(text, "MJCF text", folder))


def as_source(source: Source | str | Path) -> Source:
    """A scanned source as it is, a path read, MJCF text (a string that contains `<`) scanned.

    Raises:
        MjcfError: as `read`.
    """
    if isinstance(source, Source):
        return source
    return from_text(str(source)) if isinstance(source, str) and "<" in source else read(source)


def compile(source: Source | str | Path, *, trusted: bool = False) -> mujoco.MjModel:
    """Compile a model: scan, trial run in a child process with limits, then here.

    The child costs about 15 ms, once per content and process: it loads MuJoCo's library without importing it.

    Args:
        source: a scanned source, a path, or MJCF text (a string that contains `<`).
        trusted: skip the child, and the second scan of an edited source; for text that the project itself made
            from a checked source.

    Returns:
        The compiled model.

    Raises:
        MjcfError: as `read`; or the model does not compile, with MuJoCo's message; or that takes more time or
            memory than allowed; or it compiles to numbers that nothing can be simulated with.

    Example:
        >>> model = compile('<mujoco><worldbody><body><joint/><geom size="1"/></body></worldbody></mujoco>')
        >>> model.nq
        1
    """
    if not isinstance(source, Source):
        source = as_source(source)
    elif not trusted and source.sha256 not in _tried:
        # Somebody may have changed the text since it was scanned.
        source = replace(source, files=scan(source.text, source.name, source.folder))
    quiet_mujoco()
    if not trusted and source.sha256 not in _tried:
        _try_in_child(source)
        _tried.add(source.sha256)
    try:
        model = mujoco.MjModel.from_xml_string(source.text, assets=dict(source.files))
    except (ValueError, mujoco.FatalError) as error:
        raise MjcfError(f"{source.name}: {_one_line(str(error))}") from None
    if not trusted and source.sha256 not in _sound:
        check_numbers(model, source.name)
        _sound.add(source.sha256)
    return model


def quiet_mujoco() -> None:
    """Stop MuJoCo from writing MUJOCO_LOG.TXT into the current folder, and warnings to the terminal.

    It holds for the process. The warnings are still counted in `data.warning`, where whoever simulates must look.
    """
    config = mujoco.MjLogConfig.get()
    if config.logto_file or config.logto_console:
        config.logto_file = config.logto_console = False
        config.set()


# The trial compilation

_tried: set[str] = set()  # digests of what compiled in a child of this process
_sound: set[str] = set()  # digests of those whose numbers were looked at

_CHILD = """
import ctypes as c, os, resource, struct, sys
memory, cpu = int(sys.argv[2]), int(sys.argv[3])
resource.setrlimit(resource.RLIMIT_AS, (memory, memory))
resource.setrlimit(resource.RLIMIT_CPU, (cpu, cpu + 1))
resource.setrlimit(resource.RLIMIT_CORE, (0, 0))

def block():
    size, = struct.unpack("<q", sys.stdin.buffer.read(8))
    return sys.stdin.buffer.read(size)

class Log(c.Structure):
    _fields_ = [("console", c.c_bool), ("file", c.c_bool), ("name", c.c_char * 1024), ("topics", c.c_int)]

lib = c.CDLL(sys.argv[1])
lib.mju_setLogConfig.argtypes = [Log]
lib.mju_setLogConfig(Log())
lib.mj_parseXMLString.restype = lib.mj_compile.restype = lib.mj_makeData.restype = c.c_void_p
lib.mjs_getError.restype = c.c_char_p
text, vfs, error = block(), c.c_void_p(), c.create_string_buffer(4096)
lib.mj_defaultVFS(c.byref(vfs))
for _ in range(int(block())):
    name, data = block(), block()
    lib.mj_addBufferVFS(c.byref(vfs), name, data, len(data))
spec, fail = lib.mj_parseXMLString(text, c.byref(vfs), error, len(error)), b""
if not spec:
    fail = error.value or b"cannot be parsed"
else:
    model = lib.mj_compile(c.c_void_p(spec), c.byref(vfs))
    if not model:
        fail = lib.mjs_getError(c.c_void_p(spec)) or b"cannot be compiled"
    elif not lib.mj_makeData(c.c_void_p(model)):
        fail = b"there is not enough memory to simulate it"
sys.stdout.buffer.write(fail)
sys.stdout.flush()
os._exit(1 if fail else 0)
"""


def _try_in_child(source: Source) -> None:
    """Compile in a process that may die of it.

    Raises:
        MjcfError: it does not compile, or not within the limits.
    """
    blocks = [source.text.encode(), str(len(source.files)).encode()]
    for name, data in source.files.items():
        blocks += [name.encode(), data]
    payload = b"".join(struct.pack("<q", len(block)) + block for block in blocks)
    # -I and -S leave out start-up files and environment, and save most of Python's start-up time.
    limits = [str(MEMORY_LIMIT), str(CPU_LIMIT)]
    command = [sys.executable, "-I", "-S", "-c", _CHILD, _library(), *limits]
    try:
        done = subprocess.run(command, input=payload, capture_output=True, timeout=WALL_LIMIT, check=False)
    except subprocess.TimeoutExpired:
        raise MjcfError(f"{source.name}: did not compile within {WALL_LIMIT} s; simplify the model") from None
    if done.returncode == 0:
        return
    if done.returncode == 1 and done.stdout:
        raise MjcfError(f"{source.name}: {_one_line(done.stdout.decode(errors='replace'))}")
    if done.returncode in (-signal.SIGXCPU, -signal.SIGKILL):
        raise MjcfError(f"{source.name}: did not compile within {CPU_LIMIT} s of computing; simplify the model")
    last = done.stderr.decode(errors="replace").strip().splitlines()[-1:] or ["no message"]
    raise MjcfError(
        f"{source.name}: MuJoCo broke down while compiling it ({last[0]}; exit {done.returncode}); "
        f"probably it needs more than {MEMORY_LIMIT >> 30} GiB of memory; simplify the model"
    )


@functools.cache
def _library() -> str:
    folder = Path(mujoco.__file__).parent
    found = sorted(entry for entry in folder.iterdir() if entry.name.startswith("libmujoco."))
    if not found:
        raise MjcfError(f"MuJoCo's library is not in {folder}; reinstall it: pip install --force-reinstall mujoco")
    return os.fspath(found[0])


def _one_line(message: str) -> str:
    """MuJoCo's message on one line, of a thousand characters at most that can be printed: it says a value in full."""
    line = "; ".join(line.strip() for line in message.splitlines() if line.strip())[:1000]
    if "plugin" in line and "not found" in line:
        line += " (no plugin is loaded here, for that would run its code; write what it does in MJCF)"
    return "".join(character if character.isprintable() else "?" for character in line)
