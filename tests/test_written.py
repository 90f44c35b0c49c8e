"""What is written back, judged as its owner will run it: by MuJoCo, with the file's own integrator at its own step."""

from __future__ import annotations

import copy
import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import mujoco
import numpy as np
import pytest
import sim2real_rigs
from hypothesis import given
from hypothesis import strategies as st
from sim2real_rigs import CART, TORQUE

from dipc_gym import mjcf, physics, recording
from dipc_gym.mjcf.edit import Document
from dipc_gym.recording import Recording
from dipc_gym.sim2real.diagnosis import diagnose
from dipc_gym.sim2real.effects import Effect, catalogue
from dipc_gym.sim2real.effects.friction_speed import FrictionOfSpeed
from dipc_gym.sim2real.effects.load_position_law import ForceOfPosition
from dipc_gym.sim2real.estimation.fit import Fit, fit
from dipc_gym.sim2real.model.parameters import model_parameters
from dipc_gym.sim2real.model.structure import Structure, Term
from dipc_gym.sim2real.replay import replay
from dipc_gym.sim2real.result import AsWritten, Diagnosis, Errors
from dipc_gym.sim2real.selection.settings import SCORE, SEARCH
from dipc_gym.sim2real.verdict.improve import _differing
from dipc_gym.sim2real.verdict.sentences import initial_states, made_up, step_costs
from dipc_gym.sim2real.verdict.settings import VERDICT
from dipc_gym.sim2real.verdict.written import Option, Predictor, _allowed, _to_the_end, _with_one_less, choose

FURUTA = """<mujoco model="furuta">
  <compiler angle="radian"/>
  <option timestep="0.002" integrator="implicitfast"/>
  <worldbody>
    <body name="arm">
      <inertial pos="0.1 0 0" mass="0.25" diaginertia="1e-4 9e-4 9e-4"/>
      <joint name="arm" axis="0 0 1" damping="0.002"/>
      <body name="pendulum" pos="0.2 0 0">
        <inertial pos="0 0 -0.12" mass="0.12" diaginertia="6e-4 6e-4 1e-5"/>
        <joint name="pendulum" axis="1 0 0" damping="2e-4"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor name="motor" joint="arm" gear="0.05"/></actuator>
  <sensor><jointpos name="arm" joint="arm"/><jointpos name="pendulum" joint="pendulum"/></sensor>
</mujoco>"""
RAIL = CART.replace('timestep="0.001"', 'timestep="0.002"')
LEVEL = 0.02  # N m of dry friction at the arm


def simulated(text: str, joint: str, level: float, strength: float, noise: float, seed: int) -> Recording:
    """Twenty seconds of a rig with dry friction in one joint, by MuJoCo in steps twenty times as fine as its file's."""
    model = copy.copy(mjcf.compile(mjcf.from_text(text)))
    model.opt.timestep /= 20
    model.opt.noslip_iterations = 3
    dof = int(model.joint(joint).dofadr[0])
    model.dof_frictionloss[dof], model.dof_solref[dof] = level, (2 * model.opt.timestep, 1)
    data, rng = mujoco.MjData(model), np.random.default_rng(seed)
    rates, phases, period = rng.uniform(0.15, 2.5, 6), rng.uniform(0, 6, 6), 20 * model.opt.timestep
    time = period * np.arange(round(20 / period))
    command = strength * np.sum(np.sin(2 * np.pi * rates * time[:, None] + phases), axis=1)
    readings = np.empty((len(time), model.nsensordata))
    for k in range(len(time)):
        mujoco.mj_forward(model, data)
        readings[k] = data.sensordata + noise * rng.normal(size=model.nsensordata)
        data.ctrl[0] = command[k]
        mujoco.mj_step(model, data, 20)
    names = mjcf.controls(model), mjcf.scalar_sensors(model)
    return Recording(f"run {seed}", time, command[:, None], readings, tuple(names[0]), tuple(names[1]))


def furuta(seed: int) -> Recording:
    return simulated(FURUTA, "arm", LEVEL, 0.8, 3e-4, seed)


def asked(text: str, runs: list[Recording], held_out: Recording, *names: str) -> Diagnosis:
    return diagnose(mjcf.from_text(text), runs, [held_out], effects=[catalogue()[name] for name in names])


