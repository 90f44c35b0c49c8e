"""The experiments that a comparison is made of: train one compensator on one rig, balance one rig with one pair."""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dipc_gym import compensators, controllers, estimators, runs
from dipc_gym.compensators import FallbackWarning, OutOfRangeWarning
from dipc_gym.controllers import lqr, normalisation
from dipc_gym.estimators import EstimateWarning
from dipc_gym.identification import Sweep
from dipc_gym.plant import Plant
from dipc_gym.policy import Policy
from dipc_gym.provenance import digest
from dipc_gym.runs import Course, Identification, Impulse, MotorFault, identify
from dipc_gym.safety import intact

Array = NDArray[np.float64]

FIGURES = {
    **dict.fromkeys(("seconds", "force_rms", "voltage_rms", "clipped_share"), float),
    **dict.fromkeys(("cart_m", "pole1_deg", "pole2_deg"), (float, None)),
    "survived": bool,
}
"""Shape of what `figures` gives."""
RUN = {
    **FIGURES,
    **dict.fromkeys(("controller", "compensator"), str),
    **dict.fromkeys(("cost", "cost_printed_q"), float),
    "trained_with": (str, None),
    "test_mse": (float, None),
    "seed": int,
    "parameters": int,
    "notes": [str],
}
"""Shape of what `Balancing` gives."""
OWN = "differences"  # the environment's own observation, which needs no estimator
NOTED = (OutOfRangeWarning, FallbackWarning, EstimateWarning)  # what the table tells of a run
SETTLED = 20.0  # s; the paper reads deviations off its Fig. 12 after that


@dataclass(frozen=True, kw_only=True)
class Learning:
    """What is learned from the identification run of one rig.

    Attributes:
        plant: the rig.
        model: its MJCF file; None is the package's.
        recording: file of the identification run; None simulates it.
        sweep: the simulated run.
        seed: of the encoders' noise and of the training.
        files: what `fingerprints` says of the files that the above names.
    """

    plant: Plant
    model: str | None
    recording: str | None
    sweep: Sweep
    seed: int
    files: dict[str, str]

    def identification(self) -> Identification:
        """The run that it is learned from."""
        return identify(self.plant, model=self.model, from_recording=self.recording, sweep=self.sweep, seed=self.seed)


@dataclass(frozen=True, kw_only=True)
class CompensatorTraining(Learning):
    """Identify a rig and train one compensator on it.

    Attributes:
        compensator: registered name, or path of a saved one.
    """

    compensator: str

    @property
    def name(self) -> str:
        """Of its file."""
        return f"train-{label(self.compensator)}-{self.seed:02d}"

    def run(self) -> dict[str, Any]:
        """Train; the result is the compensator's dictionary."""
        return self.identification().fit(self.compensator, seed=self.seed).to_dict()

    def check(self, result: Any) -> None:
        """Refuse what is no compensator."""
        intact.fit(result, {})
        compensators.load(result)


@dataclass(frozen=True, kw_only=True)
class FrictionLearning(Learning):
    """Identify a rig and learn the friction that all its estimators take."""

    @property
    def name(self) -> str:
        """Of its file."""
        return f"friction-{self.seed:02d}"

    def run(self) -> dict[str, Any]:
        """Learn; the result is the dictionary of the simplest estimator, whose numbers suit all the others."""
        return self.identification().fit_estimator("differences", seed=self.seed).to_dict()

    def check(self, result: Any) -> None:
        """Refuse what is no estimator."""
        intact.fit(result, {})  # a text would be taken for a path
        estimators.load(result)


