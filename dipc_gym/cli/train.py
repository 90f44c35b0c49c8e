"""`dipc-gym train` and `dipc-gym train-policy`."""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import tyro

from dipc_gym.cli.options import columns, ending, free

if TYPE_CHECKING:
    from dipc_gym.training.task import Training


@dataclass(frozen=True)
class Train:
    """Train a friction compensator and save it as JSON.

    It is trained on a simulated identification run, or on a recording of your rig made with the poles locked. Readings
    are smoothed as their noise asks for. What the recording covers of force and velocity is told, and one that cannot
    support a compensator is refused. --model gives mass and linear friction, such as the improved.xml of a diagnosis.

    Try:
        dipc-gym train --out llnf.json
        dipc-gym train --out mine.json --compensator mlp --recording sweep.csv --plant rig.json
        dipc-gym train --out mine.json --recording sweep.csv --model diagnosis/improved.xml
        dipc-gym train --out mine.json --recording sweep.csv --compensator observed --estimator disturbance
        dipc-gym train --out mine.json --recording log.csv --map pos_cart=cart --map u=motor --unit cart=mm
    """

    out: Path
    """file for the compensator"""
    compensator: str = "llnf"
    """llnf, mlp (needs torch), feedforward, lugre, observed or another; an unknown name lists them all"""
    estimator: str | None = None
    """fit this one to the same run, such as disturbance or kalman, and save it beside: mine_disturbance.json"""
    recording: str | None = None
    """recording with columns time, motor (V) and cart (m), or as --map and --unit say"""
    map: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
    """column=name: which column of the file is which name in the model; may be repeated"""
    unit: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
    """name=unit: unit of a column, such as deg, mm, ms or counts as a factor; may be repeated"""
    plant: str | None = None
    """JSON file of the plant; where parameters are distributions, identification takes their centres"""
    model: str | None = None
    """MJCF file of the rig: a cart, two poles and a motor"""
    seed: int = 0
    """of training and of the simulated encoders' noise"""
    overwrite: bool = False
    """replace the file if it exists"""

    def run(self) -> int:
        """Train and save."""
        from dipc_gym import compensators, estimators
        from dipc_gym.runs import identify

        free(self.out, self.overwrite)
        ending(self.out, ".json")
        mapping, units = columns(self.recording, self.map, self.unit)
        compensators.registry.kind(self.compensator)  # refuse an unknown name before anything is simulated
        beside = self.out.with_name(f"{self.out.stem}_{self.estimator}.json")
        if self.estimator is not None:
            estimators.kind(self.estimator)
            free(beside, self.overwrite)
        found = identify(
            self.plant,
            model=self.model,
            from_recording=self.recording,
            mapping=mapping,
            units=units,
            seed=self.seed,
        )
        trained = found.fit(self.compensator, seed=self.seed)
        compensators.save(trained, self.out)
        if self.estimator is not None:
            estimators.save(found.fit_estimator(self.estimator, seed=self.seed), beside)
        for note in found.run.notes:
            print(f"note: {note}")
        if self.recording is not None:
            print(found.excitation.report())
        print(f"{self.out}: {self.compensator}, {trained.parameters} parameters")
        if self.estimator is not None:
            print(f"{beside}: {self.estimator}")
        if trained.figures is not None:
            fit = trained.figures
            print(f"mean square error: training {fit.train_mse:.4g} V^2, test {fit.test_mse:.4g} V^2")
        return 0


