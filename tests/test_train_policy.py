"""Training: it learns, goes on after a kill to the same policy, and spoils nothing."""

from __future__ import annotations

import dataclasses
import errno
import json
import os
import pickle
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dipc_gym import cli
from dipc_gym.controllers import ControllerError
from dipc_gym.policy import Policy
from dipc_gym.training import checkpoint, folder, train
from dipc_gym.training.train import RECIPES, Recipe, Rig, Training, TrainingError, evaluate

pytest.importorskip("torch")
pytest.importorskip("stable_baselines3")
from dipc_gym.sb3 import DIPCFrictionVecEnv
from dipc_gym.training.learner import SCALES, Learner, ScaledRigs

# Two stages each; SAC learns from step 200 on.
SHORT = {
    "ppo": Recipe(steps=4_000, num_envs=8, stage=250, rollout=125, batch_size=250, width=8),
    "sac": Recipe(
        steps=4_000,
        num_envs=4,
        stage=500,
        action_repeat=4,
        learning_starts=200,
        batch_size=32,
        width=8,
        buffer_size=1_000,
    ),
}


@pytest.fixture(autouse=True)
def briefly(monkeypatch: pytest.MonkeyPatch) -> None:
    """Four trials of two runs are enough to see what becomes of them."""
    monkeypatch.setattr(train, "RUNS", 2)
    monkeypatch.setattr(train, "LOOKS", 4)


def short(algorithm: Any = "ppo", **changes: Any) -> Training:
    values = {"algorithm": algorithm, "compensator": "none", "seed": 5, "recipe": SHORT[algorithm]}
    return Training(**values | changes)


def killed_after_first_stage(monkeypatch: pytest.MonkeyPatch, error: BaseException) -> None:
    real, calls = checkpoint.write, []

    def stopping(*arguments: Any) -> None:
        real(*arguments)
        calls.append(1)
        if len(calls) == 1:
            raise error

    monkeypatch.setattr(checkpoint, "write", stopping)


