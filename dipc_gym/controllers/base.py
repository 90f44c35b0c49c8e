"""What a controller is: from what is observed to the force that is wanted on the cart."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@runtime_checkable
class Remembers(Protocol):
    """What else a controller has that keeps something in mind from call to call."""

    def reset(self) -> None:
        """Forget it: a run begins."""


class Controller(Protocol):
    """What the experiments ask of a controller."""

    @property
    def name(self) -> str:
        """What tables call it."""

    def force(self, observation: Array) -> float:
        """Force wanted on the cart, N, for an observation (6,) of `DIPC-Friction-v0`."""
