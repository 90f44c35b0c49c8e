"""The engine beside MuJoCo, and its derivatives beside differences."""

from __future__ import annotations

import copy
import ctypes
import gc
import os
import re
import stat
import sys
import threading
import weakref
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sim2real_rigs import CART, HANGING, NOISE, RK4, prepared, record, sweep

from dipc_gym import mjcf, physics
from dipc_gym.engine import Uncovered, check, machine, program
from dipc_gym.engine import run as engine_run
from dipc_gym.engine.layout import CONTROLS, Element, Head, Kind
from dipc_gym.engine.run import Commands, Directions, Jobs, differentiate, run
from dipc_gym.mjcf.edit import Document
from dipc_gym.physics import entries
from dipc_gym.sim2real.effects import catalogue
from dipc_gym.sim2real.effects.load_position_law import ForceOfPosition
from dipc_gym.sim2real.effects.shared.base import passive_ramp
from dipc_gym.sim2real.effects.unknown_recent import UnknownRecent
from dipc_gym.sim2real.estimation import slopes
from dipc_gym.sim2real.estimation.problem import predict, sensitivities
from dipc_gym.sim2real.estimation.slopes import Slopes
from dipc_gym.sim2real.model.parameters import model_parameters
from dipc_gym.sim2real.model.structure import Term
from dipc_gym.sim2real.simulation import batch
from dipc_gym.sim2real.simulation.batch import Stepping, simulate
from dipc_gym.sim2real.simulation.compiled import compiled
from dipc_gym.sim2real.simulation.motion import Motion
from dipc_gym.sim2real.simulation.windows import cut

Array = np.ndarray

ODD = 'limited="true" solimplimit="0.9 0.95 0.001 0.5 3"'  # its impedance is a cubic spline
LIMITS = (
    "",
    'solreflimit="0.03 0.7"',
    'solreflimit="-900 -20"',
    'solimplimit="0 0.95 0.2"',
    'solimplimit="0.3 0.99 0.5 0.2 2"',
    'solimplimit="0.3 0.99 0.5 0.2 1"',
    'solimplimit="0.8 0.9 0"',
    'margin="0.05"',
)


def numbers(values: Array) -> str:
    return " ".join(repr(float(x)) for x in np.ravel(values))


def random_tree(
    rng: np.random.Generator, joints: int, *, dry: bool = False, yields: bool = False, bounded: bool = False
) -> str:
    """A tree of hinges and slides, along axes of the frame or not, with springs, dampers and motors of many kinds."""
    parents = [int(rng.integers(-1, i)) if i else -1 for i in range(joints)]
    bounds = [f'actuatorfrcrange="{-0.3 - k} {0.1 * (k + 1)}"' if k % 3 == 1 and bounded else "" for k in range(joints)]

    def body(i: int) -> str:
        kind = "slide" if rng.random() < 0.3 else "hinge"
        axis = np.eye(3)[rng.integers(3)] * rng.choice([-1, 1]) if rng.random() < 0.5 else rng.normal(size=3)
        turn = rng.normal(size=4) if rng.random() < 0.4 else np.eye(4)[0]
        friction = rng.uniform(0.05, 0.5) if dry else 0.0
        inside = "".join(body(j) for j in range(i + 1, joints) if parents[j] == i)
        return f"""<body pos="{numbers(0.3 * rng.normal(size=3))}" quat="{numbers(turn)}"
              gravcomp="{rng.choice([0, 0, 1, 0.5])}">
            <inertial pos="{numbers(0.2 * rng.normal(size=3))}" quat="{numbers(rng.normal(size=4))}"
              mass="{rng.uniform(0.2, 2)}" diaginertia="{numbers(rng.uniform(0.01, 0.02, 3))}"/>
            <joint name="j{i}" type="{kind}" axis="{numbers(axis)}" pos="{numbers(0.1 * rng.normal(size=3))}"
              ref="{rng.choice([0.0, 0.3])}" damping="{numbers(rng.uniform(0, 1, 3))}" frictionloss="{friction}"
              stiffness="{numbers(rng.uniform(0, 3, 3))}" springref="{0.1 * rng.normal()}" {bounds[i]}
              armature="{rng.uniform(0.01, 0.1)}"/>
            <body><inertial pos="{numbers(0.1 * rng.normal(size=3))}" mass="0.1" diaginertia="1e-3 1e-3 1e-3"/></body>
            {inside}</body>"""

    motors = {
        "motor": '<motor joint="{j}" gear="{g}"/>',
        "position": '<position joint="{j}" kp="{g}" kv="0.3" ctrlrange="-0.4 0.4" ctrllimited="true"/>',
        "filter": '<general joint="{j}" dyntype="filter" dynprm="0.01" gainprm="{g}" forcerange="-0.5 0.5"/>',
        "dcmotor": """<dcmotor joint="{j}" gear="3" resistance="1.2" motorconst="0.06" damping="0.1 0.01 0.02"
            armature="0.001" inductance="0 0.004" thermal="3 0 5 0.00393 25 20" cogging="0.1 7 0.3"/>""",
        "bristles": '<dcmotor joint="{j}" input="none" resistance="1" motorconst="0 0" lugre="30 0.5 0.2 0.3 0.2"/>',
        "saturated": '<dcmotor joint="{j}" resistance="1.2" motorconst="0.5" saturation="0.2 0 0" cogging="0.1 3 1"/>',
    }
    kinds = rng.choice(sorted(motors), size=joints)
    driven = "".join(motors[k].format(j=f"j{i}", g=rng.uniform(0.5, 2)) for i, k in enumerate(kinds))
    tendon = ""
    if joints > 1:
        ends = f'<joint joint="j0" coef="1"/><joint joint="j1" coef="{rng.normal()}"/>'
        tendon = f"""<tendon><fixed stiffness="5 1 1" damping="0.2 0.1 0.1" springlength="-0.1 0.1">{ends}</fixed>
            {f'<fixed stiffness="4" springlength="0.05" springyield="0.02">{ends}</fixed>' if yields else ""}
            <fixed limited="true" range="-0.2 0.2" solreflimit="-10000 -30" solimplimit="1e-4 1e-4 1">{ends}</fixed>
            </tendon>"""
    sensors = "".join(f'<jointpos name="s{i}" joint="j{i}"/>' for i in range(joints))
    roots = "".join(body(i) for i in range(joints) if parents[i] < 0)
    return f"""<mujoco><compiler angle="radian"/><option gravity="0.3 -0.2 -9.81" timestep="0.0005"/>
        <worldbody>{roots}</worldbody>{tendon}<actuator>{driven}</actuator><sensor>{sensors}</sensor></mujoco>"""


