"""The bench of friction rejection: many rigs in one call are those of one after the other, and ratios are paired."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from types import ModuleType
from typing import Any

import loops
import numpy as np
import pages
import pytest

from dipc_gym import compensators, controllers, estimators, runs
from dipc_gym.compensators import Friedland, Ideal, LuGre, Stribeck
from dipc_gym.controllers import lqr
from dipc_gym.experiments.compare import Comparison
from dipc_gym.experiments.tables import against_first
from dipc_gym.plant import Friction

RIGS, SECONDS = 3, 1.0


@pytest.fixture(scope="module")
def bench() -> ModuleType:
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(pages.ROOT))
        from benchmarks import rejection
    return rejection


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What `compare` leaves of rigs that it has trained on; here every rig has learned something else."""
    place = tmp_path_factory.mktemp("rejection")
    (place / "cells").mkdir()
    (place / "compensators").mkdir()
    for seed in range(RIGS):
        share = 0.8 + 0.2 * seed
        dry = Friction(coulomb=8.0 * share, static=11.0 * share, viscous=0.0)
        seeing = dataclasses.replace(loops.seeing("kalman"), dry=dry)
        (place / "cells" / f"friction-{seed:02d}.json").write_text(json.dumps({"result": seeing.to_dict()}))
        made = {
            "feedforward": dataclasses.replace(loops.feedforward(), coulomb=2.0 * share),
            "stribeck": Stribeck(0.25, 2.0 * share, 0.7, 0.3, 0.01, 0.012, 0.04),
            "mlp": dataclasses.replace(loops.mlp(), outs=tuple(share * x for x in loops.mlp().outs)),
            "llnf": loops.llnf(4 + 3 * seed),  # with as many models as it happened to grow
            "history": dataclasses.replace(loops.history(), outs=tuple(share * x for x in loops.history().outs)),
            "friedland": Friedland(4.0, 24.0, 0.005, 8.0 * share, 5.0, 0.02, 1.26, 40.0),
        }
        for name, each in made.items():
            compensators.save(each, place / "compensators" / f"{name}-{seed:02d}.json")
    return place


PAIRS = (
    *(("differences", name) for name in ("none", "llnf", "mlp")),
    *(("kalman", name) for name in ("feedforward", "lugre", "lugre_static", "history", "friedland", "friedland_fixed")),
    *(("kalman_friction", "lugre"), ("disturbance", "observed"), ("ekf", "observed"), ("kalman", "ideal")),
)


@pytest.mark.filterwarnings("ignore::dipc_gym.compensators.OutOfRangeWarning")
@pytest.mark.parametrize("pair", PAIRS, ids="+".join)
def test_rigs_side_by_side_are_those_of_one_after_the_other(
    bench: ModuleType, folder: Path, pair: tuple[str, str]
) -> None:
    plants = [Comparison(seeds=RIGS).rig(seed) for seed in range(RIGS)]
    found = bench.tried(folder, ("lqr", *pair), plants, SECONDS, None)
    for seed, (plant, row) in enumerate(zip(plants, found, strict=True)):
        eye, hand = bench.trained(folder, seed, *pair, plant)
        course = runs.balance(
            controllers.balancing("lqr"), hand, seconds=SECONDS, seed=seed, plant=plant, estimator=eye
        )
        x = course.state
        cost = np.einsum("ni,ij,nj->", x, lqr.RECOVERED_Q, x) + lqr.R * course.force @ course.force
        assert row["cost"] == pytest.approx(cost, rel=1e-9)
        assert row["survived"] != course.fell
        late = x[course.time >= SECONDS / 4, 0]
        assert row["cart_m"] == pytest.approx(np.abs(late).max(), rel=1e-9)


def test_what_an_ablation_takes_away_is_one_part(bench: ModuleType, folder: Path) -> None:
    """In every line of it, two of the three names stay, or the compensator is the same but for one of its parts."""
    plant, variants = Comparison(seeds=1).rig(0), {"lugre_static": "lugre", "friedland_fixed": "friedland"}
    for _, without, taken in bench.ABLATION:
        assert sum(a == b for a, b in zip(without, taken, strict=True)) == 2
    for less, whole in variants.items():
        _, reduced = bench.trained(folder, 0, "kalman", less, plant)
        _, full = bench.trained(folder, 0, "kalman", whole, plant)
        if isinstance(full, LuGre):
            assert isinstance(reduced, Stribeck)
            assert full.newtons_per_volt * reduced.coulomb == pytest.approx(full.coulomb)
            assert full.newtons_per_volt * reduced.bump == pytest.approx(full.excess)
            assert reduced.bump_velocity == full.stribeck_velocity
            # Where the cart slides at a constant speed for long, a bristle holds what its level is.
            full.reset()
            for _ in range(400):
                steady = full.voltage(0.0, 0.3)
            assert reduced.voltage(0.0, 0.3) == pytest.approx(steady, rel=1e-3)
        else:
            assert dataclasses.replace(reduced, rate=full.rate) == full
            for _ in range(200):
                reduced.voltage(10.0, 0.2)
            assert reduced.state()[0, 0] == pytest.approx(full.level, abs=1e-6)


def test_pole_encoders_change_alone(bench: ModuleType) -> None:
    plant = Comparison(seeds=1).rig(0)
    finer = bench.AXES["pole"].rig(plant, 0.25)
    assert finer.encoders.pole == plant.encoders.pole / 4
    assert dataclasses.replace(finer, encoders=plant.encoders) == plant
    assert finer.encoders.cart == plant.encoders.cart


def test_ratios_are_paired_rig_by_rig_and_say_how_many() -> None:
    """By hand: ratios 2 and 8 of the cart have the geometric mean 4, whatever the rigs' own sizes are."""
    cells: list[dict[str, Any]] = []
    for seed, (cart, times, stands) in enumerate([(1.0, 2.0, True), (100.0, 8.0, True), (1.0, 50.0, False)]):
        cells.append({"controller": "a", "compensator": "x", "seed": seed, "survived": True, "cart_m": cart})
        wide = {"controller": "a", "compensator": "y", "seed": seed, "survived": stands, "cart_m": times * cart}
        cells.append(wide)
    (row,) = against_first(cells, [("a", "x"), ("a", "y")], "cart_m")
    assert row["cart_m_ratio"] == pytest.approx(4.0)
    assert (row["rigs"], row["less_on"]) == (2, 0)
    half = 12.706204736 * np.log(4) / np.sqrt(2) / np.sqrt(2)  # t of one degree of freedom, deviation log 4 / sqrt 2
    assert row["high"] == pytest.approx(4 * np.exp(half), rel=1e-6)


def test_the_ideal_is_told_the_simulations_friction_and_observed_is_not(bench: ModuleType, folder: Path) -> None:
    plant = Comparison(seeds=1).rig(0)
    _, ideal = bench.trained(folder, 0, "disturbance", "ideal", plant)
    _, observed = bench.trained(folder, 0, "disturbance", "observed", plant)
    assert isinstance(ideal, Ideal)
    assert not ideal.observed_friction
    assert observed.observed_friction
    assert estimators.kind("disturbance").observes_friction
