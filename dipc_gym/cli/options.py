"""What options of several subcommands have in common."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Literal, get_args, get_origin, get_type_hints

from dipc_gym.safety.naming import suggestion


def listed(names: str) -> tuple[str, ...]:
    """Names with commas between, each once."""
    return tuple(dict.fromkeys(name.strip() for name in names.split(",") if name.strip()))


def pairs(option: str, texts: Sequence[str]) -> dict[str, str]:
    """The two sides of options like `--unit theta1=deg`.

    Raises:
        ValueError: there is no equals sign, or a left side stands there twice.
    """
    found: dict[str, str] = {}
    for text in texts:
        left, equals, right = text.rpartition("=")
        if not (left and equals and right):
            raise ValueError(f"--{option} {text}: write it with an equals sign between, such as --{option} a=b")
        if left in found:
            raise ValueError(f"--{option} names {left!r} twice")
        found[left] = right
    return found


def columns(
    recording: str | None, mapping: Sequence[str], units: Sequence[str]
) -> tuple[dict[str, str], dict[str, str]]:
    """What --map and --unit say of the columns of a recording.

    Raises:
        ValueError: as `pairs`, or they say something and there is no recording.
    """
    if recording is None and (mapping or units):
        raise ValueError("--map and --unit tell what the columns of a --recording are; name one")
    return pairs("map", mapping), pairs("unit", units)


def check_choices(command: type, arguments: Sequence[str]) -> None:
    """Refuse a value that is none of an option's choices, with the one that was meant, and a word for a number.

    Args:
        command: dataclass of the subcommand; fields with choices are `Literal`.
        arguments: of the command line, after the subcommand.

    Raises:
        ValueError: it is none of them, no number where one has to be, or a seed below 0.
    """
    hints = {f"--{name.replace('_', '-')}": hint for name, hint in get_type_hints(command).items()}
    choices = {option: tuple(_choices(hint)) for option, hint in hints.items()}
    for argument, following in zip(arguments, [*arguments, ""][1:], strict=True):
        option, equals, value = argument.partition("=")
        named = choices.get(option.replace("_", "-"), ())
        value = value if equals else following
        if named and value and not value.startswith("-") and value not in named:
            raise ValueError(f"{option} {value}: it can be {' or '.join(named)}{suggestion(value, named)}")
        if option == "--seed" and value.startswith("-") and value[1:].isdigit():
            raise ValueError(f"--seed {value}: it must be a whole number from 0 on")
        _check_number(option, hints.get(option.replace("_", "-")), value)


def _check_number(option: str, hint: Any, value: str) -> None:
    """Refuse a word where an option takes a number."""
    kinds = (hint, *get_args(hint))
    kind = next((kind for kind in (int, float) if kind in kinds), None)
    if kind is None or get_origin(hint) is tuple or not value or value.startswith("-") or value == "None":
        return
    try:
        kind(value)
    except ValueError:
        raise ValueError(f"{option} {value}: it must be a {'whole ' * (kind is int)}number") from None


def _choices(hint: Any) -> Iterator[str]:
    """The strings that a type allows, where it allows no others."""
    if get_origin(hint) is Literal:
        yield from get_args(hint)
    else:
        for part in get_args(hint):
            yield from _choices(part)


def ending(path: Path, *suffixes: str) -> Path:
    """A path that ends as what is written to it must.

    Raises:
        ValueError: it ends otherwise.
    """
    if path.suffix.lower() not in suffixes:
        raise ValueError(f"{path}: this is written as {' or '.join(suffixes)}; end its name so")
    return path


def free(path: Path, overwrite: bool) -> None:
    """Refuse to write over a file, before any work is done.

    Raises:
        OSError: it exists and `overwrite` is not set, or its folder does not exist.
    """
    if path.exists() and not overwrite:
        raise FileExistsError(f"{path} exists; choose another name or say --overwrite")
    if not path.absolute().parent.is_dir():
        raise FileNotFoundError(f"{path}: there is no folder {path.absolute().parent}")
