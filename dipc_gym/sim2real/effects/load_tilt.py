"""The rig is not level."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import mujoco
import numpy as np

from dipc_gym.mjcf.edit import Document
from dipc_gym.sim2real.effects.base import Effect, Evidence, Parameter, Values


class Tilt(Effect):
    """Gravity does not point where the model says: the table is tilted about the x and y axes."""

    id = "load.tilt"
    place = "world"
    linear = ("about_x", "about_y")
    parameters = (Parameter("about_x", "rad", -0.5, 0.5), Parameter("about_y", "rad", -0.5, 0.5))
    rivals = ("load.constant", "sensor.bias")

    def fits(self, model: mujoco.MjModel, at: str) -> bool:
        """Where there is gravity."""
        return bool(np.any(model.opt.gravity != 0))

    def guesses(self, evidence: Evidence) -> Sequence[Values]:
        """Half a degree about either axis."""
        return [{"about_x": 0.01, "about_y": 0.0}, {"about_x": 0.0, "about_y": 0.01}]

    def edit(self, document: Document, at: str, values: Values) -> None:
        """Gravity turned about x, then about y."""
        x, y, z = (float(word) for word in document.get_option("gravity").split())
        a, b = values["about_x"], values["about_y"]
        y, z = y * np.cos(a) - z * np.sin(a), y * np.sin(a) + z * np.cos(a)
        x, z = x * np.cos(b) + z * np.sin(b), -x * np.sin(b) + z * np.cos(b)
        document.option(gravity=f"{float(x)!r} {float(y)!r} {float(z)!r}")

    def sentence(self, at: str, values: Values, unit: Mapping[str, str]) -> str:
        """In words."""
        degrees = np.degrees(np.hypot(values["about_x"], values["about_y"]))
        return f"The rig is tilted by {degrees:.2g} degrees."
