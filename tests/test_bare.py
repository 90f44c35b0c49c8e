"""What is only looked at is left out of what a fit compiles, and nothing else."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from sim2real_rigs import RIGS

from dipc_gym import mjcf
from dipc_gym.mjcf.bare import bare
from dipc_gym.mjcf.edit import Document
from dipc_gym.sim2real.effects import catalogue
from dipc_gym.sim2real.model.parameters import model_parameters
from dipc_gym.sim2real.model.structure import Structure, Term

# Bodies with mass from meshes and from other geoms, one with an inertial of its own, one welded and without a name.
ARM = """<mujoco>
  <compiler angle="radian"/><option timestep="0.002" {option}><flag contact="disable"/></option>
  <asset>
    <mesh name="wedge" vertex="0 0 0  0.1 0 0  0 0.05 0  0 0 0.3  0.1 0.05 0.3"/>
    <texture name="grid" type="2d" builtin="checker" width="64" height="64" rgb1="1 1 1" rgb2="0 0 0"/>
    <material name="grid" texture="grid"/>
  </asset>
  <worldbody>
    <geom type="plane" size="1 1 1" material="grid"/>
    <body name="upper" pos="0 0 1">
      <joint name="shoulder" axis="0 1 0" damping="0.3"/>
      <geom name="skin" type="mesh" mesh="wedge" mass="1.2"/>
      <body pos="0.02 0 0.1"><geom type="box" size="0.02 0.03 0.04" mass="0.3" euler="0.3 0.2 0.1"/></body>
      <body name="fore" pos="0 0 0.3">
        <joint name="elbow" axis="0 1 0" damping="0.1"/>
        <inertial pos="0 0 0.1" mass="0.5" fullinertia="4e-3 5e-3 2e-3 1e-4 2e-4 3e-4"/>
        <geom type="mesh" mesh="wedge" material="grid"/>
        <frame pos="0 0 0.2"><geom type="sphere" size="0.02"/></frame>
      </body>
    </body>
  </worldbody>
  <actuator><motor name="first" joint="shoulder"/><motor name="second" joint="elbow"/></actuator>
  <sensor><jointpos name="angle1" joint="shoulder"/><jointpos name="angle2" joint="elbow"/>{sensor}</sensor>
</mujoco>"""
PLAIN = ARM.format(option="", sensor="")


def moves(model: mujoco.MjModel) -> list[np.ndarray]:
    """Mass matrix, gravity and Coriolis forces, and accelerations at a state."""
    data, full = mujoco.MjData(model), np.zeros((model.nv, model.nv))
    data.qpos[:], data.qvel[:], data.ctrl[:] = (0.4, -0.7), (1.0, -2.0), (0.3, -0.2)
    mujoco.mj_forward(model, data)
    mujoco.mj_fullM(model, data, full)
    return [full, data.qfrc_bias.copy(), data.qacc.copy()]


def test_a_model_moves_as_before_without_its_meshes() -> None:
    model = mjcf.compile(PLAIN)
    light = mjcf.compile(bare(Document(mjcf.from_text(PLAIN)), model).source, trusted=True)
    assert (model.nmesh, model.ntex, light.nmesh, light.ntex, light.ngeom) == (1, 1, 0, 0, 0)
    for whole, part in zip(moves(model), moves(light), strict=True):
        np.testing.assert_allclose(part, whole, rtol=1e-9)


@pytest.mark.parametrize(
    "text",
    [
        ARM.format(option='density="1000"', sensor=""),
        ARM.format(option="", sensor='<framepos name="tip" objtype="geom" objname="skin"/>'),
        RIGS["hanging"],
    ],
    ids=["a medium pushes on geoms", "a sensor asks for one", "nothing takes long"],
)
def test_it_is_left_whole_where_its_looks_matter(text: str) -> None:
    document = Document(mjcf.from_text(text))
    assert bare(document, mjcf.compile(text)) is document


def test_variants_of_a_fit_are_those_that_are_written_back() -> None:
    """Numbers of the model and an effect, in what is simulated and in what the owner gets."""
    document, model = Document(mjcf.from_text(PLAIN)), mjcf.compile(PLAIN)
    structure = Structure(document, model, ("shoulder", "elbow"), tuple(model_parameters(document, model)))
    assert {"upper.mass", "fore.mass", "fore.centre_of_mass"} <= {slot.key for slot in structure.slots}
    values = {"mass": 0.2, "inertia": 1e-4, "x": 0.05, "y": 0.0, "z": 0.2}
    structure = structure.with_term(Term(catalogue()["load.payload"], "elbow", values))
    z = structure.first + 0.1
    simulated, written = structure.physics(z).model, mjcf.compile(structure.write(z).text())
    assert (simulated.nmesh, written.nmesh) == (0, 1)
    for part, whole in zip(moves(simulated), moves(written), strict=True):
        np.testing.assert_allclose(part, whole, rtol=1e-9)
