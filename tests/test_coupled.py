"""Joints that an equality constraint holds in proportion to others: mirrored fingers, gears."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from sim2real_rigs import RK4, prepared, record, sweep

from dipc_gym import mjcf, physics
from dipc_gym.mjcf.edit import Document
from dipc_gym.recording import Recording, write
from dipc_gym.sim2real import catalogue, diagnose
from dipc_gym.sim2real.estimation.fit import fit
from dipc_gym.sim2real.estimation.unexplained import Scene
from dipc_gym.sim2real.model.structure import Term
from dipc_gym.sim2real.replay import replay
from dipc_gym.sim2real.simulation.batch import Stepping, simulate
from dipc_gym.sim2real.simulation.compiled import left_to_mujoco
from dipc_gym.sim2real.simulation.windows import cut

GRIPPER = """
<mujoco model="gripper">
  <option timestep="0.001" integrator="implicitfast"/>
  <worldbody>
    <body name="left">
      <joint name="left" type="slide" axis="1 0 0" damping="2"/>
      <inertial pos="0 0 0" mass="0.2" diaginertia="1e-4 1e-4 1e-4"/>
    </body>
    <body name="right">
      <joint name="right" type="slide" axis="1 0 0" damping="2"/>
      <inertial pos="0 0 0" mass="0.3" diaginertia="1e-4 1e-4 1e-4"/>
    </body>
  </worldbody>
  <equality>
    <joint joint1="right" joint2="left" polycoef="0 {ratio} 0 0 0" solref="0.002 1" solimp="0.9999 0.9999 0.001"/>
  </equality>
  <actuator>{motors}</actuator>
  <sensor>{sensors}</sensor>
