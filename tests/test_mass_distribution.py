"""A wrong mass distribution is a wrong parameter, and no tilt and no force of position."""

from __future__ import annotations

import numpy as np
import pytest
from sim2real_rigs import record

from dipc_gym import mjcf, physics
from dipc_gym.mjcf.edit import Document
from dipc_gym.sim2real import diagnose
from dipc_gym.sim2real.model.parameters import model_parameters

PENDULUM = """<mujoco>
  <option timestep="0.001" integrator="implicitfast"/>
  <worldbody>
    <body name="rod">
      <joint name="swing" type="hinge" axis="1 0 0" damping="0.01"/>
      <geom name="rod" type="capsule" fromto="0 0 0 0 0 -0.3" size="0.008" mass="0.12" contype="0" conaffinity="0"/>
      <geom name="bob" type="sphere" pos="0 0 -0.3" size="0.03" mass="0.3" contype="0" conaffinity="0"/>
    </body>
  </worldbody>
  <actuator><motor name="torque" joint="swing" gear="1"/></actuator>
  <sensor><jointpos name="encoder" joint="swing"/></sensor>
</mujoco>"""
WRONG = {
    "a lighter bob": ('mass="0.3"', 'mass="0.27"'),
    "a bob two thirds as heavy": ('mass="0.3"', 'mass="0.2"'),
    "a bob 1 cm lower": ('pos="0 0 -0.3"', 'pos="0 0 -0.31"'),
}


def command(phase: float):  # type: ignore[no-untyped-def]
    """It swings widely, and over the top now and then."""

    def at(time: float) -> float:
        return float(1.1 * np.sin(2 * np.pi * 0.9 * time + phase) + 0.5 * np.sin(2 * np.pi * 0.37 * time))

    return at


@pytest.mark.parametrize("what", WRONG)
def test_what_a_cad_file_has_wrong_is_recalibrated(what: str) -> None:
    rig = physics.from_model(mjcf.compile(PENDULUM))
    runs = [record(rig, command(phase), 12.0, noise=(1e-3,), step=1e-4) for phase in (0.0, 2.0)]
    found = diagnose(mjcf.from_text(PENDULUM.replace(*WRONG[what])), runs[:1], runs[1:])
    assert found.verdict == "recalibrated", found.sentence
    assert found.missing == ()
    assert found.held_out is not None
    assert found.held_out.nominal > 2
    assert found.held_out.improved < 1.1
    improved = mjcf.compile(found.improved)
    assert "centre of mass of rod" in found.sentence
    truth = mjcf.compile(PENDULUM)
    weight, other = (float(m.body_mass[1] * np.linalg.norm(m.body_ipos[1])) for m in (improved, truth))
    gears = float(improved.actuator_gear[0, 0] / truth.actuator_gear[0, 0])
    assert weight / gears == pytest.approx(other, rel=0.01)


def test_a_centre_of_mass_is_moved_along_its_arm_and_nothing_else() -> None:
    document, model = Document(mjcf.from_text(PENDULUM)), mjcf.compile(PENDULUM)
    (parameter,) = (one for one in model_parameters(document, model) if one.attribute == "centre_of_mass")
    assert parameter.key == "rod.centre_of_mass"
    assert parameter.value == pytest.approx(np.linalg.norm(model.body_ipos[1]))
    edited = document.copy()
    parameter.write(edited, 1.1 * parameter.value)
    moved = mjcf.compile(edited.text())
    np.testing.assert_allclose(moved.body_ipos[1], 1.1 * model.body_ipos[1], atol=1e-9)
    np.testing.assert_allclose(moved.body_inertia[1], model.body_inertia[1], rtol=1e-6)
    np.testing.assert_allclose(moved.body_mass, model.body_mass, rtol=1e-9)


def test_what_is_balanced_or_slides_has_no_arm() -> None:
    balanced = PENDULUM.replace('pos="0 0 -0.3"', 'pos="0 0 0"').replace(
        'fromto="0 0 0 0 0 -0.3"', 'fromto="0 0 .1 0 0 -.1"'
    )
    sliding = PENDULUM.replace('type="hinge"', 'type="slide"')
    for text in (balanced, sliding):
        found = model_parameters(Document(mjcf.from_text(text)), mjcf.compile(text))
        assert not [one.key for one in found if one.attribute == "centre_of_mass"]