def off(text: str, run: Recording, folder: Path) -> float:
    """Times the noise by which MuJoCo is off that runs a file as it stands."""
    (folder / "model.xml").write_text(text)
    recording.write(run, folder / "run.csv", overwrite=True)
    return replay(folder / "model.xml", folder / "run.csv").error


def test_bristles_too_stiff_for_the_file_are_written_as_dry_friction(tmp_path: Path) -> None:
    """LuGre friction fitted to dry friction explains it in fine steps, and blows up in those of the file."""
    fresh = furuta(3)
    found = asked(FURUTA, [furuta(1), furuta(2)], fresh, "friction.stribeck:presliding")
    assert found.verdict == "explained", found.sentence
    key = "friction.stribeck:presliding@arm"
    written = found.written
    assert written is not None
    assert key in written.forms
    assert "dcmotor" not in found.improved
    assert written.forms[key] in found.improved  # told in the comment
    document = Document(mjcf.from_text(FURUTA))
    bristles = {name: one["value"] for name, one in found.missing[0].parameters.items()}
    catalogue()["friction.stribeck:presliding"].edit(document, "arm", bristles)
    plain = FURUTA.replace('damping="0.002"', f'damping="0.002" frictionloss="{LEVEL}" solreffriction="0.004 1"')
    as_written, as_found, by_hand = (off(text, fresh, tmp_path) for text in (found.improved, document.text(), plain))
    assert as_found > 20
    assert as_written < 1.1 * by_hand < 3
    assert written.held_out.improved == pytest.approx(as_written, rel=0.05)  # less the first window, and its noise


def test_what_the_file_costs_at_its_own_step_is_said_everywhere(tmp_path: Path) -> None:
    text, joint, level, strength, noise = RAIL, "cart", 3.0, 4.0, 1e-5
    first, second, fresh = (simulated(text, joint, level, strength, noise, seed) for seed in (1, 2, 4))
    found = asked(text, [first, second], fresh, "friction.coulomb")
    assert [(m.effect, m.at) for m in found.missing] == [("friction.coulomb", joint)]
    written = found.written
    assert written is not None
    assert found.held_out is not None
    assert found.held_out.improved < SCORE.at_floor < written.held_out.improved  # 2 ms are coarse for 0.01 mm
    assert found.to_dict()["fit"]["as_written"]["held_out_in_noise"]["improved"] == pytest.approx(
        written.held_out.improved, abs=1e-3
    )
    figure = f"{written.held_out.improved:.3g}"
    assert f"at its own step of 2 ms: {figure}" in found.sentence
    assert f"to {figure} times the noise" in found.improved
    note = next(note for note in found.notes if "own step" in note)
    assert figure in note
    # A diagnosis judges by windows that begin when swings from before the recording are over.
    judged = fresh.slice(int(np.searchsorted(fresh.time, fresh.time[0] + 1.25 - 1e-9)), len(fresh))
    assert off(found.improved, judged, tmp_path) == pytest.approx(written.held_out.improved, rel=0.05)
    assert written.finer is not None
    step, error = written.finer.timestep, written.finer.error
    assert f"a timestep of {1e3 * step:g} ms" in note
    assert f"{error:.3g} times" in note
    finer = found.improved.replace('timestep="0.002"', f'timestep="{step}"')
    finer = finer.replace('solreffriction="0.004 1"', f'solreffriction="{2 * step} 1"')
    assert off(finer, judged, tmp_path) == pytest.approx(error, rel=0.05)
    json.dumps(found.to_dict(), allow_nan=False)


AXIS = """<mujoco model="axis">
  <option timestep="0.0005" integrator="implicitfast"/>
  <worldbody>
    <body name="wheel">
      <inertial pos="0 0 0" mass="0.1" diaginertia="1.5e-4 1.5e-4 1.5e-4"/>
      <joint name="axis" type="hinge" axis="0 0 1" damping="2e-4"/>
    </body>
  </worldbody>
  <actuator><motor name="torque" joint="axis"/></actuator>
  <sensor><jointpos name="axis" joint="axis"/></sensor>
</mujoco>
"""


