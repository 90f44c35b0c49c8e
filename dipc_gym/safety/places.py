"""Names that come out of files, and the one place they may lead to: the folder that the file belongs to.

A sweep, a trial or a model can come from a stranger, and names in it become paths: `../../.bashrc`, `/etc/passwd`, or a
harmless name that a symbolic link takes elsewhere. Whatever turns such a name into a path asks `inside`.
"""

from __future__ import annotations

import errno
from pathlib import Path, PurePosixPath, PureWindowsPath


class PlaceError(ValueError):
    """A name that leads out of its folder; the message names folder and name, and the mend."""


def inside(folder: str | Path, name: str) -> Path:
    """The path of a name within a folder, and never any other path.

    Symbolic links are followed, so that a link within the folder leads no further than the folder. The folder itself
    may be a link, for the user named it. Nothing is made or opened; whoever can write to the folder at the same moment
    can still exchange a part of the path.

    Args:
        folder: that the user named; it need not exist.
        name: relative, with slashes between its parts, as it stands in a file.

    Returns:
        `folder / name`.

    Raises:
        PlaceError: the name is empty, too long, absolute, has a part `..`, a backslash or a NUL, cannot be a path, or
            is taken out of the folder by a symbolic link.

    Example:
        >>> inside("sweep", "ppo-llnf-00/policy.json").as_posix()
        'sweep/ppo-llnf-00/policy.json'
        >>> inside("sweep", "../policy.json")  # doctest: +ELLIPSIS
        Traceback (most recent call last):
        dipc_gym.safety.places.PlaceError: sweep: '../policy.json' leads out of this folder; ...
    """
    folder = Path(folder)
    try:
        odd = not isinstance(name, str) or "\0" in name or "\\" in name or ".." in PurePosixPath(name).parts
        if odd or PurePosixPath(name).is_absolute() or PureWindowsPath(name).drive or not PurePosixPath(name).parts:
            raise ValueError
        root = folder.resolve()
        place = (root / name).resolve()
        if place == root or not place.is_relative_to(root) or _too_long(place):
            raise ValueError
    except (OSError, ValueError, RuntimeError):  # a ring of links, half a surrogate pair
        shown = repr(name) if len(repr(name)) <= 80 else f"{repr(name)[:77]}..."
        raise PlaceError(f"{folder}: {shown} leads out of this folder; use it only with names within it") from None
    return folder / name


def _too_long(place: Path) -> bool:
    """Whether no file can have this name; `resolve` does not mind."""
    try:
        place.lstat()
    except OSError as error:
        return error.errno == errno.ENAMETOOLONG
    return False
