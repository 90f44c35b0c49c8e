"""LOLIMOT's sibling with cuts in any direction: local linear models under a hierarchy of sigmoids."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Self

import numpy as np
from scipy.optimize import minimize

from dipc_gym.compensators.base import Array, Compensator, RigConstants, Samples, Signal, elementwise, numbers

if TYPE_CHECKING:
    from dipc_gym.dataflow import Program, Value

MAX_MODELS = 10  # of a compensator, twice the paper's
STEEPNESS = math.sqrt(20.0)
"""Of a cut before it is turned: its height one standard deviation of the cell away from its middle."""
ITERATIONS = 12  # of a cut's search for its direction
RIDGE = 1e-3  # weight of the slopes' squares, which keeps thin cells solvable
PATIENCE = 2  # models without a better test error after which growth ends


@dataclass(frozen=True)
class HILOMOT(Compensator):
    """Local linear models in cells that are cut in any direction (`hilomot`).

        volts = sum_i phi_i(x) (level_i + slope_i . x),    phi_i = prod_c sigmoid(sign_ic (offset_c + direction_c . x))

    over the cuts c on the way to cell i, with x = (F(k), v(k), v(k-1)). Friction at a reversal depends on velocity and
    its change together; LOLIMOT has to follow such an oblique edge in steps.

    Attributes:
        cuts: (cuts, 4) offset and direction of each cut, 1, 1/N, s/m, s/m.
        signs: (models, cuts) side of each cut on which a cell lies, 1 or -1, and 0 for a cut that is not on its way.
        lines: (models, 4) level in V, and slopes in V/N, V s/m, V s/m.

    Source: O. Nelles, "Axes-oblique partitioning strategies for local model networks", IEEE International Symposium on
        Intelligent Control, 2006.

    Example:
        >>> way = HILOMOT(cuts=((0.0, 0.0, 100.0, 0.0),), signs=((1.0,), (-1.0,)),
        ...               lines=((2.0, 0.25, 0.0, 0.0), (-2.0, 0.25, 0.0, 0.0)))
        >>> way.voltage(force=10.0, velocity=0.5), way.parameters
        (4.5, 12)
    """

    cuts: tuple[tuple[float, ...], ...] = numbers("cuts", 4)
    signs: tuple[tuple[float, ...], ...] = numbers("models", "cuts")
    lines: tuple[tuple[float, ...], ...] = numbers("models", 4)

    @classmethod
    def fit(cls, samples: Samples, rig: RigConstants, *, seed: int = 0) -> Self:
        """Grow the hierarchy on the training part; the test part decides which size is kept, as for the LLNF."""
        X, y, train = samples.inputs, samples.voltage, samples.train
        grown = grow(X[train], y[train], MAX_MODELS, test=(X[~train], y[~train]))
        return cls(*(tuple(tuple(row) for row in table.tolist()) for table in (grown.cuts, grown.signs, grown.lines)))

    def volts(self, force: Signal, velocity: Signal, previous_velocity: Signal) -> Signal:
        """Blend the local models."""
        heights = [o + f * force + v * velocity + p * previous_velocity for o, f, v, p in self.cuts]
        shares = elementwise(_sigmoid, heights)
        blend = 0.0 * force
        for signs, (level, f, v, p) in zip(self.signs, self.lines, strict=True):
            output = level + f * force + v * velocity + p * previous_velocity
            for sign, share in zip(signs, shares, strict=True):
                if sign:
                    output = output * (share if sign > 0 else 1.0 - share)
            blend = blend + output
        return blend

    @property
    def parameters(self) -> int:
        """Count of learned numbers; the signs only say which cell is where."""
        return 4 * (len(self.cuts) + len(self.lines))

    def express(self, program: Program, force: Value, velocity: Value) -> Value:
        """The same on vectors with an entry for each local model."""
        previous = program.previous("previous_velocity", velocity)
        inputs = program.join(force, velocity, previous)
        cuts, signs, lines = np.array(self.cuts), np.array(self.signs), np.array(self.lines)
        shares = inputs.affine(cuts[:, 1:], cuts[:, 0]).sigmoid()
        outputs = inputs.affine(lines[:, 1:], lines[:, 0])
        for c, sign in enumerate(signs.T):
            if sign.any():
                outputs = outputs * (program.constant(1.0 - (sign > 0)) + program.constant(sign) * shares.part(c))
        return outputs.total() if outputs.size > 1 else outputs


@dataclass(frozen=True, eq=False)
class Hierarchy:
    """A grown hierarchy, for any number of inputs.

    Attributes:
        cuts: (cuts, 1 + inputs).
        signs: (models, cuts).
        lines: (models, 1 + inputs).
        errors: (sizes,) mean squared test error with 2, 3, ... models; empty without test data.
    """

    cuts: Array
    signs: Array
    lines: Array
    errors: Array

    def predict(self, X: Array) -> Array:
        """Outputs (samples,) for inputs (samples, inputs)."""
        Z = np.column_stack([np.ones(len(X)), X])
        return np.einsum("ki,ki->k", _cells(Z @ self.cuts.T, self.signs), Z @ self.lines.T)


def grow(X: Array, y: Array, max_models: int, *, test: tuple[Array, Array] | None = None) -> Hierarchy:
    """Cut the cell that fits worst again and again, each time in the direction that leaves the smallest error.

    Args:
        X: (samples, inputs) inputs.
        y: (samples,) outputs.
        max_models: Most cells, two or more.
        test: Inputs and outputs; the size of the lowest error on them is kept. Growing ends after three cuts in a row
            that do not lower it.

    Returns:
        The hierarchy, on inputs as they were given.
    """
    low = X.min(axis=0)
    span = np.where(np.ptp(X, axis=0) > 0, np.ptp(X, axis=0), 1.0)
    back = np.eye(1 + X.shape[1])  # from numbers on scaled inputs to numbers on the inputs
    back[0, 1:] = -low / span
    back[1:, 1:] = np.diag(1 / span)
    Z = np.column_stack([np.ones(len(X)), (X - low) / span])
    cuts, signs = np.zeros((0, Z.shape[1])), np.zeros((1, 0))
    validity, lines = np.ones((1, len(y))), _line(Z, y, np.ones(len(y)))[None]
    errors: list[float] = []
    kept: Hierarchy | None = None
    while len(lines) < max(max_models, 2):
        outputs = lines @ Z.T
        error = (y - np.sum(validity * outputs, axis=0)) ** 2
        worst = int(np.argmax(validity @ error))
        mother = validity[worst]
        missed = y - np.sum(validity * outputs, axis=0) + mother * outputs[worst]
        cut = _best_cut(Z, y, missed, mother)
        share = _sigmoid(Z @ cut)
        halves = np.stack([mother * share, mother * (1 - share)])
        validity = np.vstack([validity, halves[1:]])
        validity[worst] = halves[0]
        lines = np.vstack([lines, _line(Z, y, halves[1])])
        lines[worst] = _line(Z, y, halves[0])
        cuts = np.vstack([cuts, cut])
        signs = np.column_stack([np.vstack([signs, signs[worst]]), np.zeros(len(lines))])
        signs[[worst, -1], -1] = 1.0, -1.0
        grown = Hierarchy(cuts @ back.T, signs, lines @ back.T, np.zeros(0))
        if test is None:
            kept = grown
            continue
        errors.append(float(np.mean((grown.predict(test[0]) - test[1]) ** 2)))
        if kept is None or errors[-1] == min(errors):
            kept = grown
        if len(errors) - 1 - int(np.argmin(errors)) > PATIENCE:
            break
    assert kept is not None
    return Hierarchy(kept.cuts, kept.signs, kept.lines, np.array(errors))


def _best_cut(Z: Array, y: Array, missed: Array, mother: Array) -> Array:
    """Offset and direction of the sigmoid that lets two linear models fit best, from the best cut along an axis on.

    `missed` is what the other cells leave of y.
    """

    def loss(cut: Array) -> float:
        share = _sigmoid(Z @ cut)
        left = missed
        for part in (mother * share, mother * (1 - share)):
            left = left - part * (Z @ _line(Z, y, part))
        return float(np.mean(left**2))

    mass = mother / mother.sum()
    centre = mass @ Z[:, 1:]
    spread = np.sqrt(mass @ (Z[:, 1:] - centre) ** 2) + 1e-9
    starts = []
    for axis in range(len(centre)):
        cut = np.zeros(Z.shape[1])
        cut[1 + axis] = STEEPNESS / spread[axis]
        cut[0] = -cut[1 + axis] * centre[axis]
        starts.append(cut)
    return np.asarray(minimize(loss, min(starts, key=loss), method="L-BFGS-B", options={"maxiter": ITERATIONS}).x)


def _line(Z: Array, y: Array, validity: Array) -> Array:
    weighted = Z.T * validity
    return np.asarray(np.linalg.solve(weighted @ Z + RIDGE * np.eye(Z.shape[1]), weighted @ y), dtype=np.float64)


def _cells(heights: Array, signs: Array) -> Array:
    """Validities (samples, models) from the heights (samples, cuts)."""
    shares = _sigmoid(heights)[:, None]
    return np.prod(np.where(signs > 0, shares, np.where(signs < 0, 1 - shares, 1.0)), axis=2)


def _sigmoid(heights: Array) -> Array:
    small: Array = np.exp(-np.abs(heights))
    larger: Array = np.where(heights < 0, small, 1.0).astype(np.float64)
    return larger / (1.0 + small)
