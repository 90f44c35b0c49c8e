"""The score: which troubles it takes, what a motor that misbehaves does, and how rates become a number."""

import dataclasses
from pathlib import Path

import gymnasium
import numpy as np
import pytest

from dipc_gym import compensators, controllers, sweep
from dipc_gym.controllers import designs, lqr
from dipc_gym.env import DoublePendulumEnv
from dipc_gym.experiments import compare, score, tables
from dipc_gym.experiments.compare import Comparison
from dipc_gym.plant import Plant, PlantError
from dipc_gym.runs import Impulse, balance
from dipc_gym.wrappers import FaultyMotor, VectorFaultyMotor

MASSES = {"cart": 0.56, "pole1": 0.57, "pole2": 0.128}


def test_a_motor_does_not_hear_of_voltages_that_are_refused() -> None:
    """Else no voltage would be finite any more."""
    env = FaultyMotor(gymnasium.make("DIPC-Friction-v0"), response=0.5)
    envs = VectorFaultyMotor(
        gymnasium.make_vec("DIPC-Friction-v0", 2, vectorization_mode="vector_entry_point"), response=0.5
    )
    for rigs, wrong, right in ((env, [np.nan], [4.0]), (envs, [[1.0], [np.nan]], [[4.0], [4.0]])):
        rigs.reset(seed=1)
        with pytest.raises(ValueError, match="must be a finite number"):
            rigs.step(np.array(wrong))
        assert np.all(np.equal(rigs.step(np.array(right))[4]["voltage"], 2.0))


def test_troubles_are_six_tests_that_include_the_rig_as_it_is():
    found = score.troubles(Plant(), MASSES, values=3, pushes=2)
    counts = {test: sum(trouble.test == test for trouble in found) for test in score.TESTS}
    assert counts == {
        "model": 30, "velocity noise": 3, "force noise": 3, "motor response": 3, "delay": 3, "pushes": 2,
    }  # fmt: skip
    for test in ("velocity noise", "force noise", "delay"):
        first = next(trouble for trouble in found if trouble.test == test)
        assert first.plant == Plant()
    changed = [trouble for trouble in found if trouble.test == "model"]
    for trouble in changed:  # one number at a time: levels of friction, which must stay in order, are one
        parts = [
            (name, key)
            for name in ("motor", "friction", "masses")
            for key, value in dataclasses.asdict(getattr(trouble.plant, name)).items()
            if value != getattr(getattr(Plant(), name), key)
        ]
        assert len(parts) <= 1 or {key for _, key in parts} == {"coulomb", "static"}
    assert found == score.troubles(Plant(), MASSES, values=3, pushes=2)


def test_noise_of_velocity_is_that_of_a_bare_difference():
    largest = score.troubles(Plant(), MASSES, values=2, pushes=0)[21].plant.encoders
    rng = np.random.default_rng(0)
    rate = np.diff(largest.noise * largest.pole * rng.standard_normal(100_000)) / 0.005
    assert rate.std() == pytest.approx(0.5, rel=0.02)


def test_a_rig_whose_motor_is_not_known_has_no_score():
    with pytest.raises(PlantError, match="does not say which they are"):
        score.troubles(Plant(motor=None), MASSES)


def test_the_score_is_the_mean_of_six_rates():
    balancing = Comparison(controllers=("lqr",), compensators=("none",)).balancings(
        {(seed, "none"): compensators.StaticGain(4.0).to_dict() for seed in range(10)}
    )[0]
    outcomes = []
    for i, test in enumerate(score.TESTS):
        cell = score.Scoring(balancing=balancing, test=test, masses=MASSES)
        runs = [{"what": "", "survived": k < i, "seconds": 1.0} for k in range(5)]
        outcomes.append(sweep.Outcome(cell, runs, None))
    held = score.summarise(outcomes, [("lqr", "none")])
    assert held["rows"][0]["score"] == pytest.approx(np.mean([0, 0.2, 0.4, 0.6, 0.8, 1.0]))
    assert "0.500" in score.table(held)
    assert score.summarise(outcomes[:5], [("lqr", "none")])["rows"] == []


def test_a_scoring_cell_balances_under_its_troubles():
    comparison = Comparison(controllers=("lqr",), compensators=("none",), seeds=1)
    trained = {(0, "none"): compensators.StaticGain(4.0).to_dict()}
    cell = score.Scoring(
        balancing=comparison.balancings(trained)[0], test="delay", masses=comparison.masses(), values=2
    )
    as_it_is, late = cell.run()
    assert (as_it_is["what"], as_it_is["survived"]) == ("0 ms", True)
    assert late["what"] == "40 ms"


