r"""How well pairs of estimator and compensator hold many rigs, all rigs of a pair at once in the vector environment.

    dipc-gym compare --out runs/rejection --seeds 20 --estimator disturbance --seconds 1 --compensator \
        feedforward,stribeck,friedland,mlp,llnf,llnf_lagged,llnf_adaptive,maxwell_slip,history,history_adapted,\
        disturbance_observer
    python -m benchmarks.rejection runs/rejection
    python -m benchmarks.rejection runs/rejection --axis friction --values 0.25,0.5,1,2,4 --seconds 20
    python -m benchmarks.rejection runs/rejection --ablation --axis friction --values 0.25,0.5,1,2,4 --seconds 20

The first command identifies twenty rigs and trains on each; the second balances them for 80 s under every pair below,
each rig with what was trained on it; the third changes the rigs after training, along an axis of `compare` or by the
step of the pole encoders alone; the fourth changes one part at a time, and says what that part is worth.
`compare` gives the same runs one by one; here they cost a quarter. Costs and the cart's excursions are compared rig by
rig with the first pair, or in the ablation with the pair that lacks the part: geometric mean of the ratios and its 95 %
interval, over the rigs on which both stood. What is printed is Markdown.

An estimator is told what the owner of a rig can read off its parts list: encoder, control period, supply. Friction and
blows come as a surprise.
"""

from __future__ import annotations

import argparse
import copy
import dataclasses
import json
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from dipc_gym import compensators, controllers, estimators, runs
from dipc_gym.compensators import (
    LLNF,
    MLP,
    AdaptedHistory,
    Compensator,
    History,
    Ideal,
    LuGre,
    Observed,
    StaticGain,
    Stribeck,
)
from dipc_gym.compensators.base import number_fields
from dipc_gym.controllers import LQR, lqr
from dipc_gym.estimators import Command, Differences, Disturbance, Estimator, ExtendedKalman, Kalman
from dipc_gym.experiments.compare import Comparison
from dipc_gym.experiments.robustness import AXES, Axis
from dipc_gym.experiments.tables import against_first
from dipc_gym.plant import Plant
from dipc_gym.policy import Policy
from dipc_gym.runs import Impulse
from dipc_gym.vector import DIPCFrictionVectorEnv

