"""What a target is, and the malice that all share."""

from __future__ import annotations

import json
import random
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from mutate import octets, tree

Damage = Callable[[bytes, random.Random], bytes]
BOTH: tuple[Damage, ...] = (octets, tree)


@dataclass(frozen=True)
class Target:
    """A kind of file.

    Attributes:
        files: a valid set, by path within the case's folder.
        damage: by path, how that file is damaged; one of them in each case.
        read: does what the command does with the folder.
        errors: what it may raise.
    """

    files: Mapping[str, bytes]
    damage: Mapping[str, tuple[Damage, ...]]
    read: Callable[[Path], Any]
    errors: tuple[type[Exception], ...]


def as_json(value: Any) -> bytes:
    """The bytes of a JSON file."""
    return json.dumps(value, indent=1).encode()


def finite(*values: Any) -> None:
    """Refuse what was read as numbers and is none."""
    if not all(np.isfinite(value).all() for value in values):
        raise AssertionError("what was read gives numbers that are not finite")
