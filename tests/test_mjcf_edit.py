"""Editing MJCF as text: what the author wrote stays, what is written means what was meant."""

from __future__ import annotations

import difflib
import math
import xml.etree.ElementTree as ET
from pathlib import Path

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import dipc_gym
from dipc_gym import mjcf, physics
from dipc_gym.mjcf.edit import Document, text, written_out
from dipc_gym.sim2real.effects import catalogue
from dipc_gym.sim2real.effects.shared.base import passive_ramp
from dipc_gym.sim2real.model.parameters import fixed_masses, model_parameters

RIG = Path(dipc_gym.__file__).with_name("rig.xml")
CLASSES = """<mujoco>
  <compiler autolimits="true"/>
  <default>
    <joint damping="3 0 1" type="slide"/>
    <motor gear="5" ctrlrange="-2 2" forcerange="-3 3"/>
    <default class="swing">
      <joint type="hinge" axis="0 1 0" damping="0.5" pos="0 0 0.1" range="-90 90"/>
      <default class="free"><joint damping="0"/></default>
    </default>
  </default>
  <worldbody>
    <body name="cart">
      <inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
      <joint name="cart" axis="1 0 0"/>
      <body name="pole" childclass="swing">
        <inertial pos="0 0 -0.3" mass="0.5" diaginertia="0.01 0.01 0.01"/>
        <joint name="pole"/>
        <body name="tip" pos="0 0 -1">
          <inertial pos="0 0 -0.3" mass="0.5" diaginertia="0.01 0.01 0.01"/>
          <joint name="tip" class="free"/>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor name="push" joint="cart"/>
    <motor name="turn" joint="pole"/>
  </actuator>
  <sensor><jointpos name="cart" joint="cart"/></sensor>
</mujoco>"""


def document(source: str | Path) -> Document:
    return Document(mjcf.read(source) if isinstance(source, Path) else mjcf.from_text(source))


def compiled(edited: Document) -> mujoco.MjModel:
    return mjcf.compile(edited.source.edited(edited.text()), trusted=True)


def changed_lines(before: str, after: str) -> list[str]:
    return [
        line
        for line in difflib.unified_diff(before.splitlines(), after.splitlines(), lineterm="", n=0)
        if line[0] in "+-" and line[:3] not in ("+++", "---")
    ]


# What the author wrote stays


def test_a_file_that_nobody_edits_comes_out_as_it_was() -> None:
    source = mjcf.read(RIG)
    assert Document(source).text() == source.text


def test_one_number_changes_one_line() -> None:
    source = mjcf.read(RIG)
    edited = Document(source).copy()
    edited.set(edited.joint("pole1"), damping=0.25)
    lines = changed_lines(source.text, edited.text())
    assert len(lines) == 2
    assert lines[1].strip("+ ") == '<joint name="pole1" type="hinge" axis="0 1 0" damping="0.25"/>'


def test_layout_comments_quotes_and_what_stands_around_the_root_stay() -> None:
    odd = """<?xml version='1.0'?>
<!-- before: <joint name="a"/> -->
<mujoco
    model = 'x'>
  <worldbody><!-- inside <joint name="j" /> -->
    <body><joint name='j'   axis="0 0 1"
                 damping="1"/><geom size="1" rgba="1 0 0 1"></geom></body>
  </worldbody>
</mujoco>
<!-- after -->
"""
    kept = document(odd).text()
    for piece in (
        "<?xml version='1.0'?>\n<!-- before: <joint name=\"a\"/> -->\n<mujoco\n    model = 'x'>",
        '<!-- inside <joint name="j" /> -->',
        '<joint name=\'j\'   axis="0 0 1"\n                 damping="1"/>',
        "</mujoco>\n<!-- after -->\n",
    ):
        assert piece in kept
    assert mjcf.compile(kept).njnt == 1


def test_an_edited_copy_leaves_the_original_alone() -> None:
    original = document(CLASSES)
    twin = original.copy()
    twin.set(twin.joint("cart"), damping=7)
    twin.add("custom", "text", name="n", data="x")
    assert original.text() == CLASSES


