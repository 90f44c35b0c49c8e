"""What windows begin with that no sensor shows: springs that yield or creep, and loads that swing."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sim2real_rigs import CART, RK4, prepared, record, sweep

from dipc_gym import mjcf, physics
from dipc_gym.mjcf.edit import Document
from dipc_gym.sim2real import catalogue, diagnose
from dipc_gym.sim2real.effects.friction_hysteresis import Hysteresis
from dipc_gym.sim2real.estimation.fit import fit
from dipc_gym.sim2real.estimation.problem import predict, sensitivities
from dipc_gym.sim2real.model.structure import Term
from dipc_gym.sim2real.simulation.batch import Stepping, simulate
from dipc_gym.sim2real.simulation.windows import cut
from dipc_gym.sim2real.unseen.operators import play, swing

ELEMENTS = ((0.004, 0.02), (1.5, 2.5))  # m and N
HIDDEN = {
    "load.swinging": {"mass": 0.3, "frequency": 2.2, "damping_ratio": 0.04},
    "load.creeping": {"stiffness": 60.0, "relaxation_time": 0.4},
}


def slips() -> tuple[Hysteresis, dict[str, float]]:
    law = Hysteresis(*ELEMENTS)
    return law, law.guess


def written(effect: str) -> physics.Physics:
    document = Document(mjcf.from_text(CART))
    if effect == "friction.hysteresis":
        law, values = slips()
        law.edit(document, "cart", values)
    else:
        catalogue()[effect].edit(document, "cart", HIDDEN[effect])
    return physics.from_model(mjcf.compile(document.text()))


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 10_000), st.floats(0.01, 3.0))
def test_what_is_dragged_is_never_left_farther_behind_and_forgets_small_loops(seed: int, width: float) -> None:
    rng = np.random.default_rng(seed)
    x = np.cumsum(rng.normal(size=300))
    at = play(x, np.array([width]), np.zeros(1))[:, 0]
    assert np.all(np.abs(x - at) <= width + 1e-12)
    step = np.diff(at, prepend=0.0)
    assert np.all((step >= 0) | (at >= x + width - 1e-9))  # it goes back only when dragged back
    assert np.all((step <= 0) | (at <= x - width + 1e-9))
    by_hand, rest = [], 0.0
    for now in x:
        rest = min(max(rest, now - width), now + width)
        by_hand.append(rest)
    np.testing.assert_allclose(at, by_hand, atol=1e-12)


@pytest.mark.parametrize("ratio", [0.02, 0.3, 1.4])
def test_a_load_swings_as_its_equation_says(ratio: float) -> None:
    """Carried along a sine from rest: particular and homogeneous solution by hand."""
    rate, forced = 2 * np.pi * 1.7, 9.0
    t = np.linspace(0, 2, 2001)
    q, v = np.sin(forced * t), forced * np.cos(forced * t)
    apart, faster = swing(rate**2, 2 * ratio * rate, q, v, t, t)
    x, dx = 0.0, 0.0  # midpoint rule at a tenth of the step, an integrator of its own
    found = []
    for k in range(20001):
        if k % 10 == 0:
            found.append((x, dx))
        h, now = t[-1] / 20000, k * t[-1] / 20000
        middle = x + h / 2 * dx, dx + h / 2 * (forced**2 * np.sin(forced * now) - 2 * ratio * rate * dx - rate**2 * x)
        pushed = forced**2 * np.sin(forced * (now + h / 2)) - 2 * ratio * rate * middle[1] - rate**2 * middle[0]
        x, dx = x + h * middle[1], dx + h * pushed
    np.testing.assert_allclose(apart, np.array(found)[:, 0], atol=2e-4 * np.abs(apart).max())
    np.testing.assert_allclose(faster, np.array(found)[:, 1], atol=2e-3 * np.abs(faster).max())


@pytest.mark.parametrize("effect", ["friction.hysteresis", *HIDDEN])
def test_windows_begin_with_what_the_motion_before_left(effect: str) -> None:
    """With the right parameters nearly nothing is left, in late windows as in early ones.

    A rest is known as well as the positions at which the motion turned round.
    """
    rig = written(effect)
    run = record(rig, sweep(4.0), noise=(1e-5,))
    ready = prepared(CART, [run], stepping=Stepping(0.001, RK4))
    law, values = slips() if effect == "friction.hysteresis" else (catalogue()[effect], HIDDEN[effect])
    structure = ready.structure.with_term(Term(law, "cart", values))
    right = fit(ready.problem, structure, most=0)
    without = fit(ready.problem, ready.structure, most=0)
    assert without.error > 20
    assert right.error < 0.03 * without.error
    assert np.sqrt(np.median(right.mse)) < 2


@pytest.mark.parametrize("stepping", [Stepping(0.001, RK4), Stepping(0.001)], ids=["engine", "mujoco"])
@pytest.mark.parametrize("effect", ["friction.hysteresis", "load.swinging"])
def test_windows_without_their_motions_are_refused(effect: str, stepping: Stepping) -> None:
    """Neither simulator begins with springs unbent and loads at rest where nobody knows."""
    rig = written(effect)
    windows = cut([record(rig, sweep(4.0), 0.5)], np.ones(1), 0.25, (0.0, 1.0))
    with pytest.raises(ValueError, match="depends on its motion; give the windows"):
        simulate([rig], windows, np.zeros((1, len(windows), 2)), stepping, base=["cart"])


def test_a_creeping_spring_is_maxwells_element() -> None:
    """Pulled out at once and held, it relaxes by its time constant, but for the node's own share of it."""
    time, step = 0.4, 1e-3
    model = written("load.creeping").model
    stamps = np.arange(0.0, 2.0, step)
    held = np.minimum(stamps / 0.01, 1.0) * 0.02
    ground = float(model.dof_damping[1] / model.dof_armature[1])
    behind, _ = swing(ground / time, 0.0, held, np.gradient(held, step), stamps, stamps, ground=ground)
    later = np.searchsorted(stamps, [0.1, 0.5, 0.9])
    np.testing.assert_allclose(np.diff(np.log(-behind[later])), -0.4 / time, rtol=0.02)
    assert model.body_mass[-1] < 1e-8


