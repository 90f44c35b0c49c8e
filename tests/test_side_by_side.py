"""Tasks in forks: results, what is shared, what goes wrong; and a diagnosis that does not depend on how many cores."""

from __future__ import annotations

import multiprocessing
import os
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dipc_gym import mjcf, recording
from dipc_gym.sim2real.diagnosis import diagnose
from dipc_gym.sim2real.effects import catalogue
from dipc_gym.sim2real.side_by_side import FORKS, cores, side_by_side

HERE = os.getpid()
EXAMPLE = Path(__file__).parents[1] / "examples" / "diagnose"

forked = pytest.mark.skipif(not FORKS, reason="this system does not fork")


def numbered(k: int) -> Callable[[], tuple[int, int]]:
    def task() -> tuple[int, int]:
        time.sleep(0.05 * (k % 2))
        return k, os.getpid()

    return task


@pytest.mark.parametrize("threads", [1, 2, 3])
def test_results_by_number_whatever_the_order(threads: int) -> None:
    with side_by_side([numbered(k) for k in range(7)], threads) as result:
        found = [result(k) for k in (6, 0, 3, 1)]
    assert [k for k, _ in found] == [6, 0, 3, 1]
    assert (HERE in {process for _, process in found}) == (threads == 1 or not FORKS)


@pytest.mark.parametrize("threads", [1, 2])
def test_what_is_shared_comes_back_as_itself_and_all_else_equal(threads: int) -> None:
    shared, own = np.arange(3.0), {"a": None}
    with side_by_side([lambda: (shared, [shared], own, None)] * 2, threads, [shared]) as result:
        back, (again,), copied, nothing = result(1)
    assert back is shared
    assert again is shared
    assert nothing is None
    assert copied == own
    assert (copied is own) == (threads == 1 or not FORKS)


@pytest.mark.parametrize("threads", [1, 2])
def test_an_error_is_that_of_the_task(threads: int) -> None:
    def fails() -> None:
        raise ValueError("the task's own")

    with side_by_side([fails, lambda: None], threads) as result:
        assert result(1) is None
        with pytest.raises(ValueError, match="the task's own"):
            result(0)


@forked
def test_what_a_fork_took_with_it_is_done_here() -> None:
    def dies_elsewhere() -> int:
        if os.getpid() != HERE:
            os._exit(1)
        return os.getpid()

    with side_by_side([dies_elsewhere, dies_elsewhere, dies_elsewhere], 2) as result:
        assert [result(k) for k in range(3)] == [HERE] * 3


@forked
def test_what_cannot_be_pickled_is_done_here() -> None:
    with side_by_side([lambda: lambda: 5, lambda: None], 2) as result:
        assert result(0)() == 5


@forked
def test_what_nobody_asked_for_is_given_up() -> None:
    with side_by_side([lambda: 1, *[lambda: time.sleep(3600)] * 3], 2) as result:
        assert result(0) == 1
    assert not multiprocessing.active_children()


@forked
def test_a_fork_may_be_given_up_in_the_midst_of_its_result() -> None:
    def large() -> np.ndarray:  # takes several writes
        return np.zeros(300_000)

    for _ in range(20):
        with side_by_side([large] * 6, 2) as result:
            assert result(0).size == 300_000
    assert not multiprocessing.active_children()


@forked
def test_more_tasks_than_a_pipe_holds_numbers_of() -> None:
    with side_by_side([lambda: HERE] * 20_000, 2) as result:
        assert [result(k) for k in (0, 19_999, 16_384)] == [HERE] * 3


@forked
@pytest.mark.parametrize("room", [0, 1])
def test_without_room_for_forks_tasks_are_done_here(room: int, monkeypatch: pytest.MonkeyPatch) -> None:
    fork, begun = os.fork, list[int]()

    def full() -> int:
        if len(begun) == room:
            raise BlockingIOError(11, "Resource temporarily unavailable")
        begun.append(room)
        return fork()

    monkeypatch.setattr(os, "fork", full)
    with side_by_side([numbered(k) for k in range(4)], 2) as result:
        found = [result(k) for k in range(4)]
    assert [k for k, _ in found] == [0, 1, 2, 3]
    assert (HERE in {process for _, process in found}) == (room == 0)
    assert not multiprocessing.active_children()


@forked
def test_forks_end_with_a_parent_that_is_killed() -> None:
    code = (
        "import os, time\n"
        "from dipc_gym.sim2real.side_by_side import side_by_side\n"
        "def lasts(): os.write(1, b'%d\\n' % os.getpid()); time.sleep(3600)\n"  # in one write, whatever Python buffers
        "with side_by_side([lasts, lasts], 2) as result: result(0)\n"
    )
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        try:
            forks = [int(parent.stdout.readline()) for _ in range(2)]
        finally:
            parent.kill()
    for _ in range(200):
        if not any(Path(f"/proc/{fork}").exists() for fork in forks):
            return
        time.sleep(0.05)
    pytest.fail("a fork outlives its parent")


def test_of_one_at_a_time_what_nobody_asked_for_never_begins() -> None:
    def never() -> None:
        raise AssertionError

    with side_by_side([lambda: 1, never], 1) as result:
        assert result(0) == 1


@forked
def test_a_fork_has_one_core_and_forks_no_further() -> None:
    def inner() -> tuple[int, int, int]:
        with side_by_side([os.getpid, os.getpid], 2) as result:
            return cores(0), result(0), os.getpid()

    with side_by_side([inner, inner], 2) as result:
        for k in range(2):
            one, inside, fork = result(k)
            assert one == 1
            assert inside == fork != HERE
    assert cores(0) >= 1
    assert cores(5) == 5


@pytest.mark.parametrize("kinds", [("friction.", "load.", "drag."), ("friction.speed_law", "unknown.")])
def test_a_diagnosis_is_the_same_on_any_number_of_cores(kinds: tuple[str, ...]) -> None:
    model = mjcf.compile(EXAMPLE / "arm.xml")
    recordings = [recording.read(EXAMPLE / f"run_{k}.csv", model) for k in (1, 2)]
    effects = [effect for effect in catalogue().values() if effect.id.startswith(kinds)]
    one, two = (
        replace(diagnose(EXAMPLE / "arm.xml", recordings, effects=effects, threads=threads), provenance={}).to_dict()
        for threads in (1, 2)
    )
    assert one == two
