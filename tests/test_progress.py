"""What a diagnosis shows while it runs."""

from __future__ import annotations

import io
import time

from dipc_gym.cli.progress import Progress
from dipc_gym.sim2real.stages import StageEnd


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


class Clock:
    now = 0.0

    def __call__(self) -> float:
        return self.now


def test_what_is_left_is_told_after_each_stage_and_goes_down() -> None:
    log, clock = io.StringIO(), Clock()
    with Progress(log, clock) as tell:
        progress: Progress = tell.__self__  # type: ignore[attr-defined]
        assert progress.left() == ""
        clock.now = 2.0
        tell("156 windows of 0.25 s")
        clock.now = 8.0
        tell(StageEnd("as given, the model is off by 9 x noise", "baseline"))
        first = progress.left()
        assert "left" in first
        clock.now = 12.0
        tell("friction.coulomb@cart: error 1 x noise (was 264)")
        assert progress.left() != first
        clock.now = 20.0
        tell(StageEnd("added friction.coulomb@cart", "round"))
        assert progress.left() == "6 s to 60 s left"  # half of the round that took 12 s, and five times
        clock.now = 100.0
        assert progress.left() == "longer than is usual"
    said = log.getvalue().splitlines()
    assert said[0] == "[  2.0 s] 156 windows of 0.25 s"
    assert [line for line in said if "left" in line] == [said[2], said[5]]


def test_a_terminal_is_kept_alive_and_a_log_is_not_filled() -> None:
    screen, log = Terminal(), io.StringIO()
    for out in (screen, log):
        with Progress(out) as tell:
            tell("156 windows of 0.25 s")
            time.sleep(1.2)
    assert "working" in screen.getvalue()
    assert screen.getvalue().endswith("\r\x1b[K")
    assert log.getvalue().count("\n") == 1
    assert "\r" not in log.getvalue()
