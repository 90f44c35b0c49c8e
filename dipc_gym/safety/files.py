"""Files that appear whole or not at all."""

from __future__ import annotations

import errno
import json
import math
import os
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, BinaryIO

PARTIAL = ".partial"  # ending of what a killed run may leave beside a file; the next run in the folder removes it
NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


@contextmanager
def whole(path: str | Path) -> Iterator[BinaryIO]:
    """Open a file for writing so that neither an error, a full disk nor a power cut leaves half of it.

    What is written goes to a file beside it, down to the disk, and takes the name only when the block ends. What had
    the name before stays as it was until that moment.

    Args:
        path: the file.

    Raises:
        OSError: it cannot be written, with a message that names the file; what had the name is untouched, and nothing
            is left beside it.

    Example:
        >>> import tempfile
        >>> with whole(Path(tempfile.mkdtemp()) / "note.txt") as file:
        ...     _ = file.write(b"whole")
    """
    path = Path(path)
    partial = partial_of(path)
    try:
        # Made anew: a link of this name, planted by whoever sent the folder, would lead the writing elsewhere.
        partial.unlink(missing_ok=True)
        with partial.open("xb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        partial.replace(path)
    except BaseException as error:
        with suppress(OSError):
            partial.unlink(missing_ok=True)
        if isinstance(error, OSError) and error.errno in NO_ROOM:
            said = f"{error.strerror}; make room and try again; what had this name before, if anything, is untouched"
            raise OSError(error.errno, said, str(path)) from error
        raise


def partial_of(path: Path) -> Path:
    """Where a file is written before it takes its name."""
    return path.with_name(f".{path.name}.{os.getpid()}{PARTIAL}")


def remove_partial(folder: Path) -> None:
    """Remove what a killed run has left in a folder of files that it was writing; those of processes that run stay."""
    for path in folder.glob(f".*{PARTIAL}"):
        number = re.fullmatch(rf"\..+\.(\d+)\{PARTIAL}", path.name)
        if number and not _runs(int(number[1])):
            path.unlink(missing_ok=True)


def _runs(process: int) -> bool:
    """Whether another process of this number runs on this machine."""
    if process in (0, os.getpid()):
        return False
    try:
        os.kill(process, 0)
    except PermissionError:  # it is somebody else's
        return True
    except (OSError, OverflowError):
        return False
    return True


def write_whole(path: str | Path, content: bytes) -> None:
    """Write a file that appears whole or not at all.

    Args:
        path: the file.
        content: all of it.

    Raises:
        OSError: see `whole`.
    """
    with whole(path) as file:
        file.write(content)


def finite(value: Any) -> Any:
    """A value as JSON can hold it: numbers that are not finite become null.

    Example:
        >>> finite({"error": float("inf"), "at": ["cart", 2.0]})
        {'error': None, 'at': ['cart', 2.0]}
    """
    if isinstance(value, Mapping):
        return {key: finite(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [finite(one) for one in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def write_json(path: str | Path, value: Any) -> None:
    """Write a JSON file that appears whole or not at all.

    Args:
        path: the file.
        value: what it holds.

    Raises:
        OSError: see `whole`.
        ValueError: a number is not finite.
    """
    write_whole(path, (json.dumps(value, indent=2, allow_nan=False) + "\n").encode())
