"""Stops that a model lacks: told from springs, found in motion, and written as the range of a joint."""

from __future__ import annotations

import re

import mujoco
import numpy as np
import pytest
from sim2real_rigs import CART, RK4, TORQUE, record, sweep

from dipc_gym import mjcf, physics
from dipc_gym.engine import Uncovered, constraints, program
from dipc_gym.engine.check import check
from dipc_gym.mjcf.edit import Document
from dipc_gym.recording import Recording
from dipc_gym.sim2real import catalogue, diagnose
from dipc_gym.sim2real.effects.load_stop import Stop, _begins
from dipc_gym.sim2real.simulation.batch import Stepping, simulate
from dipc_gym.sim2real.simulation.windows import cut

RATE, RATIO = 180.0, 0.25


def stopped(text: str, joint: str, **ends: float) -> physics.Physics:
    """A rig with stops at a joint."""
    document = Document(mjcf.from_text(text))
    Stop(tuple(ends)).edit(document, joint, {**ends, "contact_rate": RATE, "contact_damping": RATIO})
    return physics.load(mjcf.from_text(document.text()))


def test_a_stop_gives_back_of_a_blow_what_its_damping_leaves() -> None:
    """A free mass at a spring and damper that only push leaves when they would begin to pull: at the end of the half
    swing where the force is none (cf. Gilardi and Sharf, "Literature survey of contact dynamics modelling", 2002).
    """
    text = re.sub(r"<actuator>.*</actuator>", "", CART.replace('damping="21.4"', ""), flags=re.DOTALL)
    rig = stopped(text, "cart", high=0.1)
    model, data = rig.model, mujoco.MjData(rig.model)
    model.opt.timestep = 2e-6
    data.qvel[0] = 0.4
    highest = 0.0
    while data.qvel[0] > 0 or data.qpos[0] > 0.1:
        mujoco.mj_step(model, data)
        highest = max(highest, float(data.qpos[0]))
    fast = np.sqrt(1 - RATIO**2)
    # Until the force has gone, which is before the spring is as long as it was.
    time = np.arctan2(2 * RATIO * fast, 2 * RATIO**2 - 1) / (RATE * fast)
    back = np.exp(-RATIO * RATE * time) * (np.cos(fast * RATE * time) - RATIO / fast * np.sin(fast * RATE * time))
    assert data.qvel[0] == pytest.approx(0.4 * back, rel=2e-3)
    peak = np.arctan2(fast, RATIO) / (RATE * fast)
    depth = 0.4 / (fast * RATE) * np.exp(-RATIO * RATE * peak) * np.sin(fast * RATE * peak)
    assert highest - 0.1 == pytest.approx(depth, rel=2e-3)


def test_a_stop_in_its_other_form_gives_back_as_much() -> None:
    """MuJoCo's own limits bend a blow's spring by a tenth: their impedance is 0.9 to 0.95."""
    effect = Stop(("high",))
    (form,) = effect.forms()
    assert form.element != effect.element
    assert [p.name for p in form.parameters] == [p.name for p in effect.parameters]
    assert form.id not in catalogue()
    text = re.sub(r"<actuator>.*</actuator>", "", CART.replace('damping="21.4"', ""), flags=re.DOTALL)
    back = []
    for one in (effect, form):
        document = Document(mjcf.from_text(text))
        one.edit(document, "cart", {"high": 0.1, "contact_rate": RATE, "contact_damping": RATIO})
        model = mujoco.MjModel.from_xml_string(document.text())
        model.opt.timestep, data = 1e-5, mujoco.MjData(model)
        data.qvel[0] = 0.4
        while data.qvel[0] > 0 or data.qpos[0] > 0.1:
            mujoco.mj_step(model, data)
        back.append(float(data.qvel[0]))
    assert back[1] == pytest.approx(back[0], rel=0.1)


def limited(text: str, joint: str, end: float, how: str) -> physics.Physics:
    """A rig with a range by MuJoCo's solver, or by springs."""
    if how == "springs":
        return stopped(text, joint, low=-end, high=end)
    document = Document(mjcf.from_text(text))
    document.set(document.joint(joint), limited="true", range=(-end, end))
    rig = physics.load(mjcf.from_text(document.text()))
    if how == "late":
        rig.model.jnt_solref[:] = 0.06, 0.4
        rig.model.jnt_solimp[:, :3] = 0.0, 0.9, end
        rig.model.jnt_margin[:] = 0.1 * end
    return rig


@pytest.mark.parametrize("how", ["springs", "as MuJoCo has them", "late"])
@pytest.mark.parametrize(("text", "joint", "end"), [(CART, "cart", 0.02), (TORQUE, "shoulder", 0.3)])
def test_limits_are_in_compiled_code_as_in_mujoco(text: str, joint: str, end: float, how: str) -> None:
    rig, base = limited(text, joint, end, how), [joint]
    assert constraints.soft_limits(rig.model).tolist() == [0]
    assert not constraints.stiff_limits(rig.model).any()
    code, parameters = program.read([rig])
    assert check(code, parameters[0], rig)
    run = record(rig, sweep(4.0 if joint == "cart" else 0.6), 1.0, integrator=RK4, step=1e-4)
    assert np.ptp(run.sensors) > 2 * end  # it meets them
    windows = cut([run], np.ones(1), 0.25, (0.0, 1.0))
    initial = np.array([[[0.9 * end, 1.0], [-0.9 * end, -1.0], [0.0, 2.0], [0.0, -2.0]]])
    thin = limited(text.replace("<option ", '<option density="1e-12" '), joint, end, how)
    with pytest.raises(Uncovered, match="medium"):
        program.read([thin])
    apart = []
    for step in (1e-4, 2e-5, 4e-6):  # where in a step a joint meets its stop, only ours tells
        ours, theirs = (simulate([one], windows, initial, Stepping(step, RK4), base=base)[0] for one in (rig, thin))
        assert np.abs(ours).max() > end
        apart.append(np.abs(ours - theirs).max() / end)
    if how == "late":  # a force that begins with nothing, so that hardly anything depends on when
        assert max(apart[1:]) < 1e-7
    else:
        assert apart[2] < 0.5 * apart[1] < 0.2 * apart[0]


