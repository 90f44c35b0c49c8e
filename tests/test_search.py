"""The rules by which a search goes on, ends, and chooses; what it finds is in test_diagnose.py."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from dipc_gym.sim2real.effects import catalogue
from dipc_gym.sim2real.screening import Tried
from dipc_gym.sim2real.search import Search
from dipc_gym.sim2real.structure import Term


@pytest.mark.parametrize(
    ("before", "now", "terms", "enough"),
    [
        (300.0, 1.1, 1, True),  # a third of a percent may be owed to the law of friction
        (10.0, 1.1, 1, False),  # a twentieth may not
        (300.0, 1.3, 1, False),  # not at the noise
        (1.02, 1.02, 0, False),  # nothing was found yet
        (5.0, 0.99, 2, True),
    ],
)
def test_a_search_ends_where_laws_may_leave_what_is_left(before: float, now: float, terms: int, enough: bool) -> None:
    def fitted(error: float, count: int) -> SimpleNamespace:
        return SimpleNamespace(error=error, structure=SimpleNamespace(terms=("friction",) * count))

    search = SimpleNamespace(path=[fitted(before, 0)])
    assert Search.enough(search, fitted(now, terms)) is enough  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("small", "before", "after", "earned"),
    [
        (False, 10.0, 7.0, True),  # a third of what is left
        (False, 10.0, 8.5, False),  # a sixth
        (True, 10.0, 2.0, False),  # small beside the motion: all or nothing
        (True, 10.0, 1.1, True),
        (False, 1.3, 1.1, True),
    ],
)
def test_what_earns_its_place(small: bool, before: float, after: float, earned: bool) -> None:
    """Errors in units of noise."""
    search = SimpleNamespace(small=small)
    windows = np.ones(9)
    assert Search._earned(search, after**2 * windows, before**2 * windows) is earned  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("plain", "elaborate", "kept"),
    [
        (40.0, 20.0, ["friction.coulomb"]),  # the plain one brings three quarters: it goes first
        (70.0, 20.0, ["friction.coulomb", "friction.stribeck"]),  # less than half
        (40.0, 2.0, ["friction.coulomb", "friction.stribeck"]),  # the other may yet come down to the noise
    ],
)
def test_what_elaborates_waits_for_the_plain_one(plain: float, elaborate: float, kept: list[str]) -> None:
    """Errors of sketches, in units of noise; without either it is 100."""
    errors = {"friction.coulomb": plain, "friction.stribeck": elaborate}
    sketched = [
        (Tried(Term(catalogue()[name], "cart", {}), 1.0, SimpleNamespace(error=error)), None)  # type: ignore[arg-type]
        for name, error in errors.items()
    ]
    search = SimpleNamespace(few=np.arange(4))
    current = SimpleNamespace(mse=np.full(9, 100.0**2))
    left = Search._plain_first(search, sketched, current)  # type: ignore[arg-type]
    assert [tried.term.effect.id for tried, _ in left] == kept


@pytest.mark.parametrize(("error", "tried"), [(1.1, True), (2.0, False)])
def test_what_happened_once_is_looked_for_at_the_noise(
    monkeypatch: pytest.MonkeyPatch, error: float, tried: bool
) -> None:
    """Elsewhere a push in the right moment takes up a little of everything."""
    push = catalogue()["disturbance.pulse"]
    monkeypatch.setattr("dipc_gym.sim2real.search.places", lambda *_: ["cart"])
    model = SimpleNamespace(dof_frictionloss=np.zeros(1))
    scene = SimpleNamespace(model=model, recordings=[None], at=lambda *_: None)
    search = SimpleNamespace(effects=[push], joints=(), _plain=lambda *_: {})
    current = SimpleNamespace(mse=np.full(9, error**2), structure=SimpleNamespace(terms=(), model=model))
    monkeypatch.setattr(type(push), "guesses", lambda *_: [{}])
    assert bool(Search.hypotheses(search, current, scene)) is tried  # type: ignore[arg-type]
