"""`dipc-gym record` and `dipc-gym render`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import tyro

from dipc_gym.cli.options import columns, ending, free

if TYPE_CHECKING:
    from dipc_gym.compensators import Compensator
    from dipc_gym.estimators import Estimator
    from dipc_gym.runs import Course


@dataclass(frozen=True)
class Record:
    """Simulate a run of the rig and write it as a recording.

    A balancing run has the columns time, motor, cart, pole1 and pole2: replay, diagnose or render it. In an
    identification run the poles are locked and have no columns: train from it. To replay it takes a model without them.

    Try:
        dipc-gym record --out balance.csv --compensator llnf --seconds 20
        dipc-gym record --out best.csv --controller lqr_cart --estimator disturbance --compensator observed
        dipc-gym record --out sweep.parquet --experiment identification
    """

    out: Path
    """file to write: .csv, .npz or .parquet"""
    experiment: Literal["balance", "identification"] = "balance"
    """balance the poles, or sweep the voltage with the poles locked"""
    controller: str = "lqr"
    """lqr, lqr_cart, lqr_sampled, lqr_quiet, dither, or a policy: our own (.json), or stable-baselines3's (.zip)"""
    compensator: str | None = None
    """a name, trained for this on a simulated run, or a saved compensator (.json); an unknown name lists them all.
    Without it that which a policy was trained with, else none"""
    estimator: str | None = None
    """what the rig is seen through: a name, fitted for this, or a saved estimator (.json). Without it that which a
    policy was trained with, else the environment's own observation"""
    seconds: float = 80.0
    """length of a balancing run, s"""
    plant: str | None = None
    """JSON file of the plant; where parameters are distributions, identification takes their centres"""
    model: str | None = None
    """MJCF file of the rig: a cart, two poles and a motor"""
    seed: int = 0
    """of initial state and noise"""
    overwrite: bool = False
    """replace the file if it exists"""

    def run(self) -> int:
        """Simulate and write."""
        from dipc_gym import controllers, recording, runs
        from dipc_gym.recording.tables import check_format

        check_format(self.out)
        free(self.out, self.overwrite)
        if self.experiment == "identification":
            _idle(self, ("controller", "compensator", "estimator", "seconds"), "an identification run sweeps for 60 s")
            run = runs.identify(self.plant, model=self.model, seed=self.seed).run
        else:
            brain = controllers.balancing(self.controller)
            compensator, estimator = _parts(brain, self.compensator, self.estimator, self.plant, self.model, self.seed)
            course = runs.balance(
                brain,
                compensator,
                seconds=self.seconds,
                seed=self.seed,
                plant=self.plant,
                model=self.model,
                estimator=estimator,
            )
            run = course.recording(self.out.stem)
            if course.fell:
                print(f"fell after {course.lasted:.2f} s")
        recording.write(run, self.out, overwrite=self.overwrite)
        print(f"{self.out}: {len(run)} samples, {run.duration:.1f} s")
        return 0


