"""Where a policy acts: rigs side by side, behind a compensator or not."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import gymnasium
import numpy as np
from numpy.typing import NDArray

from dipc_gym import ENV_ID
from dipc_gym.compensators import Compensator
from dipc_gym.controllers.tracking import Tracking
from dipc_gym.estimators import Estimator
from dipc_gym.plant import Plant
from dipc_gym.policy import Policy
from dipc_gym.runs import identify
from dipc_gym.training.recipe import Recipe, TrainingError
from dipc_gym.training.task import TASKS, Training

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Rig:
    """Where a policy acts: the environment, behind a compensator or not.

    Attributes:
        compensator: what stands in front, and None where the policy commands the voltage.
        name: of the compensator.
        limit: largest command, N or V.
        newtons_per_volt: the motor's gain.
        plant: as the environment takes it.
        model: MJCF file, or None.
        estimator: what sees the rig, and None where the environment itself does.
        plan: the motion to swing up by, and None where it balances.
        linear: A (6, 6) and B (6,) of the rig's linear model about upright.
    """

    compensator: Compensator | None
    name: str
    limit: float
    newtons_per_volt: float
    plant: str | None
    model: str | None
    estimator: Estimator | None
    plan: Tracking | None
    linear: tuple[Array, Array]

    @classmethod
    def of(cls, training: Training) -> Rig:
        """Identify a rig and fit its compensator.

        Raises:
            TrainingError: the compensator needs an estimator, and the recipe learns without.
            ValueError: plant, model or compensator cannot be used.
        """
        env: Any = gymnasium.make(ENV_ID, plant=training.plant, model=training.model).unwrapped
        plant: Plant = env.plant
        identified = identify(plant, model=training.model, seed=training.seed)
        compensator = identified.fit(training.compensator, seed=training.seed)
        if compensator.observed_friction and training.recipe.exact_state:
            raise TrainingError(
                f"the compensator {compensator.name!r} takes friction from an estimator, and {training.algorithm} "
                f"learns {training.task} from the exact state, without one; take another compensator, such as llnf"
            )
        estimator = None
        if training.estimator is not None:
            estimator = identified.fit_estimator(training.estimator, seed=training.seed)
        plan = None
        if training.task == "swing-up":
            plan = Tracking.shipped() if training.plan == "tvlqr" else Tracking.load(training.plan)
            plan.require(plan.start, plan.goal, plant.control_period)
        gain = identified.cart.constants.newtons_per_volt
        direct = compensator.name == "none"
        return cls(
            None if direct else compensator,
            compensator.name,
            min(training.limit / gain, plant.supply) if direct else training.limit,
            gain,
            training.plant,
            training.model,
            estimator,
            plan,
            (np.array(identified.rig.A), np.array(identified.rig.B)),
        )

    @property
    def full_force(self) -> float:
        """What the largest command exerts on the cart, N."""
        return self.limit * (self.newtons_per_volt if self.compensator is None else 1.0)

    def learning(self, recipe: Recipe) -> Any:
        """Those to learn on. Along a plan, every second one begins where the plan does."""
        start: dict[str, Any] = {}
        if self.plan is not None:
            along = self.plan.states
            start = {"start": np.vstack([along, np.tile(along[0], (len(along), 1))])}
        return self.many(recipe.num_envs, recipe.episode, exact_state=recipe.exact_state, engine=recipe.engine, **start)

    def many(
        self,
        count: int,
        steps: int | None,
        *,
        exact_state: bool = False,
        engine: str = "mujoco",
        **task: Any,
    ) -> Any:
        """So many of them, reset as soon as they end.

        Args:
            count: how many.
            steps: of an episode.
            exact_state: as the environment takes it.
            engine: as the environment takes it.
            task: further arguments of its environment.
        """
        from dipc_gym.wrappers import VectorEstimateState, VectorForceCommand

        if self.plan is not None:
            task = {"start": self.plan.start, "goal": self.plan.goal} | task
        envs = gymnasium.make_vec(
            TASKS["balance" if self.plan is None else "swing-up"],
            num_envs=count,
            vectorization_mode="vector_entry_point",
            plant=self.plant,
            model=self.model,
            exact_state=exact_state,
            max_episode_steps=steps,
            autoreset_mode="SameStep",
            engine=engine,
            threads=1,  # the other core is for another training
            **task,
        )
        if self.estimator is not None and not exact_state:
            envs = VectorEstimateState(envs, self.estimator)
        return envs if self.compensator is None else VectorForceCommand(envs, self.compensator)

    def policy(
        self,
        training: Training,
        layers: tuple[tuple[Array, Array], ...],
        scales: Array,
        squash: Literal["clip", "tanh"],
        steps: int,
    ) -> Policy:
        """What a network is here.

        Args:
            training: of it.
            layers: see `Policy`, as are the others.
            scales: of observations.
            squash: what follows the last layer.
            steps: control periods so far.
        """
        return Policy(
            layers=layers,
            commands="voltage" if self.compensator is None else "force",
            limit=self.limit,
            compensator=self.name,
            estimator=None if self.estimator is None else self.estimator.name,
            start=None if self.plan is None else self.plan.start,
            goal=None if self.plan is None else self.plan.goal,
            newtons_per_volt=self.newtons_per_volt,
            scales=scales,
            squash=squash,
            algorithm=training.algorithm,
            seed=training.seed,
            steps=steps,
        )