@pytest.mark.parametrize("test", ["velocity noise", "force noise", "motor response", "delay"])
def test_runs_at_once_are_runs_one_by_one(test, monkeypatch):
    comparison = Comparison(controllers=("lqr",), compensators=("none",), seeds=1)
    trained = {(0, "none"): compensators.StaticGain(4.0).to_dict()}
    cell = score.Scoring(balancing=comparison.balancings(trained)[0], test=test, masses=comparison.masses(), values=3)
    monkeypatch.setattr(score, "SECONDS", 2.0)
    at_once = cell.run()
    monkeypatch.setattr(score.Scoring, "_batched", False)
    assert cell.run() == at_once


@pytest.mark.parametrize(("response", "applied"), [(0.5, [2.0, 3.0, 3.5]), (1.5, [6.0, 3.0, 4.5])])
def test_a_motor_lags_or_overshoots(response, applied):
    env = FaultyMotor(gymnasium.make("DIPC-Friction-v0"), response=response)
    env.reset(seed=1)
    assert [env.step([4.0])[4]["voltage"] for _ in range(3)] == applied
    env.reset(seed=1)
    assert env.step([4.0])[4]["voltage"] == applied[0]


@pytest.mark.parametrize("response", [0.0, 2.1, float("nan"), float("inf")])
def test_a_motor_whose_response_does_not_settle_is_refused(response):
    with pytest.raises(ValueError, match="above 0 and at most 2"):
        FaultyMotor(gymnasium.make("DIPC-Friction-v0"), response=response)
    envs = gymnasium.make_vec("DIPC-Friction-v0", 2, vectorization_mode="vector_entry_point")
    with pytest.raises(ValueError, match="above 0 and at most 2"):
        VectorFaultyMotor(envs, response=np.array([1.0, response]))


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_motors_misbehave_in_a_row_as_they_do_alone_also_after_an_episode(mode):
    many = {"vectorization_mode": "vector_entry_point", "autoreset_mode": mode}
    rows = VectorFaultyMotor(gymnasium.make_vec("DIPC-Friction-v0", 2, max_episode_steps=4, **many), noise=0.5)
    alone = FaultyMotor(gymnasium.make("DIPC-Friction-v0", max_episode_steps=4), noise=0.5)
    rows.reset(seed=5)
    alone.reset(seed=5)
    episodes = 0
    while episodes < 3:
        said = rows.step(np.ones((2, 1)))[4]
        if rows.unwrapped.began[0] and mode == "NextStep":
            continue  # this step began the episode
        *_, over, info = alone.step([1.0])
        said = said.get("final_info", said) if over else said
        assert said["voltage"][0] == info["voltage"]
        if over:
            alone.reset()
            episodes += 1


@pytest.mark.parametrize(("name", "value"), [("noise", -1.0), ("noise", np.nan), ("response", 0.0)])
def test_an_impossible_motor_is_refused(name, value):
    with pytest.raises(ValueError, match=name):
        FaultyMotor(gymnasium.make("DIPC-Friction-v0"), **{name: value})


def test_several_blows_add_up():
    """Without friction or gain, two blows of 0.1 N s are one of 0.2 at the cart's speed just afterwards."""
    brain = lqr.LQR(np.zeros(6))
    plain = compensators.StaticGain(4.0)
    runs = [balance(brain, plain, seconds=0.02, seed=1, exact_state=True, impulse=blows) for blows in (
        Impulse(0.2, 0.01), [Impulse(0.1, 0.01), Impulse(0.1, 0.015)],
    )]  # fmt: skip
    assert runs[1].state[2, 3] < runs[0].state[2, 3]
    assert runs[1].state[3, 3] > runs[1].state[2, 3] * 0.5


def test_blows_of_one_moment_add_up_and_none_is_lost():
    brain, plain = lqr.LQR(np.zeros(6)), compensators.StaticGain(4.0)
    whole, halves = (
        balance(brain, plain, seconds=0.02, seed=1, exact_state=True, impulse=blows)
        for blows in ([Impulse(0.25, 0.01)], [Impulse(0.125, 0.01), Impulse(0.125, 0.0101)])
    )
    np.testing.assert_array_equal(whole.state, halves.state)
    for moment in (0.5, -0.01):
        with pytest.raises(ValueError, match="must fall within"):
            balance(brain, plain, seconds=0.02, seed=1, impulse=Impulse(0.1, moment))


def test_a_dither_begins_anew_with_each_run():
    shaking, plain = designs.Dither(amplitude=5.0, half=3), compensators.StaticGain(4.0)
    runs = [balance(shaking, plain, seconds=0.05, seed=1) for _ in range(2)]
    np.testing.assert_array_equal(runs[0].force, runs[1].force)