@dataclass(frozen=True)
class Render:
    """Draw a run of the rig as a film, or in a window.

    Works without a display too. The run is simulated, or taken from a recording that has all three encoders.

    Try:
        dipc-gym render --out rig.gif --compensator llnf
        dipc-gym render --out run.mp4 --recording balance.csv
        dipc-gym render --out up.gif --controller tvlqr --compensator observed --seconds 5
        dipc-gym render --out run.gif --recording log.csv --map pos_cart=cart --unit pole1=deg
        dipc-gym render
    """

    out: Path | None = None
    """film to write, .gif or .mp4; without it a window opens"""
    recording: str | None = None
    """recording to draw instead of a simulated run"""
    map: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
    """column=name: which column of the recording is which name in the model; may be repeated"""
    unit: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
    """name=unit: unit of a column, such as deg, mm or ms; may be repeated"""
    controller: str = "lqr"
    """lqr, lqr_cart or another, or a policy, our own (.json) or of stable-baselines3 (.zip); tvlqr, or a plan (.json),
    which swings up; an unknown name lists them all"""
    compensator: str | None = None
    """a name, trained for this on a simulated run, or a saved compensator (.json); an unknown name lists them all.
    Without it that which a policy was trained with, else none"""
    estimator: str | None = None
    """what the rig is seen through: a name, fitted for this, or a saved estimator (.json). Without it that which a
    policy was trained with, else the environment's own observation"""
    seconds: float = 10.0
    """length, s"""
    magnify: float = 1.0
    """show deviations from upright so many times as large; the trace of the cart is in true millimetres"""
    plant: str | None = None
    """JSON file of the plant; where parameters are distributions, identification takes their centres"""
    model: str | None = None
    """MJCF file of the rig: a cart, two poles and a motor"""
    seed: int = 0
    """of initial state and noise"""
    overwrite: bool = False
    """replace the file if it exists"""

    def run(self) -> int:
        """Draw."""
        from dipc_gym import runs
        from dipc_gym.experiments import film

        if self.out is not None:
            free(ending(self.out, *film.FORMATS), self.overwrite)
        else:
            _idle(self, ("magnify",), "the window shows the rig as it is")
        mapping, units = columns(self.recording, self.map, self.unit)
        if self.recording is not None:
            idle = ("controller", "compensator", "estimator", "plant", "seed")
            _idle(self, idle, "what a recording holds has run already")
            course = runs.recorded(self.recording, model=self.model, mapping=mapping, units=units)
            caption = Path(self.recording).stem
        else:
            course, behind = self._simulated()
            caption = f"{self.controller}, {behind.name}"
        if course.fell:
            print(f"fell after {course.lasted:.2f} s")
        if self.out is None:
            film.show(course, model=self.model, seconds=self.seconds)
        else:
            film.shoot({caption: course}, self.out, model=self.model, seconds=self.seconds, magnify=self.magnify)
            print(f"{self.out}: {min(self.seconds, course.time[-1]):.1f} s")
        return 0

    def _simulated(self) -> tuple[Course, Compensator]:
        """A run, and what made voltages of forces in it."""
        from dipc_gym import controllers, runs
        from dipc_gym.controllers import Tracking
        from dipc_gym.policy import Policy

        brain = controllers.load(self.controller)
        if not (isinstance(brain, Tracking) or (isinstance(brain, Policy) and brain.swings_up)):
            compensator, estimator = _parts(brain, self.compensator, self.estimator, self.plant, self.model, self.seed)
            course = runs.balance(
                controllers.balancing(self.controller),
                compensator,
                seconds=self.seconds,
                seed=self.seed,
                plant=self.plant,
                model=self.model,
                estimator=estimator,
            )
            return course, compensator
        found = runs.identify(self.plant, model=self.model, seed=self.seed)
        sees = self.estimator or ("rigid_body" if isinstance(brain, Tracking) else brain.estimator)
        behind = _behind(brain, self.compensator, partial(found.fit, seed=self.seed))
        course = runs.swing_up(
            brain,
            behind,
            seconds=self.seconds,
            seed=self.seed,
            start=brain.start or "down-down",
            goal=brain.goal or "up-up",
            plant=self.plant,
            model=self.model,
            estimator=None if sees is None else found.fit_estimator(sees, seed=self.seed),
        )
        return course, behind


def _idle(command: Record | Render, names: tuple[str, ...], why: str) -> None:
    """Refuse options that would do nothing."""
    given = [f"--{name}" for name in names if getattr(command, name) != getattr(type(command), name)]
    if given:
        raise ValueError(f"{why}, whatever {' and '.join(given)} {'say' if len(given) > 1 else 'says'}; leave it out")


def _behind(brain: object, asked: str | None, fit: Callable[[str], Compensator]) -> Compensator:
    """The compensator that is asked for; else that which a policy was trained with, or none. Whoever runs a policy with
    another than its own is told so, as in tables of `compare`.
    """
    from dipc_gym.policy import Policy

    own = brain.compensator if isinstance(brain, Policy) else None
    found = fit(asked if asked is not None else own or "none")
    if own not in (None, found.name):
        print(f"note: the policy was trained with the compensator {own!r}, not with {found.name!r}")
    return found


def _parts(
    brain: object, compensator: str | None, estimator: str | None, plant: str | None, model: str | None, seed: int
) -> tuple[Compensator, Estimator | None]:
    """What makes a controller's force a voltage, and what it sees the rig through; None is the environment's own
    observation. What is learned is learned from one run.
    """
    from dipc_gym import runs
    from dipc_gym.policy import Policy

    policy = brain if isinstance(brain, Policy) else None
    if estimator is None and policy:
        estimator = policy.estimator
    if estimator is None:
        fit = partial(runs.compensator, plant=plant, model=model, seed=seed)
        return _behind(brain, compensator, fit), None
    found = runs.identify(plant, model=model, seed=seed)
    seen_through = found.fit_estimator(estimator, seed=seed)
    if policy:
        policy.require_estimator(seen_through.name)
    return _behind(brain, compensator, partial(found.fit, seed=seed)), seen_through
