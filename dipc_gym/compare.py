"""The paper's experiment, over many rigs: identify friction, train compensators, balance, and compare.

A seed stands for a rig of the same build: its friction, its encoder noise and its starting state are drawn from
`Spread`. Each rig is identified, its compensators are trained on that run, and every controller then balances it with
every compensator.
"""

from __future__ import annotations

import dataclasses
import json
import shutil
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from dipc_gym import ENV_ID, compensators, controllers, lqr, runs
from dipc_gym.compensators import OutOfRangeWarning
from dipc_gym.identification import Sweep
from dipc_gym.plant import Friction, Plant
from dipc_gym.runs import Course, Identification, identify
from dipc_gym.sim2real import recording
from dipc_gym.sim2real.recording import Recording
from dipc_gym.summary import summarise, table

Array = NDArray[np.float64]

SETTLED = 20.0  # s; the paper reads deviations off its Fig. 12 after that
FOLDERS = ("cells", "compensators", "recordings", "figures")
FILES = ("summary.json", "table.txt", "rig.gif")


@dataclass(frozen=True, kw_only=True)
class Spread:
    """How rigs of one build differ from each other.

    Attributes:
        friction: Coulomb force, what static friction has above it, and Stribeck velocity are each scaled by a factor
            drawn uniformly within this share of 1.
        noise: the standard deviation of encoder noise is drawn uniformly between 0 and this, counts; a quarter of a
            count is what the phase error of an incremental encoder comes to.

    The starting state is the environment's: uniform within 0.02 m and 0.02 rad of upright.
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
        seeds: number of rigs.
        seconds: length of a balancing run, s.
        plant: file of the rig's plant; None is the default rig.
        model: file of an MJCF model; None is the package's.
        recording: file of an identification run to train all compensators from; None simulates one on every rig.
        exact_state: balance with the exact state instead of encoder readings; training still sees encoders.
        sweep: the simulated identification run.
        spread: how rigs differ.
    """

    controllers: tuple[str, ...] = ("lqr",)
    compensators: tuple[str, ...] = ("none", "feedforward", "mlp", "llnf", "ideal")
    seeds: int = 10
    seconds: float = 80.0
    plant: str | None = None
    model: str | None = None
    recording: str | None = None
    exact_state: bool = False
    sweep: Sweep = field(default_factory=Sweep)
    spread: Spread = field(default_factory=Spread)

    def check(self) -> None:
        """Refuse what cannot be run, before anything is.

        Raises:
            ValueError: an unknown controller or compensator, a count or length that is not positive, or a file that
                cannot be used.
        """
        if self.seeds < 1 or not self.seconds > 0 or not self.controllers or not self.compensators:
            raise ValueError("a comparison needs at least one controller, compensator and seed, and a positive length")
        for name in self.controllers:
            controllers.load(name)
        for name in self.compensators:
            if name.endswith(".json"):
                compensators.load(name)
            elif name not in compensators.names():
                raise ValueError(
                    f"there is no compensator {name!r}; there are {', '.join(compensators.names())} and paths of "
                    "saved ones (.json)"
                )
        self.base_plant()
        if self.recording is not None:
            self.identification(0)

    def pairs(self) -> list[tuple[str, str]]:
        """Controllers and compensators as tables call them, in the order of the table."""
        return [(controllers.load(a).name, _label(b)) for a in self.controllers for b in self.compensators]

    def base_plant(self) -> Plant:
        """The build that all rigs are of."""
        env: Any = gymnasium.make(ENV_ID, plant=self.plant, model=self.model).unwrapped
        return env.plant

    def rig(self, seed: int) -> Plant:
        """The rig of a seed."""
        return self.spread.draw(self.base_plant(), seed)

    def identification(self, seed: int) -> Identification:
        """The identification run of a seed's rig, or the one that was recorded."""
        plant = self.rig(seed) if self.recording is None else self.base_plant()
        return identify(plant, model=self.model, from_recording=self.recording, sweep=self.sweep, seed=seed)


@dataclass(frozen=True)
class Fitted:
    """What one identification run gave: the run, and compensators as dictionaries by the name they were asked for."""

    seed: int
    run: Recording
    trained: dict[str, dict[str, Any]]


@dataclass(frozen=True)
class Done:
    """A balancing run: what `cells/*.json` holds of it, and its course where that is kept."""

    cell: dict[str, Any]
    course: Course | None


def fit(comparison: Comparison, seed: int) -> Fitted:
    """Identify one rig and train its compensators."""
    identified = comparison.identification(seed)
    trained = {name: identified.fit(name, seed=seed).to_dict() for name in comparison.compensators}
    return Fitted(seed, identified.run, trained)


