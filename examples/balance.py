"""Balance the rig for 20 s, with and without friction compensation.

Run it: python examples/balance.py
"""

from dataclasses import dataclass

import gymnasium
import numpy as np
import tyro

import dipc_gym
from dipc_gym.controllers import LQR
from dipc_gym.runs import identify
from dipc_gym.wrappers import ForceCommand


@dataclass
class Arguments:
    seconds: float = 20.0
    """length of a run"""
    seed: int = 0
    """of the starting state"""


def largest_deviation(env: gymnasium.Env, seconds: float, seed: int) -> float:
    """Largest deviation of the cart in the last half of a run under the paper's LQR, m."""
    lqr = LQR()
    observation, _ = env.reset(seed=seed)
    steps = round(seconds / 0.005)
    positions = np.zeros(steps)
    for k in range(steps):
        observation, _, terminated, _, _ = env.step([lqr.force(observation)])
        positions[k] = observation[0]
        if terminated:
            raise SystemExit(f"fell after {0.005 * k:.1f} s")
    return float(np.abs(positions[steps // 2 :]).max())


if __name__ == "__main__":
    arguments = tyro.cli(Arguments)
    run = identify(seed=arguments.seed)  # 60 s of swept voltage on the rig with locked poles
    for name in ("none", "feedforward", "llnf", "ideal"):
        env = gymnasium.make(dipc_gym.ENV_ID, max_episode_steps=100_000)
        env = ForceCommand(env, run.fit(name))
        deviation = largest_deviation(env, arguments.seconds, arguments.seed)
        print(f"{name:12s} cart moves by up to {1000 * deviation:5.1f} mm")
