"""Validation data speak against a law only where it had data to be fitted to."""

from __future__ import annotations

import numpy as np
import pytest
from sim2real_rigs import CART, prepared, record

from dipc_gym import mjcf, physics
from dipc_gym.sim2real.effects.friction_speed import FrictionOfSpeed
from dipc_gym.sim2real.effects.load_position_law import ForceOfPosition
from dipc_gym.sim2real.effects.motor_map import CommandMap
from dipc_gym.sim2real.effects.shared.law import Law
from dipc_gym.sim2real.effects.shared.surfaces import Surface
from dipc_gym.sim2real.effects.unknown_force import UnknownForce
from dipc_gym.sim2real.estimation.fit import fit
from dipc_gym.sim2real.model.structure import Term
from dipc_gym.sim2real.selection.support import supported

LATER = 4.0  # s, from which on the cart is sent where it has not been


def command(time: float) -> float:
    """To and fro about the middle, then off to one side, slowly."""
    return 4.0 * np.sin(2 * np.pi * time) if time < LATER else 1.5 + 0.2 * np.sin(2 * np.pi * time)


@pytest.mark.parametrize(
    ("law", "of"),
    [
        (ForceOfPosition((-0.1, 0.0, 0.1), (1.0, 0.0, 1.0)), "position"),
        (FrictionOfSpeed((0.0, 0.1, 0.5), (1.0, 0.5, 0.7)), "speed"),
        (CommandMap((-5.0, 0.0, 5.0), (-4.0, 0.0, 4.0)), "command"),
    ],
)
def test_windows_count_where_a_laws_input_was_seen_before(law: Law, of: str) -> None:
    """Speeds and commands of the second half were all there in the first; positions were not."""
    rig = physics.from_model(mjcf.compile(CART))
    problem = prepared(CART, [record(rig, command, 8.0, noise=(1e-5,))]).problem
    early = problem.windows.start < LATER - 0.3
    at = "motor" if of == "command" else "cart"
    structure = prepared(CART, problem.windows.recordings).structure.with_term(Term(law, at, law.guess))
    fitted = fit(problem.pick(early), structure, most=0)
    there = supported(fitted, problem.pick(early), problem)
    assert there[early].all()
    moved = problem.windows.observed[..., 0]
    low, high = moved[early].min(), moved[early].max()
    beyond = (moved > high + 0.03 * (high - low)).any(axis=1) | (moved < low - 0.03 * (high - low)).any(axis=1)
    assert beyond.any()
    if of == "position":
        assert not there[beyond].any()
    else:
        assert there.all()


def test_a_formula_is_asked_anywhere_and_a_surface_by_both_its_inputs() -> None:
    rig = physics.from_model(mjcf.compile(CART))
    ready = prepared(CART, [record(rig, command, 8.0, noise=(1e-5,))])
    early = ready.problem.windows.start < LATER - 0.3
    plain = fit(ready.problem.pick(early), ready.structure, most=0)
    assert supported(plain, ready.problem.pick(early), ready.problem).all()
    surface = Surface(
        ("velocity cart", "position cart"), (np.array([-0.5, 0.5]), np.array([-0.1, 0.1])), np.array([[1, 2], [3, 4.0]])
    )
    law = UnknownForce(surface, 1.0, ("m/s", "m"), "cart")
    both = fit(ready.problem.pick(early), ready.structure.with_term(Term(law, "cart", law.first)), most=0)
    assert not supported(both, ready.problem.pick(early), ready.problem).all()
