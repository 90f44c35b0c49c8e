"""The rig is not level."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence

import mujoco
import numpy as np

from dipc_gym.mjcf.edit import Document
from dipc_gym.sim2real.effects.shared.base import Effect, Evidence, Parameter, Values

TURNED = 1e-4  # rad, by which gravity is turned to see what that does
FELT = 1e-6  # of what turning does to any joint's force, or would to all that joints bear, that counts


class Tilt(Effect):
    """Gravity does not point where the model says: the table is tilted about two axes of the model across gravity.

    Of a planar rig one of the two turns gravity out of the plane, which its joints feel in second order alone: such an
    axis is left out, for no data tell its angle.

    Args:
        about: names of the axes.
    """

    id = "load.tilt"
    place = "world"
    rivals = ("load.constant", "sensor.bias", "load.payload")

    def __init__(self, about: str = "xy") -> None:
        self.about = about
        self.parameters = tuple(Parameter(f"about_{axis}", "rad", -0.5, 0.5) for axis in about)
        self.linear = tuple(p.name for p in self.parameters)

    def fits(self, model: mujoco.MjModel, at: str) -> bool:
        """Where a joint feels that gravity turns."""
        return bool(_felt(model))

    def proposals(self, evidence: Evidence) -> Sequence[tuple[Effect, Values]]:
        """About the axes that joints feel."""
        tilt = Tilt(_felt(evidence.model))
        return [(tilt, values) for values in tilt.guesses(evidence)]

    def guesses(self, evidence: Evidence) -> Sequence[Values]:
        """Half a degree about either axis."""
        names = [p.name for p in self.parameters]
        return [{name: 0.01 * (name == one) for name in names} for one in names]

    def edit(self, document: Document, at: str, values: Values) -> None:
        """Gravity turned about one axis, then about the other."""
        gravity = np.array([float(word) for word in document.get_option("gravity").split()])
        for axis in self.about:
            gravity = _turned(gravity, axis, values[f"about_{axis}"])
        document.option(gravity=" ".join(repr(float(one)) for one in gravity))

    def sentence(self, at: str, values: Values, unit: Mapping[str, str]) -> str:
        """In words."""
        angles = np.degrees([values[p.name] for p in self.parameters])
        alone = len(angles) == 1  # else which way it leans is said by the numbers
        degrees, about = (angles[0], f" about {self.about}") if alone else (np.linalg.norm(angles), "")
        return f"The rig is tilted by {degrees:.2g} degrees{about}."


def _turned(gravity: np.ndarray, axis: str, angle: float) -> np.ndarray:
    """Gravity turned about an axis of the model by an angle, rad."""
    k = "xyz".index(axis)
    i, j = (k + 1) % 3, (k + 2) % 3
    out, c, s = gravity.copy(), np.cos(angle), np.sin(angle)
    out[i], out[j] = c * gravity[i] - s * gravity[j], s * gravity[i] + c * gravity[j]
    return out


def _felt(model: mujoco.MjModel) -> str:
    """Axes across gravity about which joints feel it turn, in first order of the angle."""
    gravity = model.opt.gravity.copy()
    if not gravity.any():
        return ""
    turning, data, rng = copy.copy(model), mujoco.MjData(model), np.random.default_rng(0)
    across = [axis for k, axis in enumerate("xyz") if k != int(np.argmax(np.abs(gravity)))]
    changes, borne = dict.fromkeys(across, 0.0), 0.0
    for _ in range(4):
        data.qpos[:] = model.qpos0 + rng.normal(size=model.nq)
        for axis in across:
            forces = []
            for angle in (TURNED, -TURNED):
                turning.opt.gravity[:] = _turned(gravity, axis, angle)
                mujoco.mj_forward(turning, data)
                forces.append(data.qfrc_bias.copy())
            changes[axis] = max(changes[axis], float(np.abs(forces[0] - forces[1]).max(initial=0.0)))
            borne = max(borne, float(np.abs(forces[0]).max(initial=0.0)))
    least = FELT * max(*changes.values(), 2 * TURNED * borne)
    return "".join(axis for axis in across if changes[axis] > least)