def loaded(text: str) -> physics.Physics:
    return physics.from_model(mujoco.MjModel.from_xml_string(text))


def added(text: str, effect: str, at: str, **values: float) -> physics.Physics:
    document = Document(mjcf.from_text(text))
    catalogue()[effect].edit(document, at, values)
    return physics.from_model(mjcf.compile(document.text()))


# As MuJoCo sees it


@settings(max_examples=6, deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 7))
def test_accelerations_of_random_trees_are_mujocos(seed: int, joints: int) -> None:
    """`check` compares at random states and raises where anything differs by more than 1e-9 of the largest."""
    source = loaded(random_tree(np.random.default_rng(seed), joints, yields=True, bounded=bool(seed % 2)))
    what, parameters = program.read([source])
    check.check(what, parameters[0], source)


def with_limits(text: str, rng: np.random.Generator, *kinds: str) -> str:
    """A tree whose joints have limits, near where they begin."""

    def limited(name: re.Match[str]) -> str:
        low, high = rng.uniform(-0.3, 0.0), rng.uniform(0.15, 0.4)
        return f'{name[0]} limited="true" range="{low} {high}" {rng.choice(kinds)}'

    return re.sub(r'<joint name="j\d"', limited, text)


def with_ties(text: str, rng: np.random.Generator, joints: int) -> str:
    """A tree of which some joints follow another, with an offset, and one stays where it is."""
    kinds = ("", 'solref="0.05 0.5"', 'solref="-500 -10"', 'solimp="0.5 0.9 0.3"', 'solimp="0.7 0.99 0.3 0.3 1"')
    ties = [
        f'<joint joint1="j{k}" joint2="j0" polycoef="{0.1 * rng.normal()} {rng.normal()} 0 0 0" {rng.choice(kinds)}/>'
        for k in range(1, joints - 1)
    ]
    stays = f'<joint joint1="j{joints - 1}" polycoef="0.1 0 0 0 0" {rng.choice(kinds)}/>'
    return text.replace("<actuator>", f"<equality>{''.join(ties)}{stays}</equality><actuator>")


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 6))
def test_limits_and_ties_of_random_trees_push_as_mujocos_do(seed: int, joints: int) -> None:
    """Several are met at once, on joints and a tendon, each by another of MuJoCo's formulas."""
    rng = np.random.default_rng(seed)
    text = with_limits(random_tree(rng, joints), rng, *LIMITS)
    source = loaded(with_ties(text, rng, joints) if seed % 2 else text)
    what, parameters = program.read([source])
    assert what.codes[Head.STOPS] == joints + (joints > 1)
    assert what.codes[Head.TIES] == source.model.neq
    check.check(what, parameters[0], source)


@settings(max_examples=6, deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 5))
def test_ramps_of_a_joint_are_one_element_and_mujocos(seed: int, joints: int) -> None:
    rng = np.random.default_rng(seed)
    document, several = Document(mjcf.from_text(random_tree(rng, joints))), rng.integers(0, 6, joints)
    for k, count in enumerate(several):
        for i in range(count):
            low, high = np.sort(rng.normal(size=2)).tolist()
            passive_ramp(document, f"ramp_{k}_{i}", f"j{k}", tuple(rng.normal(size=3).tolist()), (low, high))
    source = loaded(document.text())
    what, parameters = program.read([source])
    first, size = what.codes[Head.ELEMENT_AT], int(Element.SIZE)
    elements = what.codes[first : first + what.codes[Head.ELEMENTS] * size].reshape(-1, size)
    ramps = elements[elements[:, Element.KIND] == Kind.RAMPS]
    assert sorted(ramps[:, Element.FEATURES]) == sorted(several[several > 0])
    check.check(what, parameters[0], source)


def test_a_program_that_says_something_else_is_refused() -> None:
    source = loaded(random_tree(np.random.default_rng(3), 3))
    what, parameters = program.read([source])
    heavier = parameters[0].copy()
    heavier[program.rigid.GRAVITY + 13] *= 1 + 1e-6  # a mass
    with pytest.raises(Uncovered, match="differ from MuJoCo"):
        check.check(what, heavier, source)


