"""What MJCF cannot say: each rule by its mechanics, batches against single simulations, and wrong entries."""

from __future__ import annotations

import math
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from mujoco import batch
from scipy.interpolate import RegularGridInterpolator

from dipc_gym import mjcf, physics
from dipc_gym.engine import program
from dipc_gym.engine.run import Commands, Jobs
from dipc_gym.engine.run import run as engine_run
from dipc_gym.physics import entries, formulas
from dipc_gym.sim2real.simulation.compiled import left_to_mujoco

MASS = 2.0


def cart(
    custom: str = "",
    axis: str = "1 0 0",
    timestep: float = 1e-3,
    clock: str = '<clock name="clock"/>',
    motor: str = "",
    loads: str = "",
) -> physics.Physics:
    """A mass on a rail, a force motor, its position sensed."""
    return physics.load(f"""
        <mujoco>
          <option timestep="{timestep}" integrator="implicitfast" iterations="50" tolerance="1e-12"
                  noslip_iterations="3"/>
          <worldbody>
            <body>
              <inertial pos="0 0 0" mass="{MASS}" diaginertia="1 1 1"/>
              <joint name="cart" type="slide" axis="{axis}" solreffriction="0.002 1"/>
            </body>
          </worldbody>
          <actuator><motor name="motor" joint="cart" {motor}/>{loads}</actuator>
          <sensor>
            {clock}
            <jointpos name="x" joint="cart"/>
          </sensor>
          <custom>{custom}</custom>
        </mujoco>""")


def entry(effect: str, at: str, *numbers: float) -> str:
    return f'<numeric name="dipc_gym:{effect}:{at}" data="{" ".join(repr(float(x)) for x in numbers)}"/>'


def run(rig: physics.Physics, command: float, steps: int, x: float = 0.0) -> mujoco.MjData:
    data = mujoco.MjData(rig.model)
    data.qpos[0] = x
    mujoco.mj_forward(rig.model, data)
    rig.step(data, np.array([command]), steps)
    return data


def depends(*inputs: str, on: str = "cart") -> str:
    """What a residual force depends on, as the file says it."""
    return "".join(f'<text name="dipc_gym:input:{k}:residual.force:{on}" data="{i}"/>' for k, i in enumerate(inputs, 1))


# Rules


@pytest.mark.parametrize(("command", "force"), [(0.3, 0.0), (-0.5, 0.0), (2.0, 1.5), (-2.0, -1.5)])
def test_dead_zone_takes_its_width_from_the_command(command: float, force: float) -> None:
    data = run(cart(entry("motor.deadzone", "motor", 0.5)), command, 100)
    assert data.qvel[0] == pytest.approx(force / MASS * 0.1, abs=1e-12)


def test_commands_are_not_changed_in_place() -> None:
    rig = cart(entry("motor.deadzone", "motor", 0.5))
    sent = np.array([[2.0], [0.1]])
    np.testing.assert_array_equal(rig.command(sent), [[1.5], [0.0]])
    np.testing.assert_array_equal(sent, [[2.0], [0.1]])


def test_gain_and_bias_act_in_the_order_of_the_file() -> None:
    gain, bias = entry("sensor.gain", "x", 3.0), entry("sensor.bias", "x", 0.1)
    readings = np.array([[7.0, 2.0], [8.0, -1.0]])
    np.testing.assert_allclose(cart(gain + bias).sense(readings), [[7.0, 6.1], [8.0, -2.9]])
    np.testing.assert_allclose(cart(bias + gain).sense(readings), [[7.0, 6.3], [8.0, -2.7]])
    np.testing.assert_array_equal(readings, [[7.0, 2.0], [8.0, -1.0]])


@given(st.floats(1e-3, 1.0), st.floats(1e-4, 0.5), st.floats(-5, 5), st.floats(-5, 5))
@settings(max_examples=50, deadline=None)
def test_lag_behind_a_ramp_is_exact_at_any_step(tau: float, dt: float, start: float, slope: float) -> None:
    rig = cart(entry("timing.sensor_lag", "x", tau))
    memory = rig.sensor_memory(np.array([0.0, start]))
    for k in range(1, 8):
        t = k * dt
        read = rig.sense(np.array([t, start + slope * t]), memory, dt)
        expected = start + slope * (t - tau * (1 - np.exp(-t / tau)))
        assert read[1] == pytest.approx(expected, rel=1e-9, abs=1e-9)
        assert read[0] == t


