"""Which windows stay where the laws of a fit have data: elsewhere a law does not claim to predict."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dipc_gym import mjcf
from dipc_gym.sim2real.estimation.fit import Fit
from dipc_gym.sim2real.estimation.problem import Problem
from dipc_gym.sim2real.selection.settings import SEARCH
from dipc_gym.sim2real.simulation.memory import swung
from dipc_gym.sim2real.simulation.windows import Windows

Array = NDArray[np.float64]


def supported(fitted: Fit, seen: Problem, asked: Problem) -> NDArray[np.bool_]:
    """Windows in which no law of a fit gets an input far from all those that it was fitted with, (n,).

    Args:
        fitted: to the windows seen.
        seen: windows.
        asked: windows, of the same recordings or of others.
    """
    there = np.ones(len(asked.windows), dtype=bool)
    for name in inputs_of(fitted):
        there &= ~_far(name, fitted, seen, asked)
    return there


def inputs_of(fitted: Fit) -> list[str]:
    """What the laws of a fit depend on."""
    return sorted({name for term in fitted.structure.terms for name in term.effect.inputs(term.at)})


def span(name: str, fitted: Fit, windows: Windows) -> tuple[float, float]:
    """The smallest and largest that an input gets in some windows."""
    values = input_of(name, fitted, windows)[windows.valid]
    return float(values.min()), float(values.max())


def _far(name: str, fitted: Fit, seen: Problem, asked: Problem) -> NDArray[np.bool_]:
    """Windows in which one input is far from all that were seen, (n,)."""
    known = np.sort(input_of(name, fitted, seen.windows)[seen.windows.valid])
    values = input_of(name, fitted, asked.windows)
    at = np.clip(np.searchsorted(known, values), 1, len(known) - 1)
    apart = np.minimum(np.abs(values - known[at - 1]), np.abs(values - known[at]))
    far = apart > SEARCH.beyond * (known[-1] - known[0])
    return np.asarray((far & asked.windows.valid).any(axis=1))


def input_of(name: str, fitted: Fit, windows: Windows) -> Array:
    """What a law depends on, at the samples of windows, (n, m).

    As `Evidence.inputs` calls it, a speed, how wide what hangs on a joint has swung of late, or `time`.
    """
    if name == "time":
        return windows.start[:, None] + windows.times
    kind, _, at = name.partition(" ")
    out = np.zeros(windows.times.shape)
    for i, (recording, motion) in enumerate(zip(windows.recordings, windows.motions, strict=True)):
        mine = windows.source == i
        time = windows.start[mine, None] + windows.times[mine]
        if kind == "command":
            k = np.clip(np.searchsorted(recording.time, time, side="right") - 1, 0, len(recording) - 1)
            which = recording.actuator_names.index(at)
            taken = (end[which] for end in mjcf.command_ranges(fitted.structure.model))
            out[mine] = np.clip(recording.commands[k, which], *taken)
            continue
        joint = fitted.structure.base.index(at)
        if kind == "swing":
            out[mine] = np.interp(time, motion.time, swung(fitted.structure.physics(fitted.z), joint, at, motion))
            continue
        values = (motion.position if kind == "position" else motion.velocity)[:, joint]
        out[mine] = np.interp(time, motion.time, np.abs(values) if kind == "speed" else values)
    return out