def test_a_run_of_one_period_holds_or_does_not():
    one = balance(lqr.LQR(np.zeros(6)), compensators.StaticGain(4.0), seconds=0.005, seed=1)
    assert one.held("up-up") == one.lasted == 0.0
    longer = balance(lqr.LQR(np.zeros(6)), compensators.StaticGain(4.0), seconds=0.05, seed=1)
    assert longer.held("up-up") == pytest.approx(0.05)
    assert longer.held("down-down") == 0.0


# Designs of the controller


def test_the_describing_function_foretells_the_limit_cycle():
    """Amplitude of the cart under the printed gain, exact state, Coulomb friction alone: within a quarter."""
    plant = Plant.from_dict({"friction": {"coulomb": 8.0, "static": 8.0}})
    run = balance(lqr.LQR(), compensators.StaticGain(4.0), seconds=12.0, seed=1, exact_state=True, plant=plant)
    late = run.state[run.time > 6, 0]
    foretold = designs.limit_cycle(lqr.PRINTED_GAIN, 8.0)
    assert np.abs(late).max() == pytest.approx(foretold.cart, rel=0.25)
    crossings = np.flatnonzero((late[:-1] < 0) & (late[1:] >= 0))
    assert np.pi * 2 / (np.diff(crossings).mean() * 0.005) == pytest.approx(foretold.rate, rel=0.15)


def test_every_gain_has_its_limit_cycle_and_the_quiet_one_the_smallest():
    found = {name: designs.limit_cycle(controllers.load(name).gain, 8.0).cart for name in designs.DESIGNS}
    assert all(amplitude > 0.005 for amplitude in found.values())
    assert min(found, key=found.get) == "lqr_quiet"


def test_designed_gains_hold_the_rig_they_are_for():
    A, B = designs.paper_model()
    model = DoublePendulumEnv().model
    np.testing.assert_array_equal(A, lqr.linear_model(model)[0])
    F, G = lqr.sampled(A, B, designs.PERIOD)
    for name in ("lqr_sampled", "lqr_cart", "lqr_quiet"):
        assert np.abs(np.linalg.eigvals(F - G @ controllers.load(name).gain[None])).max() < 1
        assert controllers.load(name).name == name


def test_dither_goes_on_from_call_to_call():
    shaking = designs.Dither(amplitude=5.0, half=2)
    assert [shaking.force(np.zeros(6)) for _ in range(6)] == [5.0, 5.0, -5.0, -5.0, 5.0, 5.0]


# In a comparison


def test_estimators_stand_in_the_table_with_what_they_can_feed(tmp_path):
    comparison = Comparison(
        compensators=("none", "observed"), estimators=("differences", "disturbance"), seeds=2, seconds=0.5
    )
    pairs = [("lqr", "none"), ("lqr+disturbance", "none"), ("lqr+disturbance", "observed")]
    assert comparison.pairs() == pairs
    summary = compare.run(comparison, tmp_path / "out", jobs=1)
    assert [(row["controller"], row["compensator"]) for row in summary["rows"]] == pairs
    assert summary["failures"] == {}
    assert any("without differences" in note for note in summary["notes"])
    first = summary["against_first"]
    assert [(row["controller"], row["rigs"]) for row in first] == [("lqr+disturbance", 2)] * 2
    assert all(row["low"] <= row["cost_ratio"] <= row["high"] for row in first)
    assert "against lqr, none: lqr+disturbance, observed costs" in (tmp_path / "out" / "table.txt").read_text()


def test_intervals_are_those_of_the_t_distribution():
    cells = [
        {"controller": "lqr", "compensator": name, "seed": seed, "cost": cost, "survived": True}
        for name, costs in (("none", (10.0, 10.0, 10.0)), ("llnf", (1.0, 2.0, 4.0)))
        for seed, cost in enumerate(costs)
    ]
    (row,) = tables.against_first(cells, [("lqr", "none"), ("lqr", "llnf")])
    assert row["cost_ratio"] == pytest.approx(0.2)
    assert row["high"] / row["cost_ratio"] == pytest.approx(np.exp(4.302653 * np.log(2) / np.sqrt(3)), rel=1e-6)


@pytest.mark.parametrize("estimators", [(), ("kalmann",)])
def test_unknown_estimators_are_refused(estimators):
    with pytest.raises(ValueError, match=r"give one or more|no estimator 'kalmann'"):
        Comparison(estimators=estimators).check()


def test_a_rig_that_the_score_cannot_change_is_refused_at_once(tmp_path: Path) -> None:
    """Its masses are those of bodies by name, and of their own elements."""
    other = tmp_path / "other.xml"
    other.write_text(DoublePendulumEnv().source.text.replace('body name="pole2"', 'body name="upper"'))
    asked = Comparison(seeds=1, seconds=1.0, model=str(other), robustness=("score",))
    with pytest.raises(ValueError, match=r"called cart, pole1, pole2, and there is no 'pole2'; name the bodies so"):
        asked.check()
