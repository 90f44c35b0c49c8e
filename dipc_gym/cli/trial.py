"""`dipc-gym trial`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Trial:
    """Run the blind trial of the diagnosis, which anybody can repeat.

    A generator that knows neither the tool nor MuJoCo simulates rigs with concealed physics and writes recordings and
    a nominal model; the tool diagnoses these files in folders of their own; a scorer then opens the sealed answers.
    Interrupted, it scores what is done, and goes on where it stopped when started again.

    Try:
        dipc-gym trial --out trial
        dipc-gym trial --out trial --rivals
        dipc-gym trial --out trial --count 12 --seed 7
        dipc-gym trial --out big --full --jobs 2
    """

    out: Path
    """folder for trials, sealed answers, results and the table"""
    seed: int = 1
    """determines every trial; 1 is that of the published table"""
    count: int | None = None
    """number of trials; without it 42, or 430 with --full"""
    full: bool = False
    """the long version"""
    jobs: int = 1
    """trials at a time, each on one core"""
    limit: float = 1800.0
    """seconds after which a diagnosis is stopped and counts as failed"""
    rivals: bool = False
    """give the same trials to mujoco.sysid and to a residual network instead, and add their table"""

    def run(self) -> int:
        """Generate, diagnose, score, print the table."""
        if self.rivals:
            from dipc_gym.trials.rivals import compare

            compare(self.out, seed=self.seed, count=self.count, full=self.full, jobs=self.jobs)
            print((self.out / "rivals.md").read_text())
            return 0
        from dipc_gym.trials.run import trial

        trial(self.out, seed=self.seed, count=self.count, full=self.full, jobs=self.jobs, patience=self.limit)
        print((self.out / "report.md").read_text())
        return 0
