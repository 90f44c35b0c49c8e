"""Estimators by name, and the one way to fit them."""

from __future__ import annotations

from dipc_gym.compensators import LuGre, RigConstants, Samples
from dipc_gym.estimators.base import Estimator, RigModel
from dipc_gym.safety.naming import suggestion

_KINDS: dict[str, type[Estimator]] = {}


def register(name: str, cls: type[Estimator]) -> None:
    """Make an estimator known by a name, to `fit`, `load` and the command line.

    Raises:
        ValueError: the name is not one word.
        TypeError: `cls` is not derived from `Estimator`.
    """
    if not (isinstance(cls, type) and issubclass(cls, Estimator)):
        raise TypeError(f"{cls!r} is not a class derived from Estimator")
    if not (isinstance(name, str) and name.isidentifier()):
        raise ValueError(f"{name!r} is no name for an estimator: letters, digits and underscores, please")
    cls.name = name
    _KINDS[name] = cls


def names() -> list[str]:
    """The registered names, in the order of registration."""
    return list(_KINDS)


def kind(name: str) -> type[Estimator]:
    """The class registered under a name.

    Raises:
        ValueError: there is none; the message lists what there is.
    """
    if name not in _KINDS:
        raise ValueError(f"there is no estimator {name!r}; there are {', '.join(_KINDS)}{suggestion(name, _KINDS)}")
    return _KINDS[name]


def fit(name: str, samples: Samples, constants: RigConstants, rig: RigModel, *, seed: int = 0) -> Estimator:
    """Fit an estimator to an identification run: what it learns there is the friction.

    Args:
        name: one of `names()`.
        samples: the run.
        constants: of the cart with locked poles.
        rig: linear model and sensors of the whole rig.
        seed: of whatever is random in the fit.

    Raises:
        ValueError: there is no estimator of that name, or no filter for such a model.
    """
    return kind(name)(rig, LuGre.fit(samples, constants, seed=seed).friction)
