"""A mass on one slide through the engine and MuJoCo: what a user's own file or law may hold."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
import pytest
from sim2real_rigs import RK4

from dipc_gym import mjcf, physics
from dipc_gym.engine import Uncovered, machine
from dipc_gym.mjcf.edit import Document
from dipc_gym.physics import entries
from dipc_gym.recording import Recording
from dipc_gym.sim2real.effects import catalogue, load_tilt
from dipc_gym.sim2real.effects.friction_speed import FrictionOfSpeed
from dipc_gym.sim2real.effects.shared.drives import drive_of
from dipc_gym.sim2real.estimation.problem import Problem, predict, sensitivities
from dipc_gym.sim2real.estimation.segments import prepare
from dipc_gym.sim2real.estimation.states import estimate
from dipc_gym.sim2real.estimation.unexplained import force_errors
from dipc_gym.sim2real.model.parameters import model_parameters
from dipc_gym.sim2real.model.structure import Structure, Term
from dipc_gym.sim2real.simulation import batch
from dipc_gym.sim2real.simulation.batch import Stepping, simulate
from dipc_gym.sim2real.simulation.compiled import left_to_mujoco
from dipc_gym.sim2real.simulation.memory import bends, memories
from dipc_gym.sim2real.simulation.motion import Motion
from dipc_gym.sim2real.simulation.windows import Windows, cut

Array = np.ndarray

MOTOR = '<motor name="m" joint="x"/>'


def slide(joint: str = "", *, actuator: str = MOTOR, more: str = "", sensor: str = "") -> str:
    """A mass of 1 kg on a slide without gravity."""
    return f"""<mujoco><option timestep="0.0005" gravity="0 0 0"/><worldbody><body name="b">
        <joint name="x" type="slide" axis="1 0 0" {joint}/>
        <geom type="sphere" size=".1" mass="1" contype="0" conaffinity="0"/></body></worldbody>{more}
        <actuator>{actuator}</actuator><sensor><jointpos name="p" joint="x" {sensor}/></sensor></mujoco>"""


def windows(command: float = 0.0, seconds: float = 0.5) -> Windows:
    """One window under a constant command, of a rig whose motion before it was rest."""
    t = np.arange(0, seconds, 0.01)
    recording = Recording(
        time=t,
        commands=np.full((len(t), 1), command),
        sensors=np.zeros((len(t), 1)),
        actuator_names=("m",),
        sensor_names=("p",),
        name="r",
    )
    still = Motion(t, *(np.zeros((len(t), 1)) for _ in range(3)), np.zeros(1))
    shape = (1, len(t))
    observed, valid = np.zeros((*shape, 1)), np.ones(shape, dtype=bool)
    return Windows((recording,), np.array([0]), np.zeros(1), t[None], observed, valid, np.array([1e-4]), (still,))


def positions(text: str, begin: tuple[float, float], command: float = 0.0, step: float = 5e-4) -> Array:
    """Of the mass every 10 ms, as the engine has it."""
    source, initial = physics.load(mjcf.from_text(text)), np.array([[begin]])
    return simulate([source], windows(command), initial, Stepping(step, RK4), base=("x",), threads=1)[0, 0, :, 0]


@pytest.fixture
def mujoco_alone(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Leaves simulations to MuJoCo from here on."""

    def refuse(*_: object) -> None:
        raise Uncovered("it is to be compared with")

    return lambda: monkeypatch.setattr(batch, "compiled", refuse)


@pytest.fixture
def own_laws(monkeypatch: pytest.MonkeyPatch) -> None:
    """Laws registered in a test are gone after it."""
    monkeypatch.setattr(entries, "_known", dict(entries._known))


def test_a_law_that_is_registered_after_the_engine_ran_acts_in_it(own_laws: None, mujoco_alone: Any) -> None:
    """A wall beyond where any state is compared: nothing but its motion tells that it is there."""
    positions(slide(), (0.0, 1.0))
    physics.register("own.wall", "force", lambda data, now: -data[..., 0] * np.maximum(now.position - data[..., 1], 0))
    wall = slide(more='<custom><numeric name="dipc_gym:own.wall:x" data="1000 2"/></custom>')
    assert not left_to_mujoco(physics.load(mjcf.from_text(wall)))
    thrown_back = positions(wall, (1.9, 1.0))
    assert thrown_back.max() < 2.05
    assert thrown_back[-1] < 1.9
    mujoco_alone()
    np.testing.assert_allclose(positions(wall, (1.9, 1.0)), thrown_back, atol=1e-4)


