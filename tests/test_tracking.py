"""Swinging up by a plan: it reaches the goal and holds it, its file is checked, and what it is not for is refused."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest

from dipc_gym import SWING_UP_ID, controllers, runs
from dipc_gym.cli import main
from dipc_gym.compensators import Observed
from dipc_gym.controllers import ControllerError, Tracking
from dipc_gym.controllers.designs import paper_model
from dipc_gym.controllers.tracking import equilibrium, feedback
from dipc_gym.env import DoublePendulumEnv
from dipc_gym.estimators import RigidBody
from dipc_gym.mechanics.motion import Motion
from dipc_gym.postures import POSTURES
from dipc_gym.runs import Identification
from dipc_gym.swing_up import observed
from dipc_gym.wrappers import EstimateState, ForceCommand, VectorEstimateState, VectorForceCommand

MOTION = Motion.of(*paper_model())


@pytest.fixture(scope="module")
def identified() -> Identification:
    return runs.identify(seed=1)


@pytest.fixture(scope="module")
def rigid_body(identified: Identification) -> Any:
    return identified.fit_estimator("rigid_body")


def test_the_shipped_plan_is_a_motion_of_the_rig() -> None:
    plan = Tracking.shipped()
    np.testing.assert_allclose(plan.states[0] - equilibrium("down-down"), 0, atol=2 * math.pi)
    np.testing.assert_allclose(np.cos(plan.states[[0, -1], 1:3]), [[-1, -1], [1, 1]], atol=1e-6)
    after = MOTION.after(plan.states[:-1], plan.forces, plan.period)
    assert np.abs(after - plan.states[1:]).max() < 0.05  # the force is held in each period, which the plan's is not
    assert np.abs(plan.states[:, 0]).max() < 0.35
    assert np.abs(plan.forces).max() < 70


@pytest.mark.filterwarnings("ignore::dipc_gym.compensators.OutOfRangeWarning")
@pytest.mark.parametrize("compensator", ["observed", "llnf"])
def test_swings_up_and_holds_with_friction_and_encoders(
    compensator: str, identified: Identification, rigid_body: Any
) -> None:
    course = runs.swing_up(
        controllers.load("tvlqr"), identified.fit(compensator), seconds=12.0, seed=3, estimator=rigid_body
    )
    assert not course.fell
    assert course.held("up-up") > 9.0
    assert course.held("down-down") == 0.0
    assert np.abs(course.state[course.time > 8, 0]).max() < 0.08


@pytest.mark.filterwarnings("ignore::dipc_gym.compensators.OutOfRangeWarning")
def test_without_the_filter_of_the_whole_motion_it_does_not_arrive(identified: Identification) -> None:
    course = runs.swing_up(controllers.load("tvlqr"), identified.fit("llnf"), seconds=6.0, seed=3)
    assert course.held("up-up") == 0.0  # filtered differences lag by two periods


@pytest.mark.parametrize("goal", POSTURES)
def test_every_equilibrium_is_held(goal: str, identified: Identification, rigid_body: Any) -> None:
    rest = np.tile(equilibrium(goal), (2, 1))
    around = feedback(MOTION, rest, np.zeros(1), 0.005, rest[0])
    plan = Tracking(rest, np.zeros(1), around.gains, around.hold, 0.005, goal, goal)
    course = runs.swing_up(
        plan, identified.fit("observed"), seconds=4.0, seed=0, start=goal, goal=goal, estimator=rigid_body
    )
    assert course.held(goal) >= 4.0


def test_estimates_the_whole_motion(identified: Identification, rigid_body: Any) -> None:
    env = EstimateState(gymnasium.make(SWING_UP_ID), rigid_body)
    observation, _ = env.reset(seed=0)
    inner: Any = env.unwrapped
    errors, plain = [], []
    for k in range(300):
        observation, _, over, _, info = env.step([14.0 * math.copysign(1.0, math.sin(0.05 * k))])
        assert not over
        errors.append(np.abs(observation - observed(inner.state)))
        plain.append(np.abs(inner.measured_state[3:] - inner.state[3:]))
    assert abs(inner.state[1] - math.pi) > 0.05  # it swings
    assert (np.mean(errors, axis=0)[5:] < 0.5 * np.mean(plain, axis=0)).all()
    assert np.mean(errors, axis=0)[:5].max() < 2e-3
    assert "friction_estimate" in info


def test_an_estimator_that_knows_upright_alone_is_refused(identified: Identification) -> None:
    near = identified.fit_estimator("disturbance")
    for env, wrap in (
        (gymnasium.make(SWING_UP_ID), EstimateState),
        (gymnasium.make_vec(SWING_UP_ID, 2, "vector_entry_point"), VectorEstimateState),
    ):
        with pytest.raises(ValueError, match="take 'rigid_body'"):
            wrap(env, near)


def test_many_are_estimated_as_one_even_where_episodes_end(rigid_body: Any) -> None:
    compensator, n = Observed(newtons_per_volt=4.0), 3
    turns = {"state": [0.0, math.pi + 6 * math.pi, math.pi, 0.0, 0.0, 0.0]}
    ours = gymnasium.make_vec(SWING_UP_ID, n, "vector_entry_point", max_episode_steps=20, autoreset_mode="SameStep")
    many = VectorForceCommand(VectorEstimateState(ours, rigid_body), compensator)
    single = [
        ForceCommand(EstimateState(gymnasium.make(SWING_UP_ID, max_episode_steps=20), rigid_body), compensator)
        for _ in range(n)
    ]
    observations, _ = many.reset(seed=5, options=turns)
    alone = [one.reset(seed=5 + i, options=turns)[0] for i, one in enumerate(single)]
    np.testing.assert_array_equal(observations, alone)
    for k in range(20):
        forces = 20.0 * np.sin(0.3 * k + np.arange(n))[:, None]
        observations, _, _, truncated, infos = many.step(forces)
        alone = [one.step(force)[0] for one, force in zip(single, forces, strict=True)]
        if truncated.any():
            np.testing.assert_allclose(np.stack(infos["final_obs"]), alone, atol=1e-9)  # turns come back from cosines
        else:
            np.testing.assert_array_equal(observations, alone)
    assert truncated.all()


def test_rates_of_a_pole_that_turns_stay_near(rigid_body: RigidBody) -> None:
    state = rigid_body.initial_state(np.array([[0.0, 2.0, 2.5, 0.0, 3.0, -4.0]]))
    assert np.linalg.eigvalsh(state[0, 7:].reshape(7, 7)).min() > -1e-12


def test_file_goes_there_and_back(tmp_path: Path) -> None:
    plan = Tracking.shipped()
    plan.save(tmp_path / "again.json")
    again = controllers.load(str(tmp_path / "again.json"))
    assert isinstance(again, Tracking)
    np.testing.assert_array_equal(again.gains, plan.gains)
    seen = observed(np.array([0.1, 3.0, -3.0, 0.1, 0.2, 0.3]))
    assert [again.force(seen) for _ in range(3)] == [plan.force(seen) for _ in range(3)]
    again.reset()
    plan.reset()
    assert again.force(seen) == plan.force(seen)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"rows": []}, "rows"),
        ({"rows": [[0.0] * 12]}, r"rows\[0\]"),
        ({"rows": [[math.inf] * 13]}, r"rows\[0\]"),
        ({"rows": [[1e9] * 13]}, "states must be"),
        ({"goal": "sideways"}, "goal"),
        ({"period": -1.0}, "period"),
        ({"period": 10.0}, "period"),
        ({"hold": "no"}, "hold"),
        ({"columns": ["x"]}, "columns"),
        ({"schema": "dipc-gym/trajectory/9"}, "schema"),
    ],
)
def test_broken_files_are_refused(change: dict[str, Any], says: str, tmp_path: Path) -> None:
    path = tmp_path / "plan.json"
    path.write_text(json.dumps(Tracking.shipped().to_dict() | change))
    with pytest.raises(ControllerError, match=says):
        Tracking.load(path)
    path.write_text("{")
    with pytest.raises(ControllerError, match=r"plan\.json"):
        controllers.load(str(path))


def test_readings_that_are_not_finite_leave_the_planned_force() -> None:
    plan = Tracking.shipped()
    for bad in (math.nan, math.inf, 1e300):
        plan.reset()
        force = plan.force(np.full(8, bad))
        assert math.isfinite(force)
    plan.reset()
    assert plan.force(np.full(8, math.nan)) == plan.forces[0]


def test_tasks_that_it_was_not_planned_for_are_refused() -> None:
    gain = Observed(newtons_per_volt=4.0)
    with pytest.raises(ControllerError, match="--start down-up"):
        runs.swing_up(Tracking.shipped(), gain, seconds=1.0, seed=0, start="down-up")
    from dipc_gym.plant import Plant

    with pytest.raises(ControllerError, match="control period"):
        runs.swing_up(Tracking.shipped(), gain, seconds=1.0, seed=0, plant=Plant(control_period=0.01))
    with pytest.raises(ControllerError, match="swings up"):
        controllers.balancing("tvlqr")


def test_command_line_refuses_it_where_poles_are_balanced(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for command in (["compare", "--seeds", "1"], ["record"]):
        out = tmp_path / ("run.csv" if command == ["record"] else "out")
        assert main([*command, "--out", str(out), "--controller", "tvlqr"]) == 2
        assert "swings up" in capsys.readouterr().err


def test_plans_another_transition(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("casadi")
    from dipc_gym.controllers import trajectory

    limits = trajectory.Limits(96.0, 0.45)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(trajectory, "DURATIONS", (2.5,))
        plan = trajectory.plan(MOTION, limits, 0.005, start="up-down", goal="up-up")
        assert main(["plan", "--out", str(tmp_path / "plan.json"), "--start", "up", "--resets", "0"]) == 2
        assert "first pole first" in capsys.readouterr().err
        patch.setattr(trajectory, "ITERATIONS", 1)
        with pytest.raises(trajectory.NoPlanError, match="no motion from down-down to up-up"):
            trajectory.plan(MOTION, limits, 0.005)
    np.testing.assert_allclose(np.cos(plan.states[[0, -1], 1:3]), [[1, -1], [1, 1]], atol=1e-6)
    assert np.abs(MOTION.after(plan.states[:-1], plan.forces, 0.005) - plan.states[1:]).max() < 0.1
    state = plan.states[0] + np.array([0.01, 0.01, -0.01, 0, 0, 0])  # the plan's own model, started beside the plan
    for _ in range(plan.forces.size + 400):
        state = MOTION.after(state, np.array(plan.force(observed(state))), 0.005)
    np.testing.assert_allclose(np.cos(state[1:3]), [1, 1], atol=1e-4)
    assert DoublePendulumEnv().rig.rail > np.abs(plan.states[:, 0]).max()
