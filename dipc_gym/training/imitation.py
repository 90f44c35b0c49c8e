"""Learning by imitation: a network does what feedback around a planned motion would do, wherever the network gets to.

DAgger. In the first round the teacher drives; then the network does, and of every state that it comes to the teacher
says what it would have done there. All of this is remembered, and the network learns all of it again in every round.

Source:
    Ross, Gordon, Bagnell, "A reduction of imitation learning and structured prediction to no-regret online learning"
    (AISTATS 2011).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3.common import logger

from dipc_gym.controllers.tracking import Tracking, feedback
from dipc_gym.kernels import TURN
from dipc_gym.mechanics.motion import SIZE, Motion, state_of
from dipc_gym.policy import Policy
from dipc_gym.safety.intact import fit
from dipc_gym.training.learner import SCALES, shortest
from dipc_gym.training.rig import Rig
from dipc_gym.training.task import Training

Array = NDArray[np.float64]

STEPS = np.arange(-3, 5)
"""How far the place on a plan moves in a control period, in periods of the plan."""
LOST = 2e4
"""Cost to go, in units of the paper's LQR, beyond which a rig is too far from the plan to be told a way back."""


class Teacher:
    """Feedback around a planned motion by where a rig is, not by when.

    `Tracking` counts periods. A network sees no clock, and would be told one thing and another of the same state. So
    here the place on the plan is the one to which the way back costs least, as the time-varying LQR counts costs,
    among those near the last.

    Args:
        plan: motion to follow.
        motion: of the rig.
        count: of rigs that are told at a time.

    Attributes:
        cost: (count,) of the way back, when last asked.
    """

    def __init__(self, plan: Tracking, motion: Motion, count: int) -> None:
        around = feedback(motion, plan.states, plan.forces, plan.period, plan.states[-1])
        self._states, self._forces = plan.states, np.append(plan.forces, 0.0)
        self._gains = np.vstack([around.gains, around.hold])
        self._roots = np.linalg.cholesky(around.to_go)
        self._places = np.zeros(count, dtype=np.intp)
        self.cost = np.zeros(count)

    def begin(self, rows: NDArray[np.bool_], states: Array) -> None:
        """Look for the place of some rigs on the whole plan.

        Args:
            rows: (count,) which of them.
            states: (count, 6) of all.
        """
        everywhere = np.broadcast_to(np.arange(len(self._states)), (int(rows.sum()), len(self._states)))
        self._places[rows], _ = self._nearest(states[rows], everywhere)

    def forces(self, states: Array) -> Array:
        """What it would do, (count,) N, in states (count, 6)."""
        around = np.clip(self._places[:, None] + STEPS, 0, len(self._states) - 1)
        self._places, self.cost = self._nearest(states, around)
        off = self._off(states, self._places)
        return self._forces[self._places] - (self._gains[self._places] * off).sum(axis=-1)

    def _nearest(self, states: Array, places: NDArray[np.intp]) -> tuple[NDArray[np.intp], Array]:
        """Of places (n, k), those (n,) from which states (n, 6) cost least to bring back, and what that is."""
        weighed = np.einsum("nkij,nki->nkj", self._roots[places], self._off(states[:, None], places))
        costs = (weighed * weighed).sum(axis=-1)
        best = costs.argmin(axis=-1)
        rows = np.arange(len(states))
        return places[rows, best], costs[rows, best]

    def _off(self, states: Array, places: NDArray[np.intp]) -> Array:
        off = states - self._states[places]
        off[..., 1:3] -= TURN * np.round(off[..., 1:3] / TURN)
        return off


