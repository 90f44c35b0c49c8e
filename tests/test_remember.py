"""Laws that remember: springs that creep, hysteresis of any shape, friction that grows at rest."""

from __future__ import annotations

import copy
import pickle
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from sim2real_rigs import CART, RK4, prepared, record, sweep

from dipc_gym import mjcf, physics, recording
from dipc_gym.engine import Uncovered, program
from dipc_gym.engine.check import check
from dipc_gym.engine.remember import recall
from dipc_gym.engine.run import Commands, Jobs
from dipc_gym.engine.run import run as engine_run
from dipc_gym.mjcf.edit import Document
from dipc_gym.physics import entries
from dipc_gym.sim2real import catalogue, diagnose
from dipc_gym.sim2real.effects.friction_hysteresis_law import HysteresisOfAnyLaw
from dipc_gym.sim2real.effects.friction_resting_law import RestingOfAnyLaw
from dipc_gym.sim2real.effects.load_creeping_law import CreepingSpringOfAnyLaw
from dipc_gym.sim2real.effects.motor_sag_law import SagOfAnyLaw
from dipc_gym.sim2real.effects.unknown_recent import UnknownRecent
from dipc_gym.sim2real.estimation import unexplained
from dipc_gym.sim2real.estimation.fit import fit
from dipc_gym.sim2real.estimation.problem import predict, sensitivities
from dipc_gym.sim2real.model.structure import Term
from dipc_gym.sim2real.selection.baseline import baseline
from dipc_gym.sim2real.selection.beginnings import foretold
from dipc_gym.sim2real.selection.case import Given, part
from dipc_gym.sim2real.simulation.batch import Stepping
from dipc_gym.sim2real.simulation.memory import memories
from dipc_gym.sim2real.simulation.motion import Motion
from dipc_gym.trials import generate
from dipc_gym.trials.secret import Plan

CREEPS = (60.0, 0.05, 0.0, 0.01, 0.04, 0.15)  # N/m, m, and m/s at equal stretches up to there
BENDS = (4.0, 950.0, 930.0, 900.0, 500.0, 0.0)  # N, and N/m at equal forces from -4 to 4 N
RESTS = (1.5, 2.0, 0.12, 3e-4)  # N, N, s and m/s
SEEDS = {"load.creeping": 3, "friction.hysteresis": 3, "friction.resting": 5}
ENTRIES = {"load.creeping": CREEPS, "friction.hysteresis": BENDS, "friction.resting": RESTS}
SAGS = {"drop": 0.3, "time_constant": 0.3, "current": 3.0, "gain": 3.94, "back": 4.72}  # of the cart's own motor
SAGS_BY_LAW = {"time_constant": 0.3, "more_1": 0.05, "more_2": 0.2, "current": 5.0, "gain": 3.94, "back": 4.72}
RESTS_BY_LAW = {"level": 1.5, "longest": 0.5, "slow": 3e-4, "more_1": 1.0, "more_2": 0.8}
REMEMBER = [
    *ENTRIES,
    "friction.rested_by_law",
    "motor.sag",
    "motor.sag_by_law",
]  # sags go with commands, too


def with_entry(effect: str, numbers: tuple[float, ...] | None = None, text: str = CART) -> physics.Physics:
    return physics.load(text_with(effect, numbers, text))


def text_with(effect: str, numbers: tuple[float, ...] | None = None, text: str = CART) -> str:
    document = Document(mjcf.from_text(text))
    if numbers is None:
        one = term(effect)
        one.effect.edit(document, one.at, one.guess)
    else:
        document.remembering(effect, "cart", numbers)
    return document.text()


