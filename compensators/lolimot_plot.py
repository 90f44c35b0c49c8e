"""Pictures of how LOLIMOT cut the space of inputs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from dipc_gym.compensators.lolimot import LOLIMOT

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Array = npt.NDArray[np.float64]

__all__ = ["boxes", "plot_partition"]


def boxes(model: LOLIMOT) -> tuple[Array, Array]:
    """Lower and upper corners of the boxes, (models, inputs) each, in units of X.

    Example:
        >>> x = np.linspace(-1, 1, 400)[:, None]
        >>> low, high = boxes(LOLIMOT(max_models=2).fit(x, np.abs(x[:, 0])))
        >>> low[:, 0].round(3).tolist(), high[:, 0].round(3).tolist()
        ([-1.0, 0.0], [0.0, 1.0])
    """
    half = model.sigmas_ * math.sqrt(-8 * math.log(model.border_validity)) / 2
    return model.centres_ - half, model.centres_ + half


def plot_partition(
    model: LOLIMOT,
    axes: tuple[int, int] = (0, 1),
    *,
    at: npt.ArrayLike | None = None,
    names: Sequence[str] | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Draw the boxes that a plane through the space of inputs meets, coloured by the network's output.

    Args:
        model: Fitted, with two inputs or more.
        axes: Inputs along the two axes of the picture.
        at: (inputs,) a point of the plane; by default the middle of the data's range.
        names: (inputs,) of the inputs; by default x0, x1, ...
        ax: What to draw on; by default new axes.

    Returns:
        The axes.

    Raises:
        ValueError: The inputs are not two different ones of the model's.
    """
    import matplotlib.pyplot as plt
    from matplotlib.patches import Rectangle

    inputs = model.n_features_in_
    if len(set(axes)) != 2 or not all(0 <= axis < inputs for axis in axes):
        raise ValueError(f"axes is {axes}; it must be two different inputs out of 0 to {inputs - 1}")
    low, high = boxes(model)
    point = (low.min(axis=0) + high.max(axis=0)) / 2 if at is None else np.asarray(at, dtype=np.float64)
    if point.shape != (inputs,):
        raise ValueError(f"at has shape {point.shape}; a point has {inputs} numbers")
    others = [i for i in range(inputs) if i not in axes]
    # Corners are worked out from centres and widths: those of neighbours differ by rounding. Of a point on a cut the
    # boxes above it are met, and at the upper end of the data those below.
    least, most = low.min(axis=0)[others], high.max(axis=0)[others]
    beside = 1e-9 * (most - least)
    here = np.clip(point[others], least, most - 2 * beside) + beside
    met = np.flatnonzero(((low[:, others] <= here) & (here < high[:, others])).all(axis=1))
    if ax is None:
        ax = plt.figure(figsize=(5, 4), layout="constrained").add_subplot()
    first, second = axes
    spans = [np.linspace(low[:, axis].min(), high[:, axis].max(), 200) for axis in axes]
    grid = np.tile(point, (200 * 200, 1))
    grid[:, first], grid[:, second] = (values.ravel() for values in np.meshgrid(*spans))
    picture = ax.pcolormesh(*spans, model.predict(grid).reshape(200, 200), cmap="viridis", rasterized=True)
    ax.figure.colorbar(picture, ax=ax, label="output")
    for i in met:
        corner = low[i, first], low[i, second]
        size = high[i, first] - low[i, first], high[i, second] - low[i, second]
        ax.add_patch(Rectangle(corner, *size, fill=False, edgecolor="white", linewidth=0.8))
    labels = names or [f"x{i}" for i in range(inputs)]
    ax.set(xlabel=labels[first], ylabel=labels[second], title=f"{len(met)} of {len(low)} boxes")
    return ax
