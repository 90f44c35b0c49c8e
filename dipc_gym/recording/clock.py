"""A recording's clock: counted from its first sample, and even where its rows were read evenly and stamped unevenly.

What writes a log mostly stamps a row when it comes to it, some tenths of a millisecond after it was read: an axis that
moves at 1 m/s is then off by as many tenths of a millimetre, and no physics accounts for it. Whether stamps or readings
are even, the readings tell: only under the right ones are they smooth.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from dipc_gym.recording import parts
from dipc_gym.recording.checks import IRREGULAR, noise
from dipc_gym.recording.settings import CLOCK

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from dipc_gym.recording.record import Recording


def clocked(recordings: Sequence[Recording], until: float = 1.0) -> list[Recording]:
    """Recordings on clocks that begin at 0, and are even where that is what the readings say; notes say so.

    Args:
        recordings: to be read or fitted.
        until: share of each that tells; what comes later goes on by that.

    Example:
        >>> from dipc_gym.recording import Recording
        >>> rng, t = np.random.default_rng(0), 0.004 * np.arange(1000)
        >>> read = np.sin(6 * t)[:, None]
        >>> late = Recording("late", t + 4e-4 * rng.uniform(size=1000), np.zeros((1000, 0)), read, [], ["angle"])
        >>> (mended,) = clocked([late])
        >>> bool(np.abs(np.diff(mended.time) - 0.004).max() < 1e-6)
        True
    """
    return [_even(recording, until) for recording in _from_zero(recordings)]


def _from_zero(recordings: Sequence[Recording]) -> list[Recording]:
    """Recordings with their time counted from their first samples: what shakes or pushes the rig has no other clock."""
    return [
        r
        if r.time[0] == 0
        else replace(
            r,
            time=r.time - r.time[0],
            notes=(*r.notes, f"its clock begins at {r.time[0]:.10g} s; times are counted from there"),
        )
        for r in recordings
    ]


def _even(recording: Recording, until: float) -> Recording:
    tells = parts.until(recording, until)
    count = len(tells)
    if count < CLOCK.fewest:
        return recording
    rows, begin, period = _numbered(recording.time, count)
    jitter = float(np.std((recording.time - begin - period * rows)[:count]))
    if jitter < CLOCK.least * period or np.any(np.diff(rows) < 1):
        return recording
    given, even = noise(tells), noise(replace(tells, time=period * rows[:count]))
    smoother = np.divide(given, even, out=np.ones_like(given), where=np.isfinite(given))
    if smoother.max(initial=1.0) < CLOCK.smoother or smoother.min(initial=1.0) < CLOCK.rougher:
        return recording
    best = recording.sensor_names[int(np.argmax(smoother))]
    note = (
        f"stamps are {jitter:.2g} s off even ones, and under even ones sensor {best!r} is {smoother.max():.2g} times "
        f"as smooth: rows were read evenly and stamped unevenly, and are taken to be {period:.6g} s apart; stamp a row "
        "when it is read"
    )
    notes = [one for one in recording.notes if not one.startswith(IRREGULAR)]
    return replace(recording, time=period * (rows - rows[0]), notes=(*notes, note))


def _numbered(time: NDArray[np.float64], count: int) -> tuple[NDArray[np.float64], float, float]:
    """Number of each row, counting those that are missing, (n,); and the even clock that the first `count` stamps lie
    about: where it begins, and its period, s.
    """
    usual = float(np.median(np.diff(time[:count])))
    rows = np.append(0.0, np.cumsum(np.maximum(np.rint(np.diff(time) / usual), 1.0)))
    for _ in range(2):  # a median is too rough a period for thousands of rows; the line tells it
        period, begin = np.polyfit(rows[:count], time[:count], 1)
        rows = np.rint((time - begin) / period)
    return rows, float(begin), float(period)