def term(effect: str) -> Term:
    """The effect with the numbers of its entry."""
    if effect == "motor.sag":
        return Term(catalogue()[effect], "motor", SAGS)
    if effect == "motor.sag_by_law":
        return Term(SagOfAnyLaw(SAGS_BY_LAW), "motor", SAGS_BY_LAW)
    if effect == "friction.rested_by_law":
        return Term(RestingOfAnyLaw(RESTS_BY_LAW), "cart", RESTS_BY_LAW)
    if effect == "friction.resting":
        return Term(catalogue()[effect], "cart", dict(zip(("level", "rise", "time", "slow"), RESTS, strict=True)))
    if effect == "load.creeping":
        first = {"stiffness": CREEPS[0]} | {f"faster_{k + 1}": v for k, v in enumerate(np.diff(CREEPS[2:]))}
        return Term(CreepingSpringOfAnyLaw(CREEPS[1], first), "cart", first)
    first = {"bound": BENDS[0]} | {f"fall_{k + 1}": v for k, v in enumerate(-np.diff(BENDS[1:]))}
    return Term(HysteresisOfAnyLaw(first), "cart", first)


def waving(seed: int, count: int = 400) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A motion with turns and rests: time, position and velocity, straight between samples."""
    rng = np.random.default_rng(seed)
    time = np.arange(count) * 2e-3
    velocity = np.interp(time, np.linspace(0, time[-1], 12), rng.normal(size=12) * rng.integers(0, 2, 12))
    position = np.append(0.0, np.cumsum(2e-3 * (velocity[1:] + velocity[:-1]) / 2))
    return time, position, velocity


@pytest.mark.parametrize("effect", ENTRIES)
def test_what_is_remembered_is_the_integral_of_its_rate(effect: str) -> None:
    time, position, velocity = waving(3)
    entry = physics.entry_of(effect)
    assert entry is not None
    assert entry.memory is not None
    rate, data = entry.memory, np.array(ENTRIES[effect])

    def slope(t: float, memory: np.ndarray) -> list[float]:
        now = physics.Moment(*(np.zeros(()) for _ in range(5)), speed=np.interp(t, time, velocity), memory=memory[0])
        return [float(rate(data, now))]

    by_hand = solve_ivp(slope, (0, time[-1]), [0.0], t_eval=time, rtol=1e-8, atol=1e-10, max_step=1e-3)
    (found,) = recall(effect, data[None], time, position, velocity)
    off = np.abs(found - by_hand.y[0]).max() / np.abs(by_hand.y[0]).max()
    assert off < (0.02 if effect == "friction.resting" else 1e-3)  # where a rest ends within a step, its rate jumps


@settings(max_examples=100, deadline=None)
@given(
    st.integers(0, 10_000),
    st.lists(st.floats(0.0, 50.0), min_size=2, max_size=12),
    st.floats(1e-3, 10.0),
    st.sampled_from(["load.creeping", "friction.hysteresis"]),
)
def test_over_any_motion_they_take_energy_and_give_none(
    seed: int, shape: list[float], size: float, effect: str
) -> None:
    """From rest on, whatever their tables: work done against them is never less than nothing."""
    time, position, velocity = waving(seed)
    if effect == "load.creeping":
        numbers = np.array([1.0, size, 0.0, *np.clip(np.cumsum(shape), 0, 250 * size)])
    else:
        numbers = np.array([size, *(size * np.cumsum(shape)[::-1]), 0.0])
    extra = physics.Extra(effect, "cart", "force", 0, numbers, slot=0)
    assert entries.fault(extra) is None
    (memory,) = recall(effect, numbers[None], time, position, velocity)
    against = memory  # N, of a stiffness of 1 N/m where it is a stretch
    work = np.concatenate([[0.0], np.cumsum(2e-3 * (against * velocity)[:-1])])
    assert work.min() >= -2e-2 * np.abs(against * velocity).max() * time[-1]
    if effect == "friction.hysteresis":
        assert np.abs(memory).max() <= size * (1 + 1e-3)


@pytest.mark.parametrize("effect", REMEMBER)
def test_the_engine_says_what_mujoco_says(effect: str) -> None:
    """Rates at random states; and a second that MuJoCo simulates, at ever finer steps."""
    rig = with_entry(effect)
    what, numbers = program.read([rig])
    assert check(what, numbers[0], rig)
    off = []
    for step in (4e-4, 1e-4):
        model = copy.copy(rig.model)
        model.opt.timestep, model.opt.integrator = step, RK4 if "friction.rest" not in effect else model.opt.integrator
        fine, data = physics.Physics(model, rig.extras), mujoco.MjData(model)
        track = []
        for k in range(round(1.0 / 0.01)):
            track.append(data.qpos[0])
            fine.step(data, np.array([sweep(4.0)(0.01 * k)]), round(0.01 / step))
        count = len(track)
        held = Commands(0.01 * np.arange(count), np.array([[[sweep(4.0)(0.01 * k)] for k in range(count)]]))
        zero, times = np.zeros(1, dtype=np.int64), 0.01 * np.arange(count)[None, None]
        begin = np.zeros((1, 1, what.nx))
        jobs = Jobs(numbers, begin, np.zeros(1), zero, np.full(1, count), held, zero, times, np.full(1, 1.0))
        readings, _ = engine_run(what, jobs, 5e-4)
        off.append(np.abs(readings[0, 0, 0] - track).max() / np.ptp(track))
    assert off[1] < 2e-3
    assert off[1] < max(off[0], 2e-4)


@pytest.mark.parametrize("step", [0.01, 0.02, 0.05])
def test_a_long_step_follows_what_is_forgotten_at_once(step: float) -> None:
    """Rest is forgotten within 4 ms of going on; in steps of 10 ms that swung up, until an exponential overflowed."""
    rig = with_entry("friction.resting")
    rig.model.opt.timestep, data = step, mujoco.MjData(rig.model)
    (extra,) = rig.remembering
    for k in range(round(4.0 / step)):
        rig.step(data, np.array([sweep(4.0)(k * step)]))
        assert 0 <= data.userdata[extra.slot] <= (k + 1) * step


@pytest.mark.parametrize("effect", REMEMBER)
def test_sensitivities_are_limits_of_differences(effect: str) -> None:
    ready = prepared(CART, [record(with_entry(effect), sweep(4.0), 2.0, noise=(1e-5,))])
    problem, structure = ready.problem, ready.structure.with_term(term(effect))
    z, initial = structure.first, problem.initial
    found = sensitivities(problem, structure, z, [z + 1e-7 * unit for unit in np.eye(len(z))], initial)
    assert found is not None
    _, by_parameters, _ = found
    size = 1e-5
    moved = [z + sign * size * unit for unit in np.eye(len(z)) for sign in (1, -1)]
    said = predict(problem, structure, moved, np.repeat(initial[None], len(moved), axis=0))
    for exact, difference in zip(by_parameters, (said[::2] - said[1::2]) / (2 * size), strict=True):
        if np.abs(difference).max() > 1e-9:
            off = np.abs(exact - difference).max(axis=(1, 2)) / np.abs(difference).max()
            assert np.median(off) < 1e-3


@pytest.mark.parametrize("effect", REMEMBER)
def test_windows_begin_with_what_the_motion_before_left(effect: str) -> None:
    ready = prepared(CART, [record(with_entry(effect), sweep(4.0), noise=(1e-5,), step=1e-4)])
    right = fit(ready.problem, ready.structure.with_term(term(effect)), most=0)
    without = fit(ready.problem, ready.structure, most=0)
    assert without.error > 20
    assert np.sqrt(np.median(right.mse)) < 2


@pytest.mark.parametrize("coupling", ["transmission.backlash", "transmission.compliance"])
@pytest.mark.parametrize("effect", REMEMBER)
def test_windows_begin_with_it_also_behind_a_coupling(effect: str, coupling: str) -> None:
    """A supply that sags drives the rotor, of which no recording has a motion: it goes with the joint that it leads."""
    play = catalogue()[coupling]
    ready = prepared(CART, [record(with_entry(effect), sweep(4.0), 3.0, noise=(1e-5,))])
    stiff = {"gap": 1e-5, "contact_rate": 900.0, "stiffness": 4e5, "damping": 50.0}
    hidden = Term(play, "motor", {p.name: stiff.get(p.name, 0.3) for p in play.parameters})
    errors = []
    for terms in ([term(effect), hidden], [hidden, term(effect)], [hidden]):
        structure = ready.structure
        for one in terms:
            structure = structure.with_term(one)
        errors.append(np.median(fit(ready.problem, structure, most=0).mse))
    assert errors[0] == pytest.approx(errors[1])
    assert 4 * errors[0] < errors[2]


@pytest.mark.parametrize("effect", ENTRIES)
def test_a_diagnosis_finds_it_and_the_file_holds_it(effect: str, tmp_path: Path) -> None:
    """Hidden by a simulator that is written apart, and told from what it is easily mistaken for."""
    (tmp_path / "sealed").mkdir()
    generate.make_trial(tmp_path, Plan(1, "single", "cart", effect, False, effect != "friction.resting"), SEEDS[effect])
    folder = tmp_path / "trials" / "t001_cart"
    model = mjcf.compile(folder / "nominal.xml")
    first, second, test = (recording.read(folder / f"{name}.csv", model) for name in ("train_1", "train_2", "test"))
    names = [one for one in catalogue().values() if one.name in ENTRIES]
    names += [catalogue()[name] for name in ("friction.coulomb", "load.spring", "friction.stribeck")]
    found = diagnose(folder / "nominal.xml", [first, second], [test], effects=names)
    assert (found.missing[0].effect, found.missing[0].at) == (effect, "cart")
    assert found.held_out is not None
    assert found.held_out.improved < min(2.0, 0.1 * found.held_out.recalibrated)
    (extra,) = physics.load(found.improved).remembering
    assert extra.effect == effect
    assert found.to_dict()["needs_dipc_gym"]
    assert bool(found.needs_loader) == bool(physics.load(found.improved).extras)


def test_a_rest_is_told_through_the_noise_of_a_reading() -> None:
    """A velocity that was estimated at rest is never nothing; ten times that is a motion."""
    rig = with_entry("friction.resting")
    time = np.arange(0.0, 0.5, 2e-3)
    noise = 10 * RESTS[3] * np.random.default_rng(2).uniform(-1, 1, len(time))
    none = np.zeros((len(time), 1))
    run = recording.Recording("run", time, none, none, ("motor",), ("cart",))
    for velocity, age in ((noise, 0.3), (noise + np.where(time > 0.2, 100 * RESTS[3], 0.0), 0.0)):
        motion = Motion(time, none, velocity[:, None], none, np.zeros(1))
        (found,) = memories([rig], 0, np.zeros((1, 1)), run, motion, np.array([0.3]))
        assert found[0] == pytest.approx(age, abs=5e-3)


def with_pauses(t: float) -> float:
    """A sweep with three rests, each ended by a voltage that grows."""
    for begin, end in ((5.0, 5.4), (8.0, 8.2), (10.1, 10.9)):
        if begin <= t < end + 0.4:
            return 6.0 * max(t - end, 0.0) / 0.4
    return sweep(5.0)(t)


def test_what_few_rests_show_is_found_and_what_none_shows_is_left_open() -> None:
    """All other windows are at the noise with Coulomb friction, and a push would do in those few."""
    few = [catalogue()[name] for name in ("friction.coulomb", "friction.stribeck", "friction.resting")]
    few.append(catalogue()["disturbance.pulse"])
    rests, none = (
        diagnose(
            mjcf.from_text(CART),
            [record(with_entry("friction.resting"), command, 12.0, noise=(5e-5,), step=1e-4)],
            effects=few,
            threads=1,
        )
        for command in (with_pauses, sweep(5.0))
    )
    assert [missing.effect for missing in rests.missing] == ["friction.resting"]
    assert rests.held_out is not None
    assert rests.held_out.improved < 1.05
    assert [missing.effect for missing in none.missing] == ["friction.coulomb"]
    assert {"effect": "friction.resting", "at": "cart"} in none.missing[0].same_here
    assert "record rests of" in none.next_experiment


@pytest.mark.parametrize("name", ["velocity cart", "command motor"])
def test_what_has_no_name_may_depend_on_what_was_of_late(name: str) -> None:
    """A mean of the size of a velocity or a command, which fades: a step of it is reached by an exponential."""
    law = UnknownRecent([0.0, 0.2, 0.6], [-1.0, -2.0, -4.0], (name, name), 1.0, 2.0, ("m/s", "m/s"), 0.5)
    document = Document(mjcf.from_text(CART))
    law.edit(document, "cart", law.guess)
    rig = physics.load(document.text())
    what, numbers = program.read([rig])
    assert check(what, numbers[0], rig)
    time = np.linspace(0.0, 2.0, 1001)
    zero = 0 * time
    (mean,) = recall(physics.RECENT, np.array([[0.5]]), time, zero, zero, zero - 3.0)
    np.testing.assert_allclose(mean, 3.0 * (1 - np.exp(-time / 0.5)), atol=1e-6)


def thinning(values: list[float]) -> UnknownRecent:
    """Drag that thins as its cart moves, by values at the square roots of its recent speed, each for 1 m/s."""
    knots = np.linspace(0.0, 0.8, len(values)).tolist()
    return UnknownRecent(knots, values, ("velocity cart",) * 2, 1.0, 2.0, ("m/s", "m/s"), 0.5)


def test_a_law_of_the_past_that_ends_with_its_data_remembers_as_long() -> None:
    law = thinning([-20.0, -18.0, -12.0, -8.0, -5.0, -3.0])
    values = {**law.guess, "time_constant": 1.7}
    told = np.array([False, True, True, True, False, False, True])
    shorter = law.shortened(values, told)
    assert shorter is not None
    assert shorter[0].parameters[-1].name == "time_constant"
    assert shorter[1] == {"value_1": -20.0, "value_2": -18.0, "value_3": -12.0, "value_4": -8.0, "time_constant": 1.7}


def test_a_law_of_the_past_is_told_by_how_recordings_begin() -> None:
    """At rest: later nothing says what it is near nothing, and a recording that begins in motion never does."""
    law = thinning([-20.0, -18.0, -12.0, -8.0, -5.0, -3.0])
    document = Document(mjcf.from_text(CART))
    law.edit(document, "cart", law.guess)
    rested = record(physics.load(document.text()), sweep(5.0), noise=(1e-5,), step=1e-4)
    moving = replace(rested, **{of: getattr(rested, of)[100:] for of in ("time", "commands", "sensors")})
    source = mjcf.from_text(CART)
    cases = [part(Given(source, physics.load(source), (run,), (), ()), threads=1) for run in (rested, moving)]
    assert [len(case.first.windows) for case in cases] == [1, 0]
    case = cases[0]
    assert case.first.windows.start.tolist() == [0.0]
    assert case.prepared.problem.windows.start.min() > 0.2

    partition = baseline(case).partition
    plain = case.prepared.structure
    past = plain.with_term(Term(law, "cart", law.guess))
    whole, more = (partition.whole(fit(partition.problem, structure, most=0)).problem for structure in (plain, past))
    assert len(more.windows) == len(whole.windows) + 1
    begin = past.first.copy()
    begin[0] = past.slots[0].mapped(-16.0)
    far, near = (past.slots[0].value(fit(problem, past, begin).z[0]) + 20.0 for problem in (whole, more))
    assert abs(near) < 0.2
    assert abs(near) < 0.2 * abs(far)


def test_a_load_that_may_swing_already_is_foretold_by_no_rest() -> None:
    ready = prepared(CART, [record(physics.load(CART), sweep(4.0), 2.0, noise=(1e-5,))])
    assert foretold(fit(ready.problem, ready.structure, most=0))
    swinging = catalogue()["load.swinging"]
    guess = {
        p.name: {"mass": 0.1, "frequency": 3.0, "damping_ratio": 0.1}.get(p.name, 0.1) for p in swinging.parameters
    }
    assert not foretold(fit(ready.problem, ready.structure.with_term(Term(swinging, "cart", guess)), most=0))


def test_what_only_beginnings_show_is_found_or_told() -> None:
    """Drag that is gone once the cart moves: all later windows are at the noise."""
    law = thinning((-30.0 * np.exp(-(np.linspace(0.0, 0.8, 25) ** 2) / 0.03)).tolist())
    document = Document(mjcf.from_text(CART))
    law.edit(document, "cart", law.guess)
    rig = physics.load(document.text())
    runs = [record(rig, sweep(strength), 6.0, noise=(5e-5,)) for strength in (5.0, 7.0, 6.0)]
    few = [catalogue()[name] for name in ("friction.coulomb", "residual.force:recent")]
    with_law, without = (diagnose(mjcf.from_text(CART), runs, effects=asked, threads=1) for asked in (few, few[:1]))
    assert with_law.verdict == "modelled"
    (found,) = with_law.missing
    assert "how large that was in the last 0.5 s" in found.sentence
    assert found.law["table"]["levels"][0][1] / found.law["table"]["inputs"][1]["knots"][1] == pytest.approx(-30, abs=3)
    assert without.verdict == "consistent", without.sentence
    assert any(note.startswith("The first moments of recordings") for note in without.notes)
    assert not any(note.startswith("The first moments of recordings") for note in with_law.notes)


def test_a_memory_of_somebodys_own_may_do_anything(monkeypatch: pytest.MonkeyPatch) -> None:
    """One that becomes no machine code is stepped; MuJoCo then simulates the model."""
    monkeypatch.setattr(entries, "_known", dict(entries._known))
    physics.register(
        "load.mine",
        "force",
        lambda data, now: -data[..., 0] * now.memory,
        memory=lambda data, now: np.interp(now.speed, [-9, 9], [-9, 9]) - now.memory / data[..., 1],
    )
    physics.register("load.same", "force", lambda data, now: -data[..., 0] * now.memory, memory=own_creep)
    time, position, velocity = waving(5)
    mine, same = (recall(f"load.{one}", np.array([[9.0, 0.2]]), time, position, velocity) for one in ("mine", "same"))
    np.testing.assert_allclose(mine, same, atol=1e-4 * np.abs(same).max())
    rig = with_entry("load.mine", (9.0, 0.2))
    with pytest.raises(Uncovered, match=r"load\.mine"):
        program.read([rig])
    ready = prepared(text_with("load.mine", (9.0, 0.2)), [record(rig, sweep(4.0), 1.0, noise=(1e-5,))])
    assert fit(ready.problem, ready.structure, most=0).error < 5


def own_creep(data: np.ndarray, now: physics.Moment) -> np.ndarray:
    """Maxwell's element, in arithmetic."""
    return now.speed - now.memory / data[..., 1]


