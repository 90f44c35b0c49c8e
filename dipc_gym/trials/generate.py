"""Make the trials: recordings and a nominal model for the tool, sealed answers for the scorer.

One seed determines everything. Each trial has its own seed sequence, so that it is the same whatever else is
generated, and a run that was interrupted goes on where it stopped.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from dipc_gym.trials import rigs
from dipc_gym.trials.catalogue import effects
from dipc_gym.trials.rigs import SAMPLE_TIME, SAMPLES, Rig, nominal_xml
from dipc_gym.trials.secret import Plan, Secret
from dipc_gym.trials.windows import Recording

SCHEMA = "dipc-gym/trial/1"
SMALL = {"null": 15, "single": 18, "pair": 3, "unknown": 3, "wrong": 3}
FULL = {"null": 150, "single": 182, "pair": 36, "unknown": 32, "wrong": 30}
RIG_WEIGHTS = {"cart": 0.3, "hanging": 0.2, "upright": 0.15, "motor_axis": 0.2, "pendulum": 0.15}
REDRAWS = 200


def plans(seed: int, *, count: int | None = None, full: bool = False) -> list[Plan]:
    """What each trial is to be.

    Args:
        seed: the seed.
        count: number of trials; the composition keeps its proportions. None: 42, or 430 with `full`.
        full: the long version.

    Raises:
        ValueError: `count` is below one.

    Example:
        >>> sum(plan.kind == "null" for plan in plans(1))
        15
    """
    if count is not None and count < 1:
        raise ValueError(f"count is {count}; it is the number of trials, 1 or more")
    rng = np.random.default_rng(np.random.SeedSequence([seed, 7]))
    amounts = FULL if full else SMALL
    kinds = [kind for kind, amount in amounts.items() for _ in range(amount)]
    kinds = [kinds[i] for i in rng.permutation(len(kinds))]
    while count is not None and len(kinds) < count:
        kinds = kinds + kinds
    kinds = kinds[:count]
    # Eight draws meet every variant of a rig.
    possible = {
        name: {e.name for other in range(8) for e in effects(make(np.random.default_rng(other)))}
        for name, make in rigs.RIGS.items()
    }
    ids = sorted({name for names in possible.values() for name in names})
    order: list[str] = []
    waiting: list[str] = []
    result = []
    for number, kind in enumerate(kinds, start=1):
        effect = ""
        names = list(RIG_WEIGHTS)
        if kind == "single":
            if not order:
                order = [ids[i] for i in rng.permutation(len(ids))]
            effect = order.pop()
            names = [name for name in names if effect in possible[name]]
        weights = np.array([RIG_WEIGHTS[name] for name in names])
        if kind != "single":
            # Every rig gets its share of the nulls and of the rest.
            if not waiting:
                waiting = [names[i] for i in rng.permutation(len(names))]
            rig = waiting.pop()
        else:
            rig = str(rng.choice(names, p=weights / weights.sum()))
        tuned = bool(rng.random() < 0.3) and kind in ("single", "pair") and rig != "upright"
        result.append(Plan(number, kind, rig, effect, tuned))
    return result


def generate(out: Path, *, seed: int, count: int | None = None, full: bool = False, jobs: int = 1) -> list[Plan]:
    """Write trials into `out/trials/NAME` and their answers into `out/sealed/NAME.json`.

    A trial whose answer is there is left alone. A folder made from another seed or composition is refused.

    Args:
        out: folder.
        seed: determines everything.
        count: number of trials, see `plans`.
        full: the long version.
        jobs: processes.

    Returns:
        The plans of all trials, made now or before.

    Raises:
        ValueError: `out` holds trials of another seed or composition.

    Example:
        >>> from pathlib import Path
        >>> made = generate(Path("runs/trial"), seed=1, count=2)  # doctest: +SKIP
    """
    from joblib import Parallel, delayed
    from tqdm import tqdm

    wanted = plans(seed, count=count, full=full)
    (out / "sealed").mkdir(parents=True, exist_ok=True)
    note = out / "generator.json"
    identity = {"schema": SCHEMA, "seed": seed, "full": full, "plans": len(wanted)}
    if note.exists():
        found = json.loads(note.read_text(encoding="utf-8"))
        if found != identity:
            raise ValueError(f"{note}: made with {found}, asked for {identity}; choose another folder")
    note.write_text(json.dumps(identity, indent=1), encoding="utf-8")
    missing = [plan for plan in wanted if not (out / "sealed" / f"{plan.name}.json").exists()]
    runs = Parallel(n_jobs=jobs, return_as="generator_unordered")(
        delayed(make_trial)(out, plan, seed) for plan in missing
    )
    for _ in tqdm(runs, total=len(missing), desc="generate", disable=None):
        pass
    return wanted


def make_trial(out: Path, plan: Plan, seed: int) -> None:
    """Make one trial; the answer is written last."""
    rng = np.random.default_rng(np.random.SeedSequence([seed, plan.number]))
    for _ in range(REDRAWS):
        trial = Secret.drawn(plan, rng)
        if trial.worth_keeping():
            break
    else:
        raise RuntimeError(f"{plan.name}: no usable rig with {plan.effect or plan.kind} found; change the seed")
    answer = {"schema": SCHEMA, "trial": plan.name, "seed": [seed, plan.number], **trial.answer(plan)}
    folder = out / "trials" / plan.name
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "nominal.xml").write_text(nominal_xml(trial.rig, trial.nominal), encoding="utf-8")
    for name, recording in zip(("train_1", "train_2", "test"), trial.recordings, strict=True):
        write_csv(folder / f"{name}.csv", trial.rig, recording)
    (out / "sealed" / f"{plan.name}.json").write_text(json.dumps(answer, indent=1), encoding="utf-8")


def write_csv(path: Path, rig: Rig, recording: Recording) -> None:
    """Write what a rig's owner would have: time, command, encoders."""
    time = np.arange(SAMPLES) * SAMPLE_TIME
    table = np.column_stack([time, recording.command, recording.measured])
    header = ",".join(("time", "motor", *rig.joints))
    np.savetxt(path, table, fmt="%.9g", delimiter=",", header=header, comments="")
