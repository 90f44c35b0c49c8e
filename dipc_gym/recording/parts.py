"""Parts of recordings, and recordings side by side: none twice."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dipc_gym.recording.record import Recording
from dipc_gym.recording.tables import RecordingError


def check_apart(recordings: Sequence[Recording], held_out: Sequence[Recording]) -> None:
    """Refuse to judge by what is fitted, and to count anything twice.

    Raises:
        RecordingError: a recording is held out that is fitted as well, whatever its name, or a part of it, or one is
            given twice. Of the parts of one recording that do not overlap, some may be held out.
    """
    for one, other in itertools.product(held_out, recordings):
        if overlap(one, other):
            raise RecordingError(
                f"{one.path or one.name}: held out, but the same as {other.path or other.name}, which is fitted; hold "
                "out another recording, or none: then the last quarter of each is"
            )
    for one, other in (*itertools.combinations(recordings, 2), *itertools.combinations(held_out, 2)):
        if overlap(one, other):
            raise RecordingError(
                f"{other.path or other.name}: the same as {one.path or one.name}; give it once, for what is counted "
                "twice looks surer than it is"
            )


def overlap(one: Recording, other: Recording) -> bool:
    """Whether two recordings are the same, whatever they are called, or parts of the same that have samples in common:
    where both have any, both have the same.
    """
    if (one.actuator_names, one.sensor_names) != (other.actuator_names, other.sensor_names):
        return False
    begin, end = max(one.time[0], other.time[0]), min(one.time[-1], other.time[-1])
    mine, theirs = (
        np.column_stack([each.time, each.commands, each.sensors])[(begin <= each.time) & (each.time <= end)]
        for each in (one, other)
    )
    return len(mine) > 0 and np.array_equal(mine, theirs)


def going_on(begun: Recording, whole: Recording) -> Recording:
    """A recording that begins as a part of it does, sample for sample, and goes on as the whole of it."""
    return replace(whole, sensors=np.concatenate([begun.sensors, whole.sensors[len(begun) :]]))


def until(recording: Recording, share: float) -> Recording:
    """A recording up to a share of its duration; it keeps its name, its file and the digest of that."""
    if share >= 1:
        return recording
    count = int(np.searchsorted(recording.time, recording.time[0] + share * recording.duration)) or 1
    return replace(
        recording,
        time=recording.time[:count],
        commands=recording.commands[:count],
        sensors=recording.sensors[:count],
    )
