"""Training of policies, with stable-baselines3 or by imitation: progress, checkpoints, and going on after a kill.

Training is cut into stages, each with fresh episodes and a random state of its own, made from the seed and the number
of the stage. A checkpoint stands at the end of each, so a training that was killed and goes on gives the same policy
as one that was not.
"""

from __future__ import annotations

import dataclasses
import io
import json
import math
import shutil
import time
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import gymnasium
import numpy as np
from numpy.typing import NDArray

from dipc_gym import ENV_ID, SWING_UP_ID, compensators, estimators
from dipc_gym.compensators import Compensator, OutOfRangeWarning
from dipc_gym.controllers.tracking import Tracking
from dipc_gym.estimators import Estimator
from dipc_gym.experiments import cells
from dipc_gym.plant import Plant
from dipc_gym.policy import Evaluation, Policy
from dipc_gym.rigs import ENGINES, unknown_engine
from dipc_gym.runs import identify
from dipc_gym.safety import intact
from dipc_gym.safety.alone import alone
from dipc_gym.safety.files import remove_partial, write_whole
from dipc_gym.safety.naming import suggestion
from dipc_gym.safety.places import inside
from dipc_gym.safety.untrusted import Format, first_line, shown

Array = NDArray[np.float64]
Algorithm = Literal["ppo", "sac", "dagger"]
Task = Literal["balance", "swing-up"]

SCHEMA = "dipc-gym/training/1"
WATCHED, REPORTED = 10_000, 20_000  # first seeds of the runs that choose the policy, and of those that judge it
LOOKS = 8  # how often in a training the policy is tried
RUNS, SECONDS = 10, 80.0  # of every trial
HELD, RISE = 60.0, 10.0  # of a swing-up: how long it is to stay up, and how long it may take, s
FILES = ("training.json", "checkpoint.pt", "policy.json", "compensator.json", "estimator.json", "curve.csv")


class TrainingError(ValueError):
    """A training that cannot be started or continued; the message says what to do."""


TRAINING = Format("note on a training", "train-policy", "start anew with --overwrite", 1_000_000, TrainingError)


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


TASKS = {"balance": ENV_ID, "swing-up": SWING_UP_ID}
ALGORITHMS = ("ppo", "sac", "dagger")


