"""What windows begin with that no sensor shows: springs that yield or creep, and loads that swing."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from sim2real_rigs import CART, HANGING, NOISE, RK4, prepared, record, sweep

from dipc_gym import mjcf, physics
from dipc_gym.engine.swing import Spring, swing
from dipc_gym.mjcf.edit import Document
from dipc_gym.sim2real import catalogue, diagnose
from dipc_gym.sim2real.effects.friction_hysteresis import Hysteresis
from dipc_gym.sim2real.effects.load_swinging_law import SwingingLoadOfAnyLaw
from dipc_gym.sim2real.effects.shared.base import Effect
from dipc_gym.sim2real.effects.shared.loads import smooth
from dipc_gym.sim2real.estimation.fit import fit
from dipc_gym.sim2real.estimation.problem import predict, sensitivities
from dipc_gym.sim2real.estimation.shooting import Shooting
from dipc_gym.sim2real.model.structure import Term
from dipc_gym.sim2real.simulation.batch import Stepping, simulate
from dipc_gym.sim2real.simulation.windows import cut
from dipc_gym.sim2real.unseen.parts import loads
from dipc_gym.sim2real.unseen.play import play

ELEMENTS = ((0.004, 0.02), (1.5, 2.5))  # m and N
HIDDEN = {
    "load.swinging": {"mass": 0.3, "frequency": 2.2, "damping_ratio": 0.04},
    "load.creeping": {"stiffness": 60.0, "relaxation_time": 0.4},
}


SOFTENS = (0.0, 0.01, 0.03, 0.08)  # m
SOFTENED = {"mass": 0.3, "small_swing_frequency": 2.2, "damping_ratio": 0.04, "slope_2": 0.6, "slope_3": 0.3}
EFFECTS = ["friction.hysteresis", *HIDDEN, "load.swinging:law"]


def hidden(effect: str) -> tuple[Effect, dict[str, float]]:
    if effect == "friction.hysteresis":
        law = Hysteresis(*ELEMENTS)
        return law, law.guess
    if effect == "load.swinging:law":
        return SwingingLoadOfAnyLaw(SOFTENS, SOFTENED), SOFTENED
    return catalogue()[effect], HIDDEN[effect]


def written(effect: str) -> physics.Physics:
    document, (law, values) = Document(mjcf.from_text(CART)), hidden(effect)
    law.edit(document, "cart", values)
    return physics.from_model(mjcf.compile(document.text()))


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 10_000), st.floats(0.01, 3.0), st.floats(-5.0, 5.0))
def test_what_is_dragged_is_never_left_farther_behind_and_forgets_small_loops(
    seed: int, width: float, begin: float
) -> None:
    rng = np.random.default_rng(seed)
    x = np.cumsum(rng.normal(size=300))
    at = play(x, np.array([width]), np.array([begin]))[:, 0]
    assert np.all(np.abs(x - at) <= width + 1e-12)
    step = np.diff(at, prepend=begin)
    assert np.all((step >= 0) | (at >= x + width - 1e-9))  # it goes back only when dragged back
    assert np.all((step <= 0) | (at <= x - width + 1e-9))
    by_hand, rest = [], begin
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
    apart, faster = swing([Spring(0.0, rate**2)], 2 * ratio * rate, q, v, t)
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


@settings(max_examples=30, deadline=None)
@given(
    st.lists(st.builds(Spring, st.floats(0.0, 0.3), st.floats(0.0, 400.0), st.floats(0.0, 900.0)), max_size=6),
    st.floats(0.0, 5.0),
    st.sampled_from([0.0, 20.0]),
    st.integers(0, 10_000),
)
def test_a_load_on_springs_with_slack_swings_as_its_equation_says(
    springs: list[Spring], drag: float, ground: float, seed: int
) -> None:
    """Against an integrator of its own, over any motion that is straight between samples."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 1.0, 0.01)
    v = rng.normal(size=len(t))
    q = np.cumsum(v) * 0.01 + 3.0
    found = swing(springs, drag, q, v, t, ground=ground)

    def rate(now: float, state: np.ndarray) -> list[float]:
        away, speed = state[0] - np.interp(now, t, q), state[1] - np.interp(now, t, v)
        beyond = [max(abs(away) - slack, 0.0) for slack, _, _ in springs]
        pull = np.sign(away) * sum(one.stiffness * x + one.cubic * x**3 for one, x in zip(springs, beyond, strict=True))
        return [state[1], -pull - drag * speed - ground * state[1]]

    begin = [q[0], 0.0 if ground else v[0]]
    by_hand = solve_ivp(rate, (0.0, t[-1]), begin, t_eval=t, rtol=1e-11, atol=1e-13, max_step=2e-3).y
    expected = by_hand - (q, v)
    largest = np.abs(expected).max(axis=1, keepdims=True)
    parts = 400
    finer = np.linspace(0.0, t[-1], parts * (len(t) - 1) + 1)
    fine = swing(springs, drag, np.interp(finer, t, q), np.interp(finer, t, v), finer, ground=ground)[:, ::parts]
    assert np.all(np.abs(fine - expected) <= 1e-4 * largest)
    # In its own steps a slack that ends within one costs more: its spring is taken for taut or slack all along.
    assert np.all(np.abs(found - expected) <= 5e-3 * largest)


