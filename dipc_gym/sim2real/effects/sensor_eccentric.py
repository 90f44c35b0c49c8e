"""An encoder whose disc is not centred on its axis."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import mujoco
import numpy as np

from dipc_gym import mjcf
from dipc_gym.mjcf.edit import Document
from dipc_gym.sim2real.effects.shared.base import Effect, Evidence, Parameter, Values, sensed_position
from dipc_gym.sim2real.effects.shared.settings import EFFECTS
from dipc_gym.sim2real.effects.shared.waves import eccentric

FEWEST = 0.5  # waves over the range of motion: of less, a bend of the scale is all that shows
TURN = 2 * np.pi  # rad, after which an encoder on a hinge's own axis is where it was


class Eccentric(Effect):
    """A position sensor that runs ahead and behind once in every turn: a disc or pulley off its axis, a bent shaft."""

    id = "sensor.eccentric"
    place = "sensor"
    one_of = "scale"
    linear = ("sine", "cosine")
    parameters = (
        Parameter("sine", "reading"),
        Parameter("cosine", "reading"),
        Parameter("wavelength", "reading", 1e-9, log=True, fine=EFFECTS.fine),
    )
    rivals = ("friction.position", "load.position", "motor.cogging")
    needs_loader = True
    moves_readings = True

    def fits(self, model: mujoco.MjModel, at: str) -> bool:
        """Where a sensor reads the position of a joint."""
        return sensed_position(model, at)

    def guesses(self, evidence: Evidence) -> Sequence[Values]:
        """A wave of one turn at a hinge, and those whose acceleration the force asks for."""
        joint = int(evidence.model.sensor(evidence.at).objid[0])
        return eccentric(evidence, FEWEST, [TURN] if mjcf.is_hinge(evidence.model, joint) else [])

    def edit(self, document: Document, at: str, values: Values) -> None:
        """An entry for the loader."""
        document.custom(self.id, at, [values[p.name] for p in self.parameters])

    def sentence(self, at: str, values: Values, unit: Mapping[str, str]) -> str:
        """In words."""
        size = float(np.hypot(values["sine"], values["cosine"]))
        return (
            f"Sensor {at} runs ahead and behind by up to {size:.3g} {unit['sine']} every {values['wavelength']:.3g} "
            f"{unit['wavelength']}, as an encoder off its axis does."
        )