def jobs_for(parameters: Array, initial: Array, commands: Array, samples: int, joints: int) -> Jobs:
    """Windows of two-millisecond samples that begin with the first command."""
    windows = initial.shape[1]
    times = np.repeat((0.002 * np.arange(samples))[None, None], windows, axis=0).repeat(joints, axis=1)
    zero = np.zeros(windows, dtype=np.int64)
    held = Commands(0.002 * np.arange(len(commands)), commands[None])
    count = np.full(windows, len(commands))
    sets = np.zeros(len(initial), dtype=np.int64)
    return Jobs(parameters, initial, np.zeros(windows), zero, count, held, sets, times, times.max(axis=(1, 2)))


@settings(max_examples=3, deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 7))
def test_windows_without_events_are_mujocos_at_a_fine_step(seed: int, joints: int) -> None:
    """Rigid trees with springs and dampers: Runge-Kutta at a tenth of a millisecond on both sides. Sensors read joints,
    a sum of all joints, and motors on a joint and on that sum, positions and speeds.
    """
    rng = np.random.default_rng(seed)
    text = random_tree(rng, joints)
    begin, end = text.index("<actuator>"), text.index("</sensor>")
    driven = "".join(f'<motor name="m{i}" joint="j{i}" gear="{rng.normal()}"/>' for i in range(joints))
    driven += f'<motor name="all" tendon="all" gear="{rng.normal()}"/>'
    every = "".join(f'<joint joint="j{i}" coef="{rng.normal()}"/>' for i in range(joints))
    tendon = f'<tendon><fixed name="all">{every}</fixed></tendon>'
    first = text.find("<tendon>") if "<tendon>" in text else begin
    read = (
        text[text.index("<sensor>") : end]
        + """<tendonpos name="sum" tendon="all"/><tendonvel name="sums" tendon="all"/>
        <actuatorpos name="turned" actuator="m0"/><actuatorvel name="turns" actuator="all"/>"""
    )
    source = loaded(f"{text[:first]}{tendon}<actuator>{driven}</actuator>{read}{text[end:]}")
    what, parameters = program.read([source])
    initial, commands = 0.3 * rng.normal(size=(1, 2, 2 * joints)), rng.normal(size=(25, joints + 1))
    readings, _ = run(what, jobs_for(parameters, initial, commands, 25, joints + 4), 1e-4)
    model = source.model
    model.opt.integrator, model.opt.timestep = RK4, 1e-4
    data = mujoco.MjData(model)
    for window in range(2):
        mujoco.mj_resetData(model, data)
        data.qpos[:], data.qvel[:] = initial[0, window, :joints], initial[0, window, joints:]
        for sample in range(25):
            mujoco.mj_forward(model, data)
            assert readings[0, window, :, sample] == pytest.approx(data.sensordata, abs=1e-9)
            data.ctrl[:] = commands[sample]
            mujoco.mj_step(model, data, 20)


def test_with_events_both_converge_to_the_same() -> None:
    """Three joints with dry friction, all of which stick at times: the finer, the nearer to MuJoCo's way of events."""
    text = HANGING.replace('damping="21.4"', 'damping="21.4" frictionloss="3"').replace(
        'damping="0.001"', 'damping="0.001" frictionloss="0.05"'
    )
    source = loaded(text)
    source_run = record(source, sweep(3.0), 1.0, start=(0, 0.4, -0.3))
    windows = cut([source_run], np.ones(3), 0.25, (0.0, 1.0))
    initial = np.concatenate(
        [source_run.sensors[(windows.start / 0.002).round().astype(int)], np.zeros((4, 3))], axis=1
    )
    base = ["cart", "pole1", "pole2"]
    ours = {h: simulate([source], windows, initial[None], Stepping(h, RK4), base=base)[0] for h in (1e-3, 1e-4)}
    theirs = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(batch, "compiled", lambda *_: (_ for _ in ()).throw(Uncovered("for comparison")))
        for h in (1e-3, 1e-4):
            theirs[h] = simulate([source], windows, initial[None], Stepping(h, RK4), base=base)[0]
    apart = {h: np.abs(theirs[h] - ours[1e-4]).max() for h in theirs}
    assert apart[1e-4] < 0.2 * apart[1e-3]
    assert np.abs(ours[1e-3] - ours[1e-4]).max() < 0.2 * apart[1e-3]
    assert apart[1e-4] < 1e-6


@pytest.mark.parametrize("level", [0.3, 1.0, 3.0])
def test_a_block_stops_where_the_closed_form_says(level: float) -> None:
    text = CART.replace('damping="21.4"', f'damping="0" frictionloss="{level}"').replace("0.06", "1e-9")
    source = loaded(text)
    what, parameters = program.read([source])
    initial = np.array([[[0.0, 0.7]]])
    readings, ends = run(what, jobs_for(parameters, initial, np.zeros((2, 1)), 1500, 1), 0.002)
    assert ends[0, 0].tolist() == pytest.approx([1.26 * 0.7**2 / 2 / level, 0.0], abs=1e-9)
    assert np.all(np.diff(readings[0, 0, 0]) >= 0)


