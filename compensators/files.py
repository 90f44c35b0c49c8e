"""Compensators in JSON files. Reading one executes nothing and trusts nothing."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from dipc_gym.compensators.base import (
    INPUTS,
    SCHEMA,
    Compensator,
    FitFigures,
    InputRange,
    number_fields,
)
from dipc_gym.compensators.registry import kind, names

LARGEST_FILE = 10_000_000
"""Bytes. A trained compensator takes a few thousand; whatever is larger than this is something else."""


class CompensatorError(ValueError):
    """A compensator file or dict cannot be used; the message names the file, the field and the mend."""


def save(compensator: Compensator, path: str | Path) -> None:
    """Write a compensator to a JSON file; an older file of that name is replaced only once all is written.

    Args:
        compensator: What to write.
        path: Where to.

    Raises:
        OSError: The file cannot be written.
    """
    path = Path(path)
    text = json.dumps(compensator.to_dict(), indent=2, allow_nan=False)
    partial = path.with_name(path.name + ".partial")
    partial.write_text(text + "\n", encoding="utf-8")
    partial.replace(path)


def load(source: str | Path | dict[str, Any]) -> Compensator:
    """Read a compensator from a JSON file or from the dict that `to_dict` gives.

    Args:
        source: Path of a file, or a plain dict.

    Returns:
        The compensator, as it was saved, to the last bit.

    Raises:
        CompensatorError: The file cannot be read, or a field is missing, unknown, of the wrong type, of the
            wrong size, not finite, or of a format version that this version of dipc-gym does not know.

    Example:
        >>> from dipc_gym.compensators import StaticGain
        >>> load(StaticGain(newtons_per_volt=4.0).to_dict()).voltage(2.0, 0.0)
        0.5
    """
    if isinstance(source, Mapping):
        return _Reader("compensator dict").compensator(source)
    if not isinstance(source, str | Path):
        raise CompensatorError(f"a compensator comes from a path or a dict, not from {type(source).__name__}")
    return _Reader(str(source)).compensator(_read(Path(source)))


def _read(path: Path) -> Any:
    try:
        with path.open("rb") as file:
            raw = file.read(LARGEST_FILE + 1)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise CompensatorError(
            f"{path}: cannot be read ({reason}); give the path of a file written by compensators.save"
        ) from error
    if len(raw) > LARGEST_FILE:
        raise CompensatorError(f"{path}: larger than {LARGEST_FILE} bytes; this is no compensator file")
    if not raw.strip():
        raise CompensatorError(f"{path}: the file is empty; save the compensator again")
    try:
        return json.loads(raw.decode("utf-8"))
    except UnicodeDecodeError as error:
        raise CompensatorError(f"{path}: not text; a compensator file is JSON in UTF-8") from error
    except RecursionError as error:
        raise CompensatorError(f"{path}: nested too deeply; this is no compensator file") from error
    except ValueError as error:
        raise CompensatorError(
            f"{path}: not valid JSON ({error}); perhaps cut short: save the compensator again"
        ) from error


class _Reader:
    """Takes a compensator from untrusted data, naming source and field where something is wrong."""

    def __init__(self, source: str) -> None:
        self.source = source
        self.lengths: dict[str, int] = {}

    def fail(self, where: str, problem: str) -> NoReturn:
        raise CompensatorError(f"{self.source}: {where}: {problem}")

    def compensator(self, data: Any) -> Compensator:
        if not isinstance(data, Mapping):
            self.fail("top level", f"is {_kind_of(data)}; it must be an object with schema, kind, parameters")
        schema = self.member(data, "schema", "")
        if schema != SCHEMA:
            self.fail(
                "schema",
                f"is {_short(schema)}, and this version of dipc-gym reads {SCHEMA!r}; update dipc-gym if the "
                "file is newer, or train the compensator again",
            )
        self.only(data, ("schema", "kind", "inputs", "output", "parameters", "fit"), "")
        name = self.member(data, "kind", "")
        if not isinstance(name, str) or name not in names():
            self.fail("kind", f"is {_short(name)}; there are {', '.join(names())} (register an own one before loading)")
        if self.member(data, "output", "") != {"name": "voltage", "unit": "V"}:
            self.fail("output", 'must be {"name": "voltage", "unit": "V"}')
        ranges = self.ranges(self.member(data, "inputs", ""))
        figures = self.figures(self.member(data, "fit", ""))
        values = self.parameters(kind(name), self.member(data, "parameters", ""))
        try:
            compensator = kind(name)(**values, ranges=ranges, figures=figures)
        except ValueError as error:
            self.fail("parameters", str(error))
        self.probe(compensator)
        return compensator

    def ranges(self, entries: Any) -> tuple[InputRange, ...]:
        if not isinstance(entries, list | tuple) or len(entries) not in (0, len(INPUTS)):
            expected = ", ".join(name for name, _ in INPUTS)
            self.fail("inputs", f"must be a list of the {len(INPUTS)} inputs {expected}, or an empty list")
        ranges = []
        for i, (entry, (name, unit)) in enumerate(zip(entries, INPUTS, strict=False)):
            where = f"inputs[{i}]"
            if not isinstance(entry, Mapping):
                self.fail(where, f"is {_kind_of(entry)}; it must be an object with name, unit, low, high")
            self.only(entry, ("name", "unit", "low", "high"), where)
            if self.member(entry, "name", where) != name:
                self.fail(f"{where}.name", f"is {_short(entry['name'])}; this input must be {name!r}")
            if self.member(entry, "unit", where) != unit:
                self.fail(f"{where}.unit", f"is {_short(entry['unit'])}; {name} must be in {unit!r}")
            low = self.number(self.member(entry, "low", where), f"{where}.low")
            high = self.number(self.member(entry, "high", where), f"{where}.high")
            if low > high:
                self.fail(f"{where}.low", f"is {low}, above high = {high}; exchange the two")
            ranges.append(InputRange(low, high))
        return tuple(ranges)

    def figures(self, entry: Any) -> FitFigures | None:
        if entry is None:
            return None
        if not isinstance(entry, Mapping):
            self.fail("fit", f"is {_kind_of(entry)}; it must be an object of fit figures, or null")
        self.only(entry, ("train_mse", "test_mse", "train_samples", "test_samples"), "fit")
        errors: list[float] = []
        counts: list[int] = []
        for name in ("train_mse", "test_mse"):
            errors.append(self.number(self.member(entry, name, "fit"), f"fit.{name}"))
            if errors[-1] < 0:
                self.fail(f"fit.{name}", f"is {errors[-1]}; a mean square is not negative")
        for name in ("train_samples", "test_samples"):
            count = self.member(entry, name, "fit")
            if not isinstance(count, int) or isinstance(count, bool) or count < 0:
                self.fail(f"fit.{name}", f"is {_short(count)}; it must be a count")
            counts.append(count)
        return FitFigures(errors[0], errors[1], counts[0], counts[1])

    def parameters(self, cls: type[Compensator], entry: Any) -> dict[str, Any]:
        if not isinstance(entry, Mapping):
            self.fail("parameters", f"is {_kind_of(entry)}; it must be an object")
        fields = number_fields(cls)
        self.only(entry, [column.name for column in fields], "parameters")
        values = {}
        for column in fields:
            where = f"parameters.{column.name}"
            shape = column.metadata.get("shape", ())
            positive = column.metadata.get("positive", False)
            values[column.name] = self.numbers(self.member(entry, column.name, "parameters"), shape, positive, where)
        return values

    def numbers(self, value: Any, shape: tuple[int | str, ...], positive: bool, where: str) -> Any:
        """Read nested lists of the wanted shape into nested tuples of floats."""
        if not shape:
            number = self.number(value, where)
            if positive and number <= 0:
                self.fail(where, f"is {number}; it must be above zero")
            return number
        if not isinstance(value, list | tuple):
            self.fail(where, f"is {_kind_of(value)}; it must be a list")
        length = shape[0] if isinstance(shape[0], int) else self.lengths.setdefault(shape[0], len(value))
        if len(value) != length or length == 0:
            self.fail(where, f"has {len(value)} entries; it must have {length or 'at least one'}")
        return tuple(self.numbers(item, shape[1:], positive, f"{where}[{i}]") for i, item in enumerate(value))

    def number(self, value: Any, where: str) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float):
            self.fail(where, f"is {_kind_of(value)}; it must be a number")
        try:
            number = float(value)
        except OverflowError:
            number = math.inf
        if not math.isfinite(number):
            self.fail(where, f"is {number}; it must be a finite number: train the compensator again")
        return number

    def member(self, data: Mapping[str, Any], name: str, parent: str) -> Any:
        if name not in data:
            self.fail(f"{parent}.{name}" if parent else name, "is missing; save the compensator again")
        return data[name]

    def only(self, data: Mapping[str, Any], known: Any, parent: str) -> None:
        for name in data:
            if name not in known:
                where = f"{parent}.{_short(name)}" if parent else _short(name)
                self.fail(where, f"is unknown; there are {', '.join(known)}: remove or correct it")

    def probe(self, compensator: Compensator) -> None:
        """Refuse numbers so large that the voltage overflows inside the training range."""
        ends = [(limits.low, limits.high) for limits in compensator.ranges] or [(-1.0, 1.0)] * len(INPUTS)
        corners = np.stack(np.meshgrid(*ends)).reshape(len(INPUTS), -1)
        with np.errstate(all="ignore"):
            volts = compensator.volts(corners[0], corners[1], corners[2])
        if not np.isfinite(volts).all():
            self.fail("parameters", "give a voltage that is not finite; train the compensator again")


def _kind_of(value: Any) -> str:
    kinds = {dict: "an object", list: "a list", str: "text", bool: "true or false", type(None): "null"}
    return kinds.get(type(value), f"the number {value}" if type(value) in (int, float) else "something else")


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."
