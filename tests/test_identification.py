"""The identification run and what is made of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from dipc_gym import compensators, mjcf
from dipc_gym.env import DoublePendulumEnv
from dipc_gym.identification.run import Sweep, cart, cart_model, delay, delayed, locked, record, samples
from dipc_gym.plant import Encoders, Friction, Plant
from dipc_gym.recording import Recording
from dipc_gym.runs import identify

SOURCE = DoublePendulumEnv().source
SHORT = Sweep(duration=12.0, high=4.0)


def test_sweep_goes_from_first_to_last_frequency() -> None:
    sweep = Sweep()
    time = np.arange(0, sweep.duration, 1e-4)
    volts = sweep.voltage(time)
    assert np.abs(volts).max() == pytest.approx(sweep.amplitude, rel=1e-6)
    crossings = time[1:][np.diff(np.sign(volts)) != 0]
    assert 0.5 / np.diff(crossings)[-1] == pytest.approx(sweep.high, rel=0.02)
    # The first quarter turn ends where low t + (high - low) t^2 / (2 duration) = 1/4.
    rise = (sweep.high - sweep.low) / (2 * sweep.duration)
    assert crossings[0] == pytest.approx((np.sqrt(sweep.low**2 + rise) - sweep.low) / (2 * rise), abs=1e-3)
    # A linear sweep passes the mean frequency times the duration in whole turns: two crossings each.
    assert len(crossings) == pytest.approx(2 * sweep.duration * (sweep.low + sweep.high) / 2, abs=2)


def test_locked_cart_is_the_linear_model_of_the_paper() -> None:
    model = cart_model(SOURCE, Plant())
    assert model.nv == 1
    linear = cart(model)
    assert linear.mass == pytest.approx(1.2599992, rel=1e-9)
    assert linear.constants.newtons_per_volt == pytest.approx(4.0, rel=1e-9)
    assert linear.constants.viscous == pytest.approx(40.0, rel=1e-9)
    assert linear.constants.supply_voltage == 24.0
    np.testing.assert_array_equal(model.actuator_gear[:, 0], [80.0, 1.0])  # asking left the model as it was


def test_run_stays_on_the_rail_and_reads_whole_counts() -> None:
    plant = Plant(encoders=Encoders(noise=0.2))
    run = record(cart_model(SOURCE, plant), plant, Sweep(), seed=3)
    assert run.duration == pytest.approx(60.0, abs=0.01)
    assert 0.2 < np.abs(run.sensors).max() < 0.40
    counts = run.sensors / plant.encoders.cart
    np.testing.assert_allclose(counts, np.round(counts), atol=1e-6)
    again = record(cart_model(SOURCE, plant), plant, Sweep(), seed=3)
    np.testing.assert_array_equal(run.sensors, again.sensors)
    assert not np.array_equal(run.sensors, record(cart_model(SOURCE, plant), plant, Sweep(), seed=4).sensors)


def test_without_friction_the_force_is_the_motors() -> None:
    plant = Plant(friction=Friction(coulomb=0.0, static=0.0))
    model = cart_model(SOURCE, plant)
    data = samples(record(model, plant, SHORT), cart(model), plant.encoders, plant.control_period)
    error = data.force - 4.0 * data.voltage
    # What is left: rounding of the encoder, 1.26 kg times 5.5 um rms / (5 ms)^2, and the curvature within a period.
    assert np.sqrt(np.mean(error**2)) < 0.5
    assert np.sqrt(np.mean(data.force**2)) > 15


def with_custom(*effects: str) -> mjcf.Source:
    """The rig's model with entries such as `motor.deadzone:motor=2.0` under `<custom>`."""
    numerics = "".join(
        f'<numeric name="dipc_gym:{name}" data="{data}"/>' for name, data in (e.split("=") for e in effects)
    )
    return SOURCE.edited(SOURCE.text.replace("<worldbody>", f"<custom>{numerics}</custom>\n  <worldbody>", 1))


