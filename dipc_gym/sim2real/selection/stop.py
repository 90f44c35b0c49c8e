"""Ctrl-C: the first one ends what is being tried and keeps what was found, the second ends all."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

T = TypeVar("T")


@dataclass
class Stop:
    """Whether Ctrl-C was pressed; one for a whole diagnosis, which every stage is given.

    Attributes:
        tell: called with a line when it is.
        asked: whether it was.
    """

    tell: Callable[[str], None]
    asked: bool = False

    def ask(self, what: str) -> None:
        """Note that no more is to be tried, and say what is done instead.

        Raises:
            KeyboardInterrupt: it was asked before.
        """
        if self.asked:
            raise KeyboardInterrupt
        self.asked = True
        self.tell(f"interrupted; {what} (once more stops at once)")

    def unless_pressed(self, stage: Callable[[], T], otherwise: Callable[[], T]) -> T:
        """What a stage after the search gives, or what stands for it where Ctrl-C ended the stage.

        Raises:
            KeyboardInterrupt: at the second Ctrl-C.
        """
        try:
            return stage()
        except KeyboardInterrupt:
            self.ask("writing what was found")
            return otherwise()
