"""Compensators by name, and the one way to fit them."""

from __future__ import annotations

import dataclasses

import numpy as np

from dipc_gym.compensators.base import (
    Compensator,
    FitFigures,
    InputRange,
    RigConstants,
    Samples,
)
from dipc_gym.safety.naming import suggestion

_KINDS: dict[str, type[Compensator]] = {}


def register(name: str, cls: type[Compensator]) -> None:
    """Make a compensator known by a name, to `fit`, `load`, and comparisons that are begun from Python.

    Registering a name again replaces what it stood for, so that a notebook cell can be run twice.

    Args:
        name: The name; it also stands as `kind` in the files.
        cls: A frozen dataclass derived from `Compensator`.

    Raises:
        ValueError: The name is not usable, or `cls` is already registered under another.
        TypeError: `cls` is not a compensator class.
    """
    if not (isinstance(cls, type) and issubclass(cls, Compensator)):
        raise TypeError(f"{cls!r} is not a class derived from Compensator")
    if not (isinstance(name, str) and name.isidentifier()):
        raise ValueError(f"{name!r} is no name for a compensator: letters, digits and underscores, please")
    own = cls.__dict__.get("name", "")  # what a class has from the one it is derived from is not its own
    if own not in ("", name):
        raise ValueError(f"{cls.__name__} is registered as {own!r}; derive a class of its own for {name!r}")
    cls.name = name
    _KINDS[name] = cls


def names() -> list[str]:
    """Return the registered names, in the order of registration."""
    return list(_KINDS)


def registered_elsewhere() -> dict[str, type[Compensator]]:
    """Return the classes that are none of this package's, by name: another process has to `register` them as well."""
    own = __name__.rpartition(".")[0]
    return {name: cls for name, cls in _KINDS.items() if cls.__module__.rpartition(".")[0] != own}


def kind(name: str) -> type[Compensator]:
    """Return the class registered under a name.

    Raises:
        ValueError: There is none; the message lists what there is.
    """
    if name not in _KINDS:
        raise ValueError(f"there is no compensator {name!r}; there are {', '.join(_KINDS)}{suggestion(name, _KINDS)}")
    return _KINDS[name]


def fit(name: str, samples: Samples, rig: RigConstants, *, seed: int = 0) -> Compensator:
    """Fit a compensator to an identification run.

    Args:
        name: One of `names()`.
        samples: The run, split into training and test.
        rig: What is known of the rig.
        seed: Seed of whatever is random in the training; the same seed gives the same compensator.

    Returns:
        The compensator, with the ranges of its inputs and its errors on both parts of the run.

    Raises:
        ValueError: There is no compensator of that name.

    Example:
        >>> import numpy as np
        >>> v = np.sin(np.linspace(0, 20, 400))
        >>> train = np.arange(400) % 2 == 0
        >>> samples = Samples(40 * v, v, v, 10 * v + 2 * np.tanh(v / 0.01), train)
        >>> rig = RigConstants(newtons_per_volt=4.0, viscous=40.0, supply_voltage=24.0)
        >>> round(fit("feedforward", samples, rig).coulomb, 3)
        2.0
    """
    found = dataclasses.replace(kind(name).fit(samples, rig, seed=seed), supply=rig.supply_voltage)
    return judged(found, samples)


def judged(compensator: Compensator, samples: Samples) -> Compensator:
    """Return a compensator with the ranges of a run's inputs, and its errors on both parts of the run.

    Args:
        compensator: However it was found.
        samples: The run.
    """
    if compensator.needs_friction:
        return compensator
    error = compensator.replay(samples) - samples.voltage
    train = samples.train
    figures = FitFigures(
        train_mse=float(np.mean(error[train] ** 2)),
        test_mse=float(np.mean(error[~train] ** 2)),
        train_samples=int(np.sum(train)),
        test_samples=int(np.sum(~train)),
    )
    ranges: tuple[InputRange, ...] = ()
    if compensator.parameters:
        seen = samples.inputs[train]
        ranges = tuple(InputRange(low, high) for low, high in zip(*_ends(seen), strict=True))
    return dataclasses.replace(compensator, ranges=ranges, figures=figures)


def _ends(inputs: np.ndarray) -> tuple[list[float], list[float]]:
    return inputs.min(axis=0).tolist(), inputs.max(axis=0).tolist()