def test_what_is_added_is_indented_like_the_rest() -> None:
    edited = document(CLASSES)
    edited.add("actuator", "motor", name="more", joint="tip")
    edited.add("tendon", "fixed", name="t")
    lines = edited.text().splitlines()
    assert '    <motor name="more" joint="tip"/>' in lines
    assert "  <tendon>" in lines
    assert '    <fixed name="t"/>' in lines
    assert lines[-1] == "</mujoco>"


def test_sections_may_stand_more_than_once() -> None:
    """MuJoCo merges them."""
    rig = document(
        '<mujoco><worldbody><body><joint name="a"/><geom size="0.1"/></body></worldbody>'
        '<actuator><motor name="one" joint="a" gear="-3"/></actuator><actuator><motor name="two" joint="a"/></actuator>'
        '<sensor><jointpos name="angle" joint="a"/></sensor><sensor/></mujoco>'
    )
    assert rig.actuator_names() == ["one", "two"]
    assert rig.actuator("one").get("gear") == "-3"
    assert rig.sensor("angle").get("joint") == "a"
    # A drive that is geared to turn the other way has a gain all the same.
    gear = next(number for number in model_parameters(rig, compiled(rig)) if number.key == "one.gear")
    assert gear.value == 3
    gear.write(rig, 4.0)
    assert compiled(rig).actuator("one").gear[0] == -4


# Includes


def test_includes_are_put_in_place(tmp_path: Path) -> None:
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "pole.xml").write_text(
        '\ufeff<mujocoinclude><!-- the pole --><body name="pole"><joint name="pole" damping="2"/><geom size="0.1"/>'
        '<include file="parts/tip.xml"/></body></mujocoinclude>'
    )
    (tmp_path / "parts" / "tip.xml").write_text(
        '<mujoco><body name="tip"><joint name="tip"/><geom size="0.1"/></body></mujoco>'
    )
    (tmp_path / "rig.xml").write_text(
        '<mujoco><option timestep="0.004"/><worldbody><include file="./parts//pole.xml"/></worldbody></mujoco>'
    )
    before = document(tmp_path / "rig.xml")
    assert "include" not in before.text()
    assert "<!-- the pole -->" in before.text()
    assert before.joint_names() == ["pole", "tip"]
    model = compiled(before)
    assert model.njnt == 2
    assert model.opt.timestep == 0.004
    before.set(before.joint("pole"), damping=5)
    assert compiled(before).dof_damping[0] == 5


# Numbers


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_numbers_keep_every_digit(value: float) -> None:
    assert float(text(value)) == value


@settings(max_examples=20, deadline=None)
@given(st.floats(1e-12, 1e12))
def test_numbers_reach_mujoco_to_the_last_digit(value: float) -> None:
    edited = document(CLASSES)
    edited.set(edited.joint("pole"), damping=[value, 0, 0])
    assert compiled(edited).dof_damping[1] == value


def test_numbers_that_are_whole_are_written_as_such() -> None:
    assert text([1.0, 0.5, -3]) == "1 0.5 -3"


# Default classes


def test_effective_attributes_are_those_that_mujoco_uses() -> None:
    file = document(CLASSES)
    model = compiled(file)
    for name in file.joint_names():
        written = file.effective(file.joint(name), "damping").split()
        assert float(written[0]) == model.joint(name).damping[0]
    assert file.effective(file.joint("cart"), "damping") == "3 0 1"
    assert file.effective(file.joint("cart"), "type") == "slide"
    assert file.effective(file.joint("pole"), "pos") == "0 0 0.1"
    assert file.effective(file.joint("tip"), "axis") == "0 1 0"
    assert file.effective(file.joint("tip"), "stiffness", "none") == "none"
    assert file.effective(file.actuator("push"), "gear") == "5"


def test_drag_keeps_the_damping_that_a_class_gives() -> None:
    edited = document(CLASSES)
    catalogue()["drag.quadratic"].edit(edited, "cart", {"coefficient": 4.0})
    model = compiled(edited)
    assert model.dof_damping[0] == 3
    assert model.dof_dampingpoly[0].tolist() == [4, 1]


