"""The catalogue of physical effects, one file an effect.

A file in this folder that defines a subclass of `Effect` is in the catalogue. An effect of your own, from anywhere,
joins it by `register`.
"""

from __future__ import annotations

import importlib
import inspect
import pkgutil

from dipc_gym.safety.naming import suggestion
from dipc_gym.sim2real.effects.shared.base import Effect, Evidence, Form, Parameter, Values

__all__ = ["Effect", "Evidence", "Parameter", "Values", "catalogue", "register"]

_effects: dict[str, Effect] = {}


class _ById(dict[str, Effect]):
    def __missing__(self, unknown: str) -> Effect:
        raise KeyError(f"the catalogue has no effect {unknown!r}{suggestion(unknown, self)}")


def register(effect: Effect) -> None:
    """Add an effect to the catalogue.

    Raises:
        ValueError: the catalogue has that id.
    """
    if effect.id in catalogue():
        raise ValueError(f"the catalogue has an effect {effect.id!r} already")
    _effects[effect.id] = effect


def catalogue() -> dict[str, Effect]:
    """Every effect by id, in alphabetical order.

    Example:
        >>> catalogue()["friction.coulom"]
        Traceback (most recent call last):
        KeyError: "the catalogue has no effect 'friction.coulom'; did you mean 'friction.coulomb'?"
    """
    if not _effects:
        _effects.update(_shipped())  # all or none: Ctrl-C may come between two of them
    return _ById(sorted(_effects.items()))


def _shipped() -> dict[str, Effect]:
    """The effects of the modules in this folder."""
    shipped: dict[str, Effect] = {}
    for info in pkgutil.iter_modules(__path__):
        module = importlib.import_module(f"{__name__}.{info.name}")
        for _, found in inspect.getmembers(module, inspect.isclass):
            if not issubclass(found, Effect) or issubclass(found, Form) or inspect.isabstract(found):
                continue
            if found.__module__ == module.__name__:
                shipped[found.id] = found()
    return shipped
