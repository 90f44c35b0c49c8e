"""Learned policies in files, and as controllers."""

from __future__ import annotations

import copy
import errno
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from dipc_gym import policy as policies
from dipc_gym.compensators import StaticGain
from dipc_gym.controllers import ControllerError
from dipc_gym.policy import Evaluation, Policy
from dipc_gym.training.train import Rig, Training, evaluate

RNG = np.random.default_rng(7)
OBSERVATION = np.array([0.1, -0.02, 0.03, 0.4, -0.2, 0.1])


def made(**changes: Any) -> Policy:
    layers = (
        (RNG.normal(size=(5, 6)), RNG.normal(size=5)),
        (RNG.normal(size=(4, 5)), RNG.normal(size=4)),
        (RNG.normal(size=(1, 4)), RNG.normal(size=1)),
    )
    values: dict[str, Any] = {"layers": layers, "commands": "force", "limit": 40.0, "compensator": "llnf"}
    return Policy(**values | {"scales": np.array([0.1, 0.05, 0.05, 0.5, 0.5, 0.5])} | changes)


# ------------------------------------------------------------------------------------------------- as a controller


@pytest.mark.parametrize("squash", ["clip", "tanh"])
def test_network_is_what_torch_computes(squash: str) -> None:
    torch = pytest.importorskip("torch")
    ours = made(squash=squash)
    x = torch.tensor(OBSERVATION / ours.scales)
    for i, (weights, biases) in enumerate(ours.layers):
        x = torch.nn.functional.linear(x, torch.tensor(weights), torch.tensor(biases))
        if i < len(ours.layers) - 1 or squash == "tanh":
            x = torch.tanh(x)
    assert ours.force(OBSERVATION) == pytest.approx(40.0 * float(x.clamp(-1, 1)[0]), rel=1e-12)


@given(arrays.arrays(np.float64, (3, 6), elements=st.floats(-1e3, 1e3)), st.sampled_from(["clip", "tanh"]))
def test_commands_never_leave_their_limit_and_rows_do_not_mix(observations: np.ndarray, squash: str) -> None:
    ours = made(squash=squash)
    commands = ours.command(observations)
    assert (np.abs(commands) <= 40.0).all()
    np.testing.assert_allclose(commands, [ours.force(row) for row in observations], rtol=1e-9, atol=1e-9)


def test_a_voltage_comes_back_from_no_compensator() -> None:
    ours = made(commands="voltage", limit=15.0, compensator="none", newtons_per_volt=3.94)
    volts = StaticGain(newtons_per_volt=3.94).voltage(ours.force(OBSERVATION), 0.1)
    assert volts == pytest.approx(float(ours.command(OBSERVATION)), rel=1e-12)


def test_the_wrong_compensator_is_refused_by_name() -> None:
    made().require("llnf")
    with pytest.raises(ControllerError, match=r"trained with the compensator 'llnf'.*'mlp'.*--compensator llnf"):
        made().require("mlp")
    with pytest.raises(ControllerError, match="trained directly on the voltage"):
        made(commands="voltage", compensator="none").require("llnf")


def test_impossible_policies_are_refused() -> None:
    good = made().layers
    for changes, says in (
        ({"limit": 0.0}, "limit is 0"),
        ({"newtons_per_volt": float("nan")}, "newtons_per_volt is nan"),
        ({"commands": "speed"}, "'force' or 'voltage'"),
        ({"commands": "voltage"}, "has the compensator 'none'"),
        ({"squash": "sine"}, "'clip' or 'tanh'"),
        ({"scales": np.zeros(6)}, "scales must be six"),
        ({"layers": ()}, "one number"),
        ({"layers": good[:2]}, "one number"),
        ({"layers": good[1:]}, "gets 6 inputs"),
        ({"layers": ((np.full((1, 6), np.inf), np.zeros(1)),)}, "not finite"),
    ):
        with pytest.raises(ValueError, match=says):
            made(**changes)


# ------------------------------------------------------------------------------------------------- files


def test_a_file_gives_the_same_policy(tmp_path: Path) -> None:
    tried = Evaluation(seconds=80.0, seeds=(3, 4), held=(80.0, 1.5), reward=0.5)
    ours = made(algorithm="sac", seed=3, steps=1000, squash="tanh", evaluation=tried)
    ours.save(tmp_path / "mine.json")
    again = Policy.load(tmp_path / "mine.json")
    assert again.to_dict() == ours.to_dict()
    assert again.name == "mine"
    assert again.force(OBSERVATION) == ours.force(OBSERVATION)
    assert again.evaluation is not None
    assert again.evaluation.standing == 1


def test_a_full_disk_leaves_the_old_policy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made(limit=1.0).save(tmp_path / "policy.json")

    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(OSError, match="No space left"):
        made(limit=2.0).save(tmp_path / "policy.json")
    assert Policy.load(tmp_path / "policy.json").limit == 1.0
    assert [path.name for path in tmp_path.iterdir()] == ["policy.json"]


def edit(data: Any, where: str, value: Any) -> Any:
    """A copy with one field changed, or left out (`...`)."""
    data = copy.deepcopy(data)
    *path, last = [int(key) if key.isdigit() else key for key in where.split(".")]
    inner = data
    for key in path:
        inner = inner[key]
    if value is ...:
        del inner[last]
    else:
        inner[last] = value
    return data


