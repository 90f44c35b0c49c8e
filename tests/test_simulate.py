"""Windows of recordings, and their simulation with many variants at once."""

from __future__ import annotations

import copy
import re
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline
from sim2real_rigs import CART, HANGING, NOISE, RK4, TORQUE, prepared, record, sweep

from dipc_gym import mjcf, physics
from dipc_gym.engine import Uncovered
from dipc_gym.mjcf.edit import Document
from dipc_gym.physics import entries
from dipc_gym.recording import Recording
from dipc_gym.sim2real.effects import catalogue
from dipc_gym.sim2real.estimation import problem
from dipc_gym.sim2real.estimation.fit import fit
from dipc_gym.sim2real.estimation.problem import Problem, predict, sensitivities
from dipc_gym.sim2real.estimation.settings import ESTIMATION
from dipc_gym.sim2real.model.structure import Structure, Term
from dipc_gym.sim2real.simulation import batch
from dipc_gym.sim2real.simulation.batch import Stepping, grid_step, simulate
from dipc_gym.sim2real.simulation.heat import heating_motors, winding_temperatures
from dipc_gym.sim2real.simulation.windows import cut

AS_GIVEN = Stepping(0.001)
INVERTED = TORQUE.replace('pos="0 0 -0.2"', 'pos="0 0 0.2"')
FINE = Stepping(0.001, RK4)


def rig(text: str, effect: str = "", at: str = "", **values: float) -> physics.Physics:
    document = Document(mjcf.from_text(text))
    if effect:
        catalogue()[effect].edit(document, at, values)
    return physics.from_model(mjcf.compile(document.text()))


def blank(time: np.ndarray, sensors: int = 1) -> Recording:
    n = len(time)
    return Recording("made up", time, np.zeros((n, 1)), np.zeros((n, sensors)), ["motor"], list("abc")[:sensors])


# Cutting


def test_windows_lie_end_to_end_and_hold_every_sample_once() -> None:
    time = np.arange(1000) * 0.002 + 5.0
    windows = cut([blank(time), blank(time[:600])], np.ones(1), 0.25, (0.0, 1.0))
    assert len(windows) == 8 + 4
    assert windows.source.tolist() == [0] * 8 + [1] * 4
    first = windows.pick(windows.source == 0)
    seen = (first.start[:, None] + first.times)[first.valid]
    assert seen == pytest.approx(time, abs=1e-12)
    assert windows.valid.all()


def test_a_span_is_a_part_of_each_recording() -> None:
    time = np.arange(2001) * 0.002
    train = cut([blank(time)], np.ones(1), 0.25, (0.0, 0.75))
    held = cut([blank(time)], np.ones(1), 0.25, (0.75, 1.0))
    assert len(train) == 12
    assert len(held) == 4
    assert (train.start + train.times[:, -1]).max() < held.start.min() == 3.0


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 10_000), st.floats(0.05, 0.4))
def test_irregular_windows_neither_overlap_nor_repeat(seed: int, length: float) -> None:
    rng = np.random.default_rng(seed)
    time = np.cumsum(rng.exponential(0.004, 400) + 1e-4)
    windows = cut([blank(time)], np.ones(1), length, (0.0, 1.0))
    stamps = (windows.start[:, None] + windows.times)[windows.valid]
    assert np.all(np.diff(stamps) > 0)
    assert np.isin(np.round(stamps, 9), np.round(time, 9)).all()
    assert (windows.times[:, -1] <= length + 1e-9).all()
    assert (windows.valid.sum(axis=1) >= 4).all()


def test_too_short_a_recording_gives_no_window() -> None:
    assert not len(cut([blank(np.arange(50) * 0.002)], np.ones(1), 0.25, (0.0, 1.0)))


def test_a_whole_number_of_steps_fits_a_sample() -> None:
    windows = cut([blank(np.arange(500) * 0.0033)], np.ones(1), 0.25, (0.0, 1.0))
    assert grid_step(windows, Stepping(0.001, RK4)) == pytest.approx(0.0033 / 4)
    assert grid_step(windows, Stepping(0.01, RK4)) == pytest.approx(0.0033)
    assert grid_step(windows, Stepping(0.001)) == 0.001  # as its owner runs it


