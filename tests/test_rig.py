"""The rig against an independent model: the paper's equations, written out here."""

from __future__ import annotations

import math
from importlib import resources

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from dipc_gym import mjcf
from dipc_gym.controllers.lqr import linear_model
from dipc_gym.env import DoublePendulumEnv
from dipc_gym.identification.run import cart_model
from dipc_gym.plant import Friction, Plant

Array = NDArray[np.float64]

D1, D2, D3, D4, D5, D6 = 1.2599992, 0.1769498, 0.0352, 0.07335506, 0.01408, 0.0131952
G, VISCOUS = 9.81, 40.0
DRY = Friction()
RIG = str(resources.files("dipc_gym").joinpath("rig.xml"))
NO_DRY_FRICTION = Plant(friction=Friction(coulomb=0.0, static=0.0))


def closed_form(a: float, b: float, v: float, wa: float, wb: float, force: float) -> tuple[float, float, float]:
    """Accelerations of cart and absolute angles a, b from D(q) q'' + C(q, q') q' + G(q) = (F - 40 x', 0, 0).

    Solved by Cramer's rule on plain floats: 800,000 calls in a few seconds.
    """
    p, q, r = D2 * math.cos(a), D3 * math.cos(b), D5 * math.cos(a - b)
    twist = D5 * math.sin(a - b)
    f1 = force - VISCOUS * v + D2 * math.sin(a) * wa * wa + D3 * math.sin(b) * wb * wb
    f2 = D2 * G * math.sin(a) - twist * wb * wb
    f3 = D3 * G * math.sin(b) + twist * wa * wa
    # Cofactors of the symmetric mass matrix [[D1, p, q], [p, D4, r], [q, r, D6]].
    c11, c12, c13 = D4 * D6 - r * r, q * r - p * D6, p * r - q * D4
    c22, c23, c33 = D1 * D6 - q * q, p * q - D1 * r, D1 * D4 - p * p
    det = D1 * c11 + p * c12 + q * c13
    return (
        (c11 * f1 + c12 * f2 + c13 * f3) / det,
        (c12 * f1 + c22 * f2 + c23 * f3) / det,
        (c13 * f1 + c23 * f2 + c33 * f3) / det,
    )


@pytest.fixture(scope="module")
def smooth() -> mujoco.MjModel:
    return DoublePendulumEnv(plant=NO_DRY_FRICTION).model


def set_state(data: mujoco.MjData, state: Array) -> None:
    x, a, b, v, wa, wb = state
    data.qpos[:] = x, a, b - a
    data.qvel[:] = v, wa, wb - wa


def get_state(data: mujoco.MjData) -> Array:
    x, a, c = data.qpos
    v, wa, wc = data.qvel
    return np.array([x, a, a + c, v, wa, wa + wc])


numbers = st.floats(-1.0, 1.0, allow_subnormal=False)


@settings(deadline=None, max_examples=200)
@given(st.tuples(*[numbers] * 7))
def test_accelerations_are_those_of_the_paper(smooth: mujoco.MjModel, draw: tuple[float, ...]) -> None:
    # Angles all round, velocities and volts up to what the rig can do; inside the rail stops.
    scale = np.array([0.44, np.pi, np.pi, 2.0, 15.0, 20.0])
    state, volts = scale * draw[:6], 24.0 * draw[6]
    data = mujoco.MjData(smooth)
    set_state(data, state)
    data.ctrl[0] = volts
    mujoco.mj_forward(smooth, data)
    x, a, c = data.qacc
    expected = closed_form(*state[1:], 4.0 * volts)
    np.testing.assert_allclose([x, a, a + c], expected, rtol=1e-10, atol=1e-10)


def runge_kutta(start: Array, dt: float, steps: int, every: int) -> Array:
    """The closed form without force, by the classical Runge-Kutta method; every so many steps one state."""

    def slope(s: list[float]) -> list[float]:
        return [s[3], s[4], s[5], *closed_form(s[1], s[2], s[3], s[4], s[5], 0.0)]

    def ahead(s: list[float], h: float, k: list[float]) -> list[float]:
        return [x + h * dx for x, dx in zip(s, k, strict=True)]

    state, kept = start.tolist(), []
    for step in range(steps):
        if step % every == 0:
            kept.append(state)
        k1 = slope(state)
        k2 = slope(ahead(state, dt / 2, k1))
        k3 = slope(ahead(state, dt / 2, k2))
        k4 = slope(ahead(state, dt, k3))
        mean = [(a + 2 * b + 2 * c + d) / 6 for a, b, c, d in zip(k1, k2, k3, k4, strict=True)]
        state = ahead(state, dt, mean)
    return np.array(kept)


def test_swings_about_hanging_like_the_equations_for_20_seconds() -> None:
    start = np.array([0.0, np.pi + 0.05, np.pi - 0.08, 0.0, 0.0, 0.0])
    expected = runge_kutta(start, 1e-4, 200_000, 100)

    def simulate(integrator: mujoco.mjtIntegrator, dt: float) -> Array:
        model = DoublePendulumEnv(plant=NO_DRY_FRICTION).model
        model.opt.integrator, model.opt.timestep = integrator, dt
        data = mujoco.MjData(model)
        set_state(data, start)
        kept = []
        for _ in range(2_000):
            kept.append(get_state(data))
            mujoco.mj_step(model, data, round(0.01 / dt))
        return np.array(kept)

    same_method = simulate(mujoco.mjtIntegrator.mjINT_RK4, 1e-4)
    np.testing.assert_allclose(same_method, expected, rtol=0, atol=1e-9)
    # The environment's step is ten times as long and of first order: 20 s of swinging drift by little more than a
    # hundredth of the swing, and half the step halves the drift.
    drift = [
        np.abs(simulate(mujoco.mjtIntegrator.mjINT_IMPLICITFAST, dt) - expected)[:, :3].max() for dt in (1e-3, 5e-4)
    ]
    assert drift[0] < 0.02 * 0.08
    assert drift[1] == pytest.approx(drift[0] / 2, rel=0.1)