def test_lag_behind_a_sine_has_the_gain_and_phase_of_first_order() -> None:
    tau, omega, dt = 0.02, 30.0, 1e-4
    rig = cart(entry("timing.sensor_lag", "x", tau))
    memory = rig.sensor_memory(np.zeros(2))
    time = dt * np.arange(1, 20001)
    read = np.array([rig.sense(np.array([t, np.sin(omega * t)]), memory, dt)[1] for t in time])
    late = time > 20 * tau
    settled = np.sin(omega * time - np.arctan(omega * tau)) / np.hypot(1, omega * tau)
    np.testing.assert_allclose(read[late], settled[late], atol=1e-5)


@given(st.floats(-3, 3), st.lists(st.floats(0, 10), min_size=2, max_size=6))
@settings(max_examples=50, deadline=None)
def test_friction_between_stations_is_linear_and_beyond_them_constant(x: float, levels: list[float]) -> None:
    data = np.array([-1.0, 2.0, *levels])
    now = physics.Moment(*(np.asarray(v) for v in (0.0, x, 0.0, 0.0, 0.0)))
    expected = np.interp(x, np.linspace(-1, 2, len(levels)), levels)
    assert formulas.friction_along(data, now) == pytest.approx(expected, abs=1e-4)


def test_friction_along_the_rail_holds_where_it_is_high_and_lets_go_where_it_is_low() -> None:
    rig = cart(entry("friction.position", "cart", 0.0, 1.0, 5.0, 5.0, 2.0))
    assert abs(run(rig, 4.0, 500, x=0.2).qvel[0]) < 1e-4
    assert run(rig, 4.0, 500, x=1.5).qvel[0] == pytest.approx((4.0 - 2.0) / MASS * 0.5, rel=0.01)


def test_friction_under_load_grows_with_what_the_joint_carries() -> None:
    lift = cart(entry("friction.load", "cart", 1.0, 0.1, 0.1), axis="0 0 1")
    weight, force = MASS * 9.81, 40.0
    friction = 1.0 + 0.1 * (force + weight)  # the motor pushes up, the weight down, the gear carries both
    assert run(lift, force, 300).qvel[0] == pytest.approx((force - weight - friction) / MASS * 0.3, rel=0.01)


def test_what_nobody_commands_is_no_drive_that_friction_under_load_grows_with() -> None:
    """A load in an actuator's clothes pulls with 5 N; where the engine said otherwise, a sentence would tell."""
    cogs = '<dcmotor name="load" joint="cart" input="none" motorconst="0 0" resistance="1" cogging="5 0 1.571"/>'
    rig = cart(entry("friction.load", "cart", 1.0, 0.1, 0.0), clock="", loads=cogs)
    assert run(rig, 40.0, 300).qvel[0] == pytest.approx((40.0 + 5.0 - 1.0 - 0.1 * 40.0) / MASS * 0.3, rel=0.01)
    assert not left_to_mujoco(rig)


@given(st.floats(-1, 1), st.floats(-50, 50), st.floats(-50, 50))
def test_friction_under_load_is_largest_at_rest_and_plain_in_motion(speed: float, drive: float, weight: float) -> None:
    plain, more = np.array([1.0, 0.2, 0.1]), np.array([1.0, 0.2, 0.1, 0.5, 0.03])
    now = replace(formulas.moment(0.0, drive=drive, weight=weight), speed=np.asarray(speed))
    share = formulas.friction_under_load_at_rest(more, now) / formulas.friction_under_load(plain, now)
    assert share == pytest.approx(1.5 if speed == 0 else 1.0 + 0.5 * math.exp(-((speed / 0.03) ** 2)))


