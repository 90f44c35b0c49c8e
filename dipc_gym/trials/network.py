"""A rival of the diagnosis: a neural network that learns what force the model lacks, as residual physics is often done.

The unexplained generalised force at each sample of the training recordings (nominal inertia times the difference of
the observed and the modelled acceleration) is regressed on positions, velocities and command. The network is added
to the model as a force, if the recordings are then simulated better. It may predict well; what is missing it cannot
say.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from dipc_gym.trials.replayed import Array, Motion, early_and_late, kept, lacking

HIDDEN = 32  # units of each of two layers
EPOCHS = 400  # at most
PATIENCE = 60
"""Epochs without a better validation error after which training ends."""


@dataclass(frozen=True)
class ResidualForce:
    """A network of two hidden layers of hyperbolic tangents; needs NumPy only.

    Attributes:
        centre: of the inputs (positions, velocities, command).
        spread: of the inputs.
        scale: of the forces, N or N m.
        layers: weights (out, in) and biases (out,), in order.
    """

    centre: Array
    spread: Array
    scale: Array
    layers: tuple[tuple[Array, Array], ...]

    def __call__(self, q: Array, v: Array, command: Array) -> Array:
        """Generalised force, (n, nv)."""
        x = (np.concatenate([q, v, command], axis=1) - self.centre) / self.spread
        for k, (weight, bias) in enumerate(self.layers):
            x = x @ weight.T + bias
            if k < len(self.layers) - 1:
                x = np.tanh(x)
        return np.asarray(x * self.scale)


def learn(
    model: mujoco.MjModel, motions: Sequence[Motion], noise: Array, *, seed: int = 0
) -> ResidualForce | None:  # fmt: skip
    """The force that a trial's nominal model lacks, or None if adding it makes simulations of the recordings worse.

    Args:
        model: the nominal model.
        motions: training recordings.
        noise: standard deviation of each reading's noise.
        seed: of the weights.
    """
    force = regress(model, motions, seed=seed)
    return force if kept(model, motions, noise, force) else None


def regress(model: mujoco.MjModel, motions: Sequence[Motion], *, seed: int = 0) -> ResidualForce:
    """A network fitted to the unexplained force, sample by sample.

    Args:
        model: the nominal model.
        motions: training recordings.
        seed: of the weights.
    """
    import torch

    inputs, forces = lacking(model, motions)
    everything = np.concatenate(inputs)
    centre, spread = everything.mean(axis=0), everything.std(axis=0) + 1e-12
    scale = np.concatenate(forces).std(axis=0) + 1e-12

    x, x_late = (torch.as_tensor((part - centre) / spread, dtype=torch.float32) for part in early_and_late(inputs))
    y, y_late = (torch.as_tensor(part / scale, dtype=torch.float32) for part in early_and_late(forces))
    generator = torch.Generator().manual_seed(seed)
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        net = torch.nn.Sequential(
            torch.nn.Linear(x.shape[1], HIDDEN), torch.nn.Tanh(), torch.nn.Linear(HIDDEN, HIDDEN), torch.nn.Tanh(),
            torch.nn.Linear(HIDDEN, y.shape[1]),
        )  # fmt: skip
    with torch.no_grad():
        net[-1].weight.zero_()  # without evidence nothing is added
        net[-1].bias.zero_()
    optimizer = torch.optim.Adam(net.parameters(), lr=3e-3, weight_decay=1e-5)
    best, found, waited = float(torch.mean(y_late**2)), [p.detach().clone() for p in net.parameters()], 0
    for _ in range(EPOCHS):
        for rows in torch.randperm(len(x), generator=generator).split(512):
            optimizer.zero_grad()
            torch.mean((net(x[rows]) - y[rows]) ** 2).backward()
            optimizer.step()
        with torch.no_grad():
            late = float(torch.mean((net(x_late) - y_late) ** 2))
        if late < best:
            best, found, waited = late, [p.detach().clone() for p in net.parameters()], 0
        else:
            waited += 1
            if waited >= PATIENCE:
                break
    arrays = [p.numpy().astype(float) for p in found]
    layers = tuple(zip(arrays[::2], arrays[1::2], strict=True))
    return ResidualForce(centre, spread, scale, layers)
