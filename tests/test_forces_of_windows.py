"""What explains motion explains forces as well: the force that fits leave in windows, and how it counts."""

from __future__ import annotations

import numpy as np
import pytest
import sim2real_rigs
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from dipc_gym import mjcf, physics
from dipc_gym.sim2real.estimation.unexplained import force_in_windows
from dipc_gym.sim2real.selection.score import compare

CART = """
<mujoco><option timestep="0.0005" integrator="implicitfast"/>
  <worldbody><body><joint name="cart" type="slide" axis="1 0 0" frictionloss="{dry}"/>
    <geom type="box" size="0.1 0.05 0.05" mass="1.2" contype="0" conaffinity="0"/></body></worldbody>
  <actuator><motor name="motor" joint="cart"/></actuator>
  <sensor><jointpos name="cart" joint="cart"/></sensor></mujoco>
"""
SQUARES = arrays(np.float64, (12, 3), elements=st.floats(1e-6, 1e9))


def test_the_force_that_windows_lack_is_that_of_the_friction_left_out() -> None:
    rig = physics.load(mjcf.from_text(CART.format(dry=2.0)))
    recording = sim2real_rigs.record(rig, sim2real_rigs.sweep(10.0), 6.0, noise=1e-6)
    windows = sim2real_rigs.prepared(CART.format(dry=0.0), [recording]).problem.windows
    without, within = (
        np.sqrt(force_in_windows(physics.load(mjcf.from_text(CART.format(dry=dry))), windows)[:, 0])
        for dry in (0.0, 2.0)
    )
    assert len(without) == len(windows)
    assert np.median(without) == pytest.approx(2.0, rel=0.05)
    assert np.median(within) < 0.2
    some = force_in_windows(rig, windows.pick(np.array([3, 7])))
    np.testing.assert_array_equal(np.sqrt(some[:, 0]), within[[3, 7]])


@given(old=SQUARES, new=SQUARES, unit=st.floats(1e-3, 1e3))
def test_forces_count_whatever_their_unit_and_the_other_way_round_as_much(
    old: np.ndarray, new: np.ndarray, unit: float
) -> None:
    same, blocks = np.full(12, 100.0), np.arange(12)
    forth = compare(same, same, blocks, (new, old))
    back = compare(same, same, blocks, (old, new))
    scaled = compare(same, same, blocks, (unit * new, unit * old))
    assert forth.gain == pytest.approx(-back.gain, abs=1e-9)
    assert (scaled.gain, scaled.error) == pytest.approx((forth.gain, forth.error), rel=1e-6, abs=1e-9)
    assert compare(same, same, blocks, (old, old)).gain == 0.0


def test_what_moves_a_machine_right_by_wrong_forces_is_no_clear_gain() -> None:
    """Motion in some windows a little better, forces at every joint four times as large."""
    rng = np.random.default_rng(0)
    before = rng.uniform(100.0, 200.0, 24)
    after = before * np.where(np.arange(24) % 3 == 0, 0.5, 0.7)
    force = rng.uniform(1.0, 2.0, (24, 6))
    assert compare(after, before, np.arange(24)).clear
    assert not compare(after, before, np.arange(24), (16 * force, force)).clear
    assert compare(after, before, np.arange(24), (0.5 * force, force)).clear


def test_springs_that_yield_pull_as_the_motion_before_bent_them() -> None:
    """Inverse dynamics knows no yielding: a spring of the distance from zero would pull without end."""
    text = CART.format(dry=0.0).replace(
        "</worldbody>",
        '</worldbody><tendon><fixed stiffness="400" springlength="0" springyield="0.005"><joint joint="cart" coef="1"/>'
        "</fixed></tendon>",
    )
    rig = physics.load(mjcf.from_text(text))
    recording = sim2real_rigs.record(rig, sim2real_rigs.sweep(10.0), 6.0, noise=1e-6)
    windows = sim2real_rigs.prepared(CART.format(dry=0.0), [recording]).problem.windows
    without, within = (
        np.sqrt(force_in_windows(physics.load(mjcf.from_text(one)), windows)[:, 0])
        for one in (CART.format(dry=0.0), text)
    )
    assert np.median(without) == pytest.approx(2.0, rel=0.2)
    assert np.median(within) < 0.1 * np.median(without)
    assert rig.model.tendon_stiffness[0] == 400
