"""PPO on many rigs at once, in one file: learn to balance through stick-slip friction, commanding force.

It learns in half a minute to a minute on one core; everything that matters is here, to be copied and changed.
`dipc-gym train-policy` has checkpoints, trials on the way and policies that run without torch.
Run it: python examples/train_policy.py
"""

import time
import warnings
from dataclasses import dataclass

import gymnasium
import numpy as np
import torch
import tyro

import dipc_gym
from dipc_gym.compensators import OutOfRangeWarning
from dipc_gym.runs import identify
from dipc_gym.wrappers import VectorForceCommand


@dataclass
class Arguments:
    compensator: str = "llnf"
    """none, feedforward, mlp, llnf or ideal"""
    seed: int = 0
    """of weights, exploration and initial states"""
    steps: int = 768_000
    """control periods to learn from"""
    num_envs: int = 32
    """simulated side by side"""
    rollout: int = 250
    """control periods of each rig between two updates"""
    epochs: int = 10
    """passes over a rollout"""
    batches: int = 8
    """minibatches a pass"""
    learning_rate: float = 5e-4
    """at the start; it falls linearly"""
    gamma: float = 0.995
    """discount of a control period"""
    gae_lambda: float = 0.98
    """lambda of the advantage estimate"""
    clip: float = 0.2
    """how far the probability of a command may change in an update"""
    limit: float = 60.0
    """largest force, N"""
    seconds: float = 80.0
    """length of the trial at the end"""


SCALES = np.array([0.1, 0.05, 0.05, 0.5, 0.5, 0.5])  # m, rad and their rates: what balancing looks like
REWARD = 0.02  # factor on the reward, so that the value of standing is near 1


def network(outputs: int, last: float) -> torch.nn.Sequential:
    """Two hidden layers of 64; the last starts small."""
    layers = [torch.nn.Linear(6, 64), torch.nn.Tanh(), torch.nn.Linear(64, 64), torch.nn.Tanh()]
    layers.append(torch.nn.Linear(64, outputs))
    for layer, gain in zip(layers[::2], (2**0.5, 2**0.5, last), strict=True):
        torch.nn.init.orthogonal_(layer.weight, gain)
        torch.nn.init.zeros_(layer.bias)
    return torch.nn.Sequential(*layers)


def scaled(observations: np.ndarray) -> torch.Tensor:
    return torch.as_tensor(observations / SCALES, dtype=torch.float32)


if __name__ == "__main__":
    arguments = tyro.cli(Arguments)
    torch.manual_seed(arguments.seed)
    torch.set_num_threads(1)
    warnings.simplefilter("ignore", OutOfRangeWarning)  # exploring leaves the identified range

    compensator = identify(seed=arguments.seed).fit(arguments.compensator)

    def make(count: int, steps: int) -> gymnasium.vector.VectorEnv:
        envs = gymnasium.make_vec(
            dipc_gym.ENV_ID,
            num_envs=count,
            vectorization_mode="vector_entry_point",
            autoreset_mode="SameStep",
            max_episode_steps=steps,
        )
        return VectorForceCommand(envs, compensator, force_limit=arguments.limit)

    envs = make(
        arguments.num_envs, 12_000
    )  # 60 s: in shorter episodes it never sees the cart drift to the end of its rail
    actor, critic = network(1, 0.01), network(1, 1.0)
    spread = torch.nn.Parameter(torch.full((1,), -1.0))  # logarithm of the standard deviation of commands
    weights = [*actor.parameters(), *critic.parameters(), spread]
    optimiser = torch.optim.Adam(weights, lr=arguments.learning_rate, eps=1e-5)
    average = torch.optim.swa_utils.AveragedModel(actor, multi_avg_fn=torch.optim.swa_utils.get_ema_multi_avg_fn(0.95))

    n, m = arguments.rollout, arguments.num_envs
    updates, began = max(arguments.steps // (n * m), 1), time.perf_counter()
    observations, _ = envs.reset(seed=arguments.seed)
    lengths, running = [], np.zeros(m)
    for update in range(updates):
        optimiser.param_groups[0]["lr"] = arguments.learning_rate * (1 - update / updates)
        seen, done = torch.zeros(n, m, 6), torch.zeros(n, m)
        actions, chances, rewards = torch.zeros(n, m, 1), torch.zeros(n, m), torch.zeros(n, m)
        for k in range(n):
            seen[k] = scaled(observations)
            with torch.no_grad():
                commands = torch.distributions.Normal(actor(seen[k]), spread.exp())
                actions[k] = commands.sample()
                chances[k] = commands.log_prob(actions[k]).sum(-1)
            observations, reward, fell, cut, infos = envs.step(actions[k].numpy() * arguments.limit)
            rewards[k] = torch.as_tensor(reward * REWARD)
            late = cut & ~fell
            if late.any():  # time was over, not the balance: what was still to come counts
                last = np.stack([infos["final_obs"][i] for i in np.flatnonzero(late)])
                with torch.no_grad():
                    rewards[k, late] += arguments.gamma * critic(scaled(last))[:, 0]
            done[k] = torch.as_tensor(fell | cut, dtype=torch.float32)
            running += 1
            lengths += running[fell | cut].tolist()
            running[fell | cut] = 0

        with torch.no_grad():
            values = critic(torch.cat([seen, scaled(observations)[None]]))[..., 0]
        advantages, trace = torch.zeros(n, m), torch.zeros(m)
        for k in reversed(range(n)):
            going = 1 - done[k]
            surprise = rewards[k] + arguments.gamma * going * values[k + 1] - values[k]
            trace = surprise + arguments.gamma * arguments.gae_lambda * going * trace
            advantages[k] = trace
        batch = [x.flatten(0, 1) for x in (seen, actions, chances, advantages, advantages + values[:-1])]

        for _ in range(arguments.epochs):
            for rows in torch.randperm(n * m).chunk(arguments.batches):
                x, a, old, advantage, target = (part[rows] for part in batch)
                advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
                ratio = (torch.distributions.Normal(actor(x), spread.exp()).log_prob(a).sum(-1) - old).exp()
                clipped = ratio.clamp(1 - arguments.clip, 1 + arguments.clip)
                loss = -torch.min(ratio * advantage, clipped * advantage).mean()
                loss = loss + 0.5 * (critic(x)[:, 0] - target).square().mean()
                optimiser.zero_grad()
                loss.backward()
                torch.nn.utils.clip_grad_norm_(weights, 0.5)
                optimiser.step()
        average.update_parameters(actor)  # single updates make a balancing policy better and worse by turns
        if update % 10 == 9 or update == updates - 1:
            recent = 0.005 * np.mean(lengths[-m:]) if lengths else 0.0
            newtons = arguments.limit * float(spread.exp().detach())
            print(
                f"{(update + 1) * n * m:9,} periods, {time.perf_counter() - began:4.0f} s: "
                f"episodes of {recent:4.1f} s, commands spread by {newtons:4.1f} N"
            )

    trial = make(10, 10**9)
    observations, _ = trial.reset(seed=20_000)
    standing = np.ones(10, dtype=bool)
    for _ in range(round(arguments.seconds / 0.005)):
        with torch.no_grad():
            forces = average(scaled(observations)).numpy() * arguments.limit
        observations, _, fell, _, _ = trial.step(forces)
        standing &= ~fell
    print(f"{standing.sum()} of 10 stood for {arguments.seconds:g} s")
