"""Gymnasium wrappers for the rig."""

from dipc_gym.wrappers.force_command import ForceCommand
from dipc_gym.wrappers.record import RecordRun
from dipc_gym.wrappers.vector import VectorForceCommand, VectorRecordRun

__all__ = ["ForceCommand", "RecordRun", "VectorForceCommand", "VectorRecordRun"]