def test_elements_hold_below_their_force_and_slip_at_it_in_plain_mujoco() -> None:
    """Pushed with less than all elements bear it stays near, and springs back; with more it goes on."""
    model = written("friction.hysteresis").model
    bears = sum(ELEMENTS[1])
    for share, goes in ((0.9, False), (1.1, True)):
        data = mujoco.MjData(model)
        data.qfrc_applied[0] = share * bears
        for _ in range(6000):
            mujoco.mj_step(model, data)
        reached = float(data.qpos[0])
        assert (reached > 0.05) == goes
        if not goes:
            data.qfrc_applied[0] = 0.0
            for _ in range(6000):
                mujoco.mj_step(model, data)
            assert data.qpos[0] < reached - 0.002


@pytest.mark.parametrize("effect", ["friction.hysteresis", *HIDDEN])
def test_it_is_found_and_written_back_as_plain_mjcf(effect: str) -> None:
    rig = written(effect)
    runs = [record(rig, sweep(strength), noise=(1e-5,)) for strength in (4.0, 5.0)]
    found = diagnose(mjcf.from_text(CART), runs[:1], runs[1:])
    assert found.missing[0].effect == effect
    assert found.missing[0].at == "cart"
    assert found.held_out is not None
    assert found.held_out.improved < 0.05 * found.held_out.recalibrated
    assert not found.to_dict()["needs_dipc_gym"]
    mujoco.MjModel.from_xml_string(found.improved)


def test_sensitivities_go_through_yielding() -> None:
    """Exact derivatives by the elements' forces, and by initial states, are limits of differences."""
    ready = prepared(CART, [record(written("friction.hysteresis"), sweep(4.0), 2.0, noise=(1e-5,))])
    law, values = slips()
    problem, structure = ready.problem, ready.structure.with_term(Term(law, "cart", values))
    z, initial = structure.first, problem.initial
    found = sensitivities(problem, structure, z, [z + 1e-7 * unit for unit in np.eye(len(z))], initial)
    assert found is not None
    _, by_parameters, by_initial = found
    size = 1e-4
    moved = [(z + sign * size * unit, initial) for unit in np.eye(len(z)) for sign in (1, -1)]
    moved += [(z, initial + sign * size * unit) for unit in np.eye(2) for sign in (1, -1)]
    said = predict(problem, structure, [one for one, _ in moved], np.stack([begin for _, begin in moved]))
    differences = (said[::2] - said[1::2]) / (2 * size)
    for exact, difference in zip([*by_parameters, *by_initial], differences, strict=True):
        off = np.abs(exact - difference).max(axis=(1, 2)) / np.abs(difference).max()
        # An element that yields within a step has no event of its own, and its rest jumps as the motion before turns.
        assert np.median(off) < 0.01
