"""What results were made with, so that they can be made again."""

from __future__ import annotations

import hashlib
import platform
from collections.abc import Mapping
from importlib import metadata
from pathlib import Path
from typing import Any

from dipc_gym import mjcf


def versions(*packages: str) -> dict[str, str]:
    """Versions of Python, of dipc-gym, and of the packages that a result depends on.

    Example:
        >>> list(versions("mujoco", "numpy"))
        ['python', 'dipc-gym', 'mujoco', 'numpy']
    """
    return {
        "python": platform.python_version(),
        **{name: metadata.version(name) for name in ("dipc-gym", *packages)},
    }


def digest(file: Path) -> str:
    """SHA-256 of a file; of a model (`.xml`) with all that it includes, as `mjcf.Source.sha256`.

    Raises:
        OSError: it cannot be read.
        mjcf.MjcfError: it is a model that cannot be read.
    """
    return mjcf.read(file).sha256 if file.suffix == ".xml" else hashlib.sha256(file.read_bytes()).hexdigest()


def made_with(*packages: str, timestep: float, inputs: Mapping[str, str], **further: Any) -> dict[str, Any]:
    """What a result on recordings says of its making.

    Args:
        packages: that it depends on.
        timestep: of the simulation, s.
        inputs: digest of each input, by its name.
        further: such as the seed.

    Example:
        >>> list(made_with("numpy", timestep=0.002, inputs={}, seed=0))
        ['versions', 'timestep', 'inputs', 'seed']
    """
    return {"versions": versions(*packages), "timestep": timestep, "inputs": dict(inputs), **further}