def test_a_refitted_number_keeps_its_neighbours_from_a_class() -> None:
    file = document(CLASSES)
    (damping,) = (n for n in model_parameters(file, compiled(file)) if n.key == "cart.damping")
    damping.write(file, 9.0)
    model = compiled(file)
    assert model.dof_damping[0] == 9
    assert model.dof_dampingpoly[0].tolist() == [0, 1]


BOX = '<geom size=".1" mass="2"/>'


@pytest.mark.parametrize(
    ("compiler", "inner", "free"),
    [
        ("", BOX, True),
        ('inertiafromgeom="true"', BOX, True),  # as in Gymnasium's inverted pendulums
        ('settotalmass="5"', BOX, False),  # whatever is written is scaled back
        ('fusestatic="true"', f"{BOX}<body name='welded' pos='0 0 1'>{BOX}</body>", False),  # counted again
    ],
)
def test_a_mass_is_refitted_only_where_what_is_written_holds(compiler: str, inner: str, free: bool) -> None:
    source = mjcf.from_text(
        f'<mujoco><compiler {compiler}/><worldbody><body name="cart"><joint name="cart" type="slide"/>{inner}</body>'
        "</worldbody></mujoco>"
    )
    file = Document(written_out(source, mjcf.compile(source)))
    model = compiled(file)
    parameters = model_parameters(file, model)
    masses = [number for number in parameters if number.key == "cart.mass"]
    assert bool(masses) == free
    assert bool(fixed_masses(file, model, parameters)) != free
    for mass in masses:
        mass.write(file, 3.0)
        assert compiled(file).body("cart").mass[0] == pytest.approx(3.0)


def test_added_forces_do_not_inherit_what_motors_have() -> None:
    """A constant force of 1 N is 1 N, though the file's motors have a gear of 5 and a limit."""
    for effect, values in (
        ("load.constant", {"force": 8.0}),
        ("friction.asymmetric", {"forward": 0.0, "backward": 16.0}),
    ):
        edited = document(CLASSES)
        catalogue()[effect].edit(edited, "cart", values)
        model = compiled(edited)
        model.dof_frictionloss[:] = 0
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        assert data.qfrc_actuator[0] == pytest.approx(8.0)


@pytest.mark.parametrize("at", ["push", "turn"])
def test_a_rotor_does_not_inherit_what_joints_have(at: str) -> None:
    edited = document(CLASSES)
    values = {"stiffness": 100.0, "damping": 1.0, "rotor_inertia": 0.1}
    catalogue()["transmission.compliance"].edit(edited, at, values)
    model = compiled(edited)
    rotor, load = model.joint(f"{at}_rotor"), model.joint("cart" if at == "push" else "pole")
    assert rotor.type == load.type
    assert rotor.axis.tolist() == load.axis.tolist()
    assert model.dof_damping[rotor.dofadr[0]] == 0
    assert not np.any(model.dof_dampingpoly[rotor.dofadr[0]])
    assert not model.jnt_limited[rotor.id]
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, full)
    assert full[rotor.dofadr[0], rotor.dofadr[0]] == pytest.approx(0.1, rel=1e-6)


# Degrees, options, names


@pytest.mark.parametrize("degrees", [True, False])
def test_angles_are_written_in_the_files_unit(degrees: bool) -> None:
    edited = document(CLASSES if degrees else CLASSES.replace("<compiler", '<compiler angle="radian"'))
    for joint in ("cart", "tip"):
        catalogue()["load.spring"].edit(edited, joint, {"stiffness": 3.0, "rest": 0.2})
    model = compiled(edited)
    for joint in ("cart", "tip"):
        assert model.qpos_spring[model.joint(joint).qposadr[0]] == pytest.approx(0.2, rel=1e-12)


def test_of_several_option_sections_the_last_holds() -> None:
    doubled = CLASSES.replace(
        "<default>", '<option timestep="0.005"/><option timestep="0.003" gravity="0 0 -5"/><option/><default>', 1
    )
    edited = document(doubled)
    assert edited.timestep == compiled(edited).opt.timestep == 0.003
    edited.option(timestep=0.001)
    catalogue()["load.tilt"].edit(edited, "world", {"about_x": 0.0, "about_y": 0.1})
    model = compiled(edited)
    assert model.opt.timestep == 0.001
    assert model.opt.gravity == pytest.approx([-5 * np.sin(0.1), 0, -5 * np.cos(0.1)])


