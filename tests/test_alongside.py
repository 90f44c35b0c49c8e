"""Parts that a hidden joint is added for: what they weigh, where they begin, and what a drive does to them."""

import mujoco
import numpy as np
import pytest

from dipc_gym import mjcf
from dipc_gym.mjcf.edit import Document
from dipc_gym.sim2real.effects import catalogue
from dipc_gym.sim2real.effects.shared.coupling import base_inertia
from dipc_gym.sim2real.effects.shared.drives import drive_of
from dipc_gym.sim2real.model.structure import Structure, Term
from dipc_gym.sim2real.verdict.improve import _at_rest

ARM = """<mujoco><compiler angle="radian"/><option timestep="0.001"/><worldbody>
  <body name="upper"><joint name="a" type="{kind}" axis="{first}"/>
    <geom type="capsule" fromto="0 0 0 .3 0 0" size=".03" mass="1"/>
    <body name="lower" pos=".3 0 0"><joint name="b" type="{kind}" axis="{second}" {more}/>
      <geom type="capsule" fromto="0 0 0 .2 0 0" size=".02" mass="2"/>
      <body name="hand" pos=".2 0 0"><joint name="c" axis="0 1 0"/>
        <geom type="sphere" size=".02" mass=".3"/></body></body></body></worldbody>
  <actuator><motor name="m" joint="b" {drive}/></actuator>
  <sensor><jointpos name="a" joint="a"/><jointpos name="b" joint="b"/><jointpos name="c" joint="c"/></sensor>
  {keys}</mujoco>"""


def arm(*, slides: bool = False, more: str = "", drive: str = "", keys: str = "") -> Document:
    kind, first, second = ("slide", "1 0 0", "0 1 0") if slides else ("hinge", "0 1 0", "0 1 0")
    text = ARM.format(kind=kind, first=first, second=second, more=more, drive=drive, keys=keys)
    return Document(mjcf.from_text(text))


def with_effect(document: Document, effect: str, at: str, **given: float) -> mujoco.MjModel:
    one = catalogue()[effect]
    values = {p.name: max(p.low, 0.003) if np.isfinite(p.low) else 0.003 for p in one.parameters} | given
    one.edit(document, at, values)
    return mjcf.compile(document.text())


@pytest.mark.parametrize("slides", [False, True])
@pytest.mark.parametrize(("effect", "at"), [("transmission.compliance", "m"), ("load.swinging", "b")])
def test_what_carries_a_joint_carries_no_more_for_a_part_beside_it(slides: bool, effect: str, at: str) -> None:
    document = arm(slides=slides)
    before = base_inertia(mjcf.compile(document.text()))
    after = base_inertia(with_effect(document, effect, at))
    assert after == pytest.approx(before, abs=1e-7)


@pytest.mark.parametrize(("effect", "at"), [("transmission.compliance", "m"), ("load.swinging", "b")])
def test_inertia_of_a_joint_and_a_part_taken_from_it_add_up_in_either_order(effect: str, at: str) -> None:
    one_way, other_way = arm(), arm()
    with_effect(one_way, effect, at)
    first = with_effect(one_way, "load.inertia", "b", inertia=0.05)
    with_effect(other_way, "load.inertia", "b", inertia=0.05)
    second = with_effect(other_way, effect, at)
    alone = with_effect(arm(), effect, at)
    armature = [model.dof_armature[model.joint("b").dofadr[0]] for model in (first, second, alone)]
    assert armature[:2] == pytest.approx([armature[2] + 0.05] * 2)


@pytest.mark.parametrize("behind", [False, True])
def test_a_part_begins_where_its_joint_does_also_in_keyframes(behind: bool) -> None:
    keys = '<keyframe><key name="k" qpos="1 2 3" qvel="4 5 6"/></keyframe>'
    document = arm(more='ref="3.14"', keys=keys)
    if behind:  # a joint may stand in the text behind what its body carries
        body, joint = document.body("lower"), document.joint("b")
        body.remove(joint)
        body.append(joint)
    model = with_effect(document, "transmission.compliance", "m")
    names = [model.joint(k).name for k in range(model.njnt)]
    there = {"a": 0, "b": 1, "c": 2, "m_rotor": 1}
    assert set(names) == set(there)
    assert model.key("k").qpos.tolist() == [[1, 2, 3][there[name]] for name in names]
    assert model.key("k").qvel.tolist() == [[4, 5, 6][there[name]] for name in names]
    assert model.joint("m_rotor").qpos0 == model.joint("b").qpos0 == 3.14


