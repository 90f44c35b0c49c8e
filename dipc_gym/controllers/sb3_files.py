"""Policies that stable-baselines3 saved, read without executing anything in them."""

from __future__ import annotations

import io
import json
import re
import zipfile
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from dipc_gym.controllers import normalisation
from dipc_gym.policy import ControllerError
from dipc_gym.safety.untrusted import first_line

if TYPE_CHECKING:
    pass

Array = NDArray[np.float64]

LARGEST_PART = 200_000_000  # bytes of one member of a policy file


@dataclass(frozen=True, eq=False)
class SB3Policy:
    """A learned network, evaluated in NumPy at its most likely action.

    Attributes:
        name: the file's stem.
        layers: weights (out, in) and biases (out,) from first to last.
        activation: between the layers.
        squash: whether a tanh follows the last layer and is scaled to the limits; else the output is clipped to them.
        low: smallest force, N.
        high: largest force, N.
        normalised: what is made of an observation before the network sees it; by default nothing.
    """

    name: str
    layers: tuple[tuple[Array, Array], ...]
    activation: Callable[[Array], Array]
    squash: bool
    low: float
    high: float
    normalised: Callable[[Array], Array] | None = None

    def force(self, observation: Array) -> float:
        """The network's action, in newtons as it was trained with `ForceCommand`."""
        x = observation if self.normalised is None else self.normalised(observation)
        for weight, bias in self.layers[:-1]:
            x = self.activation(weight @ x + bias)
        weight, bias = self.layers[-1]
        out = float((weight @ x + bias)[0])
        if self.squash:
            return self.low + 0.5 * (float(np.tanh(out)) + 1.0) * (self.high - self.low)
        return min(max(out, self.low), self.high)


def read_policy(path: str | Path) -> SB3Policy:
    """Read a policy that stable-baselines3 saved, without executing anything in it.

    Such a file also holds pickled objects, which run code when loaded; they are left alone. Weights are read by
    `torch.load(weights_only=True)`, everything else from the readable part of the JSON. That suffices for the
    `MlpPolicy` of PPO, A2C, SAC, TD3 and DDPG with tanh, ReLU, ELU or SiLU, trained on this environment's observations
    behind `ForceCommand`. One that was trained with `VecNormalize` needs its statistics: `sb3.save_statistics` puts
    them beside the file, where they are found. Not supported: state-dependent exploration and feature extractors.

    Raises:
        ControllerError: not such a file, or of a kind that is not supported; or the statistics beside it are broken.
        ImportError: torch is not installed.
    """
    path = Path(path)
    try:
        with zipfile.ZipFile(path) as archive:
            description = json.loads(_member(archive, "data", path))
            weights = _member(archive, "policy.pth", path)
    except FileNotFoundError:
        raise ControllerError(f"{path}: no such policy file") from None
    except (OSError, EOFError, zipfile.BadZipFile, zlib.error, ValueError, RuntimeError) as error:
        if isinstance(error, ControllerError):
            raise
        raise ControllerError(f"{path}: not a policy saved by stable-baselines3 ({error})") from None
    if not isinstance(description, dict):
        raise ControllerError(f"{path}, data: not a JSON object")
    policy = _policy(path, description, _tensors(path, weights))
    if not normalisation.place(path).exists():
        return policy
    return replace(policy, normalised=normalisation.Statistics.load(path).normalised)


