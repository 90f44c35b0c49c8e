"""Estimators: from encoder readings and commands to the rig's state, by name, in files, in the control loop.

from dipc_gym import runs
kalman = runs.estimator("disturbance")                  # friction learned from an identification run
env = EstimateState(gymnasium.make("DIPC-Friction-v0"), kalman)
"""

from dipc_gym.estimators.base import Command, EstimateWarning, Estimator, RigModel
from dipc_gym.estimators.differences import Differences
from dipc_gym.estimators.ekf import ExtendedKalman
from dipc_gym.estimators.files import EstimatorError, load, save
from dipc_gym.estimators.kalman import CompensatedKalman, Disturbance, Kalman
from dipc_gym.estimators.moving_horizon import MovingHorizon
from dipc_gym.estimators.registry import fit, kind, names, register
from dipc_gym.estimators.rigid_body import RigidBody

register("differences", Differences)
register("kalman", Kalman)
register("kalman_friction", CompensatedKalman)
register("disturbance", Disturbance)
register("ekf", ExtendedKalman)
register("moving_horizon", MovingHorizon)
register("rigid_body", RigidBody)

__all__ = [
    "Command",
    "CompensatedKalman",
    "Differences",
    "Disturbance",
    "EstimateWarning",
    "Estimator",
    "EstimatorError",
    "ExtendedKalman",
    "Kalman",
    "MovingHorizon",
    "RigModel",
    "RigidBody",
    "fit",
    "kind",
    "load",
    "names",
    "register",
    "save",
]
