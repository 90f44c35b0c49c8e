"""Memory of arrays that are gone goes back to the system."""

from __future__ import annotations

import statistics
import subprocess
import sys

import pytest

CODE = """
import numpy as np
from dipc_gym.sim2real.allocation import give_back_freed

def held():
    # Counted page by page; statm adds up what each core noted, and may be behind by several arrays.
    with open("/proc/self/smaps_rollup") as file:
        return next(int(line.split()[1]) for line in file if line.startswith("Rss:")) / 1e3

if {asked}:
    give_back_freed()
np.ones(4_000_000)  # 32 MB, mapped apart and gone
filled = [np.ones(12_000) for _ in range(600)]  # in what imports left free: up to 30 MB, by chance
before, kept = held(), []
for _ in range(20):
    large = [np.ones(625_000 + 1000 * k) for k in range(8)]  # 5 MB each, 40 MB together
    kept.append(np.ones(50_000))  # 0.4 MB that lasts lies behind them
    del large
print(held() - before)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="only there something is to be done")
def test_large_arrays_do_not_stay_in_the_heap() -> None:
    held = [
        statistics.median(
            float(
                subprocess.run([sys.executable, "-c", CODE.format(asked=asked)], capture_output=True, check=True).stdout
            )
            for _ in range(count)
        )
        for asked, count in ((True, 7), (False, 1))
    ]
    assert held[0] < 30  # 20 x 0.4 MB last
    assert held[0] <= held[1] + 2
