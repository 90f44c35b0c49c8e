r"""How well pairs of estimator and compensator hold many rigs, all rigs of a pair at once in the vector environment.

    dipc-gym compare --out runs/rejection --seeds 20 --estimator disturbance --seconds 1 --compensator \
        feedforward,stribeck,friedland,mlp,llnf,llnf_lagged,llnf_adaptive,maxwell_slip,history,history_adapted,\
        disturbance_observer
    python -m benchmarks.rejection runs/rejection
    python -m benchmarks.rejection runs/rejection --axis friction --values 0.25,0.5,1,2,4 --seconds 20

The first command identifies twenty rigs and trains on each; the second balances them for 80 s under every pair below,
each rig with what was trained on it; the third changes the rigs after training, along an axis of `compare`.
`compare` gives the same runs one by one; here they cost a quarter. Costs are compared rig by rig with the first pair:
geometric mean of the ratios and its 95 % interval.

An estimator is told what the owner of a rig can read off its parts list: encoder, control period, supply. Friction and
blows come as a surprise.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import time
import warnings
from pathlib import Path

import numpy as np

from dipc_gym import compensators, controllers, estimators, runs
from dipc_gym.compensators import Compensator, Ideal, LuGre, Observed, StaticGain
from dipc_gym.controllers import LQR, lqr
from dipc_gym.estimators import Command, Differences, Disturbance, Estimator, Kalman
from dipc_gym.experiments.compare import Comparison
from dipc_gym.experiments.robustness import AXES
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
    *(("ekf", "lugre"), ("ekf", "observed")),
)
COMPENSATORS = ("feedforward", "stribeck", "friedland", "mlp", "llnf", "llnf_lagged", "llnf_adaptive", "maxwell_slip")
OTHERS = ("history", "history_adapted", "disturbance_observer")
PAIRS = (
    *(("lqr", *pair) for pair in ESTIMATORS),
    *(("lqr", "kalman", name) for name in (*COMPENSATORS, *OTHERS)),
    *(("lqr_cart", "differences", "none"), ("lqr_cart", "kalman", "llnf"), ("lqr_cart", "kalman", "history_adapted")),
    *(("lqr_cart", "kalman", "lugre"), ("lqr_cart", "disturbance", "observed"), ("lqr_cart", "ekf", "observed")),
    *(("lqr_quiet", "disturbance", "observed"), (POLICY, "differences", "llnf"), (POLICY, "kalman", "llnf")),
    *((POLICY, "disturbance", "observed"), (OBSERVING, "disturbance", "observed")),
)
CHANGED = (
    *(("lqr", "differences", "none"), ("lqr", "differences", "llnf"), ("lqr", "kalman", "llnf")),
    *(("lqr", "kalman", "lugre"), ("lqr_cart", "kalman", "lugre")),
    *(("lqr", "disturbance", "observed"), ("lqr_cart", "disturbance", "observed")),
)
"""What is compared on changed rigs."""
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
    alike = all(inv.to_dict()["parameters"] == inverse[0].to_dict()["parameters"] for inv in inverse)
    hands = [(inverse[0], slice(0, n))] if alike else [(inv, slice(i, i + 1)) for i, inv in enumerate(inverse)]
    memory = [hand.initial_state(len(range(n)[rows])) for hand, rows in hands]
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
    """Estimators with the rows that they see: one for all where each row can have the gain of its own rig."""
    rigs = {each.rig for each in seeing}
    if len(rigs) > 1 or not isinstance(seeing[0], Kalman | Disturbance | Differences):
        return [(each, slice(i, i + 1)) for i, each in enumerate(seeing)]
    one = dataclasses.replace(seeing[0])
    if isinstance(one, Kalman | Disturbance):  # constant gains, which a product takes in a stack
        object.__setattr__(one, "_next", np.stack([each._next for each in seeing]))
    return [(one, slice(0, len(seeing)))]


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
    path = folder / "compensators" / f"{compensator}-{seed:02d}.json"
    return seeing, known[compensator] if compensator in known else compensators.load(path)


def main() -> None:
    """Balance and print."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("folder", type=Path, help="of a compare run with its trained compensators")
    options.add_argument("--seeds", type=int, default=20)
    options.add_argument("--seconds", type=float, default=80.0)
    options.add_argument("--axis", choices=list(AXES), help="change the rigs after training")
    options.add_argument("--values", default="1", help="along the axis, with commas between")
    options.add_argument("--pairs", help="controller:estimator:compensator, with commas between")
    given = options.parse_args()
    pairs = [*(CHANGED if given.axis else PAIRS)]
    if given.pairs:
        pairs = [tuple(pair.split(":")) for pair in given.pairs.split(",")]
    comparison = Comparison(seeds=given.seeds)
    warnings.simplefilter("ignore")  # a compensator asked outside its range says so once a rig
    for value in map(float, given.values.split(",")):
        plants = [comparison.rig(seed) for seed in range(given.seeds)]
        if given.axis:
            plants = [AXES[given.axis].rig(plant, value) for plant in plants]
            print(f"{AXES[given.axis].label}: {value:g}")
        cells, named = [], []
        for controller, estimator, compensator in pairs:
            began, brain = time.process_time(), controllers.load(controller)
            parts = [trained(given.folder, i, estimator, compensator, plant) for i, plant in enumerate(plants)]
            seeing, inverse = [e for e, _ in parts], [c for _, c in parts]
            if given.axis == "impulse":
                rows = struck(plants, brain, seeing, inverse, given.seconds, value)
            else:
                rows = balance(plants, brain, seeing, inverse, given.seconds)
            name = f"{brain.name}+{estimator}"
            named.append((name, compensator))
            cells += [{**r, "controller": name, "compensator": compensator, "seed": s} for s, r in enumerate(rows)]
            stood = [r for r in rows if r["survived"]]
            line = f"{name:24s} {compensator:15s} stood {len(stood):2d}/{len(rows)}"
            for key, scale, form in (("cost", 1.0, ".2e"), ("cart_m", 1000.0, ".1f")):
                low, mid, high = np.percentile([scale * r[key] for r in stood] or [np.nan], [10, 50, 100])
                line += f"  {key} {mid:{form}} ({low:{form}} to {high:{form}})"
            print(f"{line}  {time.process_time() - began:.0f} s", flush=True)
        for row in against_first(cells, named):
            print(
                f"  {row['controller']}, {row['compensator']}: {row['cost_ratio']:.3g} times the first "
                f"({row['low']:.3g} to {row['high']:.3g}), less on {row['less_on']} of {row['rigs']}"
            )


if __name__ == "__main__":
    main()