@settings(max_examples=50, deadline=None)
@given(st.lists(st.tuples(st.floats(0.005, 0.1), st.floats(0.01, 30.0)), min_size=1, max_size=8), st.floats(-0.5, 0.5))
def test_the_springs_of_a_law_pull_in_plain_mujoco_as_it_says(
    stretches: list[tuple[float, float]], away: float
) -> None:
    """Between its knots and beyond the last of them, where it is as stiff as there; it never falls with stretch."""
    widths, slopes = zip(*stretches, strict=True)
    knots = np.append(0.0, np.cumsum(widths))
    values = {"mass": 0.2, "small_swing_frequency": 1.5, "damping_ratio": 0.1}
    values |= {f"slope_{k + 1}": slope for k, slope in enumerate(slopes) if k}
    law, document = SwingingLoadOfAnyLaw(knots.tolist(), values), Document(mjcf.from_text(CART))
    law.edit(document, "cart", values)
    model = mjcf.compile(document.text())
    data, load = mujoco.MjData(model), model.joint("cart_load")

    def pull(away: float) -> float:
        data.qpos[load.qposadr[0]] = away
        mujoco.mj_forward(model, data)
        return -float(data.qfrc_passive[load.dofadr[0]])

    table = law.law_of(values, {"mass": "kg"})["table"]
    told, levels = table["inputs"][0]["knots"], np.array(table["levels"])
    assert np.all(np.diff(levels) > 0)
    np.testing.assert_allclose([pull(one) for one in told], levels, rtol=1e-6, atol=1e-9 * np.abs(levels).max())
    stiffness = values["mass"] * (2 * np.pi * values["small_swing_frequency"]) ** 2
    along = smooth(knots.tolist(), [stiffness, *(stiffness * slope for slope in slopes[1:])])
    expected = sum(float(one.pull(np.array(away))) for one in along)
    assert pull(away) == pytest.approx(expected, rel=1e-6, abs=1e-9 * np.abs(levels).max())


def test_what_a_file_gives_all_its_tendons_is_not_the_springs_of_a_load() -> None:
    given = '<default><tendon stiffness="3 5 7" damping="2 3 4" limited="true" range="-9 9"/></default>'
    plain, spoilt = (Document(mjcf.from_text(CART.replace("<worldbody>", f"{one}<worldbody>"))) for one in ("", given))
    values = {"mass": 0.2, "small_swing_frequency": 1.5, "damping_ratio": 0.1, "slope_2": 2.0}
    for document in (plain, spoilt):
        SwingingLoadOfAnyLaw([0.0, 0.02, 0.05], values).edit(document, "cart", values)
    one, other = (mjcf.compile(document.text()) for document in (plain, spoilt))
    for name in ("stiffness", "stiffnesspoly", "damping", "dampingpoly", "limited"):
        np.testing.assert_array_equal(getattr(one, f"tendon_{name}"), getattr(other, f"tendon_{name}"))
    assert list(loads(one)) == list(loads(other)) == ["cart_load"]


