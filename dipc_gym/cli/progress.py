"""How far a diagnosis is: lines with the time since the start, and an estimate of what is left."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import TextIO

# How many times as long as a stage what follows it takes, at least and at most. How long a search takes depends on how
# many effects there are to find: beside the time until it began it took 7 times as long where nothing was missing
# (practice trial p01), and 35 times where friction was (p02). Beside the round that found its last effect, what came
# after it took 2.5 times as long there: another round, fits of what might stand in for it, and the judging.
FACTORS = {"baseline": (5.0, 40.0), "round": (0.5, 5.0)}


class Progress:
    """Prints what a diagnosis tells, and, on a terminal, keeps a line alive that says how long it has to go.

    The estimate is a range, for nobody knows how many effects there are to find. Into a log goes one line for each
    stage, and no line twice. Where nothing can be written any more (a log on a full disk, a pipe whose reader has
    gone), it is silent: what is found matters more.

    Args:
        out: where to.
        clock: seconds.

    Example:
        >>> from dipc_gym.sim2real.stages import StageEnd
        >>> with Progress(sys.stdout, clock=iter([0.0, 2.0, 8.0, 8.0]).__next__) as tell:
        ...     tell("156 windows of 0.25 s")
        ...     tell(StageEnd("as given, the model is off by 9 x noise", "baseline"))
        [  2.0 s] 156 windows of 0.25 s
        [  8.0 s] as given, the model is off by 9 x noise
        [  8.0 s] 40 s to 5 min left, by how long this took
    """

    def __init__(self, out: TextIO | None = None, clock: Callable[[], float] = time.monotonic) -> None:
        self._out = sys.stderr if out is None else out
        self._clock = clock
        self._began = clock()
        self._marks: list[float] = [0.0]  # s since the start, of the ends of stages
        self._range: tuple[float, float] | None = None  # s since the start, between which it should end
        self._stop, self._lock = threading.Event(), threading.Lock()
        self._live = threading.Thread(target=self._beat, daemon=True) if self._out.isatty() else None

    def __enter__(self) -> Callable[[str], None]:
        if self._live is not None:
            self._live.start()
        return self.tell

    def __exit__(self, *error: object) -> None:
        self._stop.set()
        if self._live is not None:
            self._live.join()
            with self._lock:
                self._write("\r\x1b[K")

    def tell(self, line: str) -> None:
        """Print a line, and what is left if a stage ended with it."""
        now = self._clock() - self._began
        self._print(now, line)
        stage = getattr(line, "stage", "")  # of a `sim2real.stages.StageEnd`, which help must not load
        if stage not in FACTORS:
            return
        took = now - self._marks[-1]
        least, most = FACTORS[stage]
        self._range = now + least * took, now + most * took
        self._marks.append(now)
        self._print(now, f"{self.left()}, by how long this took")

    def left(self) -> str:
        """What is left, in words; empty before it can be said."""
        if self._range is None:
            return ""
        now = self._clock() - self._began
        least, most = (max(end - now, 0.0) for end in self._range)
        if most == 0:
            return "longer than is usual"
        return f"{_words(least)} to {_words(most)} left" if least >= 1 else f"at most {_words(most)} left"

    def _print(self, now: float, line: str) -> None:
        with self._lock:
            self._write(("\r\x1b[K" if self._live is not None else "") + f"[{now:5.1f} s] {line}\n")

    def _beat(self) -> None:
        while not self._stop.wait(1.0):
            now, left = self._clock() - self._began, self.left()
            with self._lock:
                self._write(f"\r\x1b[K[{now:5.1f} s] working{', ' + left if left else ''} (Ctrl-C ends the search)")

    def _write(self, text: str) -> None:
        with suppress(OSError):
            self._out.write(text)
            self._out.flush()


def _words(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 100 else f"{seconds / 60:.0f} min"