def recipe_for(algorithm: str, task: str = "balance") -> Recipe:
    """The recipe of an algorithm for a task; the algorithm's own where there is none.

    Example:
        >>> recipe_for("ppo", "swing-up").engine
        'compiled'
    """
    return RECIPES.get(f"{algorithm} {task}", RECIPES.get(algorithm, Recipe()))


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
        seed: of weights, exploration, starting states and identification.
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
            ValueError: plant, model or compensator cannot be used.
        """
        env: Any = gymnasium.make(ENV_ID, plant=training.plant, model=training.model).unwrapped
        plant: Plant = env.plant
        identified = identify(plant, model=training.model, seed=training.seed)
        compensator = identified.fit(training.compensator, seed=training.seed)
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


def evaluate(
    policy: Policy, rig: Rig, *, runs: int = RUNS, seconds: float = SECONDS, first_seed: int = REPORTED
) -> Evaluation:
    """Let a policy balance a rig, or swing it up, all runs side by side.

    A swing-up has ten seconds to reach its goal and 60 to stay there, whatever `seconds` says. What can no longer do so
    counts as ended, as what falls does.

    Args:
        policy: what commands.
        rig: what is balanced.
        runs: how many, with starting states of their own.
        seconds: length of a run, s.
        first_seed: of the first run, the others counting up.

    Raises:
        ControllerError: the policy was trained with another compensator.
    """
    policy.require(rig.name)
    envs = rig.many(runs, None)
    period = envs.unwrapped.plant.control_period
    swings = rig.plan is not None
    seconds = HELD if swings else seconds
    up = round(seconds / period)
    steps = up + round(RISE * swings / period)
    away = np.zeros(runs, dtype=int)  # until when it was last not at its goal, control periods
    standing, held, returns = np.ones(runs, dtype=bool), np.full(runs, steps), np.zeros(runs)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", OutOfRangeWarning)
        observations, _ = envs.reset(seed=first_seed)
        for k in range(steps):
            observations, rewards, fell, _, infos = envs.step(policy.command(observations)[:, None])
            returns[standing] += rewards[standing]
            held[standing & fell] = k + 1
            if swings:
                away[~infos["at_goal"]] = k + 1
                standing &= steps - away >= up
            standing &= ~fell
            if not standing.any():
                break
    envs.close()
    if swings:
        held = np.where(standing, up, 0)
    times = tuple(seconds if good else h * period for good, h in zip(standing, held.tolist(), strict=True))
    seeds = tuple(range(first_seed, first_seed + runs))
    return Evaluation(seconds, seeds, times, float(np.median(returns / steps)))


# ------------------------------------------------------------------------------------------------ the training


@dataclass(frozen=True)
class Look:
    """How the policy did at one moment of its training.

    Attributes:
        steps: control periods so far.
        seconds: of wall time so far, trials included.
        standing: runs out of ten that stood for 80 s.
        held: median time that runs lasted, s.
        reward: median over the runs of return over the largest possible.
    """

    steps: int
    seconds: float
    standing: int
    held: float
    reward: float

    @property
    def rank(self) -> tuple[int, float]:
        """What the best policy has the most of."""
        return self.standing, self.reward


LOOK = {"steps": int, "seconds": float, "standing": int, "held": float, "reward": float}  # as a checkpoint holds it


def run(
    training: Training, out: str | Path, *, resume: bool = False, overwrite: bool = False, quiet: bool = False
) -> Policy:
    """Train a policy and leave it in a folder.

    The folder gets `policy.json` (the best so far, by ten runs of 80 s at eight moments of the training), `curve.csv`
    (these trials), `compensator.json`, `estimator.json`, `training.json`, `tensorboard/` and `checkpoint.pt`, which is
    replaced at the end of every stage, and whole at any moment.

    Args:
        training: what to train.
        out: the folder, new or empty.
        resume: go on from the folder's checkpoint; the training must be the same. One that was killed before its first
            checkpoint begins anew.
        overwrite: replace what an earlier training left in the folder.
        quiet: show no progress bar.

    Returns:
        The best policy, judged by ten runs that did not choose it.

    Raises:
        TrainingError: the folder's training is another, or its checkpoint is broken; `resume` is set and there is none.
        FileExistsError: the folder is not empty, and neither `resume` nor `overwrite` is set.
        BusyError: another run is at work there.
        OSError: the disk is full; the last checkpoint is whole.
        KeyboardInterrupt: the last checkpoint is whole.
        ImportError: stable-baselines3 or torch is not installed.
    """
    try:
        import dipc_gym.training.learner  # noqa: F401  what it needs may not be installed
    except ImportError as missing:
        raise ImportError(
            f"training a policy needs {missing.name}: pip install -e '.[rl]' in the checkout"
        ) from missing
    rig = Rig.of(training)
    with alone(out):
        return _run(training, rig, Path(out), resume, overwrite, quiet)


def _run(training: Training, rig: Rig, out: Path, resume: bool, overwrite: bool, quiet: bool) -> Policy:
    from tqdm import tqdm

    from dipc_gym.training.imitation import Imitator
    from dipc_gym.training.learner import Learner

    out = _folder(training, out, resume=resume, overwrite=overwrite)
    learns = Imitator if training.algorithm == "dagger" else Learner
    learner: Any = learns(training, rig, inside(out, "tensorboard"))
    looks: list[Look] = []
    if resume and (out / "checkpoint.pt").exists():
        looks = restore(learner, out / "checkpoint.pt")
        if looks:
            Policy.load(out / "policy.json")  # the best so far; better refused now than after hours
    else:
        if rig.compensator is not None:
            compensators.save(rig.compensator, out / "compensator.json")
        if rig.estimator is not None:
            estimators.save(rig.estimator, out / "estimator.json")
    recipe = training.recipe
    began = time.monotonic() - (looks[-1].seconds if looks else 0.0)
    every = math.ceil(recipe.steps / LOOKS)
    bar = tqdm(
        total=recipe.steps,
        initial=learner.steps,
        desc="train",
        unit=" periods",
        unit_scale=True,
        disable=quiet or None,  # None: where nobody looks, as in a log
    )

    def watch() -> None:
        bar.update(learner.steps - bar.n)
        if learner.steps >= every * (len(looks) + 1) and learner.steps < recipe.steps:
            look()

    def look() -> None:
        policy = learner.policy()
        found = evaluate(policy, rig, runs=RUNS, first_seed=WATCHED)
        best = max((past.rank for past in looks), default=(-1, 0.0))
        seconds = round(time.monotonic() - began, 1)
        looks.append(Look(learner.steps, seconds, found.standing, float(np.median(found.held)), found.reward))
        _write_curve(looks, out)
        if looks[-1].rank > best:
            dataclasses.replace(policy, evaluation=found).save(out / "policy.json")
        learner.log({"eval/standing": found.standing, "eval/reward": found.reward})
        bar.set_postfix_str(f"{found.standing} of {RUNS} stood, reward {found.reward:.3f}")

    try:
        while learner.steps < recipe.steps:
            learner.learn(learner.steps // (recipe.stage * recipe.num_envs), watch)
            if learner.steps >= recipe.steps:
                look()
            _checkpoint(learner, looks, out)
    except OSError as error:
        why = str(error.strerror).partition(";")[0]
        said = f"{why} after {learner.steps:,} control periods; the last checkpoint is whole"
        raise OSError(error.errno, f"{said}: make room, then --resume", error.filename or str(out)) from error
    finally:
        bar.close()
    best = Policy.load(out / "policy.json")
    best = dataclasses.replace(best, evaluation=evaluate(best, rig, runs=RUNS))
    best.save(out / "policy.json")
    return best


def _folder(training: Training, out: Path, *, resume: bool, overwrite: bool) -> Path:
    """Make the folder, clear it, or see that it holds this training."""
    note = out / "training.json"
    if out.is_dir():
        remove_partial(out)
    files = cells.fingerprints(*training.named)
    wanted = json.loads(json.dumps({**training.to_dict(), "files": files}))
    if resume and not note.exists():
        raise TrainingError(f"{out}: there is no training to go on with; leave --resume out to begin one")
    if resume:
        for path in (out / name for name in FILES):
            if path.exists() and not path.is_file():  # opening a named pipe would wait for ever
                raise TrainingError(f"{path}: is no file; start anew with --overwrite")
        try:
            there = TRAINING.read(note)
            flat, other = _flat(wanted), _flat(there)
            kept = dict(there.get("files", {}))
        except (ValueError, AttributeError, LookupError, TypeError, RecursionError):
            raise TrainingError(f"{note}: cannot be read; start anew with --overwrite") from None
        for key in flat.keys() | other.keys():
            if flat.get(key) != other.get(key):
                raise TrainingError(
                    f"{note}, {shown(key)}: this training was begun with {shown(other.get(key))}, not "
                    f"{shown(flat.get(key))}; "
                    "resume with the same, or train into another folder"
                )
        for name, digest in files.items():
            if kept.get(name) != digest:
                raise TrainingError(
                    f"{name}: not the file that the training of {note} was begun with; put that back, or train into "
                    "another folder"
                )
        return out
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        if not out.is_dir() or not overwrite:
            raise FileExistsError(
                f"{out} exists and is not empty; choose another folder, or say --resume or --overwrite"
            )
        for name in FILES:
            (out / name).unlink(missing_ok=True)
        shutil.rmtree(out / "tensorboard", ignore_errors=True)
    out.mkdir(parents=True, exist_ok=True)
    write_whole(note, (json.dumps(wanted, indent=2) + "\n").encode())
    return out


def _flat(training: dict[str, Any]) -> dict[str, Any]:
    recipe = {"engine": "mujoco", "episode": training["recipe"]["stage"], **training["recipe"]}  # notes may be older
    training = {"task": "balance", "estimator": None, "plan": "tvlqr", **training}
    return {key: value for key, value in training.items() if key not in ("recipe", "files")} | {
        f"recipe.{key}": value for key, value in recipe.items()
    }


def _checkpoint(learner: Any, looks: list[Look], out: Path) -> None:
    """Write where the training stands; what was there stays until the new one is whole."""
    import torch

    buffer = io.BytesIO()
    rows = [dataclasses.asdict(look) for look in looks]
    torch.save({"schema": SCHEMA, "looks": rows, "learner": learner.state()}, buffer)
    write_whole(out / "checkpoint.pt", buffer.getvalue())


def _write_curve(looks: list[Look], out: Path) -> None:
    rows = [dataclasses.asdict(look) for look in looks]
    lines = [",".join(rows[0]), *(",".join(map(str, row.values())) for row in rows)]
    write_whole(out / "curve.csv", "".join(line + "\n" for line in lines).encode())


def restore(learner: Any, path: Path) -> list[Look]:
    """Put a learner where a checkpoint stands, executing nothing in it.

    Returns:
        The trials so far.

    Raises:
        TrainingError: it is no checkpoint of this training.
    """
    import torch

    try:
        stored = torch.load(path, map_location="cpu", weights_only=True)
        if stored["schema"] != SCHEMA:
            raise TrainingError(f"it is of the form {stored['schema']!r}; this version of dipc-gym writes {SCHEMA!r}")
        intact.fit(stored["looks"], [LOOK])
        learner.restore(stored["learner"])
        return [Look(**row) for row in stored["looks"]]
    except Exception as error:  # whatever a broken or hostile file makes torch raise
        said = f"no checkpoint of this training ({first_line(error)}); start anew with --overwrite"
        raise TrainingError(f"{path}: {said}") from None
