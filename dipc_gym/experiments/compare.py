"""The paper's experiment, over many rigs: identify friction, train compensators, balance, and compare.

A seed stands for a rig of the same build: its friction, its encoder noise and its initial state are drawn from
`Spread`. Each rig is identified, its compensators are trained on that run, and every controller then balances it with
every compensator.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any

import gymnasium
import numpy as np

from dipc_gym import ENV_ID, compensators, controllers, estimators, recording, sweep
from dipc_gym.experiments import cells, robustness, score
from dipc_gym.experiments.cells import (
    OWN,
    Balancing,
    CompensatorTraining,
    FrictionLearning,
    label,
    with_estimator,
)
from dipc_gym.experiments.tables import summarise, table
from dipc_gym.identification import Sweep
from dipc_gym.plant import Friction, Plant
from dipc_gym.policy import Policy
from dipc_gym.randomise import PlantFamily
from dipc_gym.runs import Course
from dipc_gym.safety.alone import alone
from dipc_gym.safety.files import remove_partial, write_json, write_whole
from dipc_gym.safety.naming import suggestion
from dipc_gym.safety.places import inside
from dipc_gym.sweep import Backend, Cell, Outcome

BODIES = ("cart", "pole1", "pole2")  # whose masses the score changes
SCORE = "score"  # what asks for one number, among the axes of robustness
FOLDERS = ("cells", "compensators", "recordings", "figures")
FIGURES = ("fig07_identification", "fig08_mlp", "fig09_lolimot", "fig10_llnf", "fig12_balance", "robustness")
FILES = (
    *(
        "summary.json",
        "table.txt",
        "rig.gif",
        "rig.mp4",
        "robustness.json",
        "robustness.txt",
        "score.json",
        "score.txt",
    ),
    "recordings/identification-00.csv",
    *(f"figures/{name}{kind}" for name in FIGURES for kind in (".png", ".pdf", "-narrow.pdf")),
)

Trained = Mapping[tuple[int, str], dict[str, Any]]
"""Compensators as dictionaries, by the seed of the rig and the name that they were asked for by."""


@dataclass(frozen=True, kw_only=True)
class Spread:
    """How rigs of one build differ from each other.

    Attributes:
        friction: Coulomb force, what static friction has above it, and Stribeck velocity are each scaled by a factor
            drawn uniformly within this share of 1.
        noise: the standard deviation of encoder noise is drawn uniformly between 0 and this, counts; a quarter of a
            count is what the phase error of an incremental encoder comes to.

    The initial state is the environment's: uniform within 0.02 m and 0.02 rad of upright.
    """

    friction: float = 0.2
    noise: float = 0.25

    def draw(self, plant: Plant, seed: int) -> Plant:
        """One rig of the build that `plant` describes."""
        a, b, c, noise = np.random.default_rng([seed, 1]).uniform(-1.0, 1.0, 4).tolist()
        encoders = dataclasses.replace(plant.encoders, noise=plant.encoders.noise + self.noise * (1 + noise) / 2)
        plant = dataclasses.replace(plant, encoders=encoders)
        if plant.friction is None:
            return plant
        coulomb = plant.friction.coulomb * (1 + self.friction * a)
        above = (plant.friction.static - plant.friction.coulomb) * (1 + self.friction * b)
        stribeck = plant.friction.stribeck_velocity * (1 + self.friction * c)
        friction: Friction = dataclasses.replace(
            plant.friction, coulomb=coulomb, static=coulomb + above, stribeck_velocity=stribeck
        )
        return dataclasses.replace(plant, friction=friction)


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """What is compared.

    Attributes:
        controllers: `lqr` or paths of saved policies.
        compensators: registered names, or paths of saved compensators.
        estimators: registered names, or paths of saved estimators; `differences` is the environment's own observation.
        seeds: number of rigs.
        seconds: length of a balancing run, s.
        plant: file of the rig's plant; None is the default rig.
        model: file of an MJCF model; None is the package's.
        recording: file of an identification run to train all compensators from; None simulates one on every rig.
        exact_state: balance with the exact state instead of encoder readings; training still sees encoders.
        robustness: axes along which rigs are changed after training, names of `robustness.AXES`; and `score`.
        sweep: the simulated identification run.
        spread: how rigs differ.
    """

    controllers: tuple[str, ...] = ("lqr",)
    compensators: tuple[str, ...] = ("none", "feedforward", "mlp", "llnf", "ideal")
    estimators: tuple[str, ...] = (OWN,)
    seeds: int = 10
    seconds: float = 80.0
    plant: str | None = None
    model: str | None = None
    recording: str | None = None
    exact_state: bool = False
    robustness: tuple[str, ...] = ()
    sweep: Sweep = field(default_factory=Sweep)
    spread: Spread = field(default_factory=Spread)

    def check(self) -> None:
        """Refuse what cannot be run, before anything is.

        Raises:
            ValueError: an unknown controller or compensator, a count or length that is not positive, or a file that
                cannot be used.
        """
        parts = {"controllers": self.controllers, "compensators": self.compensators, "estimators": self.estimators}
        if self.seeds < 1:
            raise ValueError(f"--seeds is {self.seeds}; it must be 1 or more")
        if not self.seconds > 0:
            raise ValueError(f"--seconds is {self.seconds:g}; it must be more than 0")
        if math.isinf(self.seconds):
            raise ValueError("--seconds is inf; it must be a finite number")
        if self.exact_state and any(name != OWN for name in self.estimators):
            raise ValueError(
                "--exact-state shows the simulation's state, and an estimator reads encoders: leave out one of them"
            )
        if empty := [kind.removesuffix("s") for kind, names in parts.items() if not names]:
            raise ValueError(f"--{empty[0]} names none; give one or more, with commas between")
        for kind, names in parts.items():
            labels = [label(name) for name in names]
            if twice := sorted({name for name in labels if labels.count(name) > 1}):
                raise ValueError(f"two {kind} are called {twice[0]!r}; rename one's file or folder")
        for name in self.compensators:
            if name.endswith(".json"):
                compensators.load(name)
            elif name not in compensators.names():
                raise ValueError(
                    f"there is no compensator {name!r}; there are {', '.join(compensators.names())} and paths of "
                    f"saved ones (.json){suggestion(name, compensators.names())}"
                )
        for name in self.estimators:
            if not name.endswith(".json"):
                estimators.kind(name)
        for name in self.compensators:
            if not any(self._feeds(one, name) for one in self.estimators):
                raise ValueError(
                    f"{name} feeds forward the friction that an estimator observes, and none of "
                    f"{', '.join(self.estimators)} does; add --estimator disturbance"
                )
        for name in self.controllers:
            if not self._partners(name):
                raise ValueError(
                    f"{name} commands voltage and goes with the compensator 'none' alone; add it to the compensators"
                )
        if drawn := [name for name, _ in PlantFamily.of(self.plant).spreads]:
            raise ValueError(
                f"{self.plant}: {', '.join(drawn)} would be drawn anew; a comparison draws its rigs itself, about a "
                "plant of plain numbers"
            )
        period = self.base_plant().control_period
        if self.seconds < period:
            raise ValueError(f"--seconds is {self.seconds:g}; a run takes at least one control period, {period:g} s")
        robustness.check((name for name in self.robustness if name != SCORE), self.base_plant())
        if SCORE in self.robustness:
            self._check_score()
        if self.recording is not None:
            self.trainings()[0].identification()

    def _check_score(self) -> None:
        """Refuse a rig that cannot be changed in all that the score changes.

        Raises:
            ValueError: it has no such bodies, or does not say what would have to change.
        """
        env: Any = gymnasium.make(ENV_ID, plant=self.plant, model=self.model).unwrapped
        for trouble in score.troubles(env.plant, self.masses()):
            trouble.plant.to_mjcf(env.source.text)

    def pairs(self) -> list[tuple[str, str]]:
        """Controllers and compensators as tables call them, in the order of the table."""
        return [
            (with_estimator(a, e), label(b))
            for a in self.controllers
            for e in self.estimators
            for b in self._partners(a)
            if self._feeds(e, b)
        ]

    def _feeds(self, estimator: str, compensator: str) -> bool:
        """Whether a compensator gets what it needs: `observed` an estimator that observes friction."""
        own = compensators.load(compensator) if compensator.endswith(".json") else compensators.kind(compensator)
        if not own.observed_friction:
            return True
        seen = estimators.load(estimator) if estimator.endswith(".json") else estimators.kind(estimator)
        return seen.observes_friction

    def _partners(self, controller: str) -> tuple[str, ...]:
        """The compensators that a controller is tried with: all; for a policy that commands voltage, `none`."""
        brain = controllers.balancing(controller)
        if isinstance(brain, Policy) and brain.commands == "voltage":
            return tuple(name for name in self.compensators if name == "none")
        return self.compensators

    def base_plant(self) -> Plant:
        """The build that all rigs are of."""
        env: Any = gymnasium.make(ENV_ID, plant=self.plant, model=self.model).unwrapped
        return env.plant

    def masses(self) -> dict[str, float]:
        """Of cart and poles as the model has them, kg.

        Raises:
            ValueError: bodies have other names.
        """
        env: Any = gymnasium.make(ENV_ID, plant=self.plant, model=self.model).unwrapped
        bodies = {env.model.body(i).name: float(env.model.body(i).mass[0]) for i in range(env.model.nbody)}
        if missing := [name for name in BODIES if name not in bodies]:
            raise ValueError(
                f"{self.model}: the score changes the masses of bodies called {', '.join(BODIES)}, and there is no "
                f"{missing[0]!r}; name the bodies so"
            )
        return {name: bodies[name] for name in BODIES}

    def rig(self, seed: int) -> Plant:
        """The rig of a seed."""
        return self.spread.draw(self.base_plant(), seed)

    def trainings(self) -> list[CompensatorTraining]:
        """Every compensator on every rig, or on the one recording."""
        rigs = {s: self.rig(s) for s in range(self.seeds)} if self.recording is None else {0: self.base_plant()}
        return [
            CompensatorTraining(
                compensator=name,
                plant=plant,
                model=self.model,
                recording=self.recording,
                sweep=self.sweep,
                seed=seed,
                files=cells.fingerprints(name, self.model, self.recording),
            )
            for seed, plant in rigs.items()
            for name in self.compensators
        ]

    def learnings(self) -> list[FrictionLearning]:
        """What estimators learn, on every rig or on the one recording; nothing if none of them learns."""
        if all(name == OWN or name.endswith(".json") for name in self.estimators):
            return []
        rigs = {s: self.rig(s) for s in range(self.seeds)} if self.recording is None else {0: self.base_plant()}
        files = cells.fingerprints(self.model, self.recording)
        return [
            FrictionLearning(
                plant=plant, model=self.model, recording=self.recording, sweep=self.sweep, seed=seed, files=files
            )
            for seed, plant in rigs.items()
        ]

    def balancings(
        self, trained: Trained, learned: Mapping[int, dict[str, Any]] = MappingProxyType({})
    ) -> list[Balancing]:
        """Every pair on every rig, as far as compensators are trained and estimators have learned."""
        rigs = {seed: self.rig(seed) for seed in range(self.seeds)}
        return [
            Balancing(
                controller=controller,
                compensator=name,
                trained=trained[source, name],
                plant=plant,
                model=self.model,
                seed=seed,
                seconds=self.seconds,
                exact_state=self.exact_state,
                files=cells.fingerprints(controller, estimator, self.model),
                estimator=estimator,
                estimating=_estimating(estimator, learned.get(source)),
            )
            for seed, plant in rigs.items()
            for source in [seed if self.recording is None else 0]
            for controller in self.controllers
            for estimator in self.estimators
            for name in self._partners(controller)
            if self._feeds(estimator, name)
            and (source, name) in trained
            and (estimator == OWN or estimator.endswith(".json") or source in learned)
        ]


def run(
    comparison: Comparison,
    out: str | Path,
    *,
    jobs: int | None = None,
    backend: Backend = "local",
    overwrite: bool = False,
) -> dict[str, Any]:
    """Run a comparison and leave its results in a folder.

    Every finished part is on disk at once, and the same call goes on from there. After Ctrl-C the summary holds what
    was finished, marked as incomplete. What failed is listed in the summary, and leaves the rest alone.

    Args:
        comparison: what to compare.
        out: the folder, new, empty, or of this very comparison.
        jobs: experiments at a time; see `sweep.run`.
        backend: where they run; see `sweep.run`.
        overwrite: begin anew instead of going on with what the folder holds.

    Returns:
        What `summary.json` holds.

    Raises:
        ValueError: see `Comparison.check` and `sweep.run`.
        FileExistsError: the folder holds something else.
        BusyError: another run is at work there.
        KeyboardInterrupt: after the summary of what is finished was written.
    """
    sweep.check(jobs, backend)
    comparison.check()
    with alone(out):
        return _run(comparison, prepare_folder(out, overwrite=overwrite), jobs, backend)


def _run(comparison: Comparison, out: Path, jobs: int | None, backend: Backend) -> dict[str, Any]:
    folder = out / "cells"
    for place in (out, out / "compensators", out / "recordings", out / "figures"):
        remove_partial(place)
    found: dict[str, Outcome[Any]] = {}
    ready = partial(_register, compensators.registered_elsewhere())

    def do(experiments: Sequence[Cell], doing: str) -> dict[str, Any]:
        """Results by the name of the cell."""
        for outcome in sweep.run(experiments, folder, jobs=jobs, backend=backend, label=doing, ready=ready):
            found[outcome.cell.name] = outcome
        return {e.name: found[e.name].result for e in experiments if found[e.name].failure is None}

    trainings, learnings = comparison.trainings(), comparison.learnings()
    before: list[Outcome[Any]] = [*sweep.finished(trainings, folder), *sweep.finished(learnings, folder)]
    sweep.finished(comparison.balancings(_trained(before), _learned(before)), folder)  # of this comparison?
    balancings: list[Balancing] = []
    notes = _notes(comparison)
    complete = False
    try:
        do(trainings, "identify and train")
        if learnings:
            do(learnings, "learn friction")
        balancings = comparison.balancings(_trained(found.values()), _learned(found.values()))
        _save_trainings(trainings, found, out)
        do(balancings, "balance")
        notes += _draw(comparison, trainings, balancings, found, out)
        if SCORE in comparison.robustness:
            do(score.plan(balancings, comparison.masses()), "score")
            scored = score.summarise((o for o in found.values() if o.failure is None), comparison.pairs())
            write_json(out / "score.json", scored)
            write_whole(out / "score.txt", (score.table(scored) + "\n").encode())
        axes = [name for name in comparison.robustness if name != SCORE]
        if axes:
            plan = robustness.plan(balancings, axes)
            do(plan, "robustness")
            held = robustness.summarise(plan, [o for o in found.values() if o.failure is None], comparison.pairs())
            write_json(out / "robustness.json", held)
            write_whole(out / "robustness.txt", (robustness.table(held) + "\n").encode())
            robustness.draw(held, out / "figures")
        complete = True
    finally:
        done = [found[b.name].result for b in balancings if b.name in found and found[b.name].failure is None]
        failures = {name: outcome.failure for name, outcome in found.items() if outcome.failure is not None}
        settings = dataclasses.asdict(comparison)
        summary = summarise(settings, comparison.pairs(), done, notes, complete, failures)
        write_json(out / "summary.json", summary)
        write_whole(out / "table.txt", (table(summary) + "\n").encode())
    return summary


def prepare_folder(out: str | Path, *, overwrite: bool) -> Path:
    """Make the output folder, or clear an earlier comparison's results from it.

    Raises:
        FileExistsError: it is a file, or holds something else than a comparison.
    """
    out = Path(out)
    for name in FOLDERS:
        inside(out, name)
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        if not (out / "cells").is_dir():
            raise FileExistsError(f"{out} exists, and is neither empty nor a comparison's; choose another folder")
        if overwrite:
            _clear(out)
    for name in FOLDERS:
        inside(out, name).mkdir(parents=True, exist_ok=True)
    return out


# ------------------------------------------------------------------------------------------------ parts


def _clear(out: Path) -> None:
    """Delete what an earlier comparison wrote, as the names of its cells tell, and no other file.

    Raises:
        FileExistsError: the folder is no comparison's.
    """
    done = sweep.written(out / "cells")
    # One that was killed before its first cell was finished had made all folders, and left that of the cells empty.
    if not done and (any((out / "cells").iterdir()) or not all((out / name).is_dir() for name in FOLDERS)):
        raise FileExistsError(f"{out} holds no earlier comparison to overwrite; choose another folder")
    for name in (path.stem for path in done):
        (out / "recordings" / f"{name}.csv").unlink(missing_ok=True)
        if name.startswith("train-"):
            (out / "compensators" / f"{name.removeprefix('train-')}.json").unlink(missing_ok=True)
    for path in (*done, *(out / name for name in FILES)):
        path.unlink(missing_ok=True)


def _trained(outcomes: Iterable[Outcome[Any]]) -> Trained:
    done = [o for o in outcomes if isinstance(o.cell, CompensatorTraining) and o.failure is None]
    return {(o.cell.seed, o.cell.compensator): o.result for o in done}


def _learned(outcomes: Iterable[Outcome[Any]]) -> dict[int, dict[str, Any]]:
    return {o.cell.seed: o.result for o in outcomes if isinstance(o.cell, FrictionLearning) and o.failure is None}


def _estimating(estimator: str, learned: dict[str, Any] | None) -> dict[str, Any] | None:
    """An estimator as a dictionary; None for the environment's own observation."""
    if estimator.endswith(".json"):
        return estimators.load(estimator).to_dict()
    return None if estimator == OWN or learned is None else {**learned, "kind": estimator}


