"""Figures that come out the same wherever they are drawn.

Matplotlib takes settings from a file `matplotlibrc` in the current folder, which may be a stranger's: one that asks for
LaTeX has a program run. Of such a file nothing is used here, nor of the user's own, so that a figure is the same on
every machine.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from types import MappingProxyType
from typing import Any

NONE: Mapping[str, Any] = MappingProxyType({})


@contextmanager
def settings(own: Mapping[str, Any] = NONE) -> Iterator[None]:
    """Draw and write figures with matplotlib's own defaults.

    Args:
        own: settings that differ from the defaults, by matplotlib's names.

    Example:
        >>> import matplotlib
        >>> with settings({"font.size": 8.0}):
        ...     matplotlib.rcParams["font.size"], matplotlib.rcParams["text.usetex"]
        (8.0, False)
    """
    from matplotlib import style

    with style.context(dict(own), after_reset=True):
        yield
