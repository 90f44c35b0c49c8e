"""Commands that act late: which of them act in a period, and the state at the moment when the next one will."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from dipc_gym.controllers import lqr
from dipc_gym.estimators.base import LARGEST, Array

if TYPE_CHECKING:
    from dipc_gym.dataflow import Program, Value


@dataclass(frozen=True, eq=False)
class Late:
    """A delay of so many whole periods and a share of one, on a linear model.

    A filter appends the past commands to its memory, newest first. In a period acts a mixture of two of them, and what
    the controller is told is the state at the moment when its next command begins to act: what is under way already is
    known. Without a delay there are no columns, and nothing changes.

    Attributes:
        whole: periods.
        share: of a further one.
        ahead: (k, k + columns) from state and past commands to the state when the next command acts.

    Source:
        Astrom, Wittenmark, "Computer-Controlled Systems" (3rd ed., 1997), section 2.3, for the sampled model; the
        prediction is Smith's, ISA Journal 6 (1959) 28-33, with the filter's state.

    Example:
        >>> late = Late.of(np.zeros((1, 1)), np.ones((1, 1)), period=0.01, delay=0.025)  # a velocity that is commanded
        >>> late.columns, round(late.share, 9)
        (3, 0.5)
        >>> late.predicted(np.array([[0.0, 1.0, 1.0, 0.0]]), 1).round(9).tolist()
        [[0.02]]
    """

    whole: int
    share: float
    ahead: Array

    @classmethod
    def of(cls, A: Array, B: Array, *, period: float, delay: float) -> Late:
        """The delay of a linear model dx/dt = A x + B u.

        Args:
            A: (k, k).
            B: (k, 1).
            period: s, for which commands are held.
            delay: from a command to the motor, s.
        """
        size = len(A)
        if delay == 0:
            return cls(0, 0.0, np.eye(size))
        whole = int(delay / period + 1e-9)
        share = max(delay / period - whole, 0.0)
        ahead = np.eye(size, size + whole + 1)
        # Oldest first: for a share of a period the one that acts already, then each of the others for a whole one.
        for column in range(whole, -1, -1):
            length = period * (share if column == whole else 1.0)
            if length > 0:
                F, G = lqr.sampled(A, B, length)
                ahead = F @ ahead
                ahead[:, size + column] += G[:, 0]
        return cls(whole, share, ahead)

    @property
    def columns(self) -> int:
        """Past commands that are remembered."""
        return self.ahead.shape[1] - self.ahead.shape[0]

    def arrived(self, past: Array, now: Array) -> tuple[Array, Array]:
        """Mean command (n,) in the period for which `now` (n,) was commanded, and the past commands after it."""
        if not self.columns:
            return now, past
        queue = np.concatenate([now[:, None], past], axis=1)
        acting = (1 - self.share) * queue[:, self.whole] + self.share * queue[:, self.whole + 1]
        return acting, queue[:, :-1]

    def predicted(self, state: Array, size: int) -> Array:
        """State (n, size) when the next command acts, from memory (n, size + columns); a copy."""
        if not self.columns:
            return state[:, :size].copy()
        return (self.ahead @ state[:, : size + self.columns, None])[:, :, 0]

    def express(self, program: Program, matrix: Array, readings: Value, command: Value) -> tuple[Value, Value]:
        """Write a filter of constant gain: its state (k,) after the readings, and that when the next command acts.

        Args:
            program: what is written.
            matrix: (k, k + 4) as `kalman.filter_matrix` gives it.
            readings: (3,).
            command: what was commanded in the last period; 0 in the first.
        """
        size = len(matrix)
        begun = program.join(readings, program.constant(np.zeros(size - 3)))
        kept, acting, past = program.state("filtered", np.zeros(size)), command, None
        if self.columns:
            past = program.state("commands", np.zeros(self.columns))
            queue = program.join(command, past)
            acting = queue.part(self.whole) * (1 - self.share) + queue.part(self.whole + 1) * self.share
            program.update(past, queue.part(0, self.columns))
            past = queue.part(0, self.columns)
        after = program.join(kept, acting, readings).affine(matrix)
        lost = program.constant(1.0) - after.part(0, 6).within(LARGEST).least()
        after = program.first().maximum(lost).choose(begun, after)
        program.update(kept, after)
        return after, after if past is None else program.join(after, past).affine(self.ahead)
