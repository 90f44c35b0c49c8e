"""Compensators in JSON files. Reading one executes nothing and trusts nothing."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

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
from dipc_gym.safety import untrusted
from dipc_gym.safety.files import write_json
from dipc_gym.safety.untrusted import Format, shown


class CompensatorError(ValueError):
    """A compensator file or dict cannot be used; the message names the file, the field and the mend."""


FORMAT = Format("compensator file", "compensators.save", "train the compensator again", 10_000_000, CompensatorError)
"""A trained compensator takes a few thousand bytes."""
WIDEST = 1e5  # N or m/s; a training range that goes further is no rig's
HIGHEST = 1e5
"""V, within the ranges of its inputs; ten times the largest supply that a plant can have."""
OUTPUT = {"name": "voltage", "unit": "V"}
PROBES = 9
"""Values of each input at which a compensator is tried, both ends included."""


def save(compensator: Compensator, path: str | Path) -> None:
    """Write a compensator to a JSON file; an older file of that name is replaced only once all is written.

    Args:
        compensator: What to write.
        path: Where to.

    Raises:
        OSError: The file cannot be written.
    """
    write_json(path, compensator.to_dict())


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
        return _Reader(FORMAT, "compensator dict").compensator(source)
    if not isinstance(source, str | Path):
        raise CompensatorError(f"a compensator comes from a path or a dict, not from {type(source).__name__}")
    return _Reader(FORMAT, str(source)).compensator(FORMAT.read(source))


class _Reader(untrusted.Reader):
    """Takes a compensator from untrusted data."""

    def compensator(self, data: Any) -> Compensator:
        self.document(data, SCHEMA, ("kind", "inputs", "output", "parameters", "fit"))
        name = data["kind"]
        if not isinstance(name, str) or name not in names():
            self.fail("kind", f"is {shown(name)}; there are {', '.join(names())} (register an own one before loading)")
        supply = self.supply(data["output"])
        ranges, figures = self.ranges(data["inputs"]), self.figures(data["fit"])
        values = self.parameters(kind(name), data["parameters"])
        try:
            compensator = kind(name)(**values, ranges=ranges, figures=figures, supply=supply)
        except ValueError as error:
            self.fail("parameters", str(error))
        if supply not in (None, compensator.supply):
            self.fail("output.high", f"is {supply} V, and the supply among its parameters {compensator.supply} V")
        self.probe(compensator)
        return compensator

    def supply(self, entry: Any) -> float | None:
        """The supply from the range of the output; files of earlier versions have none."""
        if not isinstance(entry, Mapping) or {**entry, "low": 0, "high": 0} != {**OUTPUT, "low": 0, "high": 0}:
            self.fail(
                "output", 'must be {"name": "voltage", "unit": "V"}, with "low" and "high" if the supply is known'
            )
        if "low" not in entry and "high" not in entry:
            return None
        self.members(entry, (*OUTPUT, "low", "high"), "output")
        supply = self.positive(entry["high"], "output.high")
        if self.number(entry["low"], "output.low") != -supply:
            self.fail("output.low", f"is {entry['low']}; a supply is as large either way, {-supply} here")
        return supply

    def ranges(self, entries: Any) -> tuple[InputRange, ...]:
        if not isinstance(entries, list | tuple) or len(entries) not in (0, len(INPUTS)):
            expected = ", ".join(name for name, _ in INPUTS)
            self.fail("inputs", f"must be a list of the {len(INPUTS)} inputs {expected}, or an empty list")
        ranges = []
        for i, (entry, (name, unit)) in enumerate(zip(entries, INPUTS, strict=False)):
            where = f"inputs[{i}]"
            self.members(entry, ("name", "unit", "low", "high"), where)
            self.one_of(entry["name"], (name,), f"{where}.name")
            self.one_of(entry["unit"], (unit,), f"{where}.unit")
            low = self.number(entry["low"], f"{where}.low")
            high = self.number(entry["high"], f"{where}.high")
            if low > high:
                self.fail(f"{where}.low", f"is {low}, above high = {high}; exchange the two")
            ranges.append(InputRange(low, high))
        return tuple(ranges)

    def figures(self, entry: Any) -> FitFigures | None:
        if entry is None:
            return None
        self.members(entry, ("train_mse", "test_mse", "train_samples", "test_samples"), "fit")
        return FitFigures(
            train_mse=self.mean_square(entry["train_mse"], "fit.train_mse"),
            test_mse=self.mean_square(entry["test_mse"], "fit.test_mse"),
            train_samples=self.count(entry["train_samples"], "fit.train_samples"),
            test_samples=self.count(entry["test_samples"], "fit.test_samples"),
        )

    def mean_square(self, value: Any, where: str) -> float:
        number = self.number(value, where)
        if number < 0:
            self.fail(where, f"is {number}; a mean square is not negative")
        return number

    def parameters(self, cls: type[Compensator], entry: Any) -> dict[str, Any]:
        fields = number_fields(cls)
        self.members(entry, [column.name for column in fields], "parameters")
        lengths: dict[str, int] = {}
        return {
            column.name: self.numbers(
                entry[column.name],
                column.metadata.get("shape", ()),
                self.positive if column.metadata.get("positive", False) else self.number,
                lengths,
                f"parameters.{column.name}",
            )
            for column in fields
        }

    def numbers(
        self,
        value: Any,
        shape: tuple[int | str, ...],
        read: Callable[[Any, str], float],
        lengths: dict[str, int],
        where: str,
    ) -> Any:
        """Read nested lists of the wanted shape into nested tuples of floats; lengths with a name must agree."""
        if not shape:
            return read(value, where)
        wanted = shape[0] if isinstance(shape[0], int) else lengths.get(shape[0])
        entries = self.entries(value, where, wanted)
        if isinstance(shape[0], str):
            lengths[shape[0]] = len(entries)
        return tuple(self.numbers(item, shape[1:], read, lengths, f"{where}[{i}]") for i, item in enumerate(entries))

    def probe(self, compensator: Compensator) -> None:
        """Refuse numbers that give no voltage of this world at the corners of the training range and between them."""
        ends = [(limits.low, limits.high) for limits in compensator.ranges] or [(-1.0, 1.0)] * len(INPUTS)
        beyond = [end for both in ends for end in both if abs(end) > WIDEST]
        if beyond:
            self.fail("inputs", f"range to {beyond[0]:.3g}, and no rig has such forces or velocities: train it again")
        with np.errstate(all="ignore"):
            axes = [low + (high - low) * np.linspace(0.0, 1.0, PROBES) for low, high in ends]
            force, velocity, previous = (axis.ravel() for axis in np.meshgrid(*axes))
            volts = np.broadcast_to(compensator.volts(force, velocity, previous), force.shape)
            wrong = ~(np.abs(volts) <= HIGHEST)
        if wrong.any():
            worst = int(np.argmax(wrong))
            self.fail(
                "parameters",
                f"give {volts[worst]:.3g} V for {force[worst]:.3g} N at {velocity[worst]:.3g} m/s, within the ranges "
                f"of its inputs; a compensator gives {HIGHEST:,.0f} V at most: train it again",
            )