def test_between_the_steps_of_a_model_as_it_is_readings_are_those_of_its_motion() -> None:
    """Samples that lie on no step, of a pendulum that is simulated at its own."""
    plain = rig(TORQUE)
    windows = cut([blank(np.arange(500) * 0.0033)], np.ones(1), 0.25, (0.0, 1.0))
    initial = np.tile([0.4, -0.3], (len(windows), 1))
    off, on = (
        simulate([plain], windows, initial[None], stepping, base=("shoulder",))[0]
        for stepping in (Stepping(0.001), Stepping(0.0033 / 4, RK4))
    )
    assert np.abs(off - on).max() < 2e-3  # of first order in the step
    assert np.abs(np.diff(off - on, n=2, axis=1)).max() < 1e-5  # and not in the sample's place between two


# As MuJoCo does it


@pytest.mark.parametrize("text", [CART, HANGING, TORQUE])
def test_as_given_is_mujocos_own_step_to_the_last_bit(text: str) -> None:
    """On the grid, with the model's step and integrator, windows are what `mj_step` does."""
    plain = rig(text)
    count = plain.model.nv
    run = record(plain, sweep(2.0), 1.0, period=0.001, step=0.001, start=[0.05, 0.4, -0.2][:count])
    windows = cut([run], np.ones(count), 0.25, (0.0, 1.0))
    initial = np.random.default_rng(1).normal(size=(len(windows), 2 * count)) * 0.3
    base = [plain.model.joint(j).name for j in range(plain.model.njnt)]
    readings = simulate([plain], windows, initial[None], AS_GIVEN, base=base)[0]
    data = mujoco.MjData(plain.model)
    for k in range(len(windows)):
        mujoco.mj_resetData(plain.model, data)
        data.qpos[:], data.qvel[:] = initial[k, :count], initial[k, count:]
        first = int(np.searchsorted(run.time, windows.start[k] - 1e-9))
        for i in range(readings.shape[1]):
            data.ctrl[:] = run.commands[first + i]
            mujoco.mj_step(plain.model, data)
            assert np.array_equal(data.sensordata, readings[k, i])


def test_threads_do_not_change_a_bit() -> None:
    P = prepared(HANGING, [record(rig(HANGING), sweep(3.0), 2.0, noise=NOISE["hanging"])])
    one, two = (
        predict(replace(P.problem, threads=n), P.structure, [P.structure.first], P.problem.initial[None])
        for n in (1, 2)
    )
    assert np.array_equal(one, two)


def test_a_simulation_that_diverges_is_not_restarted() -> None:
    """MuJoCo would put it back to where the model begins, which near rest is no bad prediction."""
    P = prepared(CART, [record(rig(CART), sweep(4.0), 1.0, noise=1e-5)])
    base = P.structure
    document = base.document.copy()
    document.set(document.joint("cart"), damping=-1e9)
    broken = Structure(document, base.model, base.base)
    readings = predict(P.problem, broken, [broken.first], P.problem.initial[None])[0]
    assert readings.shape == P.problem.windows.observed.shape
    assert not (np.abs(readings[:, -1]) < 1e6).any()


@pytest.mark.parametrize(
    ("effect", "values"),
    [
        ("friction.coulomb", {"level": 2.0}),
        ("friction.load", {"level": 1.0, "by_drive": 0.1, "by_weight": 0.1}),
        (
            "friction.load:stribeck",
            {"level": 1.0, "by_drive": 0.1, "by_weight": 0.1, "excess": 0.5, "velocity": 0.02},
        ),
        ("friction.position", {"first": -0.1, "last": 0.1, **{f"level_{k}": 1.0 + k / 3 for k in range(1, 6)}}),
        ("friction.position:wave", {"level": 2.0, "sine": 0.5, "cosine": 0.5, "wavelength": 0.1}),
    ],
)
def test_a_window_that_diverges_leaves_the_others_alone(effect: str, values: dict[str, float]) -> None:
    windows = cut([noisy(rig(CART), 0.5)], np.ones(1), 0.25, (0.0, 1.0))
    initial = np.zeros((2, len(windows), 2))
    initial[1, 1] = np.nan
    dry = rig(CART, effect, "cart", **values)
    whole, broken = (simulate([dry], windows, one[None], FINE, base=["cart"])[0] for one in initial)
    others = np.arange(len(windows)) != 1
    assert not np.isfinite(broken[1]).any()
    assert np.array_equal(broken[others], whole[others])


# Samples and commands between steps


