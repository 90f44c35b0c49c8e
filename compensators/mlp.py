"""The paper's rival: a multilayer perceptron with five hidden neurons."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Self

import numpy as np

from dipc_gym.compensators.base import (
    Array,
    Compensator,
    RigConstants,
    Samples,
    Signal,
    elementwise,
    numbers,
)

HIDDEN = 5  # units, as in the paper
STARTS = 3  # first weights that are tried
EPOCHS = 60  # at most
ITERATIONS = 10  # of L-BFGS in an epoch
PATIENCE = 6  # epochs without a better validation error after which training ends


@dataclass(frozen=True)
class MLP(Compensator):
    """Multilayer perceptron (`mlp`), 3 inputs, 5 hidden tanh neurons, 1 linear output, as in the paper.

        volts = sum_h out_h tanh(w_h . (F(k), v(k), v(k-1)) + bias_h).

    The paper prints 25 weights for it: 15 + 5 + 5, so without a bias at the output (its table says 19). The
    scaling of inputs and output in training is folded into the weights afterwards and adds no numbers.

    Networks with all but the same test error can differ in the loop: in a trial with LuGre friction, three
    training seeds gave the LQR cost of the LLNF and a fourth 1.8 times as much. Judge it over seeds.

    Attributes:
        weights: (5, 3) weights of force (1/N), velocity and previous velocity (s/m).
        biases: (5,) biases of the hidden neurons.
        outs: (5,) output weights, V.

    Example:
        >>> mlp = MLP(weights=((0.1, 0.0, 0.0),) * 5, biases=(0.0,) * 5, outs=(1.0,) * 5)
        >>> mlp.voltage(force=0.0, velocity=0.1), mlp.parameters
        (0.0, 25)
    """

    weights: tuple[tuple[float, ...], ...] = numbers(HIDDEN, 3)
    biases: tuple[float, ...] = numbers(HIDDEN)
    outs: tuple[float, ...] = numbers(HIDDEN)
    _neurons: list[tuple[float, ...]] = field(default_factory=list, init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        super().__post_init__()
        for row, bias in zip(self.weights, self.biases, strict=True):
            self._neurons.append((*row, bias))

    @classmethod
    def fit(cls, samples: Samples, rig: RigConstants, *, seed: int = 0) -> Self:
        """Train in torch: L-BFGS on all training samples at once, from three random starts.

        As for the LLNF, the error on the test part decides when to stop and which start to keep; so the test
        error flatters a little.

        Raises:
            ImportError: Torch is not installed; running a trained network does without it.
        """
        scale = np.std(samples.inputs[samples.train], axis=0)
        scale[scale == 0] = 1.0
        output = float(np.std(samples.voltage[samples.train])) or 1.0
        weights, biases, outs = _train(samples.inputs / scale, samples.voltage / output, samples.train, seed)
        return cls(
            weights=tuple(tuple(row) for row in (weights / scale).tolist()),
            biases=tuple(biases.tolist()),
            outs=tuple((outs * output).tolist()),
        )

    def volts(self, force: Signal, velocity: Signal, previous_velocity: Signal) -> Signal:
        """Evaluate the network."""
        sums = [f * force + v * velocity + p * previous_velocity + bias for f, v, p, bias in self._neurons]
        hidden = elementwise(np.tanh, sums)
        volts = self.outs[0] * hidden[0]
        for out, value in zip(self.outs[1:], hidden[1:], strict=True):
            volts = volts + out * value
        return volts


def _train(inputs: Array, outputs: Array, train: np.ndarray, seed: int) -> tuple[Array, Array, Array]:
    """Return weights (5, 3), biases (5,) and output weights (5,) of the network with the lowest test error."""
    try:
        import torch
    except ImportError as missing:
        raise ImportError("training the mlp needs torch: add its extra: pip install '.[mlp]' in a clone") from missing

    x, y = torch.from_numpy(inputs), torch.from_numpy(outputs)
    learn = torch.from_numpy(train)
    x_train, y_train, x_test, y_test = x[learn], y[learn], x[~learn], y[~learn]

    def error(network: list[torch.Tensor], x: torch.Tensor, y: torch.Tensor) -> torch.Tensor:
        weights, biases, outs = network
        return torch.mean((torch.tanh(x @ weights.T + biases) @ outs - y) ** 2)

    rng = np.random.default_rng(seed)
    best_error = np.inf
    best: list[Array] | None = None
    for _ in range(STARTS):
        weights = torch.from_numpy(rng.normal(size=(HIDDEN, 3))).requires_grad_()
        biases = torch.from_numpy(rng.normal(size=HIDDEN)).requires_grad_()
        outs = torch.from_numpy(rng.normal(size=HIDDEN) / HIDDEN).requires_grad_()
        network = [weights, biases, outs]

        optimizer = torch.optim.LBFGS(network, max_iter=ITERATIONS, line_search_fn="strong_wolfe")

        def closure(
            network: list[torch.Tensor] = network, optimizer: torch.optim.Optimizer = optimizer
        ) -> torch.Tensor:
            optimizer.zero_grad()
            loss = error(network, x_train, y_train)
            loss.backward()
            return loss

        lowest, since = np.inf, 0
        for _ in range(EPOCHS):
            optimizer.step(closure)
            with torch.no_grad():
                test_error = float(error(network, x_test, y_test))
            if test_error < best_error:
                best_error, best = test_error, [tensor.detach().numpy().copy() for tensor in network]
            since = 0 if test_error < (1 - 1e-4) * lowest else since + 1
            lowest = min(lowest, test_error)
            if since >= PATIENCE:
                break
    assert best is not None
    return best[0], best[1], best[2]
