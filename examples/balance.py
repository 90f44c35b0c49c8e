"""Balance the rig without and with friction compensation, and compare in numbers.

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
    """of the initial state"""


def largest_deviations(env: gymnasium.Env, seconds: float, seed: int) -> np.ndarray:
    """Largest deviations in the last half of a run under the paper's LQR: cart, mm, and the two poles, degrees."""
    observation, _ = env.reset(seed=seed)
    lqr = LQR()
    states = np.zeros((round(seconds / 0.005), 3))
    for k in range(len(states)):
        observation, _, terminated, _, _ = env.step(np.array([lqr.force(observation)]))
        states[k] = observation[:3]
        if terminated:
            raise SystemExit(f"fell after {0.005 * (k + 1):.2f} s")
    return np.abs(states[len(states) // 2 :]).max(axis=0) * (1000, 180 / np.pi, 180 / np.pi)


if __name__ == "__main__":
    arguments = tyro.cli(Arguments)
    run = identify(seed=arguments.seed)  # 60 s of swept voltage on the rig with locked poles
    found = {}
    print("largest deviation   cart, mm   pole 1, deg   pole 2, deg")
    for name in ("none", "feedforward", "llnf", "ideal"):
        env = gymnasium.make(dipc_gym.ENV_ID, max_episode_steps=100_000)
        env = ForceCommand(env, run.fit(name))
        found[name] = largest_deviations(env, arguments.seconds, arguments.seed)
        print("{:19s} {:8.1f} {:13.2f} {:13.2f}".format(name, *found[name]))
    less = found["none"] / found["llnf"]
    print(
        "With the LLNF compensator, cart and poles move {:.1f}, {:.1f} and {:.1f} times less than without.".format(
            *less
        )
    )
