"""A cell of a sweep that is done at once. Processes that run it import this file, and none of what tests import."""

from __future__ import annotations

import os
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from dipc_gym.safety import intact


@dataclass(frozen=True)
class Halve:
    """Halves a number; some numbers fail or kill the process that halves them."""

    number: int
    trace: str = ""
    options: dict[str, float] = field(default_factory=lambda: {"scale": 1.0})

    @property
    def name(self) -> str:
        return f"halve-{self.number:03d}"

    def run(self) -> Any:
        if self.trace:
            (Path(self.trace) / f"{self.number}-{time.monotonic_ns()}").touch()
        if self.number == 13:
            raise ArithmeticError("thirteen\nis unlucky")
        if self.number == 14:
            return float("nan")
        if self.number == 99:
            os._exit(3)
        time.sleep(0.02)
        return {
            "half": self.number / 2 * self.options["scale"],
            "pid": os.getpid(),
            "threads": os.environ.get("OMP_NUM_THREADS"),
        }

    def check(self, result: Any) -> None:
        intact.fit(result, {"half": float})
