"""A spring that creeps: a belt, a cable, rubber, which pulls back at once and gives way in time (Maxwell's element)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from dipc_gym.engine.swing import Spring, swing
from dipc_gym.mjcf.edit import Document
from dipc_gym.sim2real.effects.shared.base import Effect, Evidence, Parameter, Values, rms
from dipc_gym.sim2real.effects.shared.coupling import couple, node
from dipc_gym.sim2real.effects.shared.sought import Sought, apart

Array = NDArray[np.float64]

TIMES = np.geomspace(0.03, 5.0, 24)  # s, tried by regression
FAST = (0.03, 0.1, 0.3)  # s, tried whatever forces say, for a refitted mass and damping do nearly what such springs do
USUAL = 0.3  # of the unexplained force: what a spring pulls with then
APART = np.exp(0.5)  # ratio of the relaxation times of two first guesses, at least
SHARPEST = 2e-3  # s: what the node between spring and damper settles in: it needs some inertia, for steps of up to 5 ms


class CreepingSpring(Effect):
    """A spring and a damper in series, from the joint to where its body is carried.

    MuJoCo has springs and dampers side by side only. Between the two stands a node, a joint of its own that nobody
    senses, with just so much armature that steps can follow it. What it does at a window's start follows from the
    motion before (`simulation.memory`). Faster than a window it damps, slower it is a spring, and both have plainer
    names.
    """

    id = "load.creeping"
    place = "joint"
    one_of = "creeping spring"
    parameters = (
        Parameter("stiffness", "N/m", 1e-9, log=True),
        Parameter("relaxation_time", "s", 10 * SHARPEST, 60.0, log=True),
    )
    rivals = ("load.spring", "friction.viscous", "friction.hysteresis", "load.swinging", "timing.sensor_lag")

    def guesses(self, evidence: Evidence) -> Sequence[Values]:
        """The two relaxation times at which a spring would pull most like the unexplained force, and fast ones."""
        sought = Sought(evidence)
        times = TIMES.tolist()
        pulls = [sought.explained(_stretch(time, evidence)) for time in times]
        best = apart([one.left_by_pulling for one in pulls], times, count=2, ratio=APART)
        fast = [(usual(evidence, _stretch(time, evidence)), time) for time in FAST]
        told = [(pulls[k].weight, times[k]) for k in best]
        return [{"stiffness": stiffness, "relaxation_time": time} for stiffness, time in told + fast]

    def edit(self, document: Document, at: str, values: Values) -> None:
        """A node beside the joint, a spring between the two, and a damper under the node."""
        damping = values["stiffness"] * values["relaxation_time"]
        name = node(document, f"{at}_creep", at, armature=damping * SHARPEST, damping=damping)
        couple(document, name, name, at, values["stiffness"] * _softer(values["relaxation_time"]), 0.0)

    def sentence(self, at: str, values: Values, unit: Mapping[str, str]) -> str:
        """In words."""
        return (
            f"A spring of {values['stiffness']:.3g} {unit['stiffness']} at {at} creeps: it gives way with a time "
            f"constant of {values['relaxation_time']:.3g} s."
        )


def _softer(time: float) -> float:
    """How many times as stiff the spring beside a node of some inertia is that pulls as one without does.

    Maxwell's element pulls with c s - c^2 / k s^2 + ... times the stretch, one with a node of inertia A with c s + (A -
    c^2 / k') s^2: the same up to the third power of s where 1 / k' is 1 / k + A / c^2.
    """
    return 1.0 / (1.0 + SHARPEST / time)


def usual(evidence: Evidence, stretch: Array) -> float:
    """Stiffness with which a spring that is stretched so far, (n,), pulls with a good part of the unexplained force."""
    return USUAL * evidence.force_scale / max(rms(stretch), 1e-12)


def _stretch(time: float, evidence: Evidence) -> Array:
    """How far a spring of 1 N/m is stretched, (n,): what it pulls with."""
    out = np.zeros(len(evidence.time))
    for run in evidence.runs:
        if len(run) >= 3:
            q, v, t = evidence.position[run], evidence.velocity[run], evidence.time[run]
            spring = Spring(0.0, _softer(time) / (time * SHARPEST))
            out[run] = _softer(time) * swing([spring], 0.0, q, v, t, ground=1 / SHARPEST)[0]
    return out
