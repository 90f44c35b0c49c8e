"""Wall time until PPO reaches a return: our batch of environments against stable-baselines3's `make_vec_env`.

    python -m benchmarks.walltime [--num-envs 32] [--goal 1000] [--seed 0]

Both learn with the settings of `dipc-gym train-policy`, from the same seed, on episodes of 10 s in which the policy
commands the voltage, until the mean return of the last 100 episodes reaches the goal (of at most 2,000). The batch
gives what single environments give, to the last bit, so both learn the same and need the same number of control
periods: the ratio is that of the environments, with the same learning added to both. `make_vec_env` steps one
environment after another in one process; the batch has one thread. With `engine="compiled"` the physics are integrated
more finely, so that learning takes another course, and the number of control periods another. On busy cores, read the
processor's time.
"""

import argparse
import time
import warnings
from collections import deque

import gymnasium
import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import VecMonitor

import dipc_gym
from dipc_gym.sb3 import DIPCFrictionVecEnv
from dipc_gym.training.learner import ScaledRigs
from dipc_gym.training.train import RECIPES

RECIPE = RECIPES["ppo"]
VOLTS = 15.0  # largest command
STEPS = 2_000  # of an episode


def batch(count, engine="mujoco"):
    envs = gymnasium.make_vec(
        dipc_gym.ENV_ID,
        num_envs=count,
        vectorization_mode="vector_entry_point",
        autoreset_mode="SameStep",
        max_episode_steps=STEPS,
        engine=engine,
        threads=1,
    )
    return VecMonitor(ScaledRigs(DIPCFrictionVecEnv(envs), VOLTS, RECIPE.reward))


def singles(count):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # that its Monitor is there twice
        envs = make_vec_env(dipc_gym.ENV_ID, n_envs=count, env_kwargs={"max_episode_steps": STEPS})
        return VecMonitor(ScaledRigs(envs, VOLTS, RECIPE.reward))


class UntilGoal(BaseCallback):
    """Stops the training, and knows how long its environments took."""

    def __init__(self, goal):
        super().__init__()
        self.goal, self.returns = goal, deque(maxlen=100)

    def _on_step(self):
        self.returns += [info["episode"]["r"] / RECIPE.reward for info in self.locals["infos"] if "episode" in info]
        return len(self.returns) < 100 or np.mean(self.returns) < self.goal


def seconds_to_goal(make, options):
    envs = make(options.num_envs)
    model = PPO(
        "MlpPolicy",
        envs,
        n_steps=RECIPE.rollout,
        batch_size=RECIPE.batch_size,
        n_epochs=RECIPE.epochs,
        gae_lambda=RECIPE.gae_lambda,
        gamma=RECIPE.gamma,
        learning_rate=RECIPE.learning_rate,
        policy_kwargs={"net_arch": [RECIPE.width] * 2, "log_std_init": RECIPE.log_std_init},
        seed=options.seed,
        device="cpu",
    )
    until = UntilGoal(options.goal)
    began = time.perf_counter(), time.process_time()
    model.learn(options.most, callback=until)
    wall, processor = time.perf_counter() - began[0], time.process_time() - began[1]
    envs.close()
    return wall, processor, model.num_timesteps, np.mean(until.returns)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--num-envs", type=int, default=RECIPE.num_envs)
    parser.add_argument("--goal", type=float, default=1_000.0, help="mean return of the last 100 episodes")
    parser.add_argument("--most", type=int, default=2_000_000, help="control periods to give up after")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    if min(options.num_envs, options.most) < 1:
        parser.error("--num-envs and --most must be above zero")
    torch.set_num_threads(1)
    print(f"{'':32s}{'wall time / s':>15s}{'processor / s':>15s}{'control periods':>17s}{'return':>8s}")
    found = {}
    ways = {
        "batch (DIPCFrictionVecEnv)": batch,
        "single ones (make_vec_env)": singles,
        "engine 'compiled'": lambda count: batch(count, "compiled"),
    }
    for name, make in ways.items():
        found[name] = wall, processor, steps, reached = seconds_to_goal(make, options)
        print(f"{name:32s}{wall:15.1f}{processor:15.1f}{steps:17,d}{reached:8.0f}", flush=True)
    (a, b, *_), *others = found.values()
    for name, (c, d, *_) in zip(list(ways)[1:], others, strict=True):
        print(f"{name + ' of batch':40s}{c / a:7.2f}{d / b:15.2f}")


if __name__ == "__main__":
    main()
