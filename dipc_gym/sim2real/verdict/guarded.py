"""Late stages of a diagnosis; whatever happens in one, what the search found before is kept.

After many minutes of search come a dozen stages that judge, compare and word what was found. One that fails, or that
Ctrl-C ends, is left out and said to be; the others go on.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import ClassVar, TypeVar

from dipc_gym.sim2real.selection.stop import Stop

T = TypeVar("T")

LOG = logging.getLogger(__name__)  # of what a note says in one line, for whoever looks into it
LOG.addHandler(logging.NullHandler())  # else Python prints it for whoever asked for no log


class Guarded:
    """Runs stages and keeps notes on those that were left out.

    Attributes:
        stop: Ctrl-C, which it asks and is told by.
        strict: whether a failure ends the diagnosis; the tests set it, or they would pass whatever fails.
        notes: what the reader of the diagnosis should know, in sentences.
    """

    strict: ClassVar[bool] = False

    def __init__(self, stop: Stop) -> None:
        self.stop = stop
        self.notes: list[str] = []

    def __call__(self, what: str, stage: Callable[[], T], otherwise: Callable[[], T]) -> T:
        """What a stage gives, or what stands for it.

        Args:
            what: is lacking without the stage, as the subject of a sentence.
            stage: gives it.
            otherwise: what is taken in its place; must not fail.

        Raises:
            KeyboardInterrupt: at the second Ctrl-C.
        """
        try:
            return self.stop.unless_pressed(stage, otherwise)
        except Exception as error:  # whatever it is, what was found before stands
            if self.strict:
                raise
            LOG.exception("%s could not be worked out", what)
            said = str(error).strip().splitlines()
            why = f"{type(error).__name__}: {said[0]}" if said else type(error).__name__
            self.notes.append(
                f"{what} could not be worked out ({why}) and is left out; what was found before stands. Please report "
                "this with the files."
            )
            self.stop.tell(f"note: {self.notes[-1]}")
            return otherwise()