def test_a_step_that_hides_what_was_found_is_taken_by_another_integrator(tmp_path: Path) -> None:
    """Half a step of a fast axis is more than a wrong damping: at the file's own, a model that lacks it is better."""
    truth = AXIS.replace("implicitfast", "RK4").replace('damping="2e-4"', 'damping="2.006e-4"')
    first, second, fresh = (simulated(truth, "axis", 0.0, 0.012, 1e-4, seed) for seed in (1, 2, 3))
    found = asked(AXIS, [first, second], fresh)
    assert found.written is not None
    assert found.written.exact
    assert found.written.integrator == "RK4"
    assert found.written.held_out.improved < SCORE.at_floor < found.written.held_out.nominal
    assert mjcf.compile(mjcf.from_text(found.improved)).opt.integrator == mujoco.mjtIntegrator.mjINT_RK4
    assert off(found.improved, fresh, tmp_path) < SCORE.at_floor
    asks = "improved.xml asks for the integrator RK4"
    assert asks in found.improved
    assert any(asks in note for note in found.notes)
    own = found.improved.replace("RK4", "implicitfast")
    assert off(own, fresh, tmp_path) > off(AXIS, fresh, tmp_path)  # what it would be without


NOTHING = Structure(Document(mjcf.from_text(CART)), mjcf.compile(mjcf.from_text(CART)), ("cart",))


def option(error: float, *, refitted: bool = False) -> Option:
    return Option(NOTHING, NOTHING.first, error, refitted)


def options(*, refitted: bool = False) -> st.SearchStrategy[list[Option]]:
    made = st.floats(0.9, 1e6).map(lambda error: option(error, refitted=refitted))
    return st.lists(made, min_size=0 if refitted else 1, max_size=6)


@pytest.mark.parametrize(
    ("physical", "refitted", "exact", "plainer", "taken"),
    [
        ((1.1,), (), (), (9.0,), 1.1),  # the rig's own parameters will do
        ((50.0, 1.7, 1.1), (), (), (9.0,), 1.1),  # in another form
        ((3.0,), (1.1,), (), (9.0,), 1.1),  # others make up for the step
        ((9.0,), (4.0,), (), (20.0,), 9.0),  # others do not, and are wrong at any other step
        ((9.0,), (2.4,), (), (5.0,), 2.4),  # but they may for most of it
        ((9.0,), (4.0,), (), (5.0,), 5.0),  # for a part of it is chance
        ((7.0,), (4.0,), (), (5.0,), 7.0),  # where the step costs most, the rig's own are right at any other
        ((9.0,), (7.0,), (), (5.0, 6.0), 5.0),  # nothing is better
        ((9.0,), (7.0,), (), (9.0,), 9.0),  # as good, and right at any step
        ((1.19,), (), (), (1.0,), 1.19),  # at the noise all are as good
        ((9.0,), (7.0,), (1.0,), (5.0, 6.0), 1.0),  # in the same steps of another integrator
        ((9.0,), (2.4,), (1.0,), (5.0,), 1.0),  # which is right at any other step
        ((7.0,), (4.0,), (1.0,), (5.0,), 1.0),  # and no worse than a plainer one
        ((4.0,), (), (1.0,), (5.0,), 4.0),  # but takes four times as long
        ((9.0,), (), (3.0,), (5.0,), 5.0),  # and is nothing for itself
    ],
)
def test_what_is_written(
    physical: tuple[float, ...],
    refitted: tuple[float, ...],
    exact: tuple[float, ...],
    plainer: tuple[float, ...],
    taken: float,
) -> None:
    made = [option(error, refitted=True) for error in refitted]
    own, other, fewer = ([option(error) for error in errors] for errors in (physical, exact, plainer))
    chosen = choose(own, made, other, fewer, 1.2)
    assert chosen.error == taken


