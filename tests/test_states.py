"""Motion and unexplained force from sensors: known motions come back, and what cannot be known is said."""

from __future__ import annotations

import re

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dipc_gym import mjcf, physics
from dipc_gym.recording import Recorder, Recording
from dipc_gym.sim2real.estimation import states

CART_POLE = """
    <mujoco>
      <option timestep="0.001" integrator="RK4"/>
      <worldbody>
        <body>
          <inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
          <joint name="cart" type="slide" axis="1 0 0" damping="2"/>
          <body>
            <inertial pos="0 0 -0.3" mass="0.5" diaginertia="0.01 0.01 0.01"/>
            <joint name="pole" axis="0 1 0" damping="0.01"/>
          </body>
        </body>
        {more}
      </worldbody>
      <tendon><fixed name="sum"><joint joint="cart" coef="2"/><joint joint="pole" coef="1"/></fixed></tendon>
      <actuator><motor name="motor" joint="cart" gear="3"/></actuator>
      <sensor>{sensors}</sensor>
      <custom>{custom}</custom>
    </mujoco>"""
CART, POLE = '<jointpos name="cart" joint="cart"/>', '<jointpos name="pole" joint="pole"/>'
SUM = '<tendonpos name="sum" tendon="sum"/>'
SPEED = '<jointvel name="speed" joint="pole"/>'
ROTOR = """
    <body>
      <inertial pos="0 0 0" mass="0.1" diaginertia="1 1 1"/>
      <joint name="rotor" type="slide" axis="1 0 0"/>
    </body>"""


def cart_pole(sensors: str = CART + POLE, custom: str = "", more: str = "") -> physics.Physics:
    return physics.load(CART_POLE.format(sensors=sensors, custom=custom, more=more))


def stamps(rng: np.random.Generator, n: int, irregular: bool) -> np.ndarray:
    return np.cumsum(rng.uniform(0.4, 1.6, n) * 0.002 if irregular else np.full(n, 0.002))


def recorded(rig: physics.Physics, time: np.ndarray, sensors: np.ndarray) -> Recording:
    names = mjcf.controls(rig.model), mjcf.scalar_sensors(rig.model)
    return Recording("made up", time, np.zeros((len(time), len(names[0]))), sensors, *names)


# Smoothing


@pytest.mark.parametrize("irregular", [False, True])
@pytest.mark.parametrize("noise", [1e-5, 1e-3, 0.05])
def test_smoothing_recovers_a_known_motion_within_its_noise(irregular: bool, noise: float) -> None:
    rng = np.random.default_rng(1)
    time = stamps(rng, 4000, irregular)
    true = np.sin(3 * time) + 0.2 * np.sin(11 * time + 1)
    smooth = states.smoothed(time, true + noise * rng.normal(size=len(time)), noise)
    inner = slice(50, -50)
    assert np.std((smooth - true)[inner]) < 0.4 * noise
    speed = 3 * np.cos(3 * time) + 2.2 * np.cos(11 * time + 1)
    assert np.std((np.gradient(smooth, time) - speed)[inner]) < 25 * noise + 1e-3


@given(st.lists(st.floats(-10, 10), min_size=3, max_size=3), st.floats(1e-6, 1.0), st.integers(0, 100))
@settings(max_examples=40, deadline=None)
def test_smoothing_leaves_parabolas_alone(coefficients: list[float], noise: float, seed: int) -> None:
    time = stamps(np.random.default_rng(seed), 200, irregular=True)
    values = np.polyval(coefficients, time)
    np.testing.assert_allclose(states.smoothed(time, values, noise), values, atol=1e-9)


def test_smoothing_bears_stamps_one_rounding_apart() -> None:
    time = np.arange(300) * 0.01
    time = np.insert(time, 151, np.nextafter(time[150], np.inf))
    assert np.isfinite(states.smoothed(time, np.sin(time), 1e-4)).all()


