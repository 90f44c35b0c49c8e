"""The same trials given to rivals: a refit by `mujoco.sysid`, a network that learns the residual force, and PySINDy.

None can name what is missing; what they can be compared by is the held-out error.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dipc_gym import sweep
from dipc_gym.safety import intact
from dipc_gym.safety.alone import alone
from dipc_gym.safety.files import write_json, write_whole
from dipc_gym.safety.intact import DamagedError
from dipc_gym.safety.places import inside
from dipc_gym.sweep import Backend
from dipc_gym.trials import records
from dipc_gym.trials.generate import generate
from dipc_gym.trials.grade import CLEAR, in_noise
from dipc_gym.trials.run import processes, swept

NAMES = {"sysid": "`mujoco.sysid` refit", "network": "residual network", "sparse": "PySINDy on estimated forces"}


@dataclass(frozen=True, kw_only=True)
class Contest:
    """Fit the rivals to one trial, and measure their held-out errors.

    Attributes:
        folder: of the trial; other nodes need it under the same path.
        noise: of the sensors, SI units; all that is taken from the sealed answer.
    """

    folder: str
    noise: tuple[float, ...]

    @property
    def name(self) -> str:
        """Of the trial."""
        return Path(self.folder).name

    def run(self) -> dict[str, Any]:
        """Fit; of each rival `seconds` and `error` (in units of noise, None if it diverges), and sysid's `factors`."""
        import mujoco

        from dipc_gym.mjcf import quiet_mujoco
        from dipc_gym.trials.network import learn
        from dipc_gym.trials.refit import refit
        from dipc_gym.trials.replayed import Motion, error
        from dipc_gym.trials.sparse import discover

        quiet_mujoco()
        folder, noise = Path(self.folder), np.array(self.noise)
        motions = [Motion.read(folder / f"train_{k}.csv") for k in (1, 2)]
        test = Motion.read(folder / "test.csv")
        begun = time.perf_counter()
        model, factors = refit(folder / "nominal.xml", motions, noise)
        note: dict[str, Any] = {"sysid": {"seconds": time.perf_counter() - begun, "factors": factors}}
        note["sysid"]["error"] = _finite(error(model, test, noise))
        nominal = mujoco.MjModel.from_xml_path(str(folder / "nominal.xml"))
        for rival, learns in (("network", learn), ("sparse", discover)):
            begun = time.perf_counter()
            force = learns(nominal, motions, noise)
            note[rival] = {"seconds": time.perf_counter() - begun, "kept": force is not None}
            note[rival]["error"] = _finite(error(nominal, test, noise, force))
        return note

    def check(self, result: Any) -> None:
        """Refuse what no contest gives."""
        intact.fit(result, records.CONTEST)


def compare(
    out: Path, *, seed: int, count: int | None = None, full: bool = False, laws: bool = False,
    jobs: int | None = None, backend: Backend = "local",
) -> list[dict[str, Any]]:  # fmt: skip
    """Give the trials of a folder to the rivals, and write `rivals.md` and `rivals.json`.

    Trials that they have seen are left alone; trials that are not there are generated.

    Args:
        out: folder.
        seed: see `dipc_gym.trials.run.trial`.
        count: likewise.
        full: likewise.
        laws: likewise.
        jobs: likewise.
        backend: likewise.

    Returns:
        One entry a trial that they have seen: what was hidden, and everybody's held-out error in units of noise.
    """
    sweep.check(jobs, backend)
    with alone(out):
        return _compare(out, seed, count, full, laws, jobs, backend)


def _compare(
    out: Path, seed: int, count: int | None, full: bool, laws: bool, jobs: int | None, backend: Backend
) -> list[dict[str, Any]]:
    made = generate(out, seed=seed, count=count, full=full, laws=laws, jobs=processes(jobs, backend))
    names = [plan.name for plan in made]
    contests = [
        Contest(
            folder=str((out / "trials" / name).absolute()), noise=tuple(records.answer(out, name)["noise"].values())
        )
        for name in names
        if not _done(out, name)
    ]
    try:
        for name, note in swept(contests, jobs=jobs, backend=backend, label="rivals"):
            inside(out, f"results/{name}").mkdir(parents=True, exist_ok=True)
            intact.write(inside(out, f"results/{name}/rivals.json"), note)
    finally:
        rows = [row for name in names if (row := _row(out, name))]
        write_json(out / "rivals.json", {"seed": seed, "trials": rows})
        write_whole(out / "rivals.md", markdown(rows, seed=seed).encode())
    return rows


def _done(out: Path, name: str) -> bool:
    note = inside(out, f"results/{name}/rivals.json")
    if not note.exists():
        return False
    try:
        records.contest(out, name)
    except DamagedError as damage:
        intact.set_aside(note, damage)
        return False
    return True


