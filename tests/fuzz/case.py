"""One damaged file, one reader: what may happen, and what may not."""

from __future__ import annotations

import contextlib
import io
import os
import random
import re
import resource
import shutil
import signal
import sys
import tempfile
import traceback
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from target import Target

SECONDS = 20
"""Of processor time, so that a case is judged alike on a busy machine."""
WAIT = 300
"""Seconds on the clock, for what waits for something that never comes."""
ROOM = 1 << 30
"""Bytes of address space that a case may take beside what is there before it."""
MEND = re.compile(r"another (folder|version)|no compensator can be trained|too short; training|leave out --compensator")
"""What plain ValueErrors say that are meant: other parameters, a sound file of another kind, too short a recording."""
CODE = os.path.join(tempfile.gettempdir(), "fuzz-code-")  # noqa: PTH118  see `rigs`: not the user's cache
WRITES = {
    "os.rename": (0, 1),
    "os.remove": (0,),
    "os.mkdir": (0,),
    "os.rmdir": (0,),
    "os.link": (1,),
    "os.symlink": (1,),
}


class TooSlowError(BaseException):
    """A case took longer than it may; no reader's `except Exception` catches it."""


@dataclass(frozen=True)
class Case:
    """What became of a damaged file.

    Attributes:
        outcome: `read`, or the error's class.
        fault: what must not happen and did, or empty.
        seconds: of processor time that it took.
    """

    outcome: str
    fault: str
    seconds: float


class Watch:
    """Notes every file that Python code opens for writing, makes, moves or deletes, for the life of the process."""

    def __init__(self) -> None:
        self.inside: str | None = None
        self.outside: list[str] = []
        sys.addaudithook(self._hook)

    def _hook(self, event: str, arguments: tuple[Any, ...]) -> None:
        if self.inside is None:
            return
        if event == "open":
            path, _, flags = arguments
            if isinstance(flags, int) and flags & (os.O_WRONLY | os.O_RDWR | os.O_CREAT):
                self._note(path)
        elif event in WRITES:
            for i in WRITES[event]:
                self._note(arguments[i])

    def _note(self, path: Any) -> None:
        if isinstance(path, str | bytes | os.PathLike) and self.inside is not None:
            name = os.path.abspath(os.fsdecode(path))  # noqa: PTH100  a link is judged by where it stands
            known = name.startswith((self.inside + os.sep, "/dev/null", "/proc/", CODE)) or "__pycache__" in name
            if not known and name != self.inside:
                self.outside.append(name)


WATCH = Watch()


def run(target: Target, seed: int, value: Any = None) -> Case:
    """Damage one file of a target, and let its reader have it.

    Args:
        target: what is read.
        seed: decides which file is damaged, and how.
        value: for JSON, a further value to put somewhere.
    """
    rng = random.Random(seed)
    name = rng.choice(sorted(target.damage))
    how = rng.choice(target.damage[name])
    arguments = (rng, value) if how.__name__ == "tree" else (rng,)
    damaged = how(target.files[name], *arguments)
    place = Path(tempfile.mkdtemp(prefix="fuzz-")).resolve()
    try:
        folder = place / "case"
        for path, content in target.files.items():
            (folder / path).parent.mkdir(parents=True, exist_ok=True)
            (folder / path).write_bytes(damaged if path == name else content)
        return _read(target, folder)
    finally:
        shutil.rmtree(place, ignore_errors=True)


def _read(target: Target, folder: Path) -> Case:
    before = _listing(folder.parent)
    WATCH.inside, WATCH.outside = str(folder), []
    began = _used()
    outcome, fault = "read", ""
    try:
        with (
            contextlib.chdir(folder.parent),
            _limits(),
            warnings.catch_warnings(),
            contextlib.redirect_stderr(io.StringIO()),
        ):
            warnings.simplefilter("ignore")
            target.read(folder)
    except target.errors as error:
        outcome = type(error).__name__
        ours = type(error).__module__.startswith("dipc_gym")
        if not str(error).strip() or not (ours or (type(error) is ValueError and MEND.search(str(error)))):
            fault = traceback.format_exc()
        elif len(str(error)) > 3000:
            fault = f"a message of {len(str(error))} characters"
    except TooSlowError:
        outcome, fault = "too slow", f"more than {SECONDS} s\n{traceback.format_exc()}"
    except BaseException as error:
        outcome, fault = type(error).__name__, traceback.format_exc()
    finally:
        WATCH.inside = None
    if WATCH.outside:
        fault += f"\nwritten outside: {WATCH.outside}"
    if _listing(folder.parent) != before:
        fault += f"\nappeared beside the folder: {_listing(folder.parent) - before}"
    return Case(outcome, fault, _used() - began)


def _used() -> float:
    """Processor time so far, s, of processes that were started and have ended too."""
    return sum(os.times()[:4])


def _listing(place: Path) -> set[str]:
    return {path.name for path in place.iterdir()}


@contextlib.contextmanager
def _limits() -> Iterator[None]:
    """At most so many seconds, and so much memory beside what the process has."""

    def stop(*_: Any) -> None:
        raise TooSlowError

    with Path("/proc/self/statm").open() as file:
        pages = int(file.read().split()[0])
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    clocks = ((signal.ITIMER_PROF, signal.SIGPROF, SECONDS), (signal.ITIMER_REAL, signal.SIGALRM, WAIT))
    previous = [signal.signal(number, stop) for _, number, _ in clocks]
    resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + ROOM, hard))
    for clock, _, seconds in clocks:
        signal.setitimer(clock, seconds)
    try:
        yield
    finally:
        for (clock, number, _), before in zip(clocks, previous, strict=True):
            signal.setitimer(clock, 0)
            signal.signal(number, before)
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))