def test_a_part_of_a_joint_in_a_frame_moves_beside_its_body() -> None:
    document = arm()
    body, joint = document.body("lower"), document.joint("b")
    body.remove(joint)
    frame = document.add(body, "frame", pos="0 0 .1", euler="0 0 1.5")
    frame.append(joint)
    given = mjcf.compile(document.text())
    model = with_effect(document, "transmission.compliance", "m")
    part = model.joint("m_rotor")
    assert model.body_parentid[part.bodyid[0]] == model.body("upper").id
    for one in (given, model):
        data = mujoco.MjData(one)
        mujoco.mj_forward(one, data)
        axis = data.xaxis[one.joint("b").id]
        if one is model:
            assert data.xaxis[part.id] == pytest.approx(axis)
            assert data.xanchor[part.id] == pytest.approx(data.xanchor[one.joint("b").id])


@pytest.mark.parametrize("drive", ["", 'ctrlrange="-.5 .5" ctrllimited="true"', 'forcerange="-.3 .3"', 'delay="0.01"'])
def test_what_a_unit_of_command_does_is_told_beyond_limits_and_delays(drive: str) -> None:
    buffer = 'nsample="20"' if "delay" in drive else ""
    model = mjcf.compile(arm(drive=f'gear="2" {drive} {buffer}').text())
    before = mjcf.compile(arm(drive=f'gear="2" {drive} {buffer}').text())
    assert drive_of(model, "m") == pytest.approx((2.0, 0.0))
    assert model.opt.disableflags == before.opt.disableflags
    assert model.actuator_forcelimited.tolist() == before.actuator_forcelimited.tolist()


@pytest.mark.parametrize(("given", "limit", "is_"), [("0 5", 2, (0, 2)), ("-1 5", 2, (-1, 2)), ("-9 9", 2, (-2, 2))])
def test_a_drive_saturates_within_its_range(given: str, limit: float, is_: tuple[float, float]) -> None:
    document = arm(drive=f'ctrllimited="true" ctrlrange="{given}"')
    assert with_effect(document, "motor.saturation", "m", limit=limit).actuator_ctrlrange[0] == pytest.approx(is_)


def test_a_supply_weakens_the_motor_whichever_was_found_first() -> None:
    document, effects = arm(), catalogue()
    sag = {"drop": 0.3, "time_constant": 1.0, "current": 1.0, "gain": 1.0, "back": 0.0}
    coupling = {p.name: 0.003 for p in effects["transmission.compliance"].parameters}
    terms = [Term(effects["motor.sag"], "m", sag), Term(effects["transmission.compliance"], "m", coupling)]
    for both in (terms, terms[::-1]):
        structure = Structure(document, mjcf.compile(document.text()), ("a", "b", "c"), (), tuple(both))
        said = structure.physics(structure.first)
        assert [said.model.joint(e.index).name for e in said.extras if e.effect == "motor.sag"] == ["m_rotor"]


@pytest.mark.parametrize("kind", ["motor", "dcmotor"])
@pytest.mark.parametrize(("effect", "at"), [("load.constant", "b"), ("transmission.compliance", "m")])
def test_the_limit_of_a_joint_is_its_drives_and_no_other_forces(kind: str, effect: str, at: str) -> None:
    low = -1 if kind == "motor" else -3  # a DC motor's torque has one limit for both ways
    document = arm(more=f'actuatorfrcrange="{low} 3"', drive='gear="2"')
    if kind == "dcmotor":
        motor = document.actuator("m")
        motor.tag = "dcmotor"
        document.set(motor, resistance=1, motorconst=1)
    forces = []
    for edited in (False, True):
        model = with_effect(document, effect, at, force=0.5) if edited else mjcf.compile(document.text())
        data = mujoco.MjData(model)
        pushed = [k for k in range(model.nv) if model.joint(int(model.dof_jntid[k])).name in ("b", "m_rotor")]
        for command in (-50.0, -0.1, 0.1, 50.0):
            data.ctrl[0] = command
            mujoco.mj_forward(model, data)
            forces.append(float(data.qfrc_actuator[pushed].sum()))
    given, after = np.array(forces[:4]), np.array(forces[4:])
    assert given == pytest.approx([low, -0.2, 0.2, 3])
    assert after == pytest.approx(given + (0.5 if effect == "load.constant" else 0.0))


def test_a_lag_shorter_than_the_step_is_stable() -> None:
    model = with_effect(arm(), "motor.inductance", "m", time_constant=2e-4)
    data = mujoco.MjData(model)
    data.ctrl[0] = 1e-3
    for _ in range(100):
        mujoco.mj_step(model, data)
    assert data.act[0] == pytest.approx(1e-3, rel=1e-6)


def test_what_makes_friction_hold_is_said_where_it_was_set() -> None:
    given, improved = arm(), arm()
    with_effect(improved, "transmission.compliance", "m")
    assert _at_rest(given, improved) == []
    with_effect(improved, "friction.coulomb", "b", level=0.3)
    assert _at_rest(given, improved)[0].startswith("noslip_iterations and solreffriction both make")