def test_what_ctrl_c_leaves_behind_writes_into_arrays_that_are_still_there(monkeypatch: pytest.MonkeyPatch) -> None:
    """Threads go on with the rows that they have begun, when whoever asked for these has gone."""
    module, begun, goes_on = sys.modules[run.__module__], threading.Event(), threading.Event()

    def function(table: object, first: int, last: int) -> None:
        begun.set()
        goes_on.wait(60)

    class Interrupted(ThreadPoolExecutor):
        def map(self, work: Callable[..., object], items: Iterable[object], **options: object) -> Iterator[object]:
            self.submit(work, next(iter(items)))
            begun.wait(60)
            raise KeyboardInterrupt

    threads = Interrupted(1)
    monkeypatch.setattr(module, "_function", lambda *of: function)
    monkeypatch.setattr(module, "pool", lambda *of: threads)
    kept: list[weakref.ref[np.ndarray]] = []
    empty = np.empty

    def remembered(*shape: object, **options: object) -> np.ndarray:
        made = empty(*shape, **options)  # type: ignore[call-overload]
        kept.append(weakref.ref(made))
        return made  # type: ignore[no-any-return]

    monkeypatch.setattr(module.np, "empty", remembered)
    what, parameters = program.read([loaded(CART)])
    jobs = jobs_for(parameters, np.zeros((1, 40, 2)), np.zeros((2, 1)), 10, 1)
    with pytest.raises(KeyboardInterrupt):
        run(what, jobs, 0.002, threads=2)
    monkeypatch.undo()
    gc.collect()
    assert [one() is not None for one in kept] == [True, True]
    goes_on.set()
    threads.shutdown()
    gc.collect()
    assert [one() is not None for one in kept] == [False, False]


# Derivatives


CASES = [
    ("friction.coulomb", "cart", {"level": 2.0}),
    ("friction.stribeck", "cart", {"level": 2.0, "static": 3.0, "velocity": 0.05}),
    ("friction.load", "cart", {"level": 1.0, "by_drive": 0.1, "by_weight": 0.1}),
    (
        "friction.load:stribeck",
        "cart",
        {"level": 1.0, "by_drive": 0.1, "by_weight": 0.1, "excess": 0.4, "velocity": 0.05},
    ),
    ("motor.sag", "motor", {"drop": 0.2, "time_constant": 0.1, "current": 3.0, "gain": 4.0, "back": 4.0}),
    ("friction.position:wave", "cart", {"level": 2.0, "sine": 0.5, "cosine": 0.5, "wavelength": 0.1}),
    ("transmission.compliance", "motor", {"stiffness": 3e3, "damping": 10.0, "rotor_inertia": 0.2}),
    ("timing.delay", "motor", {"delay": 0.0033}),
    ("timing.sensor_lag", "pole1", {"time_constant": 0.004}),
    ("timing.sensor_lag:delay", "pole1", {"delay": 0.0033}),
    ("motor.inductance", "motor", {"time_constant": 0.002}),
    ("motor.deadzone", "motor", {"width": 0.3}),
    ("load.tilt", "world", {"about_x": 0.01, "about_y": 0.02}),
    ("load.swinging", "cart", {"mass": 0.1, "frequency": 3.0, "damping_ratio": 0.1}),
    ("load.creeping", "cart", {"stiffness": 80.0, "relaxation_time": 0.3}),
    ("sensor.gain", "pole1", {"gain": 1.01}),
    ("sensor.eccentric", "cart", {"sine": 0.002, "cosine": 0.001, "wavelength": 0.08}),
]


@pytest.fixture(scope="module")
def hanging() -> object:
    source = physics.load(HANGING)
    return prepared(HANGING, [record(source, sweep(3.0), 1.0, noise=NOISE["hanging"], start=(0, 0.4, -0.3))])


@pytest.mark.parametrize(("effect", "at", "guess"), CASES)
def test_sensitivities_are_limits_of_differences(
    hanging: object, effect: str, at: str, guess: dict[str, float]
) -> None:
    """By all numbers of an effect and all starts, through reversals, sticking and late commands."""
    problem, structure = hanging.problem, hanging.structure.with_term(Term(catalogue()[effect], at, guess))
    z, initial = structure.first, problem.initial
    probes = [z + 1e-7 * unit for unit in np.eye(len(z))]
    found = sensitivities(problem, structure, z, probes, initial)
    assert found is not None
    readings, by_parameters, by_initial = found
    assert readings == pytest.approx(predict(problem, structure, [z], initial[None])[0], abs=1e-12)
    size = 1e-5
    moved = [(z + sign * size * unit, initial) for unit in np.eye(len(z)) for sign in (1, -1)]
    moved += [(z, initial + sign * size * unit) for unit in np.eye(6) for sign in (1, -1)]
    said = predict(problem, structure, [one for one, _ in moved], np.stack([begin for _, begin in moved]))
    differences = (said[::2] - said[1::2]) / (2 * size)
    for exact, difference in zip([*by_parameters, *by_initial], differences, strict=True):
        # Where a joint barely sticks or not within the difference, there is no limit: all windows but one must agree.
        off = np.abs(exact - difference).max(axis=(1, 2)) / max(np.abs(difference).max(), 1e-9)
        assert np.sort(off)[-2] < 1e-5


