"""Force in, voltage out; and runs on disk."""

from __future__ import annotations

import copy
import dataclasses
import json
import math
import pickle
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env, data_equivalence
from gymnasium.wrappers import (
    Autoreset,
    ClipAction,
    FrameStackObservation,
    NormalizeObservation,
    RescaleAction,
    TimeAwareObservation,
    vector,
)

import dipc_gym
from dipc_gym import compensators, mjcf, recording, runs
from dipc_gym.compensators import Compensator, CompensatorError, Feedforward, Ideal, RigConstants, Samples, StaticGain
from dipc_gym.compensators.disturbance_observer import DisturbanceObserver
from dipc_gym.compensators.friedland import Friedland
from dipc_gym.controllers.lqr import PRINTED_GAIN
from dipc_gym.env import DoublePendulumEnv
from dipc_gym.wrappers import (
    EstimateState,
    ForceCommand,
    RecordRun,
    VectorEstimateState,
    VectorForceCommand,
    VectorRecordRun,
)

GAIN = StaticGain(newtons_per_volt=4.0)
FITTED = {
    "friedland": Friedland(4.0, 24.0, 0.005, level=20.0, rate=2.0, sign_velocity=0.01, mass=1.5, viscous=40.0),
    "disturbance_observer": DisturbanceObserver(4.0, 24.0, 0.005, share=0.3, mass=1.5, viscous=40.0),
}


def rig(**kwargs: Any) -> Any:
    return gymnasium.make(dipc_gym.ENV_ID, **kwargs)


@dataclasses.dataclass(frozen=True)
class Watching(Compensator):
    """Half a volt a newton; remembers what it was asked."""

    asked: list[tuple[float, float]] = dataclasses.field(default_factory=list, init=False)
    resets: list[int] = dataclasses.field(default_factory=list, init=False)

    @classmethod
    def fit(cls, samples: Samples, rig: RigConstants, *, seed: int = 0) -> Watching:
        return cls()

    def volts(self, force: Any, velocity: Any, previous_velocity: Any) -> Any:
        self.asked.append((force, velocity))
        return 0.5 * force

    def reset(self) -> None:
        super().reset()
        self.resets.append(1)


@dataclasses.dataclass(frozen=True)
class Remembering(Compensator):
    """Its voltage depends on the velocity before, so a copy without the memory would show."""

    @classmethod
    def fit(cls, samples: Samples, rig: RigConstants, *, seed: int = 0) -> Remembering:
        return cls()

    def volts(self, force: Any, velocity: Any, previous_velocity: Any) -> Any:
        return 0.25 * force + 5.0 * (velocity - previous_velocity)


def test_force_goes_through_the_compensator_with_the_observed_velocity() -> None:
    env = ForceCommand(rig(), Watching())
    watch: Any = env.compensator
    observation, info = env.reset(seed=0)
    assert info["force"] == 0.0
    for force in (10.0, -20.0, 30.0):
        velocity = observation[3]
        observation, _, _, _, info = env.step(np.array([force]))
        assert watch.asked[-1] == (force, velocity)
        assert (info["force"], info["voltage"]) == (force, force / 2)
    assert len(watch.resets) == 1
    env.reset()
    assert len(watch.resets) == 2


def test_velocity_is_the_rigs_whatever_stands_around() -> None:
    env = NormalizeObservation(ForceCommand(rig(), Watching()))
    env.reset(seed=0)
    env.step(np.array([20.0], np.float32))
    env.step(np.array([20.0], np.float32))
    watch: Any = env.env.compensator  # type: ignore[attr-defined]
    assert watch.asked[-1][1] != 0.0
    assert abs(watch.asked[-1][1]) < 0.1


def test_force_is_limited_to_what_the_motor_can_do() -> None:
    env = ForceCommand(rig(), GAIN)
    assert env.force_limit == pytest.approx(96.0)
    assert env.action_space == gymnasium.spaces.Box(-96.0, 96.0, (1,), np.float32)
    env.reset(seed=0)
    info = env.step(np.array([500.0]))[4]
    assert info["force"] == pytest.approx(96.0)
    tight = ForceCommand(rig(), GAIN, force_limit=10.0)
    tight.reset(seed=0)
    assert tight.step(np.array([-50.0]))[4]["force"] == -10.0