@given(
    physical=options(),
    refitted=options(refitted=True),
    exact=st.lists(st.floats(0.9, 1e6).map(option), max_size=1),
    plainer=options(),
    enough=st.floats(1.2, 1e6),
)
def test_no_file_predicts_worse_than_a_plainer_one(
    physical: list[Option], refitted: list[Option], exact: list[Option], plainer: list[Option], enough: float
) -> None:
    taken = choose(physical, refitted, exact, plainer, enough)
    least = max(VERDICT.worse * min(option.error for option in plainer), SCORE.at_floor)
    coarse = enough < SEARCH.main_part * min(option.error for option in physical)
    assert taken.error <= (VERDICT.coarse if coarse and taken in physical else 1.0) * least
    if taken.refitted:  # the rig's own parameters would do as badly as to be no good
        assert min(option.error for option in physical) > min(enough, *(option.error for option in plainer))
    if any(taken is option for option in exact):
        assert taken.error <= enough
        assert min(option.error for option in physical) > least
    if physical[0].error <= min(enough, least):
        assert taken is physical[0]


def in_forms() -> list[tuple[str, Effect]]:
    """Of friction; what a stop is in its other form, is told by a blow (test_stops)."""
    found = [(name, form) for name, effect in catalogue().items() for form in effect.forms()]
    return [(name, form) for name, form in found if name.startswith("friction.")]


@pytest.mark.parametrize(("name", "form"), in_forms(), ids=lambda one: one if isinstance(one, str) else one.element)
def test_a_form_is_the_same_friction_at_speed(name: str, form: Effect) -> None:
    """At a steady speed each form asks for the force that its effect does, and no form is a hypothesis."""
    effect = catalogue()[name]
    values = {"level": 0.3, "static": 0.4, "velocity": 0.05, "stiffness": 40.0, "damping": 0.3, "coefficient": 0.2}
    assert form.element
    assert form.element != effect.element
    assert {p.name for p in form.parameters} == {p.name for p in effect.parameters}
    assert form.id not in catalogue()
    forces = []
    for one in (effect, form):
        base = mjcf.compile(mjcf.from_text(TORQUE.replace("<option", '<option gravity="0 0 0"')))
        structure = Structure(Document(mjcf.from_text(TORQUE.replace("<option", '<option gravity="0 0 0"'))), base, ())
        structure = structure.with_term(Term(one, "shoulder", values))
        model = copy.copy(structure.physics(structure.first).model)
        model.opt.timestep = 1e-4
        data = mujoco.MjData(model)
        for _ in range(40_000):  # bristles bend until they slip
            data.qvel[0] = 0.5
            mujoco.mj_step(model, data)
        data.qvel[0] = 0.5
        mujoco.mj_forward(model, data)
        forces.append(float(data.qfrc_passive[0] + data.qfrc_actuator[0] + data.qfrc_constraint[0]))
    assert forces[0] < 0
    assert forces[1] == pytest.approx(forces[0], rel=0.02)


# --- nobody is given a model that predicts worse than what they had ------------------------------------------------


NOT_ENOUGH = ("friction.coulomb", "friction.position", "friction.stribeck", "load.position", "motor.deadzone")


def test_numbers_that_make_up_for_a_step_are_said_beside_what_was_found() -> None:
    parameters = {n.key: n for n in model_parameters(Document(mjcf.from_text(CART)), mjcf.compile(CART))}
    structure = replace(NOTHING, model_parameters=(parameters["cart.damping"], parameters["cart.mass"]))
    found = SimpleNamespace(structure=structure, z=np.zeros(2))  # all that is asked of a fit
    written, damping = Option(structure, np.array([np.log(2.0), 0.01]), 1.0, refitted=True), parameters["cart.damping"]
    differing = _differing(written, cast("Fit", found))
    assert differing == [("cart.damping", pytest.approx(damping.value), pytest.approx(2 * damping.value))]
    said = made_up(AsWritten(2e-3, "Euler", Errors(1, 1, 1), Errors(1, 1, 1), 1.0), differing)
    assert "own step of 2 ms and are right at no other" in said
    assert f"cart.damping {2 * damping.value:.3g} ({damping.value:.3g})" in said


