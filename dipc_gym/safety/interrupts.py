"""Ctrl-C goes to every process of a terminal's group; one of them should answer. SIGTERM is taken for it."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import resource_tracker


@contextmanager
def held_back(*others: signal.Signals) -> Iterator[None]:
    """Hold Ctrl-C back, and from processes that are started meanwhile for good: whoever started them ends them.

    A worker that Ctrl-C meets while it imports would leave a traceback among the sentences.

    Args:
        others: signals that are held back as well: SIGTERM, where processes are not ended by it.

    Example:
        >>> with held_back():
        ...     signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, ())
        True
    """
    # Where it starts meanwhile, it lets Ctrl-C through again (Python 3.11), and to the worker that is started next.
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, *others})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def as_ctrl_c() -> Iterator[None]:
    """Take SIGTERM for Ctrl-C: batch systems and `timeout` send it some time before they kill.

    Signals are the main thread's; elsewhere nothing changes, nor does it for a process that is to ignore it.

    Example:
        >>> import time
        >>> with as_ctrl_c():
        ...     time.sleep(0.01)  # what takes long
    """
    ignored = signal.getsignal(signal.SIGTERM) is signal.SIG_IGN
    if ignored or threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before or signal.SIG_DFL)
