"""Controllers by the names that the command line gives them."""

from __future__ import annotations

from dipc_gym import policy
from dipc_gym.controllers.base import Controller
from dipc_gym.controllers.designs import DESIGNS
from dipc_gym.controllers.lqr import LQR
from dipc_gym.controllers.sb3_files import read_policy
from dipc_gym.naming import suggestion
from dipc_gym.policy import ControllerError


def load(name: str) -> Controller:
    """A controller by what the command line calls it.

    Args:
        name: `lqr`, one of `designs.DESIGNS`, or the path of a policy: dipc-gym's own (`.json`), or saved by
            stable-baselines3 (`.zip`).

    Raises:
        ControllerError: there is none of that name, or the file is refused.
    """
    if name == "lqr":
        return LQR()
    if name in DESIGNS:
        return DESIGNS[name]()
    if name.endswith(".json"):
        return policy.Policy.load(name)
    if not name.endswith(".zip"):
        raise ControllerError(
            f"there is no controller {name!r}; there are 'lqr', {', '.join(map(repr, DESIGNS))} and paths of saved "
            f"policies (.json, .zip){suggestion(name, ['lqr', *DESIGNS])}"
        )
    return read_policy(name)
