r"""How well pairs of estimator and compensator hold many rigs, all rigs of a pair at once in the vector environment.

    dipc-gym compare --out runs/rejection --seeds 20 --estimator disturbance --seconds 1 \
        --compensator llnf,observed,llnf_adaptive,history,history_adapted
    python -m benchmarks.rejection runs/rejection

The first command identifies twenty rigs and trains on each; the second balances them for 80 s under every pair below,
each rig with what was trained on it. `compare` gives the same runs one by one; here they cost a quarter. Costs are
compared rig by rig with the first pair: geometric mean of the ratios and its 95 % interval.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import warnings
from pathlib import Path

import numpy as np

from dipc_gym import compensators, controllers, estimators
from dipc_gym.compensators import Compensator, Ideal, LuGre, Observed, StaticGain
from dipc_gym.controllers import LQR, lqr
from dipc_gym.estimators import Command, Differences, Disturbance, Estimator, Kalman
from dipc_gym.experiments.compare import Comparison
from dipc_gym.experiments.robustness import AXES
from dipc_gym.experiments.tables import against_first
from dipc_gym.plant import Plant
from dipc_gym.policy import Policy
from dipc_gym.vector import DIPCFrictionVectorEnv

POLICY = "dipc_gym/policies/ppo-llnf.json"
PAIRS = (
    *(("lqr", "differences", "none"), ("lqr", "differences", "llnf")),
    *(("lqr", "kalman", "none"), ("lqr", "kalman", "ideal"), ("lqr", "disturbance", "observed")),
    *(("lqr_cart", "disturbance", "observed"), ("lqr_quiet", "disturbance", "observed")),
    *(("lqr", "kalman", "lugre"), ("lqr_cart", "kalman", "lugre"), ("lqr", "kalman", "llnf")),
    *(("lqr", "kalman", "llnf_adaptive"), ("lqr", "kalman", "history"), ("lqr", "kalman", "history_adapted")),
    *((POLICY, "differences", "llnf"), (POLICY, "kalman", "llnf")),
)
SETTLED = 20.0


def balance(
    plants: list[Plant], brain: LQR | Policy, seeing: list[Estimator], inverse: list[Compensator], seconds: float
) -> list[dict[str, float | bool]]:
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
    states = eyes.initial_state(observed)
    alike = all(inv.to_dict()["parameters"] == inverse[0].to_dict()["parameters"] for inv in inverse)
    hands = [(inverse[0], slice(0, n))] if alike else [(inv, slice(i, i + 1)) for i, inv in enumerate(inverse)]
    memory = [hand.initial_state(len(range(n)[rows])) for hand, rows in hands]
    standing, cost, cart, held = np.ones(n, dtype=bool), np.zeros(n), np.zeros(n), np.zeros(n)
    supply, largest = plants[0].supply, seeing[0].rig.largest_force
    for k in range(round(seconds / period)):
        truth, friction = envs.state, -envs.friction
        seen = eyes.observation(states)
        wanted = brain.command(seen) if isinstance(brain, Policy) else -seen @ brain.gain
        force = np.clip(wanted, -largest, largest)
        volts = np.zeros(n)
        for i, (hand, rows) in enumerate(hands):
            known = {}
            if hand.needs_friction:
                known["friction"] = (eyes.friction(states) if hand.observed_friction else friction)[rows]
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
        states = eyes.update(states, readings, Command(force, volts))
    return [
        {"survived": bool(standing[i]), "cost": float(cost[i]), "cart_m": float(cart[i]), "seconds": float(held[i])}
        for i in range(n)
    ]


def together(seeing: list[Estimator]) -> Estimator:
    """One estimator for all rigs, each row with the filter of its own rig."""
    one = dataclasses.replace(seeing[0])
    if isinstance(one, Kalman | Disturbance):  # constant gains, which a product takes in a stack
        object.__setattr__(one, "_next", np.stack([each._next for each in seeing]))
    elif not isinstance(one, Differences):
        raise SystemExit(f"{one.name} cannot balance rigs together; compare takes it")
    return one


def trained(folder: Path, seed: int, estimator: str, compensator: str) -> tuple[Estimator, Compensator]:
    """What was trained on a rig."""
    learned = json.loads((folder / "cells" / f"friction-{seed:02d}.json").read_text(encoding="utf-8"))["result"]
    seeing = estimators.load({**learned, "kind": estimator})
    gain, dry = seeing.rig.newtons_per_volt, seeing.dry
    known: dict[str, Compensator] = {
        "none": StaticGain(gain),
        "observed": Observed(gain),
        "ideal": Ideal(gain),
        "lugre": LuGre(
            *(gain, seeing.rig.supply, seeing.rig.period, dry.bristle_stiffness, dry.bristle_damping, dry.coulomb),
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
    options.add_argument("--axis", choices=["friction", "encoder"], help="change the rigs after training")
    options.add_argument("--values", default="1", help="along the axis, with commas between")
    options.add_argument("--pairs", help="controller:estimator:compensator, with commas between")
    given = options.parse_args()
    pairs = [tuple(pair.split(":")) for pair in given.pairs.split(",")] if given.pairs else list(PAIRS)
    comparison = Comparison(seeds=given.seeds)
    warnings.simplefilter("ignore")  # a compensator asked outside its range says so once a rig
    for value in map(float, given.values.split(",")):
        plants = [comparison.rig(seed) for seed in range(given.seeds)]
        if given.axis:
            plants = [AXES[given.axis].rig(plant, value) for plant in plants]
            print(f"{given.axis} {value:g} times")
        cells = []
        for controller, estimator, compensator in pairs:
            brain = controllers.load(controller)
            parts = [trained(given.folder, seed, estimator, compensator) for seed in range(given.seeds)]
            if given.axis == "encoder":  # its owner knows what encoder is on the rig
                parts = [(_counting(e, p), c) for (e, c), p in zip(parts, plants, strict=True)]
            rows = balance(plants, brain, [e for e, _ in parts], [c for _, c in parts], given.seconds)
            name = f"{brain.name}+{estimator}"
            cells += [{**r, "controller": name, "compensator": compensator, "seed": s} for s, r in enumerate(rows)]
            stood = [r for r in rows if r["survived"]]
            line = f"{name:24s} {compensator:10s} stood {len(stood):2d}/{len(rows)}"
            for key, scale, form in (("cost", 1.0, ".2e"), ("cart_m", 1000.0, ".1f")):
                low, mid, high = np.percentile([scale * r[key] for r in stood] or [np.nan], [10, 50, 100])
                line += f"  {key} {mid:{form}} ({low:{form}} to {high:{form}})"
            print(line, flush=True)
        named = [(f"{controllers.load(a).name}+{b}", c) for a, b, c in pairs]
        for row in against_first(cells, named):
            print(
                f"  {row['controller']}, {row['compensator']}: {row['cost_ratio']:.3g} times the first "
                f"({row['low']:.3g} to {row['high']:.3g}), less on {row['less_on']} of {row['rigs']}"
            )


def _counting(estimator: Estimator, plant: Plant) -> Estimator:
    rig = dataclasses.replace(estimator.rig, cart_step=plant.encoders.cart, pole_step=plant.encoders.pole)
    return dataclasses.replace(estimator, rig=rig)


if __name__ == "__main__":
    main()
