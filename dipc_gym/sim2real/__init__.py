"""Sim-to-real: find, name and model the physics that a simulator leaves out.

`diagnose(model, recordings)` does it all. Data flows one way through the files here: recording, windows and states,
simulate and fit, evidence and search, judge, diagnosis, present and report.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dipc_gym.sim2real.diagnosis import diagnose
    from dipc_gym.sim2real.result import Diagnosis

__all__ = ["Diagnosis", "diagnose"]


def __getattr__(name: str) -> Any:
    """Import the diagnosis when it is asked for: recordings alone need none of it."""
    if name in __all__:
        from dipc_gym.sim2real import diagnosis

        return getattr(diagnosis, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