def test_a_spring_and_a_weight_are_no_stops() -> None:
    """What pushes all along the way is none, nor is noise; what pushes at an end alone is one."""
    rng = np.random.default_rng(1)
    position = np.sin(np.linspace(0, 60, 20_000)) * rng.uniform(0.5, 1.0, 20_000)
    noise = 0.05 * rng.normal(size=len(position))
    for force in (-4.0 * position, np.full(len(position), -2.0), -3.0 * np.sign(position)):
        assert _begins(position, force + noise) is None
        assert _begins(-position, -force + noise) is None
    assert _begins(position, noise) is None
    met = _begins(position, noise - 300.0 * np.maximum(position - 0.95, 0.0))
    assert met == pytest.approx(0.95, abs=0.01)
    assert _begins(position, noise + 300.0 * np.maximum(position - 0.95, 0.0)) is None  # it would pull


@pytest.mark.parametrize("unit", ["radian", "degree"])
def test_the_range_is_written_in_the_unit_of_the_file_and_within_the_one_that_is_there(unit: str) -> None:
    text = TORQUE.replace("radian", unit).replace('type="hinge"', 'type="hinge" limited="true" range="-1 2"')
    low, high = np.array([-1.0, 2.0]) if unit == "radian" else np.deg2rad([-1.0, 2.0])
    for ends, wanted in (
        ({"high": 0.5 * high}, (low, 0.5 * high)),
        ({"low": 0.5 * low}, (0.5 * low, high)),
        ({"low": 3 * low, "high": 3 * high}, (low, high)),
    ):
        assert stopped(text, "shoulder", **ends).model.jnt_range[0] == pytest.approx(wanted)


def test_a_stop_is_found_beside_friction_and_written_for_plain_mujoco() -> None:
    """Where it is, how hard it gives way and how much it gives back; the file predicts what it was not fitted to."""
    held = CART.replace('damping="21.4"', 'damping="21.4" stiffness="60"')  # else it drifts away from its stop
    rough = held.replace("damping=", 'frictionloss="1.2" solreffriction="0.0004 1" damping=')
    true = stopped(rough, "cart", high=0.03)
    runs = [record(true, sweep(s), 10.0, noise=1e-5, step=5e-5, seed=k) for k, s in enumerate((4.0, 5.0, 3.6))]
    names = ("load.stop", "load.spring", "load.position", "friction.coulomb", "disturbance.pulse", "motor.cogging")
    found = diagnose(mjcf.from_text(held), runs[:2], runs[2:], effects=[catalogue()[name] for name in names])
    assert {(one.effect, one.at) for one in found.missing} == {("load.stop", "cart"), ("friction.coulomb", "cart")}
    assert found.verdict == "explained", found.sentence
    stop = next(one for one in found.missing if one.effect == "load.stop")
    assert stop.parameters["high"]["value"] == pytest.approx(0.03, abs=2e-5)
    assert stop.parameters["contact_rate"]["value"] == pytest.approx(RATE, rel=0.05)
    assert stop.parameters["contact_damping"]["value"] == pytest.approx(RATIO, rel=0.05)
    assert "low" not in stop.parameters
    assert "cart runs into a stop at 0.03" in found.sentence
    model = mujoco.MjModel.from_xml_string(found.improved)
    assert model.jnt_limited[0]
    assert model.jnt_range[0, 1] == pytest.approx(0.03, abs=2e-5)
    assert model.jnt_range[0, 0] < -1e3


def test_a_stop_of_a_simulation_is_mujocos_own_limit() -> None:
    """Whoever tries a diagnosis writes `range` into the model that is simulated, with MuJoCo's defaults at its step: a
    spring and a damper leave a seventh of the blow.
    """
    text = CART.replace('timestep="0.001" integrator="implicitfast"', 'timestep="0.002" integrator="Euler"')
    euler = {"step": 2e-3, "integrator": mujoco.mjtIntegrator.mjINT_EULER}

    def runs(model: str) -> list[Recording]:
        rig = physics.load(mjcf.from_text(model))
        return [record(rig, sweep(6.0), 10.0, noise=2e-5, period=0.004, seed=seed, **euler) for seed in (1, 2)]

    free = runs(text)[0].sensors
    ends = [round(0.7 * float(end), 3) for end in (free.min(), free.max())]
    limited = text.replace('damping="21.4"', f'damping="21.4" limited="true" range="{ends[0]} {ends[1]}"')
    found = diagnose(mjcf.from_text(text), runs(limited))
    assert [(one.effect, one.at) for one in found.missing] == [("load.stop", "cart")]
    assert found.held_out is not None
    assert found.held_out.improved < 1.2
    model = mjcf.compile(found.improved)
    assert model.jnt_range[0] == pytest.approx(ends, abs=5e-4)
    assert model.jnt_solref[0] == pytest.approx([0.02, 1.0], rel=0.1)
