"""What diagnoses of public recordings of real rigs come to: one table, to be printed before and after a change.

    python benchmarks/real.py FOLDER [--rigs emps leg bam dfki uw] [--threads 0]

FOLDER holds a folder for each rig with `nominal.xml` beside its recordings, as `examples/real_recordings.py` writes
them; rigs that it does not hold are left out. Errors are those of predictions of held-out data, in multiples of the
encoder's noise: of the model as given, of its parameters refitted, of what was found, and of `improved.xml` as MuJoCo
simulates it at its own step, in brackets what fine steps come to from the same initial states. Beside the others stand
those of windows that validate, in parentheses: what is far better there than on held-out data follows the data that it
was fitted to. Seconds are those of the processor, all forks together, then those on the clock.
"""

import argparse
import os
import sys
import time
from pathlib import Path

from dipc_gym import mjcf, recording
from dipc_gym.sim2real.diagnosis import diagnose

# Folder, recordings to fit, and recordings to hold out: without any, the last quarter of each is.
RIGS = {
    "emps": ("emps", "emps.csv", ""),
    "leg": ("compass_leg", "outer_chirp.csv", "outer_swing_and_steps.csv"),
    "bam": ("bam_xl330", "[su]*.csv", ""),  # the two others switch the torque off, which no command says
    "dfki": ("dfki", "run_0[0246].csv", "run_08.csv"),
    "uw": ("uw_double", "free_swing.csv", ""),
    "kr300": ("kr300", "run_A.csv", ""),
}


def row(folder, fitted, held_out, threads):
    """A line of the table."""
    model = folder / "nominal.xml"
    compiled = mjcf.compile(model)
    given, tests = (
        [recording.read(path, compiled) for path in sorted(folder.glob(each))] if each else []
        for each in (fitted, held_out)
    )
    cpu, clock = sum(os.times()[:4]), time.perf_counter()  # of forks that have ended as well
    found = diagnose(model, given, tests, threads=threads)
    cpu, clock = sum(os.times()[:4]) - cpu, time.perf_counter() - clock
    test, validation = found.held_out, found.validation
    errors = [
        f"{getattr(test, which):.4g} ({getattr(validation, which):.3g})"
        for which in ("nominal", "recalibrated", "improved")
    ]
    own = f"{found.written.held_out.improved:.4g} [{found.written.fine:.4g}]" if found.written else ""
    effects = ", ".join(f"`{one.effect}@{one.at}`" for one in found.missing)
    return [*errors, own, found.verdict, effects, f"{cpu:.0f}, {clock:.0f}"]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="holds a folder for each rig")
    parser.add_argument("--rigs", nargs="+", choices=RIGS, default=["emps", "leg", "bam", "dfki", "uw"], metavar="RIG")
    parser.add_argument("--threads", type=int, default=0, help="cores to use; 0 for all (default)")
    given = parser.parse_args()
    there = {name: RIGS[name] for name in given.rigs if (given.folder / RIGS[name][0] / "nominal.xml").is_file()}
    if not there:
        sys.exit(f"{given.folder} holds none of {', '.join(RIGS[name][0] for name in given.rigs)} with a nominal.xml")
    print("| rig | as given | refitted | improved | at its own step | verdict | effects | seconds |")
    print("|---" * 8 + "|")
    for name, (folder, *recordings) in there.items():
        print("| " + " | ".join([name, *row(given.folder / folder, *recordings, given.threads)]) + " |", flush=True)


if __name__ == "__main__":
    main()
