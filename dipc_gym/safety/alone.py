"""One run at a time in a folder."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

try:
    import fcntl
except ImportError:
    raise ImportError(
        "folders are held by locks of Linux and macOS: on Windows, use the Windows Subsystem for Linux"
    ) from None


class BusyError(ValueError):
    """Another run is at work in a folder."""


@contextmanager
def alone(folder: str | Path) -> Iterator[None]:
    """Hold a folder, made if it is not there, so that a second run in it says so and stops.

    The operating system locks the folder itself. No file is left that could grow stale: however a run ends, `kill -9`
    included, the lock ends with it. A folder that was made for this and is still empty at the end is removed.

    Raises:
        BusyError: another run holds it.
        OSError: it is a file, or cannot be made.

    Example:
        >>> import tempfile
        >>> place = tempfile.mkdtemp()
        >>> with alone(place), alone(place):  # doctest: +ELLIPSIS
        ...     pass
        Traceback (most recent call last):
        dipc_gym.safety.alone.BusyError: ...: another run is at work in this folder; wait for its end, ...
    """
    folder = Path(folder)
    new = not folder.exists()
    if folder.exists() and not folder.is_dir():
        raise FileExistsError(f"{folder} is a file; name a folder for the results")
    folder.mkdir(parents=True, exist_ok=True)
    handle = os.open(folder, os.O_RDONLY)
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise BusyError(
                f"{folder}: another run is at work in this folder; wait for its end, or name another folder"
            ) from None
        except OSError as error:  # a network file system without locks
            print(f"{folder}: cannot be locked ({error.strerror}); let no second run write here", file=sys.stderr)
        yield
    finally:
        if new:  # while it is held: a second run would hold a folder that is none any more
            with suppress(OSError):
                folder.rmdir()
        os.close(handle)