@pytest.mark.parametrize("supply", [24.0, 12.0])
def test_the_environment_limits_the_voltage_and_says_so(supply: float) -> None:
    """The compensator leaves it to the environment, whichever supply it was trained for."""
    trained = Feedforward(0.25, 30.0, 0.0, 0.0, 1e-3, supply=24.0)
    env = ForceCommand(gymnasium.make("DIPC-Friction-v0", plant={"supply": supply}), trained)
    rigs = gymnasium.make_vec("DIPC-Friction-v0", 1, vectorization_mode="vector_entry_point", plant={"supply": supply})
    envs = VectorForceCommand(rigs, trained)
    env.reset(seed=0)
    envs.reset(seed=0)
    said = []
    for _ in range(20):
        _, _, fell, _, info = env.step([10.0])
        infos = envs.step(np.array([[10.0]]))[4]
        if fell:  # the vector environment begins anew
            break
        assert (info["voltage"], info["clipped"]) == (infos["voltage"][0], infos["clipped"][0])
        assert info["clipped"] == (abs(info["voltage"]) == supply)
        said.append(info["clipped"])
    assert any(said)
    assert trained.supply == 24.0


@pytest.mark.parametrize("kind", ["friedland", "disturbance_observer"])
def test_what_a_weak_supply_keeps_back_is_not_taken_for_friction(kind: str) -> None:
    """Fitted at 24 V and asked for 24 V where there are 12: what it remembers is what the motor got."""
    fitted = FITTED[kind]
    env = ForceCommand(gymnasium.make("DIPC-Friction-v0", plant={"supply": 12.0}), fitted)
    env.reset(seed=0)
    for _ in range(5):
        info = env.step([env.force_limit])[4]
        assert abs(info["voltage"]) <= 12.0
        assert env.compensator.state()[0, -1] == pytest.approx(info["voltage"])
    assert fitted.supply_voltage == 24.0  # type: ignore[attr-defined]


def test_a_memory_for_another_control_period_is_refused() -> None:
    slow = {"plant": {"control_period": 0.01}}
    envs = gymnasium.make_vec("DIPC-Friction-v0", 2, vectorization_mode="vector_entry_point", **slow)
    for around, inside in ((ForceCommand, rig(**slow)), (VectorForceCommand, envs)):
        with pytest.raises(ValueError, match=r"'friedland' remembers .* after 5 ms, and the control period is 10 ms"):
            around(inside, FITTED["friedland"])


def test_ideal_removes_the_limit_cycle() -> None:
    largest = {}
    for compensator in (GAIN, Ideal(newtons_per_volt=4.0)):
        env = ForceCommand(rig(exact_state=True), compensator)
        observation, _ = env.reset(seed=0)
        xs = []
        for _ in range(4_000):
            observation, _, terminated, _, _ = env.step(np.array([-PRINTED_GAIN @ observation]))
            assert not terminated
            xs.append(abs(observation[0]))
        largest[compensator.name] = max(xs[-1_000:])
    assert largest["none"] > 0.02
    assert largest["ideal"] < 1e-4


def test_accepts_object_path_and_dictionary(tmp_path: Path) -> None:
    compensators.save(GAIN, tmp_path / "gain.json")
    for form in (GAIN, GAIN.to_dict(), tmp_path / "gain.json", str(tmp_path / "gain.json")):
        env = ForceCommand(rig(), form)
        assert env.compensator == GAIN
        spec = env.spec
        assert spec is not None
        again = gymnasium.make(type(spec).from_json(spec.to_json()))
        assert isinstance(again, ForceCommand)
        assert again.compensator == GAIN


def test_two_environments_share_no_memory() -> None:
    shared = Watching()
    a, b = ForceCommand(rig(), shared), ForceCommand(rig(), shared)
    assert a.compensator is not b.compensator
    assert a.compensator is not shared


