"""Try thousands of damaged files on every reader, and count what became of them.

    python tests/fuzz/campaign.py --count 20000 --seed 1
    python tests/fuzz/campaign.py --kind model --only 123456

A case is made again from its kind and number. The exit code is 1 if anything happened that must not.
"""

from __future__ import annotations

import argparse
import os
import random
import signal
import sys
import tempfile
import time
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from itertools import chain
from multiprocessing import get_context
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

CHUNK = 50


def several(kind: str, first: int, count: int, at_work: Path) -> list[tuple[str, int, str, str, float]]:
    """Kind, number, outcome, fault and seconds of cases in a row; a note in `at_work` says which is tried."""
    from case import run
    from targets import TARGETS

    target = _targets.get(kind) or _targets.setdefault(kind, TARGETS[kind]())
    done, note = [], at_work / str(os.getpid())
    for number in range(first, first + count):
        note.write_text(f"{kind} {number}")
        case = run(target, number, random.Random(number).choice((None, [], {"a": 1e999}, "$\\x", -0.0, 10**30)))
        done.append((kind, number, case.outcome, case.fault, case.seconds))
    note.unlink()
    return done


_targets: dict = {}


def main() -> int:
    """Run the campaign."""
    from targets import TARGETS

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=20_000)
    parser.add_argument("--seed", type=int, default=0, help="number of the first case")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--kind", choices=list(TARGETS))
    parser.add_argument("--only", type=int, help="one case of a kind, by its number")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="fuzz-notes-") as notes:
        if given.only is not None:
            print(*several(given.kind, given.only, 1, Path(notes))[0][2:], sep="\n")
            return 0
        return _tried([given.kind] if given.kind else list(TARGETS), given.count, given.seed, given.jobs, Path(notes))


def _tried(kinds: list[str], count: int, seed: int, jobs: int, notes: Path) -> int:
    each, total, faults, began = -(-count // len(kinds)), 0, list[tuple[str, str]](), time.perf_counter()
    try:
        for kind in kinds:
            done, wrong = _reader(kind, range(seed, seed + each), jobs, notes)
            total, faults = total + done, faults + wrong
    except KeyboardInterrupt:
        print("interrupted; --kind goes on with a reader, --seed with other files")
    print(f"{total} files in {time.perf_counter() - began:.0f} s, {len(faults)} faults: {faults[-20:]}")
    return 1 if faults else 0


def _reader(kind: str, numbers: range, jobs: int, notes: Path) -> tuple[int, list[tuple[str, str]]]:
    """Try one reader, and print what became of its files: how many there were, and the faults.

    Every reader has processes of its own, so that none takes memory from another's limit.
    """
    outcomes, slowest, faults = Counter[str](), 0.0, []
    tasks = [(kind, first, min(CHUNK, numbers.stop - first), notes) for first in numbers[::CHUNK]]
    try:
        with ProcessPoolExecutor(jobs, get_context("spawn"), signal.signal, (signal.SIGINT, signal.SIG_IGN)) as pool:
            for _, number, outcome, fault, seconds in chain.from_iterable(pool.map(several, *zip(*tasks, strict=True))):
                outcomes[outcome] += 1
                slowest = max(slowest, seconds)
                if fault:
                    faults.append((kind, str(number)))
                    print(f"FAULT {kind} {number}: {outcome}\n{fault}", flush=True)
    except BrokenProcessPool:
        faults += [tuple(note.read_text().rsplit(" ", 1)) for note in notes.iterdir()]  # type: ignore[misc]
        print(f"FAULT {kind}: a process died while it tried one of the last of these")
    finally:
        words = ", ".join(f"{name} {count}" for name, count in outcomes.most_common())
        print(f"{kind:20} {outcomes.total():6}  {words}; slowest {slowest:.2f} s", flush=True)
    return outcomes.total(), faults


if __name__ == "__main__":
    sys.exit(main())