def test_a_command_that_changes_with_time_does_so_in_either_simulator(monkeypatch: pytest.MonkeyPatch) -> None:
    """A drive that fades pushes a free mass as far as integration says."""
    monkeypatch.setattr(entries, "_known", dict(entries._known))
    physics.register("motor.fades", "command", lambda data, now: now.value * np.exp(-now.time / data[..., 0]))
    text = """<mujoco><worldbody><body><inertial pos="0 0 0" mass="2" diaginertia="1 1 1"/>
        <joint name="cart" type="slide" axis="1 0 0"/></body></worldbody>
        <actuator><motor name="motor" joint="cart"/></actuator><sensor><jointpos name="x" joint="cart"/></sensor>
        <custom><numeric name="dipc_gym:motor.fades:motor" data="0.1"/></custom></mujoco>"""
    time = 2e-3 * np.arange(252)
    run = Recording("fades", time, np.ones((252, 1)), np.zeros((252, 1)), ["motor"], ["x"])
    windows = cut([run], np.ones(1), 0.5, (0.0, 1.0))
    at = windows.times[0]
    moved = 0.1 / 2 * (at - 0.1 * (1 - np.exp(-at / 0.1)))
    for stepping in (Stepping(2e-3, None), Stepping(2e-3, mujoco.mjtIntegrator.mjINT_RK4)):
        read = simulate([rig(text)], windows, np.zeros((1, len(windows), 2)), stepping, base=["cart"])[0, 0, :, 0]
        assert read == pytest.approx(moved, rel=0.02, abs=0.02 * moved[-1])


def test_irregular_samples_are_read_between_steps() -> None:
    """Readings between grid points are as good as the simulation: a free pendulum against its equation."""
    text = TORQUE.replace('name="arm"', 'name="arm" quat="1 0 0 0"')
    rng = np.random.default_rng(4)
    time = np.cumsum(rng.uniform(0.5, 1.5, 300) * 0.004)
    run = Recording("irregular", time, np.zeros((300, 1)), np.zeros((300, 1)), ["drive"], ["angle"])
    windows = cut([run], np.ones(1), 0.25, (0.0, 1.0))
    initial = np.tile([0.7, 2.0], (len(windows), 1))
    readings = simulate([rig(text)], windows, initial[None], FINE, base=["shoulder"])[0]
    inertia = 0.01 + 0.8 * 0.2**2
    exact = solve_ivp(
        lambda t, y: [y[1], -0.8 * 9.81 * 0.2 * np.sin(y[0]) / inertia],
        (0, 0.3),
        [0.7, 2.0],
        rtol=1e-11,
        atol=1e-12,
        dense_output=True,
    )
    for k in range(len(windows)):
        n = int(windows.valid[k].sum())
        assert readings[k, :n, 0] == pytest.approx(exact.sol(windows.times[k, :n])[0], abs=1e-8)


def test_commands_are_averaged_over_each_step() -> None:
    """A mass under force steps at odd moments gets the impulse of the held force, whatever the grid."""
    text = TORQUE.replace('type="hinge" axis="0 1 0"', 'type="slide" axis="1 0 0"').replace('gear="2"', 'gear="1"')
    rng = np.random.default_rng(5)
    time = np.cumsum(rng.uniform(0.3, 1.7, 400) * 0.0021)
    force = rng.normal(size=400)
    run = Recording("steps", time, force[:, None], np.zeros((400, 1)), ["drive"], ["angle"])
    windows = cut([run], np.ones(1), 0.25, (0.0, 1.0))
    initial = np.zeros((len(windows), 2))
    readings = simulate([rig(text)], windows, initial[None], FINE, base=["shoulder"])[0]
    for k in range(len(windows)):
        first = int(np.searchsorted(time, windows.start[k] - 1e-12))
        n = int(windows.valid[k].sum())
        x = v = 0.0
        for i in range(1, n):
            h, a = time[first + i] - time[first + i - 1], force[first + i - 1] / 0.8
            x, v = x + v * h + a * h * h / 2, v + a * h
            # What is left is how a cubic reads a bend of the path between steps.
            assert readings[k, i, 0] == pytest.approx(x, abs=0.2 * 0.001**2)


# Delays


def test_a_delay_is_an_earlier_command() -> None:
    """Whole steps of delay are the commands of that many steps ago; MuJoCo's own delay does the same."""
    run = record(rig(CART), sweep(4.0), 2.0, period=0.001, step=0.001)
    late = rig(CART, "timing.delay", "motor", delay=0.007)
    windows = cut([run], np.ones(1), 0.25, (0.0, 1.0)).pick(np.arange(1, 7))
    initial = np.tile([0.0, 0.1], (len(windows), 1))
    readings = simulate([late], windows, initial[None], AS_GIVEN, base=["cart"])[0]

    shifted = replace(run, commands=np.concatenate([np.repeat(run.commands[:1], 7, axis=0), run.commands[:-7]]))
    moved = replace(windows, recordings=(shifted,))
    assert readings == pytest.approx(simulate([rig(CART)], moved, initial[None], AS_GIVEN, base=["cart"])[0], abs=1e-12)

    data = mujoco.MjData(late.model)
    for k in range(len(windows)):
        first = int(np.searchsorted(run.time, windows.start[k] - 1e-9))
        mujoco.mj_resetData(late.model, data)
        for i in range(first - 20, first + readings.shape[1]):
            if i == first:  # until here its history fills
                data.qpos[:], data.qvel[:] = initial[k]
            data.ctrl[:] = run.commands[i]
            mujoco.mj_step(late.model, data)
            if i >= first:
                assert data.sensordata[0] == pytest.approx(readings[k, i - first, 0], abs=1e-9)