</mujoco>
"""
LEFT, RIGHT = (f'<motor name="{side}_drive" joint="{side}" gear="4"/>' for side in ("left", "right"))
THIN = 'density="1e-12"'
SENSOR = '<jointpos name="{0}" joint="{0}"/>'


def gripper(motors: str = LEFT, sensors: str = SENSOR.format("left"), ratio: float = -0.5) -> str:
    """A driven finger, and one that mirrors half of its way."""
    return GRIPPER.format(motors=motors, sensors=sensors, ratio=ratio)


@pytest.mark.parametrize(
    ("motors", "ties"),
    [
        (LEFT, {"right": ("left", -0.5)}),
        (RIGHT, {"left": ("right", -2.0)}),
        ("", {"right": ("left", -0.5)}),
        (LEFT + RIGHT, {}),
    ],
    ids=["left", "right", "none", "both"],
)
def test_of_two_joints_the_driven_one_leads(motors: str, ties: dict[str, tuple[str, float]]) -> None:
    model = mjcf.compile(gripper(motors))
    assert mjcf.coupled(model) == ties
    base = mjcf.base_joints(model)
    assert set(base) == {"left", "right"} - ties.keys()
    out = mjcf.spread_out(model)
    assert out.shape == (2, len(base))
    for led, (leader, ratio) in ties.items():
        moved = out @ np.ones(1)
        assert moved[model.joint(led).id] == ratio * moved[model.joint(leader).id]


@pytest.mark.parametrize("text", ['polycoef="0.1 1 0 0 0"', 'polycoef="0 1 0.5 0 0"', 'active="false"'])
def test_what_is_no_plain_proportion_ties_nothing(text: str) -> None:
    plain = 'polycoef="0 -0.5 0 0 0"'
    model = mjcf.compile(gripper().replace(plain, text if text.startswith("poly") else f"{plain} {text}"))
    assert mjcf.coupled(model) == {}
    assert mjcf.base_joints(model) == ("left", "right")


@pytest.mark.parametrize("effect", ["transmission.backlash", "transmission.compliance"])
def test_a_rotor_drives_for_the_joint_that_it_turns(effect: str) -> None:
    """An effect that gives the motor a rotor of its own makes no other joint the leading one."""
    source = mjcf.from_text(gripper(RIGHT, SENSOR.format("right")))
    given, run = physics.load(source), record(physics.load(source), sweep(2.0), 2.0, noise=2e-5)
    cut = prepared(source.text, [run], stepping=Stepping(5e-4, RK4))
    values = {parameter.name: max(parameter.low, 1e-3) for parameter in catalogue()[effect].parameters}
    values |= {name: value for name, value in (("stiffness", 1e5), ("rotor_inertia", 0.05)) if name in values}
    with_it = cut.structure.with_term(Term(catalogue()[effect], "right_drive", values))
    model = with_it.physics(with_it.first).model
    assert mjcf.base_joints(model) == mjcf.base_joints(given.model) == ("right",)
    assert mjcf.coupled(model) == {"left": ("right", -2.0)}
    moved = mjcf.spread_out(model)[:, 0]
    at = [model.joint(name).id for name in ("left", "right", *mjcf.followers(model))]
    assert moved[at].tolist() == [-2.0, *[1.0] * (len(at) - 1)]


THREE = """
<mujoco><option>{flag}</option><worldbody>{bodies}</worldbody><equality>{ties}</equality></mujoco>
"""
BODY = '<body><joint name="{0}" type="slide"/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body>'
TIE = '<joint joint1="{0}" joint2="{1}" polycoef="0 {2} 0 0 0"/>'


@pytest.mark.parametrize(
    ("ties", "found"),
    [
        ([("b", "a", 2), ("c", "a", -3)], {"b": ("a", 2.0), "c": ("a", -3.0)}),
        ([("b", "a", 2), ("c", "b", 3)], {"b": ("a", 2.0), "c": ("a", 6.0)}),
        ([("c", "b", 3), ("b", "a", 2)], {"b": ("a", 2.0), "c": ("a", 6.0)}),
        ([("b", "a", 2), ("a", "b", 0.5)], {"b": ("a", 2.0)}),
    ],
    ids=["two led", "chain", "chain backwards", "twice"],
)
def test_one_joint_may_lead_several(ties: list[tuple[str, str, float]], found: dict[str, tuple[str, float]]) -> None:
    bodies, held = "".join(map(BODY.format, "abc")), "".join(TIE.format(*tie) for tie in ties)
    model = mjcf.compile(THREE.format(flag="", bodies=bodies, ties=held))
    assert mjcf.coupled(model) == found
    q = mjcf.spread_out(model) @ np.ones(len(mjcf.base_joints(model)))
    for led, (leader, ratio) in found.items():
        assert q[model.joint(led).id] == ratio * q[model.joint(leader).id]
    loose = THREE.format(flag='<flag equality="disable"/>', bodies=bodies, ties=held)
    assert mjcf.coupled(mjcf.compile(loose)) == {}


def test_what_is_coupled_to_a_follower_is_coupled_to_its_leader() -> None:
    text = THREE.format(flag="", bodies="".join(map(BODY.format, "abc")), ties=TIE.format("c", "b", 3))
    follows = '<custom><text name="dipc_gym:follows:b" data="a"/></custom>'
    model = mjcf.compile(text.replace("</mujoco>", f"{follows}</mujoco>"))
    assert mjcf.followers(model) == {"b": "a"}
    assert mjcf.coupled(model) == {"c": ("a", 3.0)}
    assert mjcf.spread_out(model)[:, 0].tolist() == [1.0, 1.0, 3.0]


@pytest.mark.parametrize("seen", ["left", "right"])
def test_one_sensor_tells_where_both_fingers_are(seen: str) -> None:
    text = gripper(sensors=SENSOR.format(seen))
    rig = physics.load(mjcf.from_text(text))
    run = record(rig, sweep(2.0), 4.0, noise=2e-5, step=5e-4, integrator=RK4)
    cut = prepared(text, [run], stepping=Stepping(5e-4, RK4))
    found = fit(cut.problem, cut.structure)
    assert found.error < 1.2
    # MuJoCo's constraint gives way a little, which its own readings show; the motion is a thousand times as large.
    moved = cut.motions[0].position[:, 0] * (1.0 if seen == "left" else -0.5)
    assert np.abs(moved - run.sensors[:, 0]).max() < 1e-3 * np.ptp(run.sensors[:, 0])


def test_a_gripper_is_in_compiled_code_as_in_mujoco() -> None:
    """Behind a medium too thin to matter, MuJoCo simulates it; windows begin with both fingers where they belong."""
    text = gripper()
    ours, theirs = (physics.load(mjcf.from_text(text.replace("<option ", f"<option {way} "))) for way in ("", THIN))
    assert left_to_mujoco(ours) == []
    assert "medium" in left_to_mujoco(theirs)[0]
    windows = cut([record(ours, sweep(1.0), 1.0)], np.ones(1), 0.25, (0.0, 1.0))
    initial = np.random.default_rng(0).normal(scale=0.1, size=(1, len(windows), 2))
    for warm, approach in ((0.0, None), (0.1, np.repeat(initial, 2, axis=0))):
        both = [
            simulate([one], windows, initial, Stepping(2e-4, RK4), base=["left"], warm=warm, approach=approach)
            for one in (ours, theirs)
        ]
        assert np.ptp(both[0]) > 0.01
        assert both[0] == pytest.approx(both[1], abs=1e-9)


def test_a_stiff_tie_is_simulated_in_steps_that_bear_it() -> None:
    """Its file's step does; two milliseconds would make more of what is left each time."""
    text = gripper().replace('timestep="0.001"', 'timestep="0.0002"').replace('solref="0.002 1"', 'solref="0.0004 1"')
    run = record(physics.load(mjcf.from_text(text)), sweep(2.0), 4.0, noise=2e-5, step=1e-4, integrator=RK4)
    cut = prepared(text, [run], stepping=Stepping(0.002, RK4))
    assert left_to_mujoco(physics.load(mjcf.from_text(text))) == []
    assert 4e-4 < cut.structure.own_finest < 1e-3
    assert fit(cut.problem, cut.structure).error < 1.1


