"""Recordings that count otherwise than the model: which way is positive, where zero is, what an angle starts from."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from sim2real_rigs import CART, HANGING, NOISE, RK4, prepared, record, sweep

from dipc_gym import cli, mjcf, physics, recording
from dipc_gym.recording import Recording
from dipc_gym.sim2real.diagnosis import diagnose
from dipc_gym.sim2real.estimation.fit import fit
from dipc_gym.sim2real.simulation.batch import Stepping
from dipc_gym.sim2real.verdict import conventions
from dipc_gym.sim2real.verdict.conventions import Convention

RATED = HANGING.replace("</sensor>", '<jointvel name="rate2" joint="pole2"/></sensor>')
SENSORS = ("cart", "pole1", "pole2", "rate2")
EVERY = list(conventions.possible(mjcf.from_text(RATED), physics.load(mjcf.from_text(RATED)), ("motor",), SENSORS))
STEPPING = Stepping(0.002, RK4)


def otherwise(run: Recording, convention: Convention) -> Recording:
    """The recording whose owner follows the convention."""
    sensors = np.linalg.solve(convention.sensors, (run.sensors - convention.shift).T).T
    columns = np.concatenate([run.commands / convention.commands, sensors], axis=1)
    columns[:, convention.columns] = columns.copy()
    commands, sensors = np.split(columns, [run.commands.shape[1]], axis=1)
    commands = np.concatenate([np.repeat(commands[:1], convention.early, axis=0), commands])[: len(sensors)]
    return replace(run, commands=commands, sensors=sensors)


@pytest.fixture(scope="module")
def hanging() -> Recording:
    """The model itself, swinging widely."""
    rig = physics.load(mjcf.from_text(RATED))
    return record(rig, sweep(6.0), 8.0, noise=(*NOISE["hanging"], 2e-2), start=(0.0, 0.9, -0.6), integrator=RK4)


def found(text: str, run: Recording) -> tuple[list[Convention], float]:
    """What is found to differ, beside the model as given."""
    source = mjcf.from_text(text)
    cut = prepared(text, [run], stepping=STEPPING)
    given = fit(cut.problem, cut.structure)
    return conventions.differing(source, physics.load(source), [run], cut, [given])


def test_every_convention_is_thought_of() -> None:
    said = [convention.words for convention in EVERY]
    assert said == [
        "hold in each row what the command of that row led to, and not what it followed",
        "give commands 2 rows later than they act",
        "give commands 3 rows later than they act",
        "count command 'motor' the other way round",
        "count command 'motor' in thousandths (mV)",
        "count sensor 'cart' the other way round",
        "count sensor 'pole1' the other way round",
        "count sensor 'pole1' from half a turn away",
        "count sensors 'pole2' and 'rate2' the other way round",
        "count sensor 'pole2' from half a turn away",
        "have command 'motor' and sensor 'cart' interchanged",
        "have sensor 'pole1' and sensor 'pole2' interchanged",
    ]
    # Without the rate, which would need one of the joint before.
    hanging = mjcf.from_text(HANGING)
    plain = conventions.possible(hanging, physics.load(hanging), ("motor",), SENSORS[:3])
    assert [convention.words for convention in plain if convention.words.startswith("measure")] == [
        "measure at joint 'pole2' an absolute angle, and the model does not",
        "measure at joint 'pole2' an angle from 'pole1', and the model does not",
    ]


@pytest.mark.parametrize("convention", EVERY, ids=lambda convention: convention.words)
def test_what_differs_is_found(hanging: Recording, convention: Convention) -> None:
    others, error = found(RATED, otherwise(hanging, convention))
    assert [one.words for one in others] == [convention.words]
    assert error < 1.2


def test_a_rig_that_rests_at_first_is_asked_where_it_moves(hanging: Recording) -> None:
    """At rest every convention predicts all, and whoever reads whole counts sees nothing change."""
    late, still = 15.0, np.repeat(hanging.sensors[:1], 7500, axis=0)
    time = np.append(hanging.time[0] + 0.002 * np.arange(7500), hanging.time + late)
    commands = np.append(np.zeros((7500, 1)), hanging.commands, 0)
    resting = replace(hanging, time=time, commands=commands, sensors=np.append(still, hanging.sensors, 0))
    convention = next(one for one in EVERY if one.words == "count command 'motor' the other way round")
    others, _ = found(RATED, otherwise(resting, convention))
    assert [one.words for one in others] == [convention.words]


def test_behind_a_slow_filter_more_of_the_past_is_asked() -> None:
    """Of a command that a filter of 0.9 s passes on, a window knows nothing before seven seconds."""
    slow = '<general name="motor" joint="cart" gear="10" dyntype="filter" dynprm="0.9"/>'
    text = re.sub("<dcmotor [^>]*/>", slow, RATED)
    rig = physics.load(mjcf.from_text(text))
    run = record(rig, sweep(6.0), 11.0, noise=(*NOISE["hanging"], 2e-2), start=(0.0, 0.9, -0.6), integrator=RK4)
    convention = next(one for one in EVERY if one.words == "count sensor 'pole1' the other way round")
    others, _ = found(text, otherwise(run, convention))
    assert [one.words for one in others] == [convention.words]


@pytest.mark.parametrize("way", ["absolute", "from 'pole1'"])
def test_absolute_and_relative_angles_are_told_apart(hanging: Recording, way: str) -> None:
    plain = replace(hanging, sensors=hanging.sensors[:, :3], sensor_names=SENSORS[:3])
    (convention,) = (
        one
        for one in conventions.possible(
            mjcf.from_text(HANGING), physics.load(mjcf.from_text(HANGING)), ("motor",), SENSORS[:3]
        )
        if one.words.startswith("measure") and way in one.words
    )
    others, error = found(HANGING, otherwise(plain, convention))
    assert [one.words for one in others] == [convention.words]
    assert error < 1.2


def test_physics_that_is_missing_is_no_convention() -> None:
    rough = CART.replace('damping="21.4"', 'damping="30" frictionloss="25"')
    run = record(physics.load(mjcf.from_text(rough)), sweep(4.0), 8.0, noise=NOISE["cart"])
    others, _ = found(CART, run)
    assert others == []


def test_nothing_else_is_told_of_recordings_that_differ(hanging: Recording) -> None:
    half = next(one for one in EVERY if "'pole1' from half" in one.words)
    run = otherwise(hanging, half)
    said = diagnose(mjcf.from_text(RATED), [run])
    assert said.verdict == "cannot tell"
    assert "they seem to count sensor 'pole1' from half a turn away" in said.sentence
    assert said.next_experiment.startswith(
        "Add half a turn to the column, or give joint 'pole1' of the model ref=\"180\""
    )
    mended = RATED.replace('name="pole1" type="hinge"', 'name="pole1" type="hinge" ref="180"')
    assert mended != RATED
    assert diagnose(mjcf.from_text(mended), [run]).verdict == "consistent"


def test_on_a_symmetric_rig_command_and_sensor_are_alike_and_either_is_mended_by_its_unit(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = record(physics.load(mjcf.from_text(CART)), sweep(4.0), 8.0, noise=NOISE["cart"], integrator=RK4)
    (tmp_path / "cart.xml").write_text(CART)
    recording.write(replace(run, commands=-run.commands), tmp_path / "run.csv")
    asked = ["diagnose", str(tmp_path / "cart.xml"), str(tmp_path / "run.csv"), "--out"]
    assert cli.main([*asked, str(tmp_path / "first")]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "count command 'motor' the other way round, or to count sensor 'cart' the other way round" in said
    mend = "urn its sign round (--unit {}=-1, or a minus before the unit given, as in -mm), "
    assert f"T{mend.format('motor')}or t{mend.format('cart')}and diagnose again" in said
    assert cli.main([*asked, str(tmp_path / "second"), "--unit", "motor=-V"]) == 0
    assert "Nothing is missing" in capsys.readouterr().out


PENDULUM = """
<mujoco model="pendulum">
  <compiler angle="radian"/>
  <option timestep="0.002" integrator="RK4"/>
  <worldbody>
    <body name="arm">
      <joint name="hip" axis="0 1 0" damping="0.02"/>
      <inertial pos="0 0 -{arm}" mass="0.5" diaginertia="0.006 0.006 0.0005"/>
    </body>
  </worldbody>
  <actuator><motor name="hip" joint="hip"/></actuator>
  <sensor><jointpos name="hip" joint="hip"/></sensor>
