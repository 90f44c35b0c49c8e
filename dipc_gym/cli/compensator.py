"""`dipc-gym compensator`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from dipc_gym.cli.options import ending, free


@dataclass(frozen=True)
class FromModel:
    """Make the compensator that a model of the rig implies, without a recording.

    Friction is looked up in steady motion, whatever it consists of, and the motor on the blocked cart: elements of
    MJCF, entries of <custom>, laws of free shape. Both are turned round into a compensator of the kind curve. Made for
    the improved.xml of a diagnosis.

    Try:
        dipc-gym compensator diagnosis/improved.xml --out mine.json
        dipc-gym compensator improved.xml --plant rig.json --out mine.json
        dipc-gym export mine.json --to c --out rig.h
    """

    model: tyro.conf.Positional[Path]
    """MJCF file of the rig: a cart, two poles and a motor"""
    out: Path
    """file for the compensator"""
    plant: str | None = None
    """JSON file of the plant: encoders and control period"""
    seed: int = 0
    """of the simulated encoder's noise"""
    overwrite: bool = False
    """replace the file if it exists"""

    def run(self) -> int:
        """Make and save it."""
        from dipc_gym import compensators
        from dipc_gym.training import inverse

        free(self.out, self.overwrite)
        ending(self.out, ".json")
        made, law = inverse.compensator(self.model, self.plant, seed=self.seed)
        compensators.save(made, self.out)
        slow, fast = abs(law.friction[len(law.friction) // 2]), abs(law.friction[-1])
        print(f"{self.out}: {made.name}, {made.parameters} parameters")
        print(f"friction {slow:.3g} N at {law.slowest:.2g} m/s, {fast:.3g} N at {law.velocity[-1]:.2g} m/s")
        for note in law.notes():
            print(f"note: {note}")
        if made.figures is not None:
            print(f"mean square error on a simulated run of the model: {made.figures.test_mse:.4g} V^2")
        return 0