def test_a_joint_under_load_breaks_away_late_and_then_slides_with_what_friction_is_left() -> None:
    """30 N against a weight of 19.62 N: the gear carries both, 0.1 of each, and twice as much of it at rest."""
    rig = cart(entry("friction.load_stribeck", "cart", 1.0, 0.1, 0.1, 1.0, 0.01), axis="0 0 1")
    weight = MASS * 9.81
    level = 1.0 + 0.1 * (30.0 + weight)
    assert 30.0 - weight < 2.0 * level
    assert abs(run(rig, 30.0, 300).qvel[0]) < 1e-3
    force = 45.0
    level = 1.0 + 0.1 * (force + weight)
    assert run(rig, force, 300).qvel[0] == pytest.approx((force - weight - level) / MASS * 0.3, rel=0.02)


SAGS = '<text name="dipc_gym:input:1:motor.sag:cart" data="command motor"/>'


def sagging(*numbers: float, room: int = 1, text: str = SAGS) -> str:
    return text + entry("motor.sag", "cart", *numbers) + f'</custom><size nuserdata="{room}"/><custom>'


def test_a_supply_sags_as_a_first_order_lag_says() -> None:
    """It draws less the more it has sagged, so that what it loses goes to a share s / (1 + s) with T / (1 + s).

    The momentum that is lacking tells.
    """
    per, time, command = 0.05, 0.2, 4.0
    rig = cart(sagging(1.0, 0.0, per, time), timestep=1e-3)
    share, sooner = per * command / (1.0 + per * command), time / (1.0 + per * command)
    lost = share * (0.5 - sooner * (1.0 - math.exp(-0.5 / sooner)))
    assert run(rig, command, 500).qvel[0] == pytest.approx(command * (0.5 - lost) / MASS, rel=1e-3)


def test_back_emf_spares_the_supply() -> None:
    """A joint as fast as its command drives it draws nothing, and one that is driven back draws more.

    Of a supply that has sagged by a tenth that is a slower one.
    """
    rig = cart(sagging(1.0, 2.0, 0.1, 0.5))
    data = mujoco.MjData(rig.model)
    for speed, drawn, of_late in ((2.0, 0.0, 0.0), (0.0, 4.0, 0.0), (-1.0, 6.0, 0.0), (1.8, 0.0, 1.0), (2.0, 0.4, 1.0)):
        data.ctrl[0], data.qvel[0], data.userdata[0] = 4.0, speed, of_late
        assert rig.grown(data)[0] == pytest.approx((drawn - of_late) / 0.5)


@given(st.floats(-1e3, 1e3), st.floats(-1e6, 1e6))
def test_a_supply_never_gives_less_than_nothing_nor_more_than_it_has(command: float, memory: float) -> None:
    now = replace(formulas.moment(0.0), inputs=(np.asarray(command),), memory=np.asarray(memory))
    for rule, numbers in (
        (formulas.sagging_force, [1.0, 0.0, 0.1, 1.0]),
        (formulas.sagging_force_by_law, [1.0, 0.0, 1.0, 10.0, 0.4, 0.0, 0.3, 0.7]),
    ):
        left = command + float(rule(np.array(numbers), now))
        assert min(0.0, command) <= left <= max(0.0, command)


def test_a_supply_that_sags_in_proportion_is_a_law_of_two_knots() -> None:
    """That one remembers the share that is lost, the plain one the current: a tenth for each unit of it."""
    for of_late in (0.0, 1.0, 3.0, 7.0, 30.0):
        now = replace(formulas.moment(0.0), inputs=(np.asarray(4.0),), memory=np.asarray(of_late))
        shares = replace(now, memory=0.1 * now.memory)
        plain, law = np.array([2.0, 0.5, 0.1, 0.7]), np.array([2.0, 0.5, 0.7, 5.0, 0.1, 0.0, 0.5])
        assert formulas.sagging_force_by_law(law, shares) == pytest.approx(formulas.sagging_force(plain, now))
        assert formulas.sagging_by_law(law, shares) == pytest.approx(0.1 * formulas.sagging(plain, now))