def test_effects_that_stock_mujoco_leaves_out_act_on_the_run() -> None:
    plant = Plant(friction=Friction(coulomb=0.0, static=0.0))
    model = cart_model(with_custom("motor.deadzone:motor=2.0", "sensor.bias:pole1=0.1"), plant)
    data = samples(record(model, plant, SHORT), cart(model), plant.encoders, plant.control_period)
    arrives = np.sign(data.voltage) * np.maximum(np.abs(data.voltage) - 2.0, 0.0)
    assert np.sqrt(np.mean((data.force - 4.0 * arrives) ** 2)) < 0.5  # as without a dead zone
    assert np.sqrt(np.mean((data.force - 4.0 * data.voltage) ** 2)) > 5

    plain = record(cart_model(SOURCE, plant), plant, SHORT)
    scaled = record(cart_model(with_custom("sensor.gain:cart=1.1"), plant), plant, SHORT)
    np.testing.assert_allclose(scaled.sensors, 1.1 * plain.sensors, atol=plant.encoders.cart * 1.1)


def test_least_squares_finds_the_coulomb_force() -> None:
    # Slowly and without a lag in the velocity; with the filter's 10 ms, sign and force part company at 10 Hz.
    plant = Plant(friction=Friction(coulomb=5.0, static=6.0), encoders=Encoders(velocity_filter=0.0))
    model = cart_model(SOURCE, plant)
    linear = cart(model)
    data = samples(record(model, plant, Sweep(duration=30.0, high=2.0)), linear, plant.encoders, plant.control_period)
    fitted = compensators.fit("feedforward", data, linear.constants)
    assert isinstance(fitted, compensators.Feedforward)
    assert fitted.coulomb * 4.0 == pytest.approx(5.0, rel=0.05)
    assert fitted.per_newton * 4.0 == pytest.approx(1.0, rel=0.05)


def test_both_halves_hold_every_frequency() -> None:
    plant = Plant()
    model = cart_model(SOURCE, plant)
    data = samples(record(model, plant, SHORT), cart(model), plant.encoders, plant.control_period)
    assert np.mean(data.train) == pytest.approx(0.5, abs=0.05)
    switches = np.flatnonzero(np.diff(data.train.astype(int)))
    np.testing.assert_array_equal(np.diff(switches), 200)  # one second of 5 ms


def test_velocities_are_those_that_the_loop_will_see() -> None:
    env = DoublePendulumEnv()
    env.reset(options={"state": [0.0] * 6})
    readings, seen = [], []
    for k in range(200):
        readings.append(env.encoders[0])
        seen.append(env.measured_velocity)
        env.step(np.array([8.0 * np.cos(0.05 * k)]))
    run = Recording(
        "run", 0.005 * np.arange(200), np.zeros((200, 1)), np.array(readings)[:, None], ("motor",), ("cart",)
    )
    data = samples(run, cart(cart_model(SOURCE, Plant())), Encoders(), 0.005, block=0.2)
    np.testing.assert_allclose(data.velocity, seen[1:-2], atol=1e-12)
    np.testing.assert_allclose(data.previous_velocity, seen[:-3], atol=1e-12)


def test_other_sampling_is_brought_to_the_control_period() -> None:
    plant = Plant()
    model = cart_model(SOURCE, plant)
    run = record(model, plant, SHORT)
    # The same run, logged five times as often: commands held, readings in between on straight lines.
    time = np.arange(0.0, run.time[-1], 0.001)
    held = run.commands[np.searchsorted(run.time, time + 1e-9, side="right") - 1]
    reading = np.interp(time, run.time, run.sensors[:, 0])[:, None]
    fine = Recording("fine", time, held, reading, ("motor",), ("cart",))
    a = samples(run, cart(model), plant.encoders, plant.control_period)
    b = samples(fine, cart(model), plant.encoders, plant.control_period)
    n = min(len(a.force), len(b.force))
    assert n > 0.99 * len(a.force)
    np.testing.assert_allclose(b.voltage[:n], a.voltage[:n], atol=1e-9)
    np.testing.assert_allclose(b.force[:n], a.force[:n], atol=1e-6)


def test_recordings_that_cannot_serve_are_refused() -> None:
    linear = cart(cart_model(SOURCE, Plant()))
    time = 0.005 * np.arange(100)
    nothing = Recording("x", time, np.zeros((100, 1)), np.zeros((100, 1)), ("pump",), ("cart",))
    with pytest.raises(ValueError, match="no 'motor'"):
        samples(nothing, linear, Encoders(), 0.005)
    short = Recording("x", time, np.zeros((100, 1)), np.zeros((100, 1)), ("motor",), ("cart",))
    with pytest.raises(ValueError, match="too short"):
        samples(short, linear, Encoders(), 0.005)


