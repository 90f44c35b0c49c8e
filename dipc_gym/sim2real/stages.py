"""Lines of progress that end a stage, so that whoever shows them knows which without reading them."""

from __future__ import annotations

from typing import Literal

Stage = Literal["baseline", "round"]


class StageEnd(str):
    """A line of progress that ends a stage.

    Attributes:
        stage: `baseline`, the fits of the model itself, before any effect is tried; `round`, of the search, that found
            an effect.

    Example:
        >>> StageEnd("added friction.coulomb@cart", "round").stage
        'round'
    """

    stage: Stage

    def __new__(cls, line: str, stage: Stage) -> StageEnd:
        """The line, and what ends with it."""
        made = super().__new__(cls, line)
        made.stage = stage
        return made
