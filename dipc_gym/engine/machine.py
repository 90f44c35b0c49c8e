"""From LLVM's text to functions in memory, kept on disk between runs.

LLVM comes with the `llvmlite` wheel: nothing needs a compiler on the user's machine. What was compiled is kept in the
user's own cache folder, one file a module. An entry is found by a hash of the text, of LLVM's version and of the
processor, so one of another version or machine is never found. Whatever is wrong with the cache (damaged, not ours,
writable by others, not writable by us) costs a compilation and nothing else.
"""

from __future__ import annotations

import ctypes
import functools
import hashlib
import os
import stat
import sys
import tempfile
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import llvmlite
import llvmlite.binding as llvm

_MAGIC = b"dipc-gym engine\n"
_KEPT = 300  # entries; the oldest go
_lock = threading.Lock()


def cache_folder() -> Path:
    """Where compiled code is kept: in the cache folder of the user's system."""
    base: str | Path
    if sys.platform == "win32":
        base = os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local"
    elif sys.platform == "darwin":
        base = Path.home() / "Library" / "Caches"
    else:
        # A relative one is to be ignored, says the XDG specification: it could be a stranger's folder.
        said = Path(os.environ.get("XDG_CACHE_HOME", ""))
        base = said if said.is_absolute() else Path.home() / ".cache"
    return Path(base) / "dipc-gym" / "engine"


@dataclass(frozen=True)
class Library:
    """Functions in memory.

    Attributes:
        addresses: of functions, by name.
        keeps: what must live as long.
    """

    addresses: dict[str, int]
    keeps: Any

    def function(self, name: str, *, pointers: int, counts: int = 0, numbers: int = 0) -> Any:
        """A function of pointers, then whole numbers, then real ones, that returns nothing.

        It keeps this library alive, and calls of it let other threads run.
        """
        kinds = [ctypes.c_void_p] * pointers + [ctypes.c_int64] * counts + [ctypes.c_double] * numbers
        made: Any = ctypes.CFUNCTYPE(None, *kinds)(self.addresses[name])
        made.library = self
        return made


def load(texts: Sequence[str], functions: Sequence[str]) -> Library:
    """Compile modules that call each other, or take them from the cache.

    Args:
        texts: LLVM's intermediate representation.
        functions: names of those that are called from outside.
    """
    with _lock:
        keys = [_key(text) for text in texts]
        builder = llvm.JITLibraryBuilder().add_current_process()
        for text, key in zip(texts, keys, strict=True):
            builder.add_object_img(_object(text, key))
        for name in functions:
            builder.export_symbol(name)
        jit = llvm.create_lljit_compiler(_target())
        tracker = builder.link(jit, hashlib.sha256("".join(keys).encode()).hexdigest())
        return Library({name: int(tracker[name]) for name in functions}, (jit, tracker))


@functools.lru_cache(maxsize=64)
def _object(text: str, key: str) -> bytes:
    code = _read(key)
    if code is None:
        code = _compiled(text, _target())
        _write(key, code)
    return code


def _target() -> Any:
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    target = llvm.Target.from_default_triple()
    features = llvm.get_host_cpu_features().flatten()
    return target.create_target_machine(cpu=llvm.get_host_cpu_name(), features=features, opt=2, codemodel="jitdefault")


def _compiled(text: str, machine: Any) -> bytes:
    module = llvm.parse_assembly(text)
    module.verify()
    options = llvm.create_pipeline_tuning_options(speed_level=2)
    passes = llvm.create_pass_builder(machine, options)
    passes.getModulePassManager().run(module, passes)
    return bytes(machine.emit_object(module))


def _key(text: str) -> str:
    parts = [text, llvmlite.__version__, str(llvm.llvm_version_info), llvm.get_process_triple()]
    parts += [llvm.get_host_cpu_name(), llvm.get_host_cpu_features().flatten()]
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()


def _read(key: str) -> bytes | None:
    """The code of a key, if the cache has it and nobody else could have put it there."""
    try:
        folder = cache_folder()
        if not _ours(os.lstat(folder)):
            return None
        number = os.open(folder / key, os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_BINARY", 0))
        with os.fdopen(number, "rb") as file:
            if not _ours(os.fstat(number)):
                return None
            content = file.read()
    except (OSError, RuntimeError):  # the latter without a home folder
        return None
    head = len(_MAGIC) + 32
    code = content[head:]
    if content[: len(_MAGIC)] != _MAGIC or hashlib.sha256(code).digest() != content[len(_MAGIC) : head]:
        return None
    return code


def _write(key: str, code: bytes) -> None:
    """Keep the code; a reader finds all of it or nothing."""
    try:
        folder = cache_folder()
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        if not _ours(os.lstat(folder)):
            return
        number, name = tempfile.mkstemp(dir=folder)
        try:
            with os.fdopen(number, "wb") as file:
                file.write(_MAGIC + hashlib.sha256(code).digest() + code)
            Path(name).replace(folder / key)
            oldest = sorted(folder.iterdir(), key=lambda path: path.stat().st_mtime)
            for path in oldest[: max(0, len(oldest) - _KEPT)]:
                path.unlink(missing_ok=True)
        except OSError:
            Path(name).unlink(missing_ok=True)
    except (OSError, RuntimeError):
        return


def _ours(status: os.stat_result) -> bool:
    """Whether a file or folder is no link, belongs to the user, and nobody else may write to it."""
    if stat.S_ISLNK(status.st_mode):
        return False
    if not hasattr(os, "getuid"):
        return True  # Windows keeps the folder private by its access lists
    return status.st_uid == os.getuid() and not status.st_mode & 0o022
