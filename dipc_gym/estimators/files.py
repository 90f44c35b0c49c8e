"""Estimators in JSON files. Reading one executes nothing and trusts nothing."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from dipc_gym.estimators.base import SCHEMA, Estimator, RigModel
from dipc_gym.estimators.registry import kind, names
from dipc_gym.plant import Friction
from dipc_gym.safety import untrusted
from dipc_gym.safety.files import write_json
from dipc_gym.safety.untrusted import Format, shown


class EstimatorError(ValueError):
    """An estimator file or dict cannot be used; the message names the file, the field and the mend."""


FORMAT = Format("estimator file", "estimators.save", "fit the estimator again", 1_000_000, EstimatorError)


def save(estimator: Estimator, path: str | Path) -> None:
    """Write an estimator to a JSON file, which appears whole or not at all.

    Raises:
        OSError: it cannot be written.
    """
    write_json(path, estimator.to_dict())


def load(source: str | Path | Mapping[str, Any]) -> Estimator:
    """Read an estimator from a JSON file or from the dict that `to_dict` gives.

    Raises:
        EstimatorError: it cannot be read, or a field is missing, unknown or not what it must be.
    """
    if isinstance(source, Mapping):
        return _Reader(FORMAT, "estimator dict").estimator(dict(source))
    if not isinstance(source, str | Path):
        raise EstimatorError(f"an estimator comes from a path or a dict, not from {type(source).__name__}")
    return _Reader(FORMAT, str(source)).estimator(FORMAT.read(source))


class _Reader(untrusted.Reader):
    def estimator(self, data: Any) -> Estimator:
        self.document(data, SCHEMA, ("kind", "rig", "friction"))
        name = data["kind"]
        if not isinstance(name, str) or name not in names():
            self.fail("kind", f"is {shown(name)}; there are {', '.join(names())}")
        described = data["rig"]
        if isinstance(described, dict):  # files may be older than the delay
            described = {"delay": 0.0, **described}
        rig = self.members(described, [f.name for f in dataclasses.fields(RigModel)], "rig")
        dry = self.members(data["friction"], [f.name for f in dataclasses.fields(Friction)], "friction")
        rows = [self.row(row, 6, f"rig.A[{i}]") for i, row in enumerate(self.entries(rig["A"], "rig.A", 6))]
        plain = {key: self.number(value, f"rig.{key}") for key, value in rig.items() if key not in "AB"}
        levels = {key: self.number(value, f"friction.{key}") for key, value in dry.items()}
        try:
            model = RigModel(A=tuple(rows), B=self.row(rig["B"], 6, "rig.B"), **plain)
            return kind(name)(model, Friction(**levels))
        except (ValueError, ArithmeticError) as error:
            if isinstance(error, EstimatorError):
                raise
            raise EstimatorError(f"{self.source}: {error}; {self.format.mend}") from None

    def row(self, value: Any, length: int, where: str) -> tuple[float, ...]:
        return tuple(self.number(v, f"{where}[{i}]") for i, v in enumerate(self.entries(value, where, length)))
