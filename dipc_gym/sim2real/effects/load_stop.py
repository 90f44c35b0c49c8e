"""An end of the way that a joint runs into."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from dipc_gym.mjcf.edit import Document
from dipc_gym.sim2real.effects.shared.base import Effect, Evidence, Form, Parameter, Values
from dipc_gym.sim2real.effects.shared.coupling import bumper, limits_act
from dipc_gym.sim2real.effects.shared.settings import EFFECTS

Array = NDArray[np.float64]

FAR = 1e6  # m or rad, of an end that nothing meets
NARROWEST = 1e-9  # m, rad or degrees between two ends: MuJoCo wants some, and a fit may ask for none
SOFTEST, HARDEST = 20.0, 4000.0  # 1/s: a bumper of foam, and steel that hardly shows from one sample to the next
RATES, RATIOS = (100.0, 500.0), (0.3, 2.0)  # 1/s, and damping ratios, that are tried
LEAST, MOST = 0.01, 10.0  # damping ratio: a blow comes back whole, and a joint leaves as slowly as through honey
STEP = 1e-3  # of the way that a joint went: a sizeable change of where it ends
PLACES = 40  # that are tried at either end
DEEPEST = 0.2  # of the way that a joint went, that a stop may be entered by
DENSER = 3.0  # times as much as elsewhere: of the squares of the force for its share of samples, where a stop pushes
PUSHES = 0.2  # share of the force's squares that it takes at least
ONE_WAY = 0.65  # share of these that is a push out of it: an acceleration that was smoothed swings to both sides


class Stop(Effect):
    """A stop at one end of a joint's way, or at both: a bumper, a hard end, a cable that is taut.

    Args:
        ends: `low`, `high` or both, of those that there are.
        step: sizeable change of where they are, m or rad.
    """

    id = "load.stop"
    place = "joint"
    rivals = ("load.spring", "load.position", "disturbance.pulse")
    valleys = ("contact_rate", "contact_damping")
    finest = EFFECTS.fast
    element = "the joint's range, with a limit that is a spring and a damper"

    def __init__(self, ends: Sequence[str] = ("low", "high"), step: float = 1e-3) -> None:
        self.ends = tuple(ends)
        self.parameters = (
            *(Parameter(end, "m", step=step) for end in self.ends),
            Parameter("contact_rate", "1/s", SOFTEST, HARDEST, log=True),
            Parameter("contact_damping", "1", LEAST, MOST, log=True),
        )

    def fits(self, model: mujoco.MjModel, at: str) -> bool:
        """In a model whose limits are not switched off."""
        return limits_act(model)

    def forms(self) -> Sequence[Form]:
        """A limit whose solver keeps it stable at long steps."""
        return (Range(self.parameters, self.ends),)

    def proposals(self, evidence: Evidence) -> Sequence[tuple[Effect, Values]]:
        """Stops where the force that nothing explains pushes back, and only there."""
        at = {}
        for end, sign in (("low", -1.0), ("high", 1.0)):
            begins = _begins(sign * evidence.position, sign * evidence.force)
            if begins is not None:
                at[end] = sign * begins
        stop = Stop(tuple(at), STEP * float(np.ptp(evidence.position)))
        tried = itertools.product(RATES, RATIOS) if at else ()
        return [(stop, {**at, "contact_rate": rate, "contact_damping": ratio}) for rate, ratio in tried]

    def guesses(self, evidence: Evidence) -> Sequence[Values]:
        """Those of its own ends that the evidence shows."""
        return [values for shaped, values in self.proposals(evidence) if shaped.parameters == self.parameters]

    def edit(self, document: Document, at: str, values: Values) -> None:
        """The joint's range, with a limit that is a spring and a damper; where recordings are a simulation's, with one
        of MuJoCo's own, which is neither.
        """
        if document.simulated:
            Range(self.parameters, self.ends).edit(document, at, values)
            return
        _between(document, at, values)
        document.set(document.joint(at), **bumper(values["contact_rate"], values["contact_damping"]))

    def sentence(self, at: str, values: Values, unit: Mapping[str, str]) -> str:
        """In words."""
        places = " and ".join(f"{values[end]:.4g} {unit[end]}" for end in self.ends)
        return f"{at} runs into {'stops' if len(self.ends) > 1 else 'a stop'} at {places}."


class Range(Form):
    """Stops as MuJoCo's own limits of a joint."""

    id = "load.stop:range"
    place = "joint"
    element = "the joint's range, with a limit of MuJoCo's own"

    def __init__(self, parameters: Sequence[Parameter], ends: Sequence[str]) -> None:
        self.parameters, self.ends = tuple(parameters), tuple(ends)

    def edit(self, document: Document, at: str, values: Values) -> None:
        """The joint's range, with a limit of the same rate and damping."""
        rate, damping = values["contact_rate"], values["contact_damping"]
        _between(document, at, values)
        document.set(document.joint(at), solreflimit=(1 / (damping * rate), damping))
        document.plain(document.joint(at), solimplimit="0.9 0.95 0.001 0.5 2")

    def sentence(self, at: str, values: Values, unit: Mapping[str, str]) -> str:
        """In words."""
        return Stop(self.ends).sentence(at, values, unit)


def _between(document: Document, at: str, values: Values) -> None:
    """Limit a joint's range to what lies between its stops, within the one that it has."""
    joint = document.joint(at)
    low, high = document.limits(joint, "") or (-FAR, FAR)
    low = max(low, document.angle(joint, values.get("low", -FAR)))
    high = min(high, document.angle(joint, values.get("high", FAR)))
    document.set(joint, limited="true", range=(low, max(high, low + NARROWEST)))
    document.plain(joint, margin="0")


def _begins(position: Array, force: Array) -> float | None:
    """Where a stop begins at the upper end of a way, from the force (n,) that nothing explains; None without one.

    What pushes back at an end and hardly anywhere else is a stop; a spring pushes all along the way.
    """
    order = np.argsort(-position)
    place, push = position[order], -force[order]
    way = place[0] - place[-1]
    total = float(push @ push)
    inside = int(np.searchsorted(place[0] - place, DEEPEST * way))
    if inside < 2 or total <= 0:
        return None
    best: tuple[float, float] | None = None
    for count in np.unique(np.geomspace(2, inside, PLACES).astype(int)):
        begins, near = place[count], push[:count]
        squares = float(near @ near) / total
        out_of_it = float(np.sum(np.maximum(near, 0.0) ** 2)) / max(float(near @ near), 1e-300)
        if squares < PUSHES or squares < DENSER * count / len(push) or out_of_it < ONE_WAY:
            continue
        depth = place[:count] - begins
        left = total - max(float(depth @ near), 0.0) ** 2 / max(float(depth @ depth), 1e-300)
        if best is None or left < best[0]:
            best = left, float(begins)
    return None if best is None else best[1]