@pytest.mark.parametrize(
    "numbers",
    [
        (1.0, 0.0, 0.0, 5.0, 0.1, 0.0, 0.5),  # no time at all
        (1.0, 0.0, 1.0, 0.0, 0.1, 0.0, 0.5),  # a table of no length
        (1.0, 0.0, 1.0, 5.0, 0.1, 0.0, -0.5),  # it would add to the drive
        (1.0, 0.0, 1.0, 5.0, -0.1, 0.0, 0.5),  # or would beyond
        (1.0, 0.0, 1.0, 5.0, 0.1, 0.5),  # one level
    ],
)
def test_a_supply_that_gives_more_than_it_has_is_refused(numbers: tuple[float, ...]) -> None:
    text = SAGS.replace("motor.sag", "motor.sag_by_law") + entry("motor.sag_by_law", "cart", *numbers)
    with pytest.raises(mjcf.MjcfError, match=r"motor\.sag_by_law:cart.*out of range"):
        cart(text + '</custom><size nuserdata="1"/><custom>')


@pytest.mark.parametrize("timestep", [1e-4, 2e-3])
def test_periodic_force_moves_a_free_mass_as_integration_says(timestep: float) -> None:
    """Neither early nor late, however long the step over which it is held."""
    size, frequency, phase = 3.0, 2.0, 0.7
    rig = cart(entry("disturbance.periodic", "cart", size, frequency, phase), timestep=timestep)
    omega = 2 * np.pi * frequency
    expected = size / MASS / omega * (np.cos(phase) - np.cos(omega * 0.4 + phase))
    assert run(rig, 0.0, round(0.4 / timestep)).qvel[0] == pytest.approx(expected, rel=2e-4)


def test_a_pulse_gives_its_momentum_and_is_over() -> None:
    rig = cart(entry("disturbance.pulse", "cart", 5.0, 0.1, 0.05))
    assert run(rig, 0.0, 99).qvel[0] == 0.0
    after = run(rig, 0.0, 160)
    assert after.qvel[0] == pytest.approx(5.0 * 0.05 / MASS, abs=5.0 * 1.1e-3 / MASS)
    assert run(rig, 0.0, 300).qvel[0] == after.qvel[0]


def test_forces_on_one_joint_add_up() -> None:
    """5 N that swing slowly, and 3 N from the beginning on, in either order and anew in every step."""
    two = entry("disturbance.periodic", "cart", 5, 0.25, math.pi / 2), entry("disturbance.pulse", "cart", 3, 0.0, 9.0)
    for custom in ("".join(two), "".join(reversed(two))):
        rig = cart(custom)
        data = run(rig, 0.0, 2)
        assert data.qfrc_applied[0] == pytest.approx(8.0, abs=0.01)


def test_stock_mujoco_simulates_the_file_without_the_effect() -> None:
    rig = cart(entry("disturbance.pulse", "cart", 5.0, 0.0, 1.0))
    data = mujoco.MjData(rig.model)
    mujoco.mj_step(rig.model, data, 100)
    assert data.qvel[0] == 0.0


# Batches


def test_in_a_batch_each_law_sees_the_commands_that_its_own_motor_takes() -> None:
    """Ranges of control of 1 and 5 beside each other: of a command of 5 each law has as much as it has alone."""
    table = entry("residual.force", "cart", 9.0, 2, 1, -9.0, 9.0, 0, -9.0, 9.0)
    text = depends("command motor") + table
    variants = [cart(text, motor=f'ctrlrange="-{most} {most}"') for most in (1, 5)]
    alone = [run(one, 5.0, 1).qfrc_applied[0] for one in variants]
    for which in (np.array([0, 1]), np.array([1, 0])):
        sims = batch.Batch(variants[0].model, 2, 1)
        sims.ctrl[:], applied = 5.0, sims.bind("qfrc_applied")
        physics.stack([variants[k] for k in which], np.arange(2)).act(sims, np.zeros((2, 1)), applied, 2e-3)
        np.testing.assert_allclose(applied[:, 0], np.array(alone)[which])