@pytest.mark.parametrize("clone", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
def test_a_copy_goes_on_bit_for_bit(clone: Any) -> None:
    env = ForceCommand(rig(), Remembering())
    env.reset(seed=2)
    forces = np.random.default_rng(0).uniform(-30, 30, (40, 1))
    for force in forces[:20]:
        env.step(force)
    twin = clone(env)
    first, second = ([e.step(force) for force in forces[20:]] for e in (env, twin))
    assert data_equivalence(first, second, exact=True)


@pytest.mark.filterwarnings("ignore:.*minimum value is -infinity", "ignore:.*maximum value is infinity")
@pytest.mark.filterwarnings("ignore:.*is different from the unwrapped version")  # it is: that is the point
def test_gymnasium_finds_no_fault() -> None:
    check_env(RescaleAction(ForceCommand(rig(), GAIN), np.float32(-1), np.float32(1)), skip_render_check=True)


def test_stable_baselines3_takes_the_wrapped_rig(tmp_path: Path) -> None:
    sb3 = pytest.importorskip("stable_baselines3")
    vec = sb3.common.vec_env.VecMonitor(sb3.common.vec_env.DummyVecEnv([lambda: ForceCommand(rig(), GAIN)]))
    vec.seed(0)
    assert vec.reset().shape == (1, 6)
    observation, _, _, info = vec.step(np.array([[10.0]], np.float32))
    assert np.isfinite(observation).all()
    assert info[0]["force"] == 10.0


@pytest.mark.parametrize("action", [[math.nan], [math.inf], [], [1.0, 2.0], 3.0, None, "x"])
def test_wrong_forces_are_refused(action: Any) -> None:
    env = ForceCommand(rig(), GAIN)
    env.reset(seed=0)
    with pytest.raises(ValueError, match="force"):
        env.step(action)


def test_what_cannot_be_wrapped_is_refused(tmp_path: Path) -> None:
    with pytest.raises(TypeError, match="DIPC-Friction-v0"):
        ForceCommand(gymnasium.make("Pendulum-v1"), GAIN)
    with pytest.raises(TypeError, match="DIPC-Friction-v0"):
        RecordRun(gymnasium.make("Pendulum-v1"), tmp_path)
    for limit in (0.0, -1.0, math.nan, math.inf):
        with pytest.raises(ValueError, match="force_limit"):
            ForceCommand(rig(), GAIN, force_limit=limit)
    with pytest.raises(CompensatorError, match="no_such"):
        ForceCommand(rig(), str(tmp_path / "no_such.json"))


# ------------------------------------------------------------------------------------------------ recordings


def test_a_kind_of_compensator_has_to_be_fitted_first() -> None:
    with pytest.raises(CompensatorError, match=r"fit it to a rig: ForceCommand\(env, .*identify\(\)\.fit\('llnf'\)\)"):
        ForceCommand(rig(), "llnf")
    with pytest.raises(CompensatorError, match=r"ForceCommand\(env, dipc_gym\.runs\.compensator\(\"none\"\)\)"):
        ForceCommand(rig(), "none")
    with pytest.raises(CompensatorError, match=r"takes a compensator, its dictionary, or the path .*, not None"):
        ForceCommand(rig(), None)  # type: ignore[arg-type]
    with pytest.raises(CompensatorError, match="did you mean 'llnf'"):
        ForceCommand(rig(), "lnlf")


LOW, HIGH = np.float32([-1.0]), np.float32([1.0])  # of a rescaled action


def test_a_wrapper_that_changes_what_an_action_is_goes_outside() -> None:
    """Within, it would make the compensator's volts into something else."""
    for inside in (RescaleAction(rig(), LOW, HIGH), ForceCommand(rig(), GAIN)):
        with pytest.raises(ValueError, match="around ForceCommand instead"):
            ForceCommand(inside, GAIN)
    envs = gymnasium.make_vec(dipc_gym.ENV_ID, num_envs=2, vectorization_mode="vector_entry_point")
    with pytest.raises(ValueError, match="around ForceCommand instead"):
        VectorForceCommand(vector.RescaleAction(envs, LOW, HIGH), GAIN)
    estimator = runs.estimator("kalman")
    for inside in (RescaleAction(rig(), LOW, HIGH), ForceCommand(rig(), GAIN)):
        with pytest.raises(ValueError, match="around EstimateState instead"):
            EstimateState(inside, estimator)
    for many in (vector.RescaleAction(envs, LOW, HIGH), VectorForceCommand(envs, GAIN)):
        with pytest.raises(ValueError, match="around EstimateState instead"):
            VectorEstimateState(many, estimator)
    outside = RescaleAction(ForceCommand(ClipAction(rig()), GAIN), LOW, HIGH)
    outside.reset(seed=1)
    assert outside.step(np.array([0.5]))[4]["force"] == pytest.approx(
        0.5 * outside.unwrapped.plant.motor.force_per_volt * 24
    )


@pytest.mark.parametrize("suffix", ["csv", "npz", "parquet"])
def test_recording_repeats_in_the_simulation(suffix: str, tmp_path: Path) -> None:
    if suffix == "parquet":
        pytest.importorskip("pyarrow")
    env = RecordRun(ForceCommand(rig(), GAIN), tmp_path / "runs", name="push", suffix=suffix)
    start = [0.01, 0.02, -0.01, 0, 0, 0]
    env.reset(options={"state": start})
    forces = np.random.default_rng(0).uniform(-200, 200, (30, 1))
    for force in forces:
        env.step(force)
    env.close()
    inner = DoublePendulumEnv()
    run = recording.read(tmp_path / "runs" / f"push-0.{suffix}", inner.model)
    assert len(run) == 30
    assert run.period == pytest.approx(0.005)
    # The recorded voltages alone bring back the recorded encoder readings.
    inner.reset(options={"state": start})
    for volts, sensors in zip(run.commands, run.sensors, strict=True):
        assert inner.encoders == tuple(sensors)
        inner.step(volts)
    assert np.abs(run.commands).max() == 24.0  # as applied, after the supply's limit


def test_one_file_an_episode(tmp_path: Path) -> None:
    env = RecordRun(gymnasium.make(dipc_gym.ENV_ID, max_episode_steps=25), tmp_path)
    for _ in range(2):
        env.reset(seed=0)
        for _ in range(25):
            env.step(np.zeros(1))
    env.reset()
    env.step(np.zeros(1))
    env.reset()
    env.close()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["run-0.csv", "run-1.csv", "run-2.csv"]


def test_earlier_recordings_are_not_lost(tmp_path: Path) -> None:
    (tmp_path / "run-0.csv").write_text("precious")
    with pytest.raises(FileExistsError, match=r"run-0\.csv"):
        RecordRun(rig(), tmp_path)
    RecordRun(rig(), tmp_path, name="other")
    env = RecordRun(rig(), tmp_path, overwrite=True)
    env.reset(seed=0)
    env.step(np.zeros(1))
    env.close()
    assert (tmp_path / "run-0.csv").read_text().startswith("time,motor,cart,pole1,pole2")
    with pytest.raises(ValueError, match="suffix"):
        RecordRun(rig(), tmp_path, name="x", suffix="mat")


@pytest.mark.parametrize("name", ["", "..", "../run", "a/run", "a\\run"])
def test_names_that_leave_the_folder_are_refused(name: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="without a folder"):
        RecordRun(rig(), tmp_path, name=name)


def test_overwriting_leaves_no_recording_of_a_longer_run(tmp_path: Path) -> None:
    kept = {"run-0-0.csv", "run-a.csv", "run-1.npz", "other-0.csv"}
    for name in kept | {"run-0.csv", "run-12.csv"}:
        (tmp_path / name).write_text("old")
    RecordRun(rig(), tmp_path, overwrite=True)
    assert {path.name for path in tmp_path.iterdir()} == kept
    envs = gymnasium.make_vec(dipc_gym.ENV_ID, num_envs=1, vectorization_mode="vector_entry_point")
    (tmp_path / "run-7-3.csv").write_text("old")
    VectorRecordRun(envs, tmp_path, overwrite=True)
    assert {path.name for path in tmp_path.iterdir()} == kept - {"run-0-0.csv"}


def test_recorder_is_in_the_spec(tmp_path: Path) -> None:
    env = RecordRun(rig(), tmp_path, name="a")
    assert env.spec is not None
    wrappers = json.loads(env.spec.to_json())["additional_wrappers"]
    assert wrappers[-1]["kwargs"] == {"folder": str(tmp_path), "name": "a", "suffix": "csv", "overwrite": False}


def test_sensor_names_are_the_models() -> None:
    assert mjcf.scalar_sensors(DoublePendulumEnv().model) == ["cart", "pole1", "pole2"]


def test_an_estimator_is_told_volts_whatever_the_limit_of_force_is() -> None:
    """Spaces of 24 N and 24 V are the same."""
    kalman = runs.estimator("kalman")
    with pytest.raises(ValueError, match="a ForceCommand inside it takes newtons"):
        EstimateState(ForceCommand(rig(), GAIN, force_limit=24.0), kalman)
    with pytest.raises(ValueError, match="a ForceCommand inside it takes newtons"):
        ForceCommand(ForceCommand(rig(), GAIN, force_limit=24.0), GAIN)
    envs = gymnasium.make_vec(dipc_gym.ENV_ID, 2, "vector_entry_point")
    with pytest.raises(ValueError, match="a ForceCommand inside it takes newtons"):
        VectorEstimateState(VectorForceCommand(envs, GAIN, force_limit=24.0), kalman)


def test_wrappers_of_observations_go_around_an_estimator() -> None:
    kalman = runs.estimator("kalman")
    for wrap in (NormalizeObservation, TimeAwareObservation, lambda env: FrameStackObservation(env, 3)):
        with pytest.raises(ValueError, match="around EstimateState instead of inside"):
            EstimateState(wrap(rig()), kalman)
        env = wrap(EstimateState(rig(), kalman))
        observation, _ = env.reset(seed=1)
        assert env.observation_space.shape == np.shape(observation)
    envs = gymnasium.make_vec(dipc_gym.ENV_ID, 2, "vector_entry_point")
    with pytest.raises(ValueError, match="NormalizeObservation, around EstimateState"):
        VectorEstimateState(vector.NormalizeObservation(envs), kalman)


def test_a_compensator_that_takes_anothers_place_is_checked_and_begins_anew() -> None:
    run = runs.identify()
    single = ForceCommand(rig(), GAIN)
    many = VectorForceCommand(gymnasium.make_vec(dipc_gym.ENV_ID, 2, "vector_entry_point"), GAIN)
    single.reset(seed=1)
    many.reset(seed=1)
    for env in (single, many):
        with pytest.raises(ValueError, match="feeds forward the friction that an estimator observes"):
            env.compensator = run.fit("observed")
        assert env.compensator.name == "none"
        env.compensator = run.fit("lugre")
    alone, _, _, _, info = single.step([6.0])
    both, _, _, _, infos = many.step(np.full((2, 1), 6.0))
    assert infos["voltage"][0] == info["voltage"]
    assert both[0].tolist() == alone.tolist()


def test_steps_after_an_end_belong_to_no_recording(tmp_path: Path) -> None:
    env = RecordRun(rig(max_episode_steps=25), tmp_path)
    env.reset(seed=0)
    for _ in range(50):
        env.step([1.0])
    env.reset()
    for _ in range(25):
        env.step([1.0])
    env.close()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["run-0.csv", "run-1.csv"]
    assert len(recording.read(tmp_path / "run-0.csv", env.unwrapped.model).time) == 25


def test_a_reset_within_a_step_begins_another_recording(tmp_path: Path) -> None:
    env = RecordRun(Autoreset(rig(max_episode_steps=12)), tmp_path)
    env.reset(seed=0)
    for _ in range(38):  # of three episodes, and two steps that were spent on resets
        env.step([1.0])
    env.close()
    assert len(list(tmp_path.iterdir())) == 3


def test_an_action_at_the_bound_is_not_beyond_the_supply() -> None:
    """The float32 that is nearest to 12.6 V is more."""
    env = rig(plant={"supply": 12.6})
    env.reset(seed=0)
    assert not env.step(env.action_space.high)[4]["clipped"]
    forced = ForceCommand(rig(plant={"supply": 12.6}), GAIN, force_limit=50.1)
    forced.reset(seed=0)
    assert forced.action_space.high[0] <= 50.1


def test_a_window_without_a_display_is_refused_and_no_crash(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("sys.platform", "linux")
    env = rig(render_mode="human").unwrapped
    with pytest.raises(gymnasium.error.Error, match="there is no display"):
        env.render()
