"""What results were made with, so that they can be made again."""

from __future__ import annotations

import platform
from importlib import metadata


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
