"""What to add to a message about an unknown name: the one that was probably meant."""

from __future__ import annotations

import difflib
from collections.abc import Iterable

NEAR = 0.6  # share of letters that agree from which a name is taken for a slip of another


def suggestion(name: str, known: Iterable[str]) -> str:
    """The end of a message about an unknown name; empty where no known one is near.

    Args:
        name: as it was given.
        known: the names that there are.

    Example:
        >>> suggestion("friction.Colomb", ["friction.coulomb", "friction.viscous"])
        "; did you mean 'friction.coulomb'?"
        >>> suggestion("strat", ["state", "start"])
        "; did you mean 'start'?"
        >>> suggestion("pid", ["lqr"])
        ''
    """
    given, as_written = str(name).lower(), {one.lower(): one for one in known}
    near = difflib.get_close_matches(given, list(as_written), n=3, cutoff=NEAR)
    swapped = [one for one in near if sorted(one) == sorted(given)]  # the commonest slip: two letters change places
    return f"; did you mean {as_written[(swapped or near)[0]]!r}?" if near else ""