def test_a_force_of_what_was_of_late_names_one_input() -> None:
    table = "0.5 2 2 2 0 1 -1 1 1 -1 2 -2"
    entry = f'<custom><numeric name="dipc_gym:residual.recent:cart" data="{table}"/></custom><size nuserdata="1"/>'
    with pytest.raises(mjcf.MjcfError, match="out of range"):
        physics.load(CART.replace("</mujoco>", f"{entry}</mujoco>"))


def test_a_supply_may_sag_by_another_law_than_in_proportion() -> None:
    """Hardly under little, and much under much: a law from its first guess says so, and a share for each ampere not."""
    run = record(with_entry("motor.sag_by_law"), sweep(9.0), 12.0, noise=(1e-5,), step=2e-4, integrator=RK4)
    ready = prepared(CART, [run], stepping=Stepping(0.002, RK4))
    evidence = unexplained.scene(physics.load(CART), [run], ready.motions).at("actuator", "motor", {})
    left = {}
    for effect in ("motor.sag", "motor.sag:law"):
        guesses = [Term(shaped, "motor", begin) for shaped, begin in catalogue()[effect].proposals(evidence)]
        left[effect] = min(
            (fit(ready.problem, ready.structure.with_term(one)) for one in guesses), key=lambda x: x.error
        )
    law, plain = left["motor.sag:law"], left["motor.sag"]
    (finer, begin), *_ = law.structure.terms[-1].effect.finer(law.structure.term_values(law.z, law.structure.terms[-1]))
    again = fit(ready.problem, ready.structure.with_term(Term(finer, "motor", begin)))
    assert law.error < 0.25 * plain.error  # its first stretch holds both knots of the law that is hidden
    assert again.error < 0.06 * plain.error
    assert again.structure.values(again.z)["motor.sag:law@motor.time_constant"] == pytest.approx(0.3, rel=0.05)