def test_locking_removes_what_needs_the_poles() -> None:
    model = mjcf.compile(SOURCE.edited(locked(SOURCE.text, ["pole1", "pole2"])), trusted=True)
    assert mjcf.scalar_sensors(model) == ["cart"]
    assert model.nkey == 0


def test_joints_are_those_that_the_sensors_read() -> None:
    """Whatever they are called, and whatever stands before them in the model."""
    text = SOURCE.text.replace(
        '<body name="cart"',
        '<body name="fan"><joint name="pole1" type="hinge"/><geom size="0.1" mass="1"/></body><body name="cart"',
    ).replace('<joint name="pole1" type="hinge" axis="0 1 0"/>', '<joint name="lower" type="hinge" axis="0 1 0"/>')
    text = text.replace('<jointpos name="pole1" joint="pole1"/>', '<jointpos name="pole1" joint="lower"/>')
    text = text[: text.index("<keyframe>")] + "</mujoco>"
    model = cart_model(SOURCE.edited(text), Plant())
    assert [model.joint(i).name for i in range(model.njnt)] == ["pole1", "cart"]
    plain = record(cart_model(SOURCE, Plant()), Plant(), SHORT)
    np.testing.assert_allclose(record(model, Plant(), SHORT).sensors, plain.sensors, atol=1.1 * Encoders().cart)


def test_a_pole_that_stays_free_is_refused() -> None:
    text = SOURCE.text.replace('<body name="pole2"', '<replicate count="1"><body name="pole2"')
    text = text.replace("</body>\n      </body>", "</body></replicate>\n      </body>", 1)
    text = text.replace('joint="pole2"', 'joint="pole20"')
    text = text[: text.index("<keyframe>")] + "</mujoco>"
    with pytest.raises(ValueError, match="the joint 'pole20' of a pole cannot be locked"):
        cart_model(SOURCE.edited(text), Plant())


def test_a_run_that_reaches_an_end_of_the_rail_is_refused() -> None:
    """Its blow would be learned as friction; a gentler sweep of the same rig is taken."""
    slippery = Plant(friction=Friction(coulomb=0.0, static=0.0, viscous=0.0))
    model = cart_model(SOURCE, slippery)
    with pytest.raises(ValueError, match=r"end of its rail at 0\.\d+ s.*less than 8 V"):
        record(model, slippery, Sweep())
    gentle = record(model, slippery, Sweep(amplitude=4.0))
    assert np.abs(gentle.sensors).max() < 0.45


def test_a_run_that_diverges_is_not_started_again() -> None:
    text = SOURCE.text.replace(' autoreset="disable"', "").replace('type="slide"', 'type="slide" stiffness="-1e8"')
    model = cart_model(SOURCE.edited(text), Plant())
    with pytest.raises(ValueError, match=r"diverges at 0\.\d+ s; give the model a smaller <option timestep>"):
        record(model, Plant(), Sweep(duration=1.0))


@pytest.mark.parametrize("late", [0.0, 0.04, 0.05])
def test_a_recording_whose_motor_is_late_is_taken(late: float, tmp_path: Path) -> None:
    plant = Plant(delay=late)
    run = record(cart_model(SOURCE, plant), plant, Sweep(), seed=0)
    path = tmp_path / "sweep.csv"
    columns = np.column_stack([run.time, run.commands, run.sensors])
    np.savetxt(path, columns, delimiter=",", header="time,motor,cart", comments="", fmt="%.9g")
    found = identify(from_recording=str(path))
    assert found.rig.delay == pytest.approx(late, abs=0.0013)


@pytest.mark.parametrize("late", [0.0, 0.004, 0.01, 0.03])
def test_a_delay_is_found_in_the_run(late: float) -> None:
    plant = Plant(delay=late)
    fixed = cart_model(DoublePendulumEnv().source, plant)
    linear = cart(fixed)
    data = samples(record(fixed, plant, Sweep(), seed=0), linear, plant.encoders, plant.control_period)
    found = delay(data, linear.constants)
    assert found == pytest.approx(late, abs=0.0013)
    arrived = delayed(data.voltage, plant.control_period, found)
    lost = linear.constants.newtons_per_volt * arrived - data.force
    assert np.median(np.abs(lost[np.abs(data.velocity) > 0.2])) == pytest.approx(8.0, abs=0.5)  # Coulomb's level
