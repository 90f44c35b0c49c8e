"""What a diagnosis has left, and `report` and `export` read again."""

from __future__ import annotations

import functools
import json
import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
from rigs import MODEL, code_folder, stuck
from target import BOTH, Target, as_json, finite

from dipc_gym import mjcf, recording
from dipc_gym.dataflow import NoForm
from dipc_gym.export import law
from dipc_gym.sim2real import SavedError, redraw
from dipc_gym.sim2real.effects.shared.law import described

LAWS: tuple[dict[str, Any], ...] = (
    described(
        "force", [{"name": "position axis", "unit": "rad", "knots": [0.0, 1.0, 3.0]}], [1.0, 2.0, 0.5], "N m",
        passive=False,
    ),
    described(
        "force",
        [
            {"name": "velocity axis", "unit": "rad/s", "knots": [-1.0, 1.0]},
            {"name": "command motor", "unit": "", "knots": [0.0, 5.0]},
        ],
        [[0.0, 1.0], [2.0, 3.0]], "N m", passive=False,
    ),
)  # fmt: skip


@functools.cache
def _folder() -> dict[str, bytes]:
    """What a diagnosis has left of an axis with dry friction; a law stands beside what was found."""
    from dipc_gym.sim2real.diagnosis import diagnose
    from dipc_gym.sim2real.effects import catalogue
    from dipc_gym.sim2real.report import folder

    with tempfile.TemporaryDirectory() as place, mock.patch.dict(os.environ, {"XDG_CACHE_HOME": code_folder()}):
        (Path(place) / "run.csv").write_bytes(stuck())
        source = mjcf.from_text(MODEL)
        runs = recording.read_all([Path(place) / "run.csv"], mjcf.compile(source))
        found = diagnose(source, runs, effects=[catalogue()["friction.coulomb"]], threads=1)
        folder.save(found, Path(place) / "found", model="rig.xml", command="dipc-gym diagnose")
        left = {path.name: path.read_bytes() for path in (Path(place) / "found").glob("*.json")}
    said = json.loads(left["diagnosis.json"])
    said["missing"] = [
        {**said["missing"][0], "effect": "load.position", "at": f"axis{k}", "law": one} for k, one in enumerate(LAWS)
    ]
    return left | {"diagnosis.json": as_json(said)}


def _redrawn(folder: Path) -> None:
    redraw(folder)


def _exported(folder: Path) -> None:
    """What `export` writes of a law; it must be one, wherever it is asked."""
    for k in range(len(LAWS)):
        found = law.read(folder / "diagnosis.json", f"load.position@axis{k}")
        places = [np.array([-1e3, 0.5, 1e3])] * len(found.inputs)
        finite(found(*places, speed=None if found.driven_up_to is None else np.ones(3)))
        (folder / "law.csv").write_text(found.csv())
        (folder / "law.h").write_text(found.c("law"))


TARGETS: dict[str, Callable[[], Target]] = {
    "report": lambda: Target(_folder(), dict.fromkeys(_folder(), BOTH), _redrawn, (SavedError,)),
    "law to export": lambda: Target(_folder(), {"diagnosis.json": BOTH}, _exported, (law.LawError, NoForm)),
}
