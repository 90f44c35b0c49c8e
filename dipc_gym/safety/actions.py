"""Actions as environments and wrappers take them: finite numbers, one for each rig."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray


def one(action: Any, quantity: str) -> float:
    """The number in the action of one rig.

    Args:
        action: (1,), of whatever kind holds one number.
        quantity: what the number is, for the message.

    Raises:
        ValueError: it is not one finite number.

    Example:
        >>> one([2.5], "force")
        2.5
    """
    try:
        if len(action) != 1:
            raise ValueError
        number = float(action[0])
    except (TypeError, ValueError, IndexError):
        raise ValueError(f"an action is an array of one number, the {quantity}; this is {action!r}") from None
    if not math.isfinite(number):
        raise ValueError(f"the {quantity} is {number}; it must be a finite number")
    return number


def many(actions: Any, quantity: str, num_envs: int) -> NDArray[np.float64]:
    """The numbers in the actions of many rigs, (num_envs,).

    Args:
        actions: (num_envs, 1).
        quantity: what the numbers are, for the message.
        num_envs: how many rigs there are.

    Raises:
        ValueError: the shape is another, or a number is not finite.

    Example:
        >>> many([[2.5], [-1.0]], "force", 2)
        array([ 2.5, -1. ])
    """
    asked = np.asarray(actions, dtype=np.float64)
    if asked.shape != (num_envs, 1):
        raise ValueError(
            f"actions are an array ({num_envs}, 1), the {quantity} of each; these have shape {asked.shape}"
        )
    asked = asked[:, 0]
    if not np.isfinite(asked).all():
        row = int(np.flatnonzero(~np.isfinite(asked))[0])
        raise ValueError(f"the {quantity} of row {row} is {asked[row]}; it must be a finite number")
    return asked


def bound(limit: float) -> NDArray[np.float32]:
    """The largest float32 that is no more than a limit, (1,): an action at the bound is not beyond it.

    Example:
        >>> float(np.float32(12.6)) > 12.6, float(bound(12.6)[0]) > 12.6
        (True, False)
    """
    near = np.array([limit], np.float32)
    return np.nextafter(near, np.float32(0)) if float(near[0]) > limit else near
