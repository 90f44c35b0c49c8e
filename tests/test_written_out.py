"""What a compiler makes up stands in the text before any of it is edited."""

from __future__ import annotations

import re

import mujoco
import numpy as np
import pytest
from sim2real_rigs import RK4, record

from dipc_gym import mjcf, physics
from dipc_gym.mjcf.edit import Document, written_out
from dipc_gym.recording import Recording
from dipc_gym.sim2real import diagnose
from dipc_gym.sim2real.model.parameters import in_full, model_parameters

ARM = """
<mujoco>
  <compiler angle="radian"{compiler}/>
  <option timestep="0.002" integrator="RK4"/>
  <worldbody>
    <body{name} pos="0 0 1">
      {inertial}
      <joint name="shoulder" axis="0 1 0" damping="0.2"{joint}/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.4" size="0.02" mass="0.6" contype="0" conaffinity="0"/>
    </body>
  </worldbody>
  <actuator><motor name="m" joint="shoulder"/></actuator>
  <sensor><jointpos name="angle" joint="shoulder"/></sensor>
</mujoco>
"""
PLAIN = {"compiler": "", "name": "", "inertial": "", "joint": ""}
STALE = '<inertial pos="0 0 0" mass="1" diaginertia="0.01 0.01 0.01"/>'
FRAMED = (
    '<frame pos="0.1 0 0" euler="0.3 0.2 0">'
    '<inertial pos="0 0.02 -0.2" mass="0.7" diaginertia="0.01 0.008 0.003"/></frame>'
)
MADE_UP = {
    "no name": PLAIN,
    "springdamper": {**PLAIN, "joint": ' springdamper="0.3 0.4"'},
    "inertia from geoms": {**PLAIN, "compiler": ' inertiafromgeom="true"', "inertial": STALE},
    "an inertial in a frame": {**PLAIN, "inertial": FRAMED},
}


def arm(kind: str, **changes: str) -> mjcf.Source:
    return mjcf.from_text(ARM.format(**{**MADE_UP[kind], **changes}))


@pytest.mark.parametrize("kind", MADE_UP)
def test_the_model_stays_the_same(kind: str) -> None:
    source = arm(kind)
    model = mjcf.compile(source)
    said = written_out(source, model)
    again = mjcf.compile(said)
    data = [mujoco.MjData(one) for one in (model, again)]
    rng = np.random.default_rng(0)
    for _ in range(5):
        q, v, u = rng.normal(size=3)
        for one, state in zip((model, again), data, strict=True):
            state.qpos[:], state.qvel[:], state.ctrl[:] = q, v, u
            mujoco.mj_forward(one, state)
        np.testing.assert_allclose(data[1].qacc, data[0].qacc, rtol=1e-9)
    assert written_out(said, again) is said  # nothing more is to be said


@pytest.mark.parametrize("kind", MADE_UP)
@pytest.mark.parametrize("attribute", ["mass", "centre_of_mass", "damping", "stiffness"])
def test_a_parameter_that_is_written_is_the_models(kind: str, attribute: str) -> None:
    """Written, it did nothing: the compiler passed over it, or there was no name to write it by."""
    source, given = in_full(arm(kind), physics.load(arm(kind)))
    document = Document(source)
    found = {one.attribute: one for one in model_parameters(document, given.model)}
    if attribute == "stiffness" and kind != "springdamper":
        assert attribute not in found
        return
    found[attribute].write(document, 1.1 * found[attribute].value)
    changed = {one.attribute: one.value for one in model_parameters(document, mjcf.compile(document.text()))}
    for other, parameter in found.items():
        assert changed[other] == pytest.approx(parameter.value * (1.1 if other == attribute else 1.0), rel=1e-6)


def test_a_body_is_called_by_its_joint() -> None:
    source = arm("no name")
    assert mjcf.compile(written_out(source, mjcf.compile(source))).body(1).name == "shoulder"
    other = arm("no name", name=' name="arm"')
    assert written_out(other, mjcf.compile(other)) is other


def runs(source: mjcf.Source) -> list[Recording]:
    rig = physics.load(source)
    return [
        record(rig, lambda t, k=k: float(1.5 * np.sin(3 * t + k)), 10.0, noise=2e-4, integrator=RK4, seed=k)
        for k in (1, 2)
    ]


def test_a_wrong_mass_of_a_body_without_a_name_is_found() -> None:
    """Its joint's damping, its motor and springs that are not there stood in for it."""
    true = arm("no name").text.replace('mass="0.6"', 'mass="0.5"')
    found = diagnose(arm("no name"), runs(mjcf.from_text(true)))
    assert (found.verdict, found.missing) == ("recalibrated", ())
    assert "mass of shoulder" in found.sentence


def test_a_wrong_spring_that_is_given_by_its_time_constant_is_found() -> None:
    kind = "springdamper"
    stiffness = float(mjcf.compile(arm(kind)).jnt_stiffness[0])
    damping = float(mjcf.compile(arm(kind)).dof_damping[0])
    plain = arm("no name", joint=f' stiffness="{0.8 * stiffness}"').text
    true = plain.replace('damping="0.2"', f'damping="{damping}"')
    found = diagnose(arm(kind), runs(mjcf.from_text(true)))
    assert (found.verdict, found.missing) == ("recalibrated", ())
    stiffnesses = re.findall(r'stiffness="([0-9.]+)"', found.improved)
    assert [float(one) for one in stiffnesses] == pytest.approx([0.8 * stiffness], rel=0.02)


@pytest.mark.parametrize(
    ("servo", "changed", "gains"),
    [
        (
            '<general name="m" joint="shoulder" gainprm="20" biastype="affine" biasprm="0 -20 -1"/>',
            {"kp": 16.0, "kv": 1.5},
            (16.0, [0.0, -16.0, -1.5]),
        ),
        ('<velocity name="m" joint="shoulder" kv="1.5"/>', {"kv": 1.2}, (1.2, [0.0, 0.0, -1.2])),
        (
            '<general name="m" joint="shoulder" gainprm="1.5" biastype="affine" biasprm="0 0 -1.5"/>',
            {"kv": 1.2},
            (1.2, [0.0, 0.0, -1.2]),
        ),
    ],
)
def test_gains_of_servos_are_parameters_whatever_their_element(
    servo: str, changed: dict[str, float], gains: tuple[float, list[float]]
) -> None:
    source = mjcf.from_text(re.sub("<motor[^>]*>", servo, arm("no name", name=' name="arm"').text))
    document = Document(source)
    found = {one.attribute: one for one in model_parameters(document, mjcf.compile(source)) if one.at == "m"}
    assert set(found) == set(changed)
    for attribute, value in changed.items():
        found[attribute].write(document, value)
    model = mjcf.compile(document.text())
    assert model.actuator_gainprm[0, 0] == pytest.approx(gains[0])
    assert model.actuator_biasprm[0, :3].tolist() == pytest.approx(gains[1])