def _register(kinds: Mapping[str, type[compensators.Compensator]]) -> None:
    """Make compensators known that another process has registered."""
    for name, cls in kinds.items():
        compensators.register(name, cls)


def _notes(comparison: Comparison) -> list[str]:
    """What the reader of the table should know of the policies in it."""
    notes = [
        f"{label(name)} commands voltage, so it stands in the table with 'none' only"
        for name in comparison.controllers
        if len(comparison._partners(name)) < len(comparison.compensators)
    ]
    if comparison.base_plant().friction is None:
        notes.append("the model says its dry friction in a way that a plant does not know: it is the same on all rigs")
    blind = [e for e in comparison.estimators if not all(comparison._feeds(e, c) for c in comparison.compensators)]
    if blind:
        notes.append(f"what feeds forward observed friction stands in the table without {', '.join(map(label, blind))}")
    return notes


def _save_trainings(trainings: Sequence[CompensatorTraining], found: Mapping[str, Outcome[Any]], out: Path) -> None:
    for training in trainings:
        if found[training.name].failure is None:
            trained = compensators.load(found[training.name].result)
            compensators.save(trained, out / "compensators" / f"{label(training.compensator)}-{training.seed:02d}.json")


def _draw(
    comparison: Comparison,
    trainings: Sequence[CompensatorTraining],
    balancings: Sequence[Balancing],
    found: Mapping[str, Outcome[Any]],
    out: Path,
) -> list[str]:
    """Figures and recordings of the first rig, whose runs are made again for this; what could not be drawn, and why."""
    from dipc_gym.experiments import figures

    identified = trainings[0].identification()
    recording.write(identified.run, out / "recordings" / "identification-00.csv", overwrite=True)
    courses: dict[tuple[str, str], Course] = {}
    for balancing in balancings:
        if balancing.seed == 0 and found[balancing.name].failure is None:
            course, _ = balancing.course()
            recording.write(
                course.recording(balancing.name), out / "recordings" / f"{balancing.name}.csv", overwrite=True
            )
            courses[balancing.brain, label(balancing.compensator)] = course
    trained = {label(name): made for (seed, name), made in _trained(found.values()).items() if seed == 0}
    return figures.draw_all(identified, trained, courses, out, model=comparison.model)
