"""Steps are as fine, in each window, as what is predicted asks for."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from sim2real_rigs import CART, RK4, prepared, record, sweep

from dipc_gym import physics
from dipc_gym.sim2real.effects import catalogue
from dipc_gym.sim2real.estimation.problem import Problem, predict, sensitivities
from dipc_gym.sim2real.estimation.settings import ESTIMATION
from dipc_gym.sim2real.estimation.steps import change, controlled
from dipc_gym.sim2real.model.structure import Structure, Term
from dipc_gym.sim2real.simulation.batch import Stepping

NOISE = 1e-6
EULER = mujoco.mjtIntegrator.mjINT_EULER


def ready(stepping: Stepping, *effects: Term) -> tuple[Problem, Structure]:
    """A cart that is swept to and fro, in some steps, with effects laid over it."""
    recording = record(physics.load(CART), sweep(4.0), 4.0, noise=NOISE, step=5e-4, integrator=RK4)
    P = prepared(CART, [recording], stepping=stepping)
    noise = np.full_like(P.problem.windows.noise, NOISE)
    problem = replace(P.problem, windows=replace(P.problem.windows, noise=noise))
    return problem, replace(P.structure, terms=effects)


BACKLASH = Term(
    catalogue()["transmission.backlash"],
    "motor",
    {"gap": 1e-4, "rotor_inertia": 0.3, "contact_rate": 2e3, "contact_damping": 0.1},
)


def test_free_motion_asks_for_no_finer_steps() -> None:
    problem, structure = ready(Stepping(0.002, RK4))
    assert controlled(problem, structure, structure.first) is problem


@pytest.mark.parametrize("rule", [EULER, RK4])
def test_what_another_halving_would_change_is_small_or_too_dear(rule: mujoco.mjtIntegrator) -> None:
    terms = [BACKLASH] if rule == RK4 else []
    problem, structure = ready(Stepping(0.002, rule), *terms)
    fine = controlled(problem, structure, structure.first)
    assert fine.halvings.max() > 0

    def moved_by_another_halving(of: Problem) -> np.ndarray:
        here, there = (predict(one, structure, [structure.first], of.initial[None])[0] for one in (of, of.halved_by(1)))
        return change(of, there, here)

    left = moved_by_another_halving(fine)
    assert np.all((left <= ESTIMATION.integration) | (fine.halvings == ESTIMATION.halvings))
    never = fine.halvings == 0
    np.testing.assert_array_equal(left[never], moved_by_another_halving(problem)[never])
    assert np.all(moved_by_another_halving(problem)[~never] > ESTIMATION.integration)


def test_windows_in_steps_of_their_own_are_those_of_problems_of_their_own() -> None:
    problem, structure = ready(Stepping(0.002, RK4))
    structure = replace(structure, terms=(Term(catalogue()["friction.coulomb"], "cart", {"level": 2.0}),))
    z = structure.first
    halved = np.arange(len(problem.windows)) % 3
    mixed = problem.halved_by(halved)
    probes = [z + 0.01]
    read = predict(mixed, structure, [z, z + 0.1], mixed.initial[None])
    told = sensitivities(mixed, structure, z, probes, mixed.initial)
    assert told is not None
    for times in range(3):
        mine = np.flatnonzero(halved == times)
        own = problem.pick(mine).halved_by(times)
        np.testing.assert_array_equal(predict(own, structure, [z, z + 0.1], own.initial[None]), read[:, mine])
        alone = sensitivities(own, structure, z, probes, own.initial)
        assert alone is not None
        for whole, part in zip(told, alone, strict=True):
            np.testing.assert_array_equal(whole[mine] if whole is told[0] else whole[:, mine], part)


def test_halvings_go_with_their_windows() -> None:
    problem, structure = ready(Stepping(0.002, RK4))
    some, others = problem.pick(np.arange(4)).halved_by(2), problem.pick(np.arange(4, 7))
    assert some.join(others).halvings.tolist() == [2] * 4 + [0] * 3
    assert some.join(others).pick(np.array([3, 4])).halvings.tolist() == [2, 0]
    assert others.join(others).halved is None
    none = problem.pick(np.arange(0))
    assert controlled(none, structure, structure.first) is none