def test_linear_model_has_the_figures_printed_in_the_paper() -> None:
    A, B = linear_model(DoublePendulumEnv().model)
    printed = [[-4.9797, -0.0488, -48.0187], [41.6587, -6.2002, 114.7470], [-31.1682, 32.9157, 5.6551]]
    np.testing.assert_array_equal(A[3:, 1:4].round(4), printed)
    np.testing.assert_array_equal(B[3:, 0].round(4), [1.2005, -2.8687, -0.1414])
    np.testing.assert_allclose(A[3:, 3], -40.0 * B[3:, 0], rtol=1e-7)
    np.testing.assert_array_equal(A[:3], np.hstack([np.zeros((3, 3)), np.eye(3)]))
    np.testing.assert_allclose(A[3:, [0, 4, 5]], 0.0, atol=1e-6)
    assert not B[:3].any()


def test_energy_is_kept_without_any_loss() -> None:
    model = DoublePendulumEnv(plant=NO_DRY_FRICTION).model
    model.dof_damping[:] = 0.0
    model.actuator_gear[:] = 0.0  # no motor, no back-EMF
    model.opt.integrator, model.opt.timestep = mujoco.mjtIntegrator.mjINT_RK4, 2e-4
    model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
    data = mujoco.MjData(model)
    set_state(data, np.array([0.0, 2.0, 3.0, 0.0, 0.0, 0.0]))
    mujoco.mj_forward(model, data)
    before = data.energy.sum()
    for _ in range(3_000):
        mujoco.mj_step(model, data)
        assert abs(data.qpos[0]) < 0.45
    assert data.energy.sum() == pytest.approx(before, abs=1e-7)
    assert data.energy[1] > 0.1  # it moves


def locked_cart() -> tuple[mujoco.MjModel, mujoco.MjData]:
    """The cart with its poles locked: swinging poles would shake it loose."""
    model = cart_model(mjcf.read(RIG), Plant())
    return model, mujoco.MjData(model)


def ramp(model: mujoco.MjModel, data: mujoco.MjData, newtons_per_second: float) -> float:
    """Force at which the cart slides at 1 mm/s."""
    while data.qvel[0] < 1e-3:
        data.qfrc_applied[0] = newtons_per_second * data.time
        mujoco.mj_step(model, data)
        assert data.time < 60
    return float(data.qfrc_applied[0])


def test_cart_breaks_away_at_the_static_force() -> None:
    model, data = locked_cart()
    assert ramp(model, data, 0.5) == pytest.approx(DRY.static, rel=0.05)


def test_cart_holds_below_the_static_force() -> None:
    model, data = locked_cart()
    held = 0.9 * DRY.static
    for _ in range(10_000):
        data.qfrc_applied[0] = min(2.0 * data.time, held)
        mujoco.mj_step(model, data)
    # While the force rises the bristle gives way by -(static / stiffness) ln(1 - force / static): LuGre's presliding.
    before = data.qpos[0]
    assert before == pytest.approx(-DRY.static / DRY.bristle_stiffness * math.log(1 - held / DRY.static), rel=0.05)
    for _ in range(20_000):
        mujoco.mj_step(model, data)
    assert abs(data.qpos[0] - before) < 1e-9  # and then it stands


def test_friction_falls_from_static_to_coulomb_as_stribeck_says() -> None:
    model, data = locked_cart()
    model.jnt_range[0] = -100, 100
    data.ctrl[0] = 24.0
    while data.qvel[0] < 5 * DRY.stribeck_velocity or data.time < 0.5:
        mujoco.mj_step(model, data)
    assert DRY.coulomb == pytest.approx(-data.actuator_force[1], rel=1e-6)
    for speed in (0.01, 0.02, 0.03):
        # Hold the speed; the bristle then settles where LuGre's curve says.
        for _ in range(1_000):
            data.qvel[0] = speed
            mujoco.mj_step(model, data)
        curve = DRY.coulomb + (DRY.static - DRY.coulomb) * math.exp(-((speed / DRY.stribeck_velocity) ** 2))
        assert -data.actuator_force[1] == pytest.approx(curve, rel=1e-3)


def test_rail_stops_hold_the_cart() -> None:
    model, data = locked_cart()
    data.ctrl[0] = 24.0
    furthest = 0.0
    for _ in range(3_000):
        mujoco.mj_step(model, data)
        furthest = max(furthest, data.qpos[0])
    assert 0.45 <= furthest < 0.46


def test_text_and_default_plant_are_the_same_rig() -> None:
    assert DoublePendulumEnv().plant == Plant()
    assert Plant().motor.force_per_volt == pytest.approx(4.0, rel=1e-14)  # type: ignore[union-attr]
    assert Plant().motor.back_emf + DRY.viscous == pytest.approx(VISCOUS, rel=1e-14)  # type: ignore[union-attr]


def test_physical_inertias() -> None:
    model = DoublePendulumEnv().model
    # A body of this mass and inertia fits between its hinge and 0.44 m (pole1) or 0.56 m (pole2) along the rod.
    for body, far in (("pole1", 0.44), ("pole2", 0.56)):
        mass, centre = model.body(body).mass[0], model.body(body).ipos[2]
        about_centre = model.body(body).inertia.max()
        assert about_centre / mass <= centre * (far - centre)
