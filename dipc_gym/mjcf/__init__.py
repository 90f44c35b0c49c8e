"""MJCF files: read and compile those of strangers, ask a model what it commands and senses, edit its text."""

from dipc_gym.mjcf.model import (
    INPUTS,
    PREFIX,
    base_joints,
    check_supported,
    commanded,
    controls,
    followers,
    is_hinge,
    passive_actuators,
    scalar_sensors,
    sensor_addresses,
    sensor_delays,
    spread_out,
    texts,
    touching_pair,
)
from dipc_gym.mjcf.scan import MjcfError
from dipc_gym.mjcf.source import Source, as_source, compile, from_text, quiet_mujoco, read

__all__ = [
    "INPUTS",
    "PREFIX",
    "MjcfError",
    "Source",
    "as_source",
    "base_joints",
    "check_supported",
    "commanded",
    "compile",
    "controls",
    "followers",
    "from_text",
    "is_hinge",
    "passive_actuators",
    "quiet_mujoco",
    "read",
    "scalar_sensors",
    "sensor_addresses",
    "sensor_delays",
    "spread_out",
    "texts",
    "touching_pair",
]