@pytest.mark.parametrize("polynomial", ['stiffness="9 2 0"', 'stiffness="9 0 -4"', 'damping="1 2 0"'])
def test_a_load_that_no_pass_follows_is_simulated_as_any_joint(polynomial: str) -> None:
    """Its springs pull more on one side, push from some stretch on, or its dampers go with more than speed."""
    document = Document(mjcf.from_text(CART))
    catalogue()["load.swinging"].edit(document, "cart", hidden("load.swinging")[1])
    assert list(loads(mjcf.compile(document.text()))) == ["cart_load"]
    name, _, numbers = polynomial.partition("=")
    tendon = document.root.find("tendon/fixed")
    assert tendon is not None
    tendon.set(name, numbers.strip('"'))
    assert not loads(mjcf.compile(document.text()))


@given(st.lists(st.tuples(st.floats(0.005, 0.1), st.floats(0.01, 30.0)), min_size=1, max_size=8))
def test_a_law_of_a_swing_that_is_made_finer_is_the_same(stretches: list[tuple[float, float]]) -> None:
    widths, slopes = zip(*stretches, strict=True)
    values = {"mass": 0.2, "small_swing_frequency": 1.5, "damping_ratio": 0.1}
    values |= {f"slope_{k + 1}": slope / slopes[0] for k, slope in enumerate(slopes) if k}
    values = {name: min(max(value, 0.01), 30.0) for name, value in values.items()}  # as laws are bounded
    law = SwingingLoadOfAnyLaw([0.0, *np.cumsum(widths).tolist()], values)
    ((finer, same),) = law.finer(values)
    before, after = (one.law_of(now, {"mass": "kg"})["table"] for one, now in ((law, values), (finer, same)))
    told, finer_told = before["inputs"][0]["knots"], after["inputs"][0]["knots"]
    again = np.interp(told, finer_told, after["levels"])
    np.testing.assert_allclose(again, before["levels"], rtol=1e-6, atol=1e-9 * np.abs(again).max())


@pytest.mark.parametrize("effect", EFFECTS)
def test_windows_begin_with_what_the_motion_before_left(effect: str) -> None:
    """With the right parameters nearly nothing is left, in late windows as in early ones.

    A rest is known as well as the positions at which the motion turned round.
    """
    rig = written(effect)
    run = record(rig, sweep(4.0), noise=(1e-5,))
    ready = prepared(CART, [run], stepping=Stepping(0.001, RK4))
    law, values = hidden(effect)
    structure = ready.structure.with_term(Term(law, "cart", values))
    right = fit(ready.problem, structure, most=0)
    without = fit(ready.problem, ready.structure, most=0)
    assert without.error > 20
    assert right.error < 0.03 * without.error
    assert np.sqrt(np.median(right.mse)) < 2


@pytest.mark.parametrize("stepping", [Stepping(0.001, RK4), Stepping(0.001)], ids=["engine", "mujoco"])
@pytest.mark.parametrize("effect", ["friction.hysteresis", "load.swinging", "load.swinging:law"])
def test_windows_without_their_motions_are_refused(effect: str, stepping: Stepping) -> None:
    """Neither simulator begins with springs unbent and loads at rest where nobody knows."""
    rig = written(effect)
    windows = cut([record(rig, sweep(4.0), 0.5)], np.ones(1), 0.25, (0.0, 1.0))
    with pytest.raises(ValueError, match="depends on its motion; give the windows"):
        simulate([rig], windows, np.zeros((1, len(windows), 2)), stepping, base=["cart"])