def _row(out: Path, name: str) -> dict[str, Any] | None:
    if not (out / "results" / name / "rivals.json").exists():
        return None
    answer, rivals = records.answer(out, name), records.contest(out, name)
    ours = None
    if (out / "results" / name / "attempt.json").exists():
        try:
            ours = records.attempt(out, name)[0]["sensor_errors"]
        except DamagedError as damage:  # the others' errors stand; who diagnoses again sets it aside
            print(f"{damage}; counted as none", file=sys.stderr)
    return {
        "trial": name,
        "known_friction": answer["known_friction"],
        "kind": answer["kind"],
        "size": answer["share_of_signal"],
        "truth": [m["effect"] for m in answer["missing"]],
        "predictable": answer["held_out_predictable"],
        "error": {
            "nominal": answer["test_error"]["nominal"],
            **{rival: rivals[rival]["error"] for rival in NAMES},
            "diagnose": None if ours is None else in_noise(ours, answer["noise"]),
            "truth": answer["test_error"]["truth"],
        },
        "seconds": {rival: rivals[rival]["seconds"] for rival in NAMES},
    }


def markdown(rows: Sequence[Mapping[str, Any]], *, seed: int) -> str:
    """The rivals' table: median held-out error (quartiles) by class of trial.

    Rivals are simulated by MuJoCo, whose dry friction is soft: a model that knows dry friction predicts to twice the
    noise there even if nothing is missing, and such trials are left out.

    Args:
        rows: from `compare`.
        seed: of the trials.
    """
    left_out = sum(row["known_friction"] for row in rows)
    rows = [row for row in rows if not row["known_friction"]]
    classes = {
        "nothing missing": [r for r in rows if r["kind"] == "null"],
        "effects of twice the noise or more": [
            r for r in rows if r["kind"] in ("single", "pair") and r["size"] >= CLEAR and r["predictable"]
        ],
        "smaller effects": [r for r in rows if r["kind"] in ("single", "pair") and r["size"] < CLEAR],
        "unknown physics": [r for r in rows if r["kind"] == "unknown"],
        "wrong parameters": [r for r in rows if r["kind"] == "wrong"],
    }
    classes = {name: some for name, some in classes.items() if some}
    titles = {"nominal": "model as given", **NAMES, "diagnose": "`dipc-gym diagnose`", "truth": "true structure"}
    says = {
        "nominal": "nothing",
        "sysid": "its parameters; no structure",
        "network": "nothing",
        "sparse": "a formula",
        "diagnose": "what, where, how much",
        "truth": "",
    }
    lines = [
        f"Held-out error in units of the sensors' noise, median (quartiles), seed {seed}:",
        "",
        "| | " + " | ".join(f"{name} ({len(some)})" for name, some in classes.items()) + " | can say |",
        "|---" * (len(classes) + 2) + "|",
    ]
    for key, title in titles.items():
        cells = [_cell([r["error"][key] for r in some]) for some in classes.values()]
        lines.append(f"| {title} | " + " | ".join(cells) + f" | {says[key]} |")
    if rows:
        spent = ", ".join(f"{NAMES[k]} {np.median([r['seconds'][k] for r in rows]):.0f}" for k in NAMES)
        lines += ["", f"Median seconds a trial: {spent}."]
        both = [r["error"] for r in rows if r["kind"] not in ("null", "wrong")]
        ahead = [f"{name} in {sum(_no_worse(e, rival) for e in both)}" for rival, name in NAMES.items()]
        lines += ["", f"Where something is hidden, `diagnose` is at or below {', '.join(ahead)} of {len(both)}."]
        if left_out:
            lines += ["", f"Left out are {left_out} whose model has dry friction, which MuJoCo makes soft for rivals."]
        missing = sum(row["error"]["diagnose"] is None for row in rows)
        if missing:
            lines += ["", f"`diagnose` has no error in {missing}, not run or failed, which its medians leave out."]
        for rival, name in NAMES.items():
            gone = sum(r["error"][rival] is None for r in rows)
            if gone:
                lines += ["", f"{name} diverges on the held-out recording in {gone}, which its medians leave out."]
    return "\n".join(lines) + "\n"


def _no_worse(error: Mapping[str, float | None], rival: str) -> bool:
    """Whether `diagnose` came to an error, and the rival to none that is smaller."""
    own, other = error["diagnose"], error[rival]
    return own is not None and (other is None or own <= other)


def _finite(error: float) -> float | None:
    """An error as a record holds it."""
    return error if math.isfinite(error) else None


def _cell(errors: Sequence[float | None]) -> str:
    known = [e for e in errors if e is not None]
    if not known:
        return ""
    low, median, high = np.quantile(known, [0.25, 0.5, 0.75])
    return f"{median:.3g} ({low:.3g} to {high:.3g})"