def test_an_own_law_may_ask_whether_a_number_is_another(own_laws: None) -> None:
    """A brake of 5 N that closes while the motor is off: 1 m/s end after 0.1 m."""
    physics.register("own.brake", "friction", lambda data, now: data[..., 0] * np.where(now.drive == 0, 1.0, 0.0))
    brake = '<custom><numeric name="dipc_gym:own.brake:x" data="5"/></custom>'
    stopped = positions(slide('frictionloss="0.01"', more=brake), (0.0, 1.0))
    assert stopped[-1] == pytest.approx(0.1, abs=1e-3)


def test_friction_of_bristles_needs_no_stribeck_speed(mujoco_alone: Any) -> None:
    bristles = '<dcmotor name="m" joint="x" motorconst="0.5" resistance="1" lugre="1e4 100 1 {}"/>'
    short = slide('damping="2"', actuator=bristles.format(""))
    written_out = slide('damping="2"', actuator=bristles.format("1 0.01"))
    found = positions(short, (0.0, 0.0), 6.0)
    np.testing.assert_allclose(found, positions(written_out, (0.0, 0.0), 6.0), atol=1e-12)
    mujoco_alone()
    np.testing.assert_allclose(found, positions(short, (0.0, 0.0), 6.0), atol=1e-4)
    assert found[-1] > 0.05


def bent(v: float, command: float, step: float) -> Array:
    """The same mass on a spring of 50 N/m that bears 30 mm, by the midpoint rule in tiny steps, (50,)."""
    x, unbent, out = 0.0, 0.0, []
    for k in range(round(0.5 / step)):
        if k % round(0.01 / step) == 0:
            out.append(x)
        a = command - v - 50 * np.clip(x - unbent, -0.03, 0.03)
        middle, speed = x + step / 2 * v, v + step / 2 * a
        held = np.clip(unbent, middle - 0.03, middle + 0.03)
        x, v = x + step * speed, v + step * (command - speed - 50 * np.clip(middle - held, -0.03, 0.03))
        unbent = np.clip(unbent, x - 0.03, x + 0.03)
    return np.array(out)


@pytest.mark.parametrize("v", [0.5, 0.50001, 0.5001])
def test_a_spring_that_yields_is_dragged_without_chatter(v: float) -> None:
    """A step of 1 ms is off by less than a micrometre, whatever moment it yields at."""
    spring = '<fixed stiffness="50" springyield="0.03" springlength="0"><joint joint="x" coef="1"/></fixed>'
    text = slide('damping="1"', more=f"<tendon>{spring}</tendon>")
    assert np.abs(positions(text, (0.0, v), 6.0, step=1e-3) - bent(v, 6.0, 1e-5)).max() < 1e-6


def test_derivatives_at_a_stop_are_those_of_differences() -> None:
    stop = """<tendon><fixed limited="true" range="-0.05 0.05" solreflimit="-2000 -20" solimplimit="0.9 0.9 0.001">
        <joint joint="x" coef="1"/></fixed></tendon>"""
    text = slide('damping="1"', more=stop)
    source = mjcf.from_text(text)
    model = physics.load(source).model
    free = tuple(p for p in model_parameters(Document(source), model) if p.key in ("b.mass", "x.damping"))
    structure = Structure(Document(source), model, ("x",), model_parameters=free)
    initial = np.array([[0.0, 0.5]])
    problem = Problem(windows(3.0), initial, np.full(2, 1e-4), Stepping(5e-4, RK4), threads=1)
    z = structure.first
    found = sensitivities(problem, structure, z, [z + 1e-6 * e for e in np.eye(len(z))], initial)
    assert found is not None
    for i, e in enumerate(np.eye(len(z))):
        more, less = (predict(problem, structure, [z + k * 1e-5 * e], initial[None])[0] for k in (1, -1))
        slope = (more - less) / 2e-5
        np.testing.assert_allclose(found[1][i], slope, atol=1e-5 * np.abs(slope).max())