@pytest.mark.parametrize("noise", [0.0, 1e-9, 1e-2, 1.0])
def test_smoothing_bears_stamps_that_nearly_coincide_and_gaps(noise: float) -> None:
    time = np.arange(3000) * 0.002
    time = np.delete(np.sort(np.append(time, time[1000] + 1e-9)), slice(1500, 1900))
    values = np.sin(3 * time) + noise * np.random.default_rng(0).normal(size=len(time))
    smooth = states.smoothed(time, values, noise)
    assert np.std(smooth - np.sin(3 * time)) <= 1.1 * noise + 1e-9


def test_a_sensor_that_never_changes_stays_as_it_is() -> None:
    time = np.arange(100) * 0.01
    np.testing.assert_array_equal(states.smoothed(time, np.full(100, 0.3), np.inf), np.full(100, 0.3))


# Sensors


def test_the_map_says_how_sensors_read_joints() -> None:
    P, V, c = states.sensor_map(cart_pole(CART + SUM + SPEED))
    np.testing.assert_allclose(P, [[1, 0], [2, 1], [0, 0]], atol=1e-12)
    np.testing.assert_allclose(V, [[0, 0], [0, 0], [0, 1]], atol=1e-12)
    np.testing.assert_allclose(c, 0, atol=1e-12)


def test_the_map_holds_what_custom_entries_do_to_readings() -> None:
    custom = (
        '<numeric name="dipc_gym:sensor.gain:pole" data="1.1"/><numeric name="dipc_gym:sensor.bias:cart" data="0.02"/>'
    )
    P, _, c = states.sensor_map(cart_pole(custom=custom))
    np.testing.assert_allclose(P, [[1, 0], [0, 1.1]], atol=1e-12)
    np.testing.assert_allclose(c, [0.02, 0], atol=1e-12)


@pytest.mark.parametrize(
    ("sensors", "joints"), [(CART, "pole"), (POLE, "cart"), (POLE + SPEED, "cart"), (SUM, "cart, pole")]
)
def test_joints_that_no_position_sensor_determines_are_named(sensors: str, joints: str) -> None:
    with pytest.raises(states.Undetermined, match=f"sees joint {joints}, so"):
        states.seen(cart_pole(sensors))


def test_a_speed_tells_where_a_joint_is_that_no_position_sensor_sees() -> None:
    told = states.seen(cart_pole(CART + SPEED))
    assert told.sensors.tolist() == [0, 1]
    assert told.speeds.tolist() == [False, True]
    (note,) = states.integrated(cart_pole(CART + SPEED))
    assert note.startswith("Of pole only the speed is read")
    assert states.integrated(cart_pole(CART + POLE + SPEED)) == []
    assert not states.seen(cart_pole(CART + POLE + SPEED)).speeds.any()


def test_motion_comes_back_from_a_speed_alone() -> None:
    """From 0 on, whatever the gear between a joint and what the speed is read of."""
    rng, geared = np.random.default_rng(3), '<tendonvel name="sum" tendon="sum"/>'
    rig, noise = cart_pole(CART + geared), np.array([1e-4, 1e-2])
    time = stamps(rng, 3000, irregular=True)
    q = np.stack([0.2 * np.sin(4 * time), np.cos(5 * time) - 1], axis=1)
    _, V, _ = states.sensor_map(rig)
    speeds = np.stack([0.8 * np.cos(4 * time), -5 * np.sin(5 * time)], axis=1)
    sensors = np.stack([q[:, 0], speeds @ V[1]], axis=1) + noise * rng.normal(size=(len(time), 2))
    motion = states.estimate(recorded(rig, time, sensors), rig, noise)
    inner = slice(50, -50)
    assert np.abs(motion.position - q)[inner].max() < 1e-2
    assert np.std((motion.velocity - speeds)[inner], axis=0) == pytest.approx(np.zeros(2), abs=2e-2)


def test_a_sensor_that_is_not_linear_is_named() -> None:
    bent = CART + POLE + '<jointactuatorfrc name="force" joint="cart"/><e_kinetic name="energy"/>'
    with pytest.raises(states.Undetermined, match="'energy' is not linear"):
        states.sensor_map(cart_pole(bent))