@pytest.mark.parametrize(
    ("where", "value", "says"),
    [
        ("schema", "dipc-gym/policy/9", r"schema: is 'dipc-gym/policy/9', and this version"),
        ("schema", ..., r"schema: is missing"),
        ("algorithm", "dqn", r"algorithm: is 'dqn'; it must be 'ppo' or 'sac'"),
        ("seed", -1, r"seed: is -1; it must be a whole number"),
        ("steps", True, r"steps: is True"),
        ("compensator", "", r"compensator: is ''; it must be a name"),
        ("commands.name", "speed", r"commands\.name: is 'speed'; it must be 'force' or 'voltage'"),
        ("commands.unit", "V", r"commands\.unit: is 'V'; it must be 'N'"),
        ("commands.limit", -3, r"commands\.limit: is -3; it must be above zero"),
        ("commands.limit", "40", r"commands\.limit: is '40'; it must be a finite number"),
        ("commands", 40, r"commands: is 40; it must be an object with name, unit, limit"),
        ("newtons_per_volt", 10**400, r"newtons_per_volt: is a number of very many digits; it must be a finite number"),
        ("observation", [], r"observation: has 0 entries; it must have 6"),
        ("observation", [{}] * 5, r"observation: has 5 entries; it must have 6"),
        ("observation.2.name", "pole1", r"observation\[2\]\.name: is 'pole1'; it must be 'pole2'"),
        ("observation.2.unit", "deg", r"observation\[2\]\.unit: is 'deg'; it must be 'rad'"),
        ("observation.0.scale", 0, r"observation\[0\]\.scale: is 0; it must be above zero"),
        ("activation", "relu", r"activation: is 'relu'; it must be 'tanh'"),
        ("squash", None, r"squash: is null"),
        ("layers", [], r"layers: has 0 entries; it must have at least one"),
        ("layers.0.weights.3.2", "x", r"layers\[0\]\.weights\[3\]\[2\]: is 'x'; it must be a finite number"),
        ("layers.0.weights.3", [1.0], r"layers\[0\]\.weights\[3\]: has 1 entries; it must have 6"),
        ("layers.1.biases", [0.0], r"layers\[1\]\.weights: has 4 entries; it must have 1"),
        ("layers.0.biases.0", float("nan"), r"layers\[0\]\.biases\[0\]: is nan"),
        ("layers.0.biases.0", 1e305, r"layer 0 has numbers that are not finite, or beyond"),
        ("layers.0.more", 1, r"layers\[0\]\.'more': is unknown"),
        ("layers.0.biases", ..., r"layers\[0\]\.biases: is missing"),
        ("layers", [{"weights": [[1.0] * 6] * 2, "biases": [0.0, 0.0]}], r"must give one number"),
        ("evaluation", [], r"evaluation: is a list; it must be an object"),
        (
            "evaluation",
            {"seconds": 80, "seeds": [1, 2], "held": [80], "reward": 1},
            r"evaluation\.held: has 1 entries; it must have 2",
        ),
        ("extra", 1, r"'extra': is unknown; there are .*: remove or correct it"),
    ],
)
def test_broken_files_name_file_and_field(tmp_path: Path, where: str, value: Any, says: str) -> None:
    file = tmp_path / "bad.json"
    file.write_text(json.dumps(edit(made().to_dict(), where, value)))
    with pytest.raises(ControllerError, match=r"bad\.json.*" + says):
        Policy.load(file)


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"", "is empty"),
        (b'{"schema": ', "perhaps cut short"),
        (b"\xff\xfe", "nor any text in UTF-8"),
        (b"[" * 100_000, "nested too deeply"),
        (b"[]", "top level: is a list; it must be an object"),
        (b" " * 5_000_001, "larger than"),
    ],
)
def test_what_is_no_policy_is_refused(tmp_path: Path, content: bytes, says: str) -> None:
    file = tmp_path / "bad.json"
    file.write_bytes(content)
    with pytest.raises(ControllerError, match=r"bad\.json.*" + says):
        Policy.load(file)
    with pytest.raises(ControllerError, match="cannot be read"):
        Policy.load(tmp_path)
    with pytest.raises(ControllerError, match=r"cannot be read \(No such file"):
        Policy.load(tmp_path / "none.json")


# ------------------------------------------------------------------------------------------------- what is shipped


@pytest.mark.parametrize("name", ["ppo-none", "ppo-llnf", "ppo-observed"])
def test_shipped_policies_hold_the_pendulum(name: str) -> None:
    ours = policies.shipped(name)
    rig = Rig.of(Training(compensator=ours.compensator, estimator=ours.estimator, seed=ours.seed))
    tried = evaluate(ours, rig, runs=10, seconds=80.0, first_seed=30_000)  # neither chosen nor reported on these
    assert tried.standing >= 8


def test_unknown_shipped_policies_are_listed() -> None:
    with pytest.raises(ControllerError, match=r"there are .*ppo-llnf"):
        policies.shipped("pid")


def test_a_slip_in_a_shipped_policys_name_is_told() -> None:
    with pytest.raises(ControllerError, match="did you mean 'ppo-llnf'"):
        policies.shipped("ppo-lnf")
