"""Sensors whose scale is bent: an encoder off its axis, and any other error that goes with the reading."""

from __future__ import annotations

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sim2real_rigs import CART, HANGING, NOISE, RK4, record, sweep

from dipc_gym import mjcf, physics
from dipc_gym.recording import Recording
from dipc_gym.sim2real import catalogue, fit_effect
from dipc_gym.sim2real.effects.shared.base import Misread
from dipc_gym.sim2real.estimation import states

WAVE = 0.08  # m, what the belt moves in a turn of its pulley


def with_sensor(text: str, effect: str, numbers: str) -> physics.Physics:
    """A model whose cart's encoder has a bent scale."""
    entry = f'<custom><numeric name="dipc_gym:{effect}:cart" data="{numbers}"/></custom>'
    return physics.load(text.replace("</mujoco>", f"{entry}</mujoco>"))


def recorded(rig: str, effect: str, numbers: str) -> Recording:
    text, start = {"cart": (CART, ()), "hanging": (HANGING, (0, 0.4, -0.3))}[rig]
    bent = with_sensor(text, effect, numbers)
    return record(bent, sweep(4.0), 8.0, noise=NOISE[rig], start=start, step=1e-4, integrator=RK4)


@given(st.floats(-0.9, 0.9), st.floats(-np.pi, np.pi), st.floats(0.01, 10.0), st.lists(st.floats(-5, 5), max_size=30))
def test_a_bent_scale_is_undone(steep: float, phase: float, wavelength: float, places: list[float]) -> None:
    """Whatever the reading, what it was before is found, if the scale runs forwards everywhere."""
    size = steep * wavelength / (2 * np.pi)
    rig = with_sensor(CART, "sensor.eccentric", f"{size * np.cos(phase):.17g} {size * np.sin(phase):.17g} {wavelength}")
    straight = np.array(places)[:, None]
    found = states.straightened(rig, rig.sense(straight))
    np.testing.assert_allclose(found, straight, atol=1e-8)


def test_a_table_is_undone_inside_and_outside() -> None:
    rig = with_sensor(CART, "sensor.map", "-0.2 0.0 0.1 0.3 -0.21 0.02 0.1 0.26")
    straight = np.linspace(-0.5, 0.5, 101)[:, None]
    read = rig.sense(straight)
    assert read[0, 0] == pytest.approx(-0.51)  # as much too little as at the table's end
    np.testing.assert_allclose(states.straightened(rig, read), straight, atol=1e-12)


def test_a_scale_that_runs_backwards_gives_numbers() -> None:
    rig = with_sensor(CART, "sensor.eccentric", "1.0 0.0 0.1")
    assert np.all(np.isfinite(states.straightened(rig, np.linspace(-1, 1, 50)[:, None])))


def test_the_motion_is_estimated_from_what_a_bent_scale_means() -> None:
    rig = with_sensor(CART, "sensor.eccentric", f"0.003 0.0 {WAVE}")
    run = record(rig, sweep(4.0), 4.0, noise=[1e-6])
    straight = record(physics.load(CART), sweep(4.0), 4.0, noise=[1e-6])
    motion = states.estimate(run, rig, np.array([1e-6]))
    assert np.abs(run.sensors - straight.sensors).max() > 0.0025
    np.testing.assert_allclose(motion.position, straight.sensors, atol=2e-5)


def test_what_a_scale_is_asked_for_is_free_of_what_initial_states_could_explain() -> None:
    """The normal equations are those of explicit columns, projected window by window."""
    rng = np.random.default_rng(3)
    n, m, sensors, free = 5, 7, 2, 4
    Q, _ = np.linalg.qr(rng.normal(size=(n, m * sensors + free, free)))

    def projected(columns: np.ndarray) -> np.ndarray:
        return columns - Q @ (np.swapaxes(Q, 1, 2) @ columns)

    left = projected(rng.normal(size=(n, m * sensors + free, 1)))[..., 0]
    rows, scale, present = np.arange(m) * sensors + 1, rng.uniform(0, 2, (n, m)), rng.normal(size=(n, m))
    seen = Misread(np.zeros((n, m)), np.zeros((n, m)), present, left, Q, rows, scale)
    errors, some = rng.normal(size=(n, m, 3)), np.array([True, True, False, True, False])
    columns = np.zeros((n, m * sensors + free, 4))
    columns[:, rows] = scale[..., None] * np.concatenate([errors, present[..., None]], axis=2)
    columns = projected(columns)
    weight = np.sqrt(1 / (1 + np.mean(left**2, axis=1)))[some, None]
    H = (weight[..., None] * columns[some, :, :3]).reshape(-1, 3)
    target = (weight * (left + columns[..., 3])[some]).ravel()
    normal, right, total = seen.asked(errors, some)
    np.testing.assert_allclose(normal, H.T @ H, atol=1e-12)
    np.testing.assert_allclose(right, H.T @ target, atol=1e-12)
    assert total == pytest.approx(target @ target)


@pytest.mark.parametrize("rig", ["cart", "hanging"])
def test_an_encoder_off_its_axis_is_found(rig: str) -> None:
    text = {"cart": CART, "hanging": HANGING}[rig]
    found = fit_effect(
        catalogue()["sensor.eccentric"], mjcf.from_text(text), [recorded(rig, "sensor.eccentric", f"5e-4 2e-4 {WAVE}")]
    )
    best = next(one for one in found if one.at == "cart")
    assert best.error < 1.2 < best.error_without
    assert best.values["wavelength"] == pytest.approx(WAVE, rel=0.01)
    assert (best.values["sine"], best.values["cosine"]) == pytest.approx((5e-4, 2e-4), abs=3e-5)


@pytest.mark.parametrize("rig", ["cart", "hanging"])
def test_a_bump_of_the_scale_is_found_where_it_is(rig: str) -> None:
    """One of half a millimetre, two centimetres wide; what is left of the readings tells, not the forces."""
    text = {"cart": CART, "hanging": HANGING}[rig]
    numbers = "0.15 0.16 0.18 0.19 0.15 0.1605 0.1805 0.19"
    found = fit_effect(catalogue()["sensor.map"], mjcf.from_text(text), [recorded(rig, "sensor.map", numbers)])
    best = next(one for one in found if one.at == "cart")
    assert best.error < best.error_without / 4
    where, size = re.search(r"near (\S+) it reads (\S+) m", best.sentence).groups()
    assert 0.155 < float(where) < 0.185
    assert float(size) == pytest.approx(5e-4, rel=0.2)