def test_an_unseen_joint_that_follows_another_needs_no_sensor() -> None:
    follows = '<text name="dipc_gym:follows:rotor" data="cart"/>'
    with pytest.raises(states.Undetermined, match="joint rotor"):
        states.seen(cart_pole(more=ROTOR))
    rig = cart_pole(POLE + '<jointpos name="motor_side" joint="rotor"/>', follows, ROTOR)
    assert mjcf.base_joints(rig.model) == ("cart", "pole")
    P, _, _ = states.sensor_map(rig)
    np.testing.assert_allclose(P, [[0, 1], [1, 0]], atol=1e-12)  # the encoder on the motor tells where the cart is


@pytest.mark.parametrize(
    ("custom", "missing"),
    [
        ('<text name="dipc_gym:follows:rotor" data="wagon"/>', "wagon"),
        ('<text name="dipc_gym:follows:roter" data="cart"/>', "roter"),
        (
            '<text name="dipc_gym:follows:rotor" data="cart"/><text name="dipc_gym:follows:cart" data="rotor"/>',
            "cart",
        ),
    ],
)
def test_ties_that_cannot_be_are_refused(custom: str, missing: str) -> None:
    with pytest.raises(mjcf.MjcfError, match=f"no '{missing}' among the joints"):
        mjcf.base_joints(cart_pole(custom=custom, more=ROTOR).model)


def test_a_joint_without_a_name_is_refused() -> None:
    rig = physics.load('<mujoco><worldbody><body><joint/><geom size="1"/></body></worldbody></mujoco>')
    with pytest.raises(mjcf.MjcfError, match="joint 0 of the model has no name"):
        mjcf.base_joints(rig.model)


# Motion


def test_motion_comes_back_through_redundant_sensors() -> None:
    rng = np.random.default_rng(2)
    rig, noise = cart_pole(CART + POLE + SUM), np.array([1e-4, 1e-3, 1e-4])
    time = stamps(rng, 3000, irregular=True)
    q = np.stack([0.2 * np.sin(4 * time), np.cos(5 * time)], axis=1)
    P, _, _ = states.sensor_map(rig)
    sensors = q @ P.T + noise * rng.normal(size=(len(time), 3))
    motion = states.estimate(recorded(rig, time, sensors), rig, noise)
    inner = slice(50, -50)
    # The sum and the cart together know the pole better than its own encoder does.
    assert np.std((motion.position - q)[inner], axis=0) == pytest.approx(np.zeros(2), abs=1e-4)
    assert np.std((motion.acceleration[:, 1] + 25 * np.cos(5 * time))[inner]) < 0.05 * 25
    halfway = (time[1000] + time[1001]) / 2
    np.testing.assert_allclose(motion.at(np.array([halfway]))[0, :2], motion.position[1000:1002].mean(axis=0))


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("speed", [0.0, 0.4])
def test_a_recording_begins_as_its_first_readings_say(seed: int, speed: float) -> None:
    """A command jumps as it begins, and what it moves soon goes as fast as it can: rounder than the rest it is not.

    What is smoothed is off by more than 0.03 m/s there.
    """
    rig, noise, time = cart_pole(), np.array([1e-5, 1e-5]), np.arange(3000) * 0.002
    soon = 0.03
    cart = speed * time + 0.6 * (time + soon * np.expm1(-time / soon)) + 0.1 * np.cos(3 * time)
    rng = np.random.default_rng(seed)
    sensors = np.stack([cart, 0.2 * np.cos(4 * time)], axis=1) + noise * rng.normal(size=(3000, 2))
    motion = states.estimate(recorded(rig, time, sensors), rig, noise)
    smooth = states.smoothed(time, sensors[:, 0], noise[0])
    assert abs(np.gradient(smooth, time, edge_order=2)[0] - speed) > 0.03
    assert motion.velocity[0, 1] == 0.0
    if speed:
        assert motion.velocity[0, 0] == pytest.approx(speed, abs=0.02)
    else:
        assert motion.velocity[0, 0] == 0.0


