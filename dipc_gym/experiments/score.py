"""One number for robustness: the share of runs that stand under six kinds of trouble, one at a time.

After the robustness leaderboards of the double pendulum (Wiebe et al., "Open-source dual-purpose acrobot and pendubot
platform", IEEE Robotics & Automation Magazine 31, 2024): their six tests, with ranges scaled to a rig that balances on
a cart. The score is the mean of the six success rates; controller, compensator and estimator know of no change.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from dipc_gym.experiments import together
from dipc_gym.experiments.cells import Balancing, label
from dipc_gym.plant import Plant, PlantError
from dipc_gym.runs import Impulse, MotorFault
from dipc_gym.safety import intact
from dipc_gym.sweep import Outcome

SCHEMA = "dipc-gym/robustness-score/1"
SECONDS = 10.0  # of a run, as theirs
VALUES = 21  # of a range that is gone through
PUSHES = 50  # runs with random pushes

TESTS = {
    "model": "ten numbers of the rig, one at a time, 0.75 to 1.25 times; dry friction 0 to 2 times",
    "velocity noise": "noise of the encoders, up to 0.5 rad/s in a bare difference of a pole's angle",
    "force noise": "noise on the motor's voltage in every period, up to a third of the supply",
    "motor response": "0.1 to 2 of a change of voltage arrive in a 2 ms step, or its like in a control period",
    "delay": "0 to 40 ms from command to motor",
    "pushes": "three pushes on the cart in every run, up to 1 N s each",
}


@dataclass(frozen=True)
class Trouble:
    """One run's trouble.

    Attributes:
        test: one of `TESTS`.
        what: what is changed, for the file of results.
        plant: the changed rig.
        fault: of the motor.
        pushes: on the cart.
    """

    test: str
    what: str
    plant: Plant
    fault: MotorFault | None = None
    pushes: tuple[Impulse, ...] = ()


def troubles(plant: Plant, masses: Mapping[str, float], *, values: int = VALUES, pushes: int = PUSHES) -> list[Trouble]:
    """All runs of the six tests.

    Ranges: of the model's numbers theirs, a quarter either way, friction and damping about as much as they add. Noise
    of velocity reaches their 0.5 rad/s as it arises here, from the encoders. Force noise reaches the same third of the
    motor's limit. Response and delay are times, and taken as they are: the rigs fall over about equally fast. A push of
    1 N s changes the cart's speed by 0.8 m/s, which a rail of 0.9 m just allows.

    Args:
        plant: the rig as it was trained on, with motor and friction known.
        masses: of cart and poles, kg, as the model has them.
        values: on every grid.
        pushes: number of runs with pushes.

    Raises:
        PlantError: the rig does not say what would have to change.
    """
    if plant.motor is None or plant.friction is None:
        raise PlantError("the score changes motor and friction, and the rig does not say which they are")
    found = [Trouble("model", *change) for change in _model_changes(plant, masses, values)]
    period, encoders = plant.control_period, plant.encoders
    for sigma in np.linspace(0.0, 0.5, values).tolist():
        counts = float(np.hypot(encoders.noise, sigma * period / np.sqrt(2) / encoders.pole))
        noisy = dataclasses.replace(plant, encoders=dataclasses.replace(encoders, noise=counts))
        found.append(Trouble("velocity noise", f"{sigma:.3g} rad/s", noisy))
    for volts in np.linspace(0.0, plant.supply / 3, values).tolist():
        found.append(Trouble("force noise", f"{volts:.3g} V", plant, MotorFault(noise=volts)))
    for response in np.linspace(0.1, 2.0, values).tolist():
        fault = MotorFault(response=in_period(response, period))
        found.append(Trouble("motor response", f"{response:.3g}", plant, fault))
    for delay in np.linspace(0.0, 0.04, values).tolist():
        late = dataclasses.replace(plant, delay=plant.delay + delay)
        found.append(Trouble("delay", f"{1000 * delay:.3g} ms", late))
    for i in range(pushes):
        rng = np.random.default_rng([i, 7])
        times, sizes = 1.0 + 2.5 * np.arange(3) + rng.uniform(0, 1.5, 3), rng.uniform(-1.0, 1.0, 3)
        blows = tuple(Impulse(size, time) for size, time in zip(sizes.tolist(), times.tolist(), strict=True))
        found.append(Trouble("pushes", f"set {i}", plant, pushes=blows))
    return found


def in_period(response: float, period: float, step: float = 0.002) -> float:
    """Share of a change that arrives in a period, if `response` of it arrives in every step.

    Beyond 1 the motor overshoots by turns, and steps do not add up to a period: it is then taken as it is.

    Example:
        >>> round(in_period(0.1, 0.005), 3), in_period(1.5, 0.005)
        (0.232, 1.5)
    """
    return response if response >= 1 else 1 - (1 - response) ** (period / step)


def _model_changes(plant: Plant, masses: Mapping[str, float], values: int) -> Iterable[tuple[str, Plant]]:
    grid, wide = np.linspace(0.75, 1.25, values).tolist(), np.linspace(0.0, 2.0, values).tolist()
    motor, friction = plant.motor, plant.friction
    assert motor is not None and friction is not None  # noqa: PT018  the caller has looked
    for name, mass in masses.items():
        for share in grid:
            changed = dataclasses.replace(plant.masses, **{name: share * mass})
            yield f"masses.{name} {share:.3g}", dataclasses.replace(plant, masses=changed)
    for name in ("resistance", "constant", "pulley_radius"):
        for share in grid:
            changed_motor = dataclasses.replace(motor, **{name: share * getattr(motor, name)})
            yield f"motor.{name} {share:.3g}", dataclasses.replace(plant, motor=changed_motor)
    for name in ("viscous", "stribeck_velocity", "bristle_stiffness"):
        for share in grid:
            changed_friction = dataclasses.replace(friction, **{name: share * getattr(friction, name)})
            yield f"friction.{name} {share:.3g}", dataclasses.replace(plant, friction=changed_friction)
    for share in wide:
        levels = {"coulomb": share * friction.coulomb, "static": share * friction.static}
        yield (
            f"friction level {share:.3g}",
            dataclasses.replace(plant, friction=dataclasses.replace(friction, **levels)),
        )


@dataclass(frozen=True, kw_only=True)
class Scoring:
    """One pair on one rig under all of a test's troubles.

    Attributes:
        balancing: the pair, and the rig that it was trained on.
        test: one of `TESTS`.
        masses: of the model, kg.
        values: on every grid.
        pushes: number of runs with pushes.
    """

    balancing: Balancing
    test: str
    masses: dict[str, float]
    values: int = VALUES
    pushes: int = PUSHES

    @property
    def name(self) -> str:
        """Of its file."""
        return f"{self.balancing.name}-score-{self.test.replace(' ', '_')}"

    def run(self) -> list[dict[str, Any]]:
        """Balance for ten seconds under every trouble; those without pushes at once, where the batch takes the rig."""
        found = troubles(self.balancing.plant, self.masses, values=self.values, pushes=self.pushes)
        mine = [trouble for trouble in found if trouble.test == self.test]
        batch = [t for t in mine if not t.pushes and together.fits(t.plant, self.balancing.plant)]
        if not self._batched:
            batch = []
        lasted = dict(zip(map(id, batch), self._held(batch), strict=True))
        rows = []
        for trouble in mine:
            if id(trouble) in lasted:
                held = lasted[id(trouble)]
                survived = held >= SECONDS
            else:
                course, _ = self.balancing.course(trouble.plant, trouble.pushes, trouble.fault, SECONDS)
                held, survived = len(course.time) * self.balancing.plant.control_period, not course.fell
            rows.append({"what": trouble.what, "survived": survived, "seconds": held})
        return rows

    def _held(self, batch: Sequence[Trouble]) -> list[float]:
        return together.held(self.balancing, [(t.plant, t.fault) for t in batch], SECONDS) if batch else []

    @property
    def _batched(self) -> bool:
        """Whether the rig is one for the batch: a model of one's own may need the single environment."""
        return self.balancing.model is None

    def check(self, result: Any) -> None:
        """Refuse what are no such runs."""
        intact.fit(result, [{"what": str, "survived": bool, "seconds": float}])
        if not result:
            raise ValueError("holds no run")


