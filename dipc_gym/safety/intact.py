"""Files that a later run goes on from: whether they hold what was written, and what becomes of those that do not.

Between two runs a file can be damaged, by a disk, by a hand, or by a stranger. One that is written here carries a
SHA-256 of its own content, so that a single wrong digit shows. That tells accident, not malice: whoever means harm
writes the digest anew. So the content is checked as well, before anything is made of it.
"""

from __future__ import annotations

import hashlib
import json
import math
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from dipc_gym.safety.files import write_json
from dipc_gym.safety.untrusted import Format, shown

DIGEST = "sha256"
ASIDE = ".damaged"
LARGEST = 1e100
"""Of a number; squares of larger ones overflow in sums."""

Shape = Any
"""`float`, `int` (zero or more), `bool`, `str`, None or `object` (whatever); a tuple of shapes for one of these;
`[shape]` for a list; `{"name": shape}` for an object with at least these names; `{str: shape}` for whatever names."""


class DamagedError(ValueError):
    """A file that a run was to go on from does not hold what was written; the message names file, field and fault."""


FORMAT = Format(
    "file that a run goes on from", "the same command", "delete it to make it again", 50_000_000, DamagedError
)


def write(path: Path, value: Mapping[str, Any]) -> None:
    """Write an object as JSON with its digest, whole or not at all.

    Raises:
        OSError: it cannot be written.
        ValueError: a number is not finite.
    """
    write_json(path, signed(value))


def signed(value: Mapping[str, Any]) -> dict[str, Any]:
    """An object with the digest of what it holds."""
    plain = {key: entry for key, entry in value.items() if key != DIGEST}
    return {**plain, DIGEST: digest(plain)}


def read(path: Path, shape: Mapping[str, Shape]) -> dict[str, Any]:
    """Read an object that `write` has written.

    Args:
        path: the file. One without a digest, as made by hand, is judged by its shape alone.
        shape: that its content must have.

    Returns:
        The object, without the digest.

    Raises:
        DamagedError: it is no file, no JSON, changed since it was written, or of another shape.

    Example:
        >>> import tempfile
        >>> path = Path(tempfile.mkdtemp()) / "cell.json"
        >>> write(path, {"cost": 3.0})
        >>> read(path, {"cost": float})
        {'cost': 3.0}
        >>> _ = path.write_text(path.read_text().replace("3.0", "4.0"))
        >>> read(path, {"cost": float})  # doctest: +ELLIPSIS
        Traceback (most recent call last):
        dipc_gym.safety.intact.DamagedError: ...cell.json: was changed after it was written; delete it to make it again
    """
    if not path.is_file():  # opening a named pipe would wait for ever
        raise DamagedError(f"{path}: is no file; {FORMAT.mend}")
    held = FORMAT.read(path)
    try:
        fit(held, shape)
        said = held.pop(DIGEST, None)
        changed = said is not None and said != digest(held)
    except (ValueError, RecursionError) as error:
        raise DamagedError(f"{path}: {error or 'nested too deeply'}; {FORMAT.mend}") from None
    if changed:
        raise DamagedError(f"{path}: was changed after it was written; {FORMAT.mend}")
    return dict(held)


def digest(value: Any) -> str:
    """SHA-256 of a value as JSON, whatever the order of its names.

    Raises:
        ValueError: a number is not finite.
    """
    text = json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


def set_aside(path: Path, why: Exception) -> None:
    """Rename what is damaged, so that it is made again and still can be looked at, and say so.

    Args:
        path: the file; its name gets the ending `.damaged`, which an earlier one gives way to.
        why: what is wrong, as its message says.

    Raises:
        OSError: it cannot be renamed.
    """
    aside = path.with_name(path.name + ASIDE)
    path.replace(aside)
    print(f"{why}; set aside as {aside.name}, and done again", file=sys.stderr)


def fit(value: Any, shape: Shape, where: str = "") -> None:
    """Refuse a value that has another shape.

    Args:
        value: as JSON gives it.
        shape: see `Shape`.
        where: it stands, as a dotted path.

    Raises:
        ValueError: naming the place and what must stand there.

    Example:
        >>> fit({"cost": [1.0, "2"]}, {"cost": [float]})
        Traceback (most recent call last):
        ValueError: cost[1] is '2'; it must be a finite number
    """
    if isinstance(shape, tuple):
        faults = []
        for one in shape:
            try:
                return fit(value, one, where)
            except ValueError as error:
                faults.append(error)
        raise faults[0]
    if isinstance(shape, list):
        if not isinstance(value, list):
            _fail(value, where, "a list")
        for i, entry in enumerate(value):
            fit(entry, shape[0], f"{where}[{i}]")
    elif isinstance(shape, dict):
        if not isinstance(value, dict):
            _fail(value, where, "an object")
        named = {key: shape[str] for key in value} if str in shape else shape
        for key, one in named.items():
            place = f"{where}.{key}" if where else str(key)
            if key not in value:
                raise ValueError(f"{place} is missing")
            fit(value[key], one, place)
    elif not _IS[shape](value):
        _fail(value, where, _WORDS[shape])
    return None


def _fail(value: Any, where: str, must: str) -> None:
    raise ValueError(f"{where or 'the whole'} is {shown(value)}; it must be {must}")


def _is_number(value: Any) -> bool:
    try:
        return not isinstance(value, bool) and isinstance(value, int | float) and math.fabs(value) <= LARGEST
    except OverflowError:
        return False


def _is_count(value: Any) -> bool:
    return _is_number(value) and isinstance(value, int) and value >= 0


def _is_text(value: Any) -> bool:
    """Whether it is text that can be written: JSON can hold half of a pair that UTF-8 has no bytes for."""
    return isinstance(value, str) and not any("\ud800" <= character <= "\udfff" for character in value)


_IS = {
    float: _is_number,
    int: _is_count,
    bool: lambda value: isinstance(value, bool),
    str: _is_text,
    None: lambda value: value is None,
    object: lambda value: True,
}
_WORDS = {
    float: "a finite number",
    int: "a whole number, zero or more",
    bool: "true or false",
    str: "text",
    None: "null",
}
