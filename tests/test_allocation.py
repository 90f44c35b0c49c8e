"""Memory of arrays that are gone goes back to the system."""

from __future__ import annotations

import subprocess
import sys

import pytest

CODE = """
import resource
import numpy as np
from dipc_gym.sim2real.allocation import give_back_freed

def held():
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * resource.getpagesize() / 1e6

if {asked}:
    give_back_freed()
np.ones(4_000_000)  # 32 MB, mapped apart and gone
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
        float(subprocess.run([sys.executable, "-c", CODE.format(asked=asked)], capture_output=True, check=True).stdout)
        for asked in (True, False)
    ]
    assert held[0] < 30  # 20 x 0.4 MB last
    assert held[0] <= held[1] + 2
