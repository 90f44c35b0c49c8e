"""What the report draws, as a file: written with a diagnosis, and read again with suspicion.

JSON throughout; an array is the base64 text of its float64 values, least significant byte first. Nothing is unpickled
or unpacked, so that a file holds no more than its size says.
"""

from __future__ import annotations

import base64
import binascii
import dataclasses
import itertools
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dipc_gym.safety import intact
from dipc_gym.safety.files import finite
from dipc_gym.safety.untrusted import Format, Reader
from dipc_gym.sim2real.report.page import VERDICTS
from dipc_gym.sim2real.result import SCHEMA as DIAGNOSIS_SCHEMA
from dipc_gym.sim2real.result import Candidate, Details, Mismatch, SensorResidual, Trace

Array = NDArray[np.float64]

SCHEMA = "dipc-gym/report/1"
DIAGNOSES = ("dipc-gym/diagnosis/1", "dipc-gym/diagnosis/2", DIAGNOSIS_SCHEMA)
LARGEST = 50_000_000  # bytes; what is drawn is bounded, a difference of long files may need most of it


class SavedError(ValueError):
    """A saved diagnosis that cannot be drawn; the message names file, field and fault, and the mend."""


FORMAT = Format("report's data file", "dipc-gym diagnose", "diagnose again", LARGEST, SavedError)
DIAGNOSIS = Format("diagnosis", "dipc-gym diagnose", "diagnose again", LARGEST, SavedError)


@dataclass(frozen=True)
class Drawn:
    """What the page shows beside diagnosis.json.

    Attributes:
        model: name of the model's file.
        command: that makes the diagnosis again.
        details: what is drawn; None where nothing could be fitted.
    """

    model: str
    command: str
    details: Details | None


PARTS: dict[str, type[Trace | Mismatch | Candidate | SensorResidual]] = {
    "traces": Trace,
    "maps": Mismatch,
    "candidates": Candidate,
    "residuals": SensorResidual,
}
# How each kind of field of theirs stands in JSON.
KINDS: dict[str, intact.Shape] = {
    "str": str,
    "Status": str,
    "float": (float, None),
    "float | None": (float, None),
    "Array": str,
    "Array | None": (str, None),
}


def text(drawn: Drawn) -> str:
    """What the page shows, as JSON."""
    details = drawn.details
    held = details and {
        "before": details.before,
        "difference": details.difference,
        **{name: [_plain(entry) for entry in getattr(details, name)] for name in PARTS},
    }
    said = {"schema": SCHEMA, "model": drawn.model, "command": drawn.command, "details": held}
    return json.dumps(finite(said), allow_nan=False) + "\n"


def _plain(entry: Trace | Mismatch | Candidate | SensorResidual) -> dict[str, Any]:
    values = {field.name: getattr(entry, field.name) for field in dataclasses.fields(entry)}
    return {name: _packed(value) if isinstance(value, np.ndarray) else value for name, value in values.items()}


def _packed(values: Array) -> str:
    return base64.b64encode(np.ascontiguousarray(values, dtype="<f8").tobytes()).decode("ascii")


def read(path: Path) -> Drawn:
    """Read what `text` has made.

    Raises:
        SavedError: it is no such file, or does not hold what was written.
    """
    reader = Reader(FORMAT, str(path))
    held = reader.document(_json(FORMAT, path), SCHEMA, ("model", "command", "details"))
    shape: intact.Shape = {
        "before": str,
        "difference": str,
        **{name: [{f.name: KINDS[str(f.type)] for f in dataclasses.fields(kind)}] for name, kind in PARTS.items()},
    }
    _check(path, held, {"model": str, "command": str, "details": (shape, None) if held["details"] is None else shape})
    if held["details"] is None:
        return Drawn(held["model"], held["command"], None)
    members = reader.members(held["details"], ("before", "difference", *PARTS), "details")
    parts: dict[str, Any] = {}
    for name, kind in PARTS.items():
        parts[name] = tuple(_entry(reader, kind, one, f"details.{name}[{i}]") for i, one in enumerate(members[name]))
    try:
        details = Details(before=members["before"], difference=members["difference"], **parts)
    except ValueError as error:
        reader.fail("details", f"{error}; {FORMAT.mend}")
    return Drawn(held["model"], held["command"], details)


