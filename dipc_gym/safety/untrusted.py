"""JSON from strangers: read without executing anything, and refused in words that name source, field and mend."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

from dipc_gym.safety.naming import suggestion

MANY_DIGITS = 10**40  # whole numbers from this size on are not printed in full


@dataclass(frozen=True)
class Format:
    """A kind of JSON file, and how messages speak of it.

    Attributes:
        name: such as "policy file".
        writer: what makes such files.
        mend: what to do about a broken one, as an order.
        largest: bytes; whatever is larger is something else.
        error: what is raised.
    """

    name: str
    writer: str
    mend: str
    largest: int
    error: type[ValueError]

    def read(self, path: str | Path) -> Any:
        """What a file holds, unchecked.

        Raises:
            ValueError: of the kind `error`: it cannot be read, is too large, or is no JSON in UTF-8.

        Example:
            >>> Format("plant file", "Plant.write", "write it again", 1_000, ValueError).read("none.json")
            Traceback (most recent call last):
            ValueError: none.json: cannot be read (No such file or directory); give a plant file as Plant.write makes it
        """
        try:
            with Path(path).open("rb") as file:
                raw = file.read(self.largest + 1)
        except (OSError, ValueError) as error:
            reason = getattr(error, "strerror", None) or error
            article = "an" if self.name[0] in "aeiou" else "a"
            raise self.error(
                f"{path}: cannot be read ({reason}); give {article} {self.name} as {self.writer} makes it"
            ) from None
        if len(raw) > self.largest:
            raise self.error(f"{path}: larger than {self.largest:,} bytes; this is no {self.name}")
        if not raw.strip():
            raise self.error(f"{path}: is empty; {self.mend}")
        try:
            return json.loads(raw.decode("utf-8"))
        except UnicodeDecodeError:
            raise self.error(f"{path}: not JSON, nor any text in UTF-8; this is no {self.name}") from None
        except RecursionError:
            raise self.error(f"{path}: not JSON as we read it, nested too deeply; this is no {self.name}") from None
        except ValueError as error:
            raise self.error(f"{path}: not JSON ({error}); perhaps cut short: {self.mend}") from None


@dataclass(frozen=True)
class Reader:
    """Takes data apart field by field, and refuses what is not as it must be.

    Every method gets a value and `where` it stands, as a dotted path, and gives the value back once it is known to be
    right.

    Attributes:
        format: of the data.
        source: what messages begin with: the file's path.

    Example:
        >>> plants = Format("plant file", "Plant.write", "write it again", 1_000, ValueError)
        >>> Reader(plants, "rig.json").positive(-3, "motor.resistance")
        Traceback (most recent call last):
        ValueError: rig.json: motor.resistance: is -3; it must be above zero
    """

    format: Format
    source: str

    def fail(self, where: str, problem: str) -> NoReturn:
        """Refuse the data."""
        raise self.format.error(f"{self.source}: {where}: {problem}")

    def document(self, data: Any, schema: str, names: Sequence[str]) -> Mapping[str, Any]:
        """A whole file: an object of a known schema with exactly these names beside it."""
        if not isinstance(data, Mapping):
            self.fail("top level", f"is {shown(data)}; it must be an object with schema, {', '.join(names)}")
        if "schema" not in data:
            self.fail("schema", f"is missing; {self.format.mend}")
        if data["schema"] != schema:
            self.fail(
                "schema",
                f"is {shown(data['schema'])}, and this version of dipc-gym reads {schema!r}; update dipc-gym if the "
                f"file is newer, or {self.format.mend}",
            )
        return self.members(data, ("schema", *names), "")

    def members(self, data: Any, names: Sequence[str], where: str) -> Mapping[str, Any]:
        """An object with exactly these names, no more and no less."""
        if not isinstance(data, Mapping):
            self.fail(where, f"is {shown(data)}; it must be an object with {', '.join(names)}")
        before = f"{where}." if where else ""
        for name in data:
            if name not in names:
                near = suggestion(str(name)[:100], names)
                self.fail(
                    f"{before}{shown(name)}", f"is unknown; there are {', '.join(names)}: remove or correct it{near}"
                )
        for name in names:
            if name not in data:
                self.fail(f"{before}{name}", f"is missing; {self.format.mend}")
        return data

    def entries(self, value: Any, where: str, length: int | None = None) -> Sequence[Any]:
        """A list of one or more, or of a given length."""
        if not isinstance(value, list | tuple):
            self.fail(where, f"is {shown(value)}; it must be a list")
        if not value or (length is not None and len(value) != length):
            self.fail(where, f"has {len(value)} entries; it must have {length or 'at least one'}: {self.format.mend}")
        return value

    def number(self, value: Any, where: str) -> float:
        """A finite number."""
        number = math.nan
        if isinstance(value, int | float) and not isinstance(value, bool):
            try:
                number = float(value)
            except OverflowError:
                number = math.inf
        if not math.isfinite(number):
            self.fail(where, f"is {shown(value)}; it must be a finite number: {self.format.mend}")
        return number

    def positive(self, value: Any, where: str) -> float:
        """A finite number above zero."""
        number = self.number(value, where)
        if number <= 0:
            self.fail(where, f"is {shown(value)}; it must be above zero")
        return number

    def count(self, value: Any, where: str) -> int:
        """A whole number, zero or more."""
        if not isinstance(value, int) or isinstance(value, bool) or value < 0:
            self.fail(where, f"is {shown(value)}; it must be a whole number, zero or more")
        return value

    def text(self, value: Any, where: str) -> str:
        """A name of one to a hundred characters that can be printed."""
        if not isinstance(value, str) or not 0 < len(value) <= 100 or not value.isprintable():
            self.fail(where, f"is {shown(value)}; it must be a name")
        return value

    def one_of(self, value: Any, allowed: Sequence[str], where: str) -> str:
        """One of a few words."""
        if not isinstance(value, str) or value not in allowed:
            self.fail(where, f"is {shown(value)}; it must be {' or '.join(map(repr, allowed))}")
        return value


def shown(value: Any) -> str:
    """A value as a message can show it, however large or deep it is.

    Example:
        >>> shown("deg"), shown(None), shown({"a": 1}), shown(10**400)
        ("'deg'", 'null', 'an object', 'a number of very many digits')
    """
    if isinstance(value, int) and abs(value) >= MANY_DIGITS:
        return "a number of very many digits"
    words = {dict: "an object", list: "a list", tuple: "a list", type(None): "null"}
    text = words.get(type(value)) or repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


def first_line(error: BaseException) -> str:
    r"""What a library says of a broken file, for a message of ours: its first line, of 200 characters at most.

    Example:
        >>> first_line(ValueError("bad magic\n  at byte 0")), first_line(KeyError())
        ('bad magic', 'KeyError')
    """
    return (str(error).splitlines() or [type(error).__name__])[0][:200]
