"""A small recurrent network that makes its own memory."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from dipc_gym.compensators.base import Array, RigConstants, Samples, numbers
from dipc_gym.compensators.memory import Remembering, given

if TYPE_CHECKING:
    from dipc_gym.dataflow import Program, Value

HIDDEN = 8  # units of the recurrent layer
LENGTH = 100  # control periods of a training window
WARM = 20  # first periods of a window, which do not count
EPOCHS = 150  # at most
PATIENCE = 30  # epochs without a better validation error after which training ends
PRIOR = "history.json"
UNITS, VOLTS = np.array([10.0, 0.2]), 3.0  # N and m/s, V: what the network of many rigs counts in


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
        torch = _torch()
        train = samples.train
        scale = np.array([np.std(samples.force[train]), np.std(samples.velocity[train])])
        scale[scale == 0] = 1.0
        output = float(np.std(samples.voltage[train])) or 1.0
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            cell, last = _network(torch)
            weight = _train(torch, cell, last, _windows(torch, samples, scale, output), rate=0.02, epochs=EPOCHS)
        return cls._of(rig, cell, weight, scale, output)

    @classmethod
    def _of(cls, rig: RigConstants, cell: Any, weight: Array, scale: Array, output: float) -> Self:
        """The network in units of the rig, from one whose inputs are in units of `scale`, the output of `output`."""
        w, u, b, c = (p.detach().numpy() for p in cell.parameters())
        inward, inner = np.column_stack([w / scale, b]), np.column_stack([u, c])
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

    def express(self, program: Program, force: Value, velocity: Value) -> Value:
        """Write the network into a program that can be exported."""
        h, memory = HIDDEN, program.state("hidden", np.zeros(HIDDEN))
        inward, inner = np.array(self.inward), np.array(self.inner)
        driven = program.join(force, velocity).affine(inward[:, :2], inward[:, 2])
        held = memory.affine(inner[:, :h], inner[:, h])
        r = (driven.part(0, h) + held.part(0, h)).sigmoid()
        z = (driven.part(h, h) + held.part(h, h)).sigmoid()
        n = (driven.part(2 * h, h) + r * held.part(2 * h, h)).tanh()
        memory_ahead = (1 - z) * n + z * memory
        program.update(memory, memory_ahead)
        return program.join(force, velocity, memory_ahead).affine([(*self.direct[:2], *self.outs)], self.direct[2])


def _sigmoid(x: Array) -> Array:
    return np.asarray(0.5 + 0.5 * np.tanh(0.5 * x))


@dataclass(frozen=True)
class AdaptedHistory(History):
    """The same network, trained on many rigs beforehand and then on this one's run (`history_adapted`).

    What comes along was trained on the identification runs of 24 rigs, whose friction is a quarter to four times the
    paper's, with other bristles, drag and masses (`python -m benchmarks.pretrain`). A run of the rig goes on from
    there, with a tenth of the rate, and no more than 60 times through it.
    """

    @classmethod
    def fit(cls, samples: Samples, rig: RigConstants, *, seed: int = 0) -> Self:
        """Go on from the network of many rigs; `seed` changes nothing.

        Raises:
            ImportError: Torch is not installed; running a trained network does without it.
        """
        torch = _torch()
        cell, last = _network(torch)
        kept = json.loads(resources.files("dipc_gym.compensators").joinpath(PRIOR).read_text(encoding="utf-8"))
        with torch.no_grad():
            for parameter, numbers_ in zip([*cell.parameters(), *last.parameters()], kept["weights"], strict=True):
                parameter.copy_(torch.tensor(numbers_, dtype=torch.float64))
        windows = _windows(torch, samples, UNITS, VOLTS)
        weight = _train(torch, cell, last, windows, rate=0.002, epochs=60)
        return cls._of(rig, cell, weight, UNITS, VOLTS)


def pretrained(runs: Sequence[Samples], *, seed: int = 0, epochs: int = 2 * EPOCHS) -> dict[str, Any]:
    """What `AdaptedHistory` begins with, as its file has it, from the runs of many rigs."""
    torch = _torch()
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        cell, last = _network(torch)
        parts = [_windows(torch, samples, UNITS, VOLTS) for samples in runs]
        windows = tuple(torch.cat(part) for part in zip(*parts, strict=True))
        _train(torch, cell, last, windows, rate=0.02, epochs=epochs)
    weights = [p.detach().numpy() for p in (*cell.parameters(), *last.parameters())]
    return {"runs": len(runs), "seed": seed, "weights": [np.round(w, 9).tolist() for w in weights]}


def _torch() -> Any:
    try:
        import torch
    except ImportError as missing:
        raise ImportError(
            "training the history network needs torch: add its extra: pip install '.[rl]' in a clone"
        ) from missing
    return torch


def _network(torch: Any) -> tuple[Any, Any]:
    cell = torch.nn.GRU(2, HIDDEN, batch_first=True, dtype=torch.float64)
    return cell, torch.nn.Linear(HIDDEN + 2, 1, dtype=torch.float64)


def _windows(torch: Any, samples: Samples, scale: Array, output: float) -> tuple[Any, Any, Any]:
    """Stretches of a run: inputs (n, length, 2), outputs and whether to learn from them (n, length - warm)."""
    length = min(LENGTH, len(samples.force))
    warm = min(WARM, length - 1)
    starts = np.arange(0, len(samples.force) - length + 1, max(length - warm, 1))
    index = starts[:, None] + np.arange(length)
    inputs = np.column_stack([samples.force, samples.velocity]) / scale
    outputs = samples.voltage / output
    tensor = torch.from_numpy
    return tensor(inputs[index]), tensor(outputs[index][:, warm:]), tensor(samples.train[index][:, warm:])


def _train(torch: Any, cell: Any, last: Any, windows: tuple[Any, Any, Any], *, rate: float, epochs: int) -> Array:
    """Train the cell in place to the lowest test error; return weights (11,) of states, inputs and 1 in the output.

    Given the states, the output's weights are a linear problem, which least squares then solves exactly.
    """
    x, y, learn = windows
    warm = x.shape[1] - y.shape[1]
    weights = [*cell.parameters(), *last.parameters()]
    optimiser = torch.optim.Adam(weights, lr=rate)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, epochs)
    lowest, best, waited = np.inf, [p.detach().clone() for p in weights], 0
    for _ in range(epochs):
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
