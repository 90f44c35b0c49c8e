"""Numbers with rates of change, followed along a motion that is known, as code."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from llvmlite import ir

from dipc_gym.engine.code import Code, Numbers
from dipc_gym.engine.values import Value

Track = Sequence[tuple[Value, Value]]


def write_following(
    code: Code,
    state: Numbers,
    count: int,
    track: Track,
    steps: ir.Value,
    rates: Callable[[Sequence[Value], Numbers], Sequence[Value]],
) -> None:
    """Take some numbers from one sample of a motion to the next, by Runge-Kutta's steps of fourth order.

    Args:
        code: that is being written.
        state: the numbers; they are changed.
        count: how many these are.
        track: the motion at either sample, a straight line between them; time first, s.
        steps: into how many equal ones the time is divided.
        rates: of the numbers, 1/s, from the motion at one moment and the numbers then.
    """
    stage, slope, total, share = code.scratch(count), code.scratch(count), code.scratch(count), code.scratch(1)
    begin, end = track[0]
    part, share[0] = 1.0 / Value(code, code.at.sitofp(steps, begin.primal.type)), 0.0
    length = part * (end - begin)
    with code.count(steps):
        for i in range(count):
            total[i], slope[i] = 0.0, 0.0
        for ahead, weight in ((0.0, 1.0), (0.5, 2.0), (0.5, 2.0), (1.0, 1.0)):
            along = share[0] + ahead * part
            for i in range(count):
                stage[i] = state[i] + ahead * length * slope[i]
            for i, rate in enumerate(rates([one + along * (other - one) for one, other in track], stage)):
                slope[i] = rate
                total[i] = total[i] + weight * rate
        for i in range(count):
            state[i] = state[i] + length * total[i] / 6.0
        share[0] = share[0] + part