@pytest.mark.parametrize("speed", [0.1, 0.2])
def test_a_recording_cut_from_a_motion_begins_as_that_goes(speed: float) -> None:
    """It never rested, slow as it is there."""
    rig, noise, time = cart_pole(), np.array([5e-5, 5e-5]), np.arange(3000) * 0.002
    omega, off = 2 * np.pi, []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        cart = 0.2 * np.sin(omega * time + np.arccos(speed / (0.2 * omega)))  # 0.9 m/s is usual
        sensors = np.stack([cart, 0.2 * np.cos(4 * time)], axis=1) + noise * rng.normal(size=(3000, 2))
        off.append(states.estimate(recorded(rig, time, sensors), rig, noise).velocity[0, 0] - speed)
    assert np.sqrt(np.mean(np.square(off))) < 0.02


def test_first_readings_far_apart_do_not_tell_how_a_recording_begins() -> None:
    """At 50 Hz eight of them go once round with a pendulum of 5 Hz, and are no cubic; what is smoothed is nearer."""
    rig, noise, time = cart_pole(), np.array([1e-4, 1e-4]), np.arange(500) * 0.02
    rng, omega = np.random.default_rng(4), 2 * np.pi * 5
    sensors = np.stack([0.1 * np.cos(3 * time), 0.1 * np.sin(omega * time)], axis=1) + noise * rng.normal(size=(500, 2))
    motion = states.estimate(recorded(rig, time, sensors), rig, noise)
    smooth = states.smoothed(time, sensors[:, 1], noise[1])
    assert motion.velocity[0, 1] == np.gradient(smooth, time, edge_order=2)[0]


def test_a_dead_sensor_does_where_nothing_else_sees_its_joint() -> None:
    rng = np.random.default_rng(3)
    rig, time = cart_pole(), stamps(rng, 1000, irregular=False)
    sensors = np.stack([0.1 * np.sin(4 * time) + 1e-5 * rng.normal(size=1000), np.full(1000, 0.3)], axis=1)
    motion = states.estimate(recorded(rig, time, sensors), rig, np.array([1e-5, np.inf]))
    np.testing.assert_allclose(motion.position[:, 1], 0.3, atol=1e-9)
    np.testing.assert_allclose(motion.velocity[:, 1], 0.0, atol=1e-6)
    np.testing.assert_allclose(motion.position[:, 0], 0.1 * np.sin(4 * time), atol=5e-5)


def test_the_lag_of_a_sensor_is_undone() -> None:
    tau, omega = 0.02, 6.0
    rig = cart_pole(custom=f'<numeric name="dipc_gym:timing.sensor_lag:pole" data="{tau}"/>')
    time = np.arange(3000) * 0.002
    true = np.sin(omega * time)
    late = np.sin(omega * time - np.arctan(omega * tau)) / np.hypot(1, omega * tau)
    rng, noise = np.random.default_rng(4), 1e-5
    sensors = np.stack([0.1 * true, late], axis=1) + noise * rng.normal(size=(3000, 2))
    motion = states.estimate(recorded(rig, time, sensors), rig, np.full(2, noise))
    inner = slice(100, -100)
    assert np.std((motion.position[:, 1] - true)[inner]) < 1e-3 < np.std((late - true)[inner])


# Force


def extra_force(time: float) -> np.ndarray:
    return np.array([2.0 + np.sin(7 * time), -0.05 * np.cos(4 * time)])


def swinging(rig: physics.Physics, noise: float, seconds: float = 6.0) -> Recording:
    """A run under a slow voltage, with a force on both joints that the model does not know."""
    rng, data = np.random.default_rng(5), mujoco.MjData(rig.model)
    data.qpos[1] = 0.6
    recorder = Recorder(["motor"], ["cart", "pole"])
    for _ in range(round(seconds / 0.002)):
        command = np.array([np.sin(5 * data.time) - 0.7])
        recorder.append(data.time, command, data.qpos + noise * rng.normal(size=2))
        for _ in range(2):
            data.qfrc_applied[:] = extra_force(data.time)
            rig.step(data, command)
    return recorder.recording("swinging")


