"""Tasks on all cores side by side, in forks of this process, which know all that it knows.

A fit is a hundred short calls of the engine with Python between them; threads would take turns. A fork takes some
hundredths of a second, copies no data, and is told nothing: it has the tasks. What a task found comes back pickled, and
what both processes know already as its place in memory. Where systems cannot fork (Windows), or their libraries must
not be used after it (macOS), tasks run one after another, with the same results.
"""

from __future__ import annotations

import ctypes
import io
import multiprocessing
import pickle
import signal
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from typing import Any, TypeVar

from dipc_gym.engine import run
from dipc_gym.safety.interrupts import held_back

T = TypeVar("T")

FORKS = sys.platform == "linux"
_ENDS_WITH_PARENT = 1  # PR_SET_PDEATHSIG of prctl(2)

_tasks: Sequence[Callable[[], Any]] = ()  # of the present call; forks find them here
_known: dict[int, Any] = {}  # objects that both sides have, by their place in memory
_one_of_many = False  # in a fork: its siblings have the other cores


def cores(threads: int) -> int:
    """How many tasks may run side by side: as many as there are cores, and one within one of many."""
    return 1 if _one_of_many else run.cores(threads)


@contextmanager
def side_by_side(
    tasks: Sequence[Callable[[], T]], threads: int, shared: Iterable[object] = ()
) -> Iterator[Callable[[int], T]]:
    """Tasks that begin at once; how to get the result of each, by its number.

    What nobody asked for when this ends is given up. A task that fails in its fork, or whose fork dies, is done again
    here, where its error can be seen.

    Args:
        tasks: which change nothing that others depend on.
        threads: how many may run at a time, 0 for as many as there are cores; of one, each runs when it is asked for.
        shared: objects of which results come back as references to what is here, not as copies.

    Example:
        >>> with side_by_side([lambda: 6 * 7, lambda: 1 / 3], threads=2) as result:
        ...     result(0)
        42
    """
    global _tasks, _known
    count = min(cores(threads), len(tasks))
    if count < 2 or not FORKS:
        yield lambda k: tasks[k]()
        return
    known = {id(one): one for one in shared}
    others = set(multiprocessing.active_children())
    with ProcessPoolExecutor(count, multiprocessing.get_context("fork"), _begin) as pool:
        _tasks, _known = tasks, known
        try:
            # The engine's threads rest meanwhile, and NumPy's are made for this.
            with held_back(), warnings.catch_warnings():
                warnings.simplefilter("ignore", DeprecationWarning)
                futures = [pool.submit(_done, k) for k in range(len(tasks))]
        finally:
            _tasks, _known = (), {}

        def result(k: int) -> T:
            try:
                packed = futures[k].result()
            except Exception:
                return tasks[k]()
            found: T = _Unpickler(io.BytesIO(packed), known).load()
            return found

        try:
            yield result
        finally:
            for fork in set(multiprocessing.active_children()) - others:
                fork.terminate()


def _begin() -> None:
    """What a fork does first: it takes one core, leaves Ctrl-C to its parent, and ends with it, however that ends."""
    global _one_of_many
    _one_of_many = True
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)  # not what its parent would do then
    ctypes.CDLL(None).prctl(_ENDS_WITH_PARENT, signal.SIGKILL)


def _done(k: int) -> bytes:
    """The result of a task, pickled."""
    out = io.BytesIO()
    _Pickler(out).dump(_tasks[k]())
    return out.getvalue()


class _Pickler(pickle.Pickler):
    """Writes what both sides know as its place in memory, which forking does not change."""

    def persistent_id(self, thing: object) -> int | None:
        """The place of a thing that was there before the fork."""
        return id(thing) if id(thing) in _known else None


class _Unpickler(pickle.Unpickler):
    """Reads what a fork of this process wrote."""

    def __init__(self, data: io.BytesIO, known: dict[int, Any]) -> None:
        super().__init__(data, buffers=())
        self._known = known

    def persistent_load(self, place: int) -> Any:
        """What is there."""
        return self._known[place]