@pytest.mark.parametrize("delay", [0.0004, 0.0013, 0.0171])
def test_part_of_a_step_of_delay_counts(delay: float) -> None:
    """A mass under a ramp: a delay tau takes tau off the ramp's time."""
    text = TORQUE.replace('type="hinge" axis="0 1 0"', 'type="slide" axis="1 0 0"').replace('gear="2"', 'gear="0.8"')
    time = np.arange(400) * 0.002
    run = Recording("ramp", time, time[:, None], np.zeros((400, 1)), ["drive"], ["angle"])
    windows = cut([run], np.ones(1), 0.25, (0.0, 1.0)).pick(np.array([1, 2]))
    late = rig(text, "timing.delay", "drive", delay=delay)
    readings = simulate([late], windows, np.zeros((1, 2, 2)), FINE, base=["shoulder"])[0]
    for k in range(2):
        # Held steps of 2 ms lie one millisecond behind the ramp.
        begin = windows.start[k] - delay - 0.001
        t = windows.times[k]
        assert readings[k, :, 0] == pytest.approx(begin * t**2 / 2 + t**3 / 6, abs=2e-7)


def noisy(rig: physics.Physics, size: float) -> Recording:
    """Commands as of a loop that feeds back noise, new every 2 ms."""
    time, names = np.arange(1500) * 0.002, mjcf.scalar_sensors(rig.model)
    commands = np.random.default_rng(6).normal(size=(1500, 1)) * size
    return Recording("noisy", time, commands, np.zeros((1500, len(names))), list(mjcf.controls(rig.model)), names)


@pytest.mark.parametrize("delay", [0.0005, 0.0013, 0.0071])
@pytest.mark.parametrize(("text", "joints"), [(CART, 1), (HANGING, 3)])
def test_commands_that_change_within_a_step_do_so_to_second_order(text: str, joints: int, delay: float) -> None:
    """Coarse steps come to where fine ones do, in which commands change on the grid."""
    late = rig(text, "timing.delay", "motor", delay=delay)
    run = noisy(late, 4.0)
    base = mjcf.base_joints(late.model)
    windows = cut([run], np.ones(run.sensors.shape[1]), 0.25, (0.2, 1.0))
    initial = np.zeros((1, len(windows), 2 * joints))
    coarse, fine = (simulate([late], windows, initial, Stepping(h, RK4), base=base) for h in (0.002, 0.0001))
    # Such commands move the cart by up to 2e-5 m within a step, and the poles by 8e-5 rad.
    assert np.abs(coarse - fine).max() < 5e-6


def test_what_sticks_stays_where_it_is_whenever_commands_change() -> None:
    stuck = rig(CART, "friction.coulomb", "cart", level=20.0)
    late = copy.copy(stuck.model)
    late.actuator_delay[:] = 0.0013
    run = noisy(stuck, 0.5)
    windows = cut([run], np.ones(1), 0.25, (0.2, 1.0))
    readings = simulate([physics.from_model(late)], windows, np.zeros((1, len(windows), 2)), FINE, base=["cart"])
    assert np.abs(readings).max() < 1e-12


# Several variants at once


def test_every_variant_has_its_own_fields() -> None:
    """A batch of structures with different parameters predicts what each would alone, the loader's effects included."""
    P = prepared(HANGING, [record(rig(HANGING), sweep(3.0), 1.5, noise=NOISE["hanging"], start=(0, 0.4, -0.3))])
    S = P.structure
    for effect, at, guess in (
        ("friction.stribeck", "cart", {"level": 2.0, "static": 3.0, "velocity": 0.05}),
        ("friction.position", "cart", {"first": -0.1, "last": 0.1, **{f"level_{k}": 1.0 + k / 3 for k in range(1, 6)}}),
        ("transmission.compliance", "motor", {"stiffness": 3e3, "damping": 10.0, "rotor_inertia": 0.2}),
        ("timing.delay", "motor", {"delay": 0.004}),
        ("timing.sensor_lag", "pole1", {"time_constant": 0.004}),
        ("motor.thermal", "motor", {"thermal_resistance": 3.0, "time_constant": 5.0}),
        ("motor.deadzone", "motor", {"width": 0.3}),
        ("load.tilt", "world", {"about_x": 0.01, "about_y": 0.02}),
    ):
        structure = S.with_term(Term(catalogue()[effect], at, guess))
        Z = [structure.first, structure.first + 0.2, structure.first - 0.2]
        together = predict(P.problem, structure, Z, P.problem.initial[None])
        alone = [predict(P.problem, structure, [z], P.problem.initial[None])[0] for z in Z]
        assert together == pytest.approx(np.stack(alone), abs=1e-10), effect
        assert not np.allclose(together[0], together[1], atol=1e-9), effect


