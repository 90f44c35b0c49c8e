"""The whole motion, found from a linear model: MuJoCo's own, and its slopes."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dipc_gym.controllers import lqr
from dipc_gym.controllers.designs import paper_model
from dipc_gym.env import DoublePendulumEnv
from dipc_gym.mechanics.motion import Motion
from dipc_gym.mechanics.rigid import Rigid

PAPER = (1.259984, 0.176948, 0.035200, 0.073354, 0.014080, 0.013195)
ABSOLUTE = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 1.0, 1.0]])
MOTION = Motion.of(*paper_model())
states = st.tuples(*[st.floats(-4, 4)] * 6).map(np.array)


def test_the_paper_s_numbers_come_back() -> None:
    np.testing.assert_allclose(MOTION.d, PAPER, rtol=2e-5)
    assert MOTION.gravity == pytest.approx(9.81, rel=1e-9)
    assert MOTION.viscous == pytest.approx(40.0)


@pytest.mark.parametrize("masses", [{}, {"masses": {"cart": 0.9, "pole1": 0.3, "pole2": 0.2}}])
def test_accelerations_are_mujoco_s_everywhere(masses: dict[str, dict[str, float]]) -> None:
    env = DoublePendulumEnv(plant=masses)
    motion, rigid = Motion.of(*lqr.linear_model(env.model)), Rigid(env.model, env.rig.dofs)
    rng = np.random.default_rng(0)
    for _ in range(50):
        state, force = rng.uniform(-4, 4, 6), rng.uniform(-90, 90)
        joints = np.linalg.solve(ABSOLUTE, state[:3]), np.linalg.solve(ABSOLUTE, state[3:])
        theirs = ABSOLUTE @ rigid.acceleration(*joints, [force, 0.0, 0.0])
        np.testing.assert_allclose(motion.rate(state, force)[3:], theirs, rtol=1e-8, atol=1e-7)


@given(states, st.floats(-90, 90))
def test_slopes_are_those_of_differences(state: np.ndarray, force: float) -> None:
    A, B = MOTION.linear(state, force)
    step = 1e-5
    differences = [
        (MOTION.rate(state + d, force) - MOTION.rate(state - d, force)) / (2 * step) for d in step * np.eye(6)
    ]
    np.testing.assert_allclose(A, np.array(differences).T, atol=1e-5 * (1 + np.abs(A).max()))
    np.testing.assert_allclose(B, MOTION.rate(state, force + 1) - MOTION.rate(state, force), atol=1e-9)


@given(states, st.floats(-90, 90))
def test_many_give_the_bits_of_one(state: np.ndarray, force: float) -> None:
    many = np.tile(state, (7, 1)) + np.arange(7)[:, None] / 7
    forces = force + np.arange(7.0)
    together = MOTION.after(many, forces, 0.005)
    alone = [MOTION.after(one[None], np.array([push]), 0.005)[0] for one, push in zip(many, forces, strict=True)]
    np.testing.assert_array_equal(together, alone)


def test_energy_is_kept_without_drag() -> None:
    free = Motion(MOTION.d, MOTION.gravity, 0.0)
    state = np.array([0.0, 2.0, 2.5, 0.1, 0.0, 0.0])

    def energy(x: np.ndarray) -> float:
        _, d2, d3, *_ = free.d
        height = d2 * math.cos(x[1]) + d3 * math.cos(x[2])
        return float(0.5 * x[3:] @ free.mass(x[1:3]) @ x[3:] + free.gravity * height)

    before = energy(state)
    for _ in range(400):
        state = free.after(state, np.array(0.0), 0.005)
    assert energy(state) == pytest.approx(before, abs=1e-5)


def test_what_is_no_cart_with_two_poles_is_refused() -> None:
    A, B = paper_model()
    braked = A.copy()
    braked[4, 4] -= 0.5  # friction in a pole's joint
    for wrong in (braked, A + np.diag([0, 0, 0, 1, 1], 1), np.zeros((6, 6))):
        with pytest.raises(ValueError, match="cart with two poles"):
            Motion.of(wrong, B)
