"""Make the trials: recordings and a nominal model for the tool, sealed answers for the scorer.

One seed determines everything. Each trial has its own seed sequence, so that it is the same whatever else is
generated, and a run that was interrupted goes on where it stopped.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dipc_gym.safety import intact
from dipc_gym.safety.files import whole, write_whole
from dipc_gym.safety.intact import DamagedError
from dipc_gym.safety.interrupts import held_back
from dipc_gym.safety.places import inside
from dipc_gym.trials import records, rigs, shapes
from dipc_gym.trials.catalogue import effects
from dipc_gym.trials.prediction import Recording
from dipc_gym.trials.rigs import SAMPLE_TIME, SAMPLES, Rig, nominal_xml
from dipc_gym.trials.secret import Plan, Secret

SCHEMA = "dipc-gym/trial/1"
SMALL = {"null": 15, "single": 18, "pair": 3, "unknown": 3, "wrong": 3}  # trials of each kind
LAWS = {"single": 60, "unknown": 60, "null": 30}  # trials of each kind, with --laws
BESIDE = 1 / 3  # of the laws that are hidden beside an effect with a name
FULL = {"null": 150, "single": 182, "pair": 36, "unknown": 32, "wrong": 30}  # trials of each kind, with --full
# Shares of the trials.
RIG_WEIGHTS = {"cart": 0.3, "hanging": 0.2, "upright": 0.15, "motor_axis": 0.2, "pendulum": 0.15}
REDRAWS = 200  # of a trial whose hidden physics does not suit its rig, at most
GIVEN = ("nominal.xml", "train_1.csv", "train_2.csv", "test.csv")


def plans(seed: int, *, count: int | None = None, full: bool = False, laws: bool = False) -> list[Plan]:
    """What each trial is to be.

    Args:
        seed: the seed.
        count: number of trials: the first of those that there are, which are in an order drawn at random, again and
            again. None: 42, 430 with `full`, 150 with `laws`.
        full: the long version.
        laws: the trial of laws: shapes of no formula, of physics with a name and without.

    Raises:
        ValueError: `count` is below one.

    Example:
        >>> sum(plan.kind == "null" for plan in plans(1))
        15
    """
    if count is not None and count < 1:
        raise ValueError(f"count is {count}; it is the number of trials, 1 or more")
    rng, other = (np.random.default_rng(np.random.SeedSequence([seed, k])) for k in (7, 8))
    amounts = LAWS if laws else FULL if full else SMALL
    hides = shapes.named if laws else effects
    kinds = [kind for kind, amount in amounts.items() for _ in range(amount)]
    kinds = [kinds[i] for i in rng.permutation(len(kinds))]
    while count is not None and len(kinds) < count:
        kinds = kinds + kinds
    kinds = kinds[:count]
    # Eight draws meet every variant of a rig.
    possible = {
        name: {e.name for draw in range(8) for e in hides(make(np.random.default_rng(draw)))}
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
            # Rigs take turns, whatever their weights are for single effects.
            if not waiting:
                waiting = [names[i] for i in rng.permutation(len(names))]
            rig = waiting.pop()
        else:
            rig = str(rng.choice(names, p=weights / weights.sum()))
        tuned = bool(rng.random() < 0.3) and kind in ("single", "pair") and rig != "upright"
        beside = laws and kind != "null" and bool(other.random() < BESIDE)
        result.append(Plan(number, kind, rig, effect, tuned and not laws, laws, beside))
    return result


def generate(
    out: Path, *, seed: int, count: int | None = None, full: bool = False, laws: bool = False, jobs: int = 1
) -> list[Plan]:
    """Write trials into `out/trials/NAME` and their answers into `out/sealed/NAME.json`.

    A trial whose answer is there is left alone; one that was damaged is set aside and made again. A folder made from
    another seed or composition is refused.

    Args:
        out: folder.
        seed: determines everything.
        count: number of trials, see `plans`.
        full: the long version.
        laws: the trial of laws.
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

    wanted = plans(seed, count=count, full=full, laws=laws)
    for part in ("sealed", "trials", "results"):
        inside(out, part).mkdir(parents=True, exist_ok=True)
    note = out / "generator.json"
    identity: dict[str, object] = {"schema": SCHEMA, "seed": seed, "full": full, "plans": len(wanted)}
    identity |= {"laws": True} if laws else {}
    same_trials(note, identity)
    intact.write(note, identity)
    missing = [plan for plan in wanted if not _made(out, plan, seed)]
    with held_back():
        runs = Parallel(n_jobs=jobs, return_as="generator_unordered")(
            delayed(make_trial)(out, plan, seed) for plan in missing
        )
    for _ in tqdm(runs, total=len(missing), desc="generate", disable=None):
        pass
    return wanted


def same_trials(note: Path, identity: dict[str, object]) -> None:
    """Refuse a folder whose note says that other trials are in it.

    Raises:
        ValueError: naming both.
    """
    if not note.exists():
        return
    try:
        found = intact.read(note, {"schema": str, "seed": int, "full": bool, "plans": int})
    except DamagedError as damage:
        intact.set_aside(note, damage)
        return
    if found != identity:
        raise ValueError(f"{note}: made with {found!s:.200}, asked for {identity}; choose another folder")


def _made(out: Path, plan: Plan, seed: int) -> bool:
    path = inside(out, f"sealed/{plan.name}.json")
    if not path.exists():
        return False
    try:
        held = records.answer(out, plan.name)
    except DamagedError as damage:
        intact.set_aside(path, damage)
        return False
    if (origin := held.get("seed", [seed, plan.number])) != [seed, plan.number]:
        raise ValueError(f"{path}: made with seed {origin}, asked for {[seed, plan.number]}; choose another folder")
    return True


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
    folder = inside(out, f"trials/{plan.name}")
    folder.mkdir(parents=True, exist_ok=True)
    write_whole(folder / "nominal.xml", nominal_xml(trial.rig, trial.nominal).encode())
    for name, recording in zip(("train_1", "train_2", "test"), trial.recordings, strict=True):
        write_csv(folder / f"{name}.csv", trial.rig, recording)
    files = {name: (folder / name).read_bytes() for name in GIVEN}
    intact.write(inside(out, f"sealed/{plan.name}.json"), {**answer, "files": records.digests(files)})


def write_csv(path: Path, rig: Rig, recording: Recording) -> None:
    """Write what a rig's owner would have: time, command, encoders."""
    time = np.arange(SAMPLES) * SAMPLE_TIME
    table = np.column_stack([time, recording.command, recording.measured])
    header = ",".join(("time", "motor", *rig.joints))
    with whole(path) as file:
        np.savetxt(file, table, fmt="%.9g", delimiter=",", header=header, comments="")