# What windows remember


def test_a_lagging_sensor_remembers_the_motion_before_its_window() -> None:
    """A cart under a force that switches at every sample, against the closed form of what its filter says."""
    tau, period, mass = 0.003, 0.002, 1.26
    gear = 4.0
    driven = '<motor name="motor" joint="cart" gear="4"/>'
    bare = re.sub("<dcmotor[^>]*>", driven, CART.replace('damping="21.4"', 'damping="0"'))
    time = period * np.arange(300)
    volts = np.random.default_rng(3).uniform(-10, 10, len(time))
    x = v = y = 0.0
    said, states = np.empty(len(time)), np.empty((len(time), 2))
    for k, a in enumerate(gear * volts / mass):
        said[k], states[k] = y, (x, v)
        # y' = (x - y) / tau is met by x - tau v + tau^2 a, and what is lacking from that decays.
        ahead = x + v * period + a * period**2 / 2
        settled = x - tau * v + tau**2 * a
        x, v = ahead, v + a * period
        y = x - tau * v + tau**2 * a + (y - settled) * float(np.exp(-period / tau))
    run = Recording("shaken", time, volts[:, None], said[:, None], ["motor"], ["cart"])
    windows = cut([run], np.ones(1), 0.25, (0.0, 1.0)).pick(np.array([1]))
    begin = round(windows.start[0] / period)
    late = rig(bare, "timing.sensor_lag", "cart", time_constant=tau)
    readings = simulate(
        [late],
        windows,
        states[None, None, begin],
        Stepping(5e-4, RK4),
        base=["cart"],
        warm=0.06,
        approach=states[None, None, begin - 30],
    )[0, 0, :, 0]
    bend = gear * 10 / mass * period**2  # by how much a step bends, with the largest force
    np.testing.assert_allclose(readings, windows.observed[0, :, 0], atol=5e-3 * bend)


@pytest.mark.parametrize("stepping", [Stepping(2e-4, RK4), Stepping(5e-5, mujoco.mjtIntegrator.mjINT_IMPLICITFAST)])
def test_windows_of_a_fast_axis_begin_with_what_its_late_sensor_read(stepping: Stepping) -> None:
    """The motion that it tells is late itself, so that what follows from it is far from the reading."""
    axis = """<mujoco><option timestep="5e-4" integrator="implicitfast"/><worldbody><body>
      <inertial pos="0 0 0" mass="0.1" diaginertia="2e-4 2e-4 2e-4"/>
      <joint name="axis" type="hinge" axis="0 0 1" damping="2e-4"/></body></worldbody>
      <actuator><motor name="motor" joint="axis"/></actuator>
      <sensor><jointpos name="axis" joint="axis"/></sensor></mujoco>"""
    late, noise = {"time_constant": 0.011}, 2.4e-4
    run = record(rig(axis, "timing.sensor_lag", "axis", **late), sweep(0.06), noise=noise, step=1e-4, integrator=RK4)
    ready = prepared(axis, [run], stepping=stepping)
    there = ready.structure.with_term(Term(catalogue()["timing.sensor_lag"], "axis", late))
    assert fit(ready.problem, ready.structure, most=0).error > 50
    assert fit(ready.problem, there, most=0).error < 1.1


