"""The amplifier gives less than was asked."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from dipc_gym.mjcf.edit import Document
from dipc_gym.sim2real.effects.shared.base import Effect, Evidence, Parameter, Values, is_dcmotor, limit_the_motor

Array = NDArray[np.float64]

LEAST = 0.1  # of what was asked for, that a drive which saturates still gives


class Saturation(Effect):
    """A limit of the drive below the largest command that was sent."""

    id = "motor.saturation"
    place = "actuator"
    rivals = ("motor.back_emf", "drag.quadratic", "motor.thermal")

    def __init__(self, least: float = 0.0, given: tuple[float, float] | None = None) -> None:
        self.parameters = (Parameter("limit", "command", least),)
        self.given = given  # the range that the actuator has, of its own or of its joint

    def proposals(self, evidence: Evidence) -> Sequence[tuple[Effect, Values]]:
        """With a limit that leaves the drive a tenth of its command: one that does nothing explains nothing."""
        most, model = _most(evidence.command), evidence.model
        i = model.actuator(evidence.at).id
        low, high = model.actuator_ctrlrange[int(model.actuator_ctrladr[i])].tolist()
        given = (low, high) if model.actuator_ctrllimited[int(model.actuator_ctrladr[i])] and low < high else None
        return [(Saturation(LEAST * most, given), values) for values in self.guesses(evidence)]

    def guesses(self, evidence: Evidence) -> Sequence[Values]:
        """Four shares of the largest command."""
        most = _most(evidence.command)
        return [{"limit": share * most} for share in (0.95, 0.8, 0.6, 0.4)] if most > 0 else []

    def edit(self, document: Document, at: str, values: Values) -> None:
        """The actuator's control range, within the one that it has."""
        actuator = document.actuator(at)
        given = self.given or document.limits(actuator, "ctrl")
        document.set(actuator, ctrllimited="true", ctrlrange=_within(given, values["limit"]))
        if float(document.effective(actuator, "inheritrange", "0")):  # a range of its own takes the place of that
            document.set(actuator, inheritrange=0)

    def sentence(self, at: str, values: Values, unit: Mapping[str, str]) -> str:
        """In words."""
        limit = f"{values['limit']:.3g} {unit['limit']}".strip()
        return f"{at} saturates at {limit}, less than was commanded."


class TorqueLimit(Effect):
    """A limit of the drive's torque: a current limit, or a clutch that slips."""

    id = "motor.saturation:torque"
    place = "actuator"
    rivals = ("motor.saturation", "motor.thermal", "drag.quadratic")

    def __init__(self, least: float = 0.0, unit: str = "N m") -> None:
        self.parameters = (Parameter("limit", unit, least),)

    def proposals(self, evidence: Evidence) -> Sequence[tuple[Effect, Values]]:
        """With a limit that leaves the drive a tenth of what it gave."""
        most = _most(_torque(evidence))
        unit = "N m" if is_dcmotor(evidence.model, evidence.at) else "N"
        return [(TorqueLimit(LEAST * most, unit), values) for values in self.guesses(evidence)]

    def fits(self, model: mujoco.MjModel, at: str) -> bool:
        """On a DC motor, and on a servo, whose force depends on where it is; of a plain one, force and command are the
        same thing.
        """
        bias = model.actuator_biastype[model.actuator(at).id]
        return is_dcmotor(model, at) or bool(bias == mujoco.mjtBias.mjBIAS_AFFINE)

    def guesses(self, evidence: Evidence) -> Sequence[Values]:
        """Four shares of the largest torque."""
        most = _most(_torque(evidence))
        return [{"limit": share * most} for share in (0.95, 0.8, 0.6, 0.4)] if most > 0 else []

    def edit(self, document: Document, at: str, values: Values) -> None:
        """The motor's torque limit; a servo's within the one that it has."""
        actuator, limit = document.actuator(at), max(values["limit"], 1e-9)
        if actuator.tag == "dcmotor":
            limit_the_motor(document, actuator, limit)
            return
        document.set(actuator, forcelimited="true", forcerange=_within(document.limits(actuator, "force"), limit))

    def sentence(self, at: str, values: Values, unit: Mapping[str, str]) -> str:
        """In words."""
        return f"{at} gives no more than {values['limit']:.3g} {unit['limit']}, less than its commands ask for."


def _torque(evidence: Evidence) -> Array:
    """What a drive gives without a limit, (n,), before its gear."""
    model, gear = evidence.model, evidence.gear or 1.0
    i = model.actuator(evidence.at).id
    if model.actuator_biastype[i] != mujoco.mjtBias.mjBIAS_AFFINE:
        return evidence.load / gear
    constant, by_position, by_speed = (float(number) for number in model.actuator_biasprm[i, :3])
    moved = gear * (by_position * evidence.position + by_speed * evidence.velocity)
    return np.asarray(float(model.actuator_gainprm[i, 0]) * evidence.command + constant + moved)


def _most(values: Array) -> float:
    """The largest of a drive's commands or forces (n,), but for a thousandth of them; 0 of none."""
    return float(np.quantile(np.abs(values), 0.999)) if len(values) else 0.0


def _within(given: tuple[float, float] | None, limit: float) -> tuple[float, float]:
    """A limit either way, within the range that the actuator has already; MuJoCo refuses an empty one, and a fit may
    pass through one.
    """
    low, high = -limit, limit
    if given is not None and given[0] < given[1]:
        low, high = (float(np.clip(end, *given)) for end in (low, high))
    return low, max(high, low + 1e-9)