@pytest.mark.parametrize("first", ["eccentric", "lag"])
def test_a_sensor_lags_before_its_scale_is_bent_in_any_order_of_the_file(first: str, mujoco_alone: Any) -> None:
    both = {
        "eccentric": '<numeric name="dipc_gym:sensor.eccentric:p" data="0.02 0 0.1"/>',
        "lag": '<numeric name="dipc_gym:timing.sensor_lag:p" data="0.03"/>',
    }
    text = slide('damping="1"', more=f"<custom>{''.join(sorted(both.values(), key=lambda x: first not in x))}</custom>")
    found = positions(text, (0.0, 1.0), 6.0)
    mujoco_alone()
    np.testing.assert_allclose(found, positions(text, (0.0, 1.0), 6.0), atol=1e-9)


def test_time_constants_of_nothing_ask_for_no_steps_of_nothing() -> None:
    for actuator, finest in (
        ('<general name="m" joint="x" dyntype="filter" dynprm="0"/>', np.inf),
        ('<dcmotor name="m" joint="x" motorconst="0.5" resistance="5" inductance="5e-6"/>', 2e-5),
    ):
        source = mjcf.from_text(slide(actuator=actuator))
        structure = Structure(Document(source), mjcf.compile(source), ("x",))
        assert structure.own_finest == finest


