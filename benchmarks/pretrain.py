"""Trains what the compensator `history_adapted` begins with, on simulated identification runs of many rigs.

    python -m benchmarks.pretrain [--rigs 24] [--out compensators/history.json]

Friction is drawn from a quarter to four times the paper's (evenly in the logarithm); what static friction has above
Coulomb friction, Stribeck velocity, bristle, viscous drag and the cart's mass within a half; encoder noise up to a
quarter of a count. Seeds go from 5,000 on, so none of these rigs is one of `compare`.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
from pathlib import Path

import numpy as np

from dipc_gym import runs
from dipc_gym.compensators.history import pretrained
from dipc_gym.plant import Plant

FIRST = 5_000


def rig(seed: int) -> Plant:
    """A rig of the family."""
    rng, home = np.random.default_rng(seed), Plant()
    friction, motor = home.friction, home.motor
    assert friction is not None and motor is not None  # noqa: PT018
    wide = float(np.exp(rng.uniform(np.log(0.25), np.log(4.0))))
    a, b, c, d, e, f = rng.uniform(0.5, 1.5, 6).tolist()
    coulomb = wide * friction.coulomb
    changed = dataclasses.replace(
        friction,
        coulomb=coulomb,
        static=coulomb + a * wide * (friction.static - friction.coulomb),
        stribeck_velocity=b * friction.stribeck_velocity,
        bristle_stiffness=c * friction.bristle_stiffness,
        bristle_damping=d * friction.bristle_damping,
        viscous=e * friction.viscous,
    )
    encoders = dataclasses.replace(home.encoders, noise=rng.uniform(0.0, 0.25))
    masses = dataclasses.replace(home.masses, cart=0.56 * f)
    return dataclasses.replace(home, friction=changed, encoders=encoders, masses=masses)


def main() -> None:
    """Simulate, train and write."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--rigs", type=int, default=24)
    options.add_argument("--out", type=Path, default=Path("compensators/history.json"))
    given = options.parse_args()
    data = [runs.identify(rig(FIRST + i), seed=FIRST + i).samples for i in range(given.rigs)]
    found = pretrained(data)
    given.out.write_text(json.dumps(found, separators=(",", ":")) + "\n", encoding="utf-8")
    print(f"{given.out}: {found['runs']} runs")


if __name__ == "__main__":
    main()
