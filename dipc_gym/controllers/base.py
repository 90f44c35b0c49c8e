"""What a controller is: from what is observed to the force that is wanted on the cart."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Controller(Protocol):
    """What the experiments ask of a controller."""

    @property
    def name(self) -> str:
        """What tables call it."""

    def force(self, observation: Array) -> float:
        """Force wanted on the cart, N, for an observation (6,) of `DIPC-Friction-v0`."""
