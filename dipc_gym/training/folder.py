"""The folder of a training: new, cleared of an earlier one, or found to hold the same."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

from dipc_gym.experiments import cells
from dipc_gym.safety.files import remove_partial, write_whole
from dipc_gym.safety.untrusted import Format, shown
from dipc_gym.training.recipe import TrainingError
from dipc_gym.training.task import Training

FILES = ("training.json", "checkpoint.pt", "policy.json", "compensator.json", "estimator.json", "curve.csv")
TRAINING = Format("note on a training", "train-policy", "start anew with --overwrite", 1_000_000, TrainingError)


def prepare(training: Training, out: Path, *, resume: bool, overwrite: bool) -> Path:
    """Make the folder, clear it, or see that it holds this training.

    Args:
        training: what is to be trained there.
        out: the folder.
        resume: it is to hold the same training already.
        overwrite: what an earlier training left there goes; nothing else does.

    Returns:
        The folder, with the training noted in its `training.json`.

    Raises:
        TrainingError: another training is there, or its note cannot be read; or `resume` is set and there is none.
        FileExistsError: it is not empty, and neither `resume` nor `overwrite` is set; or what would go is of none.
    """
    note = out / "training.json"
    if out.is_dir():
        remove_partial(out)
    files = cells.fingerprints(*training.named)
    wanted = json.loads(json.dumps({**training.to_dict(), "files": files}))
    if resume and not note.exists():
        raise TrainingError(f"{out}: there is no training to go on with; leave --resume out to begin one")
    if resume:
        for path in (out / name for name in FILES):
            if path.exists() and not path.is_file():  # opening a named pipe would wait for ever
                raise TrainingError(f"{path}: is no file; start anew with --overwrite")
        try:
            there = TRAINING.read(note)
            flat, other = _flat(wanted), _flat(there)
            kept = dict(there.get("files", {}))
        except (ValueError, AttributeError, LookupError, TypeError, RecursionError):
            raise TrainingError(f"{note}: cannot be read; start anew with --overwrite") from None
        for key in flat.keys() | other.keys():
            if flat.get(key) != other.get(key):
                raise TrainingError(
                    f"{note}, {shown(key)}: this training was begun with {shown(other.get(key))}, not "
                    f"{shown(flat.get(key))}; "
                    "resume with the same, or train into another folder"
                )
        for name, digest in files.items():
            if kept.get(name) != digest:
                raise TrainingError(
                    f"{name}: not the file that the training of {note} was begun with; put that back, or train into "
                    "another folder"
                )
        return out
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        if not out.is_dir() or not overwrite:
            raise FileExistsError(
                f"{out} exists and is not empty; choose another folder, or say --resume or --overwrite"
            )
        alien = [name for name in (*FILES, "tensorboard") if (out / name).exists()]
        if alien and not note.exists():
            raise FileExistsError(
                f"{out / alien[0]} is of no training, for there is no {note.name}; move it, or choose another folder"
            )
        for name in FILES:
            (out / name).unlink(missing_ok=True)
        shutil.rmtree(out / "tensorboard", ignore_errors=True)
    out.mkdir(parents=True, exist_ok=True)
    write_whole(note, (json.dumps(wanted, indent=2) + "\n").encode())
    return out


def _flat(training: dict[str, Any]) -> dict[str, Any]:
    """A note with the fields of its recipe beside the others, and without its files' digests."""
    recipe = {"engine": "mujoco", "episode": training["recipe"]["stage"], **training["recipe"]}  # notes may be older
    training = {"task": "balance", "estimator": None, "plan": "tvlqr", **training}
    return {key: value for key, value in training.items() if key not in ("recipe", "files")} | {
        f"recipe.{key}": value for key, value in recipe.items()
    }