def test_a_creeping_spring_is_maxwells_element() -> None:
    """Pulled out at once and held, it relaxes by its time constant, whatever inertia the node needs."""
    time, step = 0.4, 1e-3
    model = written("load.creeping").model
    stamps = np.arange(0.0, 2.0, step)
    held = np.minimum(stamps / 0.01, 1.0) * 0.02
    ground = float(model.dof_damping[1] / model.dof_armature[1])
    spring = Spring(0.0, float(model.tendon_stiffness[0] / model.dof_armature[1]))
    behind, _ = swing([spring], 0.0, held, np.gradient(held, step), stamps, ground=ground)
    later = np.searchsorted(stamps, [0.1, 0.5, 0.9])
    np.testing.assert_allclose(np.diff(np.log(-behind[later])), -0.4 / time, rtol=1e-3)
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
    runs = [record(rig, sweep(strength), noise=(1e-5,), step=1e-4) for strength in (4.0, 5.0)]
    likely = [one for one in catalogue().values() if one.id.startswith(("friction", "load"))]
    found = diagnose(mjcf.from_text(CART), runs[:1], runs[1:], effects=likely)
    assert found.missing[0].effect == effect
    assert found.missing[0].at == "cart"
    assert found.held_out is not None
    assert found.held_out.improved < 0.05 * found.held_out.recalibrated
    assert not found.to_dict()["needs_dipc_gym"]
    assert bool(found.needs_loader) == bool(physics.load(found.improved).extras)
    mujoco.MjModel.from_xml_string(found.improved)


def test_sensitivities_go_through_yielding() -> None:
    """Exact derivatives by the elements' forces, and by initial states, are limits of differences."""
    ready = prepared(CART, [record(written("friction.hysteresis"), sweep(4.0), 2.0, noise=(1e-5,))])
    law, values = hidden("friction.hysteresis")
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


def test_a_load_that_swings_wide_is_found_with_the_law_of_its_spring() -> None:
    """Its spring hardens without end, by MuJoCo's own polynomial; a law of the tool's is level where data end."""
    document = Document(mjcf.from_text(CART))
    catalogue()["load.swinging"].edit(document, "cart", {"mass": 0.25, "frequency": 1.6, "damping_ratio": 0.06})
    (spring,) = document.root.iter("fixed")
    document.set(spring, stiffness=(float(spring.get("stiffness", "").split()[0]), 0.0, 1e3))
    rig = physics.from_model(mjcf.compile(document.text()))
    runs = [record(rig, sweep(volts), 8.0, noise=(1e-4,)) for volts in (6.0, 4.0)]
    found = diagnose(mjcf.from_text(CART), runs)
    (load,) = found.missing
    assert load.effect == "load.swinging"
    assert load.law is not None
    assert load.parameters["mass"]["value"] == pytest.approx(0.25, rel=0.05)
    assert load.parameters["small_swing_frequency"]["value"] == pytest.approx(1.6, rel=0.1)
    (along,), levels = load.law["table"]["inputs"], np.array(load.law["table"]["levels"])
    slopes = np.diff(levels) / np.diff(along["knots"])
    middle = len(slopes) // 2
    assert min(slopes[0], slopes[-1]) > 1.5 * max(slopes[middle - 1 : middle + 1])
    assert found.held_out.improved < 1.5
    assert not mjcf.compile(found.improved).nuserdata  # stock MuJoCo keeps nothing in mind for it


def test_a_load_begins_where_the_motion_brought_it_whatever_its_joint_is_corrected_to() -> None:
    """A centimetre aside of where the joint was: a load that hardly pulls stays where it is."""
    run = record(physics.load(CART), sweep(4.0), 1.5)
    windows = prepared(CART, [run]).problem.windows.pick(np.array([2]))
    document = Document(mjcf.from_text(CART))
    catalogue()["load.swinging"].edit(document, "cart", {"mass": 0.3, "frequency": 0.5, "damping_ratio": 0.01})
    sensors = document.add("sensor", "jointpos", name="load", joint="cart_load")
    assert sensors is not None
    rig = physics.from_model(mjcf.compile(document.text()))
    initial = np.array([[[0.0, 0.0]], [[0.01, 0.0]]])
    wide = replace(windows, observed=np.zeros((1, windows.times.shape[1], 2)), noise=np.ones(2))
    for stepping in (Stepping(0.001, RK4), Stepping(0.001)):
        at_first = simulate([rig, rig], wide, initial, stepping, base=["cart"])[:, 0, 0]
        assert at_first[1, 0] - at_first[0, 0] == pytest.approx(0.01, abs=1e-4)
        assert at_first[1, 1] == pytest.approx(at_first[0, 1], abs=1e-4)