def test_currents_follow_voltages_with_their_time_constant() -> None:
    """A locked motor's torque, integrated by a flywheel that hardly moves, against the closed form."""
    text = CART.replace('mass="1.26"', 'mass="1e4"').replace('damping="21.4"', 'damping="0"')
    for tau in (0.001, 0.003, 0.01):
        winding = rig(text, "motor.inductance", "motor", time_constant=tau)
        time = np.arange(300) * 0.002
        volts = np.where(time >= 0.3, 5.0, 0.0)
        run = Recording("step", time, volts[:, None], np.zeros((300, 1)), ["motor"], ["cart"])
        windows = cut([run], np.ones(1), 0.25, (0.0, 1.0)).pick(np.array([1]))
        zero = np.zeros((1, 1, 2))
        stepping = Stepping(5e-4, RK4)
        readings = simulate([winding], windows, zero, stepping, base=["cart"], warm=0.06, approach=zero)[0]
        t = np.maximum(windows.start[0] + windows.times[0] - 0.3, 0.0)
        force = 5.0 * 78.7 * 0.06 / 1.2
        exact = force / 1e4 * (t**2 / 2 - tau * t + tau**2 * (1 - np.exp(-t / tau)))
        # A twentieth of the step, where the step itself is half a millisecond: what a fit would take for inductance.
        assert readings[0, -1, 0] == pytest.approx(exact[-1], abs=force / 1e4 * t[-1] * 5e-5)


@pytest.mark.parametrize("tau", [0.0015, 0.004])
def test_currents_and_back_emf_keep_fourth_order(tau: float) -> None:
    """A cart on a motor with inductance against its differential equations: half the step, a sixteenth of the error."""
    gear, constant, ohms, mass, drag = 78.7, 0.06, 1.2, 1.26, 21.4
    winding = rig(CART, "motor.inductance", "motor", time_constant=tau)
    time = np.arange(200) * 0.002
    volts = 4 * np.sin(40 * time)
    run = Recording("tones", time, volts[:, None], np.zeros((200, 1)), ["motor"], ["cart"])
    windows = cut([run], np.ones(1), 0.25, (0.0, 1.0)).pick(np.array([0]))
    zero = np.zeros((1, 1, 2))

    def rates(t: float, y: np.ndarray, held: float) -> list[float]:
        return [
            y[1],
            (constant * gear * y[2] - drag * y[1]) / mass,
            ((held - constant * gear * y[1]) / ohms - y[2]) / tau,
        ]

    states = [np.zeros(3)]
    for held in volts[: windows.times.shape[1] - 1]:
        states.append(solve_ivp(rates, (0, 0.002), states[-1], args=(held,), rtol=1e-11, atol=1e-14).y[:, -1])
    exact = np.array(states)[:, 0]
    errors = []
    for step in (5e-4, 2.5e-4):
        found = simulate([winding], windows, zero, Stepping(step, RK4), base=["cart"])[0, 0, :, 0]
        errors.append(np.abs(found - exact).max())
    assert errors[0] < 1e-7 * np.ptp(exact)
    assert errors[1] < 0.1 * errors[0]


