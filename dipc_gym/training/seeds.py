"""Many trainings of policies as one sweep: seeds or compensators side by side, here or on a Ray cluster."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from dipc_gym import sweep
from dipc_gym.experiments import cells
from dipc_gym.safety import intact
from dipc_gym.safety.alone import alone
from dipc_gym.safety.files import write_whole
from dipc_gym.safety.places import inside
from dipc_gym.sweep import Backend, Outcome
from dipc_gym.training import train
from dipc_gym.training.rig import Rig
from dipc_gym.training.task import Training

KEPT = ("training.json", "policy.json", "compensator.json", "estimator.json", "curve.csv")
CELLS = "trainings"  # folder for what `sweep.run` writes


@dataclass(frozen=True, kw_only=True)
class PolicyTraining:
    """Train a policy in a temporary folder, so that no disk need be shared with whoever asked for it.

    Attributes:
        training: what is trained.
        files: what `cells.fingerprints` says of the files that it names.
    """

    training: Training
    files: dict[str, str]

    @classmethod
    def of(cls, training: Training) -> PolicyTraining:
        """The cell of a training.

        Example:
            >>> PolicyTraining.of(Training(compensator="llnf", seed=3)).name
            'ppo-llnf-03'
        """
        named = cells.fingerprints(*training.named)
        return cls(training=training, files=named)

    @property
    def name(self) -> str:
        """Of its file, and of the folder for what it gives."""
        return f"{self.training.algorithm}-{cells.label(self.training.compensator)}-{self.training.seed:02d}"

    def run(self) -> dict[str, str]:
        """Train; the texts of the files that `train.run` leaves, by name, without checkpoint and TensorBoard's."""
        with tempfile.TemporaryDirectory(prefix="training-") as place:
            out = Path(place) / self.name
            train.run(self.training, out, quiet=True)
            kept = [out / name for name in KEPT]
            return {path.name: path.read_text(encoding="utf-8") for path in kept if path.exists()}

    def check(self, result: object) -> None:
        """Refuse what are no such files."""
        intact.fit(result, {str: str})
        intact.fit(result, {"policy.json": str})
        for name in result:  # type: ignore[attr-defined]
            if name not in KEPT:
                raise ValueError(f"has a file {name!r}, which no training leaves")


def run(
    trainings: Sequence[Training],
    out: str | Path,
    *,
    jobs: int | None = None,
    backend: Backend = "local",
    overwrite: bool = False,
) -> list[Outcome[PolicyTraining]]:
    """Train policies and leave each in a folder of its own, `ALGORITHM-COMPENSATOR-SEED` within `out`.

    A folder gets what `train.run` puts there, to the byte, but no checkpoint and no TensorBoard files. What is finished
    is on disk at once, and the same call goes on from there; a training that is killed begins anew. One that fails
    takes no other with it, and is tried again by the same call.

    Args:
        trainings: what to train.
        out: the folder, new, empty, or begun by the same call.
        jobs: trainings at a time; see `sweep.run`.
        backend: where they run; see `sweep.run`.
        overwrite: begin anew instead of going on with what the folder holds.

    Returns:
        What became of each, in the order given.

    Raises:
        ValueError: a training cannot be, or what the folder holds was begun with other parameters; see `sweep.run`.
        FileExistsError: the folder holds something else.
        BusyError: another run is at work there.
        ImportError: Ray is asked for and not installed.
    """
    sweep.check(jobs, backend)
    wanted = [PolicyTraining.of(training) for training in trainings]
    for training in {(t.compensator, t.estimator, t.plan, t.plant, t.model): t for t in trainings}.values():
        Rig.of(training)  # a rig that cannot be is refused before anything is written
    done = {}
    with alone(out):
        out = _folder(Path(out), overwrite)
        for outcome in sweep.run(wanted, inside(out, CELLS), jobs=jobs, backend=backend, label="train"):
            done[outcome.cell.name] = outcome
            if outcome.failure is None:
                keep(outcome, out)
    return [done[cell.name] for cell in wanted]


def keep(outcome: Outcome[PolicyTraining], out: Path) -> None:
    """Write what a training gave into its folder.

    Raises:
        PlaceError: a name leads out of that folder, as only a stranger's cell has it.
        OSError: it cannot be written.
    """
    folder = inside(out, outcome.cell.name)
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in outcome.result.items():
        write_whole(inside(folder, name), text.encode())


def _folder(out: Path, overwrite: bool) -> Path:
    """See that the folder is this sweep's or nobody's, or clear an earlier sweep's results, and no other file."""
    held = inside(out, CELLS)
    if out.exists() and not held.is_dir() and (not out.is_dir() or any(out.iterdir())):
        raise FileExistsError(f"{out} exists and holds no sweep of trainings; choose another folder")
    if overwrite and held.is_dir():
        done = sweep.written(held)
        if not done and any(held.iterdir()):
            raise FileExistsError(f"{held} holds no earlier sweep to overwrite; choose another folder")
        for cell in done:
            for name in KEPT:
                inside(out, f"{cell.stem}/{name}").unlink(missing_ok=True)
            cell.unlink()
    return out