@pytest.mark.parametrize("algorithm", ["ppo", "sac"])
def test_a_killed_training_goes_on_to_the_same_policy(
    algorithm: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = train.run(short(algorithm), tmp_path / "whole")
    with monkeypatch.context() as patch:
        killed_after_first_stage(patch, KeyboardInterrupt())
        with pytest.raises(KeyboardInterrupt):
            train.run(short(algorithm), tmp_path / "killed")
    assert Policy.load(tmp_path / "killed" / "policy.json").steps <= SHORT[algorithm].steps // 2
    resumed = train.run(short(algorithm), tmp_path / "killed", resume=True)
    assert resumed.to_dict() == whole.to_dict()
    assert (tmp_path / "killed" / "policy.json").read_bytes() == (tmp_path / "whole" / "policy.json").read_bytes()
    curves = [
        np.genfromtxt(tmp_path / name / "curve.csv", delimiter=",", names=True)[["steps", "standing", "held", "reward"]]
        for name in ("whole", "killed")
    ]
    assert len(curves[0]) == 4
    np.testing.assert_array_equal(*curves)
    assert list((tmp_path / "whole" / "tensorboard").iterdir())


def test_learning_makes_it_stand_longer() -> None:
    recipe = dataclasses.replace(RECIPES["ppo"], steps=64_000, num_envs=16, stage=4_000, learning_rate=1e-3)
    training = short(recipe=recipe, seed=101)
    rig = Rig.of(training)
    learner = Learner(training, rig)
    before = evaluate(learner.policy(), rig, runs=20, seconds=20.0)
    learner.learn(0, lambda: None)
    after = evaluate(learner.policy(), rig, runs=20, seconds=20.0)
    longer = np.array(after.held) > np.array(before.held)
    assert longer.sum() >= 17  # of 20 initial states; by chance that happens once in 770 times


@pytest.mark.parametrize("algorithm", ["ppo", "sac"])
def test_the_file_acts_as_the_model_does(algorithm: str) -> None:
    training = short(algorithm)
    learner = Learner(training, Rig.of(training))
    learner.learn(0, lambda: None)
    learner.model.policy.load_state_dict(learner.average, strict=False)
    policy = learner.policy()
    observations = np.random.default_rng(1).normal(0.0, [0.2, 0.1, 0.1, 1.0, 1.0, 1.0], (50, 6))
    theirs, _ = learner.model.predict((observations / SCALES["balance"]).astype(np.float32), deterministic=True)
    np.testing.assert_allclose(policy.command(observations), policy.limit * theirs[:, 0], atol=1e-4 * policy.limit)


def test_who_learns_from_the_state_is_judged_on_readings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[bool] = []
    many = Rig.many

    def spy(rig: Rig, count: int, steps: int | None, *, exact_state: bool = False, **more: Any) -> Any:
        envs = many(rig, count, steps, exact_state=exact_state, **more)
        observations, _ = envs.reset(seed=1)
        assert np.allclose(observations, envs.unwrapped.state, rtol=0, atol=1e-9) == exact_state
        made.append(exact_state)
        return envs

    monkeypatch.setattr(Rig, "many", spy)
    training = short("sac")
    train.run(dataclasses.replace(training, recipe=dataclasses.replace(training.recipe, exact_state=True)), tmp_path)
    assert made[0]
    assert len(made) > 2
    assert not any(made[1:])


def test_a_held_command_is_one_given_again_and_again() -> None:
    rig = Rig.of(short())
    scales = SCALES["balance"]
    one, held = (ScaledRigs(DIPCFrictionVecEnv(rig.many(3, 150)), scales, 24.0, 0.5, hold) for hold in (1, 6))
    for rigs in (one, held):
        rigs.seed(3)
    np.testing.assert_array_equal(one.reset(), held.reset())
    commands = np.array([[-1.0], [0.0], [0.02]])  # the first falls soon, and the others are truncated in a 25th step
    reasons = []
    for _ in range(30):
        now, rewards, over, last = commands, np.zeros(3), np.zeros(3, dtype=bool), [{}, {}, {}]
        for _ in range(6):
            observations, earned, ended, infos = one.step(now)
            rewards += np.where(over, 0.0, earned)
            for i in np.flatnonzero(ended & ~over):
                last[i] = infos[i]
                reasons.append(infos[i]["TimeLimit.truncated"])
            over |= ended
            now = np.where(over[:, None], 0.0, commands)
        theirs, mean, ended, infos = held.step(commands)
        np.testing.assert_array_equal(theirs, observations)
        np.testing.assert_allclose(mean, rewards / 6, rtol=1e-6)
        np.testing.assert_array_equal(ended, over)
        for mine, other in zip(last, infos, strict=True):
            assert mine.get("TimeLimit.truncated") == other.get("TimeLimit.truncated")
            np.testing.assert_array_equal(mine.get("terminal_observation", 0), other.get("terminal_observation", 0))
    assert reasons.count(False) >= 3


def test_a_full_disk_leaves_the_last_checkpoint_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "run"
    with monkeypatch.context() as patch:
        killed_after_first_stage(patch, OSError(errno.EIO, "killed here"))
        with pytest.raises(OSError, match="killed here after 2,000"):
            train.run(short(), out)
    before = (out / "checkpoint.pt").read_bytes()
    with monkeypatch.context() as patch:
        real = checkpoint.write_whole

        def full(path: Path, content: bytes) -> None:
            if Path(path).name == "checkpoint.pt":
                patch.setattr("os.fsync", no_space)
            real(path, content)

        def no_space(_: int) -> None:
            raise OSError(errno.ENOSPC, "No space left on device")

        patch.setattr(checkpoint, "write_whole", full)
        with pytest.raises(OSError, match=r"No space left on device.* after 4,000.*--resume") as caught:
            train.run(short(), out, resume=True)
        assert caught.value.errno == errno.ENOSPC
        assert str(caught.value.filename).endswith("checkpoint.pt")
    assert (out / "checkpoint.pt").read_bytes() == before
    assert not list(out.glob("*.partial"))
    assert train.run(short(), out, resume=True).steps <= 4_000


def test_results_are_never_overwritten_by_surprise(tmp_path: Path) -> None:
    (tmp_path / "note.txt").write_text("mine")
    with pytest.raises(FileExistsError, match="--resume or --overwrite"):
        train.run(short(), tmp_path)
    train.run(short(), tmp_path, overwrite=True)
    assert (tmp_path / "note.txt").read_text() == "mine"
    with pytest.raises(TrainingError, match=r"training\.json, 'seed': this training was begun with 5, not 6"):
        train.run(short(seed=6), tmp_path, resume=True)
    longer = dataclasses.replace(SHORT["ppo"], steps=9_000)
    with pytest.raises(TrainingError, match=r"'recipe\.steps': this training was begun with 4000, not 9000"):
        train.run(short(recipe=longer), tmp_path, resume=True)
    for foreign in ("[]", "{}", '{"recipe": 1}'):
        (tmp_path / "training.json").write_text(foreign)
        with pytest.raises(TrainingError, match="cannot be read"):
            train.run(short(), tmp_path, resume=True)


def test_without_its_packages_training_says_how_to_install_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "dipc_gym.training.learner", None)
    with pytest.raises(
        ImportError,
        match=r"add its extra: pip install '\.\[rl\]' in a clone",
    ):
        train.run(short(), tmp_path / "run")