def test_options_are_raised_but_never_lowered() -> None:
    edited = document(CLASSES)
    edited.at_least(noslip_iterations=3, iterations=100)
    assert edited.root.find("option") is not None
    assert edited.root.find("option").attrib == {"noslip_iterations": "3"}  # type: ignore[union-attr]
    edited.at_least(noslip_iterations=1)
    assert compiled(edited).opt.noslip_iterations == 3


def test_names_that_are_taken_are_not_used_twice() -> None:
    edited = document(CLASSES)
    for _ in range(3):
        catalogue()["load.constant"].edit(edited, "cart", {"force": 1.0})
    model = compiled(edited)
    assert [model.actuator(i).name for i in range(2, 5)] == ["cart_load", "cart_load_2", "cart_load_3"]


def test_a_custom_entry_is_written_once() -> None:
    edited = document(CLASSES)
    edited.custom("sensor.bias", "cart", [0.1])
    edited.custom("sensor.bias", "cart", [0.2])
    (extra,) = physics.from_model(compiled(edited)).extras
    assert extra.data.tolist() == [0.2]


def test_a_name_that_does_not_stand_in_the_text_is_said() -> None:
    with pytest.raises(mjcf.MjcfError, match="no joint named 'elbow'"):
        document(CLASSES).joint("elbow")


@settings(max_examples=30, deadline=None)
@given(st.text(st.characters(codec="utf-8"), min_size=1, max_size=12).filter(str.isprintable))
def test_any_name_survives(name: str) -> None:
    root = ET.fromstring(CLASSES)
    root.find(".//body[@name='tip']/joint").set("name", name)  # type: ignore[union-attr]
    source = ET.tostring(root, encoding="unicode")
    if name in ("cart", "pole"):
        return
    edited = document(source)
    edited.set(edited.joint(name), damping=2)
    catalogue()["load.constant"].edit(edited, name, {"force": 1.0})
    edited.custom("friction.load", name, [1.0, 0.1, 0.1])
    loaded = physics.from_model(compiled(edited))
    assert loaded.model.joint(2).name == name
    assert loaded.extras[0].at == name
    assert loaded.model.dof_damping[2] == 2


@given(st.text(st.sampled_from("-<>!ab "), max_size=12))
def test_a_comment_stays_one_whatever_is_in_it(words: str) -> None:
    document = Document(mjcf.from_text(CLASSES))
    document.comment(words, f"{words}-->")
    again = ET.fromstring(document.text())
    assert [e.tag for e in again.iter()] == [e.tag for e in ET.fromstring(CLASSES).iter()]


def test_numbers_that_a_refit_cannot_write_are_left_out() -> None:
    """A carriage without a mass of its own, and what `<replicate>` gives other names."""
    source = mjcf.from_text(
        """<mujoco><worldbody>
          <body name="carriage"><joint name="rail" type="slide" damping="1"/>
            <body name="load"><inertial pos="0 0 0" mass="2" diaginertia="1 1 1"/></body></body>
          <replicate count="3" offset="1 0 0"><body name="post"><joint name="swing" damping="2"/>
            <inertial pos="0 0 -1" mass="1" diaginertia="1 1 1"/></body></replicate>
        </worldbody></mujoco>"""
    )
    parameters = model_parameters(Document(source), mjcf.compile(source))
    assert [number.key for number in parameters] == ["rail.damping"]


SERVO = """<mujoco>
  <default><position kp="30"/><default class="damped"><position kv="2"/></default></default>
  <worldbody>
    <body name="link"><joint name="j" axis="0 1 0"/><geom size="0.1" mass="1" contype="0" conaffinity="0"/></body>
  </worldbody>
  <tendon><fixed name="t"><joint joint="j" coef="1"/></fixed></tendon>
  <actuator>
    <position name="plain" joint="j"/><position name="damped" class="damped" joint="j" gear="2"/>
    <position name="by_mass" joint="j" dampratio="1"/><position name="of_tendon" tendon="t"/>
    <velocity name="speed" joint="j" kv="3"/>
  </actuator>
  <sensor><jointpos name="j" joint="j"/></sensor>
</mujoco>"""