POLICY, OBSERVING = (f"dipc_gym/policies/{name}.json" for name in ("ppo-llnf", "ppo-observed"))
ESTIMATORS = (
    *(("differences", "none"), ("differences", "llnf"), ("differences", "lugre")),
    *(("kalman", "none"), ("kalman", "lugre"), ("kalman", "ideal"), ("kalman_friction", "lugre")),
    *(("disturbance", "none"), ("disturbance", "lugre"), ("disturbance", "observed")),
    *(("ekf", "lugre"), ("ekf", "observed"), ("moving_horizon", "lugre"), ("moving_horizon", "observed")),
)
COMPENSATORS = ("feedforward", "stribeck", "friedland", "mlp", "llnf", "llnf_lagged", "llnf_adaptive", "maxwell_slip")
OTHERS = ("history", "history_adapted", "disturbance_observer")
PAIRS = (
    *(("lqr", *pair) for pair in ESTIMATORS),
    *(("lqr", "kalman", name) for name in (*COMPENSATORS, *OTHERS)),
    *(("lqr_cart", "differences", "none"), ("lqr_cart", "kalman", "llnf"), ("lqr_cart", "kalman", "history_adapted")),
    *(("lqr_cart", "kalman", "lugre"), ("lqr_cart", "disturbance", "observed"), ("lqr_cart", "ekf", "observed")),
    *(("lqr_cart", "moving_horizon", "observed"), ("lqr_cart", "kalman", "ideal")),
    *(("lqr_quiet", "disturbance", "observed"), (POLICY, "differences", "llnf"), (POLICY, "kalman", "llnf")),
    *((POLICY, "disturbance", "observed"), (OBSERVING, "disturbance", "observed")),
)
CHANGED = (
    *(("lqr", "differences", name) for name in ("none", "feedforward", "mlp", "llnf")),
    *(("lqr", "kalman", "lugre"), ("lqr_cart", "kalman", "lugre")),
    *(("lqr", "disturbance", "observed"), ("lqr_cart", "disturbance", "observed"), ("lqr_cart", "ekf", "observed")),
    *((POLICY, "differences", "llnf"), (OBSERVING, "disturbance", "observed")),
)
"""What is compared on changed rigs."""
ABLATION = (
    *(("estimator", ("lqr", "differences", name), ("lqr", "kalman", name)) for name in ("none", "llnf", "lugre")),
    ("estimator", ("lqr", "kalman", "lugre"), ("lqr", "disturbance", "lugre")),
    *(("friction model", ("lqr", "kalman", "none"), ("lqr", "kalman", name)) for name in ("feedforward", "lugre")),
    ("friction model", ("lqr", "kalman", "feedforward"), ("lqr", "kalman", "stribeck")),
    ("friction model", ("lqr", "kalman", "feedforward"), ("lqr", "kalman", "llnf")),
    ("memory", ("lqr", "kalman", "lugre_static"), ("lqr", "kalman", "lugre")),
    ("memory", ("lqr", "kalman", "llnf"), ("lqr", "kalman", "llnf_lagged")),
    ("adaptation", ("lqr", "kalman", "friedland_fixed"), ("lqr", "kalman", "friedland")),
    ("adaptation", ("lqr", "kalman", "llnf"), ("lqr", "kalman", "llnf_adaptive")),
    ("other rigs", ("lqr", "kalman", "history"), ("lqr", "kalman", "history_adapted")),
    ("observation", ("lqr", "kalman", "none"), ("lqr", "kalman", "disturbance_observer")),
    ("observation", ("lqr", "disturbance", "none"), ("lqr", "disturbance", "observed")),
    ("observation", ("lqr", "disturbance", "lugre"), ("lqr", "disturbance", "observed")),
    ("what is left", ("lqr", "disturbance", "observed"), ("lqr", "disturbance", "ideal")),
    *(
        ("controller", ("lqr", *pair), ("lqr_cart", *pair))
        for pair in (("kalman", "lugre"), ("disturbance", "observed"))
    ),
)
"""What is changed, and a pair without and with it. `lugre_static` is `lugre` with the same numbers and no bristle: its
level at the velocity now, with the sign smoothed as `stribeck` found it best. `friedland_fixed` does not learn."""
AXES = {**AXES, "pole": Axis(label="pole encoder step, times the rig's", values=(), part="encoders", scaled=("pole",))}
SETTLED = 20.0

Row = dict[str, float | bool]


def balance(
    plants: list[Plant], brain: LQR | Policy, seeing: list[Estimator], inverse: list[Compensator], seconds: float
) -> list[Row]:
    """Balance every plant with its own estimator and compensator; what has fallen is not looked at any more."""
    n, period = len(plants), plants[0].control_period
    envs = DIPCFrictionVectorEnv(n, plant=plants[0], autoreset_mode="Disabled", threads=1)
    envs.reset(seed=0)
    for i, plant in enumerate(plants):
        mask = np.arange(n) == i
        envs.reset(seed=[i] * n, options={"plant": plant, "reset_mask": mask})  # as compare seeds that rig
    observed = np.hstack([envs.encoders, np.zeros((n, 3))])
    observed[:, 2] += observed[:, 1]
    eyes = together(seeing)
    states = [eye.initial_state(observed[rows]) for eye, rows in eyes]
    hands, begun = stacked(inverse)
    memory = [*begun]
    standing, cost, cart, held = np.ones(n, dtype=bool), np.zeros(n), np.zeros(n), np.zeros(n)
    supply, rig = plants[0].supply, seeing[0].rig
    modelled = seeing[0].name == "kalman_friction"  # the only one that asks what friction the compensator assumes
    observes = seeing[0].observes_friction
    for k in range(round(seconds / period)):
        truth, friction = envs.state, -envs.friction
        seen = np.vstack([eye.observation(state) for (eye, _), state in zip(eyes, states, strict=True)])
        if observes:
            sensed = np.concatenate([eye.friction(state) for (eye, _), state in zip(eyes, states, strict=True)])
        wanted = brain.command(seen) if isinstance(brain, Policy) else -seen @ brain.gain
        force = np.clip(wanted, -rig.largest_force, rig.largest_force)
        volts, before = np.zeros(n), list(memory)
        for i, (hand, rows) in enumerate(hands):
            known = {"friction": (sensed if hand.observed_friction else friction)[rows]} if hand.needs_friction else {}
            volts[rows], memory[i] = hand.voltage_batch(force[rows], seen[rows, 3], memory[i], **known)
        volts = np.where(standing, np.clip(volts, -supply, supply), 0.0)
        cost += standing * (np.einsum("ni,ij,nj->n", truth, lqr.RECOVERED_Q, truth) + lqr.R * force**2)
        held += standing * period
        if k * period >= min(SETTLED, seconds / 4):
            cart = np.maximum(cart, standing * np.abs(truth[:, 0]))
        ended = envs.step(volts[:, None])[2]
        standing &= ~ended
        if ended.any():
            envs.reset(options={"reset_mask": ended})
        if not standing.any():
            break
        readings = envs.encoders
        readings[:, 2] += readings[:, 1]

        def assumed(velocity: np.ndarray, force: np.ndarray = force, before: list[np.ndarray] = before) -> np.ndarray:
            given = np.empty(n)
            for (hand, rows), state in zip(hands, before, strict=True):
                given[rows] = hand.voltage_batch(force[rows], velocity[rows], state)[0]
            return rig.newtons_per_volt * given - force

        for i, (eye, rows) in enumerate(eyes):
            command = Command(force[rows], volts[rows], assumed if modelled else None)
            states[i] = eye.update(states[i], readings[rows], command)
    return [
        {"survived": bool(standing[i]), "cost": float(cost[i]), "cart_m": float(cart[i]), "seconds": float(held[i])}
        for i in range(n)
    ]