@pytest.mark.parametrize(("effect", "at", "guess"), CASES)
@pytest.mark.parametrize("step", [1e-3, 0.3])
def test_slopes_that_are_kept_are_those_that_are_found_anew(
    hanging: object, effect: str, at: str, guess: dict[str, float], step: float
) -> None:
    """A structure that was asked elsewhere before says what one says that never was, products of numbers or not."""
    problem, term = hanging.problem.pick(np.arange(1)), Term(catalogue()[effect], at, guess)
    parameters = model_parameters(Document(mjcf.from_text(HANGING)), hanging.structure.model)
    base = replace(hanging.structure, model_parameters=tuple(parameters[:3]))
    found = []
    for before in (True, False):
        structure = base.with_term(term)
        there = structure.clip(structure.first + step * (1 + np.arange(len(structure.first)) / 7))
        for z in (structure.first, there) if before else (there,):
            probes = [z + 1e-6 * unit for unit in np.eye(len(z))]
            found.append(sensitivities(problem, structure, z, probes, problem.initial))
    _, kept, anew = found
    for ours, theirs in zip(kept, anew, strict=True):
        np.testing.assert_allclose(ours, theirs, atol=1e-7 * np.abs(theirs).max())


def ramps(count: int) -> Term:
    """A force of any shape along the cart's way, which MJCF says in as many passive elements."""
    knots = np.linspace(-0.3, 0.3, count)
    law = ForceOfPosition(knots.tolist(), np.sin(9 * knots).tolist())
    return Term(law, "cart", law.guess)


def thinning() -> Term:
    """A drag that goes with how fast the cart was of late: a table over that, and its time constant."""
    speed = ("velocity cart", "velocity cart")
    law = UnknownRecent(
        np.linspace(0, 0.5, 6).tolist(), [2, 1.5, 1.2, 1, 0.9, 0.8], speed, units=("m/s", "m/s"), time=0.4
    )
    return Term(law, "cart", law.guess)


