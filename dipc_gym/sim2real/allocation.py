"""Memory of arrays that are gone goes back to the system."""

from __future__ import annotations

import ctypes
import sys

_MMAP_THRESHOLD, _TRIM_THRESHOLD = -3, -1  # names of mallopt(3)
APART = 4_000_000  # bytes; a fit's Jacobian of many parameters takes more
SPARE = 16_000_000  # bytes at the end of the heap that may stay for what comes next


def give_back_freed() -> None:
    """Have the C library map large arrays apart from the heap, and return the end of the heap, for this process.

    Left to itself, glibc maps an array apart only until one as large was freed; from then on it lies in the heap, among
    small things that last. A diagnosis in which thousands of fits come and go then holds four times what it uses.
    Elsewhere this does nothing.

    Source:
        mallopt(3), on its dynamic threshold.

    Example:
        >>> give_back_freed()
    """
    if sys.platform == "linux" and (mallopt := getattr(ctypes.CDLL(None), "mallopt", None)):  # musl has none
        mallopt(_MMAP_THRESHOLD, APART)
        mallopt(_TRIM_THRESHOLD, SPARE)