@pytest.mark.parametrize("delay", [0.0007, 0.002, 0.0093])
def test_a_late_sensor_reads_what_it_would_have_read_before(delay: float) -> None:
    """One sensor of three: the others are not, and a window begins with the state that the late one shows."""
    plain, late = physics.load(HANGING), rig(HANGING, "timing.sensor_lag:delay", "pole1", delay=delay)
    model, step = copy.copy(plain.model), 1e-4
    model.opt.timestep, model.opt.integrator = step, RK4
    data, command = mujoco.MjData(model), sweep(3.0)
    data.qpos[:] = 0, 0.4, -0.3
    states = []
    for k in range(8_000):
        states.append(np.concatenate([data.qpos, data.qvel]))
        data.ctrl[:] = command(0.002 * (k // 20))
        mujoco.mj_step(model, data)
    truth = CubicSpline(np.arange(8_000) * step, np.array(states))
    time = np.arange(400) * 0.002
    seen = np.stack([truth(np.maximum(time - by, 0))[:, j] for j, by in enumerate((0.0, delay, 0.0))], axis=1)
    volts = np.array([[command(t)] for t in time])
    run = Recording("late", time, volts, seen, ["motor"], ["cart", "pole1", "pole2"])
    windows = cut([run], np.ones(3), 0.25, (0.0, 1.0)).pick(np.array([1, 2]))
    initial = truth(windows.start - delay)[None]
    found = simulate([late, plain], windows, initial, FINE, base=["cart", "pole1", "pole2"])
    assert found[0] == pytest.approx(windows.observed, abs=1e-6)
    assert np.abs(found[1] - windows.observed).max() > 1e-4


HOT = {"thermal_resistance": 3.0, "time_constant": 8.0}


@pytest.fixture(scope="module")
def hot() -> tuple[Recording, np.ndarray, np.ndarray]:
    """Twenty seconds with a motor that gets fifty kelvin warmer: recording, times and temperatures of the winding."""
    model = copy.copy(rig(CART, "motor.thermal", "motor", **HOT).model)
    model.opt.timestep, model.opt.integrator = 5e-4, RK4
    data, command = mujoco.MjData(model), sweep(9.0)
    rows, temperature = [], []
    for k in range(40_000):
        if k % 4 == 0:
            mujoco.mj_forward(model, data)
            data.ctrl[:] = command(data.time)
            rows.append([data.time, data.ctrl[0], data.sensordata[0]])
            temperature.append(data.act[0])
        mujoco.mj_step(model, data)
    table = np.array(rows)
    noisy = table[:, 2:] + np.random.default_rng(0).normal(size=(len(table), 1)) * 1e-5
    return Recording("hot", table[:, 0], table[:, 1:2], noisy, ["motor"], ["cart"]), table[:, 0], np.array(temperature)


def test_windings_are_as_hot_as_in_a_simulation_of_the_whole(hot: tuple[Recording, np.ndarray, np.ndarray]) -> None:
    run, time, temperature = hot
    P = prepared(CART, [run])
    assert temperature.max() > 30
    model = rig(CART, "motor.thermal", "motor", **HOT)
    at = P.problem.windows.start
    assert heating_motors(model.model) == [0]
    assert not heating_motors(rig(CART).model)
    (known,) = winding_temperatures([model], np.zeros((1, 1)), 0, run, P.motions[0], at)
    assert known == pytest.approx(np.interp(at, time, temperature), rel=5e-3, abs=0.02)


def test_a_winding_gets_what_its_motor_takes(hot: tuple[Recording, np.ndarray, np.ndarray]) -> None:
    """A range of control cuts off what is beyond, unless the file says that none is."""
    run = hot[0]
    motion = prepared(CART, [run]).motions[0]
    limited = rig(
        CART.replace('motorconst="0.06"', 'motorconst="0.06" ctrlrange="-2 2"'), "motor.thermal", "motor", **HOT
    )
    free = physics.Physics(copy.copy(limited.model), limited.extras)
    free.model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CLAMPCTRL
    models = limited, free, rig(CART, "motor.thermal", "motor", **HOT)
    cut_off, all_of_it, wanted = winding_temperatures(models, np.zeros((3, 1)), 0, run, motion, hot[1])
    np.testing.assert_allclose(all_of_it, wanted)
    assert cut_off.max() < 0.5 * wanted.max()


def test_a_hot_motor_is_predicted_only_from_its_temperature(hot: tuple[Recording, np.ndarray, np.ndarray]) -> None:
    """With the effect's parameters the windows are predicted to the noise; from a cold start they are not."""
    P = prepared(CART, [hot[0]], stepping=Stepping(0.001, RK4))
    S = P.structure.with_term(Term(catalogue()["motor.thermal"], "motor", HOT))
    late = P.problem.pick(P.problem.windows.start > 10)
    error = late.windows.observed - predict(late, S, [S.first], late.initial[None])[0]
    cold = late.windows.observed - predict(late, P.structure, [P.structure.first], late.initial[None])[0]
    assert np.sqrt(np.mean(error**2)) < 0.1 * np.sqrt(np.mean(cold**2))


def test_a_heating_motor_needs_the_motion(hot: tuple[Recording, np.ndarray, np.ndarray]) -> None:
    windows = cut([hot[0]], np.ones(1), 0.25, (0.0, 1.0))
    model = rig(CART, "motor.thermal", "motor", **HOT)
    with pytest.raises(ValueError, match="how hot motor is"):
        simulate([model], windows, np.zeros((1, len(windows), 2)), FINE, base=["cart"])


def test_a_rotor_behind_play_is_where_the_warm_up_left_it() -> None:
    """With play of 3 mm, windows are predicted far better than with a rotor that starts in the middle of it."""
    values = {"gap": 3e-3, "rotor_inertia": 0.3, "contact_rate": 1e3, "contact_damping": 0.3}
    run = record(rig(CART, "transmission.backlash", "motor", **values), sweep(4.0), 4.0, noise=1e-5, step=5e-5)
    P = prepared(CART, [run])
    S = P.structure.with_term(Term(catalogue()["transmission.backlash"], "motor", values))

    def error(structure: Structure) -> float:
        readings = predict(P.problem, structure, [structure.first], P.problem.initial[None])[0]
        return float(np.median(np.abs(P.problem.windows.observed - readings).max(axis=1)))

    effect = type("Centred", (type(S.terms[0].effect),), {"warm": 0.0})()
    centred = replace(S, terms=(replace(S.terms[0], effect=effect),))
    assert error(S) < 0.2 * error(centred)


@pytest.fixture(scope="module")
def balanced() -> tuple[Problem, Structure]:
    """Six seconds of an arm that a controller keeps upright through a shaft that gives way; the model with that."""
    values = {"stiffness": 12.0, "damping": 0.12, "rotor_inertia": 4e-3}
    model = copy.copy(rig(INVERTED, "transmission.compliance", "drive", **values).model)
    model.opt.timestep, model.opt.integrator = 5e-5, RK4
    data, rng, period = mujoco.MjData(model), np.random.default_rng(5), 0.002
    arm = int(model.joint("shoulder").dofadr[0])
    time = period * np.arange(3000)
    commands, angles = np.empty((2, len(time)))
    for k, t in enumerate(time):
        commands[k] = sweep(0.15)(t) - 1.6 * data.qpos[arm] - 0.05 * data.qvel[arm]
        angles[k] = data.qpos[arm] + 1e-5 * rng.normal()
        data.ctrl[0] = commands[k]
        mujoco.mj_step(model, data, 40)
    run = Recording("balanced", time, commands[:, None], angles[:, None], ("drive",), ("angle",))
    ready = prepared(INVERTED, [run])
    return ready.problem, ready.structure.with_term(Term(catalogue()["transmission.compliance"], "drive", values))


def test_a_rotor_on_a_spring_swings_as_it_does_on_a_rig_that_is_kept_from_falling(
    balanced: tuple[Problem, Structure], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Left alone for as long as the rotor needs, the arm falls, and the rotor with it."""
    windows, structure = balanced

    known = windows.pick(np.flatnonzero(windows.windows.start != 0.25))

    def error() -> float:
        return fit(known, structure, most=0).error

    assert np.abs(windows.windows.recordings[0].sensors).max() < 0.5
    assert error() < 1.1
    monkeypatch.setattr(problem, "ESTIMATION", replace(ESTIMATION, stretch=1.0))
    assert error() > 1.6


def test_windows_are_approached_alike_by_the_engine_and_by_mujoco(
    balanced: tuple[Problem, Structure], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Joints are put back three times on the way; what the engine says changes with the parameters is what does."""
    windows, structure = balanced
    z, initial = structure.first, windows.initial
    said = sensitivities(windows, structure, z, [z + 1e-7 * unit for unit in np.eye(len(z))], initial)
    assert said is not None
    readings, by_parameters, _ = said
    moved = [z + sign * 1e-4 * unit for unit in np.eye(len(z)) for sign in (1, -1)]
    monkeypatch.setattr(batch, "compiled", lambda *_: (_ for _ in ()).throw(Uncovered("for comparison")))
    there = predict(windows, structure, [z, *moved], initial[None])
    np.testing.assert_allclose(there[0], readings, atol=1e-7)
    for exact, difference in zip(by_parameters, (there[1::2] - there[2::2]) / 2e-4, strict=True):
        np.testing.assert_allclose(exact, difference, atol=2e-3 * np.abs(difference).max() + 1e-9)


@pytest.mark.parametrize("missing", [(100, 160), (500, 507), (125, 135), (0, 0)])
def test_no_window_reaches_across_a_gap(missing: tuple[int, int]) -> None:
    time = np.delete(np.arange(1001) * 0.002, np.arange(*missing))
    windows = cut([blank(time)], np.ones(1), 0.25, (0.0, 1.0))
    steps = np.where(windows.valid[:, 1:], np.diff(windows.times, axis=1), 0.0)
    assert steps.max() < 0.003
    seen = (windows.start[:, None] + windows.times)[windows.valid]
    assert len(np.unique(seen)) == len(seen) > 700
    assert seen.max() > 1.7  # it goes on behind it


def test_windows_after_a_gap_begin_when_what_was_before_is_forgotten() -> None:
    """What was commanded in a gap is not known, nor what a winding or a filter remembers of it."""
    time = np.delete(np.arange(0, 4, 0.004), np.s_[500:540])
    recording = Recording("gap", time, np.zeros((len(time), 0)), np.sin(time)[:, None], (), ("angle",))
    assert recording.goes_on.tolist() == [time[0], time[500]]
    for after in (0.0, 0.3):
        windows = cut([recording], np.array([1e-3]), 0.25, (0.0, 1.0), after)
        begins = windows.start[windows.start >= time[500]]
        assert begins.min() == pytest.approx(time[500] + after, abs=0.004)
        assert np.diff(windows.start)[windows.start[1:] < 2.0].max() == pytest.approx(0.25, abs=0.004)
    told = windows.after_the_first(-0.31)
    assert not told[windows.start == begins.min()].any()
    assert told[windows.start > begins.min() + 0.1].all()
