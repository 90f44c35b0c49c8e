"""`dipc-gym train` and `dipc-gym train-policy`."""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from dipc_gym.cli.options import free


@dataclass(frozen=True)
class Train:
    """Train a friction compensator and save it as JSON.

    It is trained on a simulated identification run, or on a recording of your rig made with the poles locked.

    Try:
        dipc-gym train --out llnf.json
        dipc-gym train --out mine.json --compensator mlp --recording sweep.csv --plant rig.json
    """

    out: Path
    """file for the compensator"""
    compensator: str = "llnf"
    """none, feedforward, mlp (needs torch), llnf or ideal"""
    recording: str | None = None
    """recording with columns time, motor (V) and cart (m)"""
    plant: str | None = None
    """JSON file of the plant"""
    model: str | None = None
    """MJCF file of the rig"""
    seed: int = 0
    """of training and of the simulated encoders' noise"""
    overwrite: bool = False
    """replace the file if it exists"""

    def run(self) -> int:
        """Train and save."""
        from dipc_gym import compensators
        from dipc_gym.runs import identify

        free(self.out, self.overwrite)
        compensators.registry.kind(self.compensator)  # refuse an unknown name before anything is simulated
        found = identify(self.plant, model=self.model, from_recording=self.recording, seed=self.seed)
        trained = found.fit(self.compensator, seed=self.seed)
        compensators.save(trained, self.out)
        print(f"{self.out}: {self.compensator}, {trained.parameters} numbers")
        if trained.figures is not None:
            fit = trained.figures
            print(f"mean square error: training {fit.train_mse:.4g} V^2, test {fit.test_mse:.4g} V^2")
        return 0


@dataclass(frozen=True)
class TrainPolicy:
    """Train a policy that balances the rig, and try it.

    The rig is identified and its compensator fitted; the policy then learns to command force through it, or, with
    --compensator none, the motor's voltage itself. The folder gets policy.json (small, runs on NumPy, the best of
    eight trials on the way), curve.csv, compensator.json, TensorBoard's files and a checkpoint. Killed, it goes on
    with --resume, to the same policy.

    Try:
        dipc-gym train-policy --out runs/llnf
        dipc-gym train-policy --out runs/direct --compensator none --seed 3
        dipc-gym train-policy --out runs/llnf --resume
        tensorboard --logdir runs
    """

    out: Path
    """folder for the results, new or empty"""
    algo: Literal["ppo", "sac"] = "ppo"
    """proximal policy optimisation, or soft actor-critic, which takes fewer but slower steps"""
    compensator: str = "llnf"
    """none, feedforward, mlp (needs torch), llnf or ideal, identified for this; or a saved compensator (.json)"""
    seed: int = 0
    """of weights, exploration, starting states and identification"""
    steps: int | None = None
    """control periods to train for; without it the algorithm's own number"""
    rigs: int | None = None
    """rigs that are simulated side by side; without it the algorithm's own number"""
    limit: float = 60.0
    """largest force, N; for voltage, what exerts it on the blocked cart"""
    plant: str | None = None
    """JSON file of the plant; numbers may be distributions, drawn anew in every episode"""
    model: str | None = None
    """MJCF file of the rig"""
    resume: bool = False
    """go on from the folder's checkpoint; all other options as they were"""
    overwrite: bool = False
    """replace what an earlier training left in the folder"""

    def run(self) -> int:
        """Train, try, and say how it did."""
        from dipc_gym import train

        changes = {key: value for key, value in (("steps", self.steps), ("rigs", self.rigs)) if value is not None}
        training = train.Training(
            algorithm=self.algo,
            compensator=self.compensator,
            seed=self.seed,
            limit=self.limit,
            plant=self.plant,
            model=self.model,
            recipe=replace(train.RECIPES[self.algo], **changes),
        )
        try:
            policy = train.run(training, self.out, resume=self.resume, overwrite=self.overwrite)
        except KeyboardInterrupt:
            print(f"\ninterrupted; go on from the last checkpoint in {self.out} with --resume", file=sys.stderr)
            return 130
        print(f"{self.out / 'policy.json'}: {policy.summary()}")
        return 0
