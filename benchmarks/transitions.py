"""From any equilibrium to any other: plan, learn from the plan, and try both.

    python -m benchmarks.transitions --out runs/transitions [--rigs 2] [--resets 15] [--tasks "up-down to up-up"]
    python -m benchmarks.transitions --out runs/transitions --seed 1

For each task that is no `hold`: `dipc-gym plan`, `dipc-gym train-policy --task swing-up --algo dagger` from that plan,
then fifteen resets of each on rigs of `compare`, as benchmarks.swing_up does. A plan and a policy that are in the
folder already are taken as they are, so the same command goes on where it stopped.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import warnings
from pathlib import Path

from benchmarks.swing_up import tried
from dipc_gym.postures import TASKS


def made(file: Path, *command: str) -> bool:
    """Whether a file is there, after the command that makes it."""
    if not file.exists():
        done = subprocess.run([sys.executable, "-m", "dipc_gym", *command], capture_output=True, text=True)
        if done.returncode:
            print(f"  {' '.join(command)}: {done.stderr.strip().splitlines()[-1]}", flush=True)
    return file.exists()


def main() -> None:
    """Plan, train, try and print."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--out", type=Path, required=True)
    options.add_argument("--rigs", type=int, default=2)
    options.add_argument("--resets", type=int, default=15)
    options.add_argument("--seed", type=int, default=0, help="of the training; with another one the plan stays")
    options.add_argument("--tasks", nargs="+", choices=list(TASKS), metavar="TASK")
    given = options.parse_args()
    warnings.simplefilter("ignore")
    given.out.mkdir(parents=True, exist_ok=True)
    for name in given.tasks or [name for name, task in TASKS.items() if "hold" not in task.tags]:
        task, short = TASKS[name], name.replace(" ", "-")
        plan, folder = given.out / f"{short}.json", given.out / f"{short}{f'-{given.seed}' if given.seed else ''}"
        print(name, flush=True)
        if not made(plan, "plan", "--out", str(plan), "--start", task.start, "--goal", task.goal, "--resets", "0"):
            continue
        learn = "train-policy", "--out", str(folder), "--task", "swing-up", "--algo", "dagger", "--plan", str(plan)
        learn += "--seed", str(given.seed)
        for what, there in (("plan", True), ("policy", made(folder / "policy.json", *learn))):
            file = plan if what == "plan" else folder / "policy.json"
            for seed in range(given.rigs if there else 0):
                print(f"  {what}, rig {seed}: {tried(str(file), seed, resets=given.resets)}", flush=True)


if __name__ == "__main__":
    main()
