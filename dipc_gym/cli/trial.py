"""`dipc-gym trial`."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal


@dataclass(frozen=True)
class Trial:
    """Run the blind trial of the diagnosis, which anybody can repeat.

    A generator that knows neither the tool nor MuJoCo simulates rigs with concealed physics and writes recordings and
    a nominal model; the tool diagnoses these files in folders of their own; a scorer then opens the sealed answers.
    Interrupted, it scores what is done, and goes on where it stopped when started again. On a Ray cluster, the nodes
    must share the folder.

    Try:
        dipc-gym trial --out trial
        dipc-gym trial --out trial --rivals
        dipc-gym trial --out trial --count 12 --seed 7
        dipc-gym trial --out laws --laws
        dipc-gym trial --out big --full --backend ray
    """

    out: Path
    """folder for trials, sealed answers, results and the table"""
    seed: int = 14
    """determines every trial; 14 is that of the published table"""
    count: int | None = None
    """number of trials; without it 42, 430 with --full, 150 with --laws"""
    full: bool = False
    """the long version, some three hours of one core; what has nothing missing comes first"""
    laws: bool = False
    """hide physics of shapes that no formula has: friction, forces and drives of any law, and what has no name"""
    jobs: int | None = None
    """trials at a time, each on one core; without it 2, or on Ray as many as the cluster has CPUs"""
    backend: Literal["local", "ray"] = "local"
    """ray: on the cluster that RAY_ADDRESS names, or a Ray that is started on this machine"""
    limit: float = 1800.0
    """seconds after which a diagnosis is stopped and counts as failed"""
    rivals: bool = False
    """give the same trials to mujoco.sysid, to a residual network and to PySINDy instead, and add their table"""

    def run(self) -> int:
        """Generate, diagnose, score, print the table."""
        if self.full and self.laws:
            raise ValueError("--full and --laws are two different trials: choose one")
        if self.count is not None and self.count < 1:  # before imports, which may ask to install something
            raise ValueError(f"--count is {self.count}; it is the number of trials, 1 or more")
        if not 0 < self.limit < math.inf:
            raise ValueError(f"--limit is {self.limit}; it is a number of seconds above 0")
        if self.rivals and self.limit != type(self).limit:
            raise ValueError("--limit stops diagnoses; --rivals asks for none: leave one of them out")
        which: dict[str, Any] = {"count": self.count, "full": self.full, "laws": self.laws}
        if self.rivals:
            from dipc_gym.trials.generate import plans
            from dipc_gym.trials.rivals import compare

            rows = compare(self.out, seed=self.seed, **which, jobs=self.jobs, backend=self.backend)
            print((self.out / "rivals.md").read_text())
            return 1 if len(rows) < len(plans(self.seed, **which)) else 0
        from dipc_gym.trials.run import trial

        scores = trial(
            self.out,
            seed=self.seed,
            **which,
            jobs=self.jobs,
            backend=self.backend,
            patience=self.limit,
        )
        print((self.out / "report.md").read_text())
        return 1 if scores["open"] else 0
