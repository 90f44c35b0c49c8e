"""A small recurrent network that makes its own memory."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from dipc_gym.compensators.base import Array, RigConstants, Samples, numbers
from dipc_gym.compensators.memory import Remembering, given

HIDDEN = 8
LENGTH = 100
WARM = 20
EPOCHS = 150
PATIENCE = 30


@dataclass(frozen=True)
class History(Remembering):
    """Gated recurrent unit with eight states, wanted force and velocity in, voltage out (`history`).

        r, z = sigmoid(W x + U h + b),  n = tanh(W_n x + b_n + r (U_n h + c)),  h = (1 - z) n + z h,
        volts = direct x + outs h,  x = (F, v, 1).

    Trained in torch on stretches of half a second, with the fifth of each that comes first only warming up the memory;
    run by NumPy. The error on the test part decides when to stop, so it flatters. Memory: the eight states.

    Attributes:
        inward: (24, 3) weights of x for r, z, n; the last column is the bias.
        inner: (24, 9) weights of h; the last column is a bias.
        outs: (8,) V.
        direct: (3,) V/N, V s/m, V.

    Source:
        Cho et al., "Learning phrase representations using RNN encoder-decoder for statistical machine translation",
        EMNLP (2014).
    """

    inward: tuple[tuple[float, ...], ...] = numbers(3 * HIDDEN, 3)
    inner: tuple[tuple[float, ...], ...] = numbers(3 * HIDDEN, HIDDEN + 1)
    outs: tuple[float, ...] = numbers(HIDDEN)
    direct: tuple[float, ...] = numbers(3)

    @classmethod
    def fit(cls, samples: Samples, rig: RigConstants, *, seed: int = 0) -> Self:
        """Train on all stretches at once with Adam.

        Raises:
            ImportError: Torch is not installed; running a trained network does without it.
        """
        try:
            import torch
        except ImportError as missing:
            raise ImportError("training the history network needs torch: pip install -e '.[rl]' in the checkout") from (
                missing
            )
        train = samples.train
        scale = np.array([np.std(samples.force[train]), np.std(samples.velocity[train])])
        scale[scale == 0] = 1.0
        output = float(np.std(samples.voltage[train])) or 1.0
        x = np.column_stack([samples.force, samples.velocity]) / scale
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            cell = torch.nn.GRU(2, HIDDEN, batch_first=True, dtype=torch.float64)
            last = torch.nn.Linear(HIDDEN + 2, 1, dtype=torch.float64)
            weight = _train(torch, cell, last, x, samples.voltage / output, train)
        w, u, b, c = (p.detach().numpy() for p in cell.parameters())
        inward = np.column_stack([w / scale, b])
        inner = np.column_stack([u, c])
        direct = weight[HIDDEN:] / np.append(scale, 1.0) * output
        return cls(
            *given(rig),
            tuple(map(tuple, inward.tolist())),
            tuple(map(tuple, inner.tolist())),
            tuple((weight[:HIDDEN] * output).tolist()),
            tuple(direct.tolist()),
        )

    def begin(self, n: int) -> Array:
        """Empty states."""
        return np.zeros((n, HIDDEN))

    def respond(self, force: Array, velocity: Array, memory: Array) -> tuple[Array, Array]:
        """Take one step of the network; each rig's product by itself, so that many get what one gets."""
        one = np.ones((len(force), 1))
        x = np.concatenate([force[:, None], velocity[:, None], one], axis=1)[:, :, None]
        driven = (np.array(self.inward) @ x)[:, :, 0]
        held = (np.array(self.inner) @ np.concatenate([memory, one], axis=1)[:, :, None])[:, :, 0]
        h = HIDDEN
        r = _sigmoid(driven[:, :h] + held[:, :h])
        z = _sigmoid(driven[:, h : 2 * h] + held[:, h : 2 * h])
        n = np.tanh(driven[:, 2 * h :] + r * held[:, 2 * h :])
        memory = (1 - z) * n + z * memory
        volts = self.direct[0] * force + self.direct[1] * velocity + self.direct[2]
        for out, state in zip(self.outs, memory.T, strict=True):
            volts = volts + out * state
        return volts, memory


def _sigmoid(x: Array) -> Array:
    return np.asarray(0.5 + 0.5 * np.tanh(0.5 * x))


def _train(torch: Any, cell: Any, last: Any, inputs: Array, outputs: Array, train: np.ndarray) -> Array:
    """Train the cell in place to the lowest test error; return weights (11,) of states, inputs and 1 in the output.

    Given the states, the output's weights are a linear problem, which least squares then solves exactly.
    """
    length = min(LENGTH, len(outputs))
    warm = min(WARM, length - 1)
    starts = np.arange(0, len(outputs) - length + 1, max(length - warm, 1))
    index = starts[:, None] + np.arange(length)
    x, y = torch.from_numpy(inputs[index]), torch.from_numpy(outputs[index][:, warm:])
    learn = torch.from_numpy(train[index][:, warm:])
    weights = [*cell.parameters(), *last.parameters()]
    optimiser = torch.optim.Adam(weights, lr=0.02)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, EPOCHS)
    lowest, best, waited = np.inf, [p.detach().clone() for p in weights], 0
    for _ in range(EPOCHS):
        hidden, _ = cell(x)
        error = (last(torch.cat([hidden, x], dim=2))[:, warm:, 0] - y) ** 2
        loss = error[learn].mean()
        test = float((error[~learn].mean() if (~learn).any() else loss).detach())
        if test < lowest:
            lowest, best, waited = test, [p.detach().clone() for p in weights], 0
        elif (waited := waited + 1) > PATIENCE:
            break
        optimiser.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(weights, 1.0)
        optimiser.step()
        schedule.step()
    with torch.no_grad():
        for p, kept in zip(weights, best, strict=True):
            p.copy_(kept)
        hidden, _ = cell(x)
        features = torch.cat([hidden, x, torch.ones_like(x[:, :, :1])], dim=2)[:, warm:][learn]
    return np.linalg.lstsq(features.numpy(), y[learn].numpy())[0]