def test_a_batch_of_variants_equals_single_simulations_bit_for_bit() -> None:
    rng = np.random.default_rng(0)
    pendulum = """
        <mujoco>
          <option timestep="0.002" integrator="implicitfast"/>
          <worldbody>
            <body>
              <inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
              <joint name="cart" type="slide" axis="1 0 0"/>
              <body>
                <inertial pos="0 0 -0.3" mass="0.5" diaginertia="0.01 0.01 0.01"/>
                <joint name="pole" axis="0 1 0" damping="0.01"/>
              </body>
            </body>
          </worldbody>
          <actuator><motor name="motor" joint="cart"/></actuator>
          <sensor><jointpos name="cart" joint="cart"/><jointpos name="pole" joint="pole"/></sensor>
          <custom>%s</custom>
        </mujoco>"""
    variants = [
        physics.load(
            pendulum
            % "".join(
                [
                    entry("motor.deadzone", "motor", rng.uniform(0, 1)),
                    entry("friction.load", "cart", *rng.uniform(0.1, 0.5, 3)),
                    entry("friction.position", "pole", -0.5, 0.5, *rng.uniform(0, 0.1, 3)),
                    entry("disturbance.periodic", "pole", *rng.uniform(0.1, 2, 3)),
                    entry("disturbance.pulse", "cart", 3.0, *rng.uniform(0.02, 0.1, 2)),
                    entry("sensor.gain", "pole", rng.uniform(0.5, 2)),
                    entry("timing.sensor_lag", "cart", rng.uniform(0.01, 0.1)),
                ]
            )
        )
        for _ in range(3)
    ]
    which = np.array([0, 1, 2, 1, 0])
    n, steps, dt = len(which), 100, 0.002
    commands = rng.normal(scale=3, size=(steps, n, 1))
    first = rng.normal(scale=0.3, size=(n, 2))

    many = physics.stack(variants, which)
    sims = batch.Batch(variants[0].model, n, 1)
    friction, sensed = sims.expand("dof_frictionloss"), sims.bind("sensordata")
    sims.bind("qfrc_actuator"), sims.bind("actuator_force"), sims.bind("qfrc_bias")
    sims.qpos[:] = first
    sims.forward()
    memory = many.sensor_memory(sensed.copy())
    together = []
    for k in range(steps):
        sims.ctrl[:] = many.command(commands[k])
        many.act(sims, friction, sims.qfrc_applied, dt)
        sims.step()
        together.append(many.sense(sensed, memory, dt))

    for i, variant in enumerate(which):
        alone, data = variants[variant], mujoco.MjData(variants[variant].model)
        data.qpos[:] = first[i]
        mujoco.mj_forward(alone.model, data)
        memory = alone.sensor_memory(data.sensordata.copy())
        for k in range(steps):
            alone.step(data, commands[k, i])
            read = alone.sense(data.sensordata, memory, dt)
            np.testing.assert_array_equal(together[k][i], read)
        np.testing.assert_array_equal(sims.qpos[i], data.qpos)
        np.testing.assert_array_equal(sims.qvel[i], data.qvel)


# Entries