def plan(balancings: Sequence[Balancing], masses: Mapping[str, float]) -> list[Scoring]:
    """The cells: every balancing under every test."""
    return [Scoring(balancing=b, test=test, masses=dict(masses)) for b in balancings for test in TESTS]


def summarise(outcomes: Iterable[Outcome[Any]], pairs: Sequence[tuple[str, str]]) -> dict[str, Any]:
    """Success rates of each pair, over all rigs, and their mean, the score; pairs in the order of the score.

    Args:
        outcomes: those that were finished; others than of `Scoring` are passed over.
        pairs: controllers and compensators.

    Returns:
        What `score.json` holds.
    """
    done = [o for o in outcomes if isinstance(o.cell, Scoring)]
    rows: list[dict[str, Any]] = []
    for pair in pairs:
        mine = [o for o in done if (o.cell.balancing.brain, label(o.cell.balancing.compensator)) == pair]
        rates: dict[str, float] = {}
        for test in TESTS:
            runs = [run for o in mine if o.cell.test == test for run in o.result]
            if runs:
                rates[test] = sum(run["survived"] for run in runs) / len(runs)
        if len(rates) == len(TESTS):
            rigs = len({o.cell.balancing.seed for o in mine})
            score = float(np.mean([*rates.values()]))
            rows.append({"controller": pair[0], "compensator": pair[1], "rigs": rigs, "score": score, "rates": rates})
    rows.sort(key=lambda row: row["score"], reverse=True)
    return {"schema": SCHEMA, "rows": rows, "tests": TESTS, "seconds": SECONDS}


def table(summary: Mapping[str, Any]) -> str:
    """Score and success rates as text."""
    lines: list[tuple[str, ...]] = [("controller", "compensator", "rigs", "score", *TESTS)]
    for row in summary["rows"]:
        rates = (f"{row['rates'][test]:.2f}" for test in TESTS)
        lines.append((row["controller"], row["compensator"], str(row["rigs"]), f"{row['score']:.3f}", *rates))
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    text = ["  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip() for line in lines]
    text.insert(1, "-" * max(map(len, text)))
    text += [f"{name}: {what}" for name, what in summary["tests"].items()]
    return "\n".join([*text, f"share of runs of {summary['seconds']:g} s that stand; score: mean of the six"])
