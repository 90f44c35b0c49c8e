"""Ctrl-C goes to every process of a terminal's group; one of them should answer."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import resource_tracker


@contextmanager
def held_back() -> Iterator[None]:
    """Hold Ctrl-C back, and from processes that are started meanwhile for good: whoever started them ends them.

    A worker that Ctrl-C meets while it imports would leave a traceback among the sentences.

    Example:
        >>> with held_back():
        ...     signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, ())
        True
    """
    # Where it starts meanwhile, it lets Ctrl-C through again (Python 3.11), and to the worker that is started next.
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
