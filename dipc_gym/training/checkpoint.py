"""Where a training stands, on disk: the checkpoint that it goes on from, and the curve of its trials."""

from __future__ import annotations

import dataclasses
import io
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dipc_gym.safety import intact
from dipc_gym.safety.files import write_whole
from dipc_gym.safety.untrusted import first_line
from dipc_gym.training.recipe import TrainingError
from dipc_gym.training.task import SCHEMA


@dataclass(frozen=True)
class Look:
    """How the policy did at one moment of its training.

    Attributes:
        steps: control periods so far.
        seconds: of wall time so far, trials included.
        standing: runs out of ten that stood for 80 s.
        held: median time that runs lasted, s.
        reward: median over the runs of return over the largest possible.
    """

    steps: int
    seconds: float
    standing: int
    held: float
    reward: float

    @property
    def rank(self) -> tuple[int, float]:
        """What the best policy has the most of."""
        return self.standing, self.reward


LOOK = {"steps": int, "seconds": float, "standing": int, "held": float, "reward": float}  # as a checkpoint holds it


def write(learner: Any, looks: list[Look], out: Path) -> None:
    """Write where the training stands; what was there stays until the new one is whole.

    Args:
        learner: what learns.
        looks: the trials so far.
        out: folder of the training, which gets `checkpoint.pt`.

    Raises:
        OSError: the disk is full; the last checkpoint is whole.
    """
    import torch

    buffer = io.BytesIO()
    rows = [dataclasses.asdict(look) for look in looks]
    torch.save({"schema": SCHEMA, "looks": rows, "learner": learner.state()}, buffer)
    write_whole(out / "checkpoint.pt", buffer.getvalue())


def write_curve(looks: list[Look], out: Path) -> None:
    """Write the trials so far as `curve.csv`, a row each."""
    rows = [dataclasses.asdict(look) for look in looks]
    lines = [",".join(rows[0]), *(",".join(map(str, row.values())) for row in rows)]
    write_whole(out / "curve.csv", "".join(line + "\n" for line in lines).encode())


def restore(learner: Any, path: Path) -> list[Look]:
    """Put a learner where a checkpoint stands, executing nothing in it.

    Returns:
        The trials so far.

    Raises:
        TrainingError: it is no checkpoint of this training.
    """
    import torch

    try:
        stored = torch.load(path, map_location="cpu", weights_only=True)
        if stored["schema"] != SCHEMA:
            raise TrainingError(f"it is of the form {stored['schema']!r}; this version of dipc-gym writes {SCHEMA!r}")
        intact.fit(stored["looks"], [LOOK])
        learner.restore(stored["learner"])
        return [Look(**row) for row in stored["looks"]]
    except Exception as error:  # whatever a broken or hostile file makes torch raise
        said = f"no checkpoint of this training ({first_line(error)}); start anew with --overwrite"
        raise TrainingError(f"{path}: {said}") from None
