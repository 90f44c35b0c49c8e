"""Sim-to-real: find, name and model the physics that a simulator leaves out.

`diagnose(model, recordings)` does it all. Data flows one way through the rooms here: a `model` with its `effects` is
laid over recordings in `simulation` and `estimation`, `selection` compares what may be missing, `verdict` says what it
comes to, and `report` tells it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from dipc_gym import recording

if TYPE_CHECKING:
    from dipc_gym.sim2real.diagnosis import diagnose
    from dipc_gym.sim2real.result import Diagnosis

__all__ = ["Diagnosis", "diagnose", "recording"]


def __getattr__(name: str) -> Any:
    """Import the diagnosis when it is asked for: recordings alone need none of it."""
    if name in __all__:
        from dipc_gym.sim2real import diagnosis

        return getattr(diagnosis, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
