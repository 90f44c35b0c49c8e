"""Learning by imitation: what the teacher says, and what a network makes of it."""

from __future__ import annotations

import dataclasses
import functools
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dipc_gym import cli, controllers, runs
from dipc_gym.controllers import ControllerError, Tracking
from dipc_gym.controllers.designs import paper_model
from dipc_gym.controllers.tracking import equilibrium, feedback
from dipc_gym.mechanics.motion import Motion, state_of
from dipc_gym.policy import Policy
from dipc_gym.training import checkpoint, evaluation, folder, train
from dipc_gym.training.train import Recipe, Rig, Training, TrainingError, evaluate

pytest.importorskip("torch")
pytest.importorskip("stable_baselines3")
from dipc_gym.training.imitation import LOST, Imitator, Teacher

MOTION = Motion.of(*paper_model())
PLAN = Tracking.shipped()
SHORT = Recipe(steps=4_000, num_envs=8, stage=250, batch_size=250, width=8, epochs=1, buffer_size=1_500)


teacher = functools.cache(lambda count: Teacher(PLAN, MOTION, count))  # which takes a tenth of a second


def begun(states: np.ndarray) -> Teacher:
    told: Teacher = teacher(len(states))
    told.begin(np.ones(len(states), dtype=bool), states)
    return told


def training(**changes: Any) -> Training:
    given: dict[str, Any] = {"algorithm": "dagger", "task": "swing-up", "compensator": "none", "recipe": SHORT}
    return Training(**given | changes)


@pytest.fixture(autouse=True)
def briefly(monkeypatch: pytest.MonkeyPatch) -> None:
    """Trials of two runs that hold for two seconds are enough to see what becomes of them."""
    monkeypatch.setattr(train, "RUNS", 2)
    monkeypatch.setattr(train, "LOOKS", 2)
    monkeypatch.setattr(evaluation, "HELD", 2.0)
    monkeypatch.setattr(evaluation, "RISE", 1.0)


# ------------------------------------------------------------------------------------------------- the teacher


def test_on_the_plan_it_says_what_was_planned_and_at_its_end_nothing() -> None:
    told = begun(PLAN.states)
    np.testing.assert_allclose(told.forces(PLAN.states)[:-1], PLAN.forces, atol=0.05)
    np.testing.assert_allclose(told.cost, 0.0, atol=1e-9)
    assert told.forces(PLAN.states)[-1] == pytest.approx(0.0, abs=1e-6)


def test_it_has_no_clock() -> None:
    state = PLAN.states[200:201] + 1e-3
    told = begun(state)
    first = told.forces(state)
    for _ in range(20):
        np.testing.assert_array_equal(told.forces(state), first)


@settings(deadline=None)
@given(st.integers(0, len(PLAN.forces)), st.integers(-3, 3), st.integers(-3, 3), st.integers(0, 2**31))
def test_a_turn_more_is_the_same_state(place: int, first: int, second: int, seed: int) -> None:
    state = PLAN.states[place : place + 1] + np.random.default_rng(seed).normal(0.0, 0.02, (1, 6))
    both = np.vstack([state, state + 2 * math.pi * np.array([[0, first, second, 0, 0, 0]])])
    plain, turned = begun(both).forces(both)
    assert turned == pytest.approx(plain, rel=1e-6, abs=1e-6)


def test_far_from_the_plan_costs_more_than_it_can_tell_a_way_back_from() -> None:
    near, far = PLAN.states[300:301] + 1e-3, PLAN.states[300:301] + np.array([[0.0, 1.0, -1.0, 0.0, 0.0, 0.0]])
    for state, lost in ((near, False), (far, True)):
        told = begun(state)
        told.forces(state)
        assert (told.cost[0] > LOST) == lost


def test_it_swings_up_by_place_though_it_began_at_other_places() -> None:
    """Where `Tracking`, which counts periods, would have to begin where its plan does."""
    rig = Rig.of(training(compensator="observed", estimator="rigid_body", limit=96.0))
    envs = rig.many(16, None, engine="compiled", start=PLAN.states[:300:20])
    observations, _ = envs.reset(seed=4)
    told = begun(state_of(observations))
    for _ in range(500):
        observations, _, fell, _, infos = envs.step(told.forces(state_of(observations))[:, None])
        assert not fell.any()
    assert infos["at_goal"].all()


