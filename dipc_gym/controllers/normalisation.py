"""What observations were normalised with, in a file beside the policy that expects them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dipc_gym.policy import ControllerError
from dipc_gym.safety import untrusted
from dipc_gym.safety.files import write_json

Array = NDArray[np.float64]

SCHEMA = "dipc-gym/statistics/1"
FORMAT = untrusted.Format(
    "file of statistics", "sb3.save_statistics", "save the statistics again", 10_000, ControllerError
)
SIZE = 6  # of an observation


@dataclass(frozen=True, eq=False)
class Statistics:
    """Running statistics of observations, as `VecNormalize` of stable-baselines3 keeps them.

    Attributes:
        mean: (6,).
        variance: (6,).
        count: observations that they come from.
        epsilon: added to the variance.
        clip: largest normalised number, either way.

    Example:
        >>> statistics = Statistics(np.full(6, 0.1), np.full(6, 0.04), 1000.0, 0.0)
        >>> statistics.normalised(np.full(6, 0.3))[0].round(6).item()
        1.0
    """

    mean: Array
    variance: Array
    count: float
    epsilon: float = 1e-8
    clip: float = 10.0

    def normalised(self, observation: Array) -> Array:
        """What the policy sees of an observation (..., 6)."""
        return np.clip((observation - self.mean) / np.sqrt(self.variance + self.epsilon), -self.clip, self.clip)

    def save(self, policy: str | Path) -> Path:
        """Write them beside a policy file, as JSON that appears whole or not at all.

        Raises:
            OSError: it cannot be written.
        """
        path = place(policy)
        numbers = {"mean": self.mean.tolist(), "variance": self.variance.tolist()}
        write_json(path, {"schema": SCHEMA, **numbers, "count": self.count, "epsilon": self.epsilon, "clip": self.clip})
        return path

    @classmethod
    def load(cls, policy: str | Path) -> Statistics:
        """Read those beside a policy file; everything is checked.

        Raises:
            ControllerError: the file cannot be read, or a field is missing, unknown, or not what it must be.
        """
        path = place(policy)
        return _Reader(FORMAT, str(path)).statistics(FORMAT.read(path))


def place(policy: str | Path) -> Path:
    """Where the statistics of a policy file stand.

    Example:
        >>> place("runs/policy.zip").name
        'policy.statistics.json'
    """
    return Path(policy).with_suffix(".statistics.json")


class _Reader(untrusted.Reader):
    """Takes statistics from untrusted data."""

    def statistics(self, data: Any) -> Statistics:
        self.document(data, SCHEMA, ("mean", "variance", "count", "epsilon", "clip"))
        mean, variance = (self.entries(data[name], name, SIZE) for name in ("mean", "variance"))
        return Statistics(
            np.array([self.number(value, f"mean[{i}]") for i, value in enumerate(mean)]),
            np.array([self.positive(value, f"variance[{i}]") for i, value in enumerate(variance)]),
            self.positive(data["count"], "count"),
            self.positive(data["epsilon"], "epsilon"),
            self.positive(data["clip"], "clip"),
        )