def test_a_tendon_round_sites_is_no_spring_of_a_load() -> None:
    """Numbers of its sites are none of joints, and there may be more of them."""
    document = Document(mjcf.from_text(CART))
    catalogue()["load.swinging"].edit(document, "cart", HIDDEN["load.swinging"])
    text = document.text()
    sites = "".join(f'<site name="s{k}" pos="{k} 0 1"/>' for k in range(6))
    text = text.replace("<worldbody>", f"<worldbody>{sites}")
    winding = '<spatial name="rope" stiffness="3"><site site="s4"/><site site="s5"/></spatial>'
    text = text.replace("</tendon>", f"{winding}</tendon>")
    model = mjcf.compile(text)
    assert model.ntendon == 2
    assert list(loads(model)) == ["cart_load"]


def test_a_lagging_sensor_begins_with_what_it_reads_there_less_most_of_its_noise() -> None:
    """What the motion that it told would have it read is late twice, and shows as a lag that is too short."""
    noise, late = 2e-4, 0.04
    document = Document(mjcf.from_text(CART))
    catalogue()["timing.sensor_lag"].edit(document, "cart", {"time_constant": late})
    rig = physics.load(mjcf.from_text(document.text()))
    true, run = (record(rig, sweep(2.0), 8.0, noise=size, period=0.005, seed=2) for size in (0.0, noise))
    windows = prepared(CART, [run]).problem.windows
    read = np.interp(windows.start, true.time, true.sensors[:, 0])
    speed = windows.begun()[:, 1]
    told = windows.as_read(0, read - late * speed)
    assert np.sqrt(np.mean((told - read) ** 2)) < 0.7 * noise
    assert abs(np.mean((told - read) * np.sign(speed))) < 0.2 * noise


def test_a_lagging_sensor_leaves_the_states_of_other_joints_known() -> None:
    """Else friction that holds a trolley would be granted whatever beginning suits it."""
    ready = prepared(HANGING, [record(physics.load(HANGING), sweep(3.0), 2.0, noise=NOISE["hanging"], start=(0, 0.4))])
    lagging = ready.structure.with_term(Term(catalogue()["timing.sensor_lag"], "pole1", {"time_constant": 0.02}))
    known = Shooting(ready.problem, ready.structure).spread
    assert Shooting(ready.problem, lagging).spread / known == pytest.approx([1, 1e3, 1, 1, 1e3, 1])


def test_what_a_late_sensor_tells_of_a_load_is_late_as_well() -> None:
    """Where a load swings follows from the motion, which is told by a sensor that lags: taken as it is read, the true
    model leaves several times the noise.
    """
    document, values = Document(mjcf.from_text(CART)), HIDDEN["load.swinging"]
    load, lag, late = catalogue()["load.swinging"], catalogue()["timing.sensor_lag"], {"time_constant": 0.006}
    load.edit(document, "cart", values)
    lag.edit(document, "cart", late)
    rig = physics.load(mjcf.from_text(document.text()))
    ready = prepared(CART, [record(rig, sweep(2.0), 8.0, noise=2e-5, integrator=RK4, seed=3)])
    true = ready.structure.with_term(Term(load, "cart", values)).with_term(Term(lag, "cart", late))
    later = ready.problem.pick(ready.problem.windows.start > 0.5)
    assert fit(later, true, most=0).error == pytest.approx(1.0, abs=0.15)