def struck(
    plants: list[Plant],
    brain: LQR | Policy,
    seeing: list[Estimator],
    inverse: list[Compensator],
    seconds: float,
    size: float,
) -> list[Row]:
    """The same, one rig after the other, each with a blow on its cart a quarter through the run, N s."""
    rows: list[Row] = []
    for i, (plant, eye, hand) in enumerate(zip(plants, seeing, inverse, strict=True)):
        blow = Impulse(size, seconds / 4)
        hand.reset()
        course = runs.balance(brain, hand, seconds=seconds, seed=i, plant=plant, impulse=blow, estimator=eye)
        x, force = course.state, course.force
        cost = np.einsum("ni,ij,nj->", x, lqr.RECOVERED_Q, x) + lqr.R * force @ force
        late = x[course.time >= seconds / 2, 0]  # when the blow is over
        cart = float(np.abs(late).max()) if len(late) else np.nan
        rows.append({"survived": not course.fell, "cost": float(cost), "cart_m": cart, "seconds": course.lasted})
    return rows


def together(seeing: list[Estimator]) -> list[tuple[Estimator, slice]]:
    """Estimators with the rows that they see: one for all where each row can have what its own rig has."""
    alike = len({each.rig for each in seeing}) == 1
    if not (alike and isinstance(seeing[0], Kalman | Disturbance | Differences | ExtendedKalman)):
        return [(each, slice(i, i + 1)) for i, each in enumerate(seeing)]
    one: Any = dataclasses.replace(seeing[0])
    if isinstance(one, Kalman | Disturbance):  # constant gains, which a product takes in a stack
        object.__setattr__(one, "_next", np.stack([each._next for each in seeing]))
    if isinstance(one, ExtendedKalman):  # numbers of friction, which are constants of its programs, a column each
        for name in ("_following", "_observing"):
            mine, *others = (getattr(each, name).prepared(np.dtype(np.float64))[0] for each in (one, *seeing))
            mine[:] = [np.hstack(columns) for columns in zip(*others, strict=True)]
        begin = np.vstack([each.begin(np.zeros((1, 6))) for each in seeing])
        object.__setattr__(one, "begin", lambda seen: np.hstack([seen, begin[:, 6:]]))
    return [(one, slice(0, len(seeing)))]


