"""The benchmarks start, and the one of the environment knows every compensator that there is."""

import subprocess
import sys
from pathlib import Path

import pytest

from dipc_gym import compensators

ROOT = Path(__file__).parent.parent
# envpool_rate runs where EnvPool is installed, in an environment of its own: `vector --envpool` starts it.
NAMES = sorted(path.stem for path in (ROOT / "benchmarks").glob("[!_]*.py") if path.stem != "envpool_rate")


def run(name, *options):
    return subprocess.run(
        [sys.executable, "-m", f"benchmarks.{name}", *options], cwd=ROOT, capture_output=True, text=True, check=False
    )


@pytest.mark.parametrize("name", NAMES)
def test_every_benchmark_says_what_it_measures(name):
    done = run(name, "--help")
    assert not done.returncode, done.stderr
    assert done.stdout.startswith("usage: ")


def test_every_compensator_can_be_timed():
    done = run("environment", "--steps", "5", "--repeats", "1")
    assert not done.returncode, done.stderr
    for name in compensators.names():
        assert f"ForceCommand, {name} " in done.stdout


def test_the_engine_s_tables_are_whole():
    done = run("engine", "--repeats", "1")
    assert not done.returncode, done.stderr
    rows = [line for line in done.stdout.splitlines() if line.startswith(("cart ", "six-joint arm "))]
    assert len(rows) % 3 == 0  # simulated on one thread, maybe on more, and compiled
    assert len(rows) >= 6