def _entry(reader: Reader, kind: type[Any], entry: Mapping[str, Any], where: str) -> Any:
    kinds = {field.name: str(field.type) for field in dataclasses.fields(kind)}
    reader.members(entry, list(kinds), where)
    values = dict(entry)
    for name, is_a in kinds.items():
        if "Array" in is_a and entry[name] is not None:
            values[name] = _unpacked(reader, entry[name], f"{where}.{name}")
        elif is_a == "float" and entry[name] is None:
            values[name] = math.nan
    for name in ("time", "lags"):
        if name in values and not np.all(np.abs(values[name]) < intact.LARGEST):
            reader.fail(f"{where}.{name}", f"holds times that are no numbers; {FORMAT.mend}")
    if kind is Trace and np.any(np.diff(values["time"]) < 0):  # the others count from zero with each recording
        reader.fail(f"{where}.time", f"does not rise; {FORMAT.mend}")
    try:
        return kind(**values)
    except ValueError as error:
        return reader.fail(where, f"{error}; {FORMAT.mend}")


def _unpacked(reader: Reader, value: str, where: str) -> Array:
    try:
        return np.frombuffer(base64.b64decode(value, validate=True), dtype="<f8").astype(np.float64)
    except (ValueError, binascii.Error):
        return reader.fail(where, f"is no base64 text of float64 values; {FORMAT.mend}")


def read_diagnosis(path: Path) -> dict[str, Any]:
    """Read what the page shows of diagnosis.json; what may be left out there is None.

    Raises:
        SavedError: it is no such file, or does not hold what was written.
    """
    held = _json(DIAGNOSIS, path)
    reader = Reader(DIAGNOSIS, str(path))
    if not isinstance(held, dict) or held.get("schema") not in DIAGNOSES:
        reader.fail("schema", f"is none of {', '.join(DIAGNOSES)}; {DIAGNOSIS.mend}")
    said: dict[str, Any] = {key: held.get(key) for key in _FOUND}
    for key, names in _OPTIONAL.items():
        if isinstance(said[key], list):
            said[key] = [_filled(one, names) for one in said[key]]
    for missing in said["missing"] if isinstance(said["missing"], list) else ():
        if isinstance(missing, dict) and isinstance(missing.get("parameters"), dict):
            missing["parameters"] = {k: _filled(p, _INTERVAL) for k, p in missing["parameters"].items()}
        if isinstance(missing, dict) and missing.get("law"):
            missing["law"] = _filled(missing["law"], _REMEMBERS)
    _check(path, said, _FOUND)
    if said["verdict"] not in VERDICTS:
        reader.fail("verdict", f"is none of {', '.join(VERDICTS)}; {DIAGNOSIS.mend}")
    if said["fit"]:
        said["fit"] = _filled(said["fit"], _LATER)
        if isinstance(said["fit"], dict) and "train" in said["fit"]:  # as the first two schemas call it
            said["fit"]["comparison"] = said["fit"].pop("train")
        _check(path, {"fit": said["fit"]}, {"fit": _FIT})
    for i, missing in enumerate(said["missing"]):
        if missing["law"] is not None:
            _check_law(reader, missing["law"], f"missing[{i}].law")
    return said