@dataclass(frozen=True, kw_only=True)
class Balancing:
    """Balance a rig with one controller through one compensator.

    Attributes:
        controller: `lqr`, or path of a policy.
        compensator: registered name, or path of a saved one.
        trained: the compensator itself, as a dictionary.
        plant: the rig.
        model: its MJCF file; None is the package's.
        seed: of initial state and noise.
        seconds: length of the run, s.
        exact_state: balance with the exact state instead of encoder readings.
        files: what `fingerprints` says of the files that the above names.
        estimator: registered name, or path of a saved one.
        estimating: the estimator itself, as a dictionary; None is the environment's own observation.
    """

    controller: str
    compensator: str
    trained: dict[str, Any]
    plant: Plant
    model: str | None
    seed: int
    seconds: float
    exact_state: bool
    files: dict[str, str]
    estimator: str = OWN
    estimating: dict[str, Any] | None = None

    @property
    def name(self) -> str:
        """Of its file."""
        return f"{self.brain}-{label(self.compensator)}-{self.seed:02d}"

    @property
    def brain(self) -> str:
        """What tables call controller and estimator together."""
        return with_estimator(self.controller, self.estimator)

    def course(
        self,
        plant: Plant | None = None,
        impulse: Impulse | Sequence[Impulse] | None = None,
        fault: MotorFault | None = None,
        seconds: float | None = None,
    ) -> tuple[Course, list[str]]:
        """The run, and what compensator and estimator warned of.

        Args:
            plant: another rig than the one that the compensator was trained on.
            impulse: a blow that the cart takes, or several.
            fault: what the motor does to the voltages.
            seconds: length of the run, if another.
        """
        plant = self.plant if plant is None else plant
        estimator = None if self.estimating is None else estimators.load(self.estimating)
        compensator = compensators.load(self.trained)
        # Of all changes of a rig, its control period is the one that its owner sets, and tells what has to know it.
        if getattr(compensator, "period", plant.control_period) != plant.control_period:
            compensator = dataclasses.replace(compensator, period=plant.control_period)  # type: ignore[call-arg]
        if estimator is not None and estimator.rig.period != plant.control_period:
            rig = dataclasses.replace(estimator.rig, period=plant.control_period)
            estimator = dataclasses.replace(estimator, rig=rig)
        with warnings.catch_warnings(record=True) as said:
            for kind in NOTED:
                warnings.simplefilter("always", kind)
            course = runs.balance(
                controllers.load(self.controller),
                compensator,
                seconds=self.seconds if seconds is None else seconds,
                seed=self.seed,
                plant=plant,
                model=self.model,
                exact_state=self.exact_state,
                impulse=impulse,
                estimator=estimator,
                fault=fault,
            )
        return course, [str(w.message) for w in said if issubclass(w.category, NOTED)]

    def run(self) -> dict[str, Any]:
        """Balance; the result is what tables and figures show of the run."""
        course, notes = self.course()
        compensator = compensators.load(self.trained)
        return {
            "controller": self.brain,
            "compensator": label(self.compensator),
            "trained_with": self.trained_with(),
            "seed": self.seed,
            **figures(course, self.plant, self.seconds),
            "cost": _cost(course, lqr.RECOVERED_Q),
            "cost_printed_q": _cost(course, lqr.PRINTED_Q),
            "test_mse": None if compensator.figures is None else compensator.figures.test_mse,
            "parameters": compensator.parameters,
            "notes": notes,
        }

    def check(self, result: Any) -> None:
        """Refuse what is no such run of this pair on this rig."""
        intact.fit(result, RUN)
        check_figures(result)
        if not result["cost"] > 0:
            raise ValueError(f"cost is {result['cost']}; it must be above zero")
        named = (self.brain, label(self.compensator), self.seed)
        if (result["controller"], result["compensator"], result["seed"]) != named:
            raise ValueError(f"is not of {named[0]} and {named[1]} on rig {named[2]}")

    def trained_with(self) -> str | None:
        """The compensator that the policy was trained with, if it is another than this one."""
        brain = controllers.load(self.controller)
        if isinstance(brain, Policy) and brain.compensator != compensators.load(self.trained).name:
            return brain.compensator
        return None


def figures(course: Course, plant: Plant, seconds: float) -> dict[str, Any]:
    """What a run of `seconds` comes to: whether and how long it stood, deviations once settled, means over all."""
    late = np.abs(course.state[course.time >= min(SETTLED, seconds / 4)])
    if not (len(late) or course.fell):  # of a period or two
        late = np.abs(course.state[-1:])
    found: dict[str, Any] = {
        "survived": not course.fell,
        "seconds": len(course.time) * plant.control_period,
        "force_rms": float(np.sqrt(np.mean(course.force**2))),
        "voltage_rms": float(np.sqrt(np.mean(course.voltage**2))),
        "clipped_share": course.clipped / len(course.time),
    }
    for key, column, scale in (("cart_m", 0, 1.0), ("pole1_deg", 1, 180 / np.pi), ("pole2_deg", 2, 180 / np.pi)):
        found[key] = float(late[:, column].max()) * scale if len(late) else None
    return found


def check_figures(run: dict[str, Any]) -> None:
    """Refuse a run that stood to its end and has no deviations.

    Raises:
        ValueError: naming the field.
    """
    for key in ("cart_m", "pole1_deg", "pole2_deg"):
        if run["survived"] and run[key] is None:
            raise ValueError(f"{key} is null for a run that stood; it must be a number")


def fingerprints(*paths: str | None) -> dict[str, str]:
    """SHA-256 of the files among what the command line names, so that a changed file is a changed parameter.

    With a model goes what it includes, with a policy its statistics.
    """
    named = [path for path in paths if path is not None]
    named += [str(normalisation.place(path)) for path in named if path.endswith(".zip")]
    return {path: digest(Path(path)) for path in named if Path(path).is_file()}


def with_estimator(controller: str, estimator: str) -> str:
    """What a controller that sees the rig through an estimator is called; the paper's differences are not named.

    Example:
        >>> with_estimator("lqr", "differences"), with_estimator("lqr", "kalman")
        ('lqr', 'lqr+kalman')
    """
    return label(controller) if estimator == OWN else f"{label(controller)}+{label(estimator)}"


def label(name: str) -> str:
    """What a controller or compensator is called in tables and file names.

    Example:
        >>> label("llnf"), label("saved/mine.json"), label("runs/ppo/policy.json")
        ('llnf', 'mine', 'ppo')
    """
    path = Path(name)
    if path.name == "policy.json" and path.parent.name:
        return path.parent.name  # what training calls every policy; its folder tells them apart
    return path.stem if name.endswith((".json", ".zip")) else name


def _cost(course: Course, Q: Array) -> float:
    return float(np.einsum("ni,ij,nj->", course.state, Q, course.state) + lqr.R * course.force @ course.force)
