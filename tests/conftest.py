"""What holds for every test."""

from __future__ import annotations

import pytest

from dipc_gym.sim2real.verdict.guarded import Guarded


@pytest.fixture(autouse=True)
def _no_failure_becomes_a_note(monkeypatch: pytest.MonkeyPatch) -> None:
    """A stage that fails fails the test; what users get instead is tested in test_late.py."""
    monkeypatch.setattr(Guarded, "strict", True)