@dataclass(frozen=True)
class TrainPolicy:
    """Train a policy that balances the rig, or swings it up, and try it.

    The rig is identified and its compensator fitted; the policy then learns to command force through it, or, with
    --compensator none, the motor's voltage itself. The folder gets policy.json (small, runs on NumPy, the best of
    eight trials on the way), curve.csv, compensator.json, TensorBoard's files and a checkpoint. Killed, it goes on
    with --resume, to the same policy.

    To swing up, it learns along a motion that dipc-gym plan found: --algo dagger imitates the feedback around that
    motion, the others learn from reward.

    With --seeds, so many policies are trained in one sweep, from --seed on, each into a folder of its own, such as
    ppo-llnf-03, without TensorBoard's files. The same command goes on with a sweep that was killed, and tries again
    what failed; a training that was under way then begins anew.

    Try:
        dipc-gym train-policy --out runs/llnf
        dipc-gym train-policy --out runs/direct --compensator none --seed 3
        dipc-gym train-policy --out runs/up --task swing-up --algo dagger
        dipc-gym train-policy --out runs/over --task swing-up --algo dagger --plan over.json
        dipc-gym train-policy --out runs/llnf --resume
        dipc-gym train-policy --out runs/many --seeds 10 --jobs 2
        tensorboard --logdir runs
    """

    out: Path
    """folder for the results, new or empty"""
    task: Literal["balance", "swing-up"] = "balance"
    """hold the poles upright, or take them to where a plan leads, upright by default, and hold them"""
    algo: Literal["ppo", "sac", "dagger"] = "ppo"
    """proximal policy optimisation; soft actor-critic, which takes fewer but slower steps; or imitation of a plan"""
    compensator: str | None = None
    """llnf, none, mlp (needs torch), ideal or another, identified for this; or a saved compensator (.json); without it
    llnf, and observed for dagger"""
    estimator: str | None = None
    """what the policy sees the rig through, such as rigid_body, or a saved estimator (.json); without it the
    environment's own observation, and rigid_body for dagger"""
    plan: str = "tvlqr"
    """of a swing-up: tvlqr, which goes from hanging to upright, or a file that dipc-gym plan wrote"""
    seed: int = 0
    """of weights, exploration, initial states and identification; with --seeds, the first of them"""
    seeds: int | None = None
    """train a sweep of so many seeds; without it, one policy"""
    steps: int | None = None
    """control periods to train for; without it as many as the algorithm's recipe says"""
    num_envs: int | None = None
    """rigs that are simulated side by side; without it as many as the algorithm's recipe says"""
    engine: Literal["mujoco", "compiled"] | None = None
    """what simulates them, mujoco or, by default for swing-up, compiled, machine code; it is tried on MuJoCo anyway"""
    limit: float | None = None
    """largest force, N; for voltage, what exerts it on the blocked cart; without it 60, and 96 for a swing-up"""
    plant: str | None = None
    """JSON file of the plant; parameters may be distributions, drawn anew in every episode"""
    model: str | None = None
    """MJCF file of the rig: a cart, two poles and a motor"""
    resume: bool = False
    """go on from the folder's checkpoint; all other options as they were; a sweep goes on by itself"""
    jobs: int | None = None
    """of a sweep: trainings at a time; without it 2, or on Ray as many as the cluster has CPUs"""
    backend: Literal["local", "ray"] = "local"
    """of a sweep: ray is the cluster that RAY_ADDRESS names, or a Ray that is started on this machine"""
    overwrite: bool = False
    """replace what an earlier training left in the folder"""

    def run(self) -> int:
        """Train, try, and say how it did."""
        from dipc_gym.training import train

        given = {"steps": self.steps, "num_envs": self.num_envs, "engine": self.engine}
        changes: dict[str, Any] = {key: value for key, value in given.items() if value is not None}
        imitates = self.algo == "dagger"
        if self.task == "balance" and self.plan != type(self).plan:
            raise ValueError("a plan is of a swing-up; say --task swing-up too, or leave --plan out")
        training = train.Training(
            algorithm=self.algo,
            task=self.task,
            compensator=self.compensator or ("observed" if imitates else "llnf"),
            estimator=self.estimator or ("rigid_body" if imitates else None),
            plan=self.plan,
            seed=self.seed,
            limit=self.limit if self.limit is not None else 60.0 if self.task == "balance" else 96.0,
            plant=self.plant,
            model=self.model,
            recipe=replace(train.recipe_for(self.algo, self.task), **changes),
        )
        if self.seeds is not None:
            return self._sweep(training, self.seeds)
        if self.jobs is not None or self.backend != "local":
            raise ValueError("--jobs and --backend are for a sweep of several trainings; say --seeds too")
        try:
            policy = train.run(training, self.out, resume=self.resume, overwrite=self.overwrite)
        except KeyboardInterrupt:
            begun = (self.out / "checkpoint.pt").exists()
            mend = f"go on from the last checkpoint in {self.out} with --resume" if begun else "nothing to go on with"
            print(f"\ninterrupted; {mend}", file=sys.stderr)
            return 130
        print(f"{self.out / 'policy.json'}: {policy.summary()}")
        return 0

    def _sweep(self, first: Training, count: int) -> int:
        from dipc_gym.policy import Policy
        from dipc_gym.training import seeds

        if count < 1:
            raise ValueError(f"--seeds {count}: give the number of policies to train, 1 or more")
        wanted = [replace(first, seed=first.seed + i) for i in range(count)]
        try:
            outcomes = seeds.run(wanted, self.out, jobs=self.jobs, backend=self.backend, overwrite=self.overwrite)
        except KeyboardInterrupt:
            print(f"\ninterrupted; the same command goes on with what is finished in {self.out}", file=sys.stderr)
            return 130
        failed = [f"{outcome.cell.name}: {outcome.failure}" for outcome in outcomes if outcome.failure is not None]
        for outcome in outcomes:
            if outcome.failure is None:
                path = self.out / outcome.cell.name / "policy.json"
                print(f"{path}: {Policy.load(path).summary()}")
        if failed:
            print(*failed, f"{len(failed)} failed; the same command tries them again", sep="\n", file=sys.stderr)
        return 1 if failed else 0