def test_the_cost_to_go_is_what_the_feedback_costs() -> None:
    """Summed over a simulation of a linear rig about upright."""
    from dipc_gym.controllers import lqr

    rest = np.zeros((51, 6))
    around = feedback(MOTION, rest, np.zeros(50), 0.005, rest[0])
    A, B = MOTION.linear(np.zeros(6), 0.0)
    F, G = lqr.sampled(A, B[:, None], 0.005)
    x = np.array([0.01, 0.02, -0.01, 0.0, 0.1, -0.1])
    expected, cost = x @ around.to_go[0] @ x, 0.0
    for gain in around.gains:
        u = -float(gain @ x)
        cost += x @ lqr.RECOVERED_Q @ x + lqr.R * u * u
        x = F @ x + G[:, 0] * u
    assert cost + x @ around.to_go[-1] @ x == pytest.approx(expected, rel=1e-9)


# ------------------------------------------------------------------------------------------------- the network


def rest_plan(folder: Path) -> str:
    rest = np.tile(equilibrium("up-up"), (2, 1))
    around = feedback(MOTION, rest, np.zeros(1), 0.005, rest[0])
    Tracking(rest, np.zeros(1), around.gains, around.hold, 0.005, "up-up", "up-up").save(folder / "rest.json")
    return str(folder / "rest.json")


def test_it_learns_a_plan_that_holds_upright(tmp_path: Path) -> None:
    recipe = dataclasses.replace(
        train.RECIPES["dagger"], steps=64_000, num_envs=32, stage=250, batch_size=500, epochs=6, width=32
    )
    wanted = training(
        plan=rest_plan(tmp_path), compensator="observed", estimator="rigid_body", recipe=recipe, limit=60.0, seed=1
    )
    rig = Rig.of(wanted)
    learner = Imitator(wanted, rig)
    before = evaluate(learner.policy(), rig, runs=8)
    for stage in range(8):
        learner.learn(stage, lambda: None)
    after = evaluate(learner.policy(), rig, runs=8)
    assert before.standing == 0
    assert after.standing == 8
    assert learner.policy().goal == learner.policy().start == "up-up"


def killed_after_first_round(monkeypatch: pytest.MonkeyPatch) -> None:
    real = checkpoint.write

    def stopping(*arguments: Any) -> None:
        real(*arguments)
        raise KeyboardInterrupt

    monkeypatch.setattr(checkpoint, "write", stopping)