def test_a_servo_has_its_gains_for_parameters_and_keeps_its_gear() -> None:
    """A gear would stretch what it is asked for; a damping that the compiler makes by the mass stays what it is."""
    document = Document(mjcf.from_text(SERVO))
    model = mjcf.compile(SERVO)
    parameters = [one for one in model_parameters(document, model) if one.at not in ("link", "j")]
    assert {(one.key, one.value, one.unit) for one in parameters} == {
        ("plain.kp", 30.0, "N m/rad"),
        ("damped.kp", 30.0, ""),
        ("damped.kv", 2.0, ""),
        ("of_tendon.kp", 30.0, ""),
        ("by_mass.kp", 30.0, "N m/rad"),
        ("speed.kv", 3.0, "N m s/rad"),
    }
    for one in parameters:
        if one.attribute != "gear":
            one.write(document, 2 * one.value)
    written = mjcf.compile(document.text())
    np.testing.assert_allclose(written.actuator_gainprm[:4, 0], 60.0)
    np.testing.assert_allclose(written.actuator_biasprm[:2, 1:3], [[-60.0, 0.0], [-60.0, -4.0]])
    np.testing.assert_array_equal(written.actuator_gear, model.actuator_gear)


# Default classes that give an actuator's numbers by a shortcut


@pytest.mark.parametrize(
    "shortcut",
    [
        '<position kp="50" kv="3"/>',
        '<position kp="50" timeconst="0.1"/>',
        '<dcmotor motorconst="0.1" resistance="1" inductance="0.01"/>',
        '<velocity kv="7"/>',
    ],
)
def test_a_force_in_an_actuators_clothes_is_the_same_whatever_defaults_say(shortcut: str) -> None:
    document = Document(
        mjcf.from_text(
            f"""<mujoco><default>{shortcut}</default><worldbody><body><joint name="x" type="slide"/>
            <inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body></worldbody>
            <actuator><motor name="drive" joint="x" gear="2"/></actuator></mujoco>"""
        )
    )
    passive_ramp(document, "drag", "x", (0.0, 0.0, -3.0), (-9.0, 9.0))
    catalogue()["motor.inductance"].edit(document, "drive", {"time_constant": 0.01})
    model = mjcf.compile(document.text())
    data = mujoco.MjData(model)
    data.qpos[0], data.qvel[0], data.ctrl[:] = 0.4, 1.5, 1.0  # also of what nobody is to command
    data.act[:] = 1.0
    mujoco.mj_forward(model, data)
    drive, drag = (float(data.actuator_force[k]) for k in range(2))
    assert (drive, drag) == (pytest.approx(1.0), pytest.approx(-4.5))
    assert model.na == 1


def test_a_joint_that_the_text_does_not_hold_is_refused_with_how_to_write_it_out() -> None:
    text = (
        '<mujoco><worldbody><replicate count="2" offset="0 1 0"><body><joint name="j"/><geom size="0.1"/></body>'
        "</replicate></worldbody></mujoco>"
    )
    source = mjcf.from_text(text)
    with pytest.raises(mjcf.MjcfError, match=r"no joint named 'j0' stands in the text; <replicate>.*MjSpec.from_file"):
        Document(source).check_written_out(mjcf.compile(source))
    spec = mujoco.MjSpec.from_string(text)
    spec.compile()
    out = mjcf.from_text(spec.to_xml())
    Document(out).check_written_out(mjcf.compile(out))


def test_of_two_compilers_the_last_says_what_an_angle_is_in() -> None:
    text = '<mujoco>{}<worldbody><body><joint name="j"/><geom size="1"/></body></worldbody></mujoco>'
    for said, degrees in ((("radian", "degree"), True), (("degree", "radian"), False)):
        document = Document(mjcf.from_text(text.format("".join(f'<compiler angle="{one}"/>' for one in said))))
        assert document.angle(document.joint("j"), math.pi) == pytest.approx(180.0 if degrees else math.pi)
