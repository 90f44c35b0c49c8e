"""What holds for every test."""

from __future__ import annotations

import os

import pytest

from dipc_gym.engine import run
from dipc_gym.sim2real.verdict.guarded import Guarded


@pytest.fixture(autouse=True)
def _no_failure_becomes_a_note(monkeypatch: pytest.MonkeyPatch) -> None:
    """A stage that fails fails the test; what users get instead is tested in test_late.py."""
    monkeypatch.setattr(Guarded, "strict", True)


@pytest.fixture(autouse=True)
def _one_core_where_others_test(monkeypatch: pytest.MonkeyPatch) -> None:
    """A diagnosis that is told no number of cores takes one where workers fill them all: a fifth less time in all.

    What it finds is the same on any number of them, which test_side_by_side.py asks with numbers of its own.
    """
    if "PYTEST_XDIST_WORKER" in os.environ:
        monkeypatch.setattr(run, "cores", lambda threads: threads or 1)
