"""What the model of a structure decides by: numbers with their reasons, in one place."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ModelSettings:
    """Decision constants of structures and their parameters.

    Attributes:
        warm: s that bristles, currents and delays need to reach their state
        fast: s, longest step for what moves within milliseconds
        farthest: standard deviations of its prior by which a model parameter may move
    """

    warm: float = 0.06
    fast: float = 5e-4
    farthest: float = 4.0


MODEL = ModelSettings()