def test_a_killed_training_goes_on_to_the_same_policy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    wanted = training(compensator="observed", estimator="rigid_body")
    whole = train.run(wanted, tmp_path / "whole", quiet=True)
    with monkeypatch.context() as patch:
        killed_after_first_round(patch)
        with pytest.raises(KeyboardInterrupt):
            train.run(wanted, tmp_path / "killed", quiet=True)
    resumed = train.run(wanted, tmp_path / "killed", resume=True, quiet=True)
    assert resumed.to_dict() == whole.to_dict()
    for name in ("policy.json", "compensator.json", "estimator.json"):
        assert (tmp_path / "killed" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()
    assert Policy.load(tmp_path / "whole" / "policy.json").estimator == "rigid_body"


def test_it_remembers_the_latest_and_no_more_than_it_is_to() -> None:
    wanted = training()
    learner = Imitator(wanted, Rig.of(wanted))
    for first in (0, 1_000):
        values = np.arange(first, first + 1_000, dtype=float)
        learner._remember(np.tile(values[:, None], 8), values)
    state = learner.state()
    assert sorted(state["told"].tolist()) == list(range(500, 2_000))
    again = Imitator(wanted, learner.rig)
    again.restore(state)
    for one in (learner, again):
        one._remember(np.zeros((3, 8)), np.full(3, -1.0))
    np.testing.assert_array_equal(again.state()["told"], learner.state()["told"])


@pytest.mark.parametrize("fault", [{"at": 1_500}, {"at": -1}, {"steps": "many"}, {"network": {}}])
def test_the_state_of_another_training_is_refused(fault: dict[str, Any]) -> None:
    wanted = training()
    learner = Imitator(wanted, Rig.of(wanted))
    with pytest.raises((ValueError, RuntimeError)):
        learner.restore({**learner.state(), **fault})


def test_it_commands_voltage_for_the_force_that_the_teacher_wants() -> None:
    wanted = training(recipe=dataclasses.replace(SHORT, epochs=60, width=32))
    rig = Rig.of(wanted)
    learner = Imitator(wanted, rig)
    learner.learn(0, lambda: None)
    policy = learner.policy()
    assert policy.commands == "voltage"
    observations, forces = learner._seen[:1_500] * policy.scales, learner._told[:1_500] * rig.full_force
    got = policy.command(observations) * rig.newtons_per_volt
    assert np.corrcoef(got, forces)[0, 1] > 0.9
    assert np.polyfit(forces, got, 1)[0] == pytest.approx(1.0, abs=0.2)


# -------------------------------------------------------------------------------------------- what is refused


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ([], "dagger imitates a planned motion, and to balance there is none; say --task swing-up"),
        (["--task", "swing-up", "--estimator", "magic"], "magic"),
        (["--task", "swing-up", "--estimator", "kalman"], "take 'rigid_body'"),
        (["--task", "swing-up", "--plan", "gone.json"], "gone.json"),
    ],
)
def test_bad_options_are_refused(
    options: list[str], says: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "run"
    assert cli.main(["train-policy", "--out", str(out), "--algo", "dagger", *options]) == 2
    assert says in capsys.readouterr().err
    assert not (out / "policy.json").exists()


def test_a_plan_for_another_control_period_is_refused(tmp_path: Path) -> None:
    slow = tmp_path / "slow.json"
    dataclasses.replace(PLAN, period=0.01).save(slow)
    with pytest.raises(ControllerError, match=r"planned for a control period of 0\.01 s"):
        Rig.of(training(plan=str(slow)))


def test_a_training_is_not_resumed_with_another_plan(tmp_path: Path) -> None:
    plan = tmp_path / "plan.json"
    PLAN.save(plan)
    wanted = training(plan=str(plan))
    out = folder.prepare(wanted, tmp_path / "run", resume=False, overwrite=False)
    rest_plan(tmp_path)
    plan.write_bytes((tmp_path / "rest.json").read_bytes())
    with pytest.raises(TrainingError, match=r"plan\.json: not the file that the training"):
        folder.prepare(wanted, out, resume=True, overwrite=False)


def seen(compensator: str, start: str) -> Policy:
    """A policy that commands nothing, and sees the rig through an estimator."""
    return Policy(
        layers=((np.zeros((1, 8)), np.zeros(1)),),
        commands="force",
        limit=96.0,
        compensator=compensator,
        scales=np.ones(8),
        estimator="rigid_body",
        start=start,
        goal="up-up",
    )


def test_it_is_not_to_see_through_another_estimator() -> None:
    policy = seen("ideal", start="down-down")
    with pytest.raises(ControllerError, match="see through 'rigid_body' and is to see through the environment's own"):
        runs.swing_up(policy, runs.compensator("ideal"), seconds=0.1, seed=0)
    course = runs.swing_up(
        policy, runs.compensator("ideal"), seconds=0.1, seed=0, estimator=runs.estimator("rigid_body")
    )
    assert len(course.time) == 20


def test_files_say_what_a_policy_sees_through_and_older_ones_do_not(tmp_path: Path) -> None:
    policy = seen("observed", start="up-down")
    policy.save(tmp_path / "new.json")
    again = controllers.load(str(tmp_path / "new.json"))
    assert isinstance(again, Policy)
    assert (again.estimator, again.start, again.goal) == ("rigid_body", "up-down", "up-up")
    assert "seen through rigid_body" in again.summary()
    data = json.loads((tmp_path / "new.json").read_text())
    for name in ("estimator", "start", "goal"):
        del data[name]
    (tmp_path / "old.json").write_text(json.dumps(data))
    old = Policy.load(tmp_path / "old.json")
    assert (old.estimator, old.start, old.goal) == (None, None, None)
    (tmp_path / "bad.json").write_text(json.dumps({**data, "goal": "sideways"}))
    with pytest.raises(ControllerError, match=r"bad\.json.*goal"):
        Policy.load(tmp_path / "bad.json")
