"""How an algorithm learns: its recipe, and the recipes that were found."""

from __future__ import annotations

from dataclasses import dataclass

from dipc_gym.rigs import ENGINES, unknown_engine


class TrainingError(ValueError):
    """A training that cannot be started or continued; the message says what to do."""


@dataclass(frozen=True, kw_only=True)
class Recipe:
    """How an algorithm learns; the values were found on seeds from 100 on.

    Attributes:
        steps: control periods of the whole training.
        num_envs: environments side by side.
        stage: control periods of one rig between two checkpoints; 12,000 are 60 s.
        episode: control periods after which an episode is cut off.
        action_repeat: control periods that a command lasts while it learns; the policy then commands anew in each. SAC
            learns from what a single command does to the value; in 5 ms that probably drowns in the error of the value.
        engine: what simulates the rigs that it learns on, `"mujoco"` or `"compiled"`; trials are always MuJoCo's.
        exact_state: learn from the simulation's state instead of encoder readings, on which the policy then acts. A
            command that lasts has nothing to average the steps of an encoder, and the rates worked out from these are
            mostly steps.
        learning_rate: at the start; it falls linearly to a twentieth.
        gamma: discount of a control period.
        reward: factor on the environment's reward, which keeps the value near 1.
        batch_size: size of a minibatch.
        width: of the two hidden layers.
        rollout: PPO: periods of each rig before an update.
        epochs: PPO: passes over a rollout. DAgger: passes, after each round, over all that is remembered.
        gae_lambda: PPO: lambda of the advantage estimate.
        log_std_init: PPO: logarithm of the first standard deviation of the commands, in shares of the limit.
        buffer_size: SAC: commands that are remembered, with what came of them. DAgger: states, with what the teacher
            would have done in them.
        learning_starts: SAC: random commands at the start.
        gradient_steps: SAC: gradient steps for one command to each rig.
        tau: SAC: share by which the target networks approach the critics at every gradient step.
        ent_coef_init: SAC: first weight of entropy beside the scaled reward.
    """

    steps: int = 768_000
    num_envs: int = 32
    stage: int = 12_000
    episode: int = 12_000
    action_repeat: int = 1
    engine: str = "mujoco"
    exact_state: bool = False
    learning_rate: float = 5e-4
    gamma: float = 0.995
    reward: float = 0.02
    batch_size: int = 1_000
    width: int = 64
    rollout: int = 250
    epochs: int = 10
    gae_lambda: float = 0.98
    log_std_init: float = -1.0
    buffer_size: int = 300_000
    learning_starts: int = 5_000
    gradient_steps: int = 1
    tau: float = 0.01
    ent_coef_init: float = 0.01

    def __post_init__(self) -> None:
        for name in (
            "steps",
            "num_envs",
            "stage",
            "episode",
            "action_repeat",
            "batch_size",
            "width",
            "rollout",
            "epochs",
            "buffer_size",
            "gradient_steps",
        ):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int) or value < 1:
                raise TrainingError(f"{name} is {value!r}; it must be a whole number above zero")
        if self.engine not in list(ENGINES):
            raise TrainingError(unknown_engine(self.engine))


RECIPES: dict[str, Recipe] = {
    "ppo": Recipe(),
    "ppo swing-up": Recipe(
        steps=36_000_000,
        num_envs=64,
        stage=40_000,
        episode=1_600,
        action_repeat=4,
        engine="compiled",
        exact_state=True,
        gamma=0.998,
        reward=0.1,
        batch_size=2_048,
        rollout=128,
        epochs=8,
        gae_lambda=0.95,
        log_std_init=-1.0,
    ),
    "sac": Recipe(
        steps=192_000,
        num_envs=16,
        stage=8_000,
        episode=8_000,
        action_repeat=8,
        exact_state=True,
        learning_rate=1e-3,
        gamma=0.9975,
        reward=0.05,
        batch_size=256,
        learning_starts=2_000,
        gradient_steps=16,
    ),
    "dagger": Recipe(
        steps=2_457_600,
        num_envs=128,
        stage=800,
        episode=800,
        engine="compiled",
        learning_rate=2e-3,
        batch_size=2_048,
        epochs=2,
        buffer_size=1_000_000,
    ),
}


def recipe_for(algorithm: str, task: str = "balance") -> Recipe:
    """The recipe of an algorithm for a task; the algorithm's own where there is none.

    Example:
        >>> recipe_for("ppo", "swing-up").engine
        'compiled'
    """
    return RECIPES.get(f"{algorithm} {task}", RECIPES.get(algorithm, Recipe()))
