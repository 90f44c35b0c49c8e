"""`dipc-gym compare`."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from dipc_gym.cli.options import listed


@dataclass(frozen=True)
class Compare:
    """Run the paper's experiment over many rigs and compare friction compensators.

    On each rig: record the identification run (poles locked, a voltage swept from 0.3 to 10 Hz in 60 s), train the
    compensators on it, and balance the pendulum for 80 s with every controller and compensator. The folder gets
    summary.json, table.txt, figures, a GIF, the trained compensators and recordings of the first rig's runs. Killed, it
    goes on where it stopped when started again; what failed is listed and tried again, and the exit code is then 1.

    With --robustness, every pair then balances the same rigs, changed more and more after training: how far it holds
    stands in robustness.txt, robustness.json and figures/robustness.pdf.

    Try:
        dipc-gym compare --out runs/compare
        dipc-gym compare --out runs/compare --robustness all
        dipc-gym compare --out runs/rejection --estimator differences,kalman,disturbance --compensator lugre,observed
        dipc-gym compare --out runs/mine --compensator none,llnf,mine.json --controller lqr,policy.json --seeds 20
    """

    out: Path
    """folder for the results: new, empty, or begun by the same command"""
    controller: str = "lqr"
    """names with commas between: lqr, lqr_cart, lqr_sampled, lqr_quiet, dither, or policies: our own (.json), or
    stable-baselines3's (.zip)"""
    compensator: str = "none,feedforward,mlp,llnf,ideal"
    """names with commas between; or saved compensators (.json); an unknown name lists them all"""
    estimator: str = "differences"
    """names with commas between, such as kalman,disturbance,ekf; or saved (.json); an unknown name lists them all"""
    seeds: int = 10
    """number of rigs; friction, encoder noise and initial state differ"""
    seconds: float = 80.0
    """length of a balancing run, s"""
    recording: str | None = None
    """train from this recording (time, motor, cart; poles locked) instead of simulated identification runs"""
    plant: str | None = None
    """JSON file of the plant that all rigs vary about"""
    model: str | None = None
    """MJCF file of another rig, with the actuator motor and the sensors cart, pole1, pole2"""
    exact_state: bool = False
    """balance with the exact state: what encoder noise costs is then left out"""
    robustness: str = ""
    """with commas between: friction, encoder, period, supply, impulse, or all; and score: one number for all"""
    jobs: int | None = None
    """experiments at a time; without it 2, or on Ray as many as the cluster has CPUs"""
    backend: Literal["local", "ray"] = "local"
    """ray: on the cluster that RAY_ADDRESS names, or a Ray that is started on this machine"""
    overwrite: bool = False
    """begin anew instead of going on with what the folder holds"""

    def run(self) -> int:
        """Compare, and print the table."""
        from dipc_gym.experiments import compare
        from dipc_gym.experiments.robustness import AXES
        from dipc_gym.experiments.tables import table

        comparison = compare.Comparison(
            controllers=listed(self.controller),
            compensators=listed(self.compensator),
            estimators=listed(self.estimator),
            seeds=self.seeds,
            seconds=self.seconds,
            plant=self.plant,
            model=self.model,
            recording=self.recording,
            exact_state=self.exact_state,
            robustness=tuple(
                dict.fromkeys(axis for name in listed(self.robustness) for axis in (AXES if name == "all" else (name,)))
            ),
        )
        comparison.check()
        if comparison.recording is not None:
            for note in comparison.trainings()[0].identification().run.notes:
                print(f"note: {note}")
        try:
            summary = compare.run(comparison, self.out, jobs=self.jobs, backend=self.backend, overwrite=self.overwrite)
        except KeyboardInterrupt:
            print(f"\ninterrupted; what was finished is in {self.out / 'summary.json'}", file=sys.stderr)
            return 130
        print(table(summary))
        axes, scored = set(comparison.robustness) - {compare.SCORE}, compare.SCORE in comparison.robustness
        for name in [*(["robustness.txt"] if axes else []), *(["score.txt"] if scored else [])]:
            print("\n" + (self.out / name).read_text(encoding="utf-8").rstrip())
        print(f"\nresults in {self.out}")
        if summary["failures"]:
            print(f"{len(summary['failures'])} failed, as listed; the same command tries them again", file=sys.stderr)
        return 1 if summary["failures"] else 0