def _policy(path: Path, description: Mapping[str, Any], tensors: Mapping[str, Array]) -> SB3Policy:
    if description.get("use_sde"):
        raise ControllerError(f"{path}: policies with state-dependent exploration (use_sde) are not supported")
    if any("features_extractor" in key for key in tensors):
        raise ControllerError(f"{path}: only MlpPolicy is supported; this one has a feature extractor")
    if "action_net.weight" in tensors:  # PPO, A2C
        hidden, last, squash, activation = "mlp_extractor.policy_net", "action_net", False, "Tanh"
    elif "actor.latent_pi.0.weight" in tensors:  # SAC
        hidden, last, squash, activation = "actor.latent_pi", "actor.mu", True, "ReLU"
    elif "actor.mu.0.weight" in tensors:  # TD3, DDPG
        hidden, last, squash, activation = "actor.mu", "", True, "ReLU"
    else:
        raise ControllerError(f"{path}, policy.pth: no actor of PPO, A2C, SAC, TD3 or DDPG in it")
    numbers = sorted(int(m[1]) for key in tensors if (m := re.fullmatch(re.escape(hidden) + r"\.(\d+)\.weight", key)))
    names = [f"{hidden}.{n}" for n in numbers] + ([last] if last else [])
    try:
        layers = tuple((tensors[f"{name}.weight"], tensors[f"{name}.bias"]) for name in names)
    except KeyError as error:
        raise ControllerError(f"{path}, policy.pth: {error} is missing") from None
    size = 6
    for name, (weight, bias) in zip(names, layers, strict=True):
        if weight.ndim != 2 or weight.shape[1] != size or bias.shape != weight.shape[:1]:
            raise ControllerError(f"{path}, policy.pth: layer {name} has {weight.shape} weights; it gets {size} inputs")
        if not (np.isfinite(weight).all() and np.isfinite(bias).all()):
            raise ControllerError(f"{path}, policy.pth: layer {name} has weights that are not finite")
        size = len(bias)
    if size != 1:
        raise ControllerError(f"{path}: its action has {size} numbers; the force is one")
    options = description.get("policy_kwargs")
    said = str(options.get("activation_fn", "")) if isinstance(options, dict) else ""
    if said:
        activation = said.rstrip("'>").rpartition(".")[2]
    if activation not in _ACTIVATIONS:
        raise ControllerError(f"{path}: activation {activation!r} is not among {', '.join(_ACTIVATIONS)}")
    low, high = _limits(path, description)
    return SB3Policy(path.stem, layers, _ACTIVATIONS[activation], squash, low, high)


def _limits(path: Path, description: Mapping[str, Any]) -> tuple[float, float]:
    space = description.get("action_space")
    try:
        low, high = (float(str(space[key]).strip("[] ")) for key in ("low", "high"))  # type: ignore[index]
    except (TypeError, KeyError, ValueError):
        raise ControllerError(f"{path}, data: the action space has no readable limits 'low' and 'high'") from None
    if not -np.inf < low < high < np.inf:
        raise ControllerError(f"{path}, data: the action space goes from {low} to {high}")
    return low, high


def _member(archive: zipfile.ZipFile, name: str, path: Path) -> bytes:
    try:
        size = archive.getinfo(name).file_size
    except KeyError:
        raise ControllerError(f"{path}: has no part {name!r}; not a policy saved by stable-baselines3") from None
    if size > LARGEST_PART:
        raise ControllerError(f"{path}: its part {name!r} is too large ({size:,} bytes)")
    return archive.read(name)


def _tensors(path: Path, data: bytes) -> dict[str, Array]:
    try:
        import torch
    except ImportError as missing:
        raise ImportError(
            "reading a saved policy needs torch: add its extra: pip install '.[rl]' in a clone"
        ) from missing
    try:
        loaded = torch.load(io.BytesIO(data), map_location="cpu", weights_only=True)
        return {str(key): value.double().numpy() for key, value in loaded.items()}
    except Exception as error:  # whatever a broken or hostile file makes torch raise
        raise ControllerError(f"{path}, policy.pth: cannot be read as weights ({first_line(error)})") from None


# Of networks of stable-baselines3, by the names that torch has for them.
_ACTIVATIONS: dict[str, Callable[[Array], Array]] = {
    "Tanh": np.tanh,
    "ReLU": lambda x: np.maximum(x, 0.0),
    "ELU": lambda x: np.where(x > 0, x, np.expm1(np.minimum(x, 0.0))),
    "SiLU": lambda x: x / (1 + np.exp(-x)),
}
