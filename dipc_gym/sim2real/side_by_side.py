"""Tasks on all cores side by side, in forks of this process, which know all that it knows.

A fit is a hundred short calls of the engine with Python between them; threads would take turns. A fork takes some
hundredths of a second, copies no data, and is told nothing: it has the tasks. What a task found comes back pickled, and
what both processes know already as its place in memory. Where systems cannot fork (Windows), or their libraries must
not be used after it (macOS), tasks run one after another, with the same results.

Forks share no lock. Each writes its results into a pipe of its own, which ends when the fork does, and they take the
numbers of their tasks from one pipe that was filled before the first of them began. So a fork may be ended at any
moment, in the midst of a result too; a pool of the standard library then waits for the rest of it for ever.
"""

from __future__ import annotations

import ctypes
import io
import multiprocessing
import os
import pickle
import signal
import struct
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any, TypeVar

from dipc_gym.engine import run
from dipc_gym.safety.interrupts import held_back

T = TypeVar("T")

FORKS = sys.platform == "linux"
_ENDS_WITH_PARENT = 1  # PR_SET_PDEATHSIG of prctl(2)
_NUMBER = struct.Struct("=I")  # of a task

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
    count = min(cores(threads), len(tasks))
    if count < 2 or not FORKS:
        yield lambda k: tasks[k]()
        return
    known = {id(one): one for one in shared}
    forks: dict[Connection, BaseProcess] = {}  # at work, by the pipes that their results come from
    packed: dict[int, bytes] = {}

    def result(k: int) -> T:
        while k not in packed and forks:
            _received(forks, packed)
        if not packed.get(k):
            return tasks[k]()
        found: T = _Unpickler(io.BytesIO(packed[k]), known).load()
        return found

    try:
        _fork(tasks, known, count, forks)
        yield result
    finally:
        for pipe, fork in forks.items():
            fork.kill()
            fork.join()
            pipe.close()


def _fork(
    tasks: Sequence[Callable[[], Any]], known: dict[int, Any], count: int, forks: dict[Connection, BaseProcess]
) -> None:
    """Set forks to work, or as many as there is room for; without one, tasks are done here."""
    context = multiprocessing.get_context("fork")
    numbers, all_numbers = os.pipe()
    os.set_blocking(all_numbers, False)
    with suppress(BlockingIOError):  # a pipe holds some thousands; tasks beyond are done here
        for k in range(len(tasks)):
            os.write(all_numbers, _NUMBER.pack(k))
    os.close(all_numbers)
    # The engine's threads rest meanwhile, and NumPy's are made for this.
    try:
        with held_back(signal.SIGTERM), warnings.catch_warnings(), suppress(OSError):
            warnings.simplefilter("ignore", DeprecationWarning)
            for _ in range(count):
                results, out = context.Pipe(duplex=False)
                with out:  # the fork has the only other end: the pipe ends with it
                    fork = context.Process(target=_work, args=(tasks, known, numbers, out), daemon=True)
                    fork.start()
                forks[results] = fork
    finally:
        os.close(numbers)


def _received(forks: dict[Connection, BaseProcess], packed: dict[int, bytes]) -> None:
    """Wait for results, and take note of forks that have ended."""
    for pipe in wait(list(forks)):
        assert isinstance(pipe, Connection)
        try:
            (k,) = _NUMBER.unpack(pipe.recv_bytes())
            packed[k] = pipe.recv_bytes()
        except (EOFError, OSError):
            forks.pop(pipe).join()
            pipe.close()


def _work(tasks: Sequence[Callable[[], Any]], known: dict[int, Any], numbers: int, out: Connection) -> None:
    """What a fork does: it takes one core, leaves signals to its parent, ends with it, however that ends, and works."""
    global _one_of_many
    _one_of_many = True
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    ctypes.CDLL(None).prctl(_ENDS_WITH_PARENT, signal.SIGKILL)
    while number := os.read(numbers, _NUMBER.size):
        try:
            done = io.BytesIO()
            _Pickler(done, known).dump(tasks[_NUMBER.unpack(number)[0]]())
            found = done.getvalue()
        except Exception:
            found = b""  # its parent does it again and sees why
        out.send_bytes(number)
        out.send_bytes(found)


class _Pickler(pickle.Pickler):
    """Writes what both sides know as its place in memory, which forking does not change."""

    def __init__(self, out: io.BytesIO, known: dict[int, Any]) -> None:
        super().__init__(out)
        self._known = known

    def persistent_id(self, thing: object) -> int | None:
        """The place of a thing that was there before the fork."""
        return id(thing) if id(thing) in self._known else None


class _Unpickler(pickle.Unpickler):
    """Reads what a fork of this process wrote."""

    def __init__(self, data: io.BytesIO, known: dict[int, Any]) -> None:
        super().__init__(data, buffers=())
        self._known = known

    def persistent_load(self, place: int) -> Any:
        """What is there."""
        return self._known[place]
