"""Windows: short stretches of recordings, each predicted from an initial state of its own."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from dipc_gym.recording import Recording
from dipc_gym.sim2real.simulation.motion import Motion, initial_states

Array = NDArray[np.float64]
JUST = 1e-9  # s: less than stamps are told apart by


@dataclass(frozen=True)
class Windows:
    """Short stretches of recordings, each predicted from an initial state of its own.

    Attributes:
        recordings: where they were cut from.
        source: index into `recordings`, (n,).
        start: time stamp at which each begins, s, (n,).
        times: sample times after the start, s, (n, m).
        observed: readings, (n, m, ns); zero where `valid` is False.
        valid: which samples exist, (n, m); windows of irregular recordings differ in count.
        noise: standard deviation of each sensor's noise, (ns,).
        motions: of the base joints in each recording; needed where what a window begins with depends on the motion
            before, as the heat of a motor does.
        late: delay of the latest sensor of the model that told the motions, s: so long before its first sample a
            window begins, in these motions as in simulations.
        lags: time constants of the sensors that lag in that model, s, by their names.
    """

    recordings: tuple[Recording, ...]
    source: NDArray[np.intp]
    start: Array
    times: Array
    observed: Array
    valid: NDArray[np.bool_]
    noise: Array
    motions: tuple[Motion, ...] = ()
    late: float = 0.0
    lags: Mapping[str, float] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.start)

    def pick(self, which: NDArray[np.intp] | NDArray[np.bool_]) -> Windows:
        """Some of the windows."""
        return replace(
            self,
            source=self.source[which],
            start=self.start[which],
            times=self.times[which],
            observed=self.observed[which],
            valid=self.valid[which],
        )

    def join(self, other: Windows) -> Windows:
        """These windows and others of the same recordings, maybe cut apart from these: where samples come irregularly,
        those may hold more of them, or fewer.
        """
        samples = max(self.times.shape[1], other.times.shape[1])
        one, two = self._with_room(samples), other._with_room(samples)
        return replace(
            self,
            source=np.append(one.source, two.source),
            start=np.append(one.start, two.start),
            times=np.append(one.times, two.times, 0),
            observed=np.append(one.observed, two.observed, 0),
            valid=np.append(one.valid, two.valid, 0),
        )

    def _with_room(self, samples: int) -> Windows:
        """The same with room for so many samples in each; those that do not exist come at the last time."""
        more = samples - self.times.shape[1]
        if not more:
            return self
        last = self.times[:, -1:] if self.times.size else np.zeros((len(self), 1))
        return replace(
            self,
            times=np.append(self.times, np.repeat(last, more, axis=1), 1),
            observed=np.pad(self.observed, ((0, 0), (0, more), (0, 0))),
            valid=np.pad(self.valid, ((0, 0), (0, more))),
        )

    def begun(self, before: float = 0.0, behind: Sequence[float] = ()) -> Array:
        """Positions and velocities of the base joints, (n, 2 nb), where windows begin.

        Args:
            before: or so many seconds before.
            behind: by how much the motion of each joint is late, s, (nb,); none of them if empty.
        """
        time = self.start - self.late - before
        out = initial_states(self.motions, self.source, time)
        for joint, late in enumerate(behind):
            if late:
                columns = [joint, len(behind) + joint]
                out[:, columns] = initial_states(self.motions, self.source, time + late)[:, columns]
        return out

    def after_the_first(self, at: float) -> NDArray[np.bool_]:
        """Whether `at` seconds after each window's start its recording has begun, or gone on after a gap, (n,): before,
        nothing is known.
        """
        return np.asarray(self.start + at > self.went_on + JUST)

    @property
    def began(self) -> Array:
        """When the recording of each window began, s, (n,)."""
        return np.array([recording.time[0] for recording in self.recordings])[self.source]

    @property
    def went_on(self) -> Array:
        """When the recording of each window began, or went on after the last gap before it, s, (n,)."""
        out = np.empty(len(self))
        for i, recording in enumerate(self.recordings):
            mine, since = self.source == i, recording.goes_on
            out[mine] = since[np.maximum(np.searchsorted(since, self.start[mine] + JUST) - 1, 0)]
        return out

    def as_read(self, sensor: int, remembered: Array) -> Array:
        """What a lagging sensor remembers where windows begin, (..., n): what it reads there, smoothed, but for the
        noise, for a smooth curve misses where a fast rig turns.

        The motion that leads there was told by that sensor, and is late itself: what follows from it is late twice,
        which passes for a shorter lag in every window.
        """
        told = np.full(len(self), np.nan)
        for i, motion in enumerate(self.motions):
            if motion.read is not None:
                mine = self.source == i
                told[mine] = np.interp(self.start[mine], motion.time, motion.read[:, sensor])
        read, noise = self.observed[:, 0, sensor], self.noise[sensor]
        return np.where(np.isfinite(told), np.clip(told, read - noise, read + noise), remembered)

    @property
    def period(self) -> float:
        """Shortest median sample period among the recordings, s."""
        return min(recording.period for recording in self.recordings)


def cut(
    recordings: Sequence[Recording], noise: Array, length: float, span: tuple[float, float], after: float = 0.0
) -> Windows:
    """Cut recordings into windows that lie end to end.

    Args:
        recordings: with the same sensors.
        noise: standard deviation of each sensor's noise, (ns,).
        length: s.
        span: the part of each recording to use, as fractions of its duration.
        after: time that passes from a gap to the next window, s: what a model remembers of it.

    Returns:
        The windows in order of recording and time. An incomplete one at the end is dropped, and none reaches across a
        gap, where samples are missing.
    """
    parts: list[tuple[int, int, int]] = []
    for i, recording in enumerate(recordings):
        t = recording.time
        last = t[0] + span[1] * (t[-1] - t[0]) + 1e-9
        # A window holds the samples before its end, the first sample of the next one excluded.
        first = int(np.searchsorted(t, t[0] + span[0] * (t[-1] - t[0]) - 1e-9))
        while first < len(t) and t[first] + length <= last + recording.period:
            stop = int(np.searchsorted(t, t[first] + length - 1e-3 * recording.period))
            on = recording.goes_on[np.searchsorted(recording.goes_on, t[stop - 1], side="right") - 1]
            if on > t[0] and on + after > t[first]:  # what was commanded in the gap is not known
                first = int(np.searchsorted(t, on + after))
                continue
            if stop - first >= 4:
                parts.append((i, first, stop))
            first = max(stop, first + 1)
    count = max((stop - first for _, first, stop in parts), default=0)
    shape = (len(parts), count)
    times, valid = np.zeros(shape), np.zeros(shape, dtype=bool)
    observed = np.zeros((*shape, len(noise)))
    for k, (i, first, stop) in enumerate(parts):
        n = stop - first
        times[k, :n] = recordings[i].time[first:stop] - recordings[i].time[first]
        times[k, n:] = times[k, n - 1]
        observed[k, :n] = recordings[i].sensors[first:stop]
        valid[k, :n] = True
    source = np.array([i for i, _, _ in parts], dtype=np.intp)
    start = np.array([recordings[i].time[first] for i, first, _ in parts])
    return Windows(tuple(recordings), source, start, times, observed, valid, noise)