@pytest.mark.parametrize(
    "law", [sim2real_rigs.Hysteresis(6.0, 4e-3), sim2real_rigs.StiffSpot()], ids=lambda law: type(law).__name__
)
def test_no_diagnosis_predicts_worse_than_refitted_numbers(
    law: sim2real_rigs.Hysteresis | sim2real_rigs.StiffSpot,
) -> None:
    runs = [sim2real_rigs.rail(law, seed) for seed in (1, 2)]
    found = diagnose(mjcf.from_text(sim2real_rigs.RAIL), runs, effects=[catalogue()[name] for name in NOT_ENOUGH])
    assert found.verdict not in ("consistent", "cannot tell"), found.sentence
    validation, written = found.validation, found.written
    assert validation is not None
    assert written is not None
    for errors in (validation, written.validation):
        assert errors.improved <= max(VERDICT.worse * min(errors.nominal, errors.recalibrated), SCORE.at_floor)
    assert found.to_dict()["fit"]["validation_in_noise"]["improved"] == pytest.approx(validation.improved, abs=1e-4)


def test_a_file_may_do_without_an_effect_that_takes_fine_steps() -> None:
    """A winding worth nothing keeps a file from its own step; dry friction does not, and is not asked to go."""
    rig = physics.load(CART)
    P = sim2real_rigs.prepared(CART, [sim2real_rigs.record(rig, sim2real_rigs.sweep(4.0), 4.0, noise=1e-5)])
    friction = Term(catalogue()["friction.coulomb"], "cart", {"level": 0.01})
    winding = Term(catalogue()["motor.inductance"], "motor", {"time_constant": 1e-4})
    both = fit(P.problem, P.structure.with_term(friction).with_term(winding), most=2)
    own = Predictor(P.problem, P.problem).at(1e-3)
    some = np.arange(0, len(P.problem.windows), 2)
    [option] = _with_one_less(both, P.problem.pick(some), some, own)
    assert [term.key for term in option.structure.terms] == [friction.key]
    assert option.error == own.error(option.structure, option.z) < np.inf
    assert _with_one_less(replace(both, structure=P.structure.with_term(winding)), P.problem, some, own) == []


@pytest.mark.parametrize(
    ("enough", "error", "times"),
    [
        pytest.param(1.2, 5.4, VERDICT.coarse, id="the step costs most: which file is better at it is chance"),
        pytest.param(2.4, 4.6, VERDICT.worse, id="fine steps leave half as much"),
        pytest.param(1.2, 1.0, VERDICT.worse, id="the step costs nothing"),
    ],
)
def test_a_file_may_be_worse_than_another_at_a_step_that_costs_most(enough: float, error: float, times: float) -> None:
    assert _allowed(enough, error) == times


def test_what_no_initial_state_explains_is_not_put_down_to_the_step() -> None:
    """Derivatives may ask for an initial state that does not help where a joint sticks, in fine steps as in its own."""
    said = AsWritten(1e-3, "Euler", Errors(159.0, 91.0, 62.5), Errors(155.0, 110.0, 60.0), 62.3)
    dropped = {"dropped": [], "alone": False, "stiff": False}
    assert step_costs(said, **dropped) == ""
    assert "62.3 times the noise" in (note := initial_states(said, Errors(159.0, 91.0, 24.4)))
    assert "24.4" in note
    assert initial_states(said, Errors(159.0, 91.0, 60.0)) == ""
    coarse = replace(said, held_out=Errors(159.0, 91.0, 80.0))
    assert "with a converged step to 62.3" in step_costs(coarse, **dropped)


def test_laws_that_were_fitted_to_the_end_are_written_in_its_order() -> None:
    """A fit to more windows may give laws more knots, and puts the one that it made finer last."""
    ready = sim2real_rigs.prepared(CART, [sim2real_rigs.record(physics.load(CART), sim2real_rigs.sweep(4.0))])
    speed, place = (Term(kind([0.0, 0.5], [1.0, 2.0]), "cart", {}) for kind in (FrictionOfSpeed, ForceOfPosition))
    finer = Term(FrictionOfSpeed([0.0, 0.2, 0.5], [1.0, 1.5, 2.0]), "cart", {})
    speed, place, finer = (replace(term, guess=term.effect.guess) for term in (speed, place, finer))
    before, last = (
        fit(ready.problem, ready.structure.with_term(one).with_term(other), most=0)
        for one, other in ((speed, place), (place, finer))
    )
    further = _to_the_end(Option(before.structure, before.z, 1.0), last)
    assert further is not None
    assert further.structure.terms == last.structure.terms
    np.testing.assert_array_equal(further.z, last.z)
    assert _to_the_end(Option(before.structure, before.z, 1.0, refitted=True), last) is None
