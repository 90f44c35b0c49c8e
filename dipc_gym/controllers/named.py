"""Controllers by the names that the command line gives them."""

from __future__ import annotations

from dipc_gym import policy
from dipc_gym.controllers.base import Controller
from dipc_gym.controllers.designs import DESIGNS
from dipc_gym.controllers.lqr import LQR
from dipc_gym.controllers.sb3_files import read_policy
from dipc_gym.controllers.tracking import SCHEMA, Tracking
from dipc_gym.policy import ControllerError
from dipc_gym.safety.naming import suggestion


def load(name: str) -> Controller:
    """A controller by what the command line calls it.

    Args:
        name: `lqr`, one of `designs.DESIGNS`, `tvlqr`, which swings up, or the path of a file: a policy of dipc-gym's
            (`.json`) or of stable-baselines3's (`.zip`), or what `dipc-gym plan` wrote (`.json`).

    Raises:
        ControllerError: there is none of that name, or the file is refused.
    """
    if name == "tvlqr":
        return Tracking.shipped()
    if name == "lqr":
        return LQR()
    if name in DESIGNS:
        return DESIGNS[name]()
    if name.endswith(".json"):
        content = policy.FORMAT.read(name)
        if isinstance(content, dict) and content.get("schema") == SCHEMA:
            return Tracking.load(name)
        return policy.Policy.load(name)
    if not name.endswith(".zip"):
        raise ControllerError(
            f"there is no controller {name!r}; there are 'lqr', 'tvlqr', {', '.join(map(repr, DESIGNS))} and paths of "
            f"saved policies (.json, .zip) and plans (.json){suggestion(name, ['lqr', 'tvlqr', *DESIGNS])}"
        )
    return read_policy(name)


def balancing(name: str) -> Controller:
    """A controller by name, of those that hold a rig upright.

    Raises:
        ControllerError: it swings up; or what `load` raises.
    """
    controller = load(name)
    if isinstance(controller, Tracking) or (isinstance(controller, policy.Policy) and controller.swings_up):
        raise ControllerError(
            f"{name} is for DIPC-Friction-SwingUp-v0 and swings up; here controllers balance, such as 'lqr'"
        )
    return controller
