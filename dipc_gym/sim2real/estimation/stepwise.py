"""Parameters that change readings by steps: found by search, where slopes have nothing to follow.

A joint at rest breaks away when what drives it exceeds what holds it. Where a command goes by steps, so does the moment
of that, and what a window reads stays the same while the friction at rest changes a little, and then jumps.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dipc_gym.sim2real.estimation.settings import ESTIMATION
from dipc_gym.sim2real.estimation.shooting import Shooting, mean_loss, typical

Array = NDArray[np.float64]


def searched(shooting: Shooting, z: Array, initial: Array, residual: Array, S: Array) -> Array:
    """Mapped parameters (p,) that predict better, with those moved that change readings by steps.

    Each is moved either way, alone and against its neighbour, and what helps is kept, together if that helps more.
    Windows that do not change are not simulated.

    Args:
        shooting: structure and windows.
        z: mapped parameters, (p,).
        initial: states, (n, 2 nb).
        residual: there, (n, m, ns).
        S: sensitivity to the initial states, (n, M, 2 nb).
    """
    moves = _moves(shooting, z)
    mse = shooting.mse(shooting.left(initial, residual, S))
    far = [shooting.structure.clip(z + sign * np.abs(moves).max(axis=0)) for sign in (-1.0, 1.0)]
    changed = shooting.residuals(far, initial[None]) != residual
    some = np.flatnonzero(changed.any(axis=(0, 2, 3)))
    if not len(some):
        return z
    here = Shooting(shooting.problem.pick(some), shooting.structure)
    begin, slopes, scale, known = initial[some], S[some], typical(mse), mse.copy()

    def penalised(mse: Array, one: Array) -> float:
        return mean_loss(mse, scale) + shooting.structure.prior.penalty(one, shooting.problem.counts)

    def losses(tries: Sequence[Array]) -> Array:
        out = []
        for one, left in zip(tries, here.residuals(tries, begin[None]), strict=True):
            known[some] = here.mse(here.left(begin, left, slopes))
            out.append(penalised(known, one))
        return np.array(out)

    now = penalised(mse, z)
    for share in ESTIMATION.searched:
        left = moves
        while len(left):
            tries = [shooting.structure.clip(z + share * move) for move in left]
            gains = now - losses(tries)
            best, helps = int(np.argmax(gains)), gains > 0
            together = shooting.structure.clip(z + share * left[helps].sum(axis=0))
            (both,) = now - losses([together])
            if max(both, gains[best]) < ESTIMATION.tolerance * now:
                break
            z, now = (together, now - both) if both > gains[best] else (tries[best], now - gains[best])
            left = left[helps]  # the others are asked again in shorter moves
    return z


def _moves(shooting: Shooting, z: Array) -> Array:
    """Sizeable changes of the mapped parameters, (k, p)."""
    sizes, unit, found = shooting.structure.sizes(z), np.eye(len(z)), list[Array]()
    for own in shooting.structure.stepwise:
        alone = [sizes[i] * unit[i] for i in own]
        against = [one - other for one, other in itertools.pairwise(alone)]
        found += [sign * one for one in (*alone, *against) for sign in (1.0, -1.0)]
    return np.array(found)