def test_what_remembers_is_compiled_for_what_moves_its_beginnings_alone(
    hanging: object, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A time constant does; values of its table, those of another law, friction and masses do not."""
    problem, terms = hanging.problem, (Term(catalogue()["friction.coulomb"], "cart", {"level": 2.0}), ramps(30))
    parameters = model_parameters(Document(mjcf.from_text(HANGING)), hanging.structure.model)
    base = replace(hanging.structure, model_parameters=tuple(parameters[:3]), terms=terms)
    made, found, whole = [], [], type(base).physics
    monkeypatch.setattr(type(base), "physics", lambda self, z: made.append(z) or whole(self, z))
    for before in (True, False):
        structure = base.with_term(thinning())
        there = structure.first + 1e-2 * (1 + np.arange(len(structure.first)) / 7) * (structure.tables >= 0)
        for z in (structure.first, there) if before else (there,):
            probes = [z + 1e-6 * unit for unit in np.eye(len(z))]
            made.clear()
            found.append((sensitivities(problem, structure, z, probes, problem.initial), len(made)))
    _, (kept, few), (anew, many) = found
    for ours, theirs in zip(kept, anew, strict=True):
        np.testing.assert_allclose(ours, theirs, atol=1e-7 * np.abs(theirs).max())
    assert np.abs(kept[1][-1]).max() > 0  # by the time constant
    assert few <= 3  # the model, a check of the slopes that are kept, and one for the time constant
    assert many > 10


def test_what_moves_beginnings_is_asked_all_along_the_recordings(hanging: object) -> None:
    """In the first window nothing has been remembered yet, whatever the time constant."""
    structure, problem = hanging.structure.with_term(thinning()), hanging.problem.pick(np.arange(1))
    assert problem.windows.start.tolist() == [0.0]
    z = structure.first
    assert sensitivities(problem, structure, z, [z + 1e-6 * unit for unit in np.eye(len(z))], problem.initial)
    assert structure.worked_out[Slopes].alike.tolist() == [True] * 6 + [False]


def test_passive_elements_are_no_commands(hanging: object) -> None:
    structure = hanging.structure.with_term(ramps(60))
    here = structure.physics(structure.first)
    what, parameters = program.read([here])
    assert here.model.nu > CONTROLS
    assert what.codes[Head.CONTROLS] == 1
    assert check.check(what, parameters[0], here)


def test_windows_feel_few_values_of_a_table(hanging: object, monkeypatch: pytest.MonkeyPatch) -> None:
    """Values that a window does not meet are left out there, and nothing changes by it."""
    structure, problem, found = hanging.structure.with_term(ramps(60)), hanging.problem, []
    z = structure.first
    probes, whole = list(z + 1e-6 * np.eye(len(z))), engine_run._felt

    def told() -> tuple[Array, Array, Array]:
        made = sensitivities(problem, structure, z, probes, problem.initial)
        assert made is not None
        return made

    monkeypatch.setattr(engine_run, "_felt", lambda *given: found.append(whole(*given)) or found[-1])
    few = told()
    monkeypatch.setattr(engine_run, "PAYS", len(z))
    for some, every in zip(few, told(), strict=True):
        np.testing.assert_allclose(some, every, rtol=0, atol=1e-9 * np.abs(every).max())
    (felt,) = found
    assert felt[:-1].mean() < 0.75
    assert felt[-1].all()  # initial states


@given(st.lists(st.floats(0.2, 5.0), min_size=5, max_size=5))
def test_slopes_of_a_table_stay_whatever_masses_do(moved: list[float]) -> None:
    """A mass and a lever multiply each other and are asked anew; values of a table are not, moved or not."""

    def parameters_at(x: Array) -> Array:
        return np.array([x[0] * x[1], x[0], 2 * x[2] - x[3], x[3] + x[4], x[4]])

    def slopes_at(x: Array) -> Array:
        change = np.zeros((5, 5))
        change[0, :2], change[1, 0] = (x[1], 1.0), x[0]
        change[2, 2], change[3, 2:4], change[4, 3:] = 2.0, (-1.0, 1.0), 1.0
        return change

    begin, tables, alike = np.ones(5), np.array([-1, -1, 2, 2, 2]), np.ones(5, dtype=bool)
    known = Slopes(None, begin, parameters_at(begin), slopes_at(begin), np.full(5, 1e-3), tables, alike)  # type: ignore[arg-type]
    there = begin + np.array(moved)
    held, sure = known.told(there, parameters_at(there))
    assert (held.tolist(), sure) == ([False, False, True, True, True], False)
    still = np.append(there[:4], begin[4])
    assert known.told(still, parameters_at(still))[0].tolist() == [False, False, True, True, True]
    held, sure = known.told(begin, parameters_at(begin))
    assert sure
    assert held.all()
    bent = parameters_at(there) + np.array([0.0, 0.0, 0.0, 1.0, 0.0])
    assert known.told(there, bent)[0].tolist() == [False, False, True, False, False]


def test_slopes_of_an_affine_map_cost_no_models(hanging: object, monkeypatch: pytest.MonkeyPatch) -> None:
    structure = hanging.structure.with_term(Term(catalogue()["friction.coulomb"], "cart", {"level": 2.0}))
    problem, made = hanging.problem.pick(np.arange(1)), []
    whole = type(structure).physics
    monkeypatch.setattr(type(structure), "physics", lambda self, z: made.append(z) or whole(self, z))
    for z in (structure.first, structure.first + 0.1):
        assert sensitivities(problem, structure, z, [z + 1e-6], problem.initial) is not None
    assert len(made) == 3


@pytest.mark.parametrize("beside", [None, ("friction.resting", {"level": 1.0, "rise": 0.5, "time": 0.3, "slow": 0.01})])
def test_slopes_of_a_table_cost_few_models(
    hanging: object, monkeypatch: pytest.MonkeyPatch, beside: tuple[str, dict[str, float]] | None
) -> None:
    """A few models tell all of them, and where a bend turns, which another element of the program stands for, those of
    the values beside it do; whatever remembers beside the table. They are those of each value alone.
    """
    problem, base, made = hanging.problem.pick(np.arange(2)), hanging.structure.with_term(ramps(40)), []
    if beside is not None:
        effect, guess = beside
        base = base.with_term(Term(catalogue()[effect], "cart", guess))
    whole = type(base).physics
    monkeypatch.setattr(type(base), "physics", lambda self, z: made.append(z) or whole(self, z))
    there = base.first + 0.01 * np.random.default_rng(1).normal(size=len(base.first))
    there[7] += 3.0 * (1 if there[6] + there[8] > 2 * there[7] else -1)

    def told(structure: object, z: Array) -> tuple[Array, Array, Array]:
        made.clear()
        found = sensitivities(problem, structure, z, list(z + 1e-6 * np.eye(len(z))), problem.initial)
        assert found is not None
        return found

    structure = replace(base)
    for z, most in ((base.first, 20), (there, 12)):
        few = told(structure, z)
        assert len(made) < most
        with monkeypatch.context() as patched:
            patched.setattr(slopes, "ESTIMATION", replace(slopes.ESTIMATION, grouped=len(z) + 1))
            each = told(replace(base), z)  # what it worked out before is not kept
            assert len(made) > len(z)
        for ours, theirs in zip(few, each, strict=True):
            np.testing.assert_allclose(ours, theirs, atol=1e-7 * np.abs(theirs).max())


@pytest.mark.parametrize(
    ("joints", "kinds", "samples", "tied"),
    [(7, (), 20, False), (4, ("",), 60, False), (4, LIMITS, 60, False), (4, LIMITS, 60, True)],
)
def test_sensitivities_of_a_random_tree(joints: int, kinds: tuple[str, ...], samples: int, tied: bool) -> None:
    """By every number of a tree at once, along random directions, and by the starts; with limits, several are met, and
    some at once, with joints that are tied and without.
    """
    rng, fast = np.random.default_rng(11), 10.0 if kinds else 1.0
    text = random_tree(rng, joints, bounded=True)
    text = with_limits(text, rng, *kinds) if kinds else text
    source = loaded(with_ties(text, rng, joints) if tied else text)
    assert source.model.jnt_actfrclimited.any()
    what, parameters = program.read([source])
    initial = 0.2 * rng.normal(size=(1, 2, what.nx))
    initial[..., joints : 2 * joints] *= fast
    initial[..., 2 * joints :] = 0.0
    jobs = jobs_for(parameters, initial, rng.normal(size=(samples, source.model.nu)), samples, joints)
    fixed = dict(what.tree.fixed)
    free = [k for k in range(len(parameters[0])) if k not in fixed and abs(parameters[0, k]) < 1e6]
    links = program.rigid
    free = [k for k in free if not (3 <= k < what.tree.count and (k - links.GRAVITY) % links.LINK < links.GEOMETRY)]
    along, unit = np.zeros((10, parameters.shape[1])), np.zeros((10, *initial.shape[1:]))
    along[:3, free] = rng.normal(size=(3, len(free))) * np.abs(parameters[0, free])
    first, count = int(what.codes[Head.ELEMENT_AT]), int(what.codes[Head.ELEMENTS])
    elements = what.codes[first : first + count * int(Element.SIZE)].reshape(count, -1)
    for rest in elements[elements[:, Element.KIND] == Kind.TIE, Element.NUMBERS]:
        along[:, rest + 1] = along[:, rest]  # there is no way between its ends
    unit[3:] = rng.normal(size=unit[3:].shape)
    readings, changes, _, _ = differentiate(what, jobs, Directions(along, unit), 5e-4)
    np.testing.assert_allclose(readings, run(what, jobs, 5e-4)[0][0], atol=1e-13)
    low, high = source.model.jnt_range.T[..., None]
    assert bool(kinds) == (source.model.jnt_limited.any() and ((readings < low) | (readings > high)).any())
    for k in range(10):
        ends = []
        for size in (1e-6, -1e-6):
            moved = replace(jobs, parameters=parameters + size * along[k], initial=initial + size * unit[k])
            ends.append(run(what, moved, 5e-4)[0][0])
        difference = (ends[0] - ends[1]) / 2e-6
        assert np.abs(changes[k] - difference).max() < 1e-5 * np.abs(difference).max()


# What is not covered


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (('type="hinge" axis="0 1 0" damping="0.0005"', 'type="ball"'), "neither hinge nor slide"),
        (("<sensor>", '<sensor><jointactuatorfrc name="force" joint="cart"/>'), "sensor 'force'"),
        (("<actuator>", '<actuator><intvelocity name="v" joint="cart" actrange="-1 1"/>'), "actuator 'v'"),
        (('<option timestep="0.001"', '<option timestep="0.001" density="1"'), "medium"),
    ],
)
def test_what_is_not_covered_is_named(change: tuple[str, str], why: str) -> None:
    assert change[0] in HANGING
    text = HANGING.replace(*change)
    if "ball" in change[1]:
        text = text.replace('<jointpos name="pole2" joint="pole2"/>', "")
    with pytest.raises(Uncovered, match=why):
        program.read([physics.Physics(mujoco.MjModel.from_xml_string(text))])


def test_what_is_not_covered_runs_on_mujoco() -> None:
    """A medium that is too thin to matter, and limits by a rule that the engine has not, met or not."""
    plain, base = loaded(HANGING), ["cart", "pole1", "pole2"]
    thin = loaded(HANGING.replace('<option timestep="0.001"', '<option timestep="0.001" density="1e-12"'))
    wide, narrow = (
        loaded(HANGING.replace('name="pole1" type="hinge"', f'name="pole1" type="hinge" {ODD} range="{ends}"'))
        for ends in ("-170 170", "-2 2")
    )
    windows = cut([record(plain, sweep(2.0), 0.5)], np.ones(3), 0.25, (0.0, 1.0))
    initial = 0.1 * np.random.default_rng(0).normal(size=(1, len(windows), 6))
    ours, theirs, unmet, met = (
        simulate([one], windows, initial, Stepping(0.001, RK4), base=base)[0] for one in (plain, thin, wide, narrow)
    )
    assert ours == pytest.approx(theirs, abs=1e-9)
    assert np.array_equal(ours, unmet)
    assert np.abs(met - ours).max() > 1e-2
    assert np.abs(met[..., 1]).max() < np.abs(ours[..., 1]).max()


def test_limits_that_no_recording_comes_near_end_what_meets_them() -> None:
    """What is far off may run into a limit, or away without end; MuJoCo need not say what it does there."""
    text = HANGING.replace('name="pole1" type="hinge"', f'name="pole1" type="hinge" {ODD} range="-170 170"')
    source, base = loaded(text), ["cart", "pole1", "pole2"]
    run_away = loaded(text.replace('damping="21.4"', 'damping="-1e6"'))
    moved = record(source, sweep(2.0), 0.5)
    still = np.zeros((len(moved.time), 3))
    for angle, matter in ((0.1, False), (2.95, True)):
        motion = Motion(moved.time, still + np.array([0.0, angle, 0.0]), still, still, np.zeros(3))
        windows = replace(cut([moved], np.ones(3), 0.25, (0.0, 1.0)), motions=(motion,))
        of = compiled([source], windows, base, 0.001)
        assert of._limits_matter is matter
    initial = np.zeros((1, len(windows), 6))
    windows = replace(windows, motions=(Motion(moved.time, still, still, still, np.zeros(3)),))
    (gone,) = simulate([run_away], windows, initial, Stepping(0.001, RK4), base=base)
    assert np.isnan(gone[:, -1]).all()


def test_a_lagging_sum_of_joints_is_mujocos(hanging: object) -> None:
    """An encoder that reads a pole's absolute angle late, through compiled code and through MuJoCo, in which it is the
    same sum behind a medium too thin to matter.
    """
    text = HANGING.replace(
        '<jointpos name="pole2" joint="pole2"/>', '<tendonpos name="pole2" tendon="upright"/>'
    ).replace(
        "<actuator>",
        '<tendon><fixed name="upright"><joint joint="pole1" coef="1"/><joint joint="pole2" coef="1"/></fixed></tendon>'
        "<actuator>",
    )
    assert "tendonpos" in text
    ours, theirs = (
        added(one, "timing.sensor_lag", "pole2", time_constant=0.004)
        for one in (text, text.replace('<option timestep="0.001"', '<option timestep="0.001" density="1e-12"'))
    )
    windows = cut([record(ours, sweep(2.0), 0.5)], np.ones(3), 0.25, (0.0, 1.0))
    initial = 0.1 * np.random.default_rng(0).normal(size=(1, len(windows), 6))
    base = ["cart", "pole1", "pole2"]
    said = [simulate([one], windows, initial, Stepping(5e-5, RK4), base=base)[0] for one in (ours, theirs)]
    assert said[0] == pytest.approx(said[1], abs=1e-6)


def test_variants_of_different_structure_are_refused() -> None:
    with pytest.raises(Uncovered, match="more than numbers"):
        program.read([loaded(CART), added(CART, "friction.stribeck", "cart", level=1.0, static=2.0, velocity=0.1)])


def test_a_simulation_that_diverges_ends_itself_and_no_other() -> None:
    source = loaded(CART)
    broken = physics.Physics(copy.copy(source.model))
    broken.model.dof_damping[:] = -1e5
    what, parameters = program.read([source, broken])
    initial = np.tile([0.0, 0.1], (2, 3, 1))
    initial[0, 1] = np.nan
    readings, _ = run(what, jobs_for(parameters, initial, np.zeros((2, 1)), 50, 1), 0.001)
    assert np.isfinite(readings[0, [0, 2]]).all()
    assert np.isnan(readings[0, 1]).all()
    assert np.isnan(readings[1, :, :, -1]).all()


# The cache


TEXT = 'define double @"twice"(double %x) {\n  %y = fadd double %x, %x\n  ret double %y\n}\n'


def twice(number: float) -> float:
    machine._object.cache_clear()
    library = machine.load([TEXT], ["twice"])
    return float(ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_double)(library.addresses["twice"])(number))


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(machine, "cache_folder", lambda: tmp_path / "engine")
    return tmp_path / "engine"


def test_what_was_compiled_is_kept_and_private(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert twice(2.0) == 4.0
    (entry,) = folder.iterdir()
    assert not stat.S_IMODE(folder.stat().st_mode) & 0o022
    assert not stat.S_IMODE(entry.stat().st_mode) & 0o022
    monkeypatch.setattr(machine, "_compiled", lambda *_: pytest.fail("compiled again"))
    assert twice(3.0) == 6.0


@pytest.mark.parametrize("how", ["cut", "changed", "empty", "link", "writable"])
def test_a_damaged_entry_is_compiled_anew(folder: Path, how: str) -> None:
    twice(2.0)
    (entry,) = folder.iterdir()
    content = entry.read_bytes()
    if how == "cut":
        entry.write_bytes(content[:-10])
    elif how == "changed":
        entry.write_bytes(content[:-1] + bytes([content[-1] ^ 1]))
    elif how == "empty":
        entry.write_bytes(b"")
    elif how == "link":
        entry.rename(folder.parent / "elsewhere")
        entry.symlink_to(folder.parent / "elsewhere")
    else:
        entry.chmod(0o666)
    assert machine._read(entry.name) is None
    assert twice(2.0) == 4.0
    assert machine._read(entry.name) is not None


def test_a_folder_that_others_can_write_to_is_left_alone(folder: Path) -> None:
    folder.mkdir()
    folder.chmod(0o777)
    assert twice(2.0) == 4.0
    assert not list(folder.iterdir())


def test_old_entries_make_room(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machine, "_KEPT", 3)
    folder.mkdir(mode=0o700)
    for age in range(5):
        (folder / f"{age}").write_bytes(b"")
        os.utime(folder / f"{age}", (1e9 - age, 1e9 - age))
    assert twice(2.0) == 4.0
    left = {path.name for path in folder.iterdir()}
    assert len(left) == 3
    assert left > {"0", "1"}


def test_without_a_cache_it_works_as_well(folder: Path) -> None:
    folder.write_text("a file in its place")
    assert twice(2.0) == 4.0
    assert [each.name for each in folder.parent.iterdir()] == ["engine"]


def test_a_law_that_is_more_than_arithmetic_is_left_to_mujoco(monkeypatch: pytest.MonkeyPatch) -> None:
    """A user's law may do anything; the engine leaves it out, and goes on with all others."""
    monkeypatch.setattr(entries, "_known", dict(entries._known))
    physics.register(
        "friction.mine", "friction", lambda data, now: data[..., 0] + np.interp(now.position, [-1, 1], [1, 2])
    )
    entry = '<custom><numeric name="dipc_gym:{}:cart" data="1 2 3"/></custom></mujoco>'
    with pytest.raises(Uncovered, match=r"friction\.mine"):
        program.read([loaded(CART.replace("</mujoco>", entry.format("friction.mine")))])
    _, parameters = program.read([loaded(CART.replace("</mujoco>", entry.format("friction.load")))])
    assert parameters[0][-3:].tolist() == [1, 2, 3]
    assert "friction.mine" not in [rule.effect for rule in program.rules()]


def test_a_spring_with_a_gap_may_be_as_stiff_as_nothing_in_a_variant() -> None:
    """Derivatives are by models beside one whose spring does not bend: an element that comes and goes is none."""
    text = """<mujoco><worldbody><body name="cart">
      <inertial pos="0 0 0" mass="1" diaginertia="1e-3 1e-3 1e-3"/><joint name="cart" type="slide" axis="1 0 0"/>
    </body></worldbody>
    <tendon><fixed name="bend" springlength="-0.1 0.1" stiffness="{}"><joint joint="cart" coef="1"/></fixed></tendon>
    <sensor><jointpos name="cart" joint="cart"/></sensor></mujoco>"""
    variants = [physics.load(text.format(stiffness)) for stiffness in (0.0, 5.0)]
    what, parameters = program.read(variants)
    assert parameters.shape[0] == 2
    for numbers, variant in zip(parameters, variants, strict=True):
        assert check.check(what, numbers, variant)