@pytest.mark.parametrize(
    ("custom", "words"),
    [
        (entry("motor.dedzone", "motor", 1.0), "known effects are .*motor.deadzone"),
        ('<numeric name="dipc_gym:motor.deadzone" data="1"/>', "known effects"),
        (entry("motor.deadzone", "cart", 1.0), "no 'cart' in the model; there are motor"),
        (entry("sensor.bias", "cart", 1.0), "no 'cart' in the model; there are clock, x"),
        (entry("friction.load", "motor", 1.0, 0.1, 0.1), "no 'motor' in the model; there are cart"),
        (entry("friction.load", "cart", 1.0), "numbers \\[1.0\\], too few, .*level, by_drive"),
        (entry("friction.position", "cart", 0.0, 1.0, 2.0), "too few"),
        (entry("friction.position", "cart", 1.0, 1.0, 2.0, 2.0), "out of range"),
        (entry("disturbance.pulse", "cart", 1.0, 0.0), "numbers \\[1.0, 0.0\\], too few"),
        (entry("friction.load_stribeck", "cart", 1.0, 0.1, 0.1, 0.5, 0.0), "out of range; .*excess, velocity"),
        (entry("friction.load_by_speed", "cart", 1.0, 0.1, 0.1, 0.5, 0.0, 0.2, 0.1), "out of range; .*fastest, slow"),
        (entry("friction.load_by_speed", "cart", 1.0, 0.1, 0.1, 0.5, 0.1, -0.2, 0.1), "out of range"),
        (entry("friction.load_by_speed", "cart", 1.0, 0.1, 0.1, 0.5, 0.1, 0.2), "too few"),
        (sagging(1.0, 0.0, -0.1, 1.0), "out of range; .*gain, back, per, time constant"),
        (sagging(1.0, 0.0, 0.1, 1e-4), "out of range"),
        (sagging(1.0, 0.0, 0.1), "too few"),
        (sagging(1.0, 0.0, 0.1, 1.0, text=""), "out of range"),
        (sagging(1.0, 0.0, 0.1, 1.0, text=SAGS.replace("command motor", "velocity cart")), "out of range"),
        (sagging(1.0, 0.0, 0.1, 1.0, text=SAGS.replace("command motor", "command moto")), "no 'command moto'.*motor"),
        (sagging(1.0, 0.0, 0.1, 1.0, room=0), "nuserdata"),
        (entry("motor.deadzone", "motor", 0.4, 7.0), "numbers \\[0.4, 7.0\\], too few, too many or out of range"),
        (entry("motor.deadzone", "motor", -0.4), "out of range"),
        (entry("friction.wave", "cart", 1.0, 0.2, 0.1), "out of range: it takes 4"),
        (entry("motor.map", "motor", 0.0, 1.0), "as many knots as values"),
        (entry("motor.map", "motor", 1.0, 0.0, 1.0, 2.0), "out of range: its knots do not increase"),
        (entry("friction.time", "cart", 3.0, 1.0, 1.0, 1.0), "out of range: it goes from 3 to 1"),
        (entry("disturbance.pulse", "cart", 1.0, 0.0, -1.0), "out of range"),
        (entry("residual.force", "cart", 1, 2, 2, 0, 1, 0, 1, 1, 2, 3, 4) + depends("position cart"), "out of range"),
        (entry("timing.sensor_lag", "x", 0.0), "out of range; .*time constant > 0"),
        (entry("timing.sensor_lag", "x", -0.1), "out of range"),
    ],
)
def test_a_wrong_entry_is_refused_with_what_would_be_right(custom: str, words: str) -> None:
    with pytest.raises(mjcf.MjcfError, match=words):
        cart(custom)


def test_entries_of_others_are_left_alone() -> None:
    assert cart('<numeric name="mine" data="1 2"/>').extras == ()