def test_what_is_remembered_goes_along_with_the_state() -> None:
    """A reset forgets; a copy and a pickle of the state do not."""
    rig = with_entry("load.creeping")
    data = mujoco.MjData(rig.model)
    for _ in range(100):
        rig.step(data, np.array([5.0]))
    twin = pickle.loads(pickle.dumps(data))
    assert twin.userdata[0] == data.userdata[0] != 0.0
    for one in (data, twin):
        rig.step(one, np.array([-5.0]), 50)
    assert twin.qpos[0] == data.qpos[0]
    mujoco.mj_resetData(rig.model, data)
    assert data.userdata[0] == 0.0


def test_room_for_it_is_made_beside_what_the_user_keeps() -> None:
    text = CART.replace("<worldbody>", '<size nuserdata="3"/><worldbody>', 1)
    rig = with_entry("load.creeping", text=text)
    assert rig.model.nuserdata == 4
    (extra,) = rig.remembering
    assert extra.slot == 3


@pytest.mark.parametrize(
    ("effect", "numbers", "why"),
    [
        ("load.creeping", (-1.0, 0.1, 0.0, 1.0, 2.0), "out of range"),
        ("load.creeping", (1.0, 0.0, 0.0, 1.0, 2.0), "out of range"),
        ("load.creeping", (1.0, 0.1, 0.0, -1.0, 2.0), "out of range"),
        ("friction.hysteresis", (1.0, 1.0, 2.0, 0.0), "out of range"),
        ("friction.hysteresis", (1.0, 2.0, 1.0, 0.5), "out of range"),
        ("friction.hysteresis", (0.0, 2.0, 1.0, 0.0), "out of range"),
        ("friction.resting", (1.0, 2.0, 0.0, 1e-3), "out of range"),
        ("friction.resting", (1.0, 2.0, 0.1, float("nan")), "out of range"),
        ("friction.rested_by_law", (1.0, 0.5, 0.0, 1e-3, 0.0, 0.2), "out of range; .*longest, soon, slow"),
        ("friction.rested_by_law", (1.0, 0.5, 0.05, 1e-3, 0.0), "too few"),
    ],
)
def test_a_law_that_would_give_energy_away_or_no_number_is_refused(
    effect: str, numbers: tuple[float, ...], why: str
) -> None:
    with pytest.raises(mjcf.MjcfError, match=why):
        with_entry(effect, numbers)


def test_a_file_without_room_for_it_is_refused_with_the_mend() -> None:
    text = CART.replace(
        "</mujoco>", '<custom><numeric name="dipc_gym:load.creeping:cart" data="1 0.1 0 1 2"/></custom></mujoco>'
    )
    with pytest.raises(mjcf.MjcfError, match='write <size nuserdata="1"/>'):
        physics.load(text)
