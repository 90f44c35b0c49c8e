"""What is trained: an algorithm for a task, on a rig and through a compensator."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any, Literal

from dipc_gym import ENV_ID, SWING_UP_ID, compensators, estimators
from dipc_gym.safety.naming import suggestion
from dipc_gym.training.recipe import Recipe, TrainingError

Algorithm = Literal["ppo", "sac", "dagger"]
Task = Literal["balance", "swing-up"]

SCHEMA = "dipc-gym/training/1"
TASKS = {"balance": ENV_ID, "swing-up": SWING_UP_ID}
ALGORITHMS = ("ppo", "sac", "dagger")


@dataclass(frozen=True, kw_only=True)
class Training:
    """What is trained, on which rig.

    Attributes:
        algorithm: `"ppo"`, `"sac"` or, for a swing-up, `"dagger"`, which imitates feedback around a planned motion.
        task: `"balance"`, or `"swing-up"` from where a planned motion starts to where it ends.
        compensator: registered name, identified on a simulated run of the rig, or a saved one (`.json`). With `none`
            the policy commands the voltage itself.
        estimator: through which it sees the rig, chosen as the compensator is; None is the environment's own
            observation. Where the recipe has `exact_state`, it learns without.
        plan: of a swing-up: `tvlqr`, the motion that comes along, from hanging to upright, or a file that `dipc-gym
            plan` wrote. Episodes begin along it.
        seed: of weights, exploration, initial states and identification.
        limit: largest force that the policy may command, N; for voltage, what exerts it on the blocked cart.
        plant: file of the rig's plant; None is the default rig. Numbers may be distributions.
        model: MJCF file of the rig; None is the package's.
        recipe: how; None is the algorithm's own.

    Raises:
        TrainingError: something that cannot be.
    """

    algorithm: Algorithm = "ppo"
    task: Task = "balance"
    compensator: str = "llnf"
    estimator: str | None = None
    plan: str = "tvlqr"
    seed: int = 0
    limit: float = 60.0
    plant: str | None = None
    model: str | None = None
    recipe: Recipe = dataclasses.field(default_factory=Recipe)

    def __post_init__(self) -> None:
        if self.algorithm not in ALGORITHMS:
            near = suggestion(self.algorithm, ALGORITHMS)
            raise TrainingError(f"there is no algorithm {self.algorithm!r}; there are {', '.join(ALGORITHMS)}{near}")
        if self.task not in TASKS:
            near = suggestion(self.task, TASKS)
            raise TrainingError(f"there is no task {self.task!r}; there are {', '.join(TASKS)}{near}")
        if self.algorithm == "dagger" and self.task != "swing-up":
            raise TrainingError("dagger imitates a planned motion, and to balance there is none; say --task swing-up")
        if isinstance(self.seed, bool) or not isinstance(self.seed, int) or self.seed < 0:
            raise TrainingError(f"the seed is {self.seed!r}; it must be a whole number, zero or more")
        if not (math.isfinite(self.limit) and self.limit > 0):
            raise TrainingError(f"the limit is {self.limit}; it must be a number of newtons above zero")
        if not self.compensator.endswith(".json"):
            compensators.registry.kind(self.compensator)
        if self.estimator is not None and not self.estimator.endswith(".json"):
            estimators.kind(self.estimator)

    @property
    def named(self) -> tuple[str | None, ...]:
        """What may be files."""
        return self.compensator, self.estimator, self.plan, self.plant, self.model

    def to_dict(self) -> dict[str, Any]:
        """What `training.json` holds, without the digests of the files that are named."""
        return {"schema": SCHEMA, **dataclasses.asdict(self)}