def test_a_user_without_a_home_folder_compiles_all_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    def none(*_: object) -> None:
        raise RuntimeError("Could not determine home directory.")

    for name in ("HOME", "XDG_CACHE_HOME", "LOCALAPPDATA"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(machine.Path, "home", none)
    with pytest.raises(RuntimeError):
        machine.cache_folder()
    machine._write("a key", b"code")
    assert machine._read("a key") is None


def test_joints_whose_names_extend_another_have_priors_of_their_own() -> None:
    source = mjcf.from_text(slide().replace('name="x"', 'name="leg"').replace('joint="x"', 'joint="leg"'))
    document = Document(source)
    speeds = [0.1, 0.2, 0.4]
    law = FrictionOfSpeed(speeds, [1.0, 1.1, 1.3])
    structure = Structure(document, mjcf.compile(source), ("leg",))
    alone = structure.with_term(Term(law, "leg", law.guess)).prior.precision
    both = structure.with_term(Term(law, "leg.knee", law.guess)).with_term(Term(law, "leg", law.guess)).prior.precision
    np.testing.assert_allclose(both, np.kron(np.eye(2), alone))


def late_run(late: float, text: str = "") -> Recording:
    """A pushed mass whose sensor is late, as MuJoCo has it in steps of a tenth of a millisecond."""
    t, fine = np.arange(0, 6, 0.002), 20
    command = np.sin(2 * np.pi * 0.7 * t) + 0.5 * np.sin(2 * np.pi * 1.9 * t)
    model, x = mujoco.MjModel.from_xml_string(text or slide('damping="2"')), []
    model.opt.timestep = 0.002 / fine
    data = mujoco.MjData(model)
    for u in command:
        data.ctrl[0] = u
        for _ in range(fine):
            x.append(data.qpos[0])
            mujoco.mj_step(model, data)
    read = np.interp(t - late, np.arange(len(x)) * 0.002 / fine, x)
    read += 1e-5 * np.random.default_rng(0).normal(size=len(t))
    return Recording(
        time=t, commands=command[:, None], sensors=read[:, None], actuator_names=("m",), sensor_names=("p",), name="r"
    )


def delayed(text: str, late: float) -> str:
    """The model, with a sensor that is late."""
    return text.replace('joint="x" /></sensor>', f'joint="x" delay="{late}" nsample="250" interp="linear"/></sensor>')


def error_at_estimated_starts(text: str, told_by: str, late: float) -> float:
    """Of windows that begin where a model's estimates say, simulated by another; times the noise."""
    run = late_run(late, text)
    made = prepare(mjcf.from_text(told_by), physics.load(mjcf.from_text(told_by)), [run], Stepping(5e-4, RK4))
    true = Structure(Document(mjcf.from_text(delayed(text, late))), mjcf.compile(delayed(text, late)), ("x",))
    off = predict(made.problem, true, [true.first], made.problem.initial[None])[0] - made.problem.windows.observed
    return float(np.sqrt(np.mean((off / made.problem.windows.noise)[made.problem.windows.valid] ** 2)))


@pytest.mark.parametrize("late", [0.02, 0.05])
def test_windows_of_a_late_sensor_begin_where_simulations_do(late: float) -> None:
    """The model knows the delay: it predicts as well from where the estimate begins as without one, and asks for next
    to no force at the end of the recording.
    """
    text = slide('damping="2"')
    in_time = error_at_estimated_starts(text, text, 0.0)
    assert error_at_estimated_starts(text, delayed(text, late), late) < 1.5 * in_time
    source = mjcf.from_text(delayed(text, late))
    made = prepare(source, physics.load(source), [late_run(late)], Stepping(5e-4, RK4))
    assert force_errors(physics.load(source), [late_run(late)], made.motions, (0.0, 1.0))[0] < 0.1  # 0.5 if it stops


def test_a_load_swings_as_told_whatever_delay_is_tried() -> None:
    """The delay is what is asked for, and the motion was told without it."""
    document = Document(mjcf.from_text(slide('damping="2"')))
    catalogue()["load.swinging"].edit(document, "x", {"mass": 0.3, "frequency": 1.5, "damping_ratio": 0.05})
    swinging = document.text().replace('joint="x"/></sensor>', 'joint="x" /></sensor>')
    told = error_at_estimated_starts(swinging, delayed(swinging, 0.05), 0.05)
    assert error_at_estimated_starts(swinging, swinging, 0.05) < 2 * told


def test_a_law_sees_no_more_of_a_command_than_acts(mujoco_alone: Any) -> None:
    """A supply that sags by 30 % under an actuator that takes 5: a command of 20 is one of 5, and drives forwards."""
    document = Document(mjcf.from_text(slide(actuator='<motor name="m" joint="x" ctrlrange="-5 5"/>')))
    sag = {"gain": 1.0, "back": 0.0, "drop": 0.3, "current": 5.0, "time_constant": 0.05}
    catalogue()["motor.sag"].edit(document, "m", sag)
    text = document.text()
    much, enough = (positions(text, (0.0, 0.0), command) for command in (20.0, 5.0))
    np.testing.assert_array_equal(much, enough)
    assert much[-1] > 0.3
    mujoco_alone()
    np.testing.assert_allclose(positions(text, (0.0, 0.0), 20.0), much, atol=1e-5)
    source = physics.load(mjcf.from_text(text))
    data = mujoco.MjData(source.model)
    for _ in range(980):
        source.step(data, np.array([20.0]))
    assert data.qpos[0] == pytest.approx(much[-1], abs=1e-3)


def test_what_a_law_remembers_of_a_command_is_each_variants_own() -> None:
    """A dead zone in front of a supply that sags: what was drawn of late is less than was sent."""
    t = np.linspace(0.0, 2.0, 201)
    recording = Recording(
        time=t,
        commands=np.ones((len(t), 1)),
        sensors=np.zeros((len(t), 1)),
        actuator_names=("m",),
        sensor_names=("p",),
        name="r",
    )
    still = Motion(t, *(np.zeros((len(t), 1)) for _ in range(3)), np.zeros(1))
    made = []
    for width in (0.1, 0.5):
        document = Document(mjcf.from_text(slide()))
        catalogue()["motor.deadzone"].edit(document, "m", {"width": width})
        sag = {"gain": 1.0, "back": 0.0, "drop": 0.2, "current": 1.0, "time_constant": 0.3}
        catalogue()["motor.sag"].edit(document, "m", sag)
        made.append(physics.load(mjcf.from_text(document.text())))
    late = np.zeros((2, 1))
    found = memories(made, 0, late, recording, still, t)
    alone = [memories([one], 0, late[:1], recording, still, t)[0] for one in made]
    np.testing.assert_array_equal(found, alone)
    assert found[0, -1] > 1.2 * found[1, -1]


def test_what_is_remembered_of_a_late_command_comes_late() -> None:
    """A pulse of 0.1 s that acts 50 ms after it was sent has drawn less by its end, and as much 50 ms later."""
    t = np.arange(0.0, 0.5, 0.01)
    commands = ((t >= 0.1) & (t < 0.2)).astype(float)[:, None]
    run = Recording("r", t, commands, np.zeros((len(t), 1)), ("m",), ("p",))
    still = Motion(t, *(np.zeros((len(t), 1)) for _ in range(3)), np.zeros(1))
    document = Document(mjcf.from_text(slide()))
    sag = {"gain": 1.0, "back": 0.0, "drop": 0.2, "current": 1.0, "time_constant": 0.02}
    catalogue()["motor.sag"].edit(document, "m", sag)
    rig = physics.load(mjcf.from_text(document.text()))
    prompt, late = memories([rig, rig], 0, np.array([[0.0], [0.05]]), run, still, t)
    assert prompt.max() > 0.5
    np.testing.assert_allclose(late[5:], prompt[:-5], atol=1e-9)


@pytest.mark.parametrize("integrator", [RK4, None])
def test_windows_of_a_late_sensor_begin_with_what_was_sent_by_then(integrator: Any) -> None:
    """A pulse from 0.5 to 0.7 s, read 50 ms late: what a law remembers goes by when a window's state was, not read."""
    late = 'delay="0.05" nsample="200"'
    document = Document(mjcf.from_text(slide(sensor=late)))
    sag = {"gain": 1.0, "back": 0.0, "drop": 0.2, "current": 1.0, "time_constant": 0.02}
    catalogue()["motor.sag"].edit(document, "m", sag)
    rig = physics.load(mjcf.from_text(document.text()))
    t = np.arange(0.0, 1.0, 0.002)
    commands = ((t >= 0.5) & (t < 0.7)).astype(float)[:, None]
    run = Recording("r", t, commands, (1e-5 * np.sin(t))[:, None], ("m",), ("p",))
    motion = estimate(run, rig, np.array([1e-6]))
    cuts = replace(cut([run], np.array([1e-6]), 0.04, (0.0, 1.0)), motions=(motion,), late=0.05)
    stepping = Stepping(5e-4, integrator)
    runs = batch._Runs([rig], cuts, stepping, ("x",), 1)
    runs.begin(0, np.zeros((1, len(cuts), 2)))
    (found,) = runs._places().remembered[0]
    state_at = cuts.start - 0.05
    # A fifth less is lost for each unit drawn, so that less is drawn, and it is so the sooner.
    drawn = np.where(state_at < 0.5, 0.0, (1 - np.exp(-1.2 * (state_at - 0.5) / 0.02)) / 1.2)
    drawn = np.where(state_at < 0.7, drawn, (1 - np.exp(-12)) / 1.2 * np.exp(-(state_at - 0.7) / 0.02))
    np.testing.assert_allclose(found, drawn, atol=0.002)


def test_a_spring_that_yields_is_bent_by_what_follows_as_well() -> None:
    """Of a follower it is bent as its leader moves; between both nothing bends it."""
    coupled = slide(
        more="""
        <tendon><fixed name="t" stiffness="50" springyield="0.03" springlength="0">{}</fixed></tendon>
        <custom><text name="dipc_gym:follows:f" data="x"/></custom>"""
    ).replace(
        "</worldbody>",
        """<body name="c"><joint name="f" type="slide" axis="1 0 0"/><geom type="sphere" size=".1" mass="1"
        contype="0" conaffinity="0"/></body></worldbody>""",
    )
    t = np.arange(0.0, 1.0, 0.01)
    position = 0.1 * np.sin(8 * t)[:, None]
    motion = Motion(t, position, np.gradient(position, t, axis=0), np.zeros_like(position), np.zeros(1))
    one = {name: f'<joint joint="{name}" coef="1"/>' for name in "xf"}
    own, follower, both = (
        bends([physics.load(coupled.format(held))], 0, motion, t)[0]
        for held in (one["x"], one["f"], one["x"] + one["f"].replace('"1"', '"-1"'))
    )
    assert np.abs(own).max() == pytest.approx(0.03)
    np.testing.assert_array_equal(follower, own)
    assert not both.any()


# Drives


@pytest.mark.parametrize(
    ("actuator", "gain"),
    [
        ('<general name="m" joint="x" dyntype="filter" dynprm="0.01" gainprm="2"/>', 2.0),
        ('<position name="m" joint="x" kp="5" timeconst="0.05"/>', 5.0),
        ('<dcmotor name="m" joint="x" motorconst="0.1" resistance="1" inductance="0 0.05"/>', 0.1),
    ],
)
def test_a_drive_has_its_gain_once_it_has_settled(actuator: str, gain: float) -> None:
    assert drive_of(mjcf.compile(slide(actuator=actuator)), "m")[0] == pytest.approx(gain)


def edited(text: str, effect: str, values: dict[str, float], at: str = "m") -> mujoco.MjModel:
    """A model with an effect of the catalogue."""
    document = Document(mjcf.from_text(text))
    catalogue()[effect].edit(document, at, values)
    return mjcf.compile(document.text())


def test_a_servo_may_inherit_the_range_that_saturation_narrows() -> None:
    servo = '<position name="m" joint="x" kp="5" inheritrange="1"/>'
    model = edited(slide('range="-1 1"', actuator=servo), "motor.saturation", {"limit": 0.5})
    np.testing.assert_allclose(model.actuator_ctrlrange[0], [-0.5, 0.5])


def test_back_emf_adds_to_what_an_actuator_is_damped_by() -> None:
    braked = '<motor name="m" joint="x" gear="2" damping="0.5"/>'
    model = edited(slide(actuator=braked), "motor.back_emf", {"coefficient": 0.2})
    assert model.actuator_damping[0] == pytest.approx(0.5 + 0.2 / 4)


def test_springs_that_stiffen_are_springs() -> None:
    stiffening = mjcf.compile(slide('stiffness="0 0 5"'))
    assert not catalogue()["load.spring"].fits(stiffening, "x")
    assert catalogue()["load.spring"].fits(mjcf.compile(slide()), "x")


def test_a_motor_that_lags_takes_no_gain_from_default_classes() -> None:
    other = '<default><general gainprm="50" biastype="affine" biasprm="0 -50 0"/></default>'
    model = edited(slide(more=other), "motor.inductance", {"time_constant": 0.01})
    assert model.actuator_gainprm[0, 0] == 1.0
    assert model.actuator_biastype[0] == mujoco.mjtBias.mjBIAS_NONE


def test_a_limit_of_a_joints_forces_goes_along_with_the_drive() -> None:
    """A DC motor has one limit both ways: one that a joint sets from -2 to 1 N stands at its rotor then."""
    motor = '<dcmotor name="m" joint="x" motorconst="1" resistance="1"/>'
    text = slide('actuatorfrcrange="-2 1" actuatorfrclimited="true"', actuator=motor)
    values = {"stiffness": 1e3, "damping": 1.0, "rotor_inertia": 0.1}
    model = edited(text, "transmission.compliance", values)
    data = mujoco.MjData(model)
    for command, most in ((10.0, 1.0), (-10.0, -2.0)):
        data.ctrl[0] = command
        mujoco.mj_forward(model, data)
        assert data.qfrc_actuator[model.joint("m_rotor").dofadr[0]] == pytest.approx(most)


def test_a_speed_servo_is_no_supply_that_sags() -> None:
    for actuator, drains in ((MOTOR, True), ('<velocity name="m" joint="x" kv="2"/>', False)):
        assert catalogue()["motor.sag"].fits(mjcf.compile(slide(actuator=actuator)), "m") == drains


@pytest.mark.parametrize(
    ("gravity", "along", "hinge", "about"),
    [
        ("0 0 -9.81", "1 0 0", "0 1 0", "y"),
        ("0 0 -9.81", "0 1 0", "1 0 0", "x"),
        ("0 -9.81 0", "1 0 0", "0 0 1", "z"),
        ("-9.81 0 0", "0 1 0", "0 0 1", "z"),
    ],
)
def test_a_planar_rig_tilts_within_its_plane(gravity: str, along: str, hinge: str, about: str) -> None:
    """Turned about the other axis across gravity, its joints would feel it in second order alone."""
    down = " ".join(str(0.03 * float(g)) for g in gravity.split())
    model = mjcf.compile(f"""<mujoco><option gravity="{gravity}"/><worldbody><body><joint name="x" type="slide"
        axis="{along}"/><geom size=".1" mass="1"/><body><joint name="q" axis="{hinge}"/>
        <geom type="capsule" fromto="0 0 0 {down}" size=".01" mass=".3"/></body></body></worldbody></mujoco>""")
    assert load_tilt._felt(model) == about
    document = Document(mjcf.from_text(f'<mujoco><option gravity="{gravity}"/></mujoco>'))
    load_tilt.Tilt(about).edit(document, "world", {f"about_{about}": 0.1})
    model.opt.gravity[:] = [float(g) for g in document.get_option("gravity").split()]
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert abs(data.qfrc_bias[0]) == pytest.approx(1.3 * 9.81 * np.sin(0.1))


def test_gravity_that_no_joint_feels_is_tilted_by_nobody() -> None:
    weightless = mjcf.compile(slide())
    assert not catalogue()["load.tilt"].fits(weightless, "world")
    # A lift: its axis is vertical but for rounding.
    lift = mjcf.compile("""<mujoco><worldbody><body euler="30 0 0"><geom size=".1" mass="1"/>
        <joint name="x" type="slide" axis="0 0.5 0.86602540378443865"/></body></worldbody></mujoco>""")
    assert not catalogue()["load.tilt"].fits(lift, "world")