def test_wrong_numbers_of_a_gripper_with_one_encoder_are_refitted() -> None:
    true = gripper().replace('axis="1 0 0" damping="2"', 'axis="1 0 0" damping="5"')
    run = record(physics.load(mjcf.from_text(true)), sweep(2.0), 4.0, noise=2e-5, step=5e-4, integrator=RK4)
    said = diagnose(mjcf.from_text(gripper()), [run], effects=[])
    assert said.verdict == "recalibrated"
    assert said.held_out.improved < 1.5 < 100 < said.held_out.nominal


@pytest.mark.parametrize("at", ["left", "right"])
@pytest.mark.parametrize("numbers", [(), (60.0, 0.05, 0.0, 0.01, 0.04, 0.15)], ids=["a load", "an entry"])
def test_what_remembers_acts_on_a_joint_that_is_led_as_on_one_that_leads(
    at: str, numbers: tuple[float, ...], tmp_path: Path
) -> None:
    """What it remembers follows the way that joint goes, which is the leader's times their ratio."""
    document = Document(mjcf.from_text(gripper()))
    if numbers:
        document.remembering("load.creeping", at, numbers)
    else:
        catalogue()["load.creeping"].edit(document, at, {"stiffness": 60.0, "relaxation_time": 0.3})
    creeps = physics.load(mjcf.from_text(document.text()))
    run = record(creeps, sweep(2.0), 3.0, noise=2e-5, step=5e-4, integrator=RK4)
    (tmp_path / "gripper.xml").write_text(document.text())
    seen = replay(tmp_path / "gripper.xml", write(run, tmp_path / "run.csv"), step=5e-4)
    assert seen.error < 1.5


def test_evidence_of_a_finger_that_follows_is_that_of_the_one_that_leads_it() -> None:
    """Another joint with the larger mismatch is none of its business."""
    beside = (
        '<body><joint name="far" type="slide" axis="0 1 0"/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body>'
    )
    sensors = "".join(SENSOR.format(name) for name in ("left", "right", "far"))
    text = gripper(sensors=sensors).replace("</worldbody>", f"{beside}</worldbody>")
    model, n = mjcf.compile(text), 50
    rng = np.random.default_rng(0)
    motion, force = rng.normal(size=(n, 2)), rng.normal(size=(n, 2)) * [1.0, 1e3]
    names = ["left", "right", "far"]
    run = Recording("run", 0.001 * np.arange(n), np.zeros((n, 1)), np.zeros((n, 3)), ["left_drive"], names)
    seen = Scene(model, (run,), run.time, motion, 2 * motion, force, force, 0 * force, np.ones(2))
    leads, follows = seen.at("sensor", "left", {}), seen.at("sensor", "right", {})
    assert follows.position == pytest.approx(-0.5 * leads.position)
    assert follows.force == pytest.approx(-2 * leads.force)
    assert follows.inertia == pytest.approx(4 * leads.inertia)


@pytest.mark.parametrize("step", [0.002, 0.0005])
def test_windows_begin_with_a_soft_tie_as_far_apart_as_it_has_given_way(step: float) -> None:
    """MuJoCo's own ties give way by more than encoders are wrong by; the model that made the motion predicts it."""
    soft = gripper().replace(' solref="0.002 1" solimp="0.9999 0.9999 0.001"', "")
    run = record(physics.load(mjcf.from_text(soft)), sweep(2.0), 4.0, noise=5e-6, step=step, integrator=RK4)
    cut = prepared(soft, [run], stepping=Stepping(step, RK4))
    assert cut.structure.warm > 0.1  # some time constants of 20 ms and more
    assert fit(cut.problem, cut.structure, most=0).error < 1.2


def test_windows_that_begin_with_a_recording_remember_nothing_of_what_was_run_in_before_them() -> None:
    """In both simulators; what springs gave way by while nothing was recorded is nobody's knowledge."""
    document = Document(mjcf.from_text(gripper()))
    document.remembering("load.creeping", "left", (60.0, 0.05, 0.0, 0.01, 0.04, 0.15))
    ours, theirs = (
        physics.load(mjcf.from_text(document.text().replace("<option ", f"<option {way} "))) for way in ("", THIN)
    )
    run = record(ours, sweep(2.0), 1.0, noise=2e-5, step=5e-4, integrator=RK4)
    ready = prepared(document.text(), [run], stepping=Stepping(5e-4, RK4))
    windows = ready.problem.windows
    states = np.stack([windows.begun(before) for before in (0.2, 0.0)])
    for rig in (ours, theirs):
        predicted = simulate(
            [rig], windows, states[1:], Stepping(5e-4, RK4), base=["left"], warm=0.2, approach=states[:1]
        )
        first = np.abs(predicted[0, 0, :, 0] - windows.observed[0, :, 0])
        assert first.max() < 2e-4  # else what a fifth of a second of motion bends