class Imitator:
    """A network that learns from a teacher, with the interface of `learner.Learner`.

    Rigs begin along the plan, every second of them where the plan does. One that ends, or that is lost to the teacher,
    begins anew.

    Args:
        training: what to learn.
        rig: where.
        folder: for TensorBoard's files; None writes none.
    """

    def __init__(self, training: Training, rig: Rig, folder: Path | None = None) -> None:
        torch.set_num_threads(1)  # a network this small is slower on two
        assert rig.plan is not None  # a swing-up has one
        self.training, self.rig, recipe = training, rig, training.recipe
        self.steps = 0
        self._scales = SCALES[training.task]
        self._envs = rig.learning(recipe)
        self._teacher = Teacher(rig.plan, Motion.of(*rig.linear), recipe.num_envs)
        torch.manual_seed(training.seed)
        width = recipe.width
        self._network = torch.nn.Sequential(
            torch.nn.Linear(SIZE, width),
            torch.nn.Tanh(),
            torch.nn.Linear(width, width),
            torch.nn.Tanh(),
            torch.nn.Linear(width, 1),
        )
        self._seen = np.zeros((recipe.buffer_size, SIZE), dtype=np.float32)
        self._told = np.zeros(recipe.buffer_size, dtype=np.float32)
        self._at, self._filled = 0, 0
        self._logger = logger.configure(None if folder is None else str(folder), ["tensorboard"] if folder else [])

    def learn(self, stage: int, each_step: Callable[[], None]) -> None:
        """Drive for one round and learn what the teacher said.

        Args:
            stage: number of the round, from 0, in which the teacher drives.
            each_step: called at its end.
        """
        recipe = self.training.recipe
        seeds = np.random.SeedSequence([self.training.seed, stage]).generate_state(2) >> 1
        self._drive(stage, int(seeds[0]), math.ceil(min(recipe.stage, (recipe.steps - self.steps) / recipe.num_envs)))
        torch.manual_seed(int(seeds[1]))
        error = self._fit(recipe.learning_rate * max(1.0 - self.steps / recipe.steps, 0.05))
        self.log({"train/error": self.rig.full_force * math.sqrt(error), "train/remembered": self._filled})
        each_step()

    def _drive(self, stage: int, seed: int, periods: int) -> None:
        envs, teacher = self._envs, self._teacher
        observations, _ = envs.reset(seed=seed)
        teacher.begin(np.ones(envs.num_envs, dtype=bool), state_of(observations))
        for _ in range(periods):
            wanted = np.clip(teacher.forces(state_of(observations)) / self.rig.full_force, -1.0, 1.0)
            found = teacher.cost < LOST
            self._remember(observations[found], wanted[found])
            shares = wanted if stage == 0 else self._shares(observations)
            observations, _, fell, timed_out, _ = envs.step(self.rig.limit * shares[:, None])
            ended = fell | timed_out
            lost = ~(found | ended)
            if lost.any():
                observations, _ = envs.reset(options={"reset_mask": lost})
            if (ended | lost).any():
                teacher.begin(ended | lost, state_of(observations))
        self.steps += periods * envs.num_envs

    def _remember(self, observations: Array, wanted: Array) -> None:
        size = len(self._told)
        places = (self._at + np.arange(len(wanted))) % size
        self._seen[places], self._told[places] = observations / self._scales, wanted
        self._at, self._filled = (self._at + len(wanted)) % size, min(self._filled + len(wanted), size)

    def _shares(self, observations: Array) -> Array:
        """What the network commands, in shares of the limit."""
        with torch.no_grad():
            out = self._network(torch.from_numpy((observations / self._scales).astype(np.float32)))
        return np.clip(out[:, 0].numpy().astype(np.float64), -1.0, 1.0)

    def _fit(self, rate: float) -> float:
        """Learn all that is remembered; the mean square error on the way, in shares of the limit."""
        recipe = self.training.recipe
        seen, told = torch.from_numpy(self._seen[: self._filled]), torch.from_numpy(self._told[: self._filled])
        optimiser = torch.optim.Adam(self._network.parameters(), lr=rate)
        losses = []
        for _ in range(recipe.epochs):
            for batch in torch.randperm(self._filled).split(recipe.batch_size):
                loss = torch.nn.functional.mse_loss(self._network(seen[batch])[:, 0], told[batch])
                optimiser.zero_grad()
                loss.backward()
                optimiser.step()
                losses.append(loss.item())
        return float(np.mean(losses))

    def log(self, figures: Mapping[str, float]) -> None:
        """Give figures to TensorBoard."""
        for key, value in figures.items():
            self._logger.record(key, value)
        self._logger.dump(self.steps)

    def policy(self) -> Policy:
        """The network as it is."""
        numbers = [shortest(tensor.detach().numpy()) for tensor in self._network.parameters()]
        layers = tuple(zip(numbers[::2], numbers[1::2], strict=True))
        return self.rig.policy(self.training, layers, self._scales, "clip", self.steps)

    def state(self) -> dict[str, Any]:
        """All that the next round depends on: tensors and numbers."""
        return {
            "steps": self.steps,
            "network": self._network.state_dict(),
            "seen": torch.from_numpy(self._seen[: self._filled].copy()),
            "told": torch.from_numpy(self._told[: self._filled].copy()),
            "at": self._at,
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Take up what `state` gave.

        Raises:
            Exception: of many kinds, for the state of another training or of none; the learner is then of no use.
        """
        fit(state, {"steps": int, "at": int})
        self._network.load_state_dict(state["network"])
        filled = len(state["told"])
        self._seen[:filled], self._told[:filled] = state["seen"].numpy(), state["told"].numpy()
        if not 0 <= state["at"] < len(self._told):
            raise ValueError(f"the memory has no place {state['at']}")
        self.steps, self._at, self._filled = state["steps"], state["at"], filled