_NUMBER = (float, None)
_LAW: intact.Shape = {
    "of": [str],
    "kind": str,
    "table": {"inputs": [{"name": str, "unit": str, "knots": [float]}], "levels": [object], "unit": str},
    "supported": [[float]],
    "outside": str,
    "passive": (bool, None),
    "remembers": (str, None),
}
_NAME = {"effect": str, "at": str}
_INTERVAL = ("low", "high", "level")
_REMEMBERS = ("remembers",)  # of laws; earlier files have it not
_OPTIONAL = {"located": ("kind",), "missing": ("law",), "recalibrated": ("low", "high", "level", "was", "unit")}
_ERRORS = {"nominal": _NUMBER, "recalibrated": _NUMBER, "improved": _NUMBER}
_SENSOR = {"unit": str, "noise": _NUMBER, "motion": float, "error": _ERRORS, "share_of_motion": _ERRORS}
_LATER = ("held_out_in_noise", "as_written", "held_out_by_sensor")  # of `fit`; the first schema has them not
_FIT: intact.Shape = {
    "comparison": _ERRORS,
    "held_out": _ERRORS,
    "noise_floor": _NUMBER,
    "held_out_in_noise": (_ERRORS, None),
    "as_written": ({"timestep": float, "integrator": str, "held_out_in_noise": _ERRORS}, None),
    "held_out_by_sensor": ({str: _SENSOR}, None),
}
_FOUND: dict[str, intact.Shape] = {
    "verdict": str,
    "sentence": str,
    "located": [{"at": str, "share": _NUMBER, "where": str, "kind": (str, None)}],
    "missing": [
        {
            **_NAME,
            "sentence": str,
            "share": _NUMBER,
            "same_here": [_NAME],
            "parameters": {str: {"value": _NUMBER, "unit": str, **dict.fromkeys(_INTERVAL, _NUMBER)}},
            "rivals": [{**_NAME, "held_out": _NUMBER, "ruled_out": bool}],
            "law": (_LAW, None),
        }
    ],
    "recalibrated": [
        {
            "parameter": str,
            "at": str,
            "was": _NUMBER,
            "value": _NUMBER,
            "unit": (str, None),
            **dict.fromkeys(_INTERVAL, _NUMBER),
        }
    ],
    "fit": object,
    "next_experiment": str,
    "improved_model": str,
    "needs_dipc_gym": [str],
    "notes": [str],
    "provenance": {"versions": {str: str}, "timestep": float, "inputs": {str: str}, "seed": int},
}


def _check_law(reader: Reader, law: Mapping[str, Any], where: str) -> None:
    """Refuse a law that is no table over one or two rising inputs."""
    table = law["table"]
    knots = [one["knots"] for one in table["inputs"]]
    rising = all(len(one) > 1 and all(a < b for a, b in itertools.pairwise(one)) for one in knots)
    shaped = len(law["of"]) == len(knots) and [len(ends) for ends in law["supported"]] == [2] * len(knots)
    for name in ("levels", "low", "high"):
        if name not in table and name != "levels":
            continue
        rows = table[name] if isinstance(table[name], list) else [None]
        flat = [level for row in rows for level in (row if isinstance(row, list) else [row])]
        try:
            intact.fit(flat, [float], f"{where}.table.{name}")
        except ValueError as error:
            reader.fail(where, f"{error}; {DIAGNOSIS.mend}")
        try:
            shaped = shaped and np.shape(table[name]) == tuple(map(len, knots))
        except ValueError:  # rows of several lengths
            shaped = False
    if "low" in table and "high" not in table:
        shaped = False
    if not (1 <= len(knots) <= 2 and rising and shaped):
        reader.fail(where, f"is no table over one or two inputs with rising knots; {DIAGNOSIS.mend}")


def _filled(value: Any, names: tuple[str, ...]) -> Any:
    """An object with None for what it leaves out; whatever else it is, `_check` will refuse."""
    return {**dict.fromkeys(names), **value} if isinstance(value, dict) else value


def _json(format: Format, path: Path) -> Any:
    if not path.is_file():  # opening a named pipe would wait for ever
        raise SavedError(f"{path}: is not there, or no file; {format.mend}")
    return format.read(path)


def _check(path: Path, value: Any, shape: intact.Shape) -> None:
    try:
        intact.fit(value, shape)
    except (ValueError, RecursionError) as error:
        raise SavedError(f"{path}: {error or 'nested too deeply'}; {FORMAT.mend}") from None
