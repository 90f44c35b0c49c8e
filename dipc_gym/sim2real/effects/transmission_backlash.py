"""Play between motor and load."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import mujoco

from dipc_gym.mjcf.edit import Document
from dipc_gym.sim2real.effects.shared.base import Effect, Evidence, Parameter, Values
from dipc_gym.sim2real.effects.shared.coupling import can_split, limit, limits_act, rotor_guesses, split
from dipc_gym.sim2real.effects.shared.settings import EFFECTS


class Backlash(Effect):
    """Play in gears or belt: the motor turns a little before the load follows."""

    id = "transmission.backlash"
    place = "actuator"
    one_of = "rotor"
    parameters = (
        Parameter("gap", "m", 1e-9, log=True),
        Parameter("rotor_inertia", "kg", 1e-12, log=True),
        Parameter("contact_rate", "1/s", 50.0, 4000.0, log=True),
        Parameter("contact_damping", "1", 0.01, 2.0, log=True),
    )
    rivals = ("motor.deadzone", "transmission.compliance", "friction.coulomb", "timing.delay")
    linear = ("gap",)  # the load lags behind in proportion to the way that the rotor goes alone
    finest = EFFECTS.fast
    warm = EFFECTS.settle

    def fits(self, model: mujoco.MjModel, at: str) -> bool:
        """Where a motor drives a joint, in a model whose limits are not switched off."""
        return can_split(model, at) and limits_act(model)

    def guesses(self, evidence: Evidence) -> Sequence[Values]:
        """The way that the joint goes in a twentieth of a millisecond, in half of one, and in five."""
        return [
            {"gap": seconds * evidence.speed_scale, "rotor_inertia": rotor, "contact_rate": 1e3, "contact_damping": 0.3}
            for seconds in (5e-5, 5e-4, 5e-3)
            for rotor in rotor_guesses(evidence, (0.08, 0.25))
        ]

    def edit(self, document: Document, at: str, values: Values) -> None:
        """A rotor beside the load, and a contact at each end of the play."""
        rotor, load = split(document, at, values["rotor_inertia"])
        rate = min(values["contact_rate"], 1 / document.timestep)  # what the file's step can follow
        limit(document, f"{at}_play", rotor, load, values["gap"], rate, values["contact_damping"])

    def sentence(self, at: str, values: Values, unit: Mapping[str, str]) -> str:
        """In words."""
        return f"Backlash of {values['gap']:.3g} {unit['gap']} between {at} and what it drives."