def stacked(inverse: list[Compensator]) -> tuple[list[tuple[Compensator, slice]], list[np.ndarray]]:
    """Compensators with the rows that they answer for, and their memory: one for all where its formula allows it.

    Formulas work entry by entry, so numbers may be arrays with an entry for each rig. A network with fewer local models
    than another gets some that are valid nowhere.
    """
    n, one, kind = len(inverse), copy.copy(inverse[0]), type(inverse[0])
    begun = [each.initial_state(1) for each in inverse]
    if kind is LLNF:
        models: list[list[Any]] = [each._models for each in inverse]  # type: ignore[attr-defined]
        nowhere = (1e6, 1e6, 1e6, 1e100, 1e100, 1e100, 0.0, 0.0, 0.0, 0.0)
        longest = max(map(len, models))
        padded = np.array([rows + [nowhere] * (longest - len(rows)) for rows in models])
        object.__setattr__(one, "_models", [tuple(row) for row in padded.transpose(1, 2, 0)])
    elif kind is MLP:
        neurons = np.array([each._neurons for each in inverse])  # type: ignore[attr-defined]
        object.__setattr__(one, "_neurons", [tuple(row) for row in neurons.transpose(1, 2, 0)])
        object.__setattr__(one, "outs", np.array([each.outs for each in inverse]).T)  # type: ignore[attr-defined]
    elif kind in (History, AdaptedHistory):
        for name in ("inward", "inner"):
            object.__setattr__(one, name, np.array([getattr(each, name) for each in inverse]))
        for name in ("outs", "direct"):
            object.__setattr__(one, name, np.array([getattr(each, name) for each in inverse]).T)
    elif all(not column.metadata.get("shape") for column in number_fields(kind)):
        for column in number_fields(kind):
            if column.name != "period":
                values = np.array([getattr(each, column.name) for each in inverse])
                object.__setattr__(one, column.name, values)
    else:
        return [(each, slice(i, i + 1)) for i, each in enumerate(inverse)], begun
    object.__setattr__(one, "supply", None)
    object.__setattr__(one, "_limits", [])  # of the training, whose warnings are not looked at here
    return [(one, slice(0, n))], [np.concatenate(begun)]


def trained(folder: Path, seed: int, estimator: str, compensator: str, plant: Plant) -> tuple[Estimator, Compensator]:
    """What was trained on a rig, told what encoder, period and supply it has now."""
    learned = json.loads((folder / "cells" / f"friction-{seed:02d}.json").read_text(encoding="utf-8"))["result"]
    seeing = estimators.load({**learned, "kind": estimator})
    told = dataclasses.replace(
        seeing.rig,
        cart_step=plant.encoders.cart,
        pole_step=plant.encoders.pole,
        period=plant.control_period,
        supply=plant.supply,
    )
    seeing = dataclasses.replace(seeing, rig=told)
    gain, dry = told.newtons_per_volt, seeing.dry
    known: dict[str, Compensator] = {
        "none": StaticGain(gain),
        "observed": Observed(gain),
        "ideal": Ideal(gain),
        "lugre": LuGre(
            *(gain, told.supply, told.period, dry.bristle_stiffness, dry.bristle_damping, dry.coulomb),
            *(dry.static - dry.coulomb, dry.stribeck_velocity),
        ),
    }

    def saved(name: str) -> Any:
        return compensators.load(folder / "compensators" / f"{name}-{seed:02d}.json")

    if compensator == "lugre_static":
        levels = (dry.coulomb / gain, (dry.static - dry.coulomb) / gain)
        known[compensator] = Stribeck(
            1 / gain, *levels, 0.0, 0.0, saved("stribeck").sign_velocity, dry.stribeck_velocity
        )
    if compensator == "friedland_fixed":
        known[compensator] = dataclasses.replace(saved("friedland"), rate=1e-12)
    return seeing, known[compensator] if compensator in known else saved(compensator)


Pair = tuple[str, str, str]


def tried(folder: Path, pair: Pair, plants: list[Plant], seconds: float, blow: float | None) -> list[Row]:
    """Balance all rigs with what was trained on each."""
    brain = controllers.load(pair[0])
    parts = [trained(folder, i, *pair[1:], plant) for i, plant in enumerate(plants)]
    seeing, inverse = [e for e, _ in parts], [c for _, c in parts]
    if blow is not None:
        return struck(plants, brain, seeing, inverse, seconds, blow)
    return balance(plants, brain, seeing, inverse, seconds)


