"""Controllers: from what is observed to the force that is wanted on the cart."""

from dipc_gym.controllers.base import Controller
from dipc_gym.controllers.lqr import LQR
from dipc_gym.controllers.named import balancing, load
from dipc_gym.controllers.sb3_files import SB3Policy, read_policy
from dipc_gym.controllers.tracking import Tracking
from dipc_gym.policy import ControllerError

__all__ = ["LQR", "Controller", "ControllerError", "SB3Policy", "Tracking", "balancing", "load", "read_policy"]
