"""Every file that a command reads: a valid one, what damages it, and what the command does with it.

A reader gets the folder that holds the file. It reads, and then uses what it read as the command would, for a number
that passes the reader and breaks what follows is no better than a traceback.
"""

from __future__ import annotations

from collections.abc import Callable

import brains
import diagnoses
import folders
import rigs
from target import Target

TARGETS: dict[str, Callable[[], Target]] = {**rigs.TARGETS, **diagnoses.TARGETS, **brains.TARGETS, **folders.TARGETS}
"""Made when asked for, since some need torch."""
