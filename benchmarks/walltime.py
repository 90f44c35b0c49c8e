"""Wall time until PPO has a policy that stands for 80 s: our batches of environments against `make_vec_env`.

    python -m benchmarks.walltime [--seeds 3] [--every 48000] [--most 768000]

All learn what `dipc-gym train-policy --compensator none` does, with its recipe and from the same seed: to command the
voltage of 32 rigs. Every so many control periods the policy is tried by ten runs of 80 s on MuJoCo's rigs, and
training ends when all ten stand; the time of these trials is left out, for they are the same for all. The batch gives
what single environments give, to the last bit, so both learn the same and need the same number of control periods:
their ratio is that of the environments, with the same learning added to both. `make_vec_env` steps one environment
after another in one process; the batches have one thread. With `engine="compiled"` the physics are integrated more
finely, so that learning takes another course, and the number of control periods another. On busy cores, read the
processor's time.
"""

import argparse
import time
import warnings
from dataclasses import replace

import numpy as np
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import VecMonitor

import dipc_gym
from dipc_gym.training.evaluation import RUNS, WATCHED, evaluate
from dipc_gym.training.learner import SCALES, Learner, ScaledRigs
from dipc_gym.training.rig import Rig
from dipc_gym.training.train import RECIPES, Training

RECIPE = RECIPES["ppo"]
BATCH, SINGLES, COMPILED = "batch (DIPCFrictionVecEnv)", "single ones (make_vec_env)", "engine 'compiled'"


class Over(Exception):
    """All runs of a trial stood, or there were enough control periods."""


def singles(rig):
    """As many environments as the recipe has, one after another."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # that its Monitor is there twice
        envs = make_vec_env(dipc_gym.ENV_ID, n_envs=RECIPE.num_envs, env_kwargs={"max_episode_steps": RECIPE.episode})
        return VecMonitor(ScaledRigs(envs, SCALES["balance"], rig.limit, RECIPE.reward))


def until_it_stands(way, seed, every, most):
    """Wall time and processor's time of learning, s, control periods, and runs that stood in the last trial."""
    recipe = replace(RECIPE, engine="compiled") if way == COMPILED else RECIPE
    training = Training(compensator="none", seed=seed, recipe=recipe)
    rig = Rig.of(training)
    learner = Learner(training, rig)
    if way == SINGLES:
        learner.model.set_env(singles(rig))
    tried, spent, standing = 0, np.zeros(2), 0

    def clocks():
        return np.array([time.perf_counter(), time.process_time()])

    def look():
        nonlocal tried, spent, standing
        if learner.steps < every * (tried + 1):
            return
        begun = clocks()
        tried, standing = tried + 1, evaluate(learner.policy(), rig, first_seed=WATCHED).standing
        spent += clocks() - begun
        if standing == RUNS or learner.steps >= most:
            raise Over

    began = clocks()
    try:
        while learner.steps < most:
            learner.learn(learner.steps // (recipe.stage * recipe.num_envs), look)
    except Over:
        pass
    wall, processor = clocks() - began - spent
    learner.model.get_env().close()
    return wall, processor, learner.steps, standing


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=3, help="trainings each, with seeds from 0 on")
    parser.add_argument("--every", type=int, default=48_000, help="control periods from one trial to the next")
    parser.add_argument("--most", type=int, default=RECIPE.steps, help="control periods to give up after")
    options = parser.parse_args()
    if min(options.seeds, options.every, options.most) < 1:
        parser.error("--seeds, --every and --most must be above zero")
    print(f"{'':28s}{'seed':>5s}{'wall time / s':>15s}{'processor / s':>15s}{'control periods':>17s}{'stood':>10s}")
    spent = {}
    for seed in range(options.seeds):
        for way in (BATCH, SINGLES, COMPILED):
            wall, processor, steps, standing = until_it_stands(way, seed, options.every, options.most)
            spent.setdefault(way, []).append((wall, processor))
            print(f"{way:28s}{seed:5d}{wall:15.1f}{processor:15.1f}{steps:17,d}{standing:4d} of {RUNS}", flush=True)
    print("times the batch, median over the seeds")
    for way in (SINGLES, COMPILED):
        wall, processor = np.median(np.array(spent[way]) / np.array(spent[BATCH]), axis=0)
        print(f"{way:33s}{wall:15.2f}{processor:15.2f}")


if __name__ == "__main__":
    main()