def test_a_training_is_not_resumed_with_another_file(tmp_path: Path) -> None:
    """Of the same name: the policy would be of two rigs."""
    plant = tmp_path / "rig.json"
    plant.write_text('{"friction": {"coulomb": 5.0}}')
    training = short(plant=str(plant))
    out = folder.prepare(training, tmp_path / "run", resume=False, overwrite=False)
    assert folder.prepare(training, out, resume=True, overwrite=False) == out
    plant.write_text('{"friction": {"coulomb": 9.0}}')
    with pytest.raises(TrainingError, match=r"rig\.json: not the file that the training of .*training\.json was begun"):
        folder.prepare(training, out, resume=True, overwrite=False)


class Bomb:
    def __reduce__(self) -> Any:
        return (Path.touch, (Path("exploded"),))


def test_nothing_in_a_checkpoint_is_executed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    out = tmp_path / "run"
    train.run(short(), out)
    whole = (out / "checkpoint.pt").read_bytes()
    for content in (pickle.dumps(Bomb()), b"", whole[: len(whole) // 2]):
        (out / "checkpoint.pt").write_bytes(content)
        with pytest.raises(TrainingError, match=r"checkpoint\.pt: no checkpoint of this training.*--overwrite"):
            train.run(short(), out, resume=True)
    assert not (tmp_path / "exploded").exists()


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--steps", "0"], "steps is 0"),
        (["--num-envs", "-4"], "num_envs is -4"),
        (["--seed", "-1"], "--seed -1: it must be a whole number from 0 on"),
        (["--limit", "0"], "the limit is 0"),
        (["--limit", "nan"], "the limit is nan"),
        (["--compensator", "magic"], "there is no compensator 'magic'; there are none"),
        (["--compensator", "gone.json"], "gone.json: cannot be read"),
        (["--plant", "gone.json"], "gone.json"),
    ],
)
def test_bad_options_are_refused_before_anything_is_written(
    options: list[str], says: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "run"
    assert cli.main(["train-policy", "--out", str(out), *options]) == 2
    assert says in capsys.readouterr().err
    assert not out.exists()


def test_command_line_trains_and_says_how_it_did(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "run"
    command = ["train-policy", "--out", str(out), "--compensator", "ideal", "--steps", "8000", "--num-envs", "8"]
    assert cli.main(command) == 0
    said = capsys.readouterr().out
    assert "policy.json: ppo, force through ideal" in said
    assert "stood for 80 s in 0 of 2 runs" in said
    assert (out / "compensator.json").is_file()
    assert cli.main(command) == 2
    assert cli.main([*command, "--resume"]) == 0


def test_it_learns_on_compiled_rigs_and_is_tried_on_mujoco(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made, real = [], train.Rig.many

    def many(*args: Any, engine: str = "mujoco", **kwargs: Any) -> Any:
        made.append(engine)
        return real(*args, engine=engine, **kwargs)

    monkeypatch.setattr(train.Rig, "many", many)
    recipe = dataclasses.replace(SHORT["ppo"], engine="compiled")
    train.run(short(recipe=recipe), tmp_path / "out", quiet=True)
    assert made.count("compiled") == 1
    assert made.count("mujoco") > 1
    with pytest.raises(TrainingError, match=r"recipe\.engine.*begun with 'compiled', not 'mujoco'"):
        train.run(short(), tmp_path / "out", resume=True, quiet=True)
    with pytest.raises(TrainingError, match="engine is 'gpu'; it can be 'mujoco' or 'compiled'"):
        dataclasses.replace(recipe, engine="gpu")


def test_a_training_from_before_there_was_a_choice_of_engine_goes_on(tmp_path: Path) -> None:
    first = train.run(short(), tmp_path / "out", quiet=True)
    note = tmp_path / "out" / "training.json"
    old = json.loads(note.read_text())
    del old["recipe"]["engine"]
    note.write_text(json.dumps(old))
    assert train.run(short(), tmp_path / "out", resume=True, quiet=True).to_dict() == first.to_dict()


LINE = {"steps": 2_000, "seconds": 1.0, "standing": 0, "held": 0.5, "reward": 0.1}
FAULTS = (
    lambda held: held["looks"].append({**LINE, "seconds": "long"}),
    lambda held: held["learner"].update(steps="many"),
    lambda held: held["learner"]["average"].popitem(),
    lambda held: held["learner"].update(average={k: v[:1] for k, v in held["learner"]["average"].items()}),
)


def test_a_checkpoint_that_unpickles_and_is_none_of_this_training_is_refused(tmp_path: Path) -> None:
    import torch

    out = tmp_path / "run"
    train.run(short(), out)
    whole = (out / "checkpoint.pt").read_bytes()
    for fault in FAULTS:
        (out / "checkpoint.pt").write_bytes(whole)
        held = torch.load(out / "checkpoint.pt", weights_only=True)
        fault(held)
        torch.save(held, out / "checkpoint.pt")
        with pytest.raises(TrainingError, match=r"checkpoint\.pt: no checkpoint of this training.*--overwrite"):
            train.run(short(), out, resume=True)


def test_going_on_needs_the_best_policy_so_far_and_says_so_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "run"
    with monkeypatch.context() as patch:
        killed_after_first_stage(patch, KeyboardInterrupt())
        with pytest.raises(KeyboardInterrupt):
            train.run(short(), out)
    (out / "policy.json").write_text("{")
    before = (out / "checkpoint.pt").read_bytes()
    with pytest.raises(ControllerError, match=r"policy\.json: not JSON"):
        train.run(short(), out, resume=True)
    assert (out / "checkpoint.pt").read_bytes() == before


@pytest.mark.parametrize("name", ["policy.json", "compensator.json", "tensorboard/other/run"])
def test_files_of_no_training_are_not_cleared(name: str, tmp_path: Path) -> None:
    """Such as a compensator that was saved by hand, or the logs of other runs."""
    mine = tmp_path / name
    mine.parent.mkdir(parents=True, exist_ok=True)
    mine.write_text("mine")
    with pytest.raises(FileExistsError, match=r"is of no training, for there is no training\.json; move it"):
        folder.prepare(short(), tmp_path, resume=False, overwrite=True)
    assert mine.read_text() == "mine"


def test_friction_cannot_be_observed_where_a_recipe_learns_from_the_exact_state() -> None:
    training = short(compensator="observed", estimator="disturbance")
    exact = dataclasses.replace(training, recipe=dataclasses.replace(training.recipe, exact_state=True))
    with pytest.raises(TrainingError, match=r"'observed' takes friction from an estimator, .* take another"):
        Rig.of(exact)


@pytest.mark.parametrize("name", folder.FILES)
def test_a_pipe_in_the_place_of_a_file_is_not_waited_for(name: str, tmp_path: Path) -> None:
    out = tmp_path / "run"
    folder.prepare(short(), out, resume=False, overwrite=False)
    (out / name).unlink(missing_ok=True)
    os.mkfifo(out / name)
    with pytest.raises(TrainingError, match=f"{name}: is no file; start anew with --overwrite"):
        folder.prepare(short(), out, resume=True, overwrite=False)
    folder.prepare(short(), out, resume=False, overwrite=True)


def test_what_a_kill_before_the_first_file_leaves_is_no_hindrance(tmp_path: Path) -> None:
    (tmp_path / ".training.json.99999999.partial").touch()
    folder.prepare(short(), tmp_path, resume=False, overwrite=False)
    assert [path.name for path in tmp_path.iterdir()] == ["training.json"]
