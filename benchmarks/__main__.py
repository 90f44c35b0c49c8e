"""`python -m benchmarks` runs all benchmarks and prints their tables."""

import runpy
import sys

for name in ("environment", "vector", "lolimot", "sysid"):
    print(f"== {name} ==", flush=True)
    sys.argv = [f"benchmarks/{name}.py"]
    runpy.run_module(f"benchmarks.{name}", run_name="__main__")
    print()
