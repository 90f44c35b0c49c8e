"""Training of policies, with stable-baselines3 or by imitation: progress, checkpoints, and going on after a kill.

Training is cut into stages, each with fresh episodes and a random state of its own, made from the seed and the number
of the stage. A checkpoint stands at the end of each, so a training that was killed and goes on gives the same policy
as one that was not.
"""

from __future__ import annotations

import dataclasses
import math
import time
from pathlib import Path
from typing import Any

import numpy as np

from dipc_gym import compensators, estimators
from dipc_gym.policy import Policy
from dipc_gym.safety.alone import alone
from dipc_gym.safety.files import NO_ROOM
from dipc_gym.safety.places import inside
from dipc_gym.training import checkpoint, folder
from dipc_gym.training.checkpoint import Look
from dipc_gym.training.evaluation import RUNS, WATCHED, evaluate
from dipc_gym.training.recipe import RECIPES, Recipe, TrainingError, recipe_for
from dipc_gym.training.rig import Rig
from dipc_gym.training.task import Training

__all__ = ["RECIPES", "Recipe", "Rig", "Training", "TrainingError", "evaluate", "recipe_for", "run"]

LOOKS = 8  # how often in a training the policy is tried


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
            f"training a policy needs {missing.name}: add its extra: pip install '.[rl]' in a clone"
        ) from missing
    rig = Rig.of(training)
    with alone(out):
        return _run(training, rig, Path(out), resume, overwrite, quiet)


def _run(training: Training, rig: Rig, out: Path, resume: bool, overwrite: bool, quiet: bool) -> Policy:
    from tqdm import tqdm

    from dipc_gym.training.imitation import Imitator
    from dipc_gym.training.learner import Learner

    out = folder.prepare(training, out, resume=resume, overwrite=overwrite)
    learns = Imitator if training.algorithm == "dagger" else Learner
    learner: Any = learns(training, rig, inside(out, "tensorboard"))
    looks: list[Look] = []
    if resume and (out / "checkpoint.pt").exists():
        looks = checkpoint.restore(learner, out / "checkpoint.pt")
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
        checkpoint.write_curve(looks, out)
        if looks[-1].rank > best:
            dataclasses.replace(policy, evaluation=found).save(out / "policy.json")
        learner.log({"eval/standing": found.standing, "eval/reward": found.reward})
        bar.set_postfix_str(f"{found.standing} of {RUNS} stood, reward {found.reward:.3f}")

    try:
        while learner.steps < recipe.steps:
            learner.learn(learner.steps // (recipe.stage * recipe.num_envs), watch)
            if learner.steps >= recipe.steps:
                look()
            checkpoint.write(learner, looks, out)
    except OSError as error:
        why = str(error.strerror).partition(";")[0]
        mend = "make room, then" if error.errno in NO_ROOM else "mend that, then"
        begun = (out / "checkpoint.pt").exists()
        what = f"the last checkpoint is whole: {mend} --resume" if begun else f"no checkpoint yet: {mend} begin anew"
        said = f"{why} after {learner.steps:,} control periods; {what}"
        raise OSError(error.errno, said, error.filename or str(out)) from error
    finally:
        bar.close()
    best = Policy.load(out / "policy.json")
    best = dataclasses.replace(best, evaluation=evaluate(best, rig, runs=RUNS))
    best.save(out / "policy.json")
    return best