def test_each_state_of_a_motor_relaxes_at_its_own_rate() -> None:
    """A winding warms up over seconds, its current follows within milliseconds, and bristles as fast as they move."""
    motor = """<dcmotor name="motor" joint="cart" gear="3" resistance="1.2" motorconst="0.06" inductance="0 0.001"
        thermal="10 5 0 0.0039 25 25" lugre="1000 1 0.5 0.8 0.1"/>"""
    whole = CART_POLE.format(more="", sensors=CART, custom="")
    text = re.sub("<actuator>.*</actuator>", f"<actuator>{motor}</actuator>", whole)
    model = mujoco.MjModel.from_xml_string(text)
    data, step = mujoco.MjData(model), 0.005
    data.qvel[0] = 0.2
    mujoco.mj_forward(model, data)
    heat, bristles, current = states._relaxed(model, data, step) / step
    inductance = float(model.actuator_dynprm[0, 0])
    assert heat == pytest.approx(1 - step / (2 * 10 * 5), rel=1e-4)
    assert current == pytest.approx(inductance / step * -np.expm1(-step / inductance))
    assert 0 < bristles < current


def test_a_force_that_the_model_does_not_know_is_recovered() -> None:
    rig, noise = cart_pole(), 1e-6
    run = swinging(rig, noise)
    motion = states.estimate(run, rig, np.full(2, noise))
    force, load, _ = states.unexplained_force(rig, run, motion)
    expected = np.stack([extra_force(t) for t in run.time])
    inner = slice(50, -50)
    np.testing.assert_allclose(force[inner, 0], expected[inner, 0], atol=0.1)
    np.testing.assert_allclose(force[inner, 1], expected[inner, 1], atol=0.02)
    assert load.shape == force.shape
    assert np.std(load[inner, 1]) > 0.1  # the weight that swings


def test_who_is_interrupted_leaves_the_model_as_it_was(monkeypatch: pytest.MonkeyPatch) -> None:
    """It is simulated afterwards, for what was found so far is judged."""
    rig, noise = cart_pole(), 1e-6
    run = swinging(rig, noise)
    motion = states.estimate(run, rig, np.full(2, noise))
    rig.model.actuator_delay[:], rig.model.dof_frictionloss[:] = 0.01, 0.3
    calls, actuation = iter(range(50)), mujoco.mj_fwdActuation

    def interrupted(*given: object) -> None:
        if next(calls) == 49:
            raise KeyboardInterrupt
        actuation(*given)

    monkeypatch.setattr(mujoco, "mj_fwdActuation", interrupted)
    with pytest.raises(KeyboardInterrupt):
        states.unexplained_force(rig, run, motion)
    assert (rig.model.actuator_delay == 0.01).all()
    assert (rig.model.dof_frictionloss == 0.3).all()


def test_a_force_on_a_follower_counts_for_its_leader() -> None:
    noise = 1e-6
    run = swinging(cart_pole(), noise)
    heavy = cart_pole(custom='<text name="dipc_gym:follows:rotor" data="cart"/>', more=ROTOR)
    motion = states.estimate(run, heavy, np.full(2, noise))
    force, _, _ = states.unexplained_force(heavy, run, motion)
    expected = np.array([extra_force(t)[0] for t in run.time]) + 0.1 * motion.acceleration[:, 0]
    np.testing.assert_allclose(force[50:-50, 0], expected[50:-50], atol=0.1)


def test_forces_in_the_model_file_are_not_unexplained() -> None:
    custom = '<numeric name="dipc_gym:disturbance.periodic:cart" data="2 1 0.3"/>'
    rig, noise = cart_pole(custom=custom), 1e-6
    data, recorder = mujoco.MjData(rig.model), Recorder(["motor"], ["cart", "pole"])
    for _ in range(2000):
        recorder.append(data.time, [0.5], data.qpos)
        rig.step(data, np.array([0.5]), 2)
    run = recorder.recording("shaken")
    motion = states.estimate(run, rig, np.full(2, noise))
    with_it, _, _ = states.unexplained_force(rig, run, motion)
    without, _, _ = states.unexplained_force(cart_pole(), run, motion)
    assert np.abs(with_it[50:-50, 0]).max() < 0.05
    assert np.abs(without[50:-50, 0]).max() > 1.9