</mujoco>
"""


def test_a_command_that_never_changes_is_no_reading() -> None:
    """A free swing of an arm whose length is wrong: nothing of it can be interchanged with the motor's zeros."""
    swung = record(
        physics.load(mjcf.from_text(PENDULUM.format(arm=0.3))), lambda time: 0.0, 8.0, noise=1e-3, start=(1.0,)
    )
    said = diagnose(mjcf.from_text(PENDULUM.format(arm=0.1)), [swung], effects=[])
    assert said.verdict != "cannot tell"


@pytest.mark.parametrize("wrong", ["interchanged", "thousandths"])
def test_the_advice_mends_what_it_is_given_for(wrong: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Also where a command and a sensor have one name, and in the model's own unit of angle."""
    text = PENDULUM.format(arm=0.2)
    run = record(
        physics.load(mjcf.from_text(text)), lambda t: 0.3 * np.sin(4 * t) + 0.2 * np.sin(9 * t), 8.0, noise=1e-3
    )
    commands, sensors = run.commands, run.sensors
    if wrong == "interchanged":
        commands, sensors = sensors, commands
    else:
        commands = 1e3 * commands
    (tmp_path / "arm.xml").write_text(text)
    recording.write(replace(run, commands=commands, sensors=sensors), tmp_path / "run.csv")
    asked = ["diagnose", str(tmp_path / "arm.xml"), str(tmp_path / "run.csv"), "--out"]
    assert cli.main([*asked, str(tmp_path / "first")]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert wrong in said
    options = re.findall(r"--(?:map|unit) [^\s,)]+", said)
    assert options == (
        ["--map ctrl:hip=sensor:hip", "--map sensor:hip=ctrl:hip"]
        if wrong == "interchanged"
        else ["--unit ctrl:hip=mNm"]
    )
    assert cli.main([*asked, str(tmp_path / "second"), *" ".join(options).split()]) == 0
    assert "Nothing is missing" in capsys.readouterr().out


def test_half_a_turn_is_told_in_the_unit_of_the_file() -> None:
    text = PENDULUM.format(arm=0.2)
    for unit, half in (("radian", "3.1415927"), ("degree", "180")):
        source = mjcf.from_text(text.replace("radian", unit))
        (turned,) = (
            one
            for one in conventions.possible(source, physics.load(source), ("hip",), ("hip",))
            if "half a turn" in one.words
        )
        assert f'ref="{half}"' in turned.mend


DOUBLE = """
<mujoco><option timestep="0.002" integrator="RK4"/><worldbody><body><joint name="a" axis="0 1 0" damping="0.02"/>
  <inertial pos="0 0 -0.2" mass="0.5" diaginertia="0.006 0.006 0.0005"/>
  <body pos="0 0 -0.4"><joint name="b" axis="0 {way} 0" damping="0.01"/>
    <inertial pos="0 0 -0.15" mass="0.2" diaginertia="0.002 0.002 0.0002"/></body></body></worldbody>
<actuator><motor name="a" joint="a" gear="2"/>{geared}</actuator>
<sensor><jointpos name="a" joint="a"/>{reads}</sensor></mujoco>
"""
PLAIN = '<jointpos name="b" joint="b"/>'
GEARED = '<actuatorpos name="b" actuator="idle"/>'


@pytest.mark.parametrize("way", [1, -1])
@pytest.mark.parametrize("reads", [PLAIN, GEARED], ids=["plain", "geared"])
def test_angles_from_afar_are_those_of_a_pair_of_axes(way: int, reads: str) -> None:
    """Of axes that point apart, what adds up is their difference; an encoder may turn thirty times as far."""
    geared = '<motor name="idle" joint="b" gear="30"/>' if reads == GEARED else ""
    source = mjcf.from_text(DOUBLE.format(way=way, reads=reads, geared=geared))
    times = 30.0 if geared else 1.0
    names = ("a", "idle") if geared else ("a",)
    listed = list(conventions.possible(source, physics.load(source), names, ("a", "b")))
    absolute = next(one for one in listed if "at joint 'b' an absolute angle" in one.words)
    turned = next(one for one in listed if "'b' from half a turn" in one.words)
    a, b = 0.7, -0.4
    seen = np.array([[a, times * (b + way * a)]])  # the lower body against the world, about its own axis
    assert seen @ absolute.sensors.T == pytest.approx(np.array([[a, times * b]]))
    assert absolute.mend.startswith("subtract" if way > 0 else "add")
    assert turned.shift == pytest.approx([0.0, times * np.pi])


def test_the_advice_to_turn_a_sign_names_what_the_reader_takes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = PENDULUM.format(arm=0.2)
    run = record(physics.load(mjcf.from_text(text)), lambda t: 0.3 * np.sin(4 * t) + 0.1, 8.0, noise=1e-3)
    (tmp_path / "arm.xml").write_text(text)
    recording.write(replace(run, commands=-run.commands), tmp_path / "run.csv")
    asked = ["diagnose", str(tmp_path / "arm.xml"), str(tmp_path / "run.csv"), "--out"]
    assert cli.main([*asked, str(tmp_path / "first")]) == 0
    options = re.findall(r"--unit [^\s,)]+", capsys.readouterr().out)
    assert options[0] == "--unit ctrl:hip=-1"
    assert cli.main([*asked, str(tmp_path / "second"), *options[0].split()]) == 0
    assert "Nothing is missing" in capsys.readouterr().out


def test_a_command_in_degrees_is_found() -> None:
    """The angle that a servo is asked for."""
    servo = HANGING.replace("<actuator>", "<actuator><!-- ").replace(
        "</actuator>", ' --><position name="motor" joint="pole1" kp="5"/></actuator>'
    )
    source = mjcf.from_text(servo)
    words = [one.words for one in conventions.possible(source, physics.load(source), ("motor",), SENSORS[:3])]
    assert "count command 'motor' in degrees (deg)" in words
    volts = mjcf.from_text(HANGING)
    assert not any(
        "in degrees" in one.words for one in conventions.possible(volts, physics.load(volts), ("motor",), SENSORS[:3])
    )
