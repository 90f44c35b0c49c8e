"""What a trial leaves on disk, read again: sealed answers, notes on attempts, and what rivals gave.

All of it may have been damaged since, or come from a stranger. What does not hold is set aside and made again: an
answer and its recordings from the seed, which gives the same ones, an attempt by diagnosing once more.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from dipc_gym.safety import intact
from dipc_gym.safety.intact import DamagedError
from dipc_gym.safety.places import PlaceError, inside
from dipc_gym.trials.grade import Grade, grade

NAMED = {"effect": str, "at": str}
KINDS = ("null", "single", "pair", "unknown", "wrong")
ANSWER = {
    **dict.fromkeys(("trial", "rig", "kind"), str),
    **dict.fromkeys(("tuned", "known_friction", "recalibrated_suffices", "held_out_predictable"), bool),
    **dict.fromkeys(("share_of_signal", "moved_from_nominal", "signal"), float),
    "missing": [{**NAMED, "also_at": [str]}],
    "includes": [str],
    "parameters": {str: {str: {"value": float}}},
    "equivalents": {str: [NAMED]},
    "equivalent_sets": {str: [[NAMED]]},
    "share_of_each": {str: float},
    "drive": dict.fromkeys(("gear", "rotor", "kt", "resistance"), float),
    "test_error": dict.fromkeys(("nominal", "recalibrated", "truth"), float),
    "noise": {str: float},
}
ATTEMPT = {"seconds": float, "failure": (None, str), "sensor_errors": (None, {str: float})}
ATTEMPT_MAY = {
    "sensor_errors_own_step": (None, {str: float}),
    "error_within": (None, float),
    "tool": str,
    "timed_out": bool,
    "files": {str: str},
}
DIAGNOSIS = {"verdict": str, "missing": [NAMED], "recalibrated": [object]}
CONTEST = {name: {"error": (None, float), "seconds": float} for name in ("sysid", "network", "sparse")}
PLAIN = re.compile(r"[\w.:+@/ -]{1,100}")
"""Names of effects and places; a table and a figure show them."""


def answer(out: Path, name: str) -> dict[str, Any]:
    """The sealed answer of a trial.

    Args:
        out: folder of the run.
        name: of the trial.

    Raises:
        DamagedError: it is not there, or it or a file of its trial is not what was written.
    """
    path = inside(out, f"sealed/{name}.json")
    held = intact.read(path, ANSWER)
    if held["kind"] not in KINDS or held["trial"] != name:
        raise DamagedError(f"{path}: is the answer of {held['trial']!r}, of kind {held['kind']!r}; delete it")
    _same_files(path, inside(out, f"trials/{name}"), held)
    _judged(path, held, None, {"failure": "none yet"})
    return held


def attempt(out: Path, name: str) -> tuple[dict[str, Any], dict[str, Any] | None]:
    """The note on an attempt, and the diagnosis, or None where there is none.

    Args:
        out: folder of the run.
        name: of the trial.

    Raises:
        DamagedError: either is not what was written.
    """
    path = inside(out, f"results/{name}/attempt.json")
    note = intact.read(path, ATTEMPT)
    said = {key: shape for key, shape in ATTEMPT_MAY.items() if key in note}
    try:
        intact.fit(note, said)
    except ValueError as fault:
        raise DamagedError(f"{path}: {fault}") from None
    if note["failure"] is not None:
        return note, None
    _same_files(path, path.parent, note)
    written = path.with_name("diagnosis.json")
    return note, intact.read(written, DIAGNOSIS) if written.exists() else None


def graded(out: Path, name: str) -> Grade:
    """How an attempt did.

    Raises:
        DamagedError: answer, note or diagnosis are damaged or do not fit each other.
    """
    sealed = answer(out, name)
    note, diagnosis = attempt(out, name)
    return _judged(inside(out, f"results/{name}/attempt.json"), sealed, diagnosis, note)


def contest(out: Path, name: str) -> dict[str, Any]:
    """What rivals gave.

    Raises:
        DamagedError: it is not what was written.
    """
    return intact.read(inside(out, f"results/{name}/rivals.json"), CONTEST)


def digests(texts: Mapping[str, bytes]) -> dict[str, str]:
    """SHA-256 of files by name, to be written into the record that goes with them."""
    return {name: hashlib.sha256(text).hexdigest() for name, text in texts.items()}


def _same_files(path: Path, folder: Path, record: Mapping[str, Any]) -> None:
    """Refuse a record whose files, as far as it says which it has, were changed or are gone."""
    said = record.get("files", {})
    try:
        intact.fit(said, {str: str})
        for name, digest in said.items():
            file = inside(folder, name)
            if not file.is_file() or hashlib.sha256(file.read_bytes()).hexdigest() != digest:
                raise ValueError(f"{file} is gone, or was changed after it was written")
    except (ValueError, PlaceError, OSError) as fault:
        raise DamagedError(f"{path}: {fault}") from None


def _judged(
    path: Path, sealed: Mapping[str, Any], diagnosis: Mapping[str, Any] | None, note: Mapping[str, Any]
) -> Grade:
    """What grading says, which looks closer than a shape can: a stranger's numbers need not fit each other."""
    try:
        found = grade(sealed, diagnosis, note)
        for name in (found.rig, found.verdict, *found.truth, *found.said):
            if not PLAIN.fullmatch(name):
                raise ValueError(f"{name[:40]!r} is no name")
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as fault:
        raise DamagedError(f"{path}: cannot be judged ({type(fault).__name__}: {fault}); delete it") from None
    return found
