"""Recordings: what was commanded and what was sensed, by a model's names, in SI units; read, checked, written.

`record` holds the table itself, `files` reads and writes it, `columns` and `units` match names and units, `tables`
knows the file formats, `checks` says what is odd about a channel, `clock` and `glitches` mend stamps and single
samples, and `parts` keeps several recordings apart.
"""

from dipc_gym.recording.checks import noise
from dipc_gym.recording.files import read, read_all, write
from dipc_gym.recording.held import resample_commands
from dipc_gym.recording.record import Recorder, Recording
from dipc_gym.recording.tables import RecordingError

__all__ = [
    "Recorder",
    "Recording",
    "RecordingError",
    "noise",
    "read",
    "read_all",
    "resample_commands",
    "write",
]