def balance(
    comparison: Comparison, seed: int, controller: str, name: str, trained: Mapping[str, Any], keep: bool
) -> Done:
    """Balance one rig with one controller and one compensator.

    Args:
        comparison: length and rigs.
        seed: the rig.
        controller: name of the controller.
        name: name of the compensator.
        trained: the compensator as a dictionary.
        keep: return the course too.
    """
    brain, compensator, plant = controllers.load(controller), compensators.load(dict(trained)), comparison.rig(seed)
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always", OutOfRangeWarning)
        course = runs.balance(
            brain,
            compensator,
            seconds=comparison.seconds,
            seed=seed,
            plant=plant,
            model=comparison.model,
            exact_state=comparison.exact_state,
        )
    cell: dict[str, Any] = {
        "controller": brain.name,
        "compensator": _label(name),
        "seed": seed,
        "survived": not course.fell,
        "seconds": len(course.time) * plant.control_period,
        "cost": _cost(course, lqr.RECOVERED_Q),
        "cost_printed_q": _cost(course, lqr.PRINTED_Q),
        "force_rms": float(np.sqrt(np.mean(course.force**2))),
        "voltage_rms": float(np.sqrt(np.mean(course.voltage**2))),
        "clipped_share": course.clipped / len(course.time),
        "test_mse": None if compensator.figures is None else compensator.figures.test_mse,
        "parameters": compensator.parameters,
        "notes": [str(w.message) for w in said if issubclass(w.category, OutOfRangeWarning)],
    }
    late = np.abs(course.state[course.time >= min(SETTLED, comparison.seconds / 4)])
    for key, column, scale in (("cart_m", 0, 1.0), ("pole1_deg", 1, 180 / np.pi), ("pole2_deg", 2, 180 / np.pi)):
        cell[key] = float(late[:, column].max()) * scale if len(late) else None
    return Done(cell, course if keep else None)


def run(comparison: Comparison, out: str | Path, *, jobs: int = 2, overwrite: bool = False) -> dict[str, Any]:
    """Run a comparison and leave its results in a folder.

    Every finished part is on disk at once; after Ctrl-C the summary holds what was finished, marked as incomplete.

    Args:
        comparison: what to compare.
        out: the folder, new or empty.
        jobs: processes.
        overwrite: replace the results that an earlier comparison left in the folder.

    Returns:
        What `summary.json` holds.

    Raises:
        ValueError: see `Comparison.check`.
        FileExistsError: the folder is not empty and `overwrite` is not set.
        KeyboardInterrupt: after the summary of what is finished was written.
    """
    from dipc_gym import figures

    comparison.check()
    out = prepare_folder(out, overwrite=overwrite)
    cells: list[dict[str, Any]] = []
    fits: dict[int, Fitted] = {}
    courses: dict[tuple[str, str], Course] = {}
    notes: list[str] = []
    complete = False
    try:
        for fitted in _parallel(_fits(comparison), jobs, "identify and train"):
            fits[fitted.seed] = fitted
            _save_fit(fitted, out)
        for done in _parallel(_balances(comparison, fits), jobs, "balance"):
            cells.append(done.cell)
            _save_cell(done, out)
            if done.course is not None:
                courses[done.cell["controller"], done.cell["compensator"]] = done.course
        notes += figures.draw_all(comparison, fits[0], courses, out)
        complete = True
    finally:
        summary = summarise(dataclasses.asdict(comparison), comparison.pairs(), cells, notes, complete)
        write_json(out / "summary.json", summary)
        (out / "table.txt").write_text(table(summary) + "\n", encoding="utf-8")
    return summary


def prepare_folder(out: str | Path, *, overwrite: bool) -> Path:
    """Make the output folder, or clear an earlier comparison's results from it.

    Raises:
        FileExistsError: it is not empty and `overwrite` is not set, or it is a file.
    """
    out = Path(out)
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        if not out.is_dir() or not overwrite:
            raise FileExistsError(f"{out} exists and is not empty; choose another folder or say --overwrite")
        for name in FOLDERS:
            shutil.rmtree(out / name, ignore_errors=True)
        for name in FILES:
            (out / name).unlink(missing_ok=True)
    for name in FOLDERS:
        (out / name).mkdir(parents=True, exist_ok=True)
    return out


def write_json(path: Path, value: Any) -> None:
    """Write a JSON file that appears whole or not at all."""
    partial = path.with_name(path.name + ".partial")
    partial.write_text(json.dumps(value, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    partial.replace(path)


# ------------------------------------------------------------------------------------------------ parts


def _fits(comparison: Comparison) -> list[Any]:
    from joblib import delayed

    seeds = range(comparison.seeds) if comparison.recording is None else range(1)
    return [delayed(fit)(comparison, seed) for seed in seeds]


def _balances(comparison: Comparison, fits: Mapping[int, Fitted]) -> list[Any]:
    from joblib import delayed

    return [
        delayed(balance)(comparison, seed, controller, name, fits.get(seed, fits[0]).trained[name], seed == 0)
        for seed in range(comparison.seeds)
        for controller in comparison.controllers
        for name in comparison.compensators
    ]


def _parallel(tasks: Sequence[Any], jobs: int, label: str) -> Iterator[Any]:
    """Results as they are finished, with a progress bar."""
    from joblib import Parallel
    from tqdm import tqdm

    results: Iterable[Any] = Parallel(n_jobs=jobs, return_as="generator_unordered")(tasks)
    yield from tqdm(results, total=len(tasks), desc=label, unit="run")


def _save_fit(fitted: Fitted, out: Path) -> None:
    for name, trained in fitted.trained.items():
        compensators.save(compensators.load(trained), out / "compensators" / f"{_label(name)}-{fitted.seed:02d}.json")
    if fitted.seed == 0:
        recording.write(fitted.run, out / "recordings" / "identification-00.csv")


def _save_cell(done: Done, out: Path) -> None:
    name = f"{done.cell['controller']}-{done.cell['compensator']}-{done.cell['seed']:02d}"
    write_json(out / "cells" / f"{name}.json", done.cell)
    if done.course is not None:
        recording.write(done.course.recording(name), out / "recordings" / f"{name}.csv")


def _cost(course: Course, Q: Array) -> float:
    return float(np.einsum("ni,ij,nj->", course.state, Q, course.state) + lqr.R * course.force @ course.force)


def _label(name: str) -> str:
    """What a compensator is called in tables and file names."""
    return Path(name).stem if name.endswith(".json") else name