@pytest.mark.parametrize("late", [0.0, 0.0007, 0.002])
def test_a_command_that_holds_is_not_taken_for_an_early_one(late: float) -> None:
    """What motion tells of a moment is what went on before and after it: half a sample off, slopes stay unexplained."""
    rig, noise, period, parts = one_joint(""), 1e-7, 0.002, 20
    rig.model.actuator_delay[:], rig.model.actuator_history[:, 1] = late, 1  # between its entries as well
    stamps = period * np.arange(1000)
    sent, step = 3.0 * np.sin(40.0 * stamps), period / parts
    acts = np.roll(np.repeat(sent, parts), round(late / step))  # it begins and ends at nothing
    speed = np.append(0.0, np.cumsum(acts) * step)
    place = np.append(0.0, np.cumsum(speed[:-1] * step + 0.5 * acts * step**2))[:-1:parts]
    recorder, rng = Recorder(["motor"], ["cart"]), np.random.default_rng(1)
    for time, command, reading in zip(stamps, sent, place, strict=True):
        recorder.append(time, [command], [reading + noise * rng.normal()])
    run = recorder.recording("driven")
    force, _, _ = states.unexplained_force(rig, run, states.estimate(run, rig, np.array([noise])))
    slope = 120.0 * np.cos(40.0 * (stamps - late))
    early = -(slope[20:-20] @ force[20:-20, 0]) / (slope[20:-20] @ slope[20:-20])
    assert early == pytest.approx(0.0, abs=0.1 * period)


@pytest.mark.parametrize(("pushed", "unexplained"), [(2.0, 0.0), (-2.0, 0.0), (5.0, -2.0), (-5.0, 2.0)])
def test_dry_friction_holds_a_joint_at_rest_up_to_its_level(pushed: float, unexplained: float) -> None:
    """What its readings say of a direction is noise; what it cannot hold, something else does."""
    rig, noise, rng = one_joint('frictionloss="3"'), 1e-5, np.random.default_rng(2)
    recorder = Recorder(["motor"], ["cart"])
    for time in np.arange(0.0, 2.0, 0.002):
        recorder.append(time, [pushed], noise * rng.normal(size=1))
    run = recorder.recording("at rest")
    force, _, _ = states.unexplained_force(rig, run, states.estimate(run, rig, np.array([noise])))
    assert np.mean(force) == pytest.approx(unexplained, abs=0.05)
    assert np.quantile(np.abs(force - unexplained), 0.9) < (0.05 if abs(pushed) < 3.0 else 1.0)


def test_a_joint_that_slides_is_resisted_by_the_level_of_its_friction() -> None:
    """Held by half a newton too little or too much, it is said so, either way."""
    noise, rng, t = 1e-6, np.random.default_rng(3), np.arange(0.0, 2.0, 0.002)
    recorder = Recorder(["motor"], ["cart"])
    for time, place in zip(t, 0.2 * np.sin(3 * t), strict=True):
        push = -0.2 * 9 * np.sin(3 * time) + 3.0 * np.sign(np.cos(3 * time))
        recorder.append(time, [push], place + noise * rng.normal(size=1))
    run = recorder.recording("to and fro")
    for level in (2.5, 3.0, 3.5):
        rig = one_joint(f'frictionloss="{level}"')
        motion = states.estimate(run, rig, np.array([noise]))
        force, _, _ = states.unexplained_force(rig, run, motion)
        fast = np.abs(motion.velocity[:, 0]) > 0.1
        np.testing.assert_allclose(force[fast], (level - 3.0) * np.sign(motion.velocity[fast]), atol=0.1)


def one_joint(joint: str) -> physics.Physics:
    return physics.load(
        f"""<mujoco><option timestep="0.001"/><worldbody><body>
        <inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/><joint name="cart" type="slide" axis="1 0 0" {joint}/>
        </body></worldbody><actuator><motor name="motor" joint="cart"/></actuator>
        <sensor><jointpos name="cart" joint="cart"/></sensor></mujoco>"""
    )


def test_a_sensor_of_what_a_command_does_at_once_is_refused() -> None:
    """When within a step it was read, decides what it says; where the joints are, it does not say."""
    pulled = cart_pole(CART + POLE + '<actuatorfrc name="pull" actuator="motor"/>')
    with pytest.raises(states.Undetermined, match="sensor 'pull' reads what a command does at once"):
        states.sensor_map(pulled)
