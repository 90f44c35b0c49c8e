"""Files that appear whole or not at all."""

from __future__ import annotations

import contextlib
import json
import os
from pathlib import Path
from typing import Any


def write_whole(path: str | Path, content: bytes) -> None:
    """Write a file so that neither a full disk nor a power cut leaves half of it.

    The content goes to a file beside it, down to the disk, and takes the name only then. What had the name before
    stays as it was until that moment.

    Args:
        path: the file.
        content: all of it.

    Raises:
        OSError: it cannot be written; what had the name is untouched, and nothing is left beside it.

    Example:
        >>> import tempfile
        >>> write_whole(Path(tempfile.mkdtemp()) / "note.txt", b"whole")
    """
    path = Path(path)
    partial = path.with_name(path.name + ".partial")
    try:
        with partial.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        partial.replace(path)
    except BaseException:
        with contextlib.suppress(OSError):
            partial.unlink(missing_ok=True)
        raise


def write_json(path: str | Path, value: Any) -> None:
    """Write a JSON file that appears whole or not at all.

    Args:
        path: the file.
        value: what it holds.

    Raises:
        OSError: see `write_whole`.
        ValueError: a number is not finite.
    """
    write_whole(path, (json.dumps(value, indent=2, allow_nan=False) + "\n").encode())