def test_a_registered_effect_is_understood(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(entries, "_known", dict(entries._known))
    physics.register("motor.square", "command", lambda data, now: data[..., 0] * now.value**2)
    assert cart(entry("motor.square", "motor", 0.5)).command(np.array([4.0])) == [8.0]
    with pytest.raises(ValueError, match="registered already"):
        physics.register("motor.square", "command", formulas.deadzone)


@pytest.mark.parametrize(
    ("entry", "data"),
    [
        ("friction.wave:cart", "0 1 1 1e-320"),
        ("friction.wave:cart", "1 1 1 0"),
        ("friction.position:cart", "1 1 2 3"),
        ("timing.sensor_lag:cart", "1e308"),
        ("timing.sensor_lag:cart", "1e-320"),
        ("sensor.gain:cart", "1e300"),
        ("sensor.bias:cart", "nan"),
        ("motor.deadzone:motor", "-1e300"),
        ("disturbance.periodic:cart", "1 1e308 0"),
    ],
)
def test_entries_that_would_give_no_numbers_are_refused(entry: str, data: str) -> None:
    text = f"""<mujoco><worldbody><body><joint name="cart" type="slide"/><geom size="0.1" mass="1"/></body></worldbody>
        <actuator><motor name="motor" joint="cart"/></actuator><sensor><jointpos name="cart" joint="cart"/></sensor>
        <custom><numeric name="dipc_gym:{entry}" data="{data}"/></custom></mujoco>"""
    with pytest.raises(mjcf.MjcfError, match=rf"<custom> entry 'dipc_gym:{entry}' has the numbers"):
        physics.load(text)


# Residual forces


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000), st.integers(2, 6), st.integers(2, 6))
def test_a_residual_force_is_its_table_and_goes_on_as_it_ends(seed: int, m: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    first, second = (np.cumsum(rng.uniform(0.1, 1.0, k)) for k in (m, n))
    levels = rng.normal(size=(m, n))
    custom = entry("residual.force", "cart", 1e3, m, n, *first, *second, *levels.ravel())
    rig = cart(custom + depends("position cart", "command motor"))
    table = RegularGridInterpolator((first, second), levels)
    data, applied = mujoco.MjData(rig.model), np.zeros(1)
    for _ in range(20):
        data.qpos[0], data.ctrl[0] = rng.uniform(-1, 7, 2)
        rig.act(data, np.zeros(1), applied)
        inside = np.clip(data.qpos[0], first[0], first[-1]), np.clip(data.ctrl[0], second[0], second[-1])
        assert applied[0] == pytest.approx(float(np.ravel(table(inside))[0]), abs=1e-12)


def test_a_residual_force_drives_nothing_faster_than_the_data_were() -> None:
    custom = entry("residual.force", "cart", 2.0, 2, 1, -1, 1, 0, 5.0, 5.0) + depends("velocity cart")
    rig = cart(custom)
    applied, data = np.zeros(1), mujoco.MjData(rig.model)
    for speed, force in ((1.9, 5.0), (3.0, 2.5), (4.0, 0.0), (1e6, 0.0), (-1e6, 5.0)):
        data.qvel[0] = speed
        rig.act(data, np.zeros(1), applied)
        assert applied[0] == pytest.approx(force)
    assert run(rig, 0.0, 20_000).qvel[0] < 4.0


@settings(max_examples=5, deadline=None)
@given(st.integers(0, 10_000))
def test_no_residual_force_feeds_a_simulation_without_end(seed: int) -> None:
    """An hour under random commands, on a rig without any loss of its own."""
    rng = np.random.default_rng(seed)
    levels = rng.normal(size=(4, 3))
    knots = (*np.linspace(-1, 1, 4), *np.linspace(-2, 2, 3))
    rig = cart(
        entry("residual.force", "cart", 2.0, 4, 3, *knots, *levels.ravel()) + depends("position cart", "velocity cart"),
        clock="",
    )
    what, numbers = program.read([rig])
    count = 3600 * 50
    commands = np.cumsum(rng.normal(size=(count, 1)), axis=0)
    commands = 1e-2 * np.diff(commands, axis=0, prepend=0.0)
    held = Commands(0.02 * np.arange(count), commands[None])
    zero, one = np.zeros(1, dtype=np.int64), np.full(1, count)
    times = np.linspace(0, 3600, 7)[None, None]
    jobs = Jobs(numbers, np.zeros((1, 1, what.nx)), np.zeros(1), zero, one, held, zero, times, np.full(1, 3600.0))
    readings, ends = engine_run(what, jobs, 0.02)
    assert np.isfinite(readings).all()
    assert abs(ends[0, 0, 1]) < 4.0 + 2.0  # twice the largest speed of the data, and what commands add


NUMBERS = st.one_of(
    st.floats(-1e3, 1e3), st.floats(), st.integers(-3, 70).map(float), st.sampled_from([0.0, 1e-320, 1e-304, 1e9, -1e9])
)
RULES = [(one.effect, one.stage) for one in physics.known() if one.stage != "lag"]


@settings(max_examples=500, deadline=None)
@given(
    rule=st.sampled_from(RULES),
    numbers=st.lists(NUMBERS, max_size=12),
    at=st.lists(st.floats(-1e10, 1e10), min_size=6, max_size=6),
    rising=st.booleans(),
)
@example(("motor.map", "command"), [0.0, 1.0, 1.0, 1.0, 1.0, 1e-320], [0.0, 0.0, 0.0, 0.0, 1.0, 0.0], True)
@example(("friction.time", "friction"), [0.0, 0.0, -1.0, -1.0], [0.0] * 6, True)
@example(("friction.load", "friction"), [1.0, -0.5, 0.0], [0.0, 0.0, 10.0, 0.0, 0.0, 1.0], False)
@example(("friction.load_stribeck", "friction"), [1.0, 0.1, 0.0, -5.0, 0.1], [0.0, 0.0, 10.0, 0.0, 0.0, 0.0], False)
def test_an_entry_that_is_let_in_gives_a_number_wherever_the_joint_is(
    rule: tuple[str, physics.Stage], numbers: list[float], at: list[float], rising: bool
) -> None:
    """A wave of 1e-304 m had given none at 3,641 m. And no dry friction drives."""
    if rising:
        numbers = sorted(number for number in numbers if not math.isnan(number))
        if rule[0] == physics.RESIDUAL:
            numbers = [1.0, 2, 2, -1, 1, -1, 1, *numbers[:4]]
    effect, stage = rule
    extra = physics.Extra(effect, "cart", stage, 0, np.array(numbers), (("position", 0), ("velocity", 0)))
    if entries.fault(extra) is not None:
        return
    time, position, drive, weight, value, speed = (np.float64(x) for x in at)
    now = physics.Moment(np.abs(time), position, drive, weight, value, speed, (position, speed))
    assert np.isfinite(extra(now))
    assert stage != "friction" or extra(now) >= 0


def test_an_entry_of_very_many_numbers_is_refused_in_few_words() -> None:
    """Every number had been tried as a position: minutes for the largest file that is read."""
    with pytest.raises(mjcf.MjcfError, match="100,002 numbers, more than 12,288") as refused:
        cart(entry("friction.position", "cart", 0, 1, *range(100_000)))
    assert len(str(refused.value)) < 500


@pytest.mark.parametrize(
    ("numbers", "inputs", "why"),
    [
        ((1, 2, 1, 0, 1, 0, 5, 6), (), "out of range: what it depends on is not said"),
        ((1, 2, 1, 1, 0, 0, 5, 6), ("position cart",), "out of range: its knots do not increase"),
        ((0, 2, 1, 0, 1, 0, 5, 6), ("position cart",), "out of range: its speed is 0, and must be positive"),
        ((1, 2, 1, 0, 1, 0, 5), ("position cart",), "out of range: a table of 2 x 1 has 8 numbers, not 7"),
        ((1, 2, 1, 0, 1, 0, 5, math.nan), ("position cart",), "out of range: number 8 is nan"),
        (
            (1, 100, 100, *range(200), *[0.0] * 10_000),
            ("position cart", "velocity cart"),
            "10,187 more, too few, too many or out of range: a table of 100 x 100 is 10,000 levels, more than 4,096",
        ),
        ((1, 2, 1, 0, 1, 0, 5, 6), ("position card",), "did you mean 'cart'"),
        ((1, 2, 1, 0, 1, 0, 5, 6), ("speed cart",), "position, velocity and command"),
    ],
)
def test_a_residual_force_that_is_none_is_refused(
    numbers: tuple[float, ...], inputs: tuple[str, ...], why: str
) -> None:
    with pytest.raises(mjcf.MjcfError, match=why):
        cart(entry("residual.force", "cart", *numbers) + depends(*inputs))


def test_two_laws_of_dry_friction_at_one_joint_are_refused() -> None:
    """Forces add up; two levels of one friction do not, and one would be lost."""
    both = entry("friction.load", "cart", 0.3, 0.0, 0.0) + entry("friction.wave", "cart", 0.1, 0.0, 0.0, 1.0)
    with pytest.raises(mjcf.MjcfError, match=r"friction.wave:cart': friction.load says how large .* already; keep one"):
        cart(both)


def test_what_a_law_depends_on_is_asked_of_any_law(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of one's own as of ours; one that depends on nothing says so."""
    monkeypatch.setattr(entries, "_known", dict(entries._known))
    physics.register("own.tie", "force", lambda data, now: -data[..., 0] * now.inputs[0])
    names = f'<text name="{mjcf.INPUTS}1:own.tie:cart" data="{{}}"/>'
    own = entry("own.tie", "cart", 2.0)
    (extra,) = cart(own + names.format("position cart")).extras
    assert extra.inputs == (("position", 0),)
    with pytest.raises(mjcf.MjcfError, match="no 'position nowhere' in the model; there are cart"):
        cart(own + names.format("position nowhere"))
    with pytest.raises(mjcf.MjcfError, match=r"friction.load depends on nothing"):
        cart(
            entry("friction.load", "cart", 0.3, 0.0, 0.0)
            + names.replace("own.tie", "friction.load").format("position cart")
        )
