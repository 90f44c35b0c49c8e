"""Gymnasium wrappers for the rig."""

from dipc_gym.wrappers.estimate import EstimateState
from dipc_gym.wrappers.faulty_motor import FaultyMotor, VectorFaultyMotor
from dipc_gym.wrappers.force_command import ForceCommand
from dipc_gym.wrappers.record import RecordRun
from dipc_gym.wrappers.vector import VectorForceCommand, VectorRecordRun
from dipc_gym.wrappers.vector_estimate import VectorEstimateState

__all__ = [
    "EstimateState",
    "FaultyMotor",
    "ForceCommand",
    "RecordRun",
    "VectorEstimateState",
    "VectorFaultyMotor",
    "VectorForceCommand",
    "VectorRecordRun",
]