def spread(rows: list[Row], key: str, scale: float, form: Callable[[float], str]) -> str:
    """Median (10th percentile to the worst) over the rigs that stood."""
    stood = [scale * row[key] for row in rows if row["survived"]]
    if not stood:
        return "-"
    low, mid, high = (form(value) for value in np.percentile(stood, [10, 50, 100]))
    return f"{mid} ({low} to {high})"


def ratio(rows: list[Row], first: list[Row], of: str) -> str:
    """Geometric mean of rows over first, rig by rig, and its 95 % interval; how many rigs, if not all."""
    cells = [
        {**row, "controller": who, "compensator": "", "seed": seed}
        for who, table in (("first", first), ("this", rows))
        for seed, row in enumerate(table)
    ]
    for found in against_first(cells, [("first", ""), ("this", "")], of):
        rigs = "" if found["rigs"] == len(rows) else f", {found['rigs']} rigs"
        return f"{found[f'{of}_ratio']:.2g} ({found['low']:.2g} to {found['high']:.2g}{rigs})"
    return "-"


def short(value: float) -> str:
    """Such as 6.2e6."""
    return f"{value:.1e}".replace("e+0", "e").replace("e+", "e")


def millimetres(value: float) -> str:
    """With a decimal below ten."""
    return f"{value:.1f}" if value < 9.95 else f"{value:.0f}"


def called(pair: Pair) -> str:
    """Controller, estimator and compensator as the columns of a table."""
    name = Path(pair[0]).stem
    return f"`{name}` | `{pair[1]}` | `{pair[2]}`"


def main() -> None:
    """Balance and print."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("folder", type=Path, help="of a compare run with its trained compensators")
    options.add_argument("--seeds", type=int, default=20)
    options.add_argument("--seconds", type=float, default=80.0)
    options.add_argument("--axis", choices=list(AXES), help="change the rigs after training")
    options.add_argument("--values", default="1", help="along the axis, with commas between")
    options.add_argument("--ablation", action="store_true", help="change one part at a time")
    options.add_argument("--pairs", help="controller:estimator:compensator, with commas between")
    given = options.parse_args()
    pairs = [*(CHANGED if given.axis else PAIRS)]
    if given.pairs:
        pairs = [tuple(pair.split(":")) for pair in given.pairs.split(",")]
    comparison = Comparison(seeds=given.seeds)
    warnings.simplefilter("ignore")  # a compensator asked outside its range says so once a rig
    for value in map(float, given.values.split(",")):
        plants = [comparison.rig(seed) for seed in range(given.seeds)]
        blow = value if given.axis == "impulse" else None
        if given.axis:
            plants = [AXES[given.axis].rig(plant, value) for plant in plants]
            print(f"\n{AXES[given.axis].label}: {value:g}\n")
        done: dict[Pair, list[Row]] = {}

        def rows(
            pair: Pair, plants: list[Plant] = plants, blow: float | None = blow, done: dict[Pair, list[Row]] = done
        ) -> list[Row]:
            if pair not in done:
                done[pair] = tried(given.folder, pair, plants, given.seconds, blow)
            return done[pair]

        if given.ablation:
            print("| part | without | with | J, times | cart, times |\n|---|---|---|---|---|")
            for part, without, taken in ABLATION:
                names = " | ".join(", ".join((Path(p[0]).stem, *p[1:])) for p in (without, taken))
                both = rows(taken), rows(without)
                print(f"| {part} | {names} | {ratio(*both, 'cost')} | {ratio(*both, 'cart_m')} |", flush=True)
        else:
            head = (
                "controller | estimator | compensator | stood | J | cart, mm | J over the first | cart over the first"
            )
            print(f"| {head} | time, s |\n|---|---|---|---|---|---|---|---|---|")
            for pair in pairs:
                began = time.process_time()
                mine, first = rows(pair), rows(pairs[0])
                stood = sum(bool(row["survived"]) for row in mine)
                sizes = f"{spread(mine, 'cost', 1.0, short)} | {spread(mine, 'cart_m', 1000.0, millimetres)}"
                ratios = f"{ratio(mine, first, 'cost')} | {ratio(mine, first, 'cart_m')}"
                took = time.process_time() - began
                print(f"| {called(pair)} | {stood}/{len(mine)} | {sizes} | {ratios} | {took:.0f} |", flush=True)


if __name__ == "__main__":
    main()
