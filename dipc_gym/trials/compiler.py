"""Numba, which compiles the integrator, where nobody but the user gives it orders.

It takes settings from a file in the current folder, which may be a stranger's. One of them is the folder of its cache,
and what it finds there it unpickles and runs.
"""

from __future__ import annotations

from pathlib import Path

_SETTINGS = Path(".numba_config.yaml")
if _SETTINGS.exists():
    raise ValueError(
        f"{_SETTINGS.absolute()}: Numba would take orders from this file, such as whose compiled code to run; run the "
        "trial from another folder, or remove it"
    )

try:
    import numba
except ImportError as missing:
    raise ImportError("the blind trial needs numba: add its extra: pip install '.[trial]' in a clone") from missing

__all__ = ["numba"]
