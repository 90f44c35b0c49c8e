"""Controllers: the printed gain, and policies read without trusting their files."""

from __future__ import annotations

import io
import json
import pickle
import zipfile
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest

import dipc_gym
from dipc_gym import controllers
from dipc_gym.compensators import StaticGain
from dipc_gym.controllers import ControllerError
from dipc_gym.wrappers import ForceCommand

OBSERVATION = np.array([0.05, -0.1, 0.08, 0.2, -0.3, 0.4])


def test_lqr_is_minus_the_printed_gain_times_the_state() -> None:
    brain = controllers.load("lqr")
    for i, newtons in enumerate((-31.6, 720.1, -1176.3, -28.1, 20.0, -210.4)):
        assert brain.force(np.eye(6)[i]) == pytest.approx(newtons)


def saved(algorithm: str, folder: Path, **policy: Any) -> tuple[Any, Path]:
    sb3 = pytest.importorskip("stable_baselines3")
    env = ForceCommand(gymnasium.make(dipc_gym.ENV_ID), StaticGain(newtons_per_volt=4.0))
    model = getattr(sb3, algorithm)("MlpPolicy", env, policy_kwargs=policy or None, seed=1)
    file = folder / f"{algorithm}.zip"
    model.save(file)
    return model, file


@pytest.mark.parametrize(
    ("algorithm", "policy"),
    [
        ("PPO", {}),
        ("PPO", {"net_arch": [32, 16], "activation_fn": "ReLU"}),
        ("A2C", {"activation_fn": "ELU"}),
        ("SAC", {"net_arch": [32, 32]}),
        ("SAC", {"net_arch": [16], "activation_fn": "SiLU"}),
        ("TD3", {"net_arch": [32, 16]}),
        ("DDPG", {}),
    ],
)
def test_policy_acts_as_stable_baselines3_says(algorithm: str, policy: dict[str, Any], tmp_path: Path) -> None:
    torch = pytest.importorskip("torch")
    if "activation_fn" in policy:
        policy = {**policy, "activation_fn": getattr(torch.nn, policy["activation_fn"])}
    model, file = saved(algorithm, tmp_path, **policy)
    ours = controllers.load(str(file))
    assert ours.name == algorithm
    for scale in (0.1, 1.0, 30.0):
        theirs, _ = model.predict(scale * OBSERVATION, deterministic=True)
        assert ours.force(scale * OBSERVATION) == pytest.approx(float(theirs[0]), rel=1e-4, abs=1e-4)


def changed(file: Path, target: Path, **parts: bytes | None) -> Path:
    """A copy of a policy file with some members replaced, or left out (None)."""
    with zipfile.ZipFile(file) as old, zipfile.ZipFile(target, "w") as new:
        for name in old.namelist():
            content = parts.get(name.replace(".", "_"), old.read(name))
            if content is not None:
                new.writestr(name, content)
    return target


class Bomb:
    def __reduce__(self) -> Any:
        return (Path.touch, (Path("exploded"),))


def test_nothing_in_a_policy_file_is_executed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    _, file = saved("PPO", tmp_path)
    with pytest.raises(ControllerError, match=r"policy\.pth"):
        controllers.load(str(changed(file, tmp_path / "bomb.zip", policy_pth=pickle.dumps(Bomb()))))
    description = json.loads(zipfile.ZipFile(file).read("data"))
    for value in description.values():
        if isinstance(value, dict) and ":serialized:" in value:
            value[":serialized:"] = "this would explode"
    controllers.load(str(changed(file, tmp_path / "text.zip", data=json.dumps(description).encode())))
    assert not (tmp_path / "exploded").exists()


def edited(file: Path, target: Path, **changes: Any) -> Path:
    description = json.loads(zipfile.ZipFile(file).read("data"))
    return changed(file, target, data=json.dumps({**description, **changes}).encode())


def tensors(**values: Any) -> bytes:
    torch = pytest.importorskip("torch")
    buffer = io.BytesIO()
    torch.save({key.replace("__", "."): torch.tensor(value) for key, value in values.items()}, buffer)
    return buffer.getvalue()


def test_broken_policy_files_are_refused(tmp_path: Path) -> None:
    _, file = saved("PPO", tmp_path)
    target = tmp_path / "bad.zip"

    def refused(path: Path, says: str) -> None:
        with pytest.raises(ControllerError, match=says):
            controllers.load(str(path))

    refused(tmp_path / "none.zip", "no such policy file")
    target.write_bytes(b"not a zip")
    refused(target, "not a policy saved")
    target.write_bytes(file.read_bytes()[:2000])
    refused(target, "not a policy saved")
    with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("data", "{}")
    packed = bytearray(target.read_bytes())
    begins = packed.index(b"data") + len("data")
    target.write_bytes(packed[:begins] + b"\xff" + packed[begins + 1 :])  # no block of deflate begins like that
    refused(target, "not a policy saved")
    for signature, flags in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        packed[packed.index(signature) + flags] |= 1
    target.write_bytes(packed)
    refused(target, "encrypted")
    refused(changed(file, target, policy_pth=None), "no part 'policy.pth'")
    refused(changed(file, target, data=None), "no part 'data'")
    refused(changed(file, target, data=b"[1]"), "not a JSON object")
    refused(changed(file, target, data=b"{"), "not a policy saved")
    refused(changed(file, target, data=b"[" * 100_000), "not a policy saved")
    refused(edited(file, target, use_sde=True), "state-dependent exploration")
    refused(edited(file, target, action_space={"low": "?", "high": "?"}), "no readable limits")
    refused(edited(file, target, action_space={"low": "[3]", "high": "[-3]"}), "goes from 3")
    refused(edited(file, target, policy_kwargs={"activation_fn": "<class 'evil.Thing'>"}), "activation 'Thing'")
    refused(changed(file, target, policy_pth=tensors(other=[1.0])), "no actor")
    refused(
        changed(file, target, policy_pth=tensors(action_net__weight=[[1.0] * 4], action_net__bias=[0.0])), "6 inputs"
    )
    refused(
        changed(file, target, policy_pth=tensors(action_net__weight=[[1.0] * 6] * 2, action_net__bias=[0.0] * 2)),
        "action has 2 numbers",
    )
    refused(
        changed(file, target, policy_pth=tensors(action_net__weight=[[float("nan")] * 6], action_net__bias=[0.0])),
        "not finite",
    )
    refused(changed(file, target, policy_pth=tensors(action_net__weight=[[1.0] * 6])), "is missing")


def test_unknown_controllers_are_listed() -> None:
    with pytest.raises(ControllerError, match=r"there are 'lqr', .* and paths"):
        controllers.load("pid")
