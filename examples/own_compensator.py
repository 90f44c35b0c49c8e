"""Add a compensator of your own: one dataclass, one formula, one fit.

This one knows that friction may differ between the two directions. It is registered beside the others, so
it can be fitted, saved, loaded and compared like them. Run it: python examples/own_compensator.py
"""

from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from dipc_gym import compensators
from dipc_gym.compensators import Compensator, RigConstants, Samples, elementwise


@dataclass(frozen=True)
class TwoWay(Compensator):
    """Coulomb friction with a level for each direction."""

    per_newton: float  # V/N
    forward: float  # V, against friction while moving towards +x
    backward: float  # V, against friction while moving towards -x

    @classmethod
    def fit(cls, samples: Samples, rig: RigConstants, *, seed: int = 0) -> "TwoWay":
        sign = np.tanh(samples.velocity / 0.005)
        columns = np.column_stack([samples.force, (1 + sign) / 2, (sign - 1) / 2])
        train = samples.train
        return cls(*np.linalg.lstsq(columns[train], samples.voltage[train])[0].tolist())

    def volts(self, force, velocity, previous_velocity):
        # Plain operators, and NumPy functions through `elementwise`: it then works for one rig and for many.
        (sign,) = elementwise(np.tanh, [velocity / 0.005])
        return self.per_newton * force + self.forward * (1 + sign) / 2 + self.backward * (sign - 1) / 2


def identification_run(seconds: float = 40.0, period: float = 0.005) -> tuple[Samples, RigConstants]:
    """Drive a 1.26 kg cart with a swept voltage; its friction is 9 N forwards and 6 N backwards."""
    rig = RigConstants(newtons_per_volt=4.0, viscous=40.0, supply_voltage=24.0)
    time = np.arange(0, seconds, period)
    voltage = 20 * np.sin(2 * np.pi * (0.3 + 0.02 * time) * time)
    velocity = np.zeros(len(time) + 1)
    for k, volts in enumerate(voltage):
        v = velocity[k]
        for _ in range(20):
            friction = (7.5 + 1.5 * np.sign(v)) * np.tanh(v / 0.005)
            v += period / 20 * (rig.newtons_per_volt * volts - rig.viscous * v - friction) / 1.26
        velocity[k + 1] = v
    force = 1.26 * np.diff(velocity) / period + rig.viscous * (velocity[1:] + velocity[:-1]) / 2
    train = time.astype(int) % 2 == 0  # alternating one-second blocks
    return Samples(force[1:], velocity[1:-1], velocity[:-2], voltage[1:], train[1:]), rig


def main() -> None:
    compensators.register("two_way", TwoWay)
    samples, rig = identification_run()
    for name in ("none", "feedforward", "two_way", "llnf"):
        compensator = compensators.fit(name, samples, rig)
        print(f"{name:12} test error {compensator.figures.test_mse:7.4f} V^2, {compensator.parameters} numbers")

    two_way = compensators.fit("two_way", samples, rig)
    with TemporaryDirectory() as folder:
        compensators.save(two_way, Path(folder) / "two_way.json")
        assert compensators.load(Path(folder) / "two_way.json") == two_way
    print(f"friction forwards {two_way.forward * rig.newtons_per_volt:.1f} N", end=", ")
    print(f"backwards {two_way.backward * rig.newtons_per_volt:.1f} N")
    print(f"10 N at 0.1 m/s takes {two_way.voltage(force=10.0, velocity=0.1):.2f} V")


if __name__ == "__main__":
    main()
